"""How a recording is opened beside a plan for the measures, by the type of the plan's intent."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from threadline.plan import Motion, Plan, Scheduled, Stitched
from threadline.signals import Recording
from threadline.verdict.measure import Run
from threadline.verdict.motion_run import motion_run
from threadline.verdict.stitch_run import StitchRun
from threadline.verdict.switch_run import SwitchRun


def _switch_run(recording: Recording, plan: Plan, lag_s: float) -> Run:  # noqa: ARG001
    """Return a run beside its schedule; it has no lag, because it waits for its inputs."""
    return SwitchRun(recording, plan)


def _stitch_run(recording: Recording, plan: Plan, lag_s: float) -> Run:  # noqa: ARG001
    """Return a run beside its stitches; it has no lag, because the needle tells their times."""
    return StitchRun(recording, plan)


RUNS: Mapping[type, Callable[[Recording, Plan, float], Run]] = {
    Motion: motion_run,
    Scheduled: _switch_run,
    Stitched: _stitch_run,
}
"""By intent: opens a recording beside its plan with the lag, s, that the specification allows."""


def open_run(recording: Recording, plan: Plan, lag_s: float) -> Run:
    """Return ``recording`` beside ``plan``, as its measures read it.

    Raises
    ------
    RecordingError
        If channels are absent without which nothing at all can be judged.
    """
    return RUNS[type(plan.intent)](recording, plan, lag_s)
