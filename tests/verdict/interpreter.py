"""A second reading of ``docs/specs.md``: the criteria that cannot pass, from the bare samples.

It shares no code with the judge. It reads the specification with ``tomllib``, knows from the tables
of the document which channels each measure needs, and computes the simplest bounds of a measure:
for example, the distance of a sample from the whole path is never more than its contour error. If
the judge passes a criterion that cannot pass, this is a false proof.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

Floats = np.ndarray

UNIT = {"mm": 1e-3, "um": 1e-6, "m": 1.0, "deg": np.pi / 180.0, "rad": 1.0, "V": 1.0, "mV": 1e-3}
UNIT |= {"A": 1.0, "mA": 1e-3, "": 1.0, "%": 0.01, "s": 1.0, "ms": 1e-3, "mm/s": 1e-3, "m/s": 1.0}
UNIT |= {"deg/s": np.pi / 180.0, "rad/s": 1.0, "m/s^2": 1.0, "rad/s^2": 1.0}
UNIT |= {"m/s^3": 1.0, "rad/s^3": 1.0, "stitch": 1.0, "kHz": 1e3}
KIND_UNITS = {"voltage": {"V", "mV"}, "current": {"A", "mA"}, "operation": {""}}
KIND_UNITS |= {"input": {""}, "output": {""}, "torque_share": {""}}
KIND_UNITS |= {"velocity": {"mm/s", "m/s", "deg/s", "rad/s"}}
KIND_UNITS |= {"sensor": {"V", "mV", "count", "m/s^2", "rad/s^2"}}
LENGTHS, ANGLES = {"mm", "um", "m", "mm/s", "m/s"}, {"deg", "rad", "deg/s", "rad/s"}

# The tables of the document: (alternatives, whether every axis needs one) for each measure.
NEEDS: dict[str, list[tuple[tuple[str, ...], bool]]] = {
    "contour_error": [(("tool", "load"), True)],
    "progress_error": [(("tool", "load"), True)],
    "turning_point_error": [(("tool", "load"), False)],
    "repeatability": [(("tool", "load"), True)],
    "tracking_error": [(("commanded",), False), (("tool", "load", "measured"), False)],
    "velocity_ripple": [(("tool", "load"), True)],
    "stitch_length_error": [(("tool", "load"), True)],
    "stitch_speed_error": [(("tool", "load"), True)],
    "stitches_to_speed": [(("tool", "load"), True), (("commanded",), True)],
    "stitches_from_needle": [(("tool", "load"), True), (("commanded",), True)],
    "stitch_placement_error": [(("tool", "load"), True)],
    "seam_error": [(("tool", "load"), True)],
    "needle_time_error": [(("tool", "load"), True)],
    "residual_vibration": [(("tool", "load"), False), (("commanded",), True)],
    "settling_time": [(("tool", "load"), True), (("commanded",), True)],
    "dac_saturation": [(("voltage",), False)],
    "current_peak": [(("current",), False)],
    "current_rms": [(("current",), False)],
}
SWITCHED: dict[str, tuple[str, bool]] = {
    "residual_vibration": ("frame", False),
    "settling_time": ("frame", True),
    "end_position_error": ("load", False),
    "travel": ("load", False),
}
PER_AXIS = {"turning_point_error", "tracking_error", "residual_vibration", "dac_saturation"}
PER_AXIS |= {"current_peak", "current_rms", "travel", "velocity", "acceleration", "jerk"}
PER_AXIS |= {"end_position_error", "stitch_residual", "servo_force", "step_rate"}
MACHINE = ("travel", "velocity", "acceleration", "jerk")
STITCHED: dict[str, list[tuple[tuple[str, ...], bool]]] = {
    "stitch_residual": [(("load",), True)],
    "servo_force": [(("torque_share",), True)],
}
NEEDLE = "needle"
VALVES = ("travel", "switching_order", "switching_dwell", "valve_conflict", "over_level")


@dataclass
class Channel:
    """A channel of the file: chunks of (first tick, samples), and its description."""

    kind: str
    axis: str
    unit: str
    period_s: float
    chunks: list[tuple[int, Floats]]

    def times_s(self) -> Floats:
        return np.concatenate([self.period_s * (f + np.arange(len(v))) for f, v in self.chunks])

    def values(self) -> Floats:
        return np.concatenate([v for _, v in self.chunks]) * UNIT[self.unit]


@dataclass
class Stitch:
    """For each stitch: its instants by the command, its wanted duration, and whether it counts."""

    begin_s: float
    end_s: float
    wanted_m: float
    exempt: bool


@dataclass
class Facts:
    """The plan and the machine as plain numbers.

    ``places`` are (n, axes) places of the stitches of an embroidery machine, m; ``stitches`` are
    the stitches of a seam.
    """

    axes: Sequence[str]
    rotary: set[str]
    switched: bool
    begin_s: float
    end_s: float
    radius_m: Floats = field(default_factory=lambda: np.ones(1))
    vertices: Floats = field(default_factory=lambda: np.zeros((1, 1)))  # m and rad
    clamp_v: Mapping[str, float] = field(default_factory=dict)
    own: Mapping[tuple[str, str], float] = field(default_factory=dict)  # of (measure, axis)
    planned: Mapping[tuple[str, str], float] = field(default_factory=dict)  # extremes, likewise
    stitches: Sequence[Stitch] = ()
    places: Floats | None = None
    lag_s: float = 0.1
    off_m: float = 0.0  # largest distance of the command from the path


def refused(channels: Mapping[str, Channel], facts: Facts) -> str:
    """Return why the recording has to be refused; empty if it need not be."""
    for name, channel in channels.items():
        units = KIND_UNITS.get(channel.kind, {u for u in LENGTHS | ANGLES if "/" not in u})
        if channel.unit not in units:
            return f"{name} is in {channel.unit}"
        placed = channel.axis in facts.axes and channel.unit in LENGTHS | ANGLES
        if placed and (channel.unit in ANGLES) != (channel.axis in facts.rotary):
            return f"{name} is in {channel.unit}"
        end = None
        for first, values in channel.chunks:
            if len(values) and (first < 0 or (end is not None and first < end)):
                return f"{name} overlaps or goes back"
            if len(values):
                end = first + len(values)
    return ""


def lacking(channel: Channel | None, facts: Facts) -> str:
    """Return which part of a channel is missing for the motion; empty if nothing is."""
    if channel is None:
        return "absent"
    chunks = [(f, v) for f, v in channel.chunks if len(v)]
    if not chunks:
        return "empty"
    for (first, values), (after, _) in pairwise(chunks):
        if after > first + len(values):
            return "a gap"
    begin, end = chunks[0][0], chunks[-1][0] + len(chunks[-1][1])
    if begin * channel.period_s > facts.begin_s + 1.001 * channel.period_s:
        return "late"
    # The last sample may be missing if the machine has arrived before its time.
    if end * channel.period_s < facts.end_s - 1.001 * channel.period_s:
        return "early"
    return ""


def find(channels: Mapping[str, Channel], kinds: Sequence[str], axis: str) -> Channel | None:
    for kind in kinds:
        for channel in channels.values():
            if channel.kind == kind and channel.axis == axis:
                return channel
    return None


def number(text: object) -> float:
    """Return a limit in SI; a bare number is a share."""
    match = re.fullmatch(r"\s*(?:\+-)?([0-9.eE+-]+)\s*(.*)", str(text))
    assert match is not None, text
    return float(match[1]) * UNIT[match[2].strip()]


def asked(spec: str, facts: Facts) -> dict[tuple[str, str], tuple[list[float], bool]]:
    """Return the limits of each measure and axis, and whether it is required."""
    found: dict[tuple[str, str], tuple[list[float], bool]] = {}
    rows = tomllib.loads(spec)["criteria"]
    # A criterion of one axis goes before a criterion of every axis.
    for row in sorted(rows, key=lambda r: "axis" in r):
        name = row["name"]
        axes = [""] if name not in PER_AXIS else [row["axis"]] if "axis" in row else facts.axes
        for axis in axes:
            limits = []
            if row.get("limit") == "machine":
                limits = [facts.own[name, axis]] if (name, axis) in facts.own else []
            elif "limit" in row:
                limits = [number(row["limit"])]
            found[name, axis] = (limits, row.get("required", False))
    for (name, axis), limit in facts.own.items():
        limits, required = found.get((name, axis), ([], False))
        found[name, axis] = ([*limits, limit], required)
    return found


def cannot_pass(
    channels: Mapping[str, Channel], facts: Facts, spec: str
) -> dict[tuple[str, str], str]:
    """Return the measures and axes that no correct judge passes, each with the reason."""
    found: dict[tuple[str, str], str] = {}
    for (name, axis), (limits, _) in asked(spec, facts).items():
        why = _lack(name, axis, channels, facts)
        if not why and limits:
            least = _least(name, axis, channels, facts)
            if least > min(limits) * 1.001 + 1e-9:
                why = f"at least {least:.6g}, limit {min(limits):.6g}"
        if why:
            found[name, axis] = why
    return found


def _lack(name: str, axis: str, channels: Mapping[str, Channel], facts: Facts) -> str:
    if facts.switched:
        if name not in SWITCHED:
            return ""
        kind, every = SWITCHED[name]
        needs = [((kind,), every)]
    elif facts.places is not None:
        needs = STITCHED.get(name, [])
        if needs:
            why = lacking(channels.get(NEEDLE), facts)
            if why:
                return f"{NEEDLE}: {why}"
            entered = len(_entries(channels[NEEDLE]))
            if entered != len(facts.places):
                return f"{entered} entries of the needle, {len(facts.places)} stitches"
    else:
        needs = NEEDS.get(name, [])
    for kinds, every in needs:
        for one in facts.axes if every or not axis else [axis]:
            why = lacking(find(channels, kinds, one), facts)
            # On an on/off machine, steps that were recorded before the end may pass.
            if why and not (facts.switched and why in ("early", "late")):
                return f"{'/'.join(kinds)} of {one}: {why}"
    return ""


def _least(name: str, axis: str, channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return a lower bound of the measure; 0 if no simple one is known."""
    if (name, axis) in facts.planned:
        return facts.planned[name, axis]
    if facts.switched:
        return 0.0
    if facts.places is not None:
        return _of_stitches(name, axis, channels, facts)
    if name == "dac_saturation":
        volts = np.abs(find(channels, ("voltage",), axis).values())  # type: ignore[union-attr]
        return float((volts >= facts.clamp_v[axis]).mean())
    if name == "current_peak":
        return float(np.abs(find(channels, ("current",), axis).values()).max())  # type: ignore[union-attr]
    if name == "tracking_error":
        actual = find(channels, ("tool", "load", "measured"), axis)
        commanded = find(channels, ("commanded",), axis)
        assert actual is not None and commanded is not None
        ours, theirs = _by_tick(actual), _by_tick(commanded)
        return max((abs(ours[t] - theirs[t]) for t in ours.keys() & theirs.keys()), default=0.0)
    if name == "contour_error":
        return _off_path(channels, facts)
    if name == "progress_error":
        return _ahead(channels, facts)
    if name in ("stitch_length_error", "stitch_speed_error"):
        return _of_seam(name, channels, facts)
    if name in ("stitch_placement_error", "seam_error"):
        return _off_seam(channels, facts)
    return 0.0


