"""What is asked of every machine beside its specification: what is always listed, and its limits.

By what moves: an axis with a path has limits of motion, a cylinder those of its valves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from threadline.machine import Machine

PLAN_DEMANDS = ("travel", "velocity", "acceleration", "jerk")
_SWITCHING_LIMITS = ("switching_order", "switching_dwell", "valve_conflict", "over_level")


@dataclass(frozen=True, slots=True, kw_only=True)
class Always:
    """What is asked of whatever moves in one way.

    Parameters
    ----------
    listed
        Measures that every verdict lists.
    limited
        Those among them whose limit is the machine's own.
    limit
        That limit: of a measure, for an axis; None where the machine has none.
    keys
        What a criterion may name besides.
    """

    listed: tuple[str, ...]
    limited: tuple[str, ...]
    limit: Callable[[Machine, str, str], float | None]
    keys: tuple[str, ...] = ()


def _of_axis(machine: Machine, measure: str, axis: str) -> float | None:
    limits = machine.axes[axis]
    if measure == "travel":
        return None if limits.endless else 0.0
    own = {
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
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


def _of_told(machine: Machine, measure: str, axis: str) -> float | None:
    return 1.0 if measure == "step_loss" else _of_axis(machine, measure, axis)


_TOLD = Always(
    listed=(*PLAN_DEMANDS, "path_deviation", "tracking_error", "step_loss"),
    limited=(*PLAN_DEMANDS, "step_loss"),
    limit=_of_told,
)
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
    "stepper": _TOLD,
    "pulse-servo": _TOLD,
    "stepped": _STEPPED,
    "cylinder": _CYLINDER,
}


def always_of(machine: Machine) -> Always:
    """Return what is asked of a machine, whatever its specification says."""
    return _BY_WHAT_MOVES[next(iter(machine.moving.values()))]
