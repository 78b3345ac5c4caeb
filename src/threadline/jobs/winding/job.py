"""The reader of windings: it turns a product file with layers into a job of moves of the eye.

It warns of a firmware planner and of a spool that do not suit the winding.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import open_binary
from threadline.errors import JobError, OptionError, Place
from threadline.files import Stream
from threadline.jobs.operations import (
    Job,
    OperationStream,
)
from threadline.jobs.winding.build_up import Laid, bridged, design
from threadline.jobs.winding.circuit import Circuit
from threadline.jobs.winding.eye_path import EyePath, chord_points, eye_path, positions
from threadline.jobs.winding.joins import Join, join
from threadline.jobs.winding.laps import Grid, Laps, moves_of, on_grid
from threadline.jobs.winding.layers import USUAL_SPEED_M_S, Winding, read_layers
from threadline.machine import Machine
from threadline.machine.motion_planner import MarlinPlanner
from threadline.machine.spool import Spool
from threadline.machine.tool import Tool
from threadline.winding.product import product_of_text
from threadline.winding.replay import Replay
from threadline.winding.surface import Surface

SUFFIX = ".wind.toml"
_DISTANCES_M = (0.01, 0.015, 0.02, 0.03, 0.04, 0.055, 0.075)
_FIRST_CHORDS = 4.0  # times the tolerance: chords of the eye that are tried first
_HALVINGS = 6
_JOIN_CHORDS = 0.5  # times the tolerance: chords of the eye in a join
_NO_BETTER = 0.8  # times the error with steps twice as long
_TOLERANCE_SHARE = 0.9  # of the tolerance
_CHECKED = 2  # circuits that are replayed
_CHORD_M, _SAGITTA_M = 5e-4, 3e-7  # of the replay's check: on a large mandrel by the sagitta
_TIED_M = 1e-3  # a tied place within this of the turn is the turn
_LEAST_USED = 0.3  # of the laid fibre: a move that draws less takes the time of this
_LEAST_S = 1e-4  # of a move
_LAST_STEPS = 8.0  # in the last move before a rest
_LINEAR = ("X", "Y", "Z")  # letters whose way is the length of a move
_TENSION_SHARE = 0.05  # of a tension, as the winder thesis lets it vary


def is_winding(path: Path) -> bool:
    """Return whether a file is named as a product file (``.wind.toml``)."""
    return path.name.lower().endswith(SUFFIX)


def own_product(path: Path) -> str:
    """Return the text of a job's own product, with the place where its fibre is tied.

    Raises
    ------
    JobError
        If the file cannot be read or wound.
    """
    winding = read_layers(path)
    laid = design(winding)
    tied_m = tied_place(winding, laid[0])
    content = json.loads(winding.text)
    content["fibre"] = {**content.get("fibre", {}), "tied": f"{1e3 * tied_m!r} mm"}
    text = json.dumps(content, ensure_ascii=True, sort_keys=True)
    product_of_text(text)
    return text


def tied_place(winding: Winding, first: Laid) -> float:
    """Return the place along the mandrel, m, where the fibre is tied: its first turn."""
    course = first.circuit.left.rows[-1:, 1]
    turn_m = float(first.wrap.surface.at(course)[0][0, 0])
    tied = winding.product.tied
    if tied is not None and abs(tied - turn_m) > _TIED_M:
        winding.refuse(
            first.layer,
            f"the fibre is tied at {1e3 * tied:.4g} mm, and the first layer begins where it turns "
            f"back, at {1e3 * turn_m:.4g} mm",
            "Leave [fibre] tied out.",
        )
    return turn_m


def read_winding(path: str | Path, *, machine: Machine) -> Job:
    """Return the job of a winding: from its file to the moves of mandrel and eye.

    Parameters
    ----------
    path
        Product file with layers.
    machine
        Machine with an eye.

    Raises
    ------
    JobError
        If the file cannot be read, or a layer cannot be wound on this machine; gives the line.
    OptionError
        If the machine has no eye that can be planned for.
    """
    _eye(machine)
    winding = read_layers(Path(path))
    return job_of(winding, design(winding), machine)


def job_of(winding: Winding, laid: tuple[Laid, ...], machine: Machine) -> Job:
    """Return the job of a winding whose layers were designed.

    Raises
    ------
    JobError
        If a layer cannot be wound on this machine; gives the line.
    OptionError
        If the machine has no eye that can be planned for.
    """
    path, tool = winding.path, _eye(machine)
    tied_place(winding, laid[0])
    laps: list[Laps] = []
    warnings: list[str] = [*turning_at_once(machine, tool, path), *other_tensions(machine, winding)]
    side = -1
    for layer_before, layer_laid in zip((None, *laid), laid, strict=False):
        if layer_before is not None:
            join_path = join(layer_before, layer_laid, side)
            laps.append(_join_laps(winding, join_path, layer_laid, machine, tool))
            side = join_path.side
        layer_laps, layer_warnings = _laps(winding, layer_laid, machine, tool, side)
        laps.append(layer_laps)
        warnings += layer_warnings
    linear = tuple(axis.kind == "linear" for axis in machine.axes.values())
    laps = [on_grid(layer_laid, Grid(linear)) for layer_laid in laps]
    approach = _approach(tool), linear, _last_way(machine)
    stream = Stream(moves_of, tuple(laps), str(path), machine.axis_names, approach)
    return Job(
        capped=_capped(tuple(laps), machine, winding),
        name=winding.product.name,
        file=str(path),
        sha256=_sha256(path),
        axes=machine.axis_names,
        start=(0.0,) * len(machine.axis_names),
        operations=OperationStream(stream),
        warnings=tuple(warnings),
    )


def _last_way(machine: Machine) -> tuple[float, ...]:
    """Return the least way of the last move before a rest, m or rad: some steps of a stepper."""
    if not machine.takes_positions:
        return (0.0,) * len(machine.axis_names)
    return tuple((_LAST_STEPS / machine.counts_per_unit).tolist())


def _capped(laps: tuple[Laps, ...], machine: Machine, winding: Winding) -> tuple[str, ...]:
    """Return a warning if the operator's normal feed slows moves down."""
    if machine.operator is None:
        return ()
    counts = machine.counts_per_unit * float(machine.tick_clock.period_s)
    normal = machine.operator.normal_feed.si
    capped_moves, moves = 0, 0
    for lap in laps:
        rates = np.abs(np.diff(lap.points, axis=0)) * counts / lap.seconds[:, None]
        capped_moves += int((rates.max(axis=1) > normal * (1.0 + 1e-9)).sum()) * lap.count
        moves += len(rates) * lap.count
    if not capped_moves:
        return ()
    speed = 1e3 * (winding.speed_m_s or USUAL_SPEED_M_S)
    return (
        f"{Place(str(winding.path))}: a fibre speed of {speed:g} mm/s is faster than the normal "
        f"feed of {normal:g} count/tick in {capped_moves} of {moves} moves, which caps it. Choose "
        "another feed with --feed, or raise operator.normal_feed.",
    )