def _entries(needle: Channel) -> list[tuple[int, int]]:
    """Return first tick and end of each stay of the needle in the cloth."""
    down = _by_tick(needle)
    found: list[list[int]] = []
    for tick in sorted(t for t, value in down.items() if value != 0):
        if found and found[-1][1] == tick:
            found[-1][1] = tick + 1
        else:
            found.append([tick, tick + 1])
    return [(begin, end) for begin, end in found]


def _of_stitches(name: str, axis: str, channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return a lower bound of a measure of an embroidery machine, sample by sample."""
    assert facts.places is not None
    entries = _entries(channels[NEEDLE]) if name in STITCHED else []
    if name == "stitch_residual":
        at = _by_tick(find(channels, ("load",), axis))  # type: ignore[arg-type]
        column = list(facts.axes).index(axis)
        return max(
            abs(at[t] - facts.places[k, column])
            for k, (begin, end) in enumerate(entries)
            for t in range(begin, end)
        )
    if name == "servo_force":
        share = _by_tick(find(channels, ("torque_share",), axis))  # type: ignore[arg-type]
        return max(abs(v) for t, v in share.items() if t < entries[-1][0])
    return 0.0


def _tool(channels: Mapping[str, Channel], facts: Facts) -> tuple[Floats, Floats]:
    """Return (n,) times, s, and (n, axes) positions of the tool, m, by its samples."""
    found = [find(channels, ("tool", "load"), axis) for axis in facts.axes]
    columns = [_by_tick(channel) for channel in found if channel is not None]
    ticks = sorted(set.intersection(*(set(c) for c in columns)))
    assert found[0] is not None
    points = np.array([[c[t] for c in columns] for t in ticks]) * facts.radius_m
    return np.array(ticks) * found[0].period_s, points


def _ahead(channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return how far the tool ran ahead of its command, at least.

    The bound is the distance to the nearest place of the command within the lag, less the distance
    of the tool from the path, which is at most its distance from the command about then.
    """
    commanded = [find(channels, ("commanded",), axis) for axis in facts.axes]
    if not all(one is not None and not lacking(one, facts) for one in commanded):
        return 0.0
    times, points = _tool(channels, facts)
    columns = [_by_tick(one) for one in commanded if one is not None]
    ticks = np.array(sorted(set.intersection(*(set(c) for c in columns))))
    way = np.array([[c[t] for c in columns] for t in ticks]) * facts.radius_m
    period_s = commanded[0].period_s  # type: ignore[union-attr]
    least = 0.0
    for time_s, point in list(zip(times, points, strict=True))[:: max(len(times) // 300, 1)]:
        since = (ticks * period_s >= time_s - facts.lag_s - 1e-9) & (
            ticks * period_s <= time_s + 1e-9
        )
        about = np.abs(ticks * period_s - time_s) <= facts.lag_s + 1e-9
        if since.sum() > 1:
            behind = _to_polyline(point, way[since])
            least = max(least, behind - _to_polyline(point, way[about]))
    return max(0.0, least - 2.0 * facts.off_m - 1e-4)


def _of_seam(name: str, channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return the least share by which a stitch is too long or short, or too fast or slow.

    A mean speed lies between the lowest and the highest speed; over a stitch it lies between its
    chord and the way through its samples, over its time.
    """
    times, points = _tool(channels, facts)
    if times[0] > 0.0:
        return 0.0  # begun late: the instant from which a sample counts is uncertain by a sample
    least = 0.0
    for stitch in facts.stitches:
        if stitch.exempt:
            continue
        ends = np.array([np.interp([stitch.begin_s, stitch.end_s], times, x) for x in points.T]).T
        chord = float(np.linalg.norm(ends[1] - ends[0])) / stitch.wanted_m
        if name == "stitch_length_error":
            least = max(least, abs(chord - 1.0) - 0.005)
            continue
        inside = points[(times > stitch.begin_s) & (times < stitch.end_s)]
        way = np.concatenate([ends[:1], inside, ends[1:]])
        length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / stitch.wanted_m
        least = max(least, chord - 1.0 - 0.02, 1.0 - length - 0.02)
    return least


def _off_seam(channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return the distance of a needle-down from the whole path, at least."""
    times, points = _tool(channels, facts)
    if times[0] > 0.0:
        return 0.0
    path = facts.vertices * facts.radius_m
    downs = np.array([s.end_s for s in facts.stitches])
    at = np.array([np.interp(downs, times, x) for x in points.T]).T
    return max((_to_polyline(point, path) for point in at), default=0.0) - 1e-5


def _by_tick(channel: Channel) -> dict[int, float]:
    factor = UNIT[channel.unit]
    return {f + i: v * factor for f, part in channel.chunks for i, v in enumerate(part.tolist())}


def _off_path(channels: Mapping[str, Channel], facts: Facts) -> float:
    """Return the distance of the farthest sample from the whole path, and the reverse, at least."""
    columns = []
    for axis in facts.axes:
        channel = find(channels, ("tool", "load"), axis)
        assert channel is not None
        columns.append(_by_tick(channel))
    ticks = sorted(set.intersection(*(set(c) for c in columns)))
    points = np.array([[c[t] for c in columns] for t in ticks]) * facts.radius_m
    path = facts.vertices * facts.radius_m
    worst = 0.0
    for point in points[:: max(len(points) // 400, 1)]:
        worst = max(worst, _to_polyline(point, path))
    for vertex in path:
        worst = max(worst, _to_polyline(vertex, points))
    return worst


def _to_polyline(point: Floats, line: Floats) -> float:
    start, way = line[:-1], np.diff(line, axis=0)
    square = (way**2).sum(axis=1)
    along = ((point - start) * way).sum(axis=1)
    u = np.clip(np.divide(along, square, out=np.zeros_like(square), where=square > 0), 0.0, 1.0)
    return float(np.linalg.norm(point - start - u[:, None] * way, axis=1).min())
