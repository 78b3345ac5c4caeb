"""After a loss of power: home, confirm, approach, and do the rest of the job."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Wire
from tests.live.memory_sink import MemorySink
from threadline.cli.operator_keys import check_continued, continued_run
from threadline.commands.plan import Plan
from threadline.errors import LimitError, OptionError, RecordingError, StoreError
from threadline.files import Recording, RunEnd, played, switch_schedule, tick_table
from threadline.files.formats import write_recording
from threadline.live.continuing import Continued, continued, last_executed, operation_at
from threadline.live.derived import Rest
from threadline.live.kinds_run import run_kind_of
from threadline.live.sim_machine import parse_fault
from threadline.live.sim_process import group_ticks
from threadline.live.states import Cause, Desk
from threadline.live.store.run_store import RunStore
from threadline.live.supervised import Conduct, run_commands
from threadline.machine import load_machine
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.proof.proof_file import read_proof, write_proof
from threadline.verdict import judge, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"
JOBS = {
    "lathe-winder": ("x-180.prg", "3 s", None),
    "stepper-winder": ("helix.gcode", "5 s", None),
    "letter-placer": ("letter-cycle.toml", "5 s", "um-zv"),
    "schiffli-frame": ("", "5 s", None),
}
SHORT: list[Path] = []  # the design of the frame, written by its fixture


@pytest.fixture(scope="module", autouse=True)
def _short_design(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Return forty stitches of two to eight millimetres for the frame."""
    moves = np.random.default_rng(4).integers(20, 81, (40, 2)) * np.array([1, -1])
    SHORT[:] = [tmp_path_factory.mktemp("design") / "forty.exp"]
    SHORT[0].write_bytes(moves.astype(np.int8).tobytes())


@cache
def planned(name: str) -> Plan:
    job, _, shaper = JOBS[name]
    machine, options = load_machine(name), Options(shaper=shaper)
    file = EXAMPLES / job if job else SHORT[0]
    return plan_job(open_job(file, machine, options), machine, options)


def run(
    plan: Plan,
    again: Continued | None = None,
    fault: str | None = None,
    confirmed: Callable[[], bool | None] = lambda: True,
    asked: Cause | None = None,
) -> tuple[tuple[RunEnd, str], Recording, Wire]:
    """Run a plan, or its rest, on a machine that was just switched on."""
    machine = plan.machine
    found = None if fault is None else parse_fault(f"{fault}", machine)
    wire, sink = Wire(machine, run_kind_of(machine).start(plan.commands), found), MemorySink()
    wire.group = group_ticks(machine, 0.0)  # as the process of the machine has it
    with closing(Desk()) as desk:
        if asked is not None:
            desk.ask(asked)
        ended, why, _ = run_commands(
            plan.commands, machine, nullcontext(wire), desk, sink,  # type: ignore[arg-type]
            Conduct(again=again, confirmed=confirmed), speed=0.0,
        )  # fmt: skip
    return (ended, why), sink.recording(plan), wire


@cache
def broken_off(name: str) -> tuple[Recording, int]:
    """Return the recording of a run that lost its power, and the last executed operation."""
    plan = planned(name)
    (ended, why), recording, _ = run(plan, fault=f"power-loss@{JOBS[name][1]}")
    assert (ended, why) == (RunEnd.FAULT, "the link is gone")
    operations = recording.samples("operation")[1]
    return recording, int(operations.max())


@cache
def rest_of(name: str) -> tuple[Continued, Recording, Wire]:
    """Return the rest of a broken-off run, its recording, and its sent rows."""
    plan = planned(name)
    again = continued(plan, broken_off(name)[1], at_rest=False)
    (ended, why), recording, wire = run(plan, again)
    assert (ended, why) == (RunEnd.COMPLETED, "")
    return again, recording, wire


@pytest.mark.parametrize("name", JOBS)
def test_last_executed_row_is_read_from_the_trace(name: str, tmp_path: Path) -> None:
    recording, executed = broken_off(name)
    write_recording(recording, tmp_path / "trace.mcap")
    assert last_executed(tmp_path / "trace.mcap") == executed > 0


