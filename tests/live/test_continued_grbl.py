"""The rest of a job on a controller with grbl: the interrupted line and all later lines."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live.grbl_model import GrblModel
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import MACHINE, patient, settings
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.files import RunEnd, tick_table
from threadline.files.formats import read_recording
from threadline.live.continuing import continued_by
from threadline.live.grbl_program import rest_of_program, written_program
from threadline.live.links import link_of
from threadline.live.states import Cause, Desk
from threadline.live.supervised import Conduct
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

__all__ = ["patient"]
EXAMPLES = Path(__file__).parents[2] / "examples"
POINTS = [(40 * k, 20 * k + 15 * (k % 2)) for k in range(1, 9)]
LINES = "".join(f"A{a} X{x}\n" for a, x in POINTS)
LOST_MM = 100.0
UNITS = np.array([np.pi / 180.0, 1e-3])


class Loses(GrblModel):
    """A controller that loses link and power when X passes a place."""

    def _move(self, left_s: float) -> None:
        if self.at[0] > LOST_MM and self.client is not None:
            self.client.shutdown(2)
            self.over = True
        else:
            super()._move(left_s)


@cache
def helix() -> Plan:
    options = Options()
    return plan_job(open_job(EXAMPLES / "helix.gcode", MACHINE, options), MACHINE, options)


def run(
    model: GrblModel, capsys: pytest.CaptureFixture[str], job: Path, *words: str
) -> tuple[int, dict[str, Any]]:
    """Run a job by the command; return its exit status and its output."""
    model.start()
    with pytest.raises(SystemExit) as ended:
        main(["run", str(job), "-m", "stepper-winder", "--nominal", "--json", "--link",
              f"grbl:{model.address}", "--store", str(job.parent / "runs"), *words])  # fmt: skip
    model.close()
    output = capsys.readouterr().out
    return int(str(ended.value.code)), json.loads(output) if output else {}


def test_after_a_loss_of_power_it_is_approached_and_done_from_a_line_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = tmp_path / "zigzag.gcode"
    job.write_text(f"G21\nG90\nG1 F3000\n{LINES}M30\n", "utf-8")
    assert run(Loses(settings()), capsys, job)[0] == 3
    (first,) = (tmp_path / "runs").glob("*/trace.mcap")
    broken_off = read_recording(first)
    executed = int(broken_off.samples("operation")[1].max())
    assert executed > 0

    model = GrblModel(settings(), faster=2.0)
    joined = tmp_path / "joined.npz"
    status, output = run(
        model, capsys, job, "--continue", "last", "--confirmed", "--recording", str(joined)
    )
    assert (status, output["ended"]) == (1, "completed")  # it has no load: nothing is proven
    assert output["judged_with"] == [first.parent.name]
    np.testing.assert_allclose(model.at[[3, 0]], POINTS[-1], atol=1e-3)

    sent = bytes(model.heard).replace(b"?", b"").split(b"\n")
    jogs = [k for k, line in enumerate(sent) if line.startswith(b"$J=")]
    works = [k for k, line in enumerate(sent) if line[:1] in b"GAXM" and line and k > jogs[-1]]
    assert jogs, "it was approached first"
    assert sent[works[0]] == b"G21 G90 G94 G17"
    assert sent[works[1]].startswith(b"G1 F")
    whole = [line for line in written(job) if line[:1] in "AXGM"]
    assert len(works) - 2 < len(whole) - 2, "and not done whole"
    assert [sent[k].decode() for k in works[2:]] == whole[2 - len(works) :]
    kept = tmp_path / "runs" / output["run"] / "sent" / "program.nc"
    assert kept.read_bytes().splitlines() == [sent[k] for k in works]
    # The axes moved one by one to the begin of the lines, and stood there.
    begins = np.array(read_start(tmp_path, output["run"])) / UNITS
    moved = np.array(model.moved_to)[:, [3, 0]]
    there = np.flatnonzero(np.abs(moved - begins).max(axis=1) < 0.02)
    assert len(there)
    one_by_one = np.abs(np.diff(moved[: there[0]], axis=0)) > 1e-9
    assert not one_by_one.all(axis=1).any()

    recording = read_recording(joined)
    a, x = (
        recording.samples(f"{name}.commanded")[1] / k for name, k in zip("AX", UNITS, strict=True)
    )
    assert abs(x[0]) < 1e-9
    assert (a[-1], x[-1]) == (pytest.approx(POINTS[-1][0]), pytest.approx(POINTS[-1][1]))
    # A never turns back by more than one sample's motion: no motion is repeated.
    assert (np.diff(a) >= -3000.0 / 60.0 * 0.01).all()
    assert len(x) > len(read_recording(Path(output["trace"])).samples("X.commanded")[1])
    operations = recording.samples("operation")[1]
    assert set(operations[np.isfinite(operations)].astype(int)) >= set(range(1, len(POINTS)))


def written(job: Path) -> list[str]:
    """Return the lines of the whole job as they are sent."""
    options = Options()
    program, _ = written_program(plan_job(open_job(job, MACHINE, options), MACHINE, options))
    return [line.decode().strip() for line in program.lines]


def read_start(folder: Path, run_: str) -> list[float]:
    recording = read_recording(folder / "runs" / run_ / "trace.mcap")
    return [float(recording.samples(f"{axis}.commanded")[1][0]) for axis in "AX"]


def test_a_line_is_the_one_under_way_when_its_operation_began() -> None:
    """Plan times show that each line ends where the rows of the table are at that time."""
    plan = helix()
    program, _ = written_program(plan)
    table = tick_table(plan.commands)
    counts = np.concatenate([block.counts for block in table])
    of = np.concatenate([block.operation for block in table])
    places = np.vstack([np.zeros(2), counts.cumsum(axis=0)]) / MACHINE.counts_per_unit
    at = places[np.minimum(program.rows[1:], len(counts))]
    assert np.abs((at - program.ends[:-1]) * MACHINE.radius_m).max() < 2e-5  # a count, a chord
    for operation in range(int(of.max()) + 1):
        rest, lines = rest_of_program(program, plan, operation)
        began = int(np.flatnonzero(of == operation)[0])
        assert rest.left_out <= began + 1
        assert rest.operation == of[min(rest.left_out + 1, began)]
        assert lines.lines[-1] == program.lines[-1]
        np.testing.assert_allclose(lines.ends[-1], program.ends[-1])
        assert lines.rows[0] == 0
        assert rest.begins / MACHINE.counts_per_unit == pytest.approx(
            places[rest.left_out], abs=1e-4
        )
        assert lines.durations_s.sum() == pytest.approx(
            program.durations_s[-len(lines.lines) + 1 :].sum(), rel=0.05
        )


def test_a_spindle_that_ran_runs_again_before_anything_moves(tmp_path: Path) -> None:
    """The rest after M3 begins with M3, after M5 with M5, and before both with neither."""
    job = tmp_path / "spindle.gcode"
    job.write_text("G1 F3000\nA20 X10\nM3\nA40 X20\nM5\nA80 X40\nM30\n", "utf-8")
    options = Options(dialect="grbl")
    plan = plan_job(open_job(job, MACHINE, options), MACHINE, options)
    program, _ = written_program(plan)
    last = int(program.operations[-1])
    begins = [rest_of_program(program, plan, k)[1].lines for k in range(last + 1)]
    switched = [
        [line.strip() for line in lines[: next(k for k, one in enumerate(lines) if b"X" in one)]]
        for lines in begins
    ]
    assert {lines[-1] for lines in switched} == {b"G21 G90 G94 G17", b"M3", b"M5"}
    assert switched[0] == [b"G21 G90 G94 G17"]
    for lines, before in zip(begins, switched, strict=True):
        left = program.lines[-(len(lines) - len(before)) :]
        done = [line for line in program.lines[: -len(left)] if line in {b"M3\n", b"M5\n"}]
        assert before[-1:] == [line.strip() for line in done[-1:]] or not done


def _modes(lines: Iterable[bytes]) -> dict[str, bytes]:
    """Return the modes after some lines, from a small reader."""
    found = {"motion": b"G1", "spindle": b"M5", "power": b"", "coolant": b"M9"}
    for word in re.findall(rb"(?<![A-Z0-9])[GMS][0-9.]+", b" ".join(lines)):
        kind = {b"G0": "motion", b"G1": "motion", b"M8": "coolant", b"M9": "coolant"}.get(word)
        kind = "spindle" if word in {b"M3", b"M4", b"M5"} else kind
        kind = "power" if word[:1] == b"S" else kind
        if kind is not None:
            found[kind] = word
    return found


def test_the_rest_of_a_job_begins_in_the_modes_of_its_place(tmp_path: Path) -> None:
    """The rest begins with the modes of the whole program there: G0 or G1, laser, S and coolant.

    At a change of the tool the sender stops, and the zero is set only once.
    """
    job = tmp_path / "laser.gcode"
    job.write_text(
        "G92 X0 A0\nT1 M6\nM4 S0\nG0 X10 A20\nG1 X20 S300 F1200\nM8\nX25\nG0 X30\nG0 X40 A30\n"
        "G1 X50 S500\nM9\nX60\nM5\n",
        "utf-8",
    )
    options = Options(dialect="grbl")
    plan = plan_job(open_job(job, MACHINE, options), MACHINE, options)
    program, _ = written_program(plan)
    whole = list(program.lines)
    assert b"M0\n" in whole and not any(b"M6" in line for line in whole)
    met = set()
    for operation in range(int(program.operations[-1]) + 1):
        lines = list(rest_of_program(program, plan, operation)[1].lines)
        moves = next(n for n, line in enumerate(lines) if b"X" in line and b"G92" not in line)
        first = len(whole) - len(lines) + moves
        assert whole[first:] == lines[moves:]
        assert _modes(lines[: moves + 1]) == _modes(whole[: first + 1])
        assert first < 5 or not any(b"G92" in line for line in lines)
        met.add(tuple(_modes(whole[:first]).values()))
    assert len(met) >= 5


@pytest.mark.parametrize("answer", [False, None])
def test_nothing_is_sent_until_somebody_confirms(answer: bool | None) -> None:
    plan, looks = helix(), list[int]()
    model = GrblModel(settings())
    model.start()
    link = link_of(f"grbl:{model.address}", MACHINE, 1.0, None)
    desk, sink = Desk(), MemorySink()

    def confirmed() -> bool | None:
        looks.append(1)
        if answer is None and len(looks) == 3:
            desk.ask(Cause.STOP)
        return answer if len(looks) > 2 else None

    with closing(desk), closing(link):
        link.prepare(plan)
        again = continued_by(plan, link.rest(plan, 2, at_rest=False))
        assert again.approach
        ended = link.run(plan, desk, sink, Conduct(again=again, confirmed=confirmed))
    model.close()
    assert ended == (RunEnd.STOPPED, "nobody has confirmed that it may go on")
    assert len(looks) >= 3
    assert b"$J" not in model.heard
    assert b"G1" not in model.heard
