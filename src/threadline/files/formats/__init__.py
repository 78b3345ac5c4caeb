"""Readers and writers of recordings and tick tables, chosen by the file extension."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from threadline.base.reading import refuse_special
from threadline.errors import RecordingError
from threadline.files.commands import TickTable
from threadline.files.formats.common import Written, clear_errors
from threadline.files.formats.plt import read_plt, write_plt
from threadline.files.formats.recording_csv import read_recording_csv, write_recording_csv
from threadline.files.formats.recording_npz import read_recording_npz, write_recording_npz
from threadline.files.formats.table_text import read_table_csv
from threadline.files.formats.tick_table import read_table_npz, write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import read_array, write_array
from threadline.files.recording import Recording

__all__ = [
    "Written",
    "read_array",
    "read_plt",
    "read_recording",
    "read_recording_csv",
    "read_recording_mcap",
    "read_recording_npz",
    "read_table",
    "read_table_csv",
    "read_table_npz",
    "write_array",
    "write_plt",
    "write_recording",
    "write_recording_csv",
    "write_recording_mcap",
    "write_recording_npz",
    "write_table_csv",
    "write_table_npz",
]


def read_recording_mcap(path: Path) -> Recording:
    """Read an MCAP recording; imports the MCAP library on the first call."""
    from threadline.files.formats import recording_mcap

    return recording_mcap.read_recording_mcap(path)


def write_recording_mcap(recording: Recording, path: Path) -> Written:
    """Write an MCAP recording; imports the MCAP library on the first call."""
    from threadline.files.formats import recording_mcap

    return recording_mcap.write_recording_mcap(recording, path)


_RECORDING_READERS: dict[str, Callable[[Path], Recording]] = {
    ".npz": read_recording_npz,
    ".csv": read_recording_csv,
    ".plt": read_plt,
    ".mcap": read_recording_mcap,
}
_RECORDING_WRITERS: dict[str, Callable[[Recording, Path], Written]] = {
    ".npz": write_recording_npz,
    ".csv": write_recording_csv,
    ".plt": write_plt,
    ".mcap": write_recording_mcap,
}
_TABLE_READERS: dict[str, Callable[[Path], TickTable]] = {
    ".npz": read_table_npz,
    ".csv": read_table_csv,
    ".ticks": read_array,
}


def _ending(path: Path, among: Mapping[str, object], what: str) -> str:
    ending = path.suffix.lower()
    if ending not in among:
        raise RecordingError(
            f"{path.name[:80]!r} has no extension of a {what}", remedy=f"Known: {', '.join(among)}."
        )
    return ending


def read_recording(path: str | Path) -> Recording:
    """Read a recording: ``.npz``, ``.mcap``, ``.plt``, ``.csv`` (also of other programs).

    Raises
    ------
    RecordingError
        If it is none of them, or damaged.
    """
    path = Path(path)
    with clear_errors(path):
        refuse_special(path)
        return _RECORDING_READERS[_ending(path, _RECORDING_READERS, "recording")](path)


def write_recording(
    recording: Recording, path: str | Path, *, plot_every: int | None = None
) -> Written:
    """Write a recording in the format given by the extension of ``path``.

    Only ``.npz`` and ``.mcap`` keep every clock.

    Parameters
    ----------
    recording
        The recording to write.
    path
        Name of the file; its extension gives the format.
    plot_every
        Ticks from line to line of a ``.plt``; by default every sample. The other formats write all
        samples.

    Raises
    ------
    RecordingError
        If the format cannot hold the recording, or the file cannot be written.
    """
    path = Path(path)
    ending = _ending(path, _RECORDING_WRITERS, "recording")
    if ending == ".plt":
        return write_plt(recording, path, every=plot_every)
    return _RECORDING_WRITERS[ending](recording, path)


def read_table(path: str | Path) -> TickTable:
    """Read a tick table: ``.npz``, ``.csv``, or ``.ticks`` (the trajectory array).

    Raises
    ------
    RecordingError
        If it is none of them, or damaged.
    """
    path = Path(path)
    with clear_errors(path):
        refuse_special(path)
        return _TABLE_READERS[_ending(path, _TABLE_READERS, "tick table")](path)