@pytest.mark.parametrize("name", ["lathe-winder", "stepper-winder"])
def test_axes_are_moved_there_and_do_the_rest_row_by_row(name: str) -> None:
    """Home, approach and rest add up to the whole: no row is skipped or repeated."""
    plan = planned(name)
    machine, table = plan.machine, tick_table(plan.commands)
    again, recording, wire = rest_of(name)
    rest = again.rest
    scale = machine.counts_per_unit
    commanded = np.stack(
        [np.rint(recording.samples(f"{axis}.commanded")[1] * k)
         for axis, k in zip(machine.axes, scale, strict=True)], axis=1,
    )  # fmt: skip
    rows = np.concatenate([block.counts for block in table])
    whole = table.start_counts + np.concatenate([np.zeros((1, rows.shape[1])), rows.cumsum(axis=0)])
    assert (commanded[0] == whole[rest.left_out]).all()
    assert (rest.begins == whole[rest.left_out]).all()
    assert (commanded[-1] == whole[-1]).all()
    # After the start from rest, every position of the table follows in order, one a tick.
    moving = [int(np.flatnonzero((way != whole[-1]).any(axis=1))[-1]) for way in (commanded, whole)]
    count = moving[0] - 300  # a start takes 256 ticks at most
    assert count > 500
    alike = [
        way[end - count : end + 2] for way, end in zip((commanded, whole), moving, strict=True)
    ]
    assert (alike[0] == alike[1]).all()
    first = next(iter(recording)).first_tick
    clock = recording.channels[0].clock
    begins_s = first[clock.name] * float(clock.period_s)
    assert begins_s == pytest.approx(rest.left_out * float(table.clock.period_s), abs=1e-9)
    # From rest within the acceleration limit; rounding to counts is 2 in a second difference.
    tick_s = float(table.clock.period_s)
    hardest = np.abs(np.diff(commanded[:200], 2, axis=0)).max(axis=0)
    own = np.abs(np.diff(whole, 2, axis=0)).max(axis=0)
    allowed = np.maximum(machine.acceleration_limit * scale * tick_s**2, own) + 2.0
    assert (hardest <= allowed).all()
    if rest.left_out:
        assert np.abs(np.diff(commanded[:3], axis=0)).max() <= np.abs(rows).max()
        jogs = [message for message in wire.sent if message.kind == "begin"]
        assert len(jogs) == len(again.approach) + 1


@pytest.mark.parametrize("name", JOBS)
def test_the_rest_alone_proves_nothing_of_the_whole(name: str) -> None:
    plan = planned(name)
    again, recording, _ = rest_of(name)
    spec = load_spec(None, plan.machine)
    if name == "letter-placer":  # in a cycle every switching has to be recorded
        with pytest.raises(RecordingError, match=r"begins at .*, the motion before"):
            judge([recording], plan, spec)
    else:
        assert not judge([recording], plan, spec).passed
    operations = recording.samples("operation")[1]
    assert operations.min() >= again.rest.operation


def test_a_frame_comes_there_with_its_needle_up() -> None:
    plan = planned("schiffli-frame")
    executed = broken_off("schiffli-frame")[1]
    rest = continued(plan, executed, at_rest=False).rest
    assert (rest.dry, rest.operation) == (True, executed)
    for block, own in zip(played(rest.commands), played(plan.commands), strict=True):
        before = own.operation < executed
        assert not block.needle[before].any()
        assert (block.needle[~before] == own.needle[~before]).all()
        assert (block.table == own.table).all()
    assert any(own.needle[own.operation < executed].any() for own in played(plan.commands))


def test_the_cycle_begins_again_where_nothing_was_held() -> None:
    """A letter on the vacuum has fallen, so it is cut anew; the knife rests before."""
    plan = planned("letter-placer")
    schedule = switch_schedule(plan.commands)
    names = list(schedule.outputs)
    of = {kind: [names.index(n) for n, o in plan.machine.outputs.items() if o.kind == kind]
          for kind in ("tool", "vacuum")}  # fmt: skip
    executed = broken_off("letter-placer")[1]
    row = int(np.flatnonzero(schedule.operation <= executed)[-1])
    assert schedule.levels[row, of["vacuum"]].any(), "the letter hung when the power went"
    rest = continued(plan, executed, at_rest=False).rest
    assert rest.operation < executed
    sent = switch_schedule(rest.commands)
    work = of["tool"] + of["vacuum"]
    before = schedule.operation < rest.operation
    assert not sent.levels[before][:, work].any()
    assert (sent.levels[~before] == schedule.levels[~before]).all()
    others = [k for k in range(len(names)) if k not in work]
    assert (sent.levels[:, others] == schedule.levels[:, others]).all()
    assert schedule.levels[~before][0, work].any()  # the step of the cut
    assert not schedule.levels[before][-1, work].any()
    # At the end of the cycle nothing is held, so it begins again at its last operation.
    last = int(schedule.operation[-1])
    assert continued(plan, last, at_rest=False).rest.operation == last


