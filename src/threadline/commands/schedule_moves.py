"""Moves of cylinders as levels of flow, their shaping, and the way of a cylinder home.

A cylinder moves home slowly until its contact is on, then pressure stays on for as long as the
whole stroke takes. A contact that is stuck on therefore starts no other cylinder before this
cylinder is home, wherever its piston stands.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import Place, PlanError, UnitError
from threadline.machine import Machine
from threadline.machine.pneumatics import Cylinder, Way
from threadline.motion.shaping import ControllerLimits, FlexibleMode, Realised, Shaper, realise
from threadline.motion.shaping.designs import DEFAULT_TOLERANCE
from threadline.motion.shaping.onoff.switched import Valves
from threadline.units import parse_quantity

_AMPLE = 2.0
_SPARE_S = 1.0
_WHOLE = 1.2  # strokes


@dataclass(frozen=True, slots=True, kw_only=True)
class HomeStage:
    """One cylinder on its way home.

    Parameters
    ----------
    on
        Outputs that move the cylinder home: its valve, and the flow controls of the smallest level.
    switch
        Contact that is on at the start of the cylinder.
    late_s
        Time without the contact after which the PLC reports a fault, s.
    pressed_s
        Time for which the pressure stays on after the contact, s.
    """

    on: tuple[str, ...]
    switch: str
    late_s: float
    pressed_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Homing:
    """One cylinder that an operation brings home, from its first scan to its arrival."""

    operation: int
    axis: str
    first_tick: int
    last_tick: int


def home_stage(machine: Machine, axis: str, place: Place | None = None) -> HomeStage:
    """Return how a cylinder is brought home; the times hold for all of its tolerances.

    Raises
    ------
    PlanError
        If no contact shows that the cylinder is home, or its tolerances allow a speed of 0.
    """
    cylinder = machine.cylinders[axis]
    level, flows = slowest(cylinder.back)
    # The lowest speed within the tolerances.
    off = sum(cylinder.back.flows[flow].tolerance_si for flow in flows)
    speed = (level - off) * cylinder.speed.least
    if speed <= 0.0:
        raise PlanError(
            f"{axis} may stand still on its way home: the tolerances of its speed and flow "
            "controls are as large as their values",
            place=place,
            remedy="Measure its speed.",
        )
    rest_s = cylinder.longest_rest_s(forward=False)
    return HomeStage(
        on=(cylinder.back.valve, *flows),
        switch=home_switch(machine, axis, place),
        late_s=_AMPLE * (cylinder.stroke.si / speed + rest_s) + _SPARE_S,
        pressed_s=_WHOLE * cylinder.stroke.si / speed + rest_s,
    )


def home_switch(machine: Machine, axis: str, place: Place | None = None) -> str:
    """Return the end switch that is on at the start of a cylinder; of several, the nearest.

    Raises
    ------
    PlanError
        If there is no such switch.
    """
    near = {
        name: contact.at.si
        for name, contact in machine.contacts.items()
        if contact.cylinder == axis and contact.beyond == "below" and contact.at is not None
    }
    if not near:
        raise PlanError(
            f"no contact shows that {axis} is home, so homing would not know when to stop it",
            place=place,
            remedy=f'Add a contact with cylinder = "{axis}", beyond = "below" to the machine file.',
        )
    return min(near, key=lambda name: near[name])


def slowest(way: Way) -> tuple[float, tuple[str, ...]]:
    """Return the smallest level above 0 of one direction, and the flow controls for that level."""
    sets = {flows: level for flows, level in way.levels().items() if level > 0.0}
    flows = min(sets, key=lambda chosen: sets[chosen])
    return sets[flows], flows


AT_ONCE = Valves(flows=(1.0,))
"""Valves whose flow follows each command immediately."""
_LEAST_TOLERANCE = 0.005
"""Levels closer than this count as equal: no flow control can be set more exactly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisShaping:
    """The shaping of one cylinder's moves.

    Parameters
    ----------
    shaper
        Shaper that is convolved with the level of the move: on at the start, off at the end.
    modes
        Modes that judge the train when its times are moved onto the scan; the worst mode counts.
    relative
        Half width of the frequency band of this judgement. None: the band in which the exact train
        stays within the tolerance.
    tolerance
        Tolerance of that band.
    """

    shaper: Shaper
    modes: tuple[FlexibleMode, ...]
    relative: float | None = None
    tolerance: float = DEFAULT_TOLERANCE

    def as_json(self) -> dict[str, Any]:
        """Return the shaper of the cylinder and its modes as JSON values."""
        modes = [
            {"frequency_hz": m.frequency_hz, "damping_ratio": m.damping_ratio} for m in self.modes
        ]
        return {"shaper": self.shaper.name, "modes": modes}


