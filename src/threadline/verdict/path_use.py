"""How much a plan uses of what the tool may do along its path."""

from __future__ import annotations

from threadline.plan import Plan
from threadline.trajectory.optimal.along_shares import path_use
from threadline.trajectory.optimal.drives import along_of
from threadline.verdict.always import PATH_USE
from threadline.verdict.finding import Finding


def measure_path_use(plan: Plan) -> dict[str, list[Finding]]:
    """Return the largest share of the limits along the path, and of which, at close instants.

    Where the speed steps between two pieces of a historical plan, the step is not counted.
    """
    along = along_of(plan.machine, plan.motion.path.radius_m)
    if along is None:
        none = Finding(value=None, note="the machine file has no [path] with a limit")
        return {PATH_USE: [none]}
    used = path_use(plan.motion.trajectory, along)
    if used is None:
        return {PATH_USE: [Finding(value=0.0)]}
    worst = Finding(
        value=used.share,
        time_s=used.time_s,
        operation=used.operation,
        note=f"of path.{used.quantity}",
    )
    return {PATH_USE: [worst]}
