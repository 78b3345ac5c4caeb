"""Limits along the path and across it: speed, its derivatives, and centripetal acceleration.

The path length travelled is treated as one more axis: a quintic polynomial on each part of a piece,
with the length and its first two derivatives at both ends. The axis limits apply to it too.
Centripetal acceleration at the path rate u' is ``u'^2`` times the part of q_uu across the path;
that is at most ``q_uu - l q_u`` for any l, and the control points of such a polynomial bound it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.extremes import hull_of
from threadline.motion.timing.optimal.elements import restricted
from threadline.motion.timing.types import Trajectory

_PARTS = 4  # of a curved piece: their length polynomials are 4^5 times as accurate as for the whole
_STRAIGHT = 1e-9  # of the largest derivative: below, the part across a straight line is rounding
_NODES, _WEIGHTS = (0.5 * (1.0 + np.polynomial.legendre.leggauss(8)[0]),
                    0.5 * np.polynomial.legendre.leggauss(8)[1])  # fmt: skip
_PLACES = np.linspace(0.0, 1.0, 13)  # of a polynomial in time, at which path limits are checked


@dataclass(frozen=True, slots=True, kw_only=True)
class AlongPath:
    """Limits of the tool along its path; each may be infinite.

    Parameters
    ----------
    velocity, acceleration, jerk
        Limits of the travelled path length's derivatives, m/s, m/s^2, m/s^3.
    deceleration
        Braking limit of the tool along its path, if it differs from ``acceleration``.
    centripetal
        Acceleration across the path, m/s^2.
    radius_m
        (axes,) length at the tool of one unit of each axis.
    """

    velocity: float
    acceleration: float
    jerk: float
    centripetal: float
    radius_m: FloatArray
    deceleration: float | None = None

    @property
    def accelerations(self) -> tuple[float, float]:
        """Limits of speeding up along the path, and of braking."""
        braking = self.acceleration if self.deceleration is None else self.deceleration
        return self.acceleration, braking

    def named(self, key: str) -> float:
        """Return the limit for a key of ``[path]`` in a machine file."""
        limit = getattr(self, key)
        return self.acceleration if limit is None else float(limit)

    @property
    def asks_for_rests(self) -> bool:
        """Whether the motion rests where the path turns back, since its speed has a kink there."""
        return bool(np.isfinite([*self.accelerations, self.jerk]).any())


def with_acceleration(
    along: AlongPath | None, acceleration: float, radius_m: FloatArray
) -> AlongPath | None:
    """Return limits combined with a limit of the acceleration along the path, m/s^2."""
    if not np.isfinite(acceleration):
        return along
    if along is None:
        return AlongPath(
            velocity=np.inf,
            acceleration=acceleration,
            jerk=np.inf,
            centripetal=np.inf,
            radius_m=radius_m,
        )
    up, down = (min(limit, acceleration) for limit in along.accelerations)
    return replace(along, acceleration=up, deceleration=down)


def divided(run: PieceBlock) -> PieceBlock:
    """Return the pieces with each curved one cut into equal parts."""
    straight = ~run.coefficients[:, 2:].any(axis=(1, 2))
    parts = np.where(straight, 1, _PARTS)
    piece = np.repeat(np.arange(len(run)), parts)
    count = parts[piece].astype(np.float64)
    part = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
    is_last = part == parts[piece] - 1
    return PieceBlock(
        coefficients=restricted(run.coefficients[piece], part / count, 1.0 / count),
        operation=run.operation[piece],
        nominal_s=run.nominal_s[piece] / count,
        rest_after=np.where(is_last, run.rest_after[piece], 0),
        dwell_s=np.where(is_last, run.dwell_s[piece], 0.0),
        line=run.line[piece],
    )


def with_length(c: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return (n, 6, axes + 1): pieces with the travelled path length as their last axis."""
    n, order, axes = c.shape
    at_tool_m = c * radius_m
    powers = np.arange(1, order)
    length_m = np.zeros(n)
    for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True):
        length_m += weight * _norm_along_path(_at(at_tool_m[:, 1:] * powers[:, None], node))
    first = at_tool_m[:, 1:] * powers[:, None]
    second = first[:, 1:] * powers[: order - 2, None]
    ends = []
    for u in (0.0, 1.0):
        rate, second_rate = _at(first, u), _at(second, u)
        speed = _norm_along_path(rate)
        acceleration_along = np.divide(
            (rate * second_rate).sum(axis=1), speed, out=np.zeros(n), where=speed > 0.0
        )
        ends.append((speed, acceleration_along))
    (v0, a0), (v1, a1) = ends
    rise_rest, velocity_rest, acceleration_rest = length_m - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    extended = np.zeros((n, 6, axes + 1))
    extended[:, :order, :axes] = c
    extended[:, :, axes] = np.stack(
        [
            np.cumsum(length_m) - length_m,
            v0,
            0.5 * a0,
            10.0 * rise_rest - 4.0 * velocity_rest + 0.5 * acceleration_rest,
            -15.0 * rise_rest + 7.0 * velocity_rest - acceleration_rest,
            6.0 * rise_rest - 3.0 * velocity_rest + 0.5 * acceleration_rest,
        ],
        axis=1,
    )
    straight = ~c[:, 2:].any(axis=(1, 2))
    extended[straight, 2:, axes] = 0.0
    return extended


