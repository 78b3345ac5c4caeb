"""The scene of an animation: the drawn parts of a machine, and their places at each instant.

A scene consists of lines in a few groups. Each group is a rigid body, such as a mandrel that turns,
a carriage that travels, or a frame that carries its cloth. The path of the tool belongs to one of
the groups, so that a wound fibre turns with its mandrel. This file makes the scenes of all
machines; ``animation`` draws them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Motion, Scheduled, Stitched
from threadline.machine import Machine
from threadline.proof.pipeline import Proof
from threadline.report.traces import contour_along
from threadline.verdict import closing

FIXED = "fixed"
MOST_FRAMES = 240
_LONGEST_S = 20.0
_PER_SECOND = 12.0
_TRAIL_PER_FRAME = 16
_SWING_DRAWN = 10.0
_TURN, _RAISE = math.radians(-24.0), math.radians(24.0)
_MM = 1e3
_DONE, _ACTUAL = "as its limits allow", "actual, darker and wider where it is off"


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A line of a scene: (n, 3) points in mm, NaN at gaps; ``grey`` is 0 for white."""

    points: FloatArray
    group: str = FIXED
    grey: float = 0.75
    width: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Rigid motion of a group: (frames, 3) shifts in mm, and (frames,) angles about x in rad."""

    shift: FloatArray
    angle: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """All that an animation shows.

    Parameters
    ----------
    title, facts
        Title, and the lines of text below it.
    time_s
        (frames,) instant of each frame in the run.
    played_s
        Time that the animation takes.
    view
        (2, 3) directions of the picture's right and up; their product with a point projects it.
    towards
        (3,) direction from the scene to the eye.
    lines
        The drawn lines.
    groups
        Motion of every group but ``FIXED``.
    group
        Group of the path.
    actual, planned
        (samples, 3) path in mm in its group, as it was and as it was planned; ``samples`` is
        ``per_frame`` times the frames.
    error, limit, unit
        (samples,) error, its limit or None, and the unit of both. The error is empty for a machine
        without dynamics.
    error_words
        Name of the error.
    per_frame
        Samples of the path between two frames.
    labels
        Names of the paths for the legend, each with whether it is dashed.
    """

    title: str
    facts: tuple[str, ...]
    time_s: FloatArray
    played_s: float
    view: FloatArray
    towards: FloatArray
    lines: tuple[Drawn, ...]
    groups: Mapping[str, Group]
    group: str
    actual: FloatArray
    planned: FloatArray
    error: FloatArray
    limit: float | None
    unit: str
    error_words: str
    per_frame: int
    labels: tuple[tuple[str, bool], ...]

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.time_s)

    @property
    def speed(self) -> float:
        """Ratio of the speed of the animation to the speed of the machine."""
        return float(self.time_s[1] - self.time_s[0]) * self.frames / self.played_s


_Error = tuple[FloatArray, float | None, str]
"""Error at each sample in mm, its limit in mm, and its name."""
_NONE: _Error = (np.empty(0), None, "")


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Positions of a run over the samples of an animation, mm or rad, by axis."""

    time_s: FloatArray
    actual: Mapping[str, FloatArray]
    planned: Mapping[str, FloatArray]
    frames: NDArray[np.int64]
    other: Mapping[str, FloatArray]
    off: _Error = _NONE


def scene_of(proof: Proof) -> Scene:
    """Return the scene of the first run of a proof."""
    make_scene, error_of = _SCENES[type(proof.plan.intent)]
    run = _sampled(proof)
    return make_scene(proof, replace(run, off=error_of(proof, run)))


def _axes(proof: Proof, run: _Run) -> Scene:
    """Return the scene of a machine with axes: a winder, a stitcher or a gantry."""
    machine = proof.plan.machine
    turning = [name for name in proof.plan.axes if _is_turning(machine, name)]
    going = [name for name in proof.plan.axes if name not in turning]
    if turning and going:
        return _winder(proof, run, turning[0], going)
    if proof.plan.job.paced_by == "needle":
        return _stitcher(proof, run, going)
    return _gantry(proof, run, going or turning)


