"""Checks that a command can write its output files, made before its work begins."""

from __future__ import annotations

import os
from itertools import product
from pathlib import Path

from threadline.errors import OptionError
from threadline.writing import check_output, is_stdout

_STEMS = ("report", "comparison", "shaper", "analysis", "design")
"""Names of reports' pages, without suffix, at which no folder or read-only file may be."""


def check_outputs(*, file: Path | None = None, folder: Path | None = None) -> None:
    """Refuse outputs that could not be written, before hours of work go into them.

    Parameters
    ----------
    file
        A file to be written; its folder may have to be made.
    folder
        A folder to be written into; it may have to be made.

    Raises
    ------
    OptionError
        If what should be a folder is a file, nothing can be written there, or something is in the
        way.
    """
    if file is not None:
        check_output(file)
        if not is_stdout(file):
            _check_folder(Path(os.path.realpath(file)).parent, file)
    if folder is not None:
        _check_folder(Path(os.path.realpath(folder)), folder)
        for stem, ending in product(_STEMS, ("html", "pdf")):
            if (page := folder / f"{stem}.{ending}").exists():
                check_output(page)


def _check_folder(folder: Path, wanted: Path) -> None:
    there = folder
    while not os.path.lexists(there) and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise OptionError(
            f"cannot write {str(wanted)!r}: {str(there)!r} is not a folder",
            remedy="Give another path.",
        )
    if not os.access(there, os.W_OK | os.X_OK):
        raise OptionError(
            f"cannot write {str(wanted)!r}: no permission to write in {str(there)!r}",
            remedy="Give another path.",
        )
