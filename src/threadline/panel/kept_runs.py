"""Runs of the panel: the check of the proof beforehand, the store, and the verdict afterwards.

Check and verdict take seconds, while the executor keeps listening, and may move. So the check is a
thread, whose start is dropped if another command comes, and the judge is a process.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import finite
from threadline.base.importing import import_and_call
from threadline.base.reading import inputs_read, noting_inputs
from threadline.commands.plan import Plan
from threadline.errors import (
    CommandError,
    InputError,
    ProofError,
    RecordingError,
    StoreError,
    ThreadlineError,
)
from threadline.files import Channel, RecordingBlock
from threadline.live.continuing import (
    Continued,
    ContinuedSink,
    continued_by,
    last_executed,
    operation_at,
)
from threadline.live.kinds_run import run_kind_of
from threadline.live.operated import Load, Operated
from threadline.live.states import Cause, Sink, State
from threadline.live.store.run_store import OpenRun, RunStore
from threadline.live.store.whole_trace import (
    as_one,
    joined_with,
    refuse_other_rows,
    trace_of,
    unfinished_run,
    whole_recording,
)
from threadline.live.supervised import (
    Interventions,
    check_halts,
    check_override,
    check_runnable,
    interventions,
)
from threadline.machine import Machine
from threadline.panel.programs import planned
from threadline.proof.pipeline import with_shaping
from threadline.proof.proof_file import ProofFile
from threadline.verdict import Spec, closing, judge, load_spec, verdict_json
from threadline.verdict.progress import PlanClock

_JUDGE = import_and_call("threadline.panel.kept_runs", "judge_main")
_NICE = 10  # the executor comes first


@dataclass(frozen=True, slots=True)
class Prepared:
    """A run that may begin: its proof was compared with the present files.

    Parameters
    ----------
    number
        Number of the request.
    stops
        Number of stops received when it was requested.
    may
        What holds and overrides of the feed do to its work.
    again, continues
        The rest of an interrupted run, and that run's name; else None, and empty.
    """

    number: int
    stops: int
    load: Load
    spec: Spec
    proof: ProofFile
    override: str | None
    inputs: tuple[Path, ...]
    may: Interventions
    again: Continued | None = None
    continues: str = ""

    def moves(self, machine: Machine) -> list[tuple[str, int]]:
        """Return the moves to where the rest begins, in their order."""
        assert self.again is not None
        return list(zip(machine.axes, self.again.rest.begins.tolist(), strict=False))

    def rest_notes(self) -> dict[str, Any]:
        """Return what the operator must know before confirming the rest."""
        assert self.again is not None
        return {"run": self.continues, "told": list(self.again.notes)}


@dataclass(frozen=True, slots=True)
class _Finished:
    content: Mapping[str, Any]
    closing: str


class KeptRuns:
    """Prepares, keeps and judges runs; the sink of the executor.

    Parameters
    ----------
    folder
        Folder of the programs.
    machine, spec_file
        The machine, and the specification; None: the machine's own.
    store
        Folder of the runs.
    link, label, speed
        Entries for the index; see ``AtLink``.
    said
        Called with a text for people, and whether something is wrong.

    Attributes
    ----------
    why
        The reason of the latest change of state, if it had one.
    """

    def __init__(
        self,
        folder: Path,
        machine: Machine,
        spec_file: Path | None,
        store: Path,
        link: str,
        label: str,
        speed: float,
        said: Callable[[str, bool], None],
    ) -> None:
        self._folder, self._machine, self._spec_file = folder, machine, spec_file
        self._store, self._speed, self._said = store, speed, said
        self._link = {"link": link, **({"label": label} if label else {})}
        self._pool = ThreadPoolExecutor(1)
        self._preparing: tuple[Future[Prepared], int, int] | None = None
        self._given_up = ""  # the command that came instead of the start being checked
        self._judging: Future[_Finished] | None = None
        self._channels: tuple[Channel, ...] = ()
        self._simulated = True
        self._sink: Sink | None = None  # of the open run
        self._left_out_s = 0.0  # of its commands, if it does the rest of a job
        self._open: tuple[OpenRun, Prepared, ExitStack] | None = None
        self._progress: dict[str, Any] | None = None
        self._held = 0  # ticks of the run spent in holds
        self._held_from: int | None = None  # tick at which the present hold began
        self._tells = run_kind_of(machine).reports_plan_time
        self._plan_clock = PlanClock(machine.command_clock)
        self.why = ""
        self._state: State | None = None

    # --- the sink of the executor ----------------------------------------------------------

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Keep the channels for later runs."""
        self._channels, self._simulated = channels, simulated

    def block(self, block: RecordingBlock) -> None:
        """Write a block into the open run."""
        if self._open is not None and self._sink is not None:
            self._sink.block(block)
            self._plan_clock.take(block.events)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Keep the reason of a change of state, and write the change into the open run."""
        # A stop in a fault keeps the fault's reason; an override is shown by itself.
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

    def give_up(self, asked: str) -> None:
        """Drop a start that is being checked: another command came."""
        self._given_up = self._given_up or asked

    def prepare(self, told: Mapping[str, Any], stops: int, executor: Operated) -> None:
        """Begin to check a requested run; ``prepared`` returns the result."""
        number = int(told["number"])
        self._given_up = ""
        work = self._pool.submit(self._prepared, told, stops, executor)
        self._preparing = (work, number, stops)

    def prepared(self) -> Prepared | tuple[int, str] | None:
        """Return the prepared run, or its number and the refusal; None while it is checked."""
        if self._preparing is None or not self._preparing[0].done():
            return None
        future, number, _ = self._preparing
        self._preparing = None
        try:
            found = future.result()
        except (ThreadlineError, OSError) as error:
            return number, str(error)
        if self._given_up:
            return number, f"it was not begun: the command {self._given_up!r} came meanwhile"
        return found

    def _prepared(self, told: Mapping[str, Any], stops: int, executor: Operated) -> Prepared:
        """Plan the program again, and compare the plan with the proof, hash by hash."""
        proof_file = Path(str(told["proof_file"]))
        override = None if told["override"] is None else str(told["override"])
        check_override(override)
        with noting_inputs():
            plan, options = planned(self._folder, told, self._machine)
            asked = load_spec(self._spec_file, self._machine)
            spec = with_shaping(asked, self._machine, options)
            check_halts(plan, answered=True)
            proof = check_runnable(proof_file, plan, spec, override)
            inputs = tuple(file for file in inputs_read() if not file.samefile(proof_file))
        if proof.content["sha256"] != told["proof"]:
            raise ProofError("it is not the proof that was shown", remedy="Calculate it again.")
        may = interventions(plan, spec)
        load, number = executor.prepare(plan), int(told["number"])
        load = replace(load, notes=(*load.notes, *may.notes))
        found = Prepared(number, stops, load, spec, proof, override, inputs, may)
        if "run" not in told:
            return found
        return self._rest_of(str(told["run"]), str(told["at"]), found, executor)

    def _rest_of(self, run: str, at: str, whole: Prepared, executor: Operated) -> Prepared:
        """Return the rest of an interrupted run; its approach is checked."""
        folder, record = unfinished_run(self._store, run)
        plan = whole.load.plan
        refuse_other_rows(record, plan)
        operation = operation_at(plan, last_executed(trace_of(folder, record)), at)
        load = executor.rest(whole.load, operation, at_rest=whole.may.hold_at_rest)
        assert load.rest is not None
        again = continued_by(plan, load.rest)
        return replace(whole, load=load, again=again, continues=folder.name)

    def set_out(self, ready: Prepared, executor: Operated) -> None:
        """Open the run in the store, and begin it.

        Raises
        ------
        CommandError
            If the machine is not idle, or the run begins elsewhere.
        """
        plan, sent = ready.load.plan, ready.load.sent
        told = {**self._link, **self._known_of(ready)}
        executor.refuse(ready.load)
        for note in ready.load.notes:
            self._said(note, False)
        run = RunStore(self._store).begin(plan, ready.proof, told, self._speed, ready.inputs, sent)
        stack = ExitStack()
        stack.enter_context(run)
        rest, self._sink = ready.load.rest, run
        self._left_out_s = 0.0
        if rest is not None:
            self._sink = ContinuedSink(run, self._machine, rest.left_out, rest.operation)
            self._left_out_s = rest.left_out * float(self._machine.command_clock.period_s)
        self._sink.begin(self._channels, self._simulated)
        self._open = (run, ready, stack)
        self._held, self._held_from = 0, None
        self._plan_clock = PlanClock(self._machine.command_clock)
        self._progress = {
            "run": run.path.name,
            "program": plan.job.name,
            "time_s": self._left_out_s,
            "duration_s": plan.duration_s,
        }
        try:
            may = ready.may
            executor.run(ready.load, hold_at_rest=may.hold_at_rest, no_override=may.no_override)
        except ThreadlineError as error:
            self._break_off(error)
            raise

    def end(self, executor: Operated) -> None:
        """Close a run that is over, and start judging it; accept the verdict of the last one."""
        if self._open is not None:
            run, ready, stack = self._open
            self._open = None
            stack.close()
            assert executor.ended is not None
            ended, why = executor.ended
            assert self._progress is not None
            share = executor.share_done
            time_s = self._time_s(executor) if share is None else self._at_share(share)
            self._progress |= {"time_s": time_s, "ended": ended.value, "why": why}
            self._judging = self._pool.submit(self._judged, run, ready, ended.value, why)
        elif self._judging is not None and self._judging.done():
            future, self._judging = self._judging, None
            assert self._progress is not None
            try:
                self._progress["verdict"] = future.result().closing
            except (ThreadlineError, OSError) as error:
                self._said(f"the run could not be judged: {error}", True)

    def _judged(self, run: OpenRun, ready: Prepared, ended: str, why: str) -> _Finished:
        with suppress(StoreError):  # a locked index may be free when the verdict is stored
            run.over(ended, why)
        try:
            verdict, closes = judged_apart(run.trace, ready.load.plan, ready.spec)
        except RecordingError as error:
            if ready.again is None:
                raise
            text = f"NOT PROVEN: the rest of a job alone is not judged ({error.message})"
            run.unjudged(ended, text)
            return _Finished({}, text)
        content = {
            **verdict,
            **self._link,
            **self._known_of(ready),
            "run": run.path.name,
            "trace": str(run.trace),
            "ended": ended,
            "hold_deviation_m": finite(ready.may.hold_deviation_m),
        }
        before = joined_with(run.trace)
        content |= {"judged_with": before} if before else {}
        unsaid = run.judged(content, ended, why)
        if before:
            told = f"; {as_one(before)}"
        else:
            told = f"; the rest of {ready.continues} alone" if ready.again is not None else ""
        told += f"; {unsaid}" if unsaid else ""
        return _Finished(content, closes + told)

    @staticmethod
    def _known_of(ready: Prepared) -> dict[str, str]:
        """Return the entries for a run's recording and verdict: the override and the origin."""
        told = {"override": ready.override} if ready.override else {}
        if ready.again is not None:
            operation = str(ready.again.rest.operation)
            told |= {"continues": ready.continues, "from_operation": operation}
        return told

    def progress(self, executor: Operated) -> dict[str, Any] | None:
        """Return the progress of the open run, or the end of the last one; None without one.

        Holds do not count: the time left of a run is its duration without them.
        """
        if self._progress is None or self._open is None:
            return self._progress
        if (share := executor.share_done) is not None:
            return {**self._progress, "time_s": self._at_share(share)}
        return {**self._progress, "time_s": self._time_s(executor)}

    def _time_s(self, executor: Operated) -> float:
        """Return the instant of the whole job that a run is at, s, from its recording.

        Without such events, each hold is subtracted from its command to its end.
        """
        if self._tells:
            due_s, _ = self._plan_clock.at(np.array([executor.time_s]))
            return self._left_out_s + float(due_s[0])
        period_s = float(self._machine.command_clock.period_s)
        held_s = executor.time_s - (self._held_from or 0) * period_s
        since = 0.0 if self._held_from is None else held_s
        return self._left_out_s + executor.time_s - self._held * period_s - max(since, 0.0)

    def _at_share(self, share: float) -> float:
        """Return the instant of the whole job at a share of its commands, s."""
        assert self._progress is not None
        whole_s = float(self._progress["duration_s"])
        return self._left_out_s + share * (whole_s - self._left_out_s)

    def _break_off(self, error: BaseException | None) -> None:
        if self._open is not None:
            stack = self._open[2]
            self._open = None
            stack.__exit__(type(error) if error else None, error, None)

    def close(self, error: BaseException | None) -> None:
        """Close an open run, as ended by ``error``; wait for the threads."""
        self._break_off(error)
        self._pool.shutdown(wait=True)