def shaping_words(shaping: AxisShaping | None) -> str:
    """Return words for the shaper of a cylinder and its modes."""
    if shaping is None:
        return "unshaped"
    modes = " and ".join(
        f"{m.frequency_hz:.4g} Hz, damping ratio {m.damping_ratio:.4g}" for m in shaping.modes
    )
    return f"shaped by {shaping.shaper.name} for {modes}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """A move as levels of flow.

    Parameters
    ----------
    ticks, levels
        Level from each scan on, the last level 0; scans count from the start of the move.
    wanted_m, commanded_m
        Requested distance, and distance covered in whole scans, m.
    speed_m_s
        Speed at level 1.
    realised
        Shaper on the scan; None for an unshaped move.
    """

    ticks: tuple[int, ...]
    levels: tuple[float, ...]
    wanted_m: float
    commanded_m: float
    speed_m_s: float
    realised: Realised | None


def move_levels(
    distance_m: float,
    cylinder: Cylinder,
    tick_s: float,
    shaping: AxisShaping | None,
    dwell_s: float = 0.0,
    valves: Valves = AT_ONCE,
) -> Levels:
    """Return the levels that cover ``distance_m``, a positive length, at the cylinder's speed.

    ``dwell_s`` is the shortest time between impulses of the shaper. If ``valves`` close later than
    they open, each stretch of flow is longer than its command, so the commands are made shorter.

    Raises
    ------
    PlanError
        If the distance is shorter than one scan of travel.
    """
    speed_m_s = cylinder.speed.si
    on_scans = distance_m / (speed_m_s * tick_s)
    on = round(on_scans - valves.longer)
    if on < 1:
        raise PlanError(
            f"a move of {cylinder.place(distance_m)} takes less than a scan of "
            f"{tick_s * 1e3:g} ms at {cylinder.pace(speed_m_s)}",
            remedy="Lower the speed or the scan.",
        )
    realised = None
    ticks: tuple[int, ...] = (0,)
    amplitudes = np.ones(1)
    if shaping is not None and len(shaping.shaper.times_s) > 1:
        realised = _on_the_scan(shaping, tick_s, dwell_s)
        ticks, amplitudes = realised.ticks, realised.shaper.amplitudes
    at, levels = _convolved(on, ticks, amplitudes)
    covered = float(on)
    if not valves.at_once:
        # The command alone gives the number of openings of each valve; shift its length to fit.
        on = max(on + round(on_scans - valves.covered(at, levels)), 1)
        at, levels = _convolved(on, ticks, amplitudes)
        covered = valves.covered(at, levels)
    return Levels(
        ticks=at,
        levels=levels,
        wanted_m=distance_m,
        commanded_m=covered * tick_s * speed_m_s,
        speed_m_s=speed_m_s,
        realised=realised,
    )


def _convolved(
    on: int, ticks: tuple[int, ...], amplitudes: FloatArray
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return ticks and levels of ``on`` scans at level 1, convolved with impulses."""
    steps: dict[int, float] = {}
    for tick, amplitude in zip(ticks, amplitudes, strict=True):
        steps[tick] = steps.get(tick, 0.0) + float(amplitude)
        steps[on + tick] = steps.get(on + tick, 0.0) - float(amplitude)
    at = sorted(steps)
    levels = np.cumsum([steps[tick] for tick in at])
    kept = [i for i in range(len(at)) if abs(steps[at[i]]) > 1e-12]
    return tuple(at[i] for i in kept), tuple(float(levels[i]) for i in kept)