def across(c: FloatArray) -> FloatArray:
    """Return (n,) bounds of the second derivative across the first, for (n, order, axes) curves.

    A curve that begins or ends at rest does so with the third power, as the elements do.
    """
    order = c.shape[1]
    powers = np.arange(1.0, order)
    ends = c[:, 1:] * powers[:, None]
    # A curve at rest at its end is reversed.
    size = np.abs(ends).max(axis=(1, 2))
    closes = np.abs(ends.sum(axis=1)).max(axis=1) <= _STRAIGHT * size
    reversed_c = restricted(c, np.ones(len(c)), -np.ones(len(c)))
    c = np.where(closes[:, None, None], reversed_c, c)
    first = c[:, 1:] * powers[:, None]
    opens = np.abs(first[:, :2]).max(axis=(1, 2)) <= _STRAIGHT * size
    second = np.zeros_like(first)
    second[:, : order - 2] = first[:, 1:] * powers[: order - 2, None]
    # At rest q_u is u^2 r: 2/u of it is a polynomial, and is along the path.
    second[opens, : order - 2] -= 2.0 * first[opens, 1:]
    second[opens, 0] = 0.0
    along_ratios = []
    for u in (0.0, 1.0):
        # Beside a rest use r instead of q_u: u^2 less in both keeps their ratio.
        rate, second_rate = _at(first, u), _at(second, u)
        if u == 0.0 and opens.any() and order > 3:
            rate[opens], second_rate[opens] = first[opens, 2], second[opens, 2]
        speed2 = (rate**2).sum(axis=1)
        along_ratios.append(
            np.divide(
                (rate * second_rate).sum(axis=1), speed2, out=np.zeros(len(c)), where=speed2 > 0.0
            )
        )
    across_part = np.zeros((len(c), order, c.shape[2]))
    across_part[:, :-1] = second - along_ratios[0][:, None, None] * first
    across_part[:, 1:] -= (along_ratios[1] - along_ratios[0])[:, None, None] * first
    flat = np.moveaxis(across_part, 1, 0).reshape(order, -1)
    bound = np.sqrt((hull_of(flat).reshape(order, len(c), -1) ** 2).sum(axis=2)).max(axis=0)
    bound[_on_one_line(first)] = 0.0
    return np.asarray(bound)


def true_shares(
    coefficients: FloatArray, duration_s: FloatArray, limits: AlongPath
) -> tuple[float, float, float]:
    """Return the largest shares of speed, acceleration and jerk along the path, at many places.

    ``coefficients`` (n, order, axes) are polynomials over [0, 1] of their times.
    """
    at_tool_m, worst = coefficients * limits.radius_m, [0.0, 0.0, 0.0]
    orders = [at_tool_m]
    for _ in range(3):
        previous = orders[-1]
        orders.append(previous[:, 1:] * np.arange(1.0, previous.shape[1])[:, None])
    for place in _PLACES.tolist():
        v, a, j = (
            _at(orders[k], place) / duration_s[:, None] ** k for k in (1, 2, 3)
        )  # fmt: skip
        speed = _norm_along_path(v)
        is_moving = speed > 1e-3 * speed.max(initial=0.0)
        tangent = np.divide(v, speed[:, None], out=np.zeros_like(v), where=is_moving[:, None])
        push = (tangent * a).sum(axis=1)
        across2 = np.maximum((a**2).sum(axis=1) - push**2, 0.0)
        jerk = (tangent * j).sum(axis=1)
        jerk += np.divide(across2, speed, out=np.zeros_like(speed), where=is_moving)
        up, down = limits.accelerations
        for k, share in enumerate(
            (speed / limits.velocity, np.maximum(push / up, -push / down), jerk / limits.jerk)
        ):
            worst[k] = max(worst[k], float(np.abs(share).max(initial=0.0)))
    return worst[0], worst[1], worst[2]


