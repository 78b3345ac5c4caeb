"""End of the program at a defect: an exit status of its own, one line, and a traceback file."""

from __future__ import annotations

import platform
import shlex
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

from threadline import __version__

EXIT_DEFECT = 70
"""EX_SOFTWARE of sysexits.h; a crash must not end with 1, which says "out of specification"."""
_SHOWN = 120


def keep_traceback(error: Exception, given: Sequence[str]) -> str:
    """Write the traceback of ``error`` to a file of its own; return the line that says where.

    Parameters
    ----------
    error
        The exception that the program did not expect.
    given
        The arguments of the command.
    """
    where = traceback.extract_tb(error.__traceback__)
    at = f" at {Path(where[-1].filename).name}:{where[-1].lineno}" if where else ""
    said = " ".join(str(error).split())[:_SHOWN]
    what = f"{type(error).__name__}{at}{f': {said}' if said else ''}"
    text = "\n".join(
        [
            f"threadline {__version__}, Python {platform.python_version()}, {platform.platform()}",
            f"command: threadline {shlex.join(given)}",
            "",
            "".join(traceback.format_exception(error)),
        ]
    )
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            prefix="threadline-defect-",
            suffix=".txt",
            delete=False,
            encoding="utf-8",
            errors="backslashreplace",
        ) as file:
            file.write(text)
        kept = f"Please report it with the file {file.name}, which has the traceback."
    except OSError as failure:
        kept = f"Its traceback could not be kept: {failure.strerror or failure}."
    return f"[DEFECT] this is a defect of the program, not of the input: {what}. {kept}"