def written_levels(
    text: str,
    distance_m: float,
    cylinder: Cylinder,
    tick_s: float,
    place: Place,
    valves: Valves = AT_ONCE,
) -> Levels:
    """Return the levels that a move list gives: ``"1 for 180 ms, 0 for 60 ms, ..."``.

    Raises
    ------
    PlanError
        If the text cannot be read, a time is not in whole scans, or the distance is off by a scan
        or more.
    """
    example = 'Write it like levels = "1 for 180 ms, 0 for 60 ms, 1 for 290 ms".'
    ticks, levels, now = list[int](), list[float](), 0
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s+for\s+(.+?)\s*", part)
        if match is None:
            raise PlanError(
                f"levels: {part.strip()[:40]!r} is not a level with its time",
                place=place,
                remedy=example,
            )
        try:
            span_s = parse_quantity(match[2], "s")
        except UnitError as error:
            raise PlanError(f"levels: {error.message}", place=place, remedy=example) from error
        scans = round(span_s / tick_s)
        if span_s <= 0.0:
            raise PlanError(
                f"levels: {match[2]} is not a duration above 0", place=place, remedy=example
            )
        if scans < 1 or abs(span_s - scans * tick_s) > 1e-6 * tick_s:
            raise PlanError(
                f"levels: {match[2]} is no whole number of scans of {tick_s * 1e3:g} ms",
                place=place,
                remedy="The valves switch on the scan of the PLC.",
            )
        level = float(match[1])
        if level == (levels[-1] if levels else 0.0):
            raise PlanError(
                f"levels are out of order: {part.strip()[:40]!r} repeats the level before it",
                place=place,
                remedy="Begin above 0, change with each one, and leave out the last 0.",
            )
        ticks.append(now)
        levels.append(level)
        now += scans
    if levels[-1] == 0.0:
        raise PlanError(
            "levels are out of order: they end with 0, which every move ends with by itself",
            place=place,
            remedy="Leave out the last 0.",
        )
    covered = (
        float(np.dot(np.diff([*ticks, now]), levels))
        if valves.at_once
        else valves.covered((*ticks, now), (*levels, 0.0))
    )
    speed_m_s = cylinder.speed.si
    commanded_m = covered * tick_s * speed_m_s
    if abs(commanded_m - distance_m) >= speed_m_s * tick_s:
        raise PlanError(
            f"the levels move the piston by {cylinder.place(commanded_m, '.2f')}, and its move is "
            f"{cylinder.place(distance_m, '.2f')}",
            place=place,
            remedy="Level times duration must add up to distance over speed."
            if valves.at_once
            else "Level times duration must add up to distance over speed, and each stretch of "
            f"flow is {valves.longer * tick_s * 1e3:g} ms longer than its command.",
        )
    return Levels(
        ticks=(*ticks, now),
        levels=(*levels, 0.0),
        wanted_m=distance_m,
        commanded_m=commanded_m,
        speed_m_s=speed_m_s,
        realised=None,
    )


def joined_levels(texts: Mapping[str, str]) -> str:
    """Return the levels of cylinders that move in one operation as one text, in their order."""
    return "; ".join(f"{axis}={text}" for axis, text in texts.items())


def levels_by_axis(text: str) -> dict[str, str]:
    """Return the levels of each cylinder; empty if the text is for the one moving cylinder."""
    if "=" not in text:
        return {}
    pairs = (part.split("=", 1) for part in text.split(";"))
    return {axis.strip(): levels.strip() for axis, levels in pairs}


