"""Search over all choices of a plan of ``optimal``, by the following error of the loops.

A plan may choose how far its path leaves the program on the inside and the outside of corners, how
much of volts and current it leaves to the loops, over which time feed-forward smooths, and how far
the loops may leave the path. Each choice makes the plan shorter the bolder it is, up to a point: a
bolder plan has larger errors. Whether a plan passes is not monotone in any of them, since a tick of
0 V or a step of the DAC moves to another instant. So the search neither bisects nor changes one
choice after the other. It keeps all trials, fits a plane to their durations and one to each of
their errors, and tries next the plan with the largest expected gain by these planes.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.option_defaults import DEFAULT_CONTOUR_M
from threadline.machine import Machine
from threadline.motion.timing.optimal.motion_limits import reserve_of
from threadline.proof.option_words import (
    LEAST_CONTOUR_M,
    Reserve,
    parse_reserve,
    parse_share,
    parse_tolerance_m,
    parse_width_s,
)
from threadline.proof.options import Options
from threadline.verdict import Spec, Status, Verdict
from threadline.verdict.contour import POINT_MISSED

CHOSEN = (
    "tolerance", "outside", "narrow", "reserve", "smoothing", "contour", "feed_forward",
)  # fmt: skip
"""Options of a plan that a search may choose if the user gave none."""
LIMIT_SHARE = "limits"
"""Option that a search may choose, too, if no plan with the full limits is in specification."""
RESERVES = ("volts", "current")
"""Knobs of the option ``reserve``: the reserves of voltage and of current."""
BUDGET = "contour_error"
"""Criterion whose limit bounds the error of the path and the error of the loops together."""
_SEED = 1994
_CANDIDATES = 600
AS_GOOD = 0.5  # ticks: a plan is simulated only if it is shorter than the best by more than this
# Standard deviation of candidates about the best place: at first, at least, and two factors on it.
_FIRST_WIDTH, _LAST_WIDTH, _WIDER, _NARROWER = 0.15, 0.02, 1.3, 0.8
_PATIENCE = 4  # after so many failures in a row candidates are drawn nearer to the best
_LEAST_USED, _MOST_USED = 0.2, 1.5  # used shares are clamped to this range before the fit
_NOISE = 0.03  # least scatter of errors about their plane
_TICKS = 0.5  # least scatter of durations about their plane, in ticks
_NEAR = 0.3  # trials farther from the best plan than this have little weight
_RIDGE = 1e-3
_CAUTION = 2.0  # power of the chance to pass: small steps that pass teach more than long ones
_CLAMPED, _FREE = 1.1, 0.9  # used share that stands for a broken limit of 0, and for a kept one
_MENDED = 0.1  # share of the limit: a larger excess is not corrected at single corners
_BESIDES = 0.01  # share of the limit: margin of a correction over the measured excess
_LEAST_SHARE = 0.05  # least share of the limits of acceleration and jerk
_LEAST_VOLTS = 0.0025  # least reserve of voltage, because loops need some in every motion
_AT_CORNERS = frozenset({"contour_error", "turning_point_error"})
_OF_PLANS = frozenset({"travel", "velocity", "acceleration", "jerk"})
"""Criteria on limits of the machine, which the planner keeps in every plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Knob:
    """One choice of a plan as a place from 0, the most careful value, to 1, the boldest value.

    Parameters
    ----------
    word
        The option.
    careful, bold
        Values at 0 and 1.
    digit
        Step of the values: each value is a multiple of it.
    typed
        Function that rounds a value, so that typing it as an option gives the same value.
    power
        Exponent: the value changes with this power of the place, so that small values lie closer
        together.
    """

    word: str
    careful: float
    bold: float
    digit: float
    typed: Callable[[str], float] = float
    power: int = 1

    def value(self, place: float) -> float:
        """Return the value at a place from 0 to 1."""
        along = place**self.power
        steps = round((self.careful + along * (self.bold - self.careful)) / self.digit)
        return self.typed(f"{steps * self.digit:.9g}")

    def place(self, value: float) -> float:
        """Return the place of a value."""
        along = min(max((value - self.careful) / (self.bold - self.careful), 0.0), 1.0)
        return along if self.power == 1 else float(along ** (1.0 / self.power))


