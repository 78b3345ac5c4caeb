"""Fit numbers of a machine to measured data, with uncertainties, and write the fitted machine."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.wording import ascii_only, nearest, toml_string
from threadline.errors import OptionError
from threadline.files.formats.common import atomic_file
from threadline.identify.estimate import (
    Estimate,
    Problem,
    check_range,
    combination_text,
    estimate,
    known_combinations,
    profile,
)
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.machine.numbers import is_whole, number_at, number_tables, with_numbers
from threadline.machine.quantity import Quantity
from threadline.units import unit_factor

_DEVIATIONS_95 = 1.959964  # deviations of a 95 % interval
_PROFILED = 2
_CORRELATED = 0.9
MOST_NUMBERS = 24
_WRITTEN_UNITS = {
    "s": "ms",
    "m": "mm",
    "H": "mH",
    "N*m": "N m",
    "kg*m^2": "kg m^2",
    "N*s/m": "N s/m",
    "N*m*s/rad": "N m s/rad",
    "N*m/A": "N m/A",
}
_LEAST_PERCENT, _MOST_PERCENT = 1e-4, 99.0


class Data(Protocol):
    """Measured data on a machine, which may have other overlays than the machine to fit."""

    @property
    def machine(self) -> Machine:
        """The machine on which the data was measured."""

    @property
    def name(self) -> str:
        """Name of the data, for messages."""

    @property
    def step(self) -> float:
        """Relative step of a number over which residuals change smoothly."""

    @property
    def robust(self) -> bool:
        """Whether the fit is robust against outliers."""

    @property
    def sources(self) -> IntArray:
        """(m,) source of each residual, counted from 0."""

    @property
    def floor(self) -> FloatArray:
        """(m,) least deviation of the noise of each residual: the rounding of its source."""

    @property
    def normalised(self) -> bool:
        """Whether the absolute magnitude of the response is unknown."""

    def residuals(self, numbers: Mapping[str, FloatArray]) -> FloatArray:
        """Return the (variants, m) residuals of numbers, dotted name to (variants,) SI values."""

    def left_over(self, residual: FloatArray, noise: FloatArray) -> list[str]:
        """Describe each place where the (m,) residuals exceed their noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedNumber:
    """A fitted number.

    Parameters
    ----------
    name
        Its dotted name.
    quantity
        The number in the machine file before the fit.
    value
        Fitted value, SI.
    deviation
        Relative standard deviation.
    least_deviation
        Smallest relative deviation of any unbiased fit to this data: the Cramer-Rao bound.
    interval
        Ends of the 95 % interval, SI, from the curvature of the sum of squares.
    profile
        Ends of the 95 % interval from the likelihood profile; None if it was not computed.
    """

    name: str
    quantity: Quantity
    value: float
    deviation: float
    least_deviation: float
    interval: tuple[float, float]
    profile: tuple[float, float] | None

    @property
    def tolerance(self) -> float:
        """Largest distance of an end of the 95 % intervals from the value, as a share of it."""
        ends: list[float] = [*self.interval, *(self.profile or ())]
        return max(abs(float(end) / self.value - 1.0) for end in ends)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The result of a fit.

    Parameters
    ----------
    machine
        The machine before the fit.
    fitted
        The same machine with the fitted numbers.
    numbers
        The fitted numbers, in the order in which they were asked for.
    estimate
        The estimate behind them, with covariance, residuals and noise.
    noise
        Per name of the data: deviation of its noise.
    unexplained
        Places where the model does not explain the data, in words; empty without any.
    """

    machine: Machine
    fitted: Machine
    numbers: tuple[FittedNumber, ...]
    estimate: Estimate
    noise: Mapping[str, float]
    unexplained: tuple[str, ...]

    @property
    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of numbers with a correlation beyond 0.9, and the correlation."""
        names, r = self.estimate.names, self.estimate.correlation
        pairs = [(i, j) for i in range(len(names)) for j in range(i)]
        return [
            (names[j], names[i], float(r[i, j])) for i, j in pairs if abs(r[i, j]) > _CORRELATED
        ]


