"""The verdict as JSON and as a table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline import __version__
from threadline.errors import SpecError
from threadline.files import ChannelKind
from threadline.jobs import read_job
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.verdict import (
    Criterion,
    Result,
    Status,
    Verdict,
    closing,
    criteria_json,
    judge,
    load_spec,
    step_rows,
    verdict_json,
    verdict_rows,
)
from threadline.verdict.rendering import shown
from threadline.verdict.types import OverTolerances

from .builders import follow, plan_through, record, spec_of, winder


def a_verdict():
    points = [[0.0, 0.0], [0.05, 0.0], [0.05, 0.05]]
    commanded, operation = follow(points, 40)
    channels = {
        ChannelKind.COMMANDED: commanded,
        ChannelKind.LOAD: commanded + np.array([0.0, 6e-4]),
    }
    plan = plan_through(points, move_s=0.2, historical=True)
    recording = record(("X", "Y"), channels, operation)
    return judge([recording], plan, load_spec(None, plan.machine)), plan


def test_json_has_the_keys_of_the_design_and_finite_numbers_only() -> None:
    verdict, plan = a_verdict()
    content = verdict_json(verdict, plan)
    text = json.dumps(content, allow_nan=False)  # the parser refuses infinities
    assert json.loads(text) == content
    assert {
        "job", "machine", "interpolation", "passed", "duration_s", "ticks", "criteria",
        "job_sha256", "machine_sha256", "threadline",
    } <= set(content)  # fmt: skip
    assert content["passed"] is False
    assert content["duration_s"] == pytest.approx(0.4)
    assert content["ticks"] == 80
    assert content["threadline"] == __version__
    for criterion in content["criteria"]:
        assert {
            "name", "axis", "measured", "limit", "unit", "status", "time_s", "job_line",
        } <= set(criterion)  # fmt: skip
    contour = next(c for c in content["criteria"] if c["name"] == "contour_error")
    assert contour["measured"] == pytest.approx(6e-4, abs=1e-12)
    assert contour["limit"] == 5e-4
    assert contour["status"] == "failed"
    settling = next(c for c in content["criteria"] if c["name"] == "settling_time")
    assert settling["measured"] is None  # the load never settles, and JSON has no infinity
    assert "not settled" in settling["note"]


def test_the_order_is_that_of_the_specification() -> None:
    verdict, plan = a_verdict()
    names = list(dict.fromkeys(r.name for r in verdict.results))
    spec = load_spec(None, plan.machine)
    assert names == list(dict.fromkeys(c.name for c in spec.criteria))


def test_rows_show_the_worst_axis_in_millimetres() -> None:
    verdict, _ = a_verdict()
    header, rows = verdict_rows(verdict)
    assert all(len(row) == len(header) for row in rows)
    turning = next(row for row in rows if row[0] == "turning_point_error")
    assert turning[1:5] == ["Y", "0.6 mm", "0.5 mm", "failed"]
    _, every = verdict_rows(verdict, every_axis=True)
    assert len([row for row in every if row[0] == "turning_point_error"]) == 2


def test_people_read_the_room_left_and_degrees() -> None:
    """A motion 50 mm inside its travel exceeds it by nothing; pi rad/s^2 are 180 deg/s^2."""
    inside = Result(
        name="travel", axis="Y", measured=-0.05, limit=0.0, unit="m", status=Status.PASSED,
        note="room left",
    )  # fmt: skip
    outside = replace(inside, measured=0.002, status=Status.FAILED, note="beyond")
    fast = replace(inside, name="acceleration", axis="A", measured=np.pi, unit="rad/s^2", note="")
    _, rows = verdict_rows(Verdict(results=(inside,), simulated=True))
    assert (rows[0][2], rows[0][3], rows[0][-1]) == ("0 mm", "0 mm", "50 mm of travel left")
    _, rows = verdict_rows(Verdict(results=(outside, fast), simulated=True))
    assert (rows[0][2], rows[0][-1]) == ("2 mm", "beyond")
    assert rows[1][2] == "180 deg/s^2"


def test_rounding_is_shown_as_nothing_and_kept_in_json() -> None:
    """Values below 1 nm, 1 ns, 1e-9 of a whole or of a limit are shown as 0, unless they fail."""
    noise = Result(
        name="contour_error", axis="", measured=4.3e-19, limit=5e-4, unit="m", status=Status.PASSED
    )
    shares = replace(noise, name="stitch_length_error", measured=3.55e-15, unit="")
    times = replace(noise, name="switching_error", measured=-2.1e-16, unit="s", limit=None)
    jerk = replace(noise, name="jerk", measured=4e-7, unit="m/s^3", limit=500.0)
    small = replace(noise, name="path_deviation", measured=2e-9)
    beyond = replace(noise, name="travel", measured=3e-12, limit=0.0, status=Status.FAILED)
    room = replace(noise, name="room", measured=1e-12, step="home", axis="X")
    shown = Verdict(results=(noise, shares, times, jerk, small, beyond, room), simulated=True)
    measured = [row[2] for row in verdict_rows(shown)[1]]
    assert measured == ["0 mm", "0 %", "0 ms", "0 m/s^3", "2e-06 mm", "3e-09 mm", "0 mm"]
    assert step_rows(shown)[1] == [["home", "0 mm"]]
    assert criteria_json(shown)[0]["measured"] == 4.3e-19


def test_row_shows_the_worst_measured_value_beside_missing_ones() -> None:
    """The worst measured value is shown, with the number of missing ones if these are required."""
    small = Result(
        name="residual_vibration", axis="X", step="home", measured=2e-5, limit=1e-4, unit="m",
        status=Status.PASSED,
    )  # fmt: skip
    large = replace(small, step="across", measured=8e-5)
    absent = replace(
        small, step="cut", measured=None, status=Status.NOT_MEASURED, note="too soon to see"
    )
    _, rows = verdict_rows(Verdict(results=(small, absent, large), simulated=True))
    (row,) = rows
    assert row[:5] == ["residual_vibration", "X", "0.08 mm", "0.1 mm", "passed"]
    assert row[-1] == "across: 1 of 3 not measured (X cut: too soon to see)"
    must = replace(absent, required=True)
    _, rows = verdict_rows(Verdict(results=(small, must, large), simulated=True))
    assert [row[2] for row in rows] == ["0.08 mm", "-"]
    assert rows[1][4] == "not-measured (required)"
    _, rows = verdict_rows(Verdict(results=(absent,), simulated=True))
    assert [row[4] for row in rows] == ["not-measured"]


def test_the_line_of_a_subroutine_says_the_pass(tmp_path: Path) -> None:
    """The third of four strokes of 10 mm is missed by 1 mm."""
    program = tmp_path / "passes.prg"
    program.write_text("O9\nG91 G1 X 10 F 600\nM99\nO1\nM98 P9 L4\nG90 G1 X 0\nM30\n")
    machine = winder()
    plan = plan_job(read_job(program, machine), machine, Options(interpolation="linear"))
    commanded, operation = [], []
    for block in plan.commands:
        commanded.append(block.counts)
        operation.append(block.operation)
    position = np.cumsum(np.concatenate(commanded), axis=0) / plan.commands.counts_per_unit
    rows = np.concatenate(operation)
    third = np.flatnonzero(rows == 2)
    position[third[len(third) // 2], 2] += 1e-3
    made = record(plan.commands.axes, {ChannelKind.LOAD: position}, rows, job_sha256="")
    verdict = judge([made], plan, spec_of(Criterion(name="contour_error"), lag_s=0.0))

    found = verdict.result("contour_error")
    assert found.measured == pytest.approx(1e-3, abs=1e-6)
    assert (found.job_line, found.passes) == (2, (3,))
    header, (row, *_) = verdict_rows(verdict)
    assert row[header.index("line")] == "2 (pass 3)"
    assert verdict_json(verdict, plan)["criteria"][0]["passes"] == [3]


def result(status, measured=1.0, limit=None, required=False, axis="X"):
    return Result(
        name="n", axis=axis, measured=measured, limit=limit, unit="m", status=status,
        required=required,
    )  # fmt: skip


def test_passed_needs_no_failure_and_everything_required() -> None:
    absent = result(Status.NOT_MEASURED, None)
    required = result(Status.NOT_MEASURED, None, required=True)
    fine, wrong = result(Status.PASSED, 1.0, 2.0), result(Status.FAILED, 3.0, 2.0)
    assert Verdict(results=(fine, absent, result(Status.REPORTED)), simulated=True).passed
    assert not Verdict(results=(fine, required), simulated=True).passed
    assert not Verdict(results=(fine, wrong), simulated=True).passed


def test_without_an_axis_the_worst_is_returned() -> None:
    a = result(Status.PASSED, 1.0, 2.0, axis="A")
    b = result(Status.FAILED, 3.0, 2.5, axis="B")
    c = result(Status.PASSED, 1.9, 2.0, axis="C")
    assert Verdict(results=(a, b, c), simulated=True).result("n") is b
    assert Verdict(results=(a, c), simulated=True).result("n") is c
    assert Verdict(results=(a, b, c), simulated=True).result("n", "A") is a
    with pytest.raises(KeyError):
        Verdict(results=(a,), simulated=True).result("m")


def test_an_unknown_measure_is_named_with_the_nearest() -> None:
    points = [[0.0], [0.1]]
    commanded, operation = follow(points, 20)
    recording = record(("X",), {ChannelKind.LOAD: commanded}, operation)
    with pytest.raises(SpecError, match="Did you mean 'contour_error'"):
        judge([recording], plan_through(points, ("X",)), spec_of(Criterion(name="contuor_error")))


def test_a_verdict_says_its_level_and_how_narrowly_it_passed() -> None:
    """Shares are rounded up, so that 96.2 % does not read as less; hard limits show 100 %."""

    def of(name: str, measured: float, limit: float | None, *, hard: bool = False) -> Result:
        status = Status.PASSED if limit else Status.REPORTED
        return Result(
            name=name, axis="", measured=measured, limit=limit, unit="m", status=status, hard=hard
        )

    results = (of("velocity", 1.0, 1.0, hard=True), of("a", 0.4811, 0.5), of("b", 9.0, None))
    once = Verdict(results=results, simulated=True)
    often = Verdict(results=results, simulated=True, runs=20)
    assert closing(once) == "IN SPEC (nominal: 1 run; 97 % of a used)"
    assert closing(often) == "IN SPEC (repeated: 20 runs; 97 % of a used)"
    assert Verdict(results=results, simulated=True, runs=19).level == "nominal"
    assert Verdict(results=results[2:], simulated=True).tightest is None


def test_a_verdict_without_a_limit_of_the_specification_says_that_limits_are_kept() -> None:
    """Only the machine's own limits were measured: that is less than being in spec."""

    def of(name: str, limit: float | None, *, hard: bool = False, measured: bool = True) -> Result:
        passed = Status.PASSED if limit else Status.REPORTED
        return Result(
            name=name, axis="", measured=0.5 if measured else None, limit=limit, unit="m",
            status=passed if measured else Status.NOT_MEASURED, hard=hard,
        )  # fmt: skip

    own = of("velocity", 1.0, hard=True)
    bare = Verdict(results=(own, of("a", None)), simulated=True)
    assert bare.passed and not bare.answers
    assert closing(bare) == ("LIMITS KEPT (nominal: 1 run; the specification sets no other limit)")
    unknown = Verdict(results=(own, of("a", 1.0, measured=False)), simulated=True)
    assert closing(unknown) == (
        "LIMITS KEPT (nominal: 1 run; a was not measured; 1 criterion not measured)"
    )
    asked = Verdict(results=(own, of("a", 1.0)), simulated=True)
    assert closing(asked) == "IN SPEC (nominal: 1 run; 50 % of a used)"