def knobs_of(
    machine: Machine,
    spec: Spec,
    options: Options,
    free: frozenset[str],
    *,
    limits_too: bool = False,
) -> tuple[Knob, ...]:
    """Return the choices of a search for a job.

    The options of the path are searched only if the specification limits the contour error.

    Parameters
    ----------
    options
        Options of the plan; with or without feed-forward.
    free
        Options that were not given.
    limits_too
        Whether the search may choose the share of the limits, too.
    """
    error_budget_m = budget_m(spec)
    knobs = []
    with_feed_forward = options.feed_forward_s is not None
    tick_s = float(machine.tick_clock.period_s)
    if error_budget_m is not None:
        rounding_m = 10.0 ** math.floor(math.log10(error_budget_m) - 2.5)
        least_m = min(options.tolerance_m, 0.2 * error_budget_m)
        knobs.append(
            Knob(
                word="tolerance",
                careful=least_m,
                bold=0.98 * error_budget_m,
                digit=rounding_m,
                typed=_mm,
            )
        )
        knobs.append(Knob(word="outside", careful=0.0, bold=1.0, digit=0.005))
        if with_feed_forward or (options.follows_contour and not machine.takes_positions):
            least_m = max(min(0.5 * DEFAULT_CONTOUR_M, 0.2 * error_budget_m), LEAST_CONTOUR_M)
            most_m = (1.0 if with_feed_forward else 1.5) * error_budget_m
            knobs.append(
                Knob(word="contour", careful=least_m, bold=most_m, digit=rounding_m, typed=_mm)
            )
    if not machine.takes_positions and "reserve" in free:
        reserves = _largest_reserves(machine)
        for word, machine_reserve, least_reserve in (
            ("volts", reserves.volts, _LEAST_VOLTS),
            ("current", reserves.current, 0.0),
        ):
            knobs.append(
                Knob(
                    word=word,
                    careful=max(machine_reserve, 0.05),
                    bold=least_reserve,
                    digit=1e-4,
                    typed=_percent,
                )
            )
    if with_feed_forward:
        knobs.append(
            Knob(
                word="smoothing",
                careful=4.0 * tick_s,
                bold=0.5 * tick_s,
                digit=tick_s / 100,
                typed=_ms,
            )
        )
    chosen_knobs = [knob for knob in knobs if knob.word in free or knob.word in RESERVES]
    if limits_too:
        share_knob = Knob(
            word=LIMIT_SHARE, careful=_LEAST_SHARE, bold=1.0, digit=1e-4, typed=_share, power=2
        )
        chosen_knobs.append(share_knob)
    return tuple(chosen_knobs)


def budget_m(spec: Spec) -> float | None:
    """Return the limit for the errors of path and loops together, m; None without a limit."""
    limits = [one.limit for one in spec.criteria if one.name == BUDGET and one.limit is not None]
    return min(limits, default=None)


def _largest_reserves(machine: Machine) -> Reserve:
    """Return the largest reserves of the drives of a machine."""
    reserves = [reserve_of(machine, name) for name, axis in machine.axes.items() if not axis.drive]
    return Reserve(*(max((one[k] for one in reserves), default=0.0) for k in range(2)))


def chosen(
    options: Options,
    knobs: Sequence[Knob],
    places: Sequence[float],
    narrower: Mapping[int, float] | None = None,
) -> Options:
    """Return ``options`` with the values of the knobs at ``places``.

    Parameters
    ----------
    narrower
        By line of the program: the tolerance at its corner, as a share of the general tolerance.
    """
    values = {knob.word: knob.value(place) for knob, place in zip(knobs, places, strict=True)}
    tolerance_m = values.get("tolerance", options.tolerance_m)
    outside_m = options.outside_m
    if "outside" in values:
        outside_m = min(_typed_m(values["outside"] * tolerance_m), tolerance_m)
    narrow = options.narrow
    if narrower:
        narrow = tuple(
            (line, _typed_m(share * tolerance_m)) for line, share in sorted(narrower.items())
        )
    return replace(
        options,
        tolerance_m=tolerance_m,
        outside_m=outside_m,
        narrow=narrow,
        contour_m=values.get("contour", options.contour_m),
        reserve=Reserve(*(values[word] for word in RESERVES))
        if "volts" in values
        else options.reserve,
        feed_forward_s=values.get("smoothing", options.feed_forward_s),
        limit_share=values.get(LIMIT_SHARE, options.limit_share),
    )


def _mm(text: str) -> float:
    return parse_tolerance_m(f"{float(text) * 1e3:.6g} mm")


def _ms(text: str) -> float:
    return parse_width_s(f"{float(text) * 1e3:.6g} ms")


def _percent(text: str) -> float:
    return parse_reserve(f"{float(text) * 1e2:.6g} %").volts


def _share(text: str) -> float:
    return parse_share(f"{float(text) * 1e2:.6g} %")


def _typed_m(length_m: float) -> float:
    """Return a length, m, rounded to four digits, as read from its text in mm."""
    return _mm(f"{length_m:.4g}") if length_m > 0.0 else 0.0


