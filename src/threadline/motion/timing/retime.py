"""The fastest motion through points, for programs that have neither a job nor a machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only, real_numbers
from threadline.errors import PlanError
from threadline.files import Stream
from threadline.motion.path.auto import auto_pieces
from threadline.motion.path.polygon import QUARTIC
from threadline.motion.path.runs import AT_A_TIME, reversals
from threadline.motion.path.types import PlannedPath, ProgrammedPath, Timing, VertexBlock
from threadline.motion.timing.extremes import hull_of
from threadline.motion.timing.optimal.along_path import AlongPath, across, true_shares
from threadline.motion.timing.optimal.elements import restricted
from threadline.motion.timing.optimal.fastest_motion import limited_blocks
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.rows import used_shares
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

_NEAR_SHARE = 0.01  # share of the tolerance: closer points are merged
_LARGEST = 1e9  # largest coordinate or limit: squares and cubes of larger ones lose digits
_LEAST = 1e-9  # least limit
_NOTHING, _ZEROS = np.zeros(AT_A_TIME), np.zeros(AT_A_TIME, dtype=np.int64)
_NOTHING.flags.writeable = _ZEROS.flags.writeable = False
_PARTS = 4  # parts of a polynomial in time: shorter parts have tighter bounds
_OUT_OF_REACH = 1.05  # times the highest speed that a limit of acceleration allows


@dataclass(frozen=True, kw_only=True, eq=False)
class Retimed(Locked, Trajectory):
    """A motion, and the share of each limit that it uses.

    Parameters
    ----------
    shares
        Largest used share of each limit, by name: (axes,) for limits of axes, (1,) for limits of
        the path. Shares of the axes and of ``centripetal`` hold at every instant, because
        Bernstein coefficients bound polynomials. The three shares along the path are the largest
        at thirteen instants of each polynomial in time.
    start
        (axes,) first point; the only position of a motion of length 0.
    """

    shares: Mapping[str, FloatArray] = field(default_factory=dict)
    start: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_only(self.start, "start", ndim=1))

    def __call__(self, time_s: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the (m, axes) ``derivative``-th derivative, as ``Trajectory`` does."""
        values = super().__call__(time_s, derivative)
        if derivative == 0 and self.duration_s == 0.0:
            values[:] = self.start
        return values

    @property
    def bound(self) -> float:
        """Largest of all shares; at most 1, up to rounding."""
        return max((float(share.max()) for share in self.shares.values()), default=0.0)


def limits_used(trajectory: Trajectory, limits: Limits) -> dict[str, FloatArray]:
    """Return bounds of the used share of each limit; see ``Retimed.shares``."""
    shares: dict[str, FloatArray] = {}
    for block in trajectory:
        for name, share in _of_block(block, limits).items():
            shares[name] = np.maximum(share, shares.get(name, 0.0))
    return shares


def _of_block(block: TrajectoryBlock, limits: Limits) -> dict[str, FloatArray]:
    c, duration_s = _parted(block)
    rates = [c]
    for _ in range(3):
        previous = rates[-1]
        rates.append(previous[:, 1:] * np.arange(1.0, previous.shape[1])[:, None])
    v, a, j = (_hull(rates[k]) / duration_s[:, None, None] ** k for k in (1, 2, 3))
    along = limits.along
    shares = {
        "velocity": np.abs(v).max(axis=(0, 1)) / limits.velocity,
        "acceleration": used_shares(v, a, limits.accelerations).max(axis=0),
        "jerk": np.abs(j).max(axis=(0, 1)) / limits.jerk,
    }
    if along is not None:
        names = ("path_velocity", "path_acceleration", "path_jerk")
        for name, share in zip(names, true_shares(c, duration_s, along), strict=True):
            shares[name] = np.array([share])
        largest = float((across(c * along.radius_m) / duration_s**2).max())
        shares["centripetal"] = np.array([largest / along.centripetal])
    return shares


