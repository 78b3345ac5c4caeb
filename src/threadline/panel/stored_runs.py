"""Runs of the panel: the check of the proof beforehand, the store, and the verdict afterwards.

The check and the verdict take seconds, in which the executor still has to listen and may move. So
the check is a thread, and its start is dropped if another command comes. The simulations of the
check and the judge are separate processes, so that the owner's process stays small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, finite
from threadline.base.reading import inputs_read, noting_inputs
from threadline.commands.plan import Plan
from threadline.errors import ProofError, RecordingError, StoreError, ThreadlineError
from threadline.files import Channel, RecordingBlock, RunEnd
from threadline.live.continuing import (
    Continued,
    ContinuedSink,
    continued_by,
    last_executed,
    operation_at,
)
from threadline.live.kinds_run import run_kind_of
from threadline.live.operated import Operated, PlanToSend
from threadline.live.path_window import REST_S
from threadline.live.states import Cause, Hold, Sink, State
from threadline.live.store.run_store import OpenRun, RunStore
from threadline.live.store.whole_trace import (
    as_one,
    joined_with,
    refuse_other_rows,
    trace_of,
    unfinished_run,
)
from threadline.live.supervised import (
    Interventions,
    check_halts,
    check_override,
    check_runnable,
)
from threadline.machine import Machine
from threadline.panel.live_contour import Also, LiveContour
from threadline.panel.programs import planned
from threadline.panel.run_work import interventions_apart, judged_apart
from threadline.proof.pipeline import with_shaping
from threadline.proof.proof_file import ProofFile
from threadline.verdict import Spec, load_spec
from threadline.verdict.progress import PlanClock


@dataclass(frozen=True, slots=True)
class Prepared:
    """A run that may begin, because its proof matches the present files.

    Parameters
    ----------
    number
        Number of the request.
    stops
        Number of stops received when it was requested.
    may
        Effect of holds and feed overrides on the verdict of the work.
    rests_s
        (n, 2) begin and end of the rests for which a hold waits, s; None: it takes effect at once.
    again, continues
        The rest of an interrupted run, and the name of that run; None and empty for a whole run.
    """

    number: int
    stops: int
    to_send: PlanToSend
    spec: Spec
    proof: ProofFile
    override: str | None
    inputs: tuple[Path, ...]
    may: Interventions
    rests_s: FloatArray | None = None
    again: Continued | None = None
    continues: str = ""

    def moves(self, machine: Machine) -> list[tuple[str, int]]:
        """Return the moves to the start of the rest, in their order: axis and counts."""
        assert self.again is not None
        return list(zip(machine.axes, self.again.rest.begins.tolist(), strict=False))

    def rest_notes(self) -> dict[str, Any]:
        """Return the notes that the operator reads before confirming the rest."""
        assert self.again is not None
        return {"run": self.continues, "notes": list(self.again.notes)}


@dataclass(frozen=True, slots=True)
class _Finished:
    content: Mapping[str, Any]
    closing: str


@dataclass(frozen=True, slots=True)
class Owned:
    """The machine, folders and link that a process is to own.

    Parameters
    ----------
    machine, spec_file
        The machine, and the file of the specification; None: the machine's own specification.
    folder, store
        Folders of the programs and of the runs.
    speed
        Seconds of simulated time per second.
    link
        Name of the link to the machine.
    """

    machine: Machine
    spec_file: Path | None
    folder: Path
    store: Path
    speed: float
    link: str = "sim"


class StoredRuns:
    """Prepares, keeps and judges runs; the sink of the executor.

    Parameters
    ----------
    owned
        The machine, its link, and the folders.
    label
        Entry for the index; see ``AtLink``.
    said
        Function that takes a text for people, and whether the text is about a fault.

    Attributes
    ----------
    why
        Reason of the latest change of state; may be empty.
    """

    def __init__(self, owned: Owned, label: str, tell: Callable[[str, bool], None]) -> None:
        machine = owned.machine
        self._folder, self._machine, self._spec_file = owned.folder, machine, owned.spec_file
        self._store, self._speed, self._tell = owned.store, owned.speed, tell
        self._link = {"link": owned.link, **({"label": label} if label else {})}
        self._pool = ThreadPoolExecutor(1)
        self._preparing: tuple[Future[Prepared], int, int] | None = None
        self._cancelled_by = ""  # the command that cancelled the start being checked
        self._judging: Future[_Finished] | None = None
        self._channels: tuple[Channel, ...] = ()
        self._simulated = True
        self._sink: Sink | None = None  # of the open run
        self._live: LiveContour | None = None  # of the open run
        self._may: tuple[str, Interventions] | None = (
            None  # hash of the latest proof, and its interventions
        )
        self._completed: dict[str, int] = {}  # number of completed runs, by program
        self._left_out_s = 0.0  # time of the job before its rest; 0 for a whole run
        self._open: tuple[OpenRun, Prepared, ExitStack] | None = None
        self._progress: dict[str, Any] | None = None
        self._held = 0  # ticks of the run spent in holds
        self._held_from: int | None = None  # tick at which the present hold began
        self._tells = run_kind_of(machine).reports_plan_time
        self._plan_clock = PlanClock(machine.command_clock)
        self._period_s = float(machine.command_clock.period_s)
        self.why = ""
        self._state: State | None = None

    # --- the sink of the executor ----------------------------------------------------------

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Store the channels of the recordings of later runs."""
        self._channels, self._simulated = channels, simulated

    def block(self, block: RecordingBlock) -> None:
        """Write a block into the open run."""
        if self._open is not None and self._sink is not None:
            self._sink.block(block)
            self._plan_clock.take(block.events)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Store the reason for a change of state, and write the change into the open run."""
        # A stop during a fault does not replace the reason of the fault. An override has its own
        # display.
        if (text or state is not self._state) and cause is not Cause.OVERRIDE:
            self.why = text
        self._state = state
        if self._open is not None:
            self._open[0].state(tick, state, cause, text)
        if state is State.HOLDING:
            self._held_from = tick if self._held_from is None else self._held_from
        elif self._held_from is not None:
            self._held += tick - self._held_from
            self._held_from = None

    # --- a run -----------------------------------------------------------------------------

    @property
    def busy(self) -> str:
        """Why no run can begin now, for people; empty if one can."""
        if self._preparing is not None:
            return "a start is being checked"
        if self._open is not None:
            return "a run is under way"
        return "" if self._judging is None else "the last run is being judged"

    def give_up(self, why: str) -> None:
        """Drop a start that is being checked, because the command ``why`` came."""
        self._cancelled_by = self._cancelled_by or why

    def prepare(self, head: Mapping[str, Any], stops: int, executor: Operated) -> None:
        """Begin to check a requested run; ``prepared`` returns the result."""
        number = int(head["number"])
        self._cancelled_by = ""
        work = self._pool.submit(self._prepared, head, stops, executor)
        self._preparing = (work, number, stops)

    def prepared(self) -> Prepared | tuple[int, str] | None:
        """Return the prepared run, or its number and the refusal; None while it is checked."""
        if self._preparing is None or not self._preparing[0].done():
            return None
        future, number, _ = self._preparing
        self._preparing = None
        try:
            ready = future.result()
        except (ThreadlineError, OSError) as error:
            return number, str(error)
        if self._cancelled_by:
            return number, f"it was not begun: the command {self._cancelled_by!r} came meanwhile"
        return ready

    def _prepared(self, head: Mapping[str, Any], stops: int, executor: Operated) -> Prepared:
        """Plan the program again, and compare the plan with the proof, hash by hash."""
        proof_file = Path(str(head["proof_file"]))
        override = None if head["override"] is None else str(head["override"])
        check_override(override)
        with noting_inputs():
            plan, options = planned(self._folder, head, self._machine)
            wanted = load_spec(self._spec_file, self._machine)
            spec = with_shaping(wanted, self._machine, options)
            check_halts(plan, answered=True)
            proof = check_runnable(proof_file, plan, spec, override)
            inputs = tuple(file for file in inputs_read() if not file.samefile(proof_file))
        if proof.content["sha256"] != head["proof"]:
            raise ProofError("it is not the proof that was shown", remedy="Calculate it again.")
        may = self._interventions(str(head["proof"]), plan, spec)
        may = may.at_once() if executor.holds_at_once else may
        LiveContour.rehearse(plan, spec, self._channels)
        to_send, number = executor.prepare(plan), int(head["number"])
        to_send = replace(to_send, notes=(*to_send.notes, *may.notes))
        rests = run_kind_of(plan.machine).rests_s
        rests_s = rests(plan.commands) if may.hold is Hold.AT_REST else None
        ready = Prepared(number, stops, to_send, spec, proof, override, inputs, may, rests_s)
        if "run" not in head:
            return ready
        return self._rest_of(str(head["run"]), str(head["at"]), ready, executor)

    def _interventions(self, proof: str, plan: Plan, spec: Spec) -> Interventions:
        """Return the effect of holds and overrides on a proof's work; simulated once per proof."""
        if self._may is None or self._may[0] != proof:
            self._may = proof, interventions_apart(plan, spec)
        return self._may[1]

    def _rest_of(self, run: str, at: str, whole_run: Prepared, executor: Operated) -> Prepared:
        """Return the rest of an interrupted run; its approach is checked."""
        folder, record = unfinished_run(self._store, run)
        plan = whole_run.to_send.plan
        refuse_other_rows(record, plan)
        operation = operation_at(plan, last_executed(trace_of(folder, record)), at)
        to_send = executor.rest(
            whole_run.to_send, operation, at_rest=whole_run.may.hold is Hold.AT_REST
        )
        assert to_send.rest is not None
        continued = continued_by(plan, to_send.rest)
        return replace(whole_run, to_send=to_send, again=continued, continues=folder.name)

    def set_out(self, ready: Prepared, executor: Operated) -> None:
        """Open the run in the store, and begin it.

        Raises
        ------
        CommandError
            If the machine is not idle, or not where the run begins.
        """
        plan, sent = ready.to_send.plan, ready.to_send.sent
        run_entries = {**self._link, **self._entries_of(ready)}
        executor.refuse(ready.to_send)
        for note in ready.to_send.notes:
            self._tell(note, False)
        run = RunStore(self._store).begin(
            plan, ready.proof, run_entries, self._speed, ready.inputs, sent
        )
        stack = ExitStack()
        stack.enter_context(run)
        rest = ready.to_send.rest
        self._live = LiveContour.of(plan, ready.spec, self._channels)
        measured_sink: Sink = run if self._live is None else Also(run, self._live)
        self._sink = measured_sink
        self._left_out_s = 0.0
        if rest is not None:
            self._sink = ContinuedSink(measured_sink, self._machine, rest.left_out, rest.operation)
            self._left_out_s = rest.left_out * self._period_s
        self._sink.begin(self._channels, self._simulated)
        self._open = (run, ready, stack)
        self._held, self._held_from = 0, None
        self._plan_clock = PlanClock(self._machine.command_clock)
        self._progress = {
            "run": run.path.name,
            "program": plan.job.name,
            "file": Path(plan.job.file).name,
            "time_s": self._left_out_s,
            "duration_s": plan.duration_s,
            "completed": self._completed.get(plan.job.name, 0),
        }
        try:
            may = ready.may
            executor.run(ready.to_send, hold=may.hold, no_override=may.no_override)
        except ThreadlineError as error:
            self._break_off(error)
            raise

    def end(self, executor: Operated) -> None:
        """Close a run that has ended, and start to judge it; take the verdict of an earlier run."""
        if self._open is not None:
            run, ready, stack = self._open
            self._open = None
            stack.close()
            assert executor.ended is not None
            ended, why = executor.ended
            self._end_live()
            assert self._progress is not None
            share = executor.share_done
            time_s = self._time_s(executor) if share is None else self._at_share(share)
            name = str(self._progress["program"])
            self._completed[name] = self._completed.get(name, 0) + (ended is RunEnd.COMPLETED)
            self._progress |= {"time_s": time_s, "ended": ended.value, "why": why}
            self._progress["completed"] = self._completed[name]
            self._judging = self._pool.submit(self._judged, run, ready, ended.value, why)
        elif self._judging is not None and self._judging.done():
            future, self._judging = self._judging, None
            assert self._progress is not None
            try:
                self._progress["verdict"] = future.result().closing
            except (ThreadlineError, OSError) as error:
                why = error.message if isinstance(error, ThreadlineError) else str(error)
                self._progress["verdict"] = f"NOT JUDGED: {why}"

    def _judged(self, run: OpenRun, ready: Prepared, ended: str, why: str) -> _Finished:
        with suppress(StoreError):  # a locked index may be free when the verdict is stored
            run.over(ended, why)
        try:
            verdict, closing_text = judged_apart(run.trace, ready.to_send.plan, ready.spec)
        except RecordingError as error:
            if ready.again is None:
                raise
            text = f"NOT PROVEN: the rest of a job alone is not judged ({error.message})"
            run.unjudged(ended, text)
            return _Finished({}, text)
        content = {
            **verdict,
            **self._link,
            **self._entries_of(ready),
            "run": run.path.name,
            "trace": str(run.trace),
            "ended": ended,
            "hold_deviation_m": finite(ready.may.hold_deviation_m),
        }
        earlier_runs = joined_with(run.trace)
        content |= {"judged_with": earlier_runs} if earlier_runs else {}
        not_written = run.judged(content, ended, why)
        if earlier_runs:
            addition = f"; {as_one(earlier_runs)}"
        else:
            addition = f"; the rest of {ready.continues} alone" if ready.again is not None else ""
        addition += f"; {not_written}" if not_written else ""
        return _Finished(content, closing_text + addition)

    @staticmethod
    def _entries_of(ready: Prepared) -> dict[str, str]:
        """Return the entries for a run's recording and verdict: the override and the origin."""
        entries = {"override": ready.override} if ready.override else {}
        if ready.again is not None:
            operation = str(ready.again.rest.operation)
            entries |= {"continues": ready.continues, "from_operation": operation}
        return entries

    def progress(self, executor: Operated) -> dict[str, Any] | None:
        """Return the progress of the open run, or the last run's final one; None without a run.

        ``time_s`` does not advance during a hold, so the time left is the time without holds.
        """
        if self._progress is None or self._open is None:
            return self._progress
        if self._live is not None:
            self._progress["contour"] = self._live.report()
        share = executor.share_done
        time_s = self._time_s(executor) if share is None else self._at_share(share)
        ready = self._open[1]
        return {**self._progress, "time_s": time_s, **next_hold(ready.rests_s, time_s)}

    def _end_live(self) -> None:
        """End the live measurement of the contour error, and keep its last report."""
        live, self._live = self._live, None
        if live is None or self._progress is None:
            return
        live.close()
        self._progress["contour"] = live.report()
        if live.failed:
            self._tell(f"the error of the run was not followed to its end: {live.failed}", True)

    def _time_s(self, executor: Operated) -> float:
        """Return the present instant of the whole job, s, from the plan times of the recording.

        If the machine reports no plan times, the duration of each hold is subtracted instead.
        """
        if self._tells:
            due_s, _ = self._plan_clock.at(np.array([executor.time_s]))
            return self._left_out_s + float(due_s[0])
        period_s = self._period_s
        held_s = executor.time_s - (self._held_from or 0) * period_s
        held_now_s = 0.0 if self._held_from is None else held_s
        return self._left_out_s + executor.time_s - self._held * period_s - max(held_now_s, 0.0)

    def _at_share(self, share: float) -> float:
        """Return the instant of the whole job at a share of its commands, s."""
        assert self._progress is not None
        whole_s = float(self._progress["duration_s"])
        return self._left_out_s + share * (whole_s - self._left_out_s)

    def _break_off(self, error: BaseException | None) -> None:
        if self._open is not None:
            self._end_live()
            stack = self._open[2]
            self._open = None
            stack.__exit__(type(error) if error else None, error, None)

    def close(self, error: BaseException | None) -> None:
        """Close an open run, as ended by ``error``; wait for the threads."""
        self._break_off(error)
        self._pool.shutdown(wait=True)


def next_hold(rests_s: FloatArray | None, time_s: float) -> dict[str, Any]:
    """Return the place at which a hold would take effect now, as fields of ``Progress``.

    Parameters
    ----------
    rests_s
        (n, 2) begin and end of the rests for which a hold waits, s; None: it takes effect at once.
    time_s
        Instant of the plan, s.

    Examples
    --------
    >>> next_hold(np.array([[1.0, 2.0], [5.0, 6.0]]), 1.97)
    {'hold': 'at a rest', 'hold_at_s': 5.0}
    >>> next_hold(np.zeros((0, 2)), 1.0)
    {'hold': 'at the end', 'hold_at_s': None}
    """
    if rests_s is None:
        return {"hold": "at once", "hold_at_s": None}
    rests_ahead_s = rests_s[rests_s[:, 1] - np.maximum(rests_s[:, 0], time_s) >= REST_S - 1e-9]
    if not len(rests_ahead_s):
        return {"hold": "at the end", "hold_at_s": None}
    return {"hold": "at a rest", "hold_at_s": round(float(max(rests_ahead_s[0, 0], time_s)), 3)}