def _is_turning(machine: Machine, name: str) -> bool:
    axis = machine.axes.get(name)
    return axis is not None and axis.kind == "rotary"


def _sampled(proof: Proof) -> _Run:
    """Return a run at evenly spaced instants, with ``_TRAIL_PER_FRAME`` instants per frame."""
    recording, plan = proof.recording, proof.plan
    end_s = max(plan.duration_s, 1e-3)
    frames = int(min(MOST_FRAMES, max(24.0, min(end_s, _LONGEST_S) * _PER_SECOND)))
    time_s = np.linspace(0.0, end_s, frames * _TRAIL_PER_FRAME)
    channel_names = {channel.name for channel in recording.channels}
    names = [key for key in channel_names if key.endswith(".frame") or key == "needle"]
    loads = {
        name: f"{name}.load" if f"{name}.load" in channel_names else f"{name}.measured"
        for name in plan.axes
    }
    names_read = {*names, *(load for load in loads.values() if load in channel_names)}
    names_read |= {f"{name}.commanded" for name in plan.axes}
    at = {
        name: np.interp(time_s, *samples)
        for name, samples in recording.samples_of(names_read).items()
    }
    actual, planned = {}, {}
    for name, load in loads.items():
        scale = 1.0 if _is_turning(plan.machine, name) else _MM
        planned[name] = scale * at[f"{name}.commanded"]
        actual[name] = scale * at[load] if load in channel_names else planned[name]
    other = {name: at[name] for name in names}
    return _Run(time_s, actual, planned, np.arange(frames) * _TRAIL_PER_FRAME, other)


def _swing(_proof: Proof, run: _Run) -> _Error:
    swings_m = [values for name, values in run.other.items() if name.endswith(".frame")]
    return (_MM * np.hypot.reduce(swings_m), None, "swing of the frame") if swings_m else _NONE


def _off_command(proof: Proof, run: _Run) -> _Error:
    offsets_mm = [run.actual[name] - run.planned[name] for name in proof.plan.axes]
    return np.hypot.reduce(offsets_mm), None, "distance from the commanded place"


def _off_path(proof: Proof, run: _Run) -> _Error:
    if proof.plan.machine.without_dynamics:
        return _NONE
    limits = [one.limit for one in proof.spec.criteria if one.name == "contour_error" and one.limit]
    contour = contour_along(proof.recording, proof.plan, proof.spec.lag_s)
    if contour is None or not len(contour[0]):
        return _off_command(proof, run)
    limit = _MM * limits[0] if limits else None
    return _MM * np.interp(run.time_s, *contour), limit, "distance from the programmed path"


def _view(turned: float = _TURN, raised: float = _RAISE) -> tuple[FloatArray, FloatArray]:
    """Return (2, 3) directions right and up of a picture, and (3,) the direction to the eye."""
    level = np.array([math.sin(turned), -math.cos(turned), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    right = np.array([math.cos(turned), math.sin(turned), 0.0])
    rows = np.vstack([right, -math.sin(raised) * level + math.cos(raised) * up])
    return rows, math.cos(raised) * level + math.sin(raised) * up


_FROM_ABOVE = (np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.0, 0.0, 1.0]))


def _made(
    proof: Proof,
    run: _Run,
    lines: list[Drawn],
    groups: dict[str, Group],
    path: tuple[str, FloatArray, FloatArray],
    view: tuple[FloatArray, FloatArray],
    notes: tuple[str, ...] = (),
) -> Scene:
    error, limit, words = run.off
    group, actual, planned = path
    end_s = float(run.time_s[-1])
    played_s = min(max(end_s, 1.0), _LONGEST_S)
    without_dynamics = proof.plan.machine.without_dynamics
    labels: tuple[tuple[str, bool], ...] = (("planned", True),)
    labels += ((_DONE if without_dynamics else _ACTUAL, False),)
    return Scene(
        title=f"{proof.plan.job.name} on {proof.plan.machine.name}",
        facts=(closing(proof.verdict), *notes),
        time_s=run.time_s[run.frames],
        played_s=played_s,
        view=view[0],
        towards=view[1],
        lines=tuple(lines),
        groups=groups,
        group=group,
        actual=actual,
        planned=planned,
        error=error,
        limit=limit,
        unit="mm",
        error_words=words,
        per_frame=_TRAIL_PER_FRAME,
        labels=labels,
    )