@pytest.mark.parametrize(("answer", "asked"), [(False, None), (None, Cause.STOP)])
def test_nothing_moves_until_somebody_confirms(answer: bool | None, asked: Cause | None) -> None:
    plan = planned("lathe-winder")
    again = continued(plan, broken_off("lathe-winder")[1], at_rest=False)
    looks: list[int] = []

    def confirmed() -> bool | None:
        looks.append(1)
        return None if len(looks) < 3 else answer

    if asked is None:
        (ended, why), _, wire = run(plan, again, confirmed=confirmed)
        assert len(looks) == 3
    else:
        machine = plan.machine
        wire = Wire(machine, run_kind_of(machine).start(plan.commands))
        with closing(Desk()) as desk:

            def stopped() -> None:
                looks.append(1)
                desk.ask(asked)

            ended, why, _ = run_commands(
                plan.commands, machine, nullcontext(wire), desk, MemorySink(),  # type: ignore[arg-type]
                Conduct(again=again, confirmed=stopped), speed=0.0,
            )  # fmt: skip
        assert looks
    assert (ended, why) == (RunEnd.STOPPED, "nobody has confirmed that it may go on")
    assert not [message for message in wire.sent if message.kind in {"begin", "refill"}]


def test_a_stop_on_the_approach_ends_it() -> None:
    plan = planned("lathe-winder")
    again = continued(plan, broken_off("lathe-winder")[1], at_rest=False)
    machine = plan.machine
    wire = Wire(machine, run_kind_of(machine).start(plan.commands))
    with closing(Desk()) as desk:
        played_groups: list[int] = []

        def later() -> None:
            played_groups.append(1)
            if len(played_groups) == 20:
                desk.ask(Cause.STOP)

        wire.before_play = later
        ended, why, _ = run_commands(
            plan.commands, machine, nullcontext(wire), desk, MemorySink(),  # type: ignore[arg-type]
            Conduct(again=again), speed=0.0,
        )  # fmt: skip
    assert ended is RunEnd.STOPPED
    assert "operator" in why
    assert len([message for message in wire.sent if message.kind == "begin"]) == 1
    assert abs(int(wire.machine.position[1])) < abs(int(again.approach[-1][1]))


def test_an_approach_beyond_the_travel_is_refused_before_anything_moves() -> None:
    plan = planned("lathe-winder")
    table = tick_table(plan.commands)
    beyond = table.start_counts + np.array([0, 30_000, 0])
    other = replace(plan, commands=replace(table, start_counts=beyond))
    with pytest.raises(LimitError, match=r"axis X: the approach goes to .*, beyond its travel"):
        continued(other, broken_off("lathe-winder")[1], at_rest=False)


def test_run_with_feed_forward_continues_at_a_rest() -> None:
    machine = load_machine("stitcher")
    options = options_of("auto", None, "0.1 mm", feed_forward=True)
    job = open_job(EXAMPLES / "stitcher-even.seam.toml", machine, options)
    plan = plan_job(job, machine, options)
    table = tick_table(plan.commands)
    rows = np.concatenate([block.counts for block in table])
    operations = np.concatenate([block.operation for block in table])
    last = int(operations[-1])
    anywhere = continued(plan, last, at_rest=False).rest
    at_rest = continued(plan, last, at_rest=True).rest
    assert at_rest.left_out < anywhere.left_out
    # 50 ms at 1 ms; index 0 is the begin, before which everything rests.
    if at_rest.left_out:
        assert not rows[at_rest.left_out - 50 : at_rest.left_out].any()
    assert at_rest.operation == operations[at_rest.left_out]


