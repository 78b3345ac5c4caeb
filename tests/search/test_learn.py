"""``threadline learn``: a repeated job whose references learn from every run."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from threadline.commands.learned import learned_commands, positions, table_text, with_offsets
from threadline.commands.plan import Plan
from threadline.dynamics.learning import learning_filter
from threadline.errors import OptionError, RecordingError
from threadline.files import tick_table
from threadline.files.formats import read_table
from threadline.files.formats.tick_table import write_table_csv, write_table_npz
from threadline.machine import load_machine
from threadline.machine.vary import band_of, corners, off_tolerance
from threadline.proof import request
from threadline.proof.option_form import Door
from threadline.proof.options import describe, options_from, options_of
from threadline.proof.pipeline import Trials, open_job, plan_job
from threadline.proof.request import Words
from threadline.search.learn import Learner, learn
from threadline.search.learned_job import LearnedJob, learned_from, typed_options
from threadline.search.question import question_of
from threadline.search.repeats import Rules, best_of
from threadline.twin import simulate
from threadline.twin.batch import BatchOptions, simulate_batch
from threadline.verdict import load_spec
from threadline.verdict.types import Level

EXAMPLES = Path(__file__).parents[2] / "examples"
MACHINE = load_machine("stitcher")
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "60 stitch/s"
motion = "discrete"
[[contour]]
unit = "in"
points = [[0, 0], [1, 0], [1, 1]]
"""
SPEC = load_spec(EXAMPLES / "stitcher-place.spec.toml", MACHINE)
SOFT = off_tolerance(MACHINE, mass=1.0, stiffness=-1.0)