def _moving(run: _Run, **shifts: FloatArray) -> Group:
    """Return the motion of a group, at its frames, from (samples,) shifts x, y and z in mm."""
    zero = np.zeros(len(run.time_s))
    shift = np.column_stack([shifts.get(name, zero) for name in "xyz"])[run.frames]
    return Group(shift, np.zeros(len(run.frames)))


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> FloatArray:
    """Return the edges of a box as one line with gaps."""
    gap = [[math.nan] * 3]
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    rows: list[list[float]] = []
    for level in (0, 1):
        rows += [[x[i], y[j], z[level]] for i, j in corners] + gap
    for i, j in corners[:4]:
        rows += [[x[i], y[j], z[0]], [x[i], y[j], z[1]], *gap]
    return np.array(rows)


def _winder(proof: Proof, run: _Run, turning: str, going: list[str]) -> Scene:
    """Return the scene of a winder: a turning mandrel with its fibre, and a carriage in front."""
    machine = proof.plan.machine
    axis = machine.axes[turning]
    x, feed = run.actual[going[0]], run.actual[going[1]] if len(going) > 1 else None
    first_mm, last_mm = float(x.min()), float(x.max())
    margin = max(0.12 * (last_mm - first_mm), 20.0)
    x_mm = np.linspace(first_mm - margin, last_mm + margin, 60)
    if axis.profile is None:
        radius = np.full(
            len(x_mm), _MM * float(machine.radius_m[list(machine.axes).index(turning)])
        )
    else:
        x_at, radius_at = (
            [_MM * one.si for one in column] for column in (axis.profile.at, axis.profile.radius)
        )
        radius = np.interp(x_mm, x_at, radius_at)
    largest = float(radius.max())
    angles = np.linspace(0.0, 2.0 * math.pi, 49)
    body = []
    for index in (0, len(x_mm) - 1, *range(6, len(x_mm) - 6, 12)):
        ring = radius[index] * np.exp(1j * angles)
        is_end = index in (0, len(x_mm) - 1)
        body.append(
            Drawn(
                np.column_stack([np.full(49, x_mm[index]), ring.real, ring.imag]),
                "mandrel",
                0.55 if is_end else 0.18,
                1.2 if is_end else 0.7,
            )
        )
    for angle in np.linspace(0.0, 2.0 * math.pi, 8, endpoint=False).tolist():
        line = np.column_stack([x_mm, radius * math.cos(angle), radius * math.sin(angle)])
        body.append(
            Drawn(line, "mandrel", 0.55 if angle == 0.0 else 0.2, 1.2 if angle == 0.0 else 0.7)
        )
    front = -(largest + max(30.0, 0.5 * largest))
    bed = -(largest + 25.0)
    ends = (float(x_mm[0]), float(x_mm[-1]))
    body += [
        Drawn(_box(ends, (front - 14.0, front + 14.0), (bed - 8.0, bed)), FIXED, 0.4),
        Drawn(_box((ends[0] - 45.0, ends[0]), (-30.0, 30.0), (bed, 30.0)), FIXED, 0.6, 1.2),
        Drawn(_box((ends[1], ends[1] + 25.0), (-12.0, 12.0), (bed, 12.0)), FIXED, 0.6, 1.2),
        Drawn(
            _box((-20.0, 20.0), (front - 12.0, front + 12.0), (bed, bed + 22.0)),
            "carriage",
            0.9,
            1.4,
        ),
        Drawn(
            np.array([[0.0, front, bed + 22.0], [0.0, front, 0.0], [0.0, -largest, 0.0]]),
            "carriage",
            0.9,
            1.2,
        ),
    ]

    def laid(values: Mapping[str, FloatArray]) -> FloatArray:
        laid_x_mm = values[going[0]]
        radius_at = np.interp(laid_x_mm, x_mm, radius)
        angle = math.pi - values[turning]  # the fibre is laid on the carriage's side
        return np.column_stack([laid_x_mm, radius_at * np.cos(angle), radius_at * np.sin(angle)])

    groups = {
        "mandrel": Group(np.zeros((len(run.frames), 3)), run.actual[turning][run.frames]),
        "carriage": _moving(run, x=x, y=np.zeros_like(x) if feed is None else feed - feed[0]),
    }
    path = ("mandrel", laid(run.actual), laid(run.planned))
    return _made(proof, run, body, groups, path, _view())