def fit(
    machine: Machine, data: Sequence[Data], names: Sequence[str], *, starts: int | None = None
) -> Fit:
    """Fit numbers of a machine to data.

    One start is the machine's own numbers; the other starts lie within a factor of 3 of them.

    Parameters
    ----------
    data
        At least one set of measured data.
    names
        Dotted names of the numbers, such as ``"links.x_belt.stiffness"``.
    starts
        See ``estimate``.

    Raises
    ------
    OptionError
        If a number does not exist or cannot be fitted, or the data does not determine the numbers;
        the message then names the combinations that it determines.
    """
    start = _first_guesses(machine, data, names)
    problem = _problem(data, names, start)
    estimated = estimate(problem, starts)
    _refuse_unknown(machine, data, estimated, start)
    check_range(estimated)
    values = start * np.exp(estimated.log_factor)
    profiled = np.argsort(-estimated.deviation)[:_PROFILED].tolist()
    numbers = []
    for k, name in enumerate(names):
        spread = _DEVIATIONS_95 * estimated.deviation[k]
        # With rounding, the residuals of recordings are rough functions of the numbers, and a
        # profile would follow the roughness.
        ends = profile(problem, estimated, k) if k in profiled and problem.robust else None
        numbers.append(
            FittedNumber(
                name=name,
                quantity=number_at(machine, name),
                value=float(values[k]),
                deviation=float(estimated.deviation[k]),
                least_deviation=float(estimated.least_deviation[k]),
                interval=(float(values[k] * np.exp(-spread)), float(values[k] * np.exp(spread))),
                profile=None
                if ends is None
                else (float(start[k] * np.exp(ends[0])), float(start[k] * np.exp(ends[1]))),
            )
        )
    noise, unexplained = _left_over(data, estimated)
    return Fit(
        machine=machine,
        fitted=with_numbers(machine, dict(zip(names, values.tolist(), strict=True))),
        numbers=tuple(numbers),
        estimate=estimated,
        noise=noise,
        unexplained=unexplained,
    )


def _first_guesses(machine: Machine, data: Sequence[Data], names: Sequence[str]) -> FloatArray:
    """Return the (p,) values of the machine, from which the fit starts."""
    if not names:
        raise OptionError("no number is named", remedy="Name one: --numbers bodies.x.inertia.")
    if len(names) > MOST_NUMBERS:
        raise OptionError(f"{len(names)} numbers, at most {MOST_NUMBERS}", remedy="Name fewer.")
    start = []
    for name in names:
        if names.count(name) > 1:
            raise OptionError(f"{name} is named twice", remedy="Name it once.")
        quantity = number_at(machine, name)
        if is_whole(machine, name) or name.startswith(("axes.", "clocks.")):
            raise OptionError(
                f"{name} cannot be fitted: no part of the simulated machine varies with it",
                remedy="Name a number of bodies, links, drives or sensors.",
            )
        if quantity.si == 0.0:
            raise OptionError(
                f"{name} is 0, from which no fit can start",
                place=machine.place,
                remedy="Write a first guess into the machine file, within a factor of 3.",
            )
        start.append(quantity.si)
        if not any(_has_number(source.machine, name) for source in data):
            raise OptionError(f"no data depends on {name}", remedy="Leave it out.")
    return np.array(start)


def _has_number(machine: Machine, name: str) -> bool:
    try:
        number_at(machine, name)
    except OptionError:
        return False
    return True


def _problem(data: Sequence[Data], names: Sequence[str], start: FloatArray) -> Problem:
    """Return the fit of all data together, whose residuals follow one after the other."""
    names_of = [
        [k for k, name in enumerate(names) if _has_number(source.machine, name)] for source in data
    ]
    sources, count = [], 0
    for source in data:
        sources.append(source.sources + count)
        count += int(source.sources.max()) + 1

    def residuals(log_factor: FloatArray) -> FloatArray:
        values = start * np.exp(log_factor)
        parts = []
        for source, own_names in zip(data, names_of, strict=True):
            if own_names:
                parts.append(source.residuals({names[k]: values[:, k] for k in own_names}))
            else:
                unchanged = source.residuals(
                    {names[0]: values[:1, 0]} if _has_number(source.machine, names[0]) else {}
                )
                parts.append(np.repeat(unchanged, len(values), axis=0))
        return np.concatenate(parts, axis=1)

    return Problem(
        names=tuple(names),
        residuals=residuals,
        source=np.concatenate(sources),
        floor=np.concatenate([source.floor for source in data]),
        step=max(source.step for source in data),
        robust=all(source.robust for source in data),
    )