def _sha256(path: Path) -> str:
    with open_binary(path) as stream:
        return hashlib.sha256(stream.read()).hexdigest()


def _eye(machine: Machine) -> Tool:
    tool = machine.tool
    if tool is None or tool.kind != "eye":
        raise OptionError(
            f"a winding needs the eye of a winder, and {machine.name} has none",
            remedy='Describe it in the machine file: [tool] kind = "eye", turn, along and across.',
        )
    if tool.roller_m[3] != 0.0:
        raise OptionError(
            f"the eye of {machine.name} has a roller of {1e3 * abs(tool.roller_m[3]):g} mm: "
            "windings are planned for a plain eye",
            remedy="Plan for a machine file without [tool] roller, and prove on the one with it.",
        )
    return tool


def _join_laps(winding: Winding, join_path: Join, laid: Laid, machine: Machine, tool: Tool) -> Laps:
    """Return a join as positions of the axes; its rows are the only circuit."""
    path = _with_envelope(winding, laid, join_path.course, machine, tool)
    chord_rows = chord_points(path.eye, _JOIN_CHORDS * winding.tolerance_m)
    laps = _timed(winding, laid, path, chord_rows, machine, tool)
    return replace(laps, count=1, further=np.zeros(len(machine.axis_names)))


def _laps(
    winding: Winding, laid: Laid, machine: Machine, tool: Tool, side: int
) -> tuple[Laps, tuple[str, ...]]:
    """Return the circuits of a layer as positions of the axes, and warnings."""
    circuit = laid.circuit
    course = circuit.course(side)
    path = _with_envelope(winding, laid, course, machine, tool)
    chord_rows, off_m = _checked(winding, circuit, path, tool)
    warnings = []
    place = Place(str(winding.path), laid.layer.line)
    if (hollow := bridged(laid)) is not None:
        warnings.append(hollow)
    if off_m > winding.tolerance_m:
        reason = "" if circuit.surface.convex else ": the surface below has hollows"
        warnings.append(
            f"{place}: the fibre is laid up to {1e3 * off_m:.3g} mm beside its design{reason}."
        )
    take_up = winding.product.take_up
    if path.slack_m > 1e-6 and path.slack_m > (take_up or 0.0):
        take_up_text = (
            "no [fibre] take_up is known"
            if take_up is None
            else (f"the take-up holds {1e3 * take_up:.3g} mm")
        )
        warnings.append(
            f"{place}: {1e3 * path.slack_m:.3g} mm of fibre go "
            f"back through the eye at a turn, and {take_up_text}."
        )
    return _timed(winding, laid, path, chord_rows, machine, tool), tuple(warnings)