def levels_text(levels: Levels, tick_s: float) -> str:
    """Return levels as text in the form of a move list."""
    spans = np.diff(levels.ticks)
    return ", ".join(
        f"{level:.6g} for {span * tick_s * 1e3:.9g} ms"
        for level, span in zip(levels.levels, spans.tolist(), strict=False)
    )


@lru_cache(maxsize=64)
def _on_the_scan(shaping: AxisShaping, tick_s: float, dwell_s: float) -> Realised:
    # The search takes seconds for long trains, so all moves of a cylinder share its result.
    return realise(
        shaping.shaper,
        shaping.modes,
        ControllerLimits(tick_s=tick_s, dwell_s=dwell_s),
        relative=shaping.relative,
        tolerance=shaping.tolerance,
    )


def valves_of(way: Way, tick_s: float) -> Valves:
    """Return the flow controls of one direction, with times in scans."""
    return Valves(
        flows=tuple(flow.si for flow in way.flows.values()),
        opens=way.opens_s / tick_s,
        closes=way.closes_s / tick_s,
    )


def open_flows(level: float, way: Way, machine: Machine, place: Place) -> tuple[str, ...]:
    """Return the flow controls whose flows add up to ``level``.

    Raises
    ------
    PlanError
        If no set of flow controls does, or the machine forbids levels above 1 or below 0.
    """
    tolerance = max(way.level_tolerance, _LEAST_TOLERANCE)
    assert machine.plc is not None
    if machine.plc.never_over and not -tolerance <= level <= 1.0 + tolerance:
        raise PlanError(
            f"the shaped command passes through level {level:.3f}, outside the unshaped 0 ... 1, "
            "which this machine forbids",
            place=place,
            remedy="Take a unit-magnitude shaper that is shorter than the move, or a slower speed.",
        )
    sets = way.levels()
    best = min(sets, key=lambda chosen: abs(sets[chosen] - level))
    if abs(sets[best] - level) > tolerance:
        known = ", ".join(dict.fromkeys(f"{value:.3g}" for value in sorted(sets.values())))
        unshaped = abs(level - 1.0) <= tolerance
        raise PlanError(
            f"no valves of {way.valve!r} make the level {level:.4f}; they make {known}",
            place=place,
            remedy=f"The flows {', '.join(way.flows)} must add up to 1."
            if unshaped
            else f"Set the flow controls {', '.join(way.flows)} so that one or some of them make "
            "it, or take a um- shaper, which needs none but 0 and 1.",
        )
    return best


def shortest_ticks(flow: str, chosen: list[tuple[str, ...]], ticks: tuple[int, ...]) -> int:
    """Return the smallest number of ticks between two switchings of ``flow``."""
    opened = [flow in names for names in chosen]
    before = [False, *opened[:-1]]
    changes = [t for t, now, was in zip(ticks, opened, before, strict=True) if now != was]
    return int(np.diff(changes).min()) if len(changes) > 1 else 1 << 62


def table_of(
    rows: Mapping[int, tuple[Mapping[str, int], int]], outputs: tuple[str, ...]
) -> tuple[IntArray, IntArray, IntArray]:
    """Return ticks, levels of all outputs, and operations of the rows with a change.

    Parameters
    ----------
    rows
        By tick: levels of the switched outputs, and the operation that switches them.
    """
    columns = {name: i for i, name in enumerate(outputs)}
    state = np.zeros(len(columns), dtype=np.int64)
    ticks, table, operations = list[int](), list[IntArray](), list[int]()
    for tick in sorted(rows):
        changes, operation = rows[tick]
        for name, value in changes.items():
            state[columns[name]] = value
        if table and np.array_equal(table[-1], state):
            continue
        ticks.append(tick)
        table.append(state.copy())
        operations.append(operation)
    return (
        np.array(ticks, dtype=np.int64),
        np.array(table, dtype=np.int64).reshape(len(table), len(columns)),
        np.array(operations, dtype=np.int64),
    )
