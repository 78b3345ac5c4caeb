"""Numbers of axes that turn without end, in programs for firmwares with single precision.

Such a firmware keeps a position in 24 bits, so a growing number loses decimals: beyond 131 072 deg
two neighbouring numbers are 0.016 deg apart. Where the job rests, the program therefore subtracts
whole turns from the position, if the firmware has a word for it: G92.9 of Marlin (2.1.3) and G92 of
RepRapFirmware set the position itself. G92 of grbl, FluidNC and Marlin only shifts the numbers of
the program, and the position keeps growing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from decimal import Decimal

import numpy as np

from threadline.commands.boards import BOARDS
from threadline.commands.planned_job import CHORD_TOLERANCE_M
from threadline.errors import PlanError
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.machine import Machine

_TAKEN_OFF_FROM = 0.1
"""Whole turns are subtracted when two numbers differ by this share of a chord's tolerance."""


class EndlessNumbers:
    """The written numbers of the axes of a program.

    Parameters
    ----------
    target
        Firmware of the program.
    names
        Axes of the job.
    machine
        Machine of the plan.
    """

    def __init__(self, target: str, names: Sequence[str], machine: Machine) -> None:
        self._target, self._names, self._word = target, names, BOARDS[target].rezero
        self._turns = [0] * len(self._names)
        radius = dict(zip(machine.axis_names, machine.radius_m.tolist(), strict=True))
        single = DIALECTS[target].grammar.single
        self._radius_mm = {
            index: 1e3 * radius[name]
            for index, name in enumerate(self._names)
            if single and machine.axes[name].kind != "linear" and machine.axes[name].endless
        }

    def written(self, at: list[str]) -> list[str]:
        """Return the numbers of a position as the program writes them.

        Raises
        ------
        PlanError
            If the firmware cannot tell apart numbers within the tolerance of a chord.
        """
        if not any(self._turns) and not self._radius_mm:
            return at
        now = [
            _plain(Decimal(text) - 360 * turns) if turns else text
            for text, turns in zip(at, self._turns, strict=True)
        ]
        for index in self._radius_mm:
            lost_mm = self._lost_mm(index, now[index])
            if lost_mm > 1e3 * CHORD_TOLERANCE_M:
                raise PlanError(
                    f"{self._names[index]} turns on to {now[index]} deg: {self._target} stores "
                    f"positions in 24 bits, in steps of {lost_mm:.2g} mm at the tool there",
                    remedy="Let the job rest between its parts (M0, or G4): whole turns are then "
                    "subtracted."
                    if self._word
                    else "Cut the job into programs, and home or reset the controller before each, "
                    "or write it for klipper or linuxcnc.",
                )
        return now

    def taken_off(self, at: list[str]) -> Iterator[str]:
        """Yield the line that takes whole turns off at a rest, if an axis has turned far enough."""
        words = []
        for index in self._radius_mm if self._word else ():
            if (
                self._lost_mm(index, self.written(at)[index])
                > _TAKEN_OFF_FROM * 1e3 * CHORD_TOLERANCE_M
            ):
                self._turns[index] = math.floor(Decimal(at[index]) / 360)
                words.append(f"{self._names[index]}{self.written(at)[index]}")
        if words:
            yield " ".join([self._word, *words])

    def _lost_mm(self, index: int, number: str) -> float:
        """Return the distance between two neighbouring numbers of an axis, mm at the tool."""
        step_deg = float(np.spacing(np.float32(abs(float(number)))))
        return float(math.radians(step_deg) * self._radius_mm[index])


def _plain(number: Decimal) -> str:
    text = f"{number:f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
