"""Readers and writers of recordings and tick tables, chosen by the file extension."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from threadline.base.reading import refuse_special
from threadline.errors import RecordingError
from threadline.files.commands import TickTable
from threadline.files.formats.common import Written, clear_errors
from threadline.files.recording import Recording

__all__ = ["Written", "read_recording", "read_table", "write_recording"]

_RECORDINGS: Mapping[str, str] = {
    ".npz": "recording_npz",
    ".csv": "recording_csv",
    ".plt": "plt",
    ".mcap": "recording_mcap",
}
_TABLES: Mapping[str, tuple[str, str]] = {
    ".npz": ("tick_table", "read_table_npz"),
    ".csv": ("table_text", "read_table_csv"),
    ".ticks": ("trajectory_array", "read_array"),
}
"""Module of each recording format, by file extension; module and reader of each table format."""


def _of_recordings(verb: str, ending: str) -> Callable[..., Any]:
    """Return the reader or writer of a format, after importing its module."""
    name = _RECORDINGS[ending]
    function: Callable[..., Any] = getattr(import_module(f"{__name__}.{name}"), f"{verb}_{name}")
    return function


def _ending(path: Path, formats: Mapping[str, object], what: str) -> str:
    ending = path.suffix.lower()
    if ending not in formats:
        raise RecordingError(
            f"{path.name[:80]!r} has no extension of a {what}",
            remedy=f"Known: {', '.join(formats)}.",
        )
    return ending


def read_recording(path: str | Path) -> Recording:
    """Read a recording: ``.npz``, ``.mcap``, ``.plt``, or ``.csv`` (also from other programs).

    Raises
    ------
    RecordingError
        If the file has none of these formats, or is damaged.
    """
    path = Path(path)
    with clear_errors(path):
        refuse_special(path)
        recording: Recording = _of_recordings("read", _ending(path, _RECORDINGS, "recording"))(path)
        return recording


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
        Number of ticks from one line to the next in a ``.plt``; by default every sample is written.
        The other formats always have all samples.

    Raises
    ------
    RecordingError
        If the format cannot hold the recording, or the file cannot be written.
    """
    path = Path(path)
    ending = _ending(path, _RECORDINGS, "recording")
    plot_options = {"every": plot_every} if ending == ".plt" else {}
    written: Written = _of_recordings("write", ending)(recording, path, **plot_options)
    return written


def read_table(path: str | Path) -> TickTable:
    """Read a tick table: ``.npz``, ``.csv``, or ``.ticks`` (the trajectory array).

    Raises
    ------
    RecordingError
        If the file has none of these formats, or is damaged.
    """
    path = Path(path)
    with clear_errors(path):
        refuse_special(path)
        module, reader = _TABLES[_ending(path, _TABLES, "tick table")]
        table: TickTable = getattr(import_module(f"{__name__}.{module}"), reader)(path)
        return table