def _flat(values: Mapping[str, FloatArray], names: list[str]) -> FloatArray:
    columns = [values[name] for name in names[:3]]
    columns += [np.zeros_like(columns[0])] * (3 - len(columns))
    return np.column_stack(columns)


def _bounds(path: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    low, high = path.min(axis=0), path.max(axis=0)
    return low, high, float(max((high - low).max(), 1.0))


def _stitcher(proof: Proof, run: _Run, going: list[str]) -> Scene:
    """Return the scene of a stitcher from above: the cloth, the moving head, and the seam."""
    actual, planned = _flat(run.actual, going), _flat(run.planned, going)
    low, high, size = _bounds(planned)
    margin = 0.12 * size
    corner_signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    cloth = np.where(corner_signs < 0, low[:2], high[:2]) + margin * corner_signs
    ring = 0.025 * size * np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 25))
    lines = [
        Drawn(np.column_stack([cloth, np.zeros(5)]), FIXED, 0.45, 1.2),
        Drawn(np.column_stack([ring.real, ring.imag, 0.0 * ring.real]), "head", 0.95, 1.4),
        Drawn(
            0.045 * size * np.array([[-1, 0, 0], [1, 0, 0], [np.nan] * 3, [0, -1, 0], [0, 1, 0]]),
            "head",
            0.8,
            0.8,
        ),
    ]
    groups = {"head": _moving(run, x=actual[:, 0], y=actual[:, 1])}
    return _made(proof, run, lines, groups, (FIXED, actual, planned), _FROM_ABOVE)


def _embroidery(proof: Proof, run: _Run) -> Scene:
    """Return the scene of an embroidery machine: a frame with its cloth under a fixed needle."""
    names = list(proof.plan.axes)[:2]
    actual, planned = _flat(run.actual, names), _flat(run.planned, names)
    low, high, size = _bounds(planned)
    margin = 0.12 * size
    corner = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    frame = np.array([*corner, corner[0]])
    outward = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    zeros = np.zeros(5)
    lines = [
        Drawn(np.column_stack([frame + 0.8 * margin * outward, zeros]), "frame", 0.3, 0.8),
        Drawn(np.column_stack([frame + margin * outward, zeros]), "frame", 0.85, 2.0),
        Drawn(
            0.03 * size * np.array([[-1, -1, 0], [0, 0, 0], [1, -1, 0], [-1, -1, 0]]),
            FIXED,
            0.95,
            1.4,
        ),
    ]
    groups = {"frame": _moving(run, x=-actual[:, 0], y=-actual[:, 1])}
    return _made(proof, run, lines, groups, ("frame", actual, planned), _FROM_ABOVE)


