"""The answer of a tuning: the loops of each axis, and jobs run with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from threadline.base.summary import Summarised, Summary
from threadline.dynamics.analysis import LoopFigures
from threadline.dynamics.loop_design import NAMES, ControllerKind, with_controller
from threadline.dynamics.responses import Step
from threadline.dynamics.worst_margins import WorstMargins
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.search.ziegler_nichols import Ultimate
from threadline.verdict import Verdict

Rule: TypeAlias = Literal["file", "margin", "ultimate", "step", "settling"]


RULES: tuple[Rule, ...] = ("margin", "ultimate", "step", "settling")


MEASURES = ("contour_error", "stitch_length_error", "settling_time", "current_peak")


def label(kind: ControllerKind, rule: Rule) -> str:
    """Return the name of a controller for people, such as ``"PD, margin"``."""
    return f"{NAMES[kind]}, {rule}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TunedLoop:
    """A controller for one axis.

    Parameters
    ----------
    axis, kind, rule
        Its axis, its kind, and the rule that chose its gains (``"file"``: the machine file).
    gains
        DAC levels per count; zero and pole of ``lead`` without unit.
    figures
        The sampled loop.
    worst
        Margins over the tolerances of the machine file.
    step
        The response of the load to a step; None if the loop is unstable.
    """

    axis: str
    kind: ControllerKind
    rule: Rule
    gains: Mapping[str, float]
    figures: LoopFigures
    worst: WorstMargins
    step: Step | None

    @property
    def name(self) -> str:
        """Kind of controller and rule, for people."""
        return f"{NAMES[self.kind]}, {self.rule}"

    def content(self) -> dict[str, Any]:
        """Return the loop as JSON content."""
        figures = self.figures.as_json()
        shown_keys = ("stable", "bandwidth_hz", "gain_margin", "phase_margin_deg", "crossover_hz",
                "modulus_margin")  # fmt: skip
        return {
            "controller": self.kind,
            "rule": self.rule,
            "gains": dict(self.gains),
            **{key: figures[key] for key in shown_keys},
            "over_tolerances": {
                "stable": self.worst.stable,
                "phase_margin_deg": self.worst.phase_margin_deg,
                "gain_margin": self.worst.gain_margin,
                "at": dict(self.worst.at),
            },
            "settling_s": None if self.step is None else self.step.settling_s,
            "overshoot": None if self.step is None else self.step.overshoot,
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TunedAxis:
    """The loops of one axis.

    Parameters
    ----------
    axis
        Its name.
    limit
        Ultimate gain and period of a proportional controller on the twin; None if there is none.
    smooth_kp
        Largest proportional gain whose step response does not overshoot.
    loops
        Every controller, in the order of the rules.
    left_out
        Controllers that do not exist, with the reason.
    """

    axis: str
    limit: Ultimate | None
    smooth_kp: float | None
    loops: tuple[TunedLoop, ...]
    left_out: tuple[str, ...]

    def loop(self, kind: ControllerKind, rule: Rule) -> TunedLoop:
        """Return one of its loops.

        Raises
        ------
        OptionError
            If there is none.
        """
        for one in self.loops:
            if (one.kind, one.rule) == (kind, rule):
                return one
        loops_there = ", ".join(f"{one.kind} by {one.rule}" for one in self.loops)
        raise OptionError(
            f"axis {self.axis} has no controller {kind} by {rule}", remedy=f"It has: {loops_there}."
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JobRun:
    """A job with one kind of controller on every axis, on the twin, in one run.

    Parameters
    ----------
    job, kind, rule
        File of the job, and the controllers.
    verdict
        Its verdict; None if a loop is unstable.
    """

    job: str
    kind: ControllerKind
    rule: Rule
    verdict: Verdict | None

    def worst(self, measure: str) -> float | None:
        """Return the largest value of a measure of all axes, SI; None if it was not measured."""
        if self.verdict is None:
            return None
        values = [
            one.measured
            for one in self.verdict.results
            if one.name == measure and one.measured is not None
        ]
        return max(values, default=None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Tuning(Summarised):
    """The answer of ``tune``; prints itself as a table.

    Parameters
    ----------
    machine
        The machine.
    axes
        The loops of each axis.
    runs
        The jobs with each kind of controller.
    """

    machine: Machine
    axes: tuple[TunedAxis, ...]
    runs: tuple[JobRun, ...] = field(default=())

    def tuned(self, kind: ControllerKind, rule: Rule = "margin") -> Machine:
        """Return the machine with one kind of controller on the axes that were tuned.

        Raises
        ------
        OptionError
            If an axis has no such controller.
        """
        machine = self.machine
        for axis in self.axes:
            loop = axis.loop(kind, rule)
            machine = with_controller(machine, axis.axis, kind, loop.gains)
        return machine

    def _summary(self) -> Summary:
        rows = []
        for axis in self.axes:
            for loop in axis.loops:
                figures = loop.figures.as_json()
                cells = [figures[key] for key in ("crossover_hz", "phase_margin_deg")]
                gains = " ".join(f"{key} {value:.4g}" for key, value in loop.gains.items())
                shown = ["-" if cell is None else f"{cell:.1f}" for cell in cells]
                stable = "stable" if loop.figures.stable else "unstable"
                rows.append([axis.axis, loop.name, gains, *shown, stable])
        header = ["axis", "controller", "gains", "crossover Hz", "phase margin deg", "loop"]
        return Summary(f"Controllers of {self.machine.name}", header, rows)

    def content(self) -> dict[str, Any]:
        """Return the answer as JSON content."""
        return {
            "machine": self.machine.name,
            "axes": {
                one.axis: {
                    "ultimate_kp": None if one.limit is None else one.limit.kp,
                    "ultimate_period_s": None if one.limit is None else one.limit.period_s,
                    "kp_without_overshoot": one.smooth_kp,
                    "loops": [loop.content() for loop in one.loops],
                    "left_out": list(one.left_out),
                }
                for one in self.axes
            },
            "jobs": [
                {
                    "job": run.job,
                    "controller": run.kind,
                    "rule": run.rule,
                    "stable": run.verdict is not None,
                    **{name: _finite(run.worst(name)) for name in MEASURES},
                }
                for run in self.runs
            ],
        }


def _finite(value: float | None) -> float | None:
    return value if value is None or math.isfinite(value) else None
