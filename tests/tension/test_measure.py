"""The criterion ``tension_variation``: its value, its place, and its inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.errors import MachineError, Place, RecordingError
from threadline.files import ChannelKind, Recording, RecordingBlock
from threadline.files.formats.common import parse_column
from threadline.machine import load_machine
from threadline.machine.variants import uncertain
from threadline.proof.pipeline import Trials, prove_plan, with_product
from threadline.proof.request import options_of
from threadline.report.figures import tension_figure
from threadline.verdict import Spec, judge, load_spec
from threadline.verdict.types import Result, Status


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Spec:
    file = tmp_path_factory.mktemp("spec") / "t.spec.toml"
    file.write_text('name = "t"\n[[criteria]]\nname = "tension_variation"\nlimit = "5 %"\n')
    return load_spec(file, load_machine("lathe-winder+spool"))


def with_tension(
    recording: Recording, change: Callable[[np.ndarray, int], np.ndarray]
) -> Recording:
    """Return a recording with another tension, and the tick of its first sample."""
    blocks: list[RecordingBlock] = []
    for block in recording.blocks:
        first = next(iter(block.first_tick.values()))
        own = change(block.samples["tension"].copy(), first)
        blocks.append(replace(block, samples={**block.samples, "tension": own}))
    return replace(recording, blocks=tuple(blocks))


def measured(recording: Recording, plan: Plan, spec: Spec) -> Result:
    (found,) = (r for r in judge([recording], plan, spec).results if r.name == "tension_variation")
    return found


def test_tension_measure_is_the_largest_deviation_from_the_mean(
    plan: Plan, whole: Recording, spec: Spec
) -> None:
    tick, even, peak = 1700, 8.0, 8.9

    def one_peak(values: np.ndarray, first: int) -> np.ndarray:
        values[:] = even
        if 0 <= tick - first < len(values):
            values[tick - first] = peak
        return values

    found = measured(with_tension(whole, one_peak), plan, spec)
    assert found.measured == pytest.approx(peak / even - 1.0, abs=1e-4)
    assert found.status is Status.FAILED
    operation = int(whole.samples("operation")[1][tick])
    assert found.job_line == plan.intent.lines_of(plan.job, [operation])[operation]
    assert found.time_s == pytest.approx(5e-3 * tick)
    assert "least 8 N, most 8.9 N" in found.note


@pytest.mark.parametrize("at", [10, 3700])
def test_tension_outside_the_laid_fibre_is_not_judged(
    plan: Plan, whole: Recording, spec: Spec, at: int
) -> None:
    """Tick 10 is the approach; at tick 3640 the motion has ended, and the fibre rests."""
    last = len(whole.samples("tension")[1])

    def one_peak(values: np.ndarray, first: int) -> np.ndarray:
        values[:] = 8.0
        tick = min(at, last - 5)
        if 0 <= tick - first < len(values):
            values[tick - first] = 2.0
        return values

    found = measured(with_tension(whole, one_peak), plan, spec)
    assert found.measured == pytest.approx(0.0, abs=1e-12)


def test_a_rest_between_counts(plan: Plan, whole: Recording, spec: Spec) -> None:
    """The simulated tension itself: the extremes of the counting samples, and their mean."""
    found = measured(whole, plan, spec)
    _times, tension = whole.samples("tension")
    assert found.measured is not None and found.time_s is not None
    mean = float(found.note.partition("mean ")[2].partition(" N")[0])
    at = round(found.time_s / 5e-3)
    assert abs(tension[at] / mean - 1.0) == pytest.approx(found.measured, rel=5e-3)
    assert 0.005 < found.measured < 0.05 and found.status is Status.PASSED


def test_without_the_channel_it_is_not_measured(plan: Plan, whole: Recording, spec: Spec) -> None:
    channels = tuple(c for c in whole.channels if c.kind is not ChannelKind.TENSION)
    for simulated in (True, False):
        found = measured(replace(whole, channels=channels, simulated=simulated), plan, spec)
        assert found.status is Status.NOT_MEASURED
        assert 'a column "tension" gives it' in found.note


def test_a_channel_that_ends_early_is_not_measured(
    plan: Plan, whole: Recording, spec: Spec
) -> None:
    """A sensor that falls silent in the middle of the winding has not measured the rest."""

    def ends(values: np.ndarray, first: int) -> np.ndarray:
        values[:] = 8.0
        return values[: max(1700 - first, 0)]

    found = measured(with_tension(whole, ends), plan, spec)
    assert found.status is Status.NOT_MEASURED
    assert "no samples for part of the winding, from 8.5 s on" in found.note


def test_a_number_that_is_none_is_refused(plan: Plan, whole: Recording, spec: Spec) -> None:
    for wrong in (np.nan, np.inf):

        def one(values: np.ndarray, first: int, wrong: float = wrong) -> np.ndarray:
            if 0 <= 1700 - first < len(values):
                values[1700 - first] = wrong
            return values

        with pytest.raises(RecordingError, match="tension"):
            measured(with_tension(whole, one), plan, spec)


def test_a_trace_from_anywhere_has_it_in_newtons() -> None:
    place = Place("t.csv", 1)
    column = parse_column("tension [N]", place)
    assert (column.name, column.kind, column.unit) == ("tension", ChannelKind.TENSION, "N")
    assert parse_column("tension [kN]", place).factor == 1000.0
    for wrong in ("tension [mm]", "tension", "X.tension [N]"):
        with pytest.raises(RecordingError):
            parse_column(wrong, place)


def test_a_machine_with_a_spool_asks_for_five_percent(plan: Plan, spec: Spec) -> None:
    product = plan.options["product"]
    own = Spec(name="own", criteria=(), lag_s=0.1)
    for name, limit in (("lathe-winder", None), ("lathe-winder+spool", 0.05)):
        asked = with_product(own, load_machine(name), options_of(product=product))
        found = {c.name: c.limit for c in asked.criteria}
        assert found.get("tension_variation") == limit
        assert found["slack"] == 0.05  # take_up of the product: 50 mm


def test_numbers_of_the_spool_vary_over_tolerances_and_runs(plan: Plan, spec: Spec) -> None:
    names = {number for one in uncertain(plan.machine) for number in one.numbers}
    assert {"spool.torque", "spool.radius", "spool.friction", "spool.arm.stiffness"} <= names
    proof = prove_plan(plan, spec, trials=Trials(repeats=3))
    (recording,) = proof.judged
    tension = recording.samples("tension")[1]
    assert tension.shape[1] == 3
    assert len({round(float(t), 6) for t in tension[2000]}) == 3
    (found,) = (r for r in proof.verdict.results if r.name == "tension_variation")
    assert found.measured is not None and found.measured > 0.005


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[tool]\nkind = "none"', ""),
        ('[spool]\nstiction = "0.1 N m exact, assumed"', "stiction, 0.1 N m, is below torque"),
        ('[spool]\nradius = "-60 mm exact, assumed"', "radius"),
        ('[spool.arm]\ntravel = "0 mm exact, assumed"', "travel"),
        ('[spool]\nbrake = "0.1 N m exact, assumed"', "brake"),
    ],
)
def test_a_wrong_spool_is_refused_by_file_and_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "mine.toml"
    if not message:
        file.write_text('base = "stitcher"\nname = "mine"\n' + _SPOOL)
        message = "spool: its fibre needs the eye of a winder"
    else:
        file.write_text(f'base = "lathe-winder+spool"\nname = "mine"\n{text}\n')
    with pytest.raises(MachineError) as refused:
        load_machine(str(file))
    assert message in str(refused.value)
    assert "mine.toml" in str(refused.value)


def test_drives_that_take_positions_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('base = "stepper-winder+xyca"\nname = "mine"\n' + _SPOOL)
    with pytest.raises(MachineError, match=r"spool: the tension is simulated on axes with control"):
        load_machine(str(file))


_SPOOL = """[spool]
radius = "60 mm exact, assumed"
inertia = "3.6e-3 kg m^2 exact, assumed"
torque = "0.43 N m exact, assumed"
stiffness = "6 kN/m exact, assumed"
[spool.arm]
mass = "0.15 kg exact, assumed"
stiffness = "120 N/m exact, assumed"
preload = "8.4 N exact, assumed"
travel = "100 mm exact, assumed"
"""


def test_the_report_draws_it_with_its_worst_place(plan: Plan, whole: Recording, spec: Spec) -> None:
    verdict = judge([whole], plan, spec)
    figure = tension_figure(verdict, whole)
    assert figure is not None
    (panel,) = figure.axes
    drawn = panel.collections[0].get_paths()[0].vertices[:, 1]
    tension = whole.samples_of(["tension"])["tension"][1]
    assert (drawn.min(), drawn.max()) == (tension.min(), tension.max())
    worst = verdict.result("tension_variation")
    (line,) = panel.lines
    assert line.get_xdata()[0] == worst.time_s
    assert (
        f"{100.0 * worst.measured:.3g} % off the mean at line {worst.job_line}" in line.get_label()
    )

    others = tuple(one for one in whole.channels if one.kind is not ChannelKind.TENSION)
    assert tension_figure(verdict, replace(whole, channels=others)) is None