def _placer(proof: Proof, run: _Run) -> Scene:
    """Return the scene of an on/off machine from the front: cylinders, tool, and swinging frame."""
    names = list(proof.plan.axes)
    x = run.actual[names[0]]
    z = run.actual[names[1]] if len(names) > 1 else np.zeros_like(x)
    sway = {one: values for one, values in run.other.items() if one.endswith(".frame")}
    swing = _MM * _SWING_DRAWN * sway.get(f"{names[0]}.frame", np.zeros_like(x))
    wide, deep = max(float(x.max()), 1.0), max(float(z.max()), 1.0)
    foot = -1.5 * deep
    beam = 0.25 * deep
    lines = [
        Drawn(
            _box((-0.2 * wide, 1.2 * wide), (-8.0, 8.0), (beam, beam + 0.12 * deep)),
            "frame",
            0.8,
            1.4,
        ),
        Drawn(_box((-0.2 * wide, -0.15 * wide), (-8.0, 8.0), (foot, beam)), "frame", 0.7),
        Drawn(_box((1.15 * wide, 1.2 * wide), (-8.0, 8.0), (foot, beam)), "frame", 0.7),
        Drawn(
            np.array([[-0.3 * wide, 0, foot], [1.3 * wide, 0, foot]], dtype=float), FIXED, 0.6, 2.0
        ),
        Drawn(
            _box((-0.06 * wide, 0.06 * wide), (-10.0, 10.0), (0.05 * deep, beam)), "slide", 0.9, 1.4
        ),
        Drawn(
            _box((-0.012 * wide, 0.012 * wide), (-2.0, 2.0), (0.0, 1.15 * deep)), "rod", 0.6, 1.0
        ),
        Drawn(_box((-0.04 * wide, 0.04 * wide), (-8.0, 8.0), (-0.1 * deep, 0.0)), "rod", 0.95, 1.6),
    ]
    groups = {
        "frame": _moving(run, x=swing),
        "slide": _moving(run, x=x + swing),
        "rod": _moving(run, x=x + swing, z=-z),
    }
    planned_z = run.planned[names[1]] if len(names) > 1 else np.zeros_like(x)
    zero = np.zeros_like(x)
    path = (
        FIXED,
        np.column_stack([x, zero, -z]),
        np.column_stack([run.planned[names[0]], zero, -planned_z]),
    )
    notes = (f"The frame's swing is drawn {_SWING_DRAWN:g} times as large.",) if sway else ()
    return _made(
        proof, run, lines, groups, path, _view(math.radians(-12.0), math.radians(14.0)), notes
    )


def _gantry(proof: Proof, run: _Run, names: list[str]) -> Scene:
    """Return the scene of a machine with axes X, Y, Z: a table, a bridge over it, and the tool."""
    actual, planned = _flat(run.actual, names), _flat(run.planned, names)
    low, high, size = _bounds(planned)
    margin = 0.12 * size
    x, y = (low[0] - margin, high[0] + margin), (low[1] - margin, high[1] + margin)
    floor = float(low[2]) - 0.04 * size
    top = float(high[2]) + 0.2 * size
    table = [
        [x[0], y[0], floor],
        [x[1], y[0], floor],
        [x[1], y[1], floor],
        [x[0], y[1], floor],
        [x[0], y[0], floor],
    ]
    thick = 0.02 * size
    lines = [
        Drawn(np.array(table), FIXED, 0.45, 1.2),
        Drawn(_box(x, (-thick, thick), (top, top + 2 * thick)), "bridge", 0.6, 1.0),
        Drawn(
            _box(
                (-2 * thick, 2 * thick), (-1.5 * thick, 1.5 * thick), (top - thick, top + 3 * thick)
            ),
            "slide",
            0.85,
            1.3,
        ),
        Drawn(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, top - float(low[2])]]), "tool", 0.9, 1.6),
        Drawn(
            np.array([[-thick, 0, 2 * thick], [0, 0, 0], [thick, 0, 2 * thick]]), "tool", 0.95, 1.4
        ),
    ]
    groups = {
        "bridge": _moving(run, y=actual[:, 1]),
        "slide": _moving(run, x=actual[:, 0], y=actual[:, 1]),
        "tool": _moving(run, x=actual[:, 0], y=actual[:, 1], z=actual[:, 2]),
    }
    return _made(
        proof, run, lines, groups, (FIXED, actual, planned), _view(_TURN, math.radians(38.0))
    )


_SCENES: Mapping[type, tuple[Callable[[Proof, _Run], Scene], Callable[[Proof, _Run], _Error]]] = {
    Motion: (_axes, _off_path),
    Scheduled: (_placer, _swing),
    Stitched: (_embroidery, _off_command),
}
"""Functions that make the scene and the error of each kind of work, by type of ``Plan.intent``."""