def _parted(block: TrajectoryBlock) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of the parts of a block's polynomials, and the parts' durations."""
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


def retime(
    points: ArrayLike,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike = np.inf,
    tolerance: float = 1e-4,
    *,
    deceleration: ArrayLike | None = None,
    path_velocity: float = np.inf,
    path_acceleration: float = np.inf,
    path_jerk: float = np.inf,
    path_deceleration: float | None = None,
    centripetal: float = np.inf,
) -> Retimed:
    """Return the fastest motion from the first of ``points`` to the last, at rest at both.

    The path follows the straight lines between the points and rounds the corners, with three
    continuous derivatives. Its distance from the lines, in both directions, is at most the
    tolerance. Dense points near a curve are replaced by chords within the tolerance.

    The limits of the axes and ``centripetal`` hold at every instant, up to rounding (a thousandth
    at most). ``path_velocity``, ``path_acceleration`` and ``path_jerk`` hold at closely spaced
    instants; nothing is proven between them. Lengths may be in any unit, the same in all arguments;
    times are in seconds.

    The search cuts the path into elements until what finer ones would save is some thousandths of
    the duration; the limits decide where it cuts. So a higher limit of the velocity may take
    longer than a lower one, but by less than 1 %. A limit that the axis cannot reach by its
    accelerations changes nothing.

    Parameters
    ----------
    points
        (n, axes), n at least 1.
    velocity, acceleration, jerk
        (axes,) limits above 0, or one number for all axes. Only the jerk may be infinite.
    tolerance
        Largest distance between path and lines, per axis; above 0.
    deceleration
        (axes,) limits while an axis slows down; default ``acceleration``.
    path_velocity, path_acceleration, path_jerk
        Limits along the path; above 0 or infinite. All axes must then have the same unit. A finite
        ``path_acceleration`` or ``path_jerk`` makes the motion rest wherever the path reverses (by
        more than 148 degrees), since the speed along the path has a kink there.
    path_deceleration
        Limit of braking along the path; default ``path_acceleration``.
    centripetal
        Limit of the acceleration across the path; above 0 or infinite.

    Returns
    -------
    Retimed
        The trajectory; ``shares`` and ``bound`` bound the used share of each limit.

    Raises
    ------
    PlanError
        If points, a limit or the tolerance are not numbers in their range; names a wrong point.

    Examples
    --------
    The example of toppra: five random points of seven axes, with toppra's limits. Unlike toppra,
    which runs a spline through the points, this rounds the corners between straight lines.

    >>> import numpy as np
    >>> random = np.random.RandomState(1)
    >>> points = random.randn(5, 7)
    >>> velocity, acceleration = 10 + random.rand(7) * 20, 10 + random.rand(7) * 2
    >>> motion = retime(points, velocity, acceleration, jerk=500.0, tolerance=0.02)
    >>> times = np.linspace(0.0, motion.duration_s, 1000)
    >>> bool((np.abs(motion(times, 2)) <= 1.001 * acceleration).all())
    True
    >>> np.abs(motion(times[-1]) - points[-1]).max() < 1e-9
    np.True_
    """
    places = checked_points(points)
    axes = places.shape[1]
    along = AlongPath(
        velocity=_checked_number("path_velocity", path_velocity),
        acceleration=_checked_number("path_acceleration", path_acceleration),
        jerk=_checked_number("path_jerk", path_jerk),
        deceleration=None
        if path_deceleration is None
        else _checked_number("path_deceleration", path_deceleration),
        centripetal=_checked_number("centripetal", centripetal),
        radius_m=np.ones(axes),
    )
    kinks = along.asks_for_rests
    limited = kinks or bool(np.isfinite([along.velocity, along.centripetal]).any())
    limits = Limits(
        velocity=_checked_limit("velocity", velocity, axes),
        acceleration=_checked_limit("acceleration", acceleration, axes),
        jerk=_checked_limit("jerk", jerk, axes, infinite=True),
        deceleration=None
        if deceleration is None
        else _checked_limit("deceleration", deceleration, axes),
        along=along if limited else None,
    )
    width = _checked_tolerance(tolerance)
    # The solver cuts a path in another way for each limit, though none of them is ever reached.
    within = replace(
        limits, velocity=np.minimum(limits.velocity, _reachable(places, limits, width))
    )
    path = path_through(places, width, reversals(places) if kinks else None)
    # Computed once and kept: the motion will be read many times.
    motion = Trajectory(axes=path.axes, blocks=Stream.of(list(limited_blocks(path, within))))
    return Retimed(
        axes=path.axes, blocks=motion.blocks, shares=limits_used(motion, limits), start=places[0]
    )


def _reachable(places: FloatArray, limits: Limits, tolerance: float) -> FloatArray:
    """Return (axes,) speeds that no axis reaches between the places.

    An axis that has the speed v left a rest or a reversal v^2 / 2 A before, at an acceleration A,
    and comes to one v^2 / 2 D later. Both lie within the extent of the places.
    """
    extent = np.ptp(places, axis=0) + 2.0 * tolerance
    speeding, braking = limits.accelerations
    mean = speeding * braking / (speeding + braking)
    return np.asarray(_OUT_OF_REACH * np.sqrt(2.0 * extent * mean))


def path_through(
    places: FloatArray, tolerance: float, rests: IntArray | None = None
) -> PlannedPath:
    """Return the path of ``retime`` through (n, axes) places, within the tolerance.

    It rests at its ends, and at places whose entry of (n,) ``rests`` is 1. The places are read
    lazily, with the path.
    """
    axes = places.shape[1]
    programmed = ProgrammedPath(
        axes=tuple(str(axis) for axis in range(axes)),
        radius_m=np.ones(axes),
        blocks=Stream(vertex_blocks, places, rests),
    )
    return PlannedPath(
        axes=programmed.axes,
        radius_m=programmed.radius_m,
        interpolation="optimal",
        timing=Timing.FASTEST,
        historical=False,
        blocks=Stream(
            auto_pieces,
            programmed,
            (1.0 - _NEAR_SHARE) * tolerance,
            _NEAR_SHARE * tolerance,
            degree=QUARTIC,
            thin=True,
        ),
    )


def vertex_blocks(places: FloatArray, rests: IntArray | None) -> Iterator[VertexBlock]:
    """Yield the places as vertices, in blocks whose results fit into the processor's cache."""
    count = len(places)
    for first in range(0, count, AT_A_TIME):
        point_rows = slice(first, min(first + AT_A_TIME, count))
        rows = slice(0, point_rows.stop - first)
        rest = _ZEROS[rows] if rests is None else rests[point_rows]
        if point_rows.stop == count:
            rest = rest.copy()
            rest[-1] = 1
        operation = np.arange(first - 1, point_rows.stop - 1)
        operation[0] = max(first - 1, 0)
        operation.flags.writeable = False
        yield VertexBlock(
            positions=places[point_rows],
            operation=operation,
            nominal_s=_NOTHING[rows],
            rest=rest,
            dwell_s=_NOTHING[rows],
            line=_ZEROS[rows],
        )