def narrowed(
    options: Options, verdict: Verdict, lines: Sequence[int], end_s: float
) -> Options | None:
    """Return options with a smaller tolerance at the corner where the largest error is.

    The result is None if a criterion without corners fails, or if the excess is too large to be
    corrected at a single corner. If the largest error is between two programmed points, the corners
    at both get a smaller tolerance. If it occurs after the end of a table of feed-forward, the
    contour allowance is reduced instead.

    Parameters
    ----------
    lines
        Lines of the moves of the program, in increasing order.
    end_s
        End of the table of commands, s.
    """
    failed = [one for one in verdict.results if one.status is Status.FAILED]
    if not failed or {one.name for one in failed} - _AT_CORNERS:
        return None
    worst = max(failed, key=lambda one: abs(one.measured or 0.0) / (one.limit or math.inf))
    if not worst.job_line or not worst.limit or worst.measured is None:
        return None
    excess_m = abs(worst.measured) - worst.limit
    if options.feed_forward_s is not None and (worst.time_s or 0.0) > end_s:
        smaller_allowance_m = options.allowance_m - excess_m - _BESIDES * worst.limit
        if math.isinf(smaller_allowance_m) or smaller_allowance_m < 0.5 * options.allowance_m:
            return None
        return replace(options, contour_m=_typed_m(smaller_allowance_m))
    corner_lines = {worst.job_line}
    previous_index = bisect_left(lines, worst.job_line) - 1
    if worst.name == BUDGET and worst.note != POINT_MISSED and previous_index >= 0:
        corner_lines.add(lines[previous_index])
    widths = dict(options.narrow)
    for line in corner_lines:
        width_m = widths.get(line, options.tolerance_m)
        if excess_m > _MENDED * worst.limit or width_m - excess_m < 0.5 * options.tolerance_m:
            return None
        widths[line] = _typed_m(width_m - excess_m - _BESIDES * worst.limit)
    return replace(options, narrow=tuple(sorted(widths.items())))