def _timed(
    winding: Winding, laid: Laid, path: EyePath, chord_rows: IntArray, machine: Machine, tool: Tool
) -> Laps:
    """Return points of a path as positions of the axes, at the wanted speed of the fibre."""
    points = positions(tool, machine.axis_names, path.eye[chord_rows], winding.product.at.si)
    further = np.zeros(len(machine.axis_names))
    assert tool.turn is not None
    further[machine.axis_names.index(tool.turn.axis)] = laid.circuit.advance / tool.turn.factor
    speed = winding.speed_m_s or USUAL_SPEED_M_S
    used = np.diff(path.used_m[chord_rows])
    laid_m = np.diff(path.course[chord_rows, 0])
    seconds = np.maximum(np.maximum(used, _LEAST_USED * laid_m) / speed, _LEAST_S)
    layer = laid.layer
    return Laps(points, further, seconds, laid.pattern.circuits, layer.line, layer.tension_n)


def _with_envelope(
    winding: Winding, laid: Laid, course: FloatArray, machine: Machine, tool: Tool
) -> EyePath:
    """Return the eye's path on the asked envelope, else on the one with the least time."""
    surface = laid.wrap.surface
    if tool.across is None:
        _, across, up = tool.payout_m
        return _path_on_envelope(
            winding, laid, surface, course, math.hypot(across, up), round_=True
        )
    least = (winding.product.clearance or 0.0) + tool.body_m
    if winding.envelope_m is not None:
        if winding.envelope_m < least:
            winding.refuse(
                laid.layer,
                f"an envelope of {1e3 * winding.envelope_m:.4g} mm: clearance and body of the eye "
                f"need {1e3 * least:.4g} mm",
                "Give a larger [fibre] envelope, or leave it out.",
            )
        return _path_on_envelope(winding, laid, surface, course, winding.envelope_m, round_=False)
    best, least_s = None, math.inf
    for distance in _DISTANCES_M:
        path = _path_on_envelope(winding, laid, surface, course, least + distance, round_=False)
        time_s = _least_time(path, machine, tool, winding)
        if best is None or time_s < least_s:
            best, least_s = path, time_s
    assert best is not None
    return best


