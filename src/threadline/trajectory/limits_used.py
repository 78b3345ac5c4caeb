"""How much of each of its limits a motion uses, as bounds that hold at every instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from threadline.arrays import FloatArray, Locked, read_only
from threadline.trajectory.extremes import hull_of
from threadline.trajectory.optimal.along_path import across, true_shares
from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.optimal.path_elements import restricted
from threadline.trajectory.optimal.two_sided import asked
from threadline.trajectory.types import Trajectory, TrajectoryBlock

_PARTS = 4  # of a polynomial in time: the bounds of its parts are nearer to it


@dataclass(frozen=True, kw_only=True, eq=False)
class Retimed(Locked, Trajectory):
    """A motion with what it uses of its limits.

    Parameters
    ----------
    shares
        By the name of the limit: the (axes,) largest shares of what each axis may do, and the (1,)
        shares of what is limited along the path. Those of the axes and of ``centripetal`` are
        proven: no instant has more, because Bernstein's coefficients bound polynomials. The three
        along the path are the largest of thirteen instants of each polynomial in time.
    start
        (axes,) the first point, where the motion stands for good if there is no way to go.
    """

    shares: Mapping[str, FloatArray] = field(default_factory=dict)
    start: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start, "start", ndim=1))

    def __call__(self, time_s: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the (m, axes) ``derivative``-th derivative, as ``Trajectory`` does."""
        found = super().__call__(time_s, derivative)
        if derivative == 0 and self.duration_s == 0.0:
            found[:] = self.start
        return found

    @property
    def bound(self) -> float:
        """The largest of all shares; at most 1 but for rounding."""
        return max((float(share.max()) for share in self.shares.values()), default=0.0)


def limits_used(trajectory: Trajectory, limits: Limits) -> dict[str, FloatArray]:
    """Return bounds of the shares of its limits that a motion uses, as ``Retimed`` has them."""
    out: dict[str, FloatArray] = {}
    for block in trajectory:
        for name, share in _of_block(block, limits).items():
            out[name] = np.maximum(share, out.get(name, 0.0))
    return out


def _of_block(block: TrajectoryBlock, limits: Limits) -> dict[str, FloatArray]:
    c, duration_s = _parted(block)
    rates = [c]
    for _ in range(3):
        last = rates[-1]
        rates.append(last[:, 1:] * np.arange(1.0, last.shape[1])[:, None])
    v, a, j = (_hull(rates[k]) / duration_s[:, None, None] ** k for k in (1, 2, 3))
    own = limits.along
    out = {
        "velocity": np.abs(v).max(axis=(0, 1)) / limits.velocity,
        "acceleration": asked(v, a, limits.sides).max(axis=0),
        "jerk": np.abs(j).max(axis=(0, 1)) / limits.jerk,
    }
    if own is not None:
        names = ("path_velocity", "path_acceleration", "path_jerk")
        for name, share in zip(names, true_shares(c, duration_s, own), strict=True):
            out[name] = np.array([share])
        most = float((across(c * own.radius_m) / duration_s**2).max())
        out["centripetal"] = np.array([most / own.centripetal])
    return out


def _parted(block: TrajectoryBlock) -> tuple[FloatArray, FloatArray]:
    """Return the polynomials of a block as those of their parts, and the (n,) times of these."""
    order = max(block.coefficients.shape[1], 4)
    pad = ((0, 0), (0, order - block.coefficients.shape[1]), (0, 0))
    c = np.repeat(np.pad(block.coefficients, pad), _PARTS, axis=0)
    begin = np.tile(np.arange(_PARTS) / _PARTS, len(block))
    return (
        restricted(c, begin, np.full(len(c), 1.0 / _PARTS)),
        np.repeat(block.duration_s, _PARTS) / _PARTS,
    )


def _hull(poly: FloatArray) -> FloatArray:
    """Return the (n, order, axes) Bernstein coefficients of polynomials."""
    n, order, axes = poly.shape
    flat = np.moveaxis(poly, 1, 0).reshape(order, n * axes)
    return np.moveaxis(hull_of(flat).reshape(order, n, axes), 0, 1)
