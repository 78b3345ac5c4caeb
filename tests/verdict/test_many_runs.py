"""Many runs side by side, compared with the judge of one run: same figures, places, lines.

The reference is the judge on a recording of one run; other tests in this folder compare its
measures with closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError, RecordingError
from threadline.files import ChannelKind, Recording, tick_table
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.numbers import with_numbers
from threadline.proof import judge_runs
from threadline.proof.judge_runs import RunsJudge
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.twin import fastest_rates, simulate, simulate_runs
from threadline.verdict import Criterion, Judge, Spec, judge, load_spec
from threadline.verdict.measure import MeasureKind, OfPlan, RunReading
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Setting, lanes, together

EXAMPLES = Path(__file__).parents[2] / "examples"
WITHIN = 1e-12
"""Of metres, amperes, seconds: sums of squares are the only figures that round at all."""


def winder() -> tuple[Plan, Spec]:
    machine = load_machine("lathe-winder")
    plan = plan_job(read_job(EXAMPLES / "x-180.prg", machine), machine, Options())
    return plan, load_spec(None, machine)


def stitcher() -> tuple[Plan, Spec]:
    """Return the plan of the thesis's redesign, so fast that the original motors saturate."""
    machine = load_machine("stitcher")
    seam = EXAMPLES / "stitcher-test-path.seam.toml"
    job = read_job(seam, machine, needle_speed="60 stitch/s")
    return plan_job(job, machine, Options()), load_spec(None, machine)


