"""A second search for a cylinder's commands: ``python -m tools.second_search MACHINE AXIS BAND``.

It is a mixed integer program of its own (HiGHS), which shares nothing with the search of
``threadline fastest --band`` but the numbers of the move. A binary for each scan and flow control
says whether that is open. At each frequency of the band the ringing behind the command is within a
polygon inside the circle of the limit. Every duration from one scan below the bound up to that of
the found command is tried, for a time. Prints JSON: what both searches find, and whether shorter
commands were proven impossible or only not found. MACHINE is a machine or one of ``OWN``.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from threadline.dynamics.pneumatic import step_ringing
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import with_numbers
from threadline.machine.vary import mode_off
from threadline.motion.shaping.onoff.flow_search import FlowMove, least_scans, shortest_flow_command

OWN: dict[str, tuple[str, dict[str, float]]] = {
    # A gantry of two cylinders: 6.3 Hz across, 10.9 Hz up.
    "gantry": (
        "letter-placer",
        {
            "links.feet.stiffness": 80.54 * (2.0 * math.pi * 6.3) ** 2,
            "links.feet_up.stiffness": 82.54 * (2.0 * math.pi * 10.9) ** 2,
        },
    ),
    # A light frame with flow controls of three equal steps of speed, on scans of 5 ms.
    "light": (
        "letter-placer+quick",
        {
            "bodies.table.inertia": 20.0,
            "bodies.table_up.inertia": 25.0,
            "cylinders.X.speed": 0.6,
            "cylinders.X.forward.flows.x_right_a1": 2.0 / 3.0,
            "cylinders.X.forward.flows.x_right_a2": 1.0 / 3.0,
        },
    ),
}
_LIMIT_M = 1e-4
_SIDES = 32  # of the polygon: 0.5 % inside the circle
_FREQUENCIES = 33
_PROGRAMMED = 17  # frequencies in the program; all are checked behind it
_SHORT = 0.2  # scans by which the distance may differ, as in the first search


def machine_of(name: str) -> Machine:
    """Return a machine of ``OWN`` or of the library."""
    base, numbers = OWN.get(name, (name, {}))
    return with_numbers(load_machine(base), numbers) if numbers else load_machine(base)


def flow_move(machine: Machine, axis: str, band: float) -> FlowMove:
    """Return the whole stroke forward of a cylinder, at most 0.1 mm of ringing over the band."""
    from threadline.commands.schedule_moves import valves_of

    assert machine.plc is not None
    scan_s = float(machine.clock(machine.plc.clock).period_s)
    cylinder = machine.cylinders[axis]
    parts = np.linspace(-band, band, _FREQUENCIES if band else 1)
    ringing = [step_ringing(mode_off(machine, float(p)) if p else machine, axis) for p in parts]
    return FlowMove(
        on_scans=cylinder.stroke.si / (cylinder.speed.si * scan_s),
        valves=valves_of(cylinder.forward, scan_s),
        dwell_scans=math.ceil(cylinder.forward.least_hold_s(machine.plc) / scan_s - 1e-9),
        turns=np.exp(np.array([r.pole for r in ringing]) * scan_s),
        most=_LIMIT_M / np.array([abs(r.amplitude_m) for r in ringing]),
    )


def second(move: FlowMove, scans: int, limit_s: float) -> tuple[str, list[float]]:
    """Return "found", "impossible" or "not found", and the level of each scan if found."""
    flows = np.asarray(move.valves.flows)
    size = scans * len(flows)
    at = np.arange(size).reshape(scans, len(flows))
    rows, low, high = list[np.ndarray](), list[float](), list[float]()

    def bound(row: np.ndarray, least: float, most: float) -> None:
        rows.append(row)
        low.append(least)
        high.append(most)

    whole = np.tile(flows, scans)
    bound(whole, move.on_scans - _SHORT, move.on_scans + _SHORT)
    chosen = np.unique(np.linspace(0, len(move.turns) - 1, _PROGRAMMED).round().astype(int))
    inside = math.cos(math.pi / _SIDES)
    for turn, most in zip(move.turns[chosen], move.most[chosen], strict=True):
        # A level in scan k steps up at k and down at k + 1; both ring on until the end.
        seen = turn ** np.arange(scans, 0, -1.0) - turn ** np.arange(scans - 1, -1, -1.0)
        for side in range(_SIDES):
            direction = np.exp(2j * np.pi * side / _SIDES)
            bound((np.outer(seen, flows).ravel() * direction).real, -np.inf, most * inside)
    for flow in range(len(flows)):
        for k in range(-1, scans):
            for ahead in range(2, move.dwell_scans + 1):
                # What opens between k and k + 1 is open at k + ahead; what shuts stays shut.
                row = np.zeros(size)
                for index, sign in ((k, -1.0), (k + 1, 1.0), (k + ahead, -1.0)):
                    if 0 <= index < scans:
                        row[at[index, flow]] += sign
                bound(row, -1.0, 0.0)
    answer = milp(
        np.zeros(size),
        constraints=LinearConstraint(np.array(rows), low, high),
        integrality=np.ones(size, dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        options={"time_limit": limit_s},
    )
    if answer.x is None:
        return ("impossible" if answer.status == 2 else "not found"), []
    return "found", (np.rint(answer.x).reshape(scans, len(flows)) @ flows).tolist()


def left(move: FlowMove, levels: list[float]) -> float:
    """Return the worst ringing over the band behind levels for each scan, over its limit."""
    steps, size = np.diff([0.0, *levels, 0.0]), len(levels)
    grown = move.turns[:, None] ** np.arange(size, -1, -1.0)
    return float((np.abs(grown @ steps) / move.most).max())


def compared(name: str, axis: str, band: float, limit_s: float) -> dict[str, Any]:
    """Return what both searches find for the stroke of one cylinder."""
    machine = machine_of(name)
    move = flow_move(machine, axis, band)
    assert machine.plc is not None
    scan_s = float(machine.clock(machine.plc.clock).period_s)
    longest = math.ceil(2.5 * move.on_scans)
    least = least_scans(move, longest, 1)
    assert least is not None
    first = shortest_flow_command(move, least, longest)
    assert first is not None
    result: dict[str, Any] = {
        "unshaped_s": move.on_scans * scan_s,
        "bound_s": least * scan_s,
        "first_s": first.scans * scan_s,
        "second_s": None,
        "tried": {},
    }
    for scans in range(max(least - 1, 1), first.scans + 1):
        began = time.perf_counter()
        what, levels = second(move, scans, limit_s)
        if what == "found" and left(move, levels) > 1.0:
            what = f"found with {left(move, levels):.4g} of the limit"
        took_s = time.perf_counter() - began
        result["tried"][f"{scans * scan_s:.4g} s"] = f"{what} in {took_s:.2g} s"
        if what == "found":
            result["second_s"] = scans * scan_s
            break
    if result["second_s"] is not None:
        result["gain"] = 1.0 - result["second_s"] / result["first_s"]
    return result


def answers(name: str, axis: str, band: str, limit_s: str = "600") -> dict[str, Any]:
    """Return what ``compared`` does, from words of a command line; limit of each duration in s."""
    return compared(name, axis, float(band), float(limit_s))


def main() -> None:
    print(json.dumps(answers(*sys.argv[1:]), indent=1))


if __name__ == "__main__":
    main()
