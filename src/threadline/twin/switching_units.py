"""Periods, dead times and valve times of an on/off machine as whole numbers of one unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np

from threadline.arrays import IntArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.numbers import exact_time_s
from threadline.machine.pneumatics import Cylinder
from threadline.machine.quantity import Quantity

_MOST_UNIT = 1 << 50


@dataclass(frozen=True, slots=True)
class Units:
    """Periods, dead times and valve times of a machine as integers; see ``Orders``."""

    scan: int
    sample: int
    opened: IntArray
    shut: IntArray
    share: IntArray


def units_of(
    machine: Machine, scan_s: Fraction, sample_s: Fraction, times_s: Mapping[str, float]
) -> Units:
    """Return scan, sample, dead times and those of valves in units in which they are whole.

    Parameters
    ----------
    times_s
        Times in which a variant differs from the machine, by their path in its file.

    Raises
    ------
    MachineError
        If a scan or one of the times has so many digits that no 64-bit count holds it.
    """
    whole = lcm(scan_s.denominator, sample_s.denominator)
    most = max(len(flows_of(cylinder)) for cylinder in machine.cylinders.values())
    opened, shut = np.zeros((2, len(machine.cylinders), most), dtype=np.int64)
    share = []

    def exact(path: str, own: Quantity | None) -> Fraction:
        if path in times_s:
            return exact_time_s(times_s[path])
        return Fraction(0) if own is None or own.exact_s is None else own.exact_s

    for row, (name, cylinder) in enumerate(machine.cylinders.items()):
        where = f"cylinders.{name}"
        delay = exact(f"{where}.delay", cylinder.delay)
        after = [
            (
                delay + exact(f"{where}.{sense}.opens", way.opens),
                delay + exact(f"{where}.{sense}.closes", way.closes),
            )
            for sense, way in (("forward", cylinder.forward), ("back", cylinder.back))
            for _ in way.flows
        ]
        times = [one for both in after for one in both]
        own = lcm(whole, *(one.denominator for one in times))
        if own * max(scan_s, sample_s, *times, Fraction(1)) > _MOST_UNIT:
            raise MachineError(
                f"cylinders.{name}: a dead time of {float(delay):.6g} s and a scan of "
                f"{float(scan_s):.6g} s have no common step above 1e-15 s",
                place=machine.place,
                remedy="Give them with fewer digits.",
            )
        for column, (late, early) in enumerate(after):
            opened[row, column], shut[row, column] = int(late * own), int(early * own)
        share.append(own // whole)
    return Units(
        int(scan_s * whole), int(sample_s * whole), opened, shut, np.array(share, dtype=np.int64)
    )


def flows_of(cylinder: Cylinder) -> list[tuple[str, str, float]]:
    """Return valve, flow control and sense of every flow of a cylinder, in their order."""
    return [
        (way.valve, flow, sign)
        for way, sign in ((cylinder.forward, 1.0), (cylinder.back, -1.0))
        for flow in way.flows
    ]