def drawn(plan: Plan, count: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    random = np.random.default_rng(3)
    machine = plan.machine
    numbers = {
        f"bodies.{name}.inertia": body.inertia.si * random.uniform(0.9, 1.1, count)
        for name, body in machine.bodies.items()
    }
    return numbers, random.random((count, len(machine.axes)))


def with_every_measure(plan: Plan, spec: Spec) -> Spec:
    """Add every criterion of the registry for such a plan that the specification does not name."""
    have = {criterion.name for criterion in spec.criteria}
    names = [
        name
        for name, kind in MEASURES.items()
        if kind.of_plan(plan) is not None or any(r.run is Setting for r in runs_of(kind))
    ]
    more = tuple(Criterion(name=name) for name in names if name not in have)
    return replace(spec, criteria=(*spec.criteria, *more))


def runs_of(kind: MeasureKind) -> list[RunReading]:
    return [reading for reading in kind.reads if not isinstance(reading, OfPlan)]


@pytest.mark.parametrize("made", [winder, stitcher])
def test_every_run_has_the_figures_that_it_has_alone(made) -> None:
    plan, spec = made()
    spec = with_every_measure(plan, spec)
    numbers, phases = drawn(plan, 19)
    found = RunsJudge(plan, spec, threads=1).judged(numbers, phases)
    recordings = []
    for run in range(19):
        own = {path: float(values[run]) for path, values in numbers.items()}
        machine = with_numbers(plan.machine, own)
        table = tick_table(plan.commands)
        recordings.append(simulate(table, machine, encoder_phase=phases[run]))
    names = {row.name for row in found.rows}
    assert "repeatability" not in names
    for run in (0, 7, 18):
        verdict = Judge(plan, spec).verdict([recordings[run]])
        assert bool(found.passed[run]) == verdict.passed
        for result in verdict.results:
            if result.name == "repeatability":
                continue
            value = found.row(result.name, result.axis).values[run]
            if result.measured is None:
                assert np.isnan(value)
            else:
                assert value == pytest.approx(result.measured, rel=WITHIN, abs=WITHIN)
    for row in found.rows:
        assert len(row.values) == 19
    assert np.ptp(found.row("contour_error").values) > 1e-6
    measured = {row.name for row in found.rows if not np.isnan(row.values).all()}
    assert {"progress_error", "velocity_ripple", "residual_vibration", "current_peak"} < measured
    if made is stitcher:
        assert {"seam_error", "stitches_to_speed", "stitch_speed_error"} < measured
    # Side by side in one recording they are the same as one after the other, places included.
    together = Judge(plan, spec).verdict([simulate_runs(tick_table(plan.commands),
        Values.of(plan.machine, numbers), encoder_phase=phases)])  # fmt: skip
    apart = Judge(plan, spec).verdict(recordings)
    assert together.runs == apart.runs == 19
    assert together.passed == apart.passed
    for mine, theirs in zip(together.results, apart.results, strict=True):
        if mine.measured is None:
            assert (mine.name, mine.note, mine.status) == (theirs.name, theirs.note, theirs.status)
            continue
        assert mine.measured == pytest.approx(theirs.measured, rel=WITHIN, abs=WITHIN)
        assert replace(mine, measured=None) == replace(theirs, measured=None)


def of_several(kinds: tuple[ChannelKind, ...], columns: int | None = None) -> Recording:
    """Return three runs side by side; channels of ``kinds`` are given once, or with ``columns``."""
    machine = load_machine("lathe-winder")
    plan = plan_job(read_job(EXAMPLES / "x-180.prg", machine), machine, Options())
    one = simulate(tick_table(plan.commands), machine)
    given = {c.name for c in one.channels if c.kind in kinds}
    alike = {ChannelKind.COMMANDED, ChannelKind.OPERATION, ChannelKind.OUTPUT}
    channels = {c.name for c in one.channels if c.kind in alike}
    blocks = []
    for block in one:
        samples = {}
        for name, values in block.samples.items():
            count = columns if name in given else 3
            once = name in channels or count is None
            samples[name] = values if once else np.repeat(values[:, None], count, axis=1)
        blocks.append(replace(block, samples=samples))
    return replace(one, blocks=blocks, runs=3)


@pytest.mark.parametrize(
    "kinds", [(ChannelKind.LOAD,), (ChannelKind.LOAD, ChannelKind.INPUT), tuple(ChannelKind)]
)
def test_a_channel_that_all_runs_share_counts_for_each(kinds) -> None:
    plan, spec = winder()
    apart = judge([of_several(())], plan, spec)
    shared = judge([of_several(kinds)], plan, spec)
    assert shared.runs == 3
    assert [r.measured for r in shared.results] == [r.measured for r in apart.results]


def test_another_number_of_columns_than_of_runs_is_refused() -> None:
    plan, spec = winder()
    with pytest.raises(RecordingError, match=r"'A\.load' has samples of shape .*holds 3 runs"):
        judge([of_several((ChannelKind.LOAD,), columns=2)], plan, spec)


def test_any_part_and_any_thread_gives_the_same(monkeypatch) -> None:
    """Threads agree to the bit, parts to 1e-12: a part's fastest variant sets its time steps."""
    plan, spec = winder()
    numbers, phases = drawn(plan, 40)
    whole = RunsJudge(plan, spec, threads=1).judged(numbers, phases)
    monkeypatch.setattr(judge_runs, "AT_ONCE", 7)
    parts: list[float] = []
    cut = RunsJudge(plan, spec, threads=3).judged(numbers, phases, parts.append)
    assert sum(parts) == pytest.approx(40.0) and len(parts) >= 6 and min(parts) >= 0.0
    single = RunsJudge(plan, spec, threads=1).judged(numbers, phases)
    for mine, theirs, third in zip(whole.rows, cut.rows, single.rows, strict=True):
        np.testing.assert_allclose(mine.values, theirs.values, rtol=WITHIN, atol=WITHIN)
        np.testing.assert_array_equal(theirs.values, third.values)


def test_blocks_of_any_length_give_the_same_bits() -> None:
    """Memory is bounded: a block holds at most so many rows times runs.

    So 16 of 512 runs are simulated in shorter blocks than the same runs without the others.
    """
    plan, spec = winder()
    numbers, phases = drawn(plan, 512)
    table, longest, found = tick_table(plan.commands), [], []
    every = Values.of(plan.machine, numbers)
    rates = tuple(float(rate.max()) for rate in fastest_rates(table, every))
    for count in (16, 512):
        values = Values.of(plan.machine, {name: of[:count] for name, of in numbers.items()})
        recording = simulate_runs(table, values, encoder_phase=phases[:count], least_rates=rates)
        longest.append(max(len(block.samples["operation"]) for block in recording))
        found.append(Judge(plan, spec).each(recording))
    assert longest[0] > 1.5 * longest[1] and longest[1] * 512 <= 1 << 18
    for mine, theirs in zip(found[0].rows, found[1].rows, strict=True):
        np.testing.assert_array_equal(mine.values, theirs.values[:16])


def test_samples_of_many_runs_are_judged_where_the_twin_put_them() -> None:
    """The samples of all axes fill one array: copying it took as long as judging it.

    Fewer runs than fill whole vectors leave gaps between the axes, and are copied: the result is
    the same.
    """
    plan, _ = winder()
    for count, copied in ((64, False), (19, True)):
        numbers, phases = drawn(plan, count)
        recording = simulate_runs(
            tick_table(plan.commands), Values.of(plan.machine, numbers), encoder_phase=phases
        )
        block = next(iter(recording))
        loads = [block.samples[f"{axis}.load"] for axis in plan.machine.axes]
        there = together(loads)
        if copied:
            assert there is None
            continue
        assert there is not None and there.shape == (*loads[0].shape, len(loads))
        assert all(np.shares_memory(there, load) for load in loads)
        np.testing.assert_array_equal(there, np.stack(loads, axis=-1))
        assert np.shares_memory(lanes(there), there)
        assert together(loads[::-1]) is None
        assert together([loads[0], None, loads[2]]) is None
        assert together([loads[0], loads[2]]) is None


def test_a_run_without_an_answer_fails_alone(monkeypatch) -> None:
    """A motion that grows without bound ends no other run."""
    plan, spec = winder()
    body = plan.machine.drive_of("X").acts_on
    path = f"bodies.{next(iter(body))}.inertia"
    own = plan.machine.bodies[next(iter(body))].inertia.si
    lost = (1,)
    simulated = judge_runs.simulate_runs

    def without(table, values, **options):
        if path in values.replaced and values.replaced[path].max() > 1.5 * own:
            raise MachineError("the motion grows without bound")
        return simulated(table, values, **options)

    monkeypatch.setattr(judge_runs, "simulate_runs", without)
    found = RunsJudge(plan, spec).judged({path: own * np.array([1.0, 2.0, 1.0, 1.0])})
    single = RunsJudge(plan, spec).judged({path: own * np.ones(1)})
    contour = found.row("contour_error")
    assert np.isinf(contour.values[1]) and contour.failed.tolist() == [False, True, False, False]
    kept = [run for run in range(4) if run not in lost]
    assert (contour.values[kept] == single.row("contour_error").values[0]).all()
    assert found.passed.tolist() == [True, False, True, True]
    # Criteria of the plan alone are unchanged.
    assert found.row("path_deviation").values[1] == single.row("path_deviation").values[0]


def test_a_criterion_without_a_limit_fails_nothing() -> None:
    plan, _ = winder()
    spec = Spec(name="told", criteria=(Criterion(name="contour_error"),))
    same = {"bodies.x.inertia": np.full(3, plan.machine.bodies["x"].inertia.si)}
    found = RunsJudge(plan, spec).judged(same, np.full((3, 3), 0.25))
    assert found.passed.all() and found.row("contour_error").limit is None
    with pytest.raises(KeyError):
        found.row("settling_time")
    with pytest.raises(OptionError, match="encoder_phase"):
        RunsJudge(plan, spec).judged(same, np.full((3, 3), 1.0))