def checked_points(points: ArrayLike) -> FloatArray:
    """Return points as (n, axes) floats; without a copy if they are such an array already.

    Raises
    ------
    PlanError
        If they cannot be converted, or a coordinate is out of range; names the point.
    """
    try:
        is_float_array = type(points) is np.ndarray and points.dtype == np.float64
        places: FloatArray = np.asarray(points) if is_float_array else real_numbers(points)
    except (TypeError, ValueError) as error:
        raise PlanError(
            f"the points are not an array of numbers of at most {_LARGEST:g}",
            remedy="Give n rows of as many axes. Leave out rows with a masked or missing value.",
        ) from error
    if places.ndim != 2 or 0 in places.shape:
        raise PlanError(
            f"the points have shape {places.shape}; they must be at least 1 row of at least 1 axis",
            remedy="A single axis is a column: points[:, None].",
        )
    wrong_rows = np.zeros(0, dtype=np.int64)
    # Usually one sum of squares already shows that all are in range, and none is NaN.
    if not np.vdot(places, places) <= _LARGEST**2:
        wrong_rows = np.flatnonzero(~(np.abs(places) <= _LARGEST).all(axis=1))
    if len(wrong_rows):
        raise PlanError(
            f"point {wrong_rows[0]} is {places[wrong_rows[0]].tolist()}; every coordinate must be "
            f"a number of at most {_LARGEST:g}",
            remedy="Correct it, or leave it out.",
        )
    return places


def _checked_limit(name: str, limit: ArrayLike, axes: int, *, infinite: bool = False) -> FloatArray:
    try:
        values = np.broadcast_to(real_numbers(limit), (axes,)).copy()
    except (TypeError, ValueError) as error:
        raise PlanError(
            f"{name} is {_shortened(limit)}; it must be one number, or one for each of {axes} "
            f"axes, of at most {_LARGEST:g}",
            remedy="Give as many as the points have axes.",
        ) from error
    for axis, value in _each(values):
        if infinite and value == np.inf:
            continue
        if not _LEAST <= value <= _LARGEST:
            raise PlanError(
                f"{_whose(name, axis)} is {value!r}; it must lie in {_LEAST:g} ... {_LARGEST:g}",
                remedy="Correct it, or choose another unit.",
            )
    return values


def _whose(name: str, axis: int) -> str:
    of_path = name.startswith("path_") or name == "centripetal"
    return name if of_path else f"{name} of axis {axis}"


def _checked_number(name: str, limit: float) -> float:
    """Return a limit along the path, checked; it may be infinite."""
    value = _one_number(name, limit, "There is one path: give one.")
    return float(_checked_limit(name, value, 1, infinite=True)[0])


def _checked_tolerance(tolerance: float) -> float:
    remedy = "Give it in the unit of the points."
    value = _one_number("the tolerance", tolerance, remedy)
    if not _LEAST <= value <= _LARGEST:
        raise PlanError(
            f"the tolerance is {value!r}; it must lie in {_LEAST:g} ... {_LARGEST:g}", remedy=remedy
        )
    return value


def _one_number(name: str, given: ArrayLike, remedy: str) -> float:
    try:
        value = real_numbers(given)
        if value.ndim:
            raise TypeError("several")
    except (TypeError, ValueError) as error:
        raise PlanError(
            f"{name} is {_shortened(given)}; it must be one number, of at most {_LARGEST:g}",
            remedy=remedy,
        ) from error
    return float(value)


def _shortened(given: object) -> str:
    """Return a value as one line, shortened."""
    try:
        text = " ".join(repr(given).split())
    except ValueError:  # Python refuses to print integers of more than 4300 digits
        return "a whole number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _each(values: FloatArray) -> Iterator[tuple[int, float]]:
    return enumerate(values.tolist())