def _path_on_envelope(
    winding: Winding, laid: Laid, surface: Surface, course: FloatArray, far: float, *, round_: bool
) -> EyePath:
    try:
        return eye_path(surface, course, far, round_)
    except JobError as error:
        winding.refuse(laid.layer, error.message, error.remedy)


def _least_time(path: EyePath, machine: Machine, tool: Tool, winding: Winding) -> float:
    """Return the time of a circuit within speed and acceleration of the axes, without ramps.

    Infinite where an axis would leave its travel.
    """
    names = machine.axis_names
    places = positions(tool, names, path.eye, winding.product.at.si)
    s_m = path.course[:, 0]
    first = np.gradient(places, s_m, axis=0)
    second = np.gradient(first, s_m, axis=0)
    speed_limit = np.full(len(s_m), np.inf)
    for column, name in enumerate(names):
        axis = machine.axes[name]
        if axis.travel is not None:
            low, high = (end.si for end in axis.travel)
            if places[:, column].min() < low or places[:, column].max() > high:
                return math.inf
        with np.errstate(divide="ignore"):
            speed_limit = np.minimum(speed_limit, axis.velocity.si / np.abs(first[:, column]))
            if axis.acceleration is not None:
                bend_limit = np.sqrt(axis.acceleration.si / np.abs(second[:, column]))
                speed_limit = np.minimum(speed_limit, bend_limit)
    if winding.speed_m_s is not None:
        speed_limit = np.minimum(speed_limit, winding.speed_m_s)
    steps_m = np.diff(s_m)
    return float((steps_m * 0.5 * (1.0 / speed_limit[1:] + 1.0 / speed_limit[:-1])).sum())


def _checked(
    winding: Winding, circuit: Circuit, path: EyePath, tool: Tool
) -> tuple[IntArray, float]:
    """Return the points of the path that keep the laid fibre within its tolerance.

    With them comes the distance of the laid fibre from the design, m.
    """
    tolerance = _FIRST_CHORDS * winding.tolerance_m
    chord_rows, off_m = chord_points(path.eye, tolerance), math.inf
    for _ in range(_HALVINGS):
        last_off, off_m = off_m, laid_error(circuit, path, path.eye[chord_rows], tool)
        # A fibre over a hollow lies beside its design, however fine the steps are.
        if off_m <= _TOLERANCE_SHARE * winding.tolerance_m or off_m > _NO_BETTER * last_off:
            break
        tolerance *= 0.5
        chord_rows = chord_points(path.eye, tolerance)
    return chord_rows, off_m


def laid_error(circuit: Circuit, path: EyePath, eye: FloatArray, tool: Tool) -> float:
    """Return the largest distance, m, between the designed fibre and the fibre that an eye lays.

    Parameters
    ----------
    eye
        (m, 3) turn, place along and distance of the eye in one circuit, linear between.
    """
    surface = circuit.surface
    laps = [eye]
    for lap in range(1, _CHECKED):
        laps.append(eye[1:] + np.array([lap * circuit.advance, 0.0, 0.0]))
    chain = np.vstack(laps)
    moves = np.abs(np.diff(chain, axis=0))
    move_m = np.maximum(moves[:, 0] * chain[1:, 2], np.maximum(moves[:, 1], moves[:, 2]))
    radius_m = float(surface.r[:, 0].max())
    chord_m = max(_CHORD_M, math.sqrt(8.0 * _SAGITTA_M * radius_m))
    count = np.maximum(np.ceil(move_m / chord_m), 1.0).astype(np.int64)
    row = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[row]
    points = np.vstack([chain[:1], chain[row] + share[:, None] * (chain[row + 1] - chain[row])])
    columns = np.zeros((len(points), 6))
    columns[:, :3] = points
    plain = Tool(
        kind="eye", radius=tool.radius, turn=tool.turn, along=tool.along, across=tool.along
    )
    tied = float(surface.at(path.course[:1, 1])[0][0, 0])
    fibre = Replay(surface, plain, math.inf, tied).feed(columns)
    known = np.isfinite(fibre.u)
    if not known.any():
        return math.inf
    return _largest_distance(circuit, path.course, fibre.u[known], -fibre.angle[known])


