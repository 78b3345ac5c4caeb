"""What a motion uses of the limits along its path, at instants that lie close."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.trajectory.optimal.along_path import AlongPath
from threadline.trajectory.types import Trajectory

_PLACES = np.linspace(0.0, 1.0, 13)  # of each polynomial in time
_MOVING = 1e-3  # of the highest speed: nearer to rest there is no direction


@dataclass(frozen=True, slots=True, kw_only=True)
class PathUse:
    """The largest share that a motion uses of its limits along the path.

    Parameters
    ----------
    quantity
        Key of ``[path]`` in the machine file: that of the limit.
    share
        Used of it.
    limit_si
        That limit, m/s, m/s^2 or m/s^3.
    time_s, operation
        Where.
    """

    quantity: str
    share: float
    limit_si: float
    time_s: float
    operation: int


def along_shares(
    velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray, limits: AlongPath
) -> dict[str, FloatArray]:
    """Return the (n,) shares of each limit along the path, by the key of ``[path]``.

    Parameters
    ----------
    velocity, acceleration, jerk
        (n, axes) of the axes, in their own units.
    """
    v, a, j = (rate * limits.radius_m for rate in (velocity, acceleration, jerk))
    speed = _size(v)
    moving = speed > _MOVING * speed.max(initial=0.0)
    along = np.divide(v, speed[:, None], out=np.zeros_like(v), where=moving[:, None])
    push = (along * a).sum(axis=1)
    across = np.where(moving, _size(a - push[:, None] * along), 0.0)
    # The length of the way gone has the derivatives v, t a and t j + |a across|^2 / v.
    bent = np.divide(across**2, speed, out=np.zeros_like(speed), where=moving)
    up, down = limits.sides
    return {
        name: np.asarray(share)
        for name, share, limit in (
            ("velocity", speed / limits.velocity, limits.velocity),
            ("acceleration", np.maximum(push, 0.0) / up, up),
            ("deceleration", np.maximum(-push, 0.0) / down, down),
            ("jerk", np.abs((along * j).sum(axis=1) + bent) / limits.jerk, limits.jerk),
            ("centripetal", across / limits.centripetal, limits.centripetal),
        )
        if np.isfinite(limit)
    }


def path_use(trajectory: Trajectory, limits: AlongPath) -> PathUse | None:
    """Return the largest share of thirteen instants of each polynomial; None for no motion."""
    worst: PathUse | None = None
    for block in trajectory:
        rates = [block.coefficients]
        for _ in range(3):
            last = rates[-1]
            rates.append(last[:, 1:] * np.arange(1.0, last.shape[1])[:, None])
        powers = [_PLACES[:, None] ** np.arange(rate.shape[1]) for rate in rates]
        time_s = block.duration_s[:, None, None]
        v, a, j = (
            (np.einsum("pk,nka->npa", powers[k], rates[k]) / time_s**k).reshape(
                -1, len(limits.radius_m)
            )
            for k in (1, 2, 3)
        )
        for name, share in along_shares(v, a, j, limits).items():
            at = int(np.argmax(share))
            if worst is None or share[at] > worst.share:
                piece, place = divmod(at, len(_PLACES))
                lasted = _PLACES[place] * block.duration_s[piece]
                worst = PathUse(
                    quantity=name,
                    share=float(share[at]),
                    limit_si=limits.named(name),
                    time_s=float(block.start_s[piece] + lasted),
                    operation=int(block.operation[piece]),
                )
    return worst


def _size(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors**2).sum(axis=1)))
