"""The verdict on a plan that the machine's own limits refuse."""

from __future__ import annotations

from threadline.errors import LimitError
from threadline.machine import Machine
from threadline.verdict import Result, Status, Verdict

_PER = {"travel": "", "velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}


def beyond(error: LimitError, machine: Machine) -> Verdict:
    """Return the verdict on a plan that breaks a limit: the criterion of that limit failed."""
    over = error.quantity == "travel"
    base = "rad" if machine.axes[error.axis].kind == "rotary" else "m"
    failed = Result(
        name=error.quantity,
        axis=error.axis,
        measured=abs(error.value_si - error.limit_si) if over else abs(error.value_si),
        limit=0.0 if over else error.limit_si,
        unit=f"{base}{_PER[error.quantity]}",
        status=Status.FAILED,
        note="the plan is refused",
    )
    return Verdict(results=(failed,), simulated=False)
