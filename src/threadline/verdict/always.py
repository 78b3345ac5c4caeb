"""The criteria that every verdict lists, whatever the specification says, and the machine's limits.

They depend on what moves: a servo axis, an axis driven by pulses or one of which limits alone are
known, a cylinder, or an axis that plays step tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from threadline.machine import Machine

PLAN_DEMANDS = ("travel", "velocity", "acceleration", "jerk")
BRAKING, PATH_USE = "deceleration", "path_use"
"""Measures of plans on machines with limits of braking, and of the way of the tool."""
_SWITCHING_LIMITS = ("switching_order", "switching_dwell", "valve_conflict", "over_level")


@dataclass(frozen=True, slots=True, kw_only=True)
class Always:
    """The criteria of all machines of one kind of axis.

    Parameters
    ----------
    listed
        Measures that every verdict lists.
    limited
        Those among them whose limit is the machine's own.
    limit
        Returns the machine's limit, SI, of a measure for an axis; None where it has none.
    keys
        Further keys that a criterion of such a machine may have in a specification.
    """

    listed: tuple[str, ...]
    limited: tuple[str, ...]
    limit: Callable[[Machine, str, str], float | None]
    keys: tuple[str, ...] = ()


def _of_axis(machine: Machine, measure: str, axis: str) -> float | None:
    if measure == PATH_USE:
        return 1.0
    limits = machine.axes[axis]
    if measure == "travel":
        return None if limits.endless else 0.0
    own = {
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
        BRAKING: limits.deceleration or limits.acceleration,
        "jerk": limits.jerk,
    }[measure]
    return None if own is None else own.si


def _of_cylinder(machine: Machine, measure: str, axis: str) -> float | None:  # noqa: ARG001
    over = machine.plc is None or machine.plc.never_over
    return 0.0 if over or measure != "over_level" else None


_AXIS = Always(
    listed=(*PLAN_DEMANDS, "path_deviation", "tracking_error", "dac_saturation"),
    limited=PLAN_DEMANDS,
    limit=_of_axis,
)


def _of_pulsed(machine: Machine, measure: str, axis: str) -> float | None:
    return 1.0 if measure == "step_loss" else _of_axis(machine, measure, axis)


_PULSED = Always(
    listed=(*PLAN_DEMANDS, "path_deviation", "tracking_error", "step_loss"),
    limited=(*PLAN_DEMANDS, "step_loss"),
    limit=_of_pulsed,
)
_KINEMATIC = Always(listed=(*PLAN_DEMANDS, "path_deviation"), limited=PLAN_DEMANDS, limit=_of_axis)
_STITCH_LIMITS = ("servo_force", "window_use", "step_rate", "fetch_use", "travel")


def _of_stitched(machine: Machine, measure: str, axis: str) -> float | None:
    if measure == "step_rate":
        assert machine.tables is not None
        return machine.tables.step_rate.si
    return _of_axis(machine, measure, axis) if measure == "travel" else 1.0


_STEPPED = Always(
    listed=("stitch_residual", *_STITCH_LIMITS), limited=_STITCH_LIMITS, limit=_of_stitched
)
_CYLINDER = Always(
    listed=(
        "residual_vibration",
        "settling_time",
        "end_position_error",
        "cycle_time",
        "travel",
        *_SWITCHING_LIMITS,
        "switching_error",
    ),
    limited=("travel", *_SWITCHING_LIMITS),
    limit=_of_cylinder,
    keys=("step",),
)
_BY_WHAT_MOVES: Mapping[str, Always] = {
    "linear": _AXIS,
    "rotary": _AXIS,
    "stepper": _PULSED,
    "pulse-servo": _PULSED,
    "kinematic": _KINEMATIC,
    "stepped": _STEPPED,
    "cylinder": _CYLINDER,
}


def always_of(machine: Machine) -> Always:
    """Return the criteria of a machine that hold whatever its specification says."""
    always = _BY_WHAT_MOVES[next(iter(machine.moving.values()))]
    braking = any(axis.deceleration is not None for axis in machine.axes.values())
    own = (*(BRAKING,) * braking, *(PATH_USE,) * (machine.path is not None))
    return replace(always, listed=(*always.listed, *own), limited=(*always.limited, *own))