@pytest.mark.parametrize(("measured", "limit"), [(np.inf, 1e-3), (1.0, 5e-324)])
def test_measurement_without_a_finite_share_of_its_limit_is_put_in_words(
    measured: float, limit: float
) -> None:
    """A machine that never settles, and a limit of almost 0: no share of it is a number."""
    failed = Result(
        name="settling_time", axis="", measured=measured, limit=limit, unit="s",
        status=Status.FAILED,
    )  # fmt: skip
    assert closing(Verdict(results=(failed,), simulated=True)) == (
        "OUT OF SPEC (nominal: 1 run; settling_time is beyond any multiple of its limit)"
    )


def test_more_than_ten_times_a_limit_is_told_as_that_and_no_more() -> None:
    """A share of millions of per cent means nothing; the value itself stands in its row."""

    def closed(measured: float) -> str:
        failed = Result(
            name="contour_error", axis="", measured=measured, limit=5e-4, unit="m",
            status=Status.FAILED,
        )  # fmt: skip
        return closing(Verdict(results=(failed,), simulated=True))

    assert closed(56.07) == ("OUT OF SPEC (nominal: 1 run; more than 1000 % of contour_error used)")
    assert closed(5e-3) == "OUT OF SPEC (nominal: 1 run; 1000 % of contour_error used)"


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.981, "99 %"), (0.99, "99 %"), (0.9911, "99.2 %"), (0.9989, "99.9 %"),
        (0.99999, "100.0 %"), (1.0, "100 %"), (1.0004, "101 %"),
    ],
)  # fmt: skip
def test_a_result_just_within_its_limit_is_told_to_a_tenth_of_a_per_cent(
    share: float, words: str
) -> None:
    """In whole per cent, rounded up, 99.2 % of a limit would read as all of it."""
    status = Status.PASSED if share <= 1.0 else Status.FAILED
    one = Result(name="a", axis="", measured=share, limit=1.0, unit="m", status=status)
    word = "IN SPEC" if share <= 1.0 else "OUT OF SPEC"
    assert closing(Verdict(results=(one,), simulated=True)) == (
        f"{word} (nominal: 1 run; {words} of a used)"
    )
    worst = OverTolerances(
        criterion="a", share=share, searched=9, drawn=0, passed=0, least=0.0, confidence=0.99
    )
    over = Verdict(results=(one,), simulated=True, tolerances=worst)
    assert f"the worst of 9 machines searched uses {words} of a" in closing(over)


