"""Files that a command writes: refused before the work where they cannot be, all or none after."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from threadline.errors import OptionError
from threadline.opening import naming


def check_outputs(
    *, file: Path | None = None, folder: Path | None = None, make: bool = True
) -> None:
    """Refuse outputs that could not be written, before hours of work go into them.

    Parameters
    ----------
    file
        A file to be written; its folder may have to be made.
    folder
        A folder to be written into; it may have to be made.
    make
        False where the folder of ``file`` must be there.

    Raises
    ------
    OptionError
        If the folder is none, or nothing can be written there.
    """
    if file is not None:
        if file.is_dir():
            raise OptionError(f"cannot write {str(file)!r}: it is a folder", remedy="Name a file.")
        _check_folder(file.parent, file, made=make)
    if folder is not None:
        _check_folder(folder, folder, made=True)


def _check_folder(folder: Path, wanted: Path, *, made: bool) -> None:
    there = folder
    while made and not os.path.lexists(there) and there != there.parent:
        there = there.parent
    if not there.is_dir():
        why = "is not a folder" if os.path.lexists(there) else "does not exist"
        raise OptionError(
            f"cannot write {str(wanted)!r}: {str(there)!r} {why}", remedy="Give another path."
        )
    if not os.access(there, os.W_OK | os.X_OK):
        raise OptionError(
            f"cannot write {str(wanted)!r}: no permission to write in {str(there)!r}",
            remedy="Give another path.",
        )


@contextmanager
def folder_of(file: Path | None) -> Iterator[None]:
    """Make the folder of ``file`` for the block; a block that fails takes it away again."""
    missing = []
    if file is not None:
        missing = [p for p in (file.parent, *file.parent.parents) if not os.path.lexists(p)]
        file.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for folder in missing:
            with suppress(OSError):  # something else has been put there
                folder.rmdir()
        raise


@contextmanager
def appearing(file: Path | None) -> Iterator[Path | None]:
    """Give a path to write to that becomes ``file`` when the block ends well, and not otherwise.

    It ends like ``file``, beside it, so that a writer sees the format and the move is one step.
    """
    if file is None:
        yield None
        return
    with (
        folder_of(file),
        tempfile.TemporaryDirectory(dir=file.parent, prefix=f".{file.name[:80]}.") as made,
    ):
        temporary = Path(made) / file.name
        with naming(file, temporary):
            yield temporary
            temporary.replace(file)
