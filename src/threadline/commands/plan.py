"""Plan: the intended work on a machine, with its commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from threadline.commands.feedforward import Following
from threadline.commands.intents import Intent, Motion, Scheduled
from threadline.commands.turns import Stitched
from threadline.errors import PlanError
from threadline.files import Commands
from threadline.jobs.feed_times import programmed_time_s
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine

__all__ = ["Following", "Intent", "Motion", "Plan", "Scheduled", "Stitched"]

IntentT = TypeVar("IntentT")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, weakref_slot=True)
class Plan:
    """All decisions before the machine moves, for any kind of work.

    Parameters
    ----------
    job, machine
        Job and machine of the plan.
    commands
        Commands for the controller.
    intent
        Intended result: paths and a trajectory, a schedule with its moves, or stitches.
    options
        Options of the plan (interpolation, feed, tolerance) as text, for people and recordings.
    """

    job: Job
    machine: Machine
    commands: Commands
    intent: Intent
    options: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Plan of {self.job.name!r} for {self.machine.name!r}>"

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the moving axes, in the order of all columns."""
        return self.intent.axes

    @property
    def duration_s(self) -> float:
        """Planned duration, s; late inputs make a job longer."""
        return self.intent.duration_s

    @property
    def feed_override(self) -> float | None:
        """Factor on the feeds of the job, 1 as programmed; None if another feed replaces them."""
        text = self.options.get("feed", "programmed")
        if text.endswith("%"):
            return float(text.removesuffix("%")) / 100.0
        return 1.0 if text == "programmed" else None

    @property
    def limits_in_full(self) -> bool:
        """Whether the plan may use the full limits of acceleration and jerk."""
        return float(self.options.get("limits", "100 %").removesuffix("%")) == 100.0

    @property
    def nominal_s(self) -> float | None:
        """Time by the programmed feeds alone, s; None without a rule for F, or with ``--feed``."""
        override = self.feed_override
        if not self.job.feed_rule or override is None:
            return None
        return programmed_time_s(self.job, self.machine, Feed(FeedMode.OVERRIDE, override))

    @property
    def interpolation(self) -> str:
        """The requested interpolation, or the name that takes its place."""
        return self.intent.interpolation(self.options)

    @property
    def planned_with(self) -> str:
        """Words for the planning method."""
        return self.intent.planned_with(self.options)

    def intended(self, intent_type: type[IntentT]) -> IntentT:
        """Return the intent of this plan, which must be of type ``intent_type``.

        Raises
        ------
        PlanError
            If the intent is of another type: a schedule has no path, and a path has no schedule.
        """
        if not isinstance(self.intent, intent_type):
            raise PlanError(
                f"{self.job.name} on {self.machine.name} is planned as "
                f"{type(self.intent).__name__}, not as {intent_type.__name__}",
                remedy="Take a machine and a job of the other kind.",
            )
        return self.intent

    @property
    def motion(self) -> Motion:
        """Paths and trajectory; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Motion)

    @property
    def scheduled(self) -> Scheduled:
        """Schedule and moves; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Scheduled)

    @property
    def stitched(self) -> Stitched:
        """Turns and stitches; PlanError (see ``intended``) for other kinds of work."""
        return self.intended(Stitched)
