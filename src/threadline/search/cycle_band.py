"""Machines all over a band of modes, and what each of them makes of a cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine.vary import mode_off
from threadline.pipeline import simulate
from threadline.plan import Plan
from threadline.verdict import Judge, Spec, Verdict

MEASURE = "residual_vibration"
_MACHINES = 17


@dataclass(frozen=True, slots=True, kw_only=True)
class BandRun:
    """What one machine of the band made of a cycle.

    Parameters
    ----------
    relative
        By how much its modes are off, -0.2 ... 0.2 for instance.
    verdict
        Of one run.
    """

    relative: float
    verdict: Verdict

    @property
    def worst_m(self) -> float:
        """The largest residual vibration."""
        found = [r.measured for r in self.verdict.results if r.name == MEASURE]
        return max((value for value in found if value is not None), default=0.0)


def band_machines(machine: Machine, band: float) -> tuple[tuple[float, Machine], ...]:
    """Return machines all over the band, each with by how much its modes are off.

    Raises
    ------
    OptionError
        If the band is not above 0 and below 1.
    """
    if not 0.0 < band < 1.0:
        raise OptionError(
            f"a band of +-{band * 100:g} % must be above 0 % and below 100 %",
            remedy='A fifth to either side is "20 %".',
        )
    parts = np.linspace(-band, band, _MACHINES).tolist()
    return tuple((part, mode_off(machine, part)) for part in parts)


def over_band(
    plan: Plan, spec: Spec, machines: Sequence[tuple[float, Machine]]
) -> tuple[BandRun, ...]:
    """Return what each machine of a band makes of a plan, in one run each."""
    return tuple(
        BandRun(
            relative=part,
            # Amplitudes that follow from place and speed go by the mode of the machine that ran.
            verdict=Judge(replace(plan, machine=one), spec).verdict([simulate(plan.commands, one)]),
        )
        for part, one in machines
    )
