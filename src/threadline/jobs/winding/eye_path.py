"""The path of the payout eye: where the tangent of the laid fibre meets a clearance envelope.

The envelope is the surface at a constant distance from the mandrel, ends included; on a machine
that cannot move its eye across, it is the cylinder on which the eye stands. Points of the path are
kept only where the laid fibre needs them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.errors import JobError
from threadline.machine.tool import Tool
from threadline.winding.surface import Surface, meridian

_ROUNDS = 60
_FOOT_ROUNDS = 30
_SAME = 1e-13  # m


@njit(nogil=True)
def _distance_to_mandrel(
    px: float, pr: float, v: float, nodes: FloatArray, x: FloatArray, r: FloatArray, hint: int
) -> tuple[float, float, int]:
    """Return distance of a point from the mandrel, the u of its foot, and the piece there."""
    last = nodes[-1]
    for _ in range(_FOOT_ROUNDS):
        hint, fx, fr, cb, sb, bend, speed = meridian(nodes, x, r, v, hint)
        dx, dr = px - fx, pr - fr
        along_m, out_m = dx * cb + dr * sb, dr * cb - dx * sb
        # The foot moves by the length along, less on a convex meridian.
        step = along_m / max(1.0 + bend * out_m, 0.2)
        v_before = v
        v = min(max(v + step / speed, 0.0), last)
        if abs(v - v_before) < _SAME:
            break
    hint, fx, fr, cb, sb, bend, speed = meridian(nodes, x, r, v, hint)
    dx, dr = px - fx, pr - fr
    if (v <= 0.0 and dx < 0.0) or (v >= last and dx > 0.0):
        return (abs(dx) if dr < 0.0 else math.hypot(dx, dr)), v, hint
    return dr * cb - dx * sb, v, hint


@njit(nogil=True)
def free_lengths(
    course: FloatArray, nodes: FloatArray, x: FloatArray, r: FloatArray, far: float, round_: bool
) -> FloatArray:
    """Return (n,) free lengths, m, from the points of a course to the envelope; NaN if none.

    Parameters
    ----------
    course
        (n, 4) length, u, angle round and winding angle.
    nodes, x, r
        The meridian, as in ``Surface``.
    far
        Distance of the envelope from the mandrel, or with ``round_`` its radius, m.
    """
    lengths = np.full(len(course), np.nan)
    hint, foot_hint = 0, 0
    for i in range(len(course)):
        u, angle = course[i, 1], course[i, 3]
        hint, px, pr, cb, sb, _, _ = meridian(nodes, x, r, u, hint)
        ca, sa = math.cos(angle), math.sin(angle)
        if round_:
            # |(r + L ca sb, L sa)| = far
            a, b, c = ca * ca * sb * sb + sa * sa, pr * ca * sb, pr * pr - far * far
            if c < 0.0 and a > 1e-12:
                lengths[i] = (-b + math.sqrt(b * b - a * c)) / a
            continue
        low, high, foot, foot_hint = 0.0, far, u, hint
        excess_low = -far
        for _ in range(60):  # the tangent leaves a convex mandrel for ever
            radius = math.hypot(pr + high * ca * sb, high * sa)
            distance_m, foot, foot_hint = _distance_to_mandrel(
                px + high * ca * cb, radius, foot, nodes, x, r, foot_hint
            )
            if distance_m > far:
                break
            low, excess_low = high, distance_m - far
            high *= 1.5
        else:
            continue
        excess_high = distance_m - far
        length = high
        for step in range(_ROUNDS):
            # Regula falsi, with a bisection in every third step.
            length = (
                0.5 * (low + high)
                if step % 3 == 2
                else low - excess_low * (high - low) / (excess_high - excess_low)
            )
            radius = math.hypot(pr + length * ca * sb, length * sa)
            distance_m, foot, foot_hint = _distance_to_mandrel(
                px + length * ca * cb, radius, foot, nodes, x, r, foot_hint
            )
            if distance_m > far:
                high, excess_high = length, distance_m - far
            else:
                low, excess_low = length, distance_m - far
            if abs(distance_m - far) < 1e-13 or high - low < 1e-13:
                break
        lengths[i] = length
    return lengths


@dataclass(frozen=True, slots=True, eq=False)
class EyePath:
    """The eye along a course.

    Parameters
    ----------
    course
        (n, 4) length, u, angle round and winding angle of the fibre.
    free_m
        (n,) free length.
    eye
        (n, 3) turn of the mandrel, rad, and distance of the pay-out point along the mandrel and
        from its axis, m.
    """

    course: FloatArray
    free_m: FloatArray
    eye: FloatArray

    @property
    def used_m(self) -> FloatArray:
        """(n,) length of fibre that has left the eye, m."""
        return np.asarray(self.course[:, 0] + self.free_m - self.free_m[0])

    @property
    def slack_m(self) -> float:
        """Largest fall of ``used_m`` below an earlier value, m: the eye takes that fibre back."""
        used = np.concatenate([self.used_m, self.used_m[1:] + self.used_m[-1]])
        return float((np.maximum.accumulate(used) - used).max())


def eye_path(surface: Surface, course: FloatArray, far_m: float, round_: bool) -> EyePath:
    """Return the eye along a course.

    Parameters
    ----------
    surface
        The mandrel that the course lies on.
    course
        (n, 4) length, u, angle round and winding angle.
    far_m
        Distance between envelope and mandrel, or with ``round_`` the envelope's radius.
    round_
        Whether the envelope is a cylinder.

    Raises
    ------
    JobError
        If the tangent does not meet the envelope.
    """
    free = free_lengths(course, surface.nodes, surface.x, surface.r, far_m, round_)
    if not np.isfinite(free).all():
        bad_row = int(np.argmin(np.isfinite(free)))
        x, r = (float(v[0, 0]) for v in surface.at(course[bad_row : bad_row + 1, 1]))
        quantity = "radius" if round_ else "distance"
        raise JobError(
            f"at {1e3 * x:.4g} mm along the mandrel (radius {1e3 * r:.4g} mm) the fibre's tangent "
            f"does not meet the envelope with a {quantity} of {1e3 * far_m:.4g} mm",
            remedy=(
                "The machine cannot move its eye across: fewer layers, a smaller mandrel, or "
                "a [tool] farther away."
                if round_
                else "Leave [fibre] envelope out, or take one nearer to the radius of the mandrel."
            ),
        )
    xs, rs = surface.at(course[:, 1])
    slope = np.hypot(xs[:, 1], rs[:, 1])
    cb, sb = xs[:, 1] / slope, rs[:, 1] / slope
    ca, sa = np.cos(course[:, 3]), np.sin(course[:, 3])
    radial, tangential = rs[:, 0] + free * ca * sb, free * sa
    eye = np.column_stack(
        [
            course[:, 2] + np.arctan2(tangential, radial),
            xs[:, 0] + free * ca * cb,
            np.hypot(radial, tangential),
        ]
    )
    return EyePath(course, free, eye)


def positions(tool: Tool, axes: tuple[str, ...], eye: FloatArray, at_m: float) -> FloatArray:
    """Return (n, axes) positions of the axes for (n, 3) turn, place along and distance of the eye.

    Yaw and roll stay at 0.

    Parameters
    ----------
    at_m
        Machine place of the left end of the mandrel.
    """
    along, across, up = tool.payout_m
    zeros = [0.0 if part is None else part.zero_si for part in tool.parts]
    height_m = up + (0.0 if tool.up is None else zeros[3])
    horizontal_m = np.sqrt(np.maximum(eye[:, 2] ** 2 - height_m**2, 0.0))
    coordinates = np.column_stack(
        [
            eye[:, 0] + np.arctan2(height_m, horizontal_m),
            eye[:, 1] + at_m - along,
            horizontal_m - across,
        ]
    )
    columns = np.zeros((len(eye), len(axes)))
    for number, part in enumerate(tool.parts[:3]):
        if part is not None:
            columns[:, axes.index(part.axis)] = (
                coordinates[:, number] - part.zero_si
            ) / part.factor
    return columns


def chord_points(eye: FloatArray, tolerance_m: float) -> IntArray:
    """Return the points between which linear axes stay within a tolerance of the path.

    Parameters
    ----------
    eye
        (n, 3) turn, rad, place along and distance from the axis, m.
    tolerance_m
        Largest distance between path and chord, a turn counted at the eye's distance.
    """
    keep = np.zeros(len(eye), dtype=np.bool_)
    keep[[0, -1]] = True
    waiting = [(0, len(eye) - 1)]
    while waiting:
        low, high = waiting.pop()
        if high - low < 2:
            continue
        inner = eye[low + 1 : high] - eye[low]
        scale = np.array([float(eye[low : high + 1, 2].max()), 1.0, 1.0])
        chord = (eye[high] - eye[low]) * scale
        chord2 = float(chord @ chord)
        inner = inner * scale
        share = inner @ chord / chord2 if chord2 > 0.0 else np.zeros(len(inner))
        distances = np.linalg.norm(inner - share[:, None] * chord, axis=1)
        worst = int(distances.argmax())
        if distances[worst] > tolerance_m:
            middle = low + 1 + worst
            keep[middle] = True
            waiting += [(low, middle), (middle, high)]
    return np.flatnonzero(keep)