def judged_apart(trace: Path, plan: Plan, spec: Spec) -> tuple[Mapping[str, Any], str]:
    """Return the verdict on the recording of a run, as JSON and in a line, from another process.

    A judge in this process would take processor time from the executor.

    Raises
    ------
    RecordingError
        If the recording cannot be judged.
    CommandError
        If the other process cannot be started, or ends without an answer.
    """
    try:
        done = subprocess.run(  # noqa: S603  # this interpreter, and words of ours
            [sys.executable, "-c", _JUDGE],
            input=pickle.dumps((trace.absolute(), plan, spec)),
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
            check=False,
        )
    except OSError as error:
        raise CommandError(
            f"the process that judges cannot be started: {error.strerror or error}"
        ) from error
    if done.returncode:
        raise CommandError("the process that judges has ended without an answer")
    found: tuple[Mapping[str, Any], str] | str = pickle.loads(done.stdout)  # noqa: S301  # of our child
    if isinstance(found, str):
        raise RecordingError(found)
    return found


def judge_main() -> None:
    """Judge the recording named on standard input; write the verdict, or why there is none."""
    os.nice(_NICE)
    trace, plan, spec = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent, through a pipe
    try:
        verdict = judge([whole_recording(trace)], plan, spec)
        found: tuple[Mapping[str, Any], str] | str = (verdict_json(verdict, plan), closing(verdict))
    except InputError as error:
        found = error.message
    sys.stdout.buffer.write(pickle.dumps(found))