def test_axes_that_never_move_have_no_rows_of_zeros() -> None:
    """Their results stay; so do failures, and every row if nothing moves at all."""
    at_rest = Result(
        name="velocity", axis="A", measured=0.0, limit=1.0, unit="rad/s", status=Status.PASSED
    )
    lag = Result(
        name="tracking_error",
        axis="A",
        measured=0.0,
        limit=None,
        unit="rad",
        status=Status.REPORTED,
    )
    moves = Result(
        name="velocity", axis="X", measured=0.1, limit=1.0, unit="m/s", status=Status.PASSED
    )
    fails = Result(
        name="travel", axis="A", measured=0.0, limit=0.0, unit="rad", status=Status.FAILED
    )

    def rows(*results: Result) -> list[str]:
        return [row[1] for row in verdict_rows(Verdict(results=results, simulated=True))[1]]

    assert rows(at_rest, lag, moves) == ["X"]
    assert rows(at_rest, lag, moves, fails) == ["X", "A"]
    room = replace(fails, status=Status.PASSED, measured=-0.05)
    shaken = replace(lag, measured=1e-4)
    assert rows(at_rest, lag, moves, room) == ["X"]
    assert rows(at_rest, shaken, moves) == ["A", "X"]
    assert rows(at_rest, lag) == ["A", "A"]
    every = verdict_rows(Verdict(results=(at_rest, moves), simulated=True), every_axis=True)[1]
    assert len(every) == 2


def test_a_step_without_a_result_has_a_dash_and_one_that_failed_to_be_measured_says_so() -> None:
    def of(step: str, name: str, measured: float | None, status: Status) -> Result:
        return Result(
            name=name, axis="Z", measured=measured, limit=0.1, unit="s", status=status, step=step
        )

    results = (
        of("down", "settling_time", 0.05, Status.PASSED),
        of("down", "cycle_time", 0.2, Status.FAILED),
        of("grip", "settling_time", None, Status.NOT_MEASURED),
    )
    header, rows = step_rows(Verdict(results=results, simulated=True))
    assert header == ["step", "settling_time Z", "cycle_time Z"]
    assert [row[0] for row in rows] == ["down", "grip"]
    assert rows[0][2].endswith(" (failed)") and not rows[0][1].endswith(" (failed)")
    assert rows[1][1:] == ["not measured", "-"]


@pytest.mark.parametrize(
    ("share", "message"), [(0.0, "0 %"), (0.0209, "2.09 %"), (1.0, "100 %"), (12.53, "1250 %")]
)
def test_shares_are_written_without_powers_of_ten(share: float, message: str) -> None:
    assert shown(share, "") == message