@pytest.fixture(scope="module")
def seam(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("learn") / "short.seam.toml"
    file.write_text(SEAM)
    return file


@pytest.fixture(scope="module")
def plan(seam: Path) -> Plan:
    options = options_of(feed_forward=True)
    return plan_job(open_job(seam, MACHINE, options), MACHINE, options)


@cache
def learner(plan: Plan, sensed: str = "head") -> Learner:
    return Learner(plan, Rules(sensed=sensed))  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_a_change_of_the_references_moves_the_load_by_the_error_it_was_made_for(
    plan: Plan, axis: str
) -> None:
    """The twin, which knows no transfer functions, plays the change: its load moves by the error.

    The error is smooth, 1 mm, without frequencies above 15 Hz. The filter is made for the file's
    machine alone, so that it is the inverse of the loop, and without quantisers.
    """
    one = learning_filter(MACHINE, axis, [MACHINE], low_pass_hz=100.0)
    base = tick_table(plan.commands)
    column = MACHINE.axis_names.index(axis)
    tick = np.arange(base.tick_count() + 1)
    error = 1e-3 * np.exp(-0.5 * ((tick - 1000) / 30.0) ** 2)
    offset = np.zeros((len(tick), 2), dtype=np.int64)
    offset[:, column] = np.rint(one.change(error) * MACHINE.counts_per_unit[column])
    channel = f"{axis}.load"
    loads = [
        simulate_batch(
            table, MACHINE, options=BatchOptions(channels=(channel,), quantised=False)
        ).samples[channel][:, 0]
        for table in (base, with_offsets(base, offset))
    ]
    moved = loads[1] - loads[0]
    assert np.abs(moved[: len(error)] - error).max() < 0.01e-3  # two roundings of references


def test_two_machines_share_the_best_factor_of_the_closed_form() -> None:
    """For two real responses a and b, ``max |1 - z r|`` is least at z = 2 / (a + b).

    Far above the modes the response of the load is proportional to stiffness / mass; at 15 times
    the frequency of the mode it still differs by some per cent.
    """
    low, high = (off_tolerance(MACHINE, mass=0.0, stiffness=k) for k in (-1.0, 1.0))
    one = learning_filter(MACHINE, "X", [low, high], low_pass_hz=400.0)
    at = np.searchsorted(one.frequency_hz, 180.0)
    assert one.left[at] == pytest.approx((1.2 - 0.8) / (1.2 + 0.8), rel=0.05)


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_no_machine_within_the_tolerances_gets_worse_at_any_frequency(axis: str) -> None:
    """The frame of Y has a zero that moves with its mass: there the plain inverse diverges."""
    machines = corners(MACHINE)
    one = learning_filter(MACHINE, axis, machines)
    assert one.left.max() <= 1.0 + 1e-9
    assert (one.unlearned_hz is not None) == (axis == "Y")


def test_a_job_is_in_spec_after_two_repeats_on_a_machine_that_fails_its_plan(plan: Plan) -> None:
    """The error at the head falls to a tenth; the report shows the measured place of the head.

    ``simulate`` and the judge are the same as for every proof.
    """
    found = learn(learner(plan), SPEC, actual=SOFT, repeats=3)
    assert not found.repeats[0].verdict.passed
    assert all(one.verdict.passed for one in found.repeats[2:])
    assert found.repeats[3].error_m < 0.1 * found.repeats[0].error_m
    assert found.passed
    assert found.within is not None and found.within <= 2
    again = options_from(dict(found.plan.options))
    planned = plan_job(plan.job, MACHINE, again)
    own, kept = tick_table(planned.commands), tick_table(found.plan.commands)
    assert own.rows_sha256() == kept.rows_sha256()
    assert describe(plan.job, MACHINE, again)["table"] == found.plan.options["table"]


def test_the_encoder_alone_does_not_see_what_the_belts_do(plan: Plan) -> None:
    """The error at the encoder becomes small, but the seam stays out of specification."""
    found = learn(learner(plan, "motor"), SPEC, actual=SOFT, repeats=3)
    assert found.repeats[3].error_m < 0.5 * found.repeats[0].error_m
    assert not found.passed


def test_a_run_that_got_worse_is_undone_and_its_gain_halved() -> None:
    assert best_of([(False, 1.0), (False, 0.4), (False, 0.2)], 0.8) == (2, 0.8)
    assert best_of([(False, 1.0), (False, 0.4), (False, 0.7), (False, 0.5)], 0.8) == (1, 0.2)
    assert best_of([(True, 0.4), (False, 0.2)], 0.8) == (0, 0.4)  # out of spec counts as worse
    assert best_of([(False, 0.2), (True, 0.4), (True, 0.3)], 0.8) == (2, 0.8)


def test_a_change_that_a_drive_cannot_give_is_halved(plan: Plan) -> None:
    """15 mm in 20 ms take far more than the 27 A of a drive."""
    one = learner(plan)
    tick = np.arange(len(one.nothing()))
    error = np.zeros_like(one.nothing())
    error[:, 0] = 15e-3 * np.exp(-0.5 * ((tick - 600) / 20.0) ** 2)
    run = one.tried(simulate(plan.commands, MACHINE), one.nothing(), passed=False)
    offset, gain, note = one.next([replace(run, error=error)])
    assert gain < 0.9
    assert "axis X" in note
    table = one.commands(offset)
    current = np.abs(simulate(table, MACHINE).samples("X.current")[1]).max()
    assert current <= MACHINE.drive_of("X").amplifier.current_limit.si  # type: ignore[union-attr]


@pytest.mark.parametrize("write", [write_table_npz, write_table_csv])
def test_a_learned_table_is_kept_in_a_file_and_bound(plan: Plan, tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    base = tick_table(plan.commands)
    offset = np.zeros((base.tick_count() + 1, 2), dtype=np.int64)
    offset[100:200] = 7
    learned = with_offsets(base, offset)
    file = tmp_path / f"learned.{'npz' if write is write_table_npz else 'csv'}"
    write(learned, file)
    assert read_table(file).began_sha256 == base.rows_sha256()
    played = learned_commands(base, table_text(str(file)))
    assert played.rows_sha256() == learned.rows_sha256() != base.rows_sha256()
    assert (positions(played) - positions(base) == offset).all()
    other = load_machine("stitcher+backlash")
    with pytest.raises(OptionError, match="on another machine file"):
        learned_commands(replace(base, machine_sha256=other.sha256), table_text(str(file)))
    with pytest.raises(OptionError, match="from another job"):
        learned_commands(replace(base, job_sha256="0" * 64), table_text(str(file)))
    with pytest.raises(OptionError, match="from another plan of this job"):
        learned_commands(learned, table_text(str(file)))


def test_a_plans_own_table_and_a_damaged_text_are_refused(plan: Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.npz"
    write_table_npz(tick_table(plan.commands), file)
    with pytest.raises(OptionError, match="not a learned one"):
        table_text(str(file))
    base = tick_table(plan.commands)
    offset = np.zeros((base.tick_count() + 1, 2), dtype=np.int64)
    write_table_npz(with_offsets(base, offset), file)
    text = table_text(str(file))
    for bad in (text[:-30], text.replace('"rows": ', '"rows": 9'), '{"learned": [[['):
        with pytest.raises(OptionError, match="damaged"):
            table_text(bad)
    with pytest.raises(RecordingError):
        table_text(str(tmp_path / "none.npz"))


def test_runs_of_a_machine_are_learned_from_one_after_the_other(plan: Plan, seam: Path) -> None:
    """Run, learn, run: each recording names the table that it played."""
    words = Words.of("learn", Door.PYTHON, {"spec": SPEC})
    recorded, errors = {}, []
    playing = plan
    for number in range(2):
        ran = simulate(playing.commands, SOFT)
        recorded[f"run {number}"] = replace(
            ran, origin=playing.options, machine_sha256=MACHINE.sha256
        )
        found = learned_from(words, seam, MACHINE, Rules(), recorded)
        errors.append(found.repeats[-1].error_m)
        playing = found.plan
    assert errors[1] < 0.5 * errors[0]
    assert [one.followed for one in found.repeats] == [True, True]
    # If the last run is given first, the later ones are worse, and are undone.
    turned = dict(reversed(recorded.items()))
    undone = learned_from(words, seam, MACHINE, Rules(), turned)
    assert [one.followed for one in undone.repeats] == [True, False]
    assert undone.gain == pytest.approx(0.9 / 2)
    same = Words.of("learn", Door.PYTHON, {"feed_forward": True, "spec": SPEC})
    typed = typed_options(learned_from(same, seam, MACHINE, Rules(), recorded).base.options)
    assert typed == {"--feed-forward": ""}
    elsewhere = {"other": replace(recorded["run 0"], machine_sha256="0" * 64)}
    with pytest.raises(OptionError, match="another machine"):
        learned_from(words, seam, MACHINE, Rules(), elsewhere)
    with pytest.raises(OptionError, match="differ from run 0"):
        learned_from(
            Words.of("learn", Door.PYTHON, {"needle": "50 stitch/s"}), seam, MACHINE, Rules(),
            recorded,
        )  # fmt: skip


def test_the_face_learns_and_proves_with_the_table(seam: Path, tmp_path: Path) -> None:
    found = tl.learn(
        seam, "stitcher", spec=SPEC, actual=SOFT, feed_forward=True, repeats=2, level="nominal"
    )
    assert isinstance(found, LearnedJob)
    assert found.passed
    assert found.content()["machines"][0]["best"] == 2
    file = tmp_path / "learned.npz"
    found.write(file)
    proved = tl.prove(
        seam,
        "stitcher",
        spec=SPEC,
        actual=SOFT,
        feed_forward=True,
        level="nominal",
        table=str(file),
    )
    assert proved.passed
    assert proved.plan.options["table"].startswith('{"learned"')


def test_a_job_is_learned_on_every_machine_of_a_band(seam: Path) -> None:
    """Each machine learns its own table, as it would alone."""
    words = {"spec": SPEC, "feed_forward": True, "repeats": 1, "level": "nominal"}
    found = tl.learn(seam, "stitcher", band="10 %", **words)  # type: ignore[arg-type]
    assert isinstance(found, LearnedJob)
    machines = band_of(MACHINE, 0.1).machines
    assert [name for name, _ in found.machines] == [name for name, _ in machines]
    assert [one.actual.sha256 for _, one in found.machines] == [m.sha256 for _, m in machines]
    alone = tl.learn(seam, "stitcher", actual=machines[0][1], **words)  # type: ignore[arg-type]
    assert isinstance(alone, LearnedJob)
    errors_m, alone_m = (
        [repeat.error_m for repeat in one.machines[0][1].repeats] for one in (found, alone)
    )
    assert errors_m == alone_m and errors_m[1] < errors_m[0]
    with pytest.raises(OptionError, match=f"each of the {len(machines)} machines"):
        found.write("table.npz")


def test_a_learned_table_is_judged_on_a_share_of_all_machines(
    seam: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by ``prove``, here on 20 machines in place of 1000."""
    few = lambda share: Trials(repeats=2, machines=20, wanted_yield=share)  # noqa: E731
    monkeypatch.setattr(request, "yielding", few)
    words = {"spec": SPEC, "actual": SOFT, "feed_forward": True, "repeats": 2}
    found = tl.learn(seam, "stitcher", yield_="1 %", **words)  # type: ignore[arg-type]
    assert isinstance(found, LearnedJob)
    verdict = found.machines[0][1].proof.verdict
    assert (verdict.level, verdict.wanted_yield, verdict.machines) == (Level.YIELD, 0.01, 20)
    assert any(result.name == "rejects" for result in verdict.results)


@pytest.mark.parametrize("words", [
    {"level": "over tolerances"}, {"yield_": "90 %"}, {"ends": "100 %"}, {"band": "20 %"},
    {"actual": "stitcher+backlash"},
])  # fmt: skip
def test_recorded_runs_are_not_judged_on_simulated_machines(
    seam: Path, words: dict[str, object]
) -> None:
    """The recording is read after that: there is no such file."""
    (name,) = words
    with pytest.raises(OptionError, match=f"runs= judges recorded runs, and {name}=.* asks for"):
        tl.learn(seam, "stitcher", runs=["none.npz"], **words)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        ({"feed_forward": False}, "timed for a head that lags"),
        ({"low_pass": "900 Hz"}, "is not between 0 and 400 Hz"),
        ({"gain": "120 %"}, "at most 100 %"),
        ({"repeats": 0}, "is not from 1 to 100"),
        ({"ends": "100 %", "actual": "stitcher+backlash"}, "ends= and actual= exclude each other"),
        ({"ends": "100 %", "band": "20 %"}, "ends= and band= exclude each other"),
        ({"measured": "foot"}, "unknown measured"),
    ],
)
def test_learning_refuses_an_impossible_request(
    seam: Path, words: dict[str, object], refusal: str
) -> None:
    with pytest.raises(OptionError, match=refusal):
        tl.learn(seam, "stitcher", **{"feed_forward": True, **words})  # type: ignore[arg-type]


def test_a_machine_without_loops_cannot_learn() -> None:
    with pytest.raises(OptionError, match="no control loops"):
        tl.learn(EXAMPLES / "x-180.prg", "stepper-winder")


def test_a_search_judges_plans_by_what_repeats_make_of_them(plan: Plan, seam: Path) -> None:
    """The question has a plan that fails as planned, and passes once it is learned."""
    words = {"feed_forward": True, "spec": SPEC, "actual": SOFT, "level": "nominal"}
    as_planned = question_of(Words.of("fastest", Door.PYTHON, words), seam, MACHINE)
    learned = question_of(Words.of("fastest", Door.PYTHON, {**words, "learned": 2}), seam, MACHINE)
    assert not as_planned.judged(plan).passed
    assert learned.judged(plan).passed


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        ({"learned": 101}, "is not from 1 to 100"),
        ({"learned": 2, "level": "nominal", "mismatch": True}, "exclude each other"),
        ({"learned": 2, "feed_forward": False}, "timed for a head that lags"),
    ],
)
def test_a_search_of_what_cannot_be_learned_is_refused(
    seam: Path, words: dict[str, object], refusal: str
) -> None:
    with pytest.raises(OptionError, match=refusal):
        question_of(
            Words.of("fastest", Door.PYTHON, {"feed_forward": True, **words}), seam, MACHINE
        )
