"""With what each axis of a plan brakes."""

from __future__ import annotations

import numpy as np

from threadline.plan import Plan
from threadline.trajectory.extremes import derivatives, highest, in_direction
from threadline.verdict.always import BRAKING
from threadline.verdict.finding import Finding


def measure_braking(plan: Plan) -> dict[str, list[Finding]]:
    """Return the exact largest acceleration against the motion of each axis.

    A step of the velocity is none: it is counted as an acceleration.
    """
    axes = plan.motion.trajectory.axes
    worst = [Finding(value=0.0, axis=axis) for axis in axes]
    for block in plan.motion.trajectory:
        for column, axis in enumerate(axes) if len(block) else ():
            polys = derivatives(block, column, 2)
            toward, piece, begin, width = in_direction(polys[1], polys[2])
            known = worst[column].value
            found = highest(-toward, 0.0 if known is None else known)
            if found is None:
                continue
            value, part, place = found
            k, where = int(piece[part]), float(begin[part] + place * width[part])
            position = block.coefficients[k].T @ where ** np.arange(block.coefficients.shape[1])
            worst[column] = Finding(
                value=value,
                axis=axis,
                time_s=float(block.start_s[k] + where * block.duration_s[k]),
                operation=int(block.operation[k]),
                position=tuple(position.tolist()),
            )
    return {BRAKING: worst}