def _on_one_line(first: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return for (n, order, axes) derivatives whether all coefficients have one direction."""
    largest_index = np.abs(first).max(axis=2).argmax(axis=1)
    lead = first[np.arange(len(first)), largest_index]
    lead2 = (lead**2).sum(axis=1)
    share = np.divide(
        (first * lead[:, None]).sum(axis=2),
        lead2[:, None],
        out=np.zeros(first.shape[:2]),
        where=lead2[:, None] > 0.0,
    )
    off_line = np.abs(first - share[:, :, None] * lead[:, None]).max(axis=(1, 2))
    return np.asarray(off_line <= _STRAIGHT * np.sqrt(lead2))


def _at(poly: FloatArray, place: float) -> FloatArray:
    """Return the (n, axes) values of (n, order, axes) polynomials at one place."""
    out = poly[:, -1].copy()
    for k in range(poly.shape[1] - 2, -1, -1):
        out = out * place + poly[:, k]
    return np.asarray(out)


def _norm_along_path(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors**2).sum(axis=-1)))


_MOVING = 1e-3  # of the highest speed: below, the direction is undefined


@dataclass(frozen=True, slots=True, kw_only=True)
class PathUse:
    """The largest share that a motion uses of its limits along the path.

    Parameters
    ----------
    quantity
        Key of the limit in ``[path]`` of the machine file.
    share
        Used share.
    limit_si
        The limit, m/s, m/s^2 or m/s^3.
    time_s, operation
        Time and operation.
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
    speed = _norm_of_shares(v)
    moving = speed > _MOVING * speed.max(initial=0.0)
    along = np.divide(v, speed[:, None], out=np.zeros_like(v), where=moving[:, None])
    push = (along * a).sum(axis=1)
    across = np.where(moving, _norm_of_shares(a - push[:, None] * along), 0.0)
    # The travelled path length has the derivatives v, t a and t j + |a across|^2 / v.
    turning_jerk = np.divide(across**2, speed, out=np.zeros_like(speed), where=moving)
    up, down = limits.accelerations
    return {
        name: np.asarray(share)
        for name, share, limit in (
            ("velocity", speed / limits.velocity, limits.velocity),
            ("acceleration", np.maximum(push, 0.0) / up, up),
            ("deceleration", np.maximum(-push, 0.0) / down, down),
            ("jerk", np.abs((along * j).sum(axis=1) + turning_jerk) / limits.jerk, limits.jerk),
            ("centripetal", across / limits.centripetal, limits.centripetal),
        )
        if np.isfinite(limit)
    }


def path_use(trajectory: Trajectory, limits: AlongPath) -> PathUse | None:
    """Return the largest share at thirteen instants per polynomial; None without motion."""
    worst: PathUse | None = None
    for block in trajectory:
        rates = [block.coefficients]
        for _ in range(3):
            previous = rates[-1]
            rates.append(previous[:, 1:] * np.arange(1.0, previous.shape[1])[:, None])
        powers = [_PLACES[:, None] ** np.arange(rate.shape[1]) for rate in rates]
        time_s = block.duration_s[:, None, None]
        v, a, j = (
            (np.einsum("pk,nka->npa", powers[k], rates[k]) / time_s**k).reshape(
                -1, len(limits.radius_m)
            )
            for k in (1, 2, 3)
        )
        for name, share in along_shares(v, a, j, limits).items():
            worst_index = int(np.argmax(share))
            if worst is None or share[worst_index] > worst.share:
                piece, place = divmod(worst_index, len(_PLACES))
                piece_time_s = _PLACES[place] * block.duration_s[piece]
                worst = PathUse(
                    quantity=name,
                    share=float(share[worst_index]),
                    limit_si=limits.named(name),
                    time_s=float(block.start_s[piece] + piece_time_s),
                    operation=int(block.operation[piece]),
                )
    return worst


def _norm_of_shares(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors**2).sum(axis=1)))