def places_of(options: Options, knobs: Sequence[Knob], machine: Machine) -> tuple[float, ...]:
    """Return the place of each knob whose value is nearest to its value in ``options``."""
    reserves = _largest_reserves(machine) if options.reserve is None else options.reserve
    values = {
        "tolerance": options.tolerance_m,
        "outside": options.outside_m / options.tolerance_m,
        "contour": min(options.allowance_m, 1.0),
        "volts": reserves.volts,
        "current": reserves.current,
        "smoothing": options.feed_forward_s or 0.0,
        LIMIT_SHARE: options.limit_share,
    }
    return tuple(knob.place(values[knob.word]) for knob in knobs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tried:
    """One plan that was tried.

    Parameters
    ----------
    places
        Places of the knobs.
    duration_s
        Duration of the plan; None where it breaks a limit of the machine.
    used
        Used share of the limit of each measured criterion; empty where the plan was not simulated,
        because it is no shorter than the best.
    passed
        Whether the plan is in specification.
    """

    places: tuple[float, ...]
    duration_s: float | None
    used: Mapping[str, float]
    passed: bool


def used_of(verdict: Verdict) -> dict[str, float]:
    """Return the largest used share of each criterion whose use depends on the loops."""
    largest_used: dict[str, float] = {}
    for one in verdict.results:
        failed = one.status is Status.FAILED
        if one.measured is None or one.limit is None or (one.name in _OF_PLANS and not failed):
            continue
        share = abs(one.measured) / one.limit if one.limit else (_CLAMPED if failed else _FREE)
        largest_used[one.name] = max(share, largest_used.get(one.name, 0.0))
    return largest_used


Try = Callable[[tuple[float, ...], float], Tried]
"""Function that makes the plan at places of the knobs, and judges it if it takes less than a time,
s."""


def boldest(
    attempt: Try, careful: tuple[float, ...], bold: tuple[float, ...], most: int
) -> list[Tried]:
    """Try at most ``most`` plans, from a bold place to a careful one, until one passes."""
    trials: list[Tried] = []
    for k in range(most):
        share = 1.0 - k / max(most - 1, 1)
        places = tuple(c + share * (b - c) for c, b in zip(careful, bold, strict=True))
        trials.append(attempt(places, math.inf))
        if trials[-1].passed:
            break
    return trials


def improved(
    attempt: Try, tried: list[Tried], most: int, tick_s: float, careful: tuple[float, ...]
) -> None:
    """Try ``most`` plans that are expected to be shorter than the best one.

    Parameters
    ----------
    attempt
        Tries a plan.
    tried
        Plans tried so far; the search adds its own.
    most
        Largest number of further plans.
    tick_s
        Tick of the machine: durations of plans differ by whole ticks.
    careful
        Places from which the search begins if no plan passes yet.
    """
    random = np.random.default_rng(_SEED)
    width, failed, count = _FIRST_WIDTH, 0, len(careful)
    steps = [tuple(1.0 if k == j else 0.0 for k in range(count)) for j in range(count)]
    for _ in range(most):
        best = best_of(tried)
        places = careful if best is None else best.places
        best_s = math.inf if best is None or best.duration_s is None else best.duration_s
        if steps:  # at first each choice is made a little bolder by itself
            step = steps.pop(0)
            candidate = tuple(
                min(p + _FIRST_WIDTH * s, 1.0) for p, s in zip(places, step, strict=True)
            )
        else:
            candidate = _promising(tried, places, best_s, width, tick_s, random)
        tried.append(attempt(candidate, best_s - AS_GOOD * tick_s))
        if tried[-1].passed:
            width, failed = min(width * _WIDER, _FIRST_WIDTH), 0
            continue
        failed += 1 if tried[-1].used else 0
        # A plan without simulation was no shorter than the best, so candidates are drawn farther
        # away.
        width = width if tried[-1].used else min(width * _WIDER, _FIRST_WIDTH)
        if tried[-1].used and failed % _PATIENCE == 0:
            width = width * _NARROWER if width > _LAST_WIDTH else _FIRST_WIDTH


def best_of(tried: Sequence[Tried]) -> Tried | None:
    """Return the shortest plan that passes; None without one."""
    passed = [one for one in tried if one.passed and one.duration_s is not None]
    return min(
        passed, key=lambda one: (one.duration_s, max(one.used.values(), default=0.0)), default=None
    )


def _promising(
    tried: Sequence[Tried],
    places: tuple[float, ...],
    best_s: float,
    width: float,
    tick_s: float,
    random: np.random.Generator,
) -> tuple[float, ...]:
    """Return the candidate near the best place with the largest expected gain of time."""
    centre = np.array(places)
    candidates = np.clip(
        centre + width * random.standard_normal((_CANDIDATES, len(centre))), 0.0, 1.0
    )
    timed = [one for one in tried if one.duration_s is not None]
    if len(timed) < 2:
        return tuple(candidates[0].tolist())
    predicted_s, scatter_s = _plane(
        timed, [one.duration_s or 0.0 for one in timed], centre, candidates
    )
    reference_s = best_s if math.isfinite(best_s) else max(one.duration_s or 0.0 for one in timed)
    scatter_s = max(scatter_s, _TICKS * tick_s)
    standard_gains = (reference_s - AS_GOOD * tick_s - predicted_s) / scatter_s
    normal = NormalDist()
    merits = np.array([a * normal.cdf(a) + normal.pdf(a) for a in standard_gains.tolist()])
    for name in {name for one in tried for name in one.used}:
        judged = [one for one in tried if name in one.used]
        logs_used = [math.log(min(max(one.used[name], _LEAST_USED), _MOST_USED)) for one in judged]
        predicted_logs, scatter = _plane(judged, logs_used, centre, candidates)
        scatter = max(scatter, _NOISE)
        merits *= [normal.cdf(-error / scatter) ** _CAUTION for error in predicted_logs.tolist()]
    return tuple(candidates[int(np.argmax(merits))].tolist())


def _plane(
    tried: Sequence[Tried], values: Sequence[float], centre: FloatArray, points: FloatArray
) -> tuple[FloatArray, float]:
    """Return (m,) values of a plane at the (m, knobs) places ``points``, and its scatter.

    The plane is fitted to the ``values`` of the trials; trials near ``centre`` have the most
    weight. The scatter is the weighted root mean square of the residuals.
    """
    offsets = np.array([one.places for one in tried]) - centre
    weight = np.exp(-0.5 * (offsets**2).sum(axis=1) / _NEAR**2) + 1e-6
    rows = np.concatenate([np.ones((len(offsets), 1)), offsets], axis=1)
    observed = np.array(values)
    ridge = _RIDGE * weight.sum() * np.eye(rows.shape[1])
    ridge[0, 0] = 0.0
    weighted = (rows * weight[:, None]).T
    fitted = np.linalg.solve(weighted @ rows + ridge, weighted @ observed)
    residuals = observed - rows @ fitted
    scatter = math.sqrt(float((weight * residuals**2).sum() / weight.sum()))
    predicted = np.concatenate([np.ones((len(points), 1)), points - centre], axis=1) @ fitted
    return np.asarray(predicted), scatter
