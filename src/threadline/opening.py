"""What every reader asks of a path before it opens it, and short text files read whole."""

from __future__ import annotations

import errno
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from threadline.errors import InputError, Place


def refuse_special(path: Path) -> None:
    """Refuse a pipe, a device or a socket: opening or reading one may never end.

    Raises
    ------
    OSError
        If ``path`` is one of them, or cannot be looked at. A folder passes: opening it fails with
        a reason of its own.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))


@contextmanager
def naming(output: Path, temporary: Path) -> Iterator[None]:
    """Let an error of the block name ``output``, where it names what is made of it or nothing.

    A full disk names no file, and a file in a temporary folder is none that anybody asked for.

    Parameters
    ----------
    output
        What was asked for.
    temporary
        What it is made from, a folder or a file that is gone afterwards.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None or str(error.filename).startswith(str(temporary)):
            error.filename = str(output)
        raise
    except InputError as error:
        error.message = error.message.replace(str(temporary), str(output))
        raise


def read_text(
    path: Path, most_bytes: int, error: type[InputError], what: str, encoding: str = "utf-8"
) -> str:
    """Return the whole of a text file that people write.

    Parameters
    ----------
    path
        The file.
    most_bytes
        A larger one is refused before it is read.
    error
        What is raised.
    what
        What the file should be, for remedies: ``"machine file"``.
    encoding
        ``"utf-8-sig"`` where a byte order mark may stand first.

    Raises
    ------
    InputError
        Of the kind ``error``, if the file cannot be read, is too large or is not UTF-8.
    """
    try:
        refuse_special(path)
        size = path.stat().st_size
        content = path.read_bytes() if size <= most_bytes else b""
    except (OSError, ValueError) as failure:  # a null in a name is a ValueError
        why = failure.strerror if isinstance(failure, OSError) else failure
        raise error(
            f"cannot read {str(path)[:200]!r}: {why}", remedy=f"Give a {what} that can be read."
        ) from failure
    place = Place(str(path))
    if size > most_bytes:
        said = f"the file has {size} bytes, limit {most_bytes}"
        raise error(said, place=place, remedy=f"Is this a {what}?")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as failure:
        raise error(
            "the file is not UTF-8 text", place=place, remedy="Save it as UTF-8."
        ) from failure
