"""Written DST and U01: read back stitch for stitch, and compared with another writer."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pystitch
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.cli.main import main
from threadline.commands.step_files import two_speeds
from threadline.errors import PlanError
from threadline.jobs import Job, Move, ToolEvent, read_job
from threadline.jobs.embroidery.tapes import dst_bytes, u01_bytes
from threadline.machine import load_machine
from threadline.machine.load import library_file
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

MACHINE = load_machine("schiffli-frame")
SAMPLES = SHARED_SAMPLES / "embroidery"


def items_of(job: Job) -> list[object]:
    """Return the moves (place, stitch, block), and the names of the events between them."""
    return [
        (tuple(round(v * 1e4) for v in item.target), item.tags["stitch"], item.tags["block"])
        if isinstance(item, Move)
        else item.name
        for item in job
        if isinstance(item, Move | ToolEvent)
    ]


def compiled(file: Path, out: Path, machine=MACHINE) -> Path:
    plan = plan_job(open_job(file, machine, Options()), machine, Options())
    write(plan, out.suffix[1:], out)
    return out


@pytest.fixture
def short_and_long(tmp_path: Path) -> Path:
    """Return a design of 30 short and 30 long stitches, farther along X than along Y."""
    numbers = np.random.default_rng(5)
    moves = np.concatenate([numbers.integers(3, 12, (30, 2)), numbers.integers(40, 90, (30, 2))])
    units = moves * np.where(np.arange(60) % 3 == 0, -1, 1)[:, None] + [[7, 0]]
    file = tmp_path / "short-and-long.dst"
    file.write_bytes(dst_bytes(units, np.ones(60, dtype=np.int64), {}, "x"))
    return file


@pytest.mark.long(but="rosette.dst")
@pytest.mark.parametrize("name", ["rosette.dst", "Star.u01", "peace.dst"])
def test_a_compiled_dst_reads_back_as_the_job_that_it_was(
    name: str, examples: Path, tmp_path: Path
) -> None:
    file = examples / name if name == "rosette.dst" else SAMPLES / name
    if not file.is_file():
        pytest.skip(NO_SAMPLES)
    out = compiled(file, tmp_path / "a.dst")
    assert items_of(read_job(out, MACHINE)) == items_of(read_job(file, MACHINE))
    # Another library finds the same stitches, and the extents of the header.
    pattern = pystitch.read(str(out))
    needles = [(x, -y) for x, y, act in pattern.stitches if act & 0xFF == pystitch.STITCH]
    moved = [item for item in items_of(read_job(file, MACHINE)) if not isinstance(item, str)]
    assert needles == [place for place, stitch, _ in moved if stitch]
    left, top, right, bottom = pattern.bounds()
    head = out.read_bytes()[:512]
    for key, value in (("+X", right), ("-X", -left), ("+Y", -top), ("-Y", bottom)):
        assert f"{key}:{int(value):5}\r".encode() in head


@given(st.lists(st.tuples(st.integers(-121, 121), st.integers(-121, 121)), min_size=1))
def test_the_records_of_dst_are_those_of_another_writer(moves: list[tuple[int, int]]) -> None:
    """Each displacement can be written in one way only."""
    from pystitch.DstWriter import encode_record

    content = dst_bytes(np.array(moves), np.ones(len(moves), dtype=np.int64), {}, "x")
    theirs = b"".join(encode_record(x, -y, pystitch.STITCH) for x, y in moves)
    assert content[512:] == theirs + b"\x00\x00\xf3"


def test_a_u01_has_its_marks_needles_and_stitches(tmp_path: Path) -> None:
    """Marks stand before their move, and split no stitch into travel."""
    numbers = random.Random(3)
    units = np.array([[0, 0], *([numbers.randint(-165, 165) for _ in "XY"] for _ in range(60))])
    sewn = np.ones(len(units), dtype=np.int64)
    sewn[30] = 0
    events = {0: ["colour"], 10: ["slow"], 20: ["fast"], 30: ["trim", "colour"], 50: ["stop"]}
    file = tmp_path / "a.u01"
    file.write_bytes(u01_bytes(units, sewn, events))
    places = np.cumsum(units, axis=0)
    job = read_job(file, MACHINE)
    found = [(item[0], item[1]) for item in items_of(job) if not isinstance(item, str)]
    kept = [tuple(at) for at, needle in zip(places.tolist(), sewn, strict=True) if needle]
    assert [at for at, stitch in found if stitch] == kept
    assert [n for n in items_of(job) if isinstance(n, str)] == [
        "colour", "slow", "fast", "trim", "colour", "stop",
    ]  # fmt: skip
    items = items_of(job)
    assert items[items.index("slow") - 1][0] == tuple(places[9].tolist())
    assert items[items.index("fast") - 1][0] == tuple(places[19].tolist())


def test_the_marks_of_a_design_follow_its_planned_speeds(
    short_and_long: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.u01"
    with pytest.raises(SystemExit) as left:
        main(["compile", str(short_and_long), "-m", "schiffli-frame", "--target", "u01",
              "-o", str(out)])  # fmt: skip
    assert not left.value.code
    output = capsys.readouterr().out
    plan = plan_job(open_job(short_and_long, MACHINE, Options()), MACHINE, Options()).stitched
    slow, facts = two_speeds(plan.turns.turn_s)
    assert facts[0] in output
    assert 0 < slow.sum() < len(slow)
    paces, now = [], False
    for item in items_of(read_job(out, MACHINE)):
        if isinstance(item, str):
            now = {"slow": True, "fast": False}.get(item, now)
        else:
            paces.append(now)
    assert paces == slow.tolist()


def test_no_other_pair_of_speeds_is_sooner() -> None:
    """Every threshold is tried, one by one."""
    times = np.random.default_rng(1).uniform(0.4, 0.9, 200)
    slow, _ = two_speeds(times)
    mine = slow.sum() * times.max() + (~slow).sum() * times[~slow].max()
    every = [(times > t).sum() * times.max() + (times <= t).sum() * t for t in times]
    assert mine == pytest.approx(min(every), rel=1e-12)
    assert not two_speeds(np.full(5, 0.5))[0].any()


def test_a_machine_with_y_before_x_writes_the_same_design(
    short_and_long: Path, tmp_path: Path
) -> None:
    """The T15 card of such a machine was mirrored at the diagonal."""
    text = library_file("schiffli-frame").read_text(encoding="utf-8")
    x, y = text.index("[axes.X]"), text.index("[axes.Y]")
    end = text.index("\n[", y) + 1
    file = tmp_path / "turned.toml"
    file.write_text(text[:x] + text[y:end] + text[x:y] + text[end:])
    turned = load_machine(str(file))
    for suffix in ("dst", "t15"):
        a = compiled(short_and_long, tmp_path / f"a.{suffix}")
        b = compiled(short_and_long, tmp_path / f"b.{suffix}", turned)
        sewn = [[m[:2] for m in items_of(read_job(f, MACHINE)) if m[1:] and m[1]] for f in (a, b)]
        assert sewn[0] == sewn[1] and len(sewn[0]) >= 60


def test_dst_warns_of_events_that_the_format_lacks(tmp_path: Path) -> None:
    file = tmp_path / "a.u01"
    events = {2: ["slow"], 4: ["fast", "stop"]}
    file.write_bytes(u01_bytes(np.full((6, 2), 20), np.ones(6, dtype=np.int64), events))
    plan = plan_job(open_job(file, MACHINE, Options()), MACHINE, Options())
    (written,) = write(plan, "dst", tmp_path / "a.dst")
    assert "1 are written as thread changes" in written.warnings[0]
    assert "2 are left out" in written.warnings[1]


def test_a_design_that_reads_back_otherwise_is_not_written(
    short_and_long: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from threadline.commands import step_files

    def wrong(units, *more):
        return dst_bytes(units + 1, *more)

    monkeypatch.setattr(step_files, "dst_bytes", wrong)
    out = tmp_path / "a.dst"
    with pytest.raises(PlanError, match="reads back from DST with other stitches"):
        compiled(short_and_long, out)
    assert not out.exists()
