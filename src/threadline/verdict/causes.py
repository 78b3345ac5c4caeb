"""Which factor a gap points to: the programmed winding with one factor changed at a time.

In the middle of the widest part of the mandrel, the bands that run from left to right lie side by
side. Their distances, and the ends of the winding, are computed again with each factor changed by
its tolerance. A wider band or another radius changes all gaps alike. A relative error of the turn,
from the steps per degree or from slip, adds up over the circuits and leaves one gap or overlap. An
error of the zero moves the whole winding to one side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.verdict.pattern import PatternClosure
from threadline.verdict.replayed import WoundJob, programmed_fibre, wound_job
from threadline.winding.product_reader import Toleranced

_ALIKE = 0.25  # of the band: gaps that differ by less are alike
_SMALL = 0.05  # of the band: a smaller gap, a cell of the raster, does not count
_LEAST_M, _LEAST_SHARE = 1e-4, 1e-4  # changes of numbers without a tolerance
_MOST = 100.0  # largest multiple of its change with which a factor may explain a gap


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """Where the bands of a winding lie.

    Parameters
    ----------
    gaps_m
        (n,) distances between the edges of neighbouring bands at the middle, in the order of the
        angle; negative where they overlap.
    ends_m
        Positions along the axis at which the fibre turns back, left and right.
    """

    gaps_m: FloatArray
    ends_m: tuple[float, float]

    @property
    def largest_m(self) -> float:
        """The largest gap; negative if all bands overlap."""
        return float(self.gaps_m.max())

    @property
    def mean_m(self) -> float:
        """The mean gap."""
        return float(self.gaps_m.mean())


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """The effect of one factor on a winding.

    Parameters
    ----------
    name
        The factor, in words.
    by
        Its change: its tolerance, or a small change if it has none. In m, or as a share of the
        turn.
    toleranced
        Whether ``by`` is its tolerance.
    mean_m, largest_m
        Change of the mean gap and of the largest gap.
    left_m, right_m
        Change of the positions at which the fibre turns back.
    """

    name: str
    by: float
    toleranced: bool
    mean_m: float
    largest_m: float
    left_m: float
    right_m: float
    of_turn: bool = False

    def shown(self, times: float = 1.0) -> str:
        """Return its change, ``times`` as large, in words."""
        value = times * self.by
        return f"{1e2 * value:+.2g} % of the turn" if self.of_turn else f"{1e3 * value:+.2g} mm"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Causes:
    """A winding, and the effect of each factor on it.

    Parameters
    ----------
    laid
        The programmed winding on the product of the file.
    width_m
        Width of the band.
    causes
        One for each factor.
    """

    laid: Laid
    width_m: float
    causes: tuple[Cause, ...]

    @property
    def missing(self) -> int:
        """Number of bands that would fit into the gaps."""
        band = max(self.width_m, float(np.median(self.laid.gaps_m)) + self.width_m)
        return int(np.round(np.maximum(self.laid.gaps_m, 0.0) / band).sum())

    def words(self) -> str:
        """Return the sizes of the gaps and their likely cause, in words."""
        gaps, largest = self.laid.gaps_m, self.laid.largest_m
        if largest <= _SMALL * self.width_m:
            shape = "the bands leave no gap"
        elif float(np.ptp(gaps)) < _ALIKE * self.width_m:
            shape = "all gaps are alike: the width of the band, or the number of circuits"
        elif self.missing:
            shape = (
                f"{_counted(self.missing, 'band')} would fit into the gaps: circuits are missing"
            )
        else:
            shape = "the gaps differ: a turn that is wrong adds up over the circuits"
        return (
            f"{1e3 * largest:.3g} mm at the largest, {1e3 * gaps.mean():.3g} mm on average, "
            f"{1e3 * gaps.min():.3g} mm at the least, side by side at the widest place; {shape}"
        )

    def rows(self) -> list[list[str]]:
        """Return a row for each factor: its change, the effect, and the change that explains it."""
        return [
            [
                cause.name,
                cause.shown(),
                f"{_mm(cause.mean_m)} mm",
                f"{_mm(cause.largest_m)} mm",
                f"{_mm(cause.left_m)}, {_mm(cause.right_m)} mm",
                self._explains(cause),
            ]
            for cause in self.causes
        ]

    def lines(self) -> list[str]:
        """Return ``words`` and ``rows`` as lines of text."""
        text = [f"Gaps between bands:   {self.words()}"]
        for name, by, mean, largest, ends, explains in self.rows():
            text.append(
                f"  {name}, {by}: mean gap {mean}, largest {largest}, ends of the winding {ends}"
                + (f"; {explains} would explain the largest gap" if explains else "")
            )
        return text

    def _explains(self, cause: Cause) -> str:
        times = self.needed(cause)
        if times is None:
            return ""
        of = f" ({abs(times):.2g} tolerances)" if cause.toleranced else ""
        return cause.shown(times) + of

    def needed(self, cause: Cause) -> float | None:
        """Return the multiple of its change with which a factor alone explains the largest gap.

        None if there is no gap, or if more than ``_MOST`` times the change were needed.
        """
        largest = self.laid.largest_m
        if largest <= _SMALL * self.width_m or _MOST * abs(cause.largest_m) < largest:
            return None
        return largest / cause.largest_m


def _mm(change_m: float) -> str:
    return f"{round(1e3 * change_m, 3) + 0.0:+.2g}"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def causes_of(plan: Plan) -> Causes | None:
    """Return the effect of each factor on the programmed winding; None without a known pattern."""
    job = wound_job(plan)
    if job is None:
        return None
    laid = _laid(plan, job)
    if laid is None:
        return None
    product = job.product
    band, radius, at, slip = product.width, product.radius_error, product.at, product.slip
    factors = (
        ("width of the band", band, "width", _LEAST_M),
        ("radius of the mandrel", radius, "radius_error", _LEAST_M),
        ("zero along the mandrel", at, "at", _LEAST_M),
        ("steps per degree, or slip", slip, "slip", _LEAST_SHARE),
    )
    found = []
    for name, number, key, least in factors:
        by = number.tolerance or least
        moved = replace(product, **{key: Toleranced(number.si + by)})  # type: ignore[arg-type]
        other = _laid(plan, replace(job, product=moved))
        if other is not None:
            turn = key == "slip"
            found.append(_cause(name, by, number.tolerance > 0.0, (laid, other), of_turn=turn))
    zero = None if job.tool.across is None else job.tool.across.zero
    across = 0.0 if zero is None else zero.tolerance_si
    by = across or _LEAST_M
    other = _laid(plan, replace(job, further_m=by))
    if other is not None:
        found.append(_cause("zero across, the eye further out", by, across > 0.0, (laid, other)))
    return Causes(laid=laid, width_m=job.width_m, causes=tuple(found))


def _cause(
    name: str, by: float, toleranced: bool, pair: tuple[Laid, Laid], *, of_turn: bool = False
) -> Cause:
    own, other = pair
    return Cause(
        name=name,
        by=by,
        toleranced=toleranced,
        mean_m=other.mean_m - own.mean_m,
        largest_m=other.largest_m - own.largest_m,
        left_m=other.ends_m[0] - own.ends_m[0],
        right_m=other.ends_m[1] - own.ends_m[1],
        of_turn=of_turn,
    )


def _laid(plan: Plan, job: WoundJob) -> Laid | None:
    """Return where the bands of the programmed winding lie; None for fewer than two circuits."""
    closing = PatternClosure([job], len(plan.axes))
    low, high = np.inf, -np.inf
    for samples in programmed_fibre(plan, job):
        closing.take([samples])
        fibre = samples.fibre
        if fibre.known.any():
            x = job.surface.at(fibre.u[fibre.known])[0][:, 0]
            low, high = min(low, float(x.min())), max(high, float(x.max()))
    rows = closing.circuits(0)
    if len(rows) < 2:
        return None
    angle = np.sort(rows[:, 0] % (2.0 * np.pi))
    across = closing.radius_m(0) * abs(float(np.cos(rows[:, 1]).mean()))
    pitch = across * np.diff(angle, append=angle[0] + 2.0 * np.pi)
    ends = low + job.at_m, high + job.at_m
    return Laid(gaps_m=pitch - job.width_m, ends_m=ends)
