"""Work for a run in other processes: the simulations before it, and its verdict.

In the process that owns the machine they would take processor time from the executor, and some
90 MB of memory that are never returned. Requests and results go through pipes.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from threadline.base.importing import import_and_call, program_apart
from threadline.commands.plan import Plan
from threadline.errors import CommandError, InputError, RecordingError, ThreadlineError
from threadline.live.store.whole_trace import whole_recording
from threadline.live.supervised import Interventions, interventions
from threadline.verdict import Spec, closing, judge, verdict_json

_JUDGE = import_and_call("threadline.panel.run_work", "judge_main")
_TRY = import_and_call("threadline.panel.run_work", "interventions_main")
_NICE = 10  # the executor comes first


def interventions_apart(plan: Plan, spec: Spec) -> Interventions:
    """Return the effect of holds and overrides on a plan's work, simulated in another process.

    Raises
    ------
    CommandError
        If the other process cannot be started, ends without an answer, or cannot simulate them.
    """
    answer = _asked(_TRY, (plan, spec), "the process that simulates holds and overrides")
    if isinstance(answer, str):
        raise CommandError(f"holds and overrides of the run cannot be simulated: {answer}")
    assert isinstance(answer, Interventions)
    return answer


def interventions_main() -> None:
    """Simulate holds and overrides of the plan on standard input; write their effect."""
    plan, spec = pickle.load(sys.stdin.buffer)  # noqa: S301  # written by the parent process
    try:
        answer: Interventions | str = interventions(plan, spec)
    except ThreadlineError as error:
        answer = error.message
    sys.stdout.buffer.write(pickle.dumps(answer))


def judged_apart(trace: Path, plan: Plan, spec: Spec) -> tuple[Mapping[str, Any], str]:
    """Return the verdict on the recording of a run, as JSON and in a line, from another process.

    Raises
    ------
    RecordingError
        If the recording cannot be judged.
    CommandError
        If the other process cannot be started, or ends without an answer.
    """
    answer: tuple[Mapping[str, Any], str] | str = _asked(
        _JUDGE, (trace.absolute(), plan, spec), "the process that judges"
    )
    if isinstance(answer, str):
        raise RecordingError(answer)
    return answer


def judge_main() -> None:
    """Judge the recording named on standard input; write the verdict, or why there is none."""
    os.nice(_NICE)
    trace, plan, spec = pickle.load(sys.stdin.buffer)  # noqa: S301  # written by the parent process
    try:
        verdict = judge([whole_recording(trace)], plan, spec)
        answer: tuple[Mapping[str, Any], str] | str = (
            verdict_json(verdict, plan),
            closing(verdict),
        )
    except InputError as error:
        answer = error.message
    sys.stdout.buffer.write(pickle.dumps(answer))


def _asked(child: str, request: object, name: str) -> Any:
    """Send an object to a Python process, and return its answer; ``name`` names it in errors."""
    try:
        process = subprocess.run(  # noqa: S603  # this interpreter with fixed arguments
            program_apart(child),
            input=pickle.dumps(request),
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
            check=False,
        )
    except OSError as error:
        raise CommandError(f"{name} cannot be started: {error.strerror or error}") from error
    if process.returncode:
        raise CommandError(f"{name} has ended without an answer")
    return pickle.loads(process.stdout)  # noqa: S301  # written by the child process
