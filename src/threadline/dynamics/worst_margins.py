"""The worst margins of a loop over the tolerances of its machine file.

The numbers of a machine change the logarithm of the plant's response nearly independently. The
changes of several numbers are therefore added, and a search moves one number after the other to the
end of its tolerance that makes the margin smaller. The reported margins are computed exactly on the
machine at the corner that the search finds. A worse machine may exist.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.loop_design import (
    ControllerKind,
    GridMargins,
    OpenPlant,
    grid_margins,
    open_plant,
    with_controller,
)
from threadline.dynamics.margins import unstable_eigenvalues
from threadline.machine import Machine
from threadline.machine.variants import uncertain, variant

_LEAST_EFFECT = 1e-6  # a smaller change of the logarithm of the plant's response is rounding
_ROUNDS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstMargins:
    """Margins of a loop on the worst machines within the tolerances.

    Parameters
    ----------
    phase_margin_deg, gain_margin
        The smallest phase margin and the smallest gain margin that were found, each on its own
        machine. An unstable loop has a negative phase margin, or a gain margin below 1. None if
        there is no gain crossover, or no phase crossover.
    stable
        Whether the loop is stable on both machines.
    at
        Numbers of the machine with the smallest phase margin, each with its end (``"+"``, ``"-"``);
        all other numbers are nominal.
    """

    phase_margin_deg: float | None
    gain_margin: float | None
    stable: bool
    at: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """The plant of an axis over the tolerances of the machine file.

    Parameters
    ----------
    machine, axis
        The machine and the axis.
    plant
        The plant with the numbers of the file.
    index
        (n,) indices in ``uncertain(machine)`` of the numbers that change the plant.
    lower, upper
        (n, k) change of the logarithm of the response with each number at its lower, and at its
        upper end.
    """

    machine: Machine
    axis: str
    plant: OpenPlant
    index: tuple[int, ...]
    lower: ComplexArray
    upper: ComplexArray

    def worst(self, kind: ControllerKind, gains: Mapping[str, float]) -> WorstMargins:
        """Return the worst margins of the axis with a controller of the given kind and gains."""
        L = self.plant.response * self.plant.controller(kind, gains)
        worst_cases: list[tuple[GridMargins, bool, FloatArray]] = []
        for measure in (_phase, _gain):
            signs = self._climbed(L, measure)
            margins, stable = self._exact(signs, kind, gains)
            worst_cases.append((margins, stable, signs))
        (by_phase, phase_stable, signs), (by_gain, gain_stable, _) = worst_cases
        names = [number.name for number in uncertain(self.machine)]
        return WorstMargins(
            phase_margin_deg=_or_none(by_phase.phase_deg[0]),
            gain_margin=_or_none(by_gain.gain_factor[0]),
            stable=phase_stable and gain_stable,
            at={
                names[k]: "+" if sign > 0.0 else "-"
                for k, sign in zip(self.index, signs, strict=True)
                if sign
            },
        )

    def _climbed(self, L: ComplexArray, measure: Callable[[GridMargins], FloatArray]) -> FloatArray:
        """Return (n,) ends (-1, 0, 1) of a machine that no change of one number makes worse."""
        count = len(self.index)
        signs = np.zeros(count)
        omega = self.plant.omega_rad_s
        least_margin = float(measure(grid_margins(L, omega))[0])
        for _ in range(_ROUNDS):
            last_margin = least_margin
            for k in range(count):
                candidate_signs = np.repeat(signs[None], 2, axis=0)
                candidate_signs[:, k] = (-1.0, 1.0)
                change = np.where(candidate_signs > 0, 1.0, 0.0) @ self.upper
                change = change + np.where(candidate_signs < 0, 1.0, 0.0) @ self.lower
                margins = measure(grid_margins(L * np.exp(change), omega))
                smallest = int(np.argmin(margins))
                if margins[smallest] < least_margin:
                    least_margin, signs = float(margins[smallest]), candidate_signs[smallest]
            if least_margin == last_margin:
                break
        return signs

    def _exact(
        self, signs: FloatArray, kind: ControllerKind, gains: Mapping[str, float]
    ) -> tuple[GridMargins, bool]:
        shares = np.zeros(len(uncertain(self.machine)))
        shares[list(self.index)] = signs
        worst_machine = variant(with_controller(self.machine, self.axis, kind, gains), shares)
        loop = axis_loop(worst_machine, self.axis)
        plant = open_plant(loop, self.plant.omega_rad_s)
        L = plant.response * plant.controller(kind, gains)
        stable = not len(unstable_eigenvalues(loop.closed().A))
        return grid_margins(L, plant.omega_rad_s), stable


def spread_of(machine: Machine, axis: str) -> Spread:
    """Return the plant of an axis over the tolerances of its machine file.

    The numbers of the present controller have no effect, because it will be replaced.
    """
    loop = axis_loop(machine, axis)
    plant = open_plant(loop)
    count = len(uncertain(machine))
    index, ends = [], []
    for k in range(count):
        changes = []
        for sign in (1.0, -1.0):
            shares = np.zeros(count)
            shares[k] = sign
            changed_plant = open_plant(axis_loop(variant(machine, shares), axis), plant.omega_rad_s)
            changes.append(np.log(changed_plant.response / plant.response))
            if np.abs(changes[0]).max() < _LEAST_EFFECT:
                break
        if len(changes) == 2:
            index.append(k)
            ends.append(changes)
    empty = np.zeros((0, len(plant.omega_rad_s)), dtype=np.complex128)
    return Spread(
        machine=machine,
        axis=axis,
        plant=plant,
        index=tuple(index),
        upper=np.array([end[0] for end in ends]) if ends else empty,
        lower=np.array([end[1] for end in ends]) if ends else empty,
    )


def _phase(margins: GridMargins) -> FloatArray:
    return margins.phase_deg


def _gain(margins: GridMargins) -> FloatArray:
    return margins.gain_factor


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