def _largest_distance(
    circuit: Circuit, course: FloatArray, u: FloatArray, angle: FloatArray
) -> float:
    """Return the largest distance of places, in the order of the course, from the course."""
    laps = [course]
    length = float(course[-1, 0])
    for lap in range(1, _CHECKED + 1):
        laps.append(course[1:] + np.array([lap * length, 0.0, lap * circuit.advance, 0.0]))
    chain = np.vstack(laps)
    # The angle round grows steadily: it names the place on the course, up to whole turns.
    angle = angle - 2.0 * math.pi * round(float(angle[0] - chain[0, 2]) / (2.0 * math.pi))
    course_u = np.interp(angle, chain[:, 2], chain[:, 1])
    winding = np.interp(angle, chain[:, 2], chain[:, 3])
    return float((np.abs(u - course_u) * np.sin(winding)).max())


def _approach(tool: Tool) -> tuple[str, ...]:
    """Return the axes in the order in which they move to the first point."""
    first = [part.axis for part in (tool.across, tool.along) if part is not None]
    return tuple(first)


def turning_at_once(machine: Machine, tool: Tool, path: Path) -> tuple[str, ...]:
    """Return a warning if Marlin plans the mandrel as a rotary axis beside linear ones.

    Marlin then takes the length of a move, and the speed between two moves, from the linear axes
    alone. Where the carriage turns back, its travel vanishes, and so does this length: at the same
    speed in mm/s one move turns the mandrel several times as fast as the next.
    """
    if not isinstance(machine.planner, MarlinPlanner):
        return ()
    assert tool.turn is not None
    turn = tool.turn.axis
    along = "" if tool.along is None else tool.along.axis
    if turn in _LINEAR or along not in _LINEAR:
        return ()
    return (
        f"{Place(str(path))}: Marlin counts the speed of a move along {along} alone, so the speed "
        f"of {turn} jumps where {along} turns back. Wire the mandrel as X, Y or Z (overlay xyz of "
        "stepper-winder).",
    )


def other_tensions(machine: Machine, winding: Winding) -> tuple[str, ...]:
    """Return a warning for each layer whose tension the machine's spool does not give as it is.

    A brake that can be set follows the layers, but its spring arm may come to lie at a stop.
    """
    spool = machine.spool
    if spool is None:
        return ()
    if spool.most_torque is not None:
        return _beyond_the_arm(spool, winding)
    spool_n = spool.tension_n
    warnings = []
    for layer in winding.layers:
        tension_n = layer.tension_n
        if tension_n is None or abs(spool_n - tension_n) <= _TENSION_SHARE * tension_n:
            continue
        torque = spool.torque_for(tension_n)
        warnings.append(
            f"{Place(str(winding.path), layer.line)}: layer {layer.number} asks for a tension of "
            f"{tension_n:.3g} N, and the spool of {machine.name} gives {spool_n:.3g} N: set its "
            f"brake to about {torque:.3g} N m for this layer."
        )
    return tuple(warnings)


def _beyond_the_arm(spool: Spool, winding: Winding) -> tuple[str, ...]:
    """Return a warning for each layer at whose tension the spring arm lies at a stop."""
    low, high = spool.floats_n
    warnings = []
    for layer in winding.layers:
        tension_n = layer.tension_n
        if tension_n is None or low < tension_n < high:
            continue
        stop = "lower" if tension_n <= low else "upper"
        warnings.append(
            f"{Place(str(winding.path), layer.line)}: layer {layer.number} asks for a tension of "
            f"{tension_n:.3g} N, at which the spring arm lies at its {stop} stop: it takes up "
            f"no change. It is free from {low:.3g} to {high:.3g} N: change spool.arm.preload, "
            "or the tension."
        )
    return tuple(warnings)