def test_places_are_circuits_lines_and_blocks() -> None:
    plan = planned("lathe-winder")
    sources = [operation.source for operation in plan.job]
    executed = len(sources) - 1
    assert operation_at(plan, executed, "block") == executed
    line = sources[executed // 2].line
    began = operation_at(plan, executed, f"line {line}")
    assert sources[began].line == line
    assert not began or sources[began - 1].line != line
    for wrong in (
        "nowhere",
        "line",
        "line x",
        "circuit 1.5",
        "line 99999",
        "line " + "1" * 5000,
        "",
    ):
        with pytest.raises(OptionError, match="--at"):
            operation_at(plan, executed, wrong)


def test_a_circuit_is_a_pass_of_the_program(tmp_path: Path) -> None:
    lines = ["%", "O 999;", "X 5;", "X -5;", "M99;", "O 998;", "G01 F 2160;", "G91;",
             "M98 P 999 L 5;", "M30;", "%", ""]  # fmt: skip
    (tmp_path / "circuits.prg").write_text("\n".join(lines), "ascii")
    machine = load_machine("lathe-winder")
    plan = plan_job(open_job(tmp_path / "circuits.prg", machine, Options()), machine, Options())
    passes = [operation.source.passes for operation in plan.job]
    executed = passes.index((4,)) + 1
    assert operation_at(plan, executed, "circuit") == passes.index((4,))
    assert operation_at(plan, executed, "circuit 2") == passes.index((2,))
    with pytest.raises(OptionError, match="has not executed it"):
        operation_at(plan, executed, "circuit 5")


def test_another_job_a_completed_run_and_nobody_there_are_refused(tmp_path: Path) -> None:
    plan = planned("lathe-winder")
    spec = load_spec(None, plan.machine)
    write_proof(prove_plan(plan, spec), tmp_path / "a.proof.json")
    store = RunStore(tmp_path / "runs")
    open_run = store.begin(plan, read_proof(tmp_path / "a.proof.json"), {"link": "sim"}, 0.0)
    with open_run:
        pass
    write_recording(broken_off("lathe-winder")[0], open_run.trace)

    def ask(of: Plan) -> Continued | None:
        run_kind = run_kind_of(of.machine)

        def rest(operation: int) -> Rest:
            return run_kind.rest(of.commands, of.machine, operation, at_rest=False)

        return continued_run(store.folder, "last", None, of, rest, asks=True)[0]

    found = ask(plan)
    assert found is not None
    assert found.rest.operation == broken_off("lathe-winder")[1]
    whole = broken_off("lathe-winder")[0]
    for foreign in (
        replace(whole, job_sha256="0" * 64),
        replace(whole, origin={**whole.origin, "run": "20200101-000000-x-180"}),
    ):
        write_recording(foreign, open_run.trace)
        with pytest.raises(StoreError, match="is the trace of another run"):
            ask(plan)
    write_recording(whole, open_run.trace)
    options = Options(interpolation="linear")
    other = plan_job(open_job(EXAMPLES / "x-180.prg", plan.machine, options), plan.machine, options)
    with pytest.raises(StoreError, match="had other rows than these"):
        ask(other)
    store.index.end(open_run.path.name, ended="completed", text="", late_ticks=0, passed=True)
    with pytest.raises(StoreError, match="was completed: there is no rest of it"):
        ask(plan)


def test_options_of_a_continued_run_are_checked_before_anything_is_planned(tmp_path: Path) -> None:
    """The run is looked up first: if it does not exist, no key would help."""
    plan = planned("lathe-winder")
    write_proof(prove_plan(plan, load_spec(None, plan.machine)), tmp_path / "a.proof.json")
    folder = tmp_path / "runs"
    with pytest.raises(OptionError, match="--at needs --continue"):
        check_continued(folder, None, "block", confirmed=False)
    with pytest.raises(StoreError, match="there is no run 'nosuch' in "):
        check_continued(folder, "nosuch", None, confirmed=False)
    assert not folder.exists()
    store = RunStore(folder)
    with store.begin(plan, read_proof(tmp_path / "a.proof.json"), {"link": "sim"}, 0.0) as open_run:
        pass
    with pytest.raises(StoreError, match="there is no run 'nosuch' in "):
        check_continued(folder, "nosuch", None, confirmed=False)
    with pytest.raises(OptionError, match="nobody is at the keyboard"):
        check_continued(folder, "last", None, confirmed=False)
    store.index.end(open_run.path.name, ended="completed", text="", late_ticks=0, passed=True)
    with pytest.raises(StoreError, match="was completed: there is no rest of it"):
        check_continued(folder, "last", None, confirmed=False)
