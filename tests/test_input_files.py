"""No reader waits for a pipe or reads a device; a refusal is reported once."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from threadline.errors import InputError
from threadline.files.formats import read_recording, read_table
from threadline.files.formats.common import atomic_file
from threadline.identify.read_response import read_response
from threadline.jobs import FORMATS, read_job
from threadline.jobs.embroidery import records
from threadline.jobs.seam import STITCHING_KEYS
from threadline.jobs.seam import job as seam_job
from threadline.machine import load_machine
from threadline.machine.par import read_parameters
from threadline.verdict import load_spec

READERS: dict[str, Callable[[Path], Any]] = {
    "job.prg": lambda path: read_job(path, load_machine("lathe-winder")),
    "job.seam.toml": lambda path: read_job(path, load_machine("stitcher")),
    "moves.toml": lambda path: read_job(path, load_machine("letter-placer")),
    "machine.toml": load_machine,
    "settings.par": lambda path: read_parameters(path, load_machine("lathe-winder")),
    "spec.toml": lambda path: load_spec(path, load_machine("lathe-winder")),
    "measured.csv": read_response,
    "run.npz": read_recording,
    "run.csv": read_recording,
    "run.plt": read_recording,
    "table.ticks": read_table,
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_and_not_waited_for(name: str, tmp_path: Path) -> None:
    """Nobody writes into the pipe: a reader that opens it would wait for ever."""
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(InputError, match="pipe or a device"):
        READERS[name](path)


@pytest.mark.parametrize("name", READERS)
def test_a_device_is_refused_and_not_read(name: str, tmp_path: Path) -> None:
    """/dev/zero has no size and no end."""
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="pipe or a device"):
        READERS[name](path)


@pytest.mark.parametrize("name", ["machine.toml", "spec.toml", "measured.csv"])
def test_a_huge_file_is_told_once(name: str, tmp_path: Path) -> None:
    """The error is itself a ValueError, and must not be wrapped as a reading error."""
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(InputError) as caught:
        READERS[name](path)
    assert "limit" in caught.value.message
    assert "cannot read" not in str(caught.value)


@pytest.mark.parametrize("name", ["measured.csv"])
def test_a_missing_file_is_wrong_input(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        READERS[name](tmp_path / name)


def test_a_pipe_is_not_written_over(tmp_path: Path) -> None:
    """A finished file replaces the old one, which must not be a device."""
    pipe = tmp_path / "run.csv"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe or a device"), atomic_file(pipe):
        pass
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


def test_the_table_of_formats_names_the_endings_that_its_readers_know() -> None:
    """The table does not import its readers, so both hold the endings."""
    known = {one.name: one for one in FORMATS}
    assert known["seam"].extensions == seam_job.SUFFIXES
    assert known["embroidery design"].extensions == records.SUFFIXES
    assert known["seam"].options == STITCHING_KEYS
    assert known["part program"].options == ("dialect", "feed_mode", "base_axes", "axes")
    assert known["move list"].options == ()
