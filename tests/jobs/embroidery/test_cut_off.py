"""Designs that are cut off or inconsistent: refused, and never read as a shorter design."""

from __future__ import annotations

import io
import time
from pathlib import Path

import numpy as np
import pytest
from pystitch import EmbPattern, HusReader
from tools import fuzz_designs as made

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.errors import JobError, Place
from threadline.jobs import read_job
from threadline.jobs.embroidery.hus import read_hus
from threadline.machine import load_machine

MACHINE = load_machine("schiffli-frame")
SAMPLES = SHARED_SAMPLES / "embroidery"
WHERE = Place("a.hus")


def last_stitch(content: bytes, suffix: str) -> int:
    """Return the number of bytes after which no part of the stitches is missing."""
    if suffix == "pes":  # pictures of it follow
        return content.rindex(b"\xff\x00", 0, len(content) - 6 * 38)
    if suffix == "xxx":  # colours of it follow
        return content.rindex(b"\x7f\x7f")
    return len(content) - 1


@pytest.mark.parametrize("suffix", ["dst", "pes", "jef", "vp3", "xxx", "u01", "hus", "t15"])
def test_a_design_that_is_cut_off_is_refused_wherever_that_is(suffix: str, tmp_path: Path) -> None:
    """EXP alone cannot tell: it has no header, and no mark of its end."""
    content = made.seeds()[suffix]
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(content)
    read_job(file, MACHINE)
    for cut in np.linspace(1, last_stitch(content, suffix) - 3, 60).astype(int).tolist():
        file.write_bytes(content[:cut])
        with pytest.raises(JobError) as refused:
            read_job(file, MACHINE)
        assert "\n" not in str(refused.value), cut
        assert refused.value.place is not None


SEEDS = {"random": lambda: made.seeds()["dst"], "rosette": made.EXAMPLE.read_bytes}


@pytest.mark.parametrize("fill", [b"", b"\x1a"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_dst_that_lacks_only_its_end_mark_is_read_with_a_warning(
    seed: str, fill: bytes, tmp_path: Path
) -> None:
    """One record fewer is a cut-off design."""
    content = SEEDS[seed]()
    file = tmp_path / "a.dst"
    file.write_bytes(content)
    whole = read_job(file, MACHINE)
    assert not any("end is missing" in warning for warning in whole.warnings)
    end = content.rindex(b"\x00\x00\xf3")
    file.write_bytes(content[:end] + fill)
    read = read_job(file, MACHINE)
    assert any("the mark of its end is missing" in warning for warning in read.warnings)
    assert [str(item) for item in read] == [str(item) for item in whole]
    for less in (3, 6, 30):
        file.write_bytes(content[: end - less] + fill)
        with pytest.raises(JobError, match="without the mark of its end"):
            read_job(file, MACHINE)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
@pytest.mark.parametrize("name", ["tree.dst", "peace.dst", "Star.DST", "Embroidermodder.DST"])
def test_real_dst_files_lack_their_end_mark_and_nothing_else(name: str, tmp_path: Path) -> None:
    """Their programs count the end mark as a record, or do not."""
    content = (SAMPLES / name).read_bytes()
    file = tmp_path / name
    end = 512 + (content[512:].rindex(b"\xf3") // 3) * 3
    file.write_bytes(content[:end])
    assert "the mark of its end is missing" in read_job(file, MACHINE).warnings[0]
    for cut in np.linspace(515, end - 3, 40).astype(int).tolist():
        file.write_bytes(content[:cut])
        with pytest.raises(JobError):
            read_job(file, MACHINE)


def records_of_peer(content: bytes) -> np.ndarray:
    pattern = EmbPattern()
    HusReader.read(io.BytesIO(content), pattern)
    return np.array(pattern.stitches)


def test_hus_is_read_as_another_library_reads_it() -> None:
    """That library also reports a trim that moves as a jump and a trim; places are the same."""
    content = made.hus_seed()
    ours, theirs = read_hus(content, WHERE), records_of_peer(content)
    assert np.array_equal(ours[ours[:, 2] == 0], theirs[theirs[:, 2] == 0])
    assert np.array_equal(ours[-1], theirs[-1])
    assert len(ours) == 241


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
def test_a_real_hus_is_read_as_another_library_reads_it() -> None:
    content = (SAMPLES / "Star.HUS").read_bytes()
    assert np.array_equal(read_hus(content, WHERE), records_of_peer(content))


@pytest.mark.parametrize(
    ("at", "put", "message"),
    [
        (0, b"\x00\x00\x00\x00", "it begins with 0x00000000"),
        (4, b"\x00\x00\x00\x00", "0 records, at most 10000000"),
        (4, b"\xff\xff\xff\xff", "4294967295 records, at most 10000000"),
        (4, b"\x80\x96\x98\x00", "column command has 241 of 10000000 records"),
        (20, b"\xff\xff\xff\x7f", "its column command is from 2147483647"),
        (42, b"\x00\x00", "column command: a block of no symbols"),
        # Lengths of lengths: one of them, of 3 one-bits, followed by as many again as needed.
        (44, b"\x0f\xff\xff\xff", "column command: a code of more than 16 bits"),
    ],
)
def test_a_hus_that_asks_for_more_than_it_has_is_refused_at_once(
    at: int, put: bytes, message: str
) -> None:
    """With some of these the peer's reader would fill the memory."""
    content = bytearray(made.hus_seed())
    content[at : at + len(put)] = put
    begun = time.process_time()
    with pytest.raises(JobError, match=message):
        read_hus(bytes(content), WHERE)
    assert time.process_time() - begun < 1.0