def _refuse_unknown(
    machine: Machine, data: Sequence[Data], estimated: Estimate, start: FloatArray
) -> None:
    """Refuse numbers that the data does not determine; name the combinations that it determines."""
    combinations = known_combinations(estimated)
    if combinations is None:
        return
    known = []
    inverse = np.linalg.pinv(estimated.jacobian, rcond=1e-6)
    for exponents in combinations:
        deviation = float(np.linalg.norm(exponents @ inverse))
        value = np.prod(np.abs(start * np.exp(estimated.log_factor)) ** exponents)
        text = combination_text(estimated.names, exponents)
        known.append(f"{text} = {value:.4g} SI +- {196.0 * deviation:.2g} %")
    if not known:
        raise OptionError(
            f"the data tells nothing of {', '.join(estimated.names)}",
            place=machine.place,
            remedy="Name numbers that change the measured output, or measure another output.",
        )
    remedy = f"Leave out {len(estimated.names) - len(known)} of the {len(estimated.names)} numbers"
    if any(source.normalised for source in data):
        remedy += ", or give responses with an absolute magnitude"
    raise OptionError(
        f"{len(estimated.names)} numbers, but the data determines only {len(known)} "
        f"combination{'s' * (len(known) != 1)}: {'; '.join(known)}",
        place=machine.place,
        remedy=f"{remedy}.",
    )


def _left_over(
    data: Sequence[Data], estimated: Estimate
) -> tuple[dict[str, float], tuple[str, ...]]:
    noise: dict[str, float] = {}
    unexplained: list[str] = []
    begin = 0
    for source in data:
        size = len(source.sources)
        rows = slice(begin, begin + size)
        noise[source.name] = float(np.median(estimated.noise[rows]))
        texts = source.left_over(estimated.residual[rows], estimated.noise[rows])
        unexplained += [f"{source.name}: {text}" for text in texts]
        begin += size
    return noise, tuple(unexplained)


def parse_numbers(text: str, machine: Machine) -> list[str]:
    """Return the dotted names in a comma-separated list.

    Raises
    ------
    OptionError
        If the machine has no such number.
    """
    from threadline.dynamics.values import number_paths

    names = [part.strip() for part in text.split(",") if part.strip()]
    known = number_paths(machine)
    for name in names:
        if name not in known and not name.startswith(("axes.", "clocks.")):
            raise OptionError(
                f"machine {machine.name!r} has no number {name!r}",
                remedy=nearest(name, known, "It has"),
            )
    return names


def quantity_text(number: FittedNumber, source: str) -> str:
    """Return a fitted number as text of a machine file.

    Parameters
    ----------
    source
        Source of the measurement, for the note.
    """
    unit = _WRITTEN_UNITS.get(number.quantity.unit, number.quantity.unit)
    value = number.value / (unit_factor(unit, number.quantity.unit) if unit else 1.0)
    percent = min(max(100.0 * number.tolerance, _LEAST_PERCENT), _MOST_PERCENT)
    return f"{value:.6g} {unit}".strip() + f" +- {percent:.2g} %, measured: {source}"


def base_lines(machine: Machine, folder: Path) -> list[str]:
    """Return the line of a machine file in ``folder`` that bases it on another machine."""
    name, overlays = split_reference(machine.reference)
    base = machine.reference
    if name.endswith(".toml"):
        base = "+".join([os.path.relpath(Path(name).resolve(), folder.resolve()), *overlays])
    return [f"base = {toml_string(base)}"]


def fitted_toml(result: Fit, source: str, folder: Path) -> str:
    """Return the text of the fitted machine's file, which is to lie in ``folder``."""
    machine = result.machine
    note = ascii_only(source)
    lines = [
        f"# Fitted by threadline fit to {note}; every tolerance is a 95 % interval.",
        *base_lines(machine, folder),
        f"name = {toml_string(machine.name.split('+')[0] + '-fitted')}",
        f"title = {toml_string(machine.title + ', fitted')}",
        *number_tables({n.name: quantity_text(n, f"fit to {note}") for n in result.numbers}),
    ]
    return "\n".join(lines) + "\n"


def write_fitted(result: Fit, source: str, file: Path) -> None:
    """Write the fitted machine.

    Raises
    ------
    RecordingError
        If the file cannot be written.
    """
    text = fitted_toml(result, source, file.parent)
    with atomic_file(file) as stream:
        stream.write(text.encode())
