"""An axis with rigid links: motion, force and current; and play that varies with an eccentric gear.

The full width of the play is ``play + width cos(angle)``. A piecewise linear system cannot contain
a cosine, so 80 straight pieces per turn approximate the width, within 2e-4 of ``width``. On a piece
the edge of the band is ``level + slope angle``. The contact force acts only along the stretch. Its
moment on the gear, which is ``slope`` times the force, is neglected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.elements import Element, Guard, Mode
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.parts import Eccentric
from threadline.machine.quantity import LEAST_SI

_CREEP = 1e-12  # m/s or rad/s: so slow that only Coulomb friction acts


def current_needed(
    machine: Machine, axis: str, velocity_si: float, acceleration_si: float
) -> float:
    """Return the current in A that an axis needs at a velocity and acceleration, all links rigid.

    Parameters
    ----------
    velocity_si, acceleration_si
        Velocity and acceleration of the axis, in m/s and m/s^2 or rad/s and rad/s^2.

    Raises
    ------
    MachineError
        If the drive does not turn with the axis.
    """
    rates = rigid_motion(machine, axis)
    drive = machine.drive_of(axis)
    turning = drive_rate(machine, axis, rates)
    force = rigid_force(machine, axis, velocity_si, acceleration_si)
    return float(force / (turning * drive.torque_constant.si))


def drive_needs(machine: Machine, axis: str) -> tuple[FloatArray, FloatArray]:
    """Return the current in A and voltage in V that an axis needs, all links rigid.

    Returns
    -------
    tuple
        Two arrays (3,), current and voltage: the need due to sliding friction, the need per m/s or
        rad/s, and the need per m/s^2 or rad/s^2. The voltage is across the winding.
    """
    drive = machine.drive_of(axis)
    drive_per_axis = abs(drive_rate(machine, axis, rigid_motion(machine, axis)))
    friction_a, moving_a = (
        abs(current_needed(machine, axis, speed, 0.0)) for speed in (_CREEP, 1.0)
    )
    acceleration_a = abs(current_needed(machine, axis, 0.0, 1.0))
    current = np.array([friction_a, moving_a - friction_a, acceleration_a])
    winding = drive.resistance.si * current
    winding[1] += drive.back_emf.si * drive_per_axis
    return current, winding


def drive_limits(
    machine: Machine, axis: str, current: FloatArray, winding: FloatArray
) -> list[tuple[float, FloatArray, str]]:
    """Return the limits of an axis' drive, each with the needs to compare with it.

    There are limits of the controller's output in V, the winding's voltage in V, and the current in
    A. A limit that the file does not give is infinite. ``current`` and ``winding`` are the results
    of ``drive_needs``.

    Returns
    -------
    list
        Limit, (3,) needs in its unit, and a format string with the name of the limit.
    """
    amplifier = machine.drive_of(axis).amplifier
    command = (winding if amplifier.mode == "voltage" else current) / amplifier.gain.si
    limit_v, limit_a = (
        np.inf if limit is None else limit.si
        for limit in (amplifier.voltage_limit, amplifier.current_limit)
    )
    return [
        (
            machine.controller_of(axis).dac.range.si,
            command,
            "full output of the controller, {:.4g} V",
        ),
        (limit_v, winding, "voltage_limit of {:.4g} V"),
        (limit_a, current, "current_limit of {:.4g} A"),
    ]


def rigid_force(machine: Machine, axis: str, velocity_si: float, acceleration_si: float) -> float:
    """Return the force in N (torque in N m) in the coordinate of the axis, all links rigid."""
    rates = rigid_motion(machine, axis)
    force = 0.0
    for name, body in machine.bodies.items():
        rate = rates[name]
        damping = 0.0 if body.damping is None else body.damping.si
        friction = 0.0 if body.friction is None else body.friction.si
        force += rate * rate * (body.inertia.si * acceleration_si + damping * velocity_si)
        force += abs(rate) * friction * np.sign(velocity_si)
    return float(force)


def drive_unit(machine: Machine, axis: str) -> str:
    """Return the unit of the torque or force of an axis' stepper or pulse servo: "N m" or "N"."""
    source = machine.source_of(axis)
    assert source is not None
    return "N" if machine.bodies[source.body].kind == "linear" else "N m"


def drive_rate(machine: Machine, axis: str, rates: dict[str, float]) -> float:
    """Return the motion of an axis's drive, rad (m), per unit motion of the axis, m or rad.

    Parameters
    ----------
    rates
        Rates of the bodies, from ``rigid_motion``.

    Raises
    ------
    MachineError
        If the drive does not move with the axis, or moves too little for a division.
    """
    source = machine.source_of(axis)
    if source is not None:
        drive_per_axis = rates[source.body]
    else:
        drive_per_axis = sum(q.si * rates[b] for b, q in machine.drive_of(axis).acts_on.items())
    if abs(drive_per_axis) < LEAST_SI:
        raise MachineError(
            f"axes.{axis}: its drive does not turn when its load moves",
            remedy="Correct the links between them, or the bodies that the drive acts on.",
        )
    return drive_per_axis


def rigid_motion(machine: Machine, axis: str) -> dict[str, float]:
    """Return the rate of every body when the axis moves at 1 m/s or 1 rad/s with rigid links.

    The rate of a body without connection to the axis is 0.
    """
    bodies = list(machine.bodies)
    rows: list[FloatArray] = []
    for link in machine.links.values():
        if link.stiffness.si > 0:
            rows.append(_row(bodies, {b: q.si for b, q in link.stretch.items()}))
    axis_part = machine.axes[axis]
    if axis_part.load is not None:
        rows.append(_row(bodies, {b: q.si for b, q in axis_part.load.items()}))
    elif source := machine.source_of(axis):
        rows.append(_row(bodies, {source.body: source.counts / axis_part.counts.si}))
    else:
        sensor = machine.sensors[machine.controller_of(axis).sensor]
        rows.append(_row(bodies, {b: q.si / axis_part.counts.si for b, q in sensor.reads.items()}))
    right_side = np.zeros(len(rows))
    right_side[-1] = 1.0
    # Lengths and angles differ by orders of magnitude, so each body's column is scaled.
    matrix = np.array(rows)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-30)
    solution = np.linalg.lstsq(matrix / scale, right_side, rcond=None)[0] / scale
    return dict(zip(bodies, solution.tolist(), strict=True))


def _row(bodies: list[str], weights: dict[str, float]) -> FloatArray:
    return np.array([weights.get(b, 0.0) for b in bodies])


PIECES_A_TURN = 80
_MAX_PIECES = 20_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """A dead band whose width varies by straight pieces, for V variants.

    Parameters
    ----------
    angle, angle_rate
        (V, N) rows of the gear's angle, counted from the start of the machine, and of its rate.
    width, phase
        (V,) amplitude of the variation of the full width; angle of the gear at the start, rad.
    first, last
        Numbers of the first piece, and of the piece after the last; piece j begins at j / 80 turns.
    """

    angle: FloatArray
    angle_rate: FloatArray
    width: FloatArray
    phase: FloatArray
    first: int
    last: int


def pieces_needed(
    machine: Machine, link: str, eccentric: Eccentric, start: dict[str, float], phase: FloatArray
) -> tuple[int, int]:
    """Return ``first`` and ``last`` of a band that covers the travel and one more turn at each end.

    Parameters
    ----------
    machine, link, eccentric
        The machine, and the name of the link with its eccentricity.
    start
        Position of each axis at the start, m or rad.
    phase
        (V,) angle of the gear at the start, rad.

    Raises
    ------
    MachineError
        If the gear turns with an endless axis, or makes more than 250 turns.
    """
    low = high = 0.0
    for name, axis in machine.axes.items():
        rates = rigid_motion(machine, name)
        rate = sum(q.si * rates[body] for body, q in eccentric.angle.items())
        if abs(rate) < 1e-12:
            continue
        if axis.travel is None:
            raise MachineError(
                f"links.{link}.eccentric turns with axis {name}, which is endless",
                place=machine.place,
                remedy=f"Give axes.{name} a travel.",
            )
        ends = [rate * (end.si - start[name]) for end in axis.travel]
        low, high = low + min(ends), high + max(ends)
    turn = 2.0 * np.pi
    first = int(np.floor((float(phase.min()) + low) / turn * PIECES_A_TURN)) - PIECES_A_TURN
    last = int(np.ceil((float(phase.max()) + high) / turn * PIECES_A_TURN)) + PIECES_A_TURN
    if last - first > _MAX_PIECES:
        raise MachineError(
            f"links.{link}.eccentric: the gear makes {(last - first) / PIECES_A_TURN:.0f} turns "
            f"over the travel, limit {_MAX_PIECES // PIECES_A_TURN}",
            place=machine.place,
            remedy="Correct its angle, or omit the eccentricity.",
        )
    return first, last


def eccentric_play(
    name: str,
    direction: FloatArray,
    stretch: FloatArray,
    spring: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    play: FloatArray,
    band: Band,
) -> Element:
    """Return a spring and damper behind a dead band whose width varies with a gear's angle.

    Every piece of the band has the modes of ``elements.play``: free, touching above and below and,
    with damping, separating above and below.

    Parameters
    ----------
    name, direction
        As in ``Element``.
    stretch, spring
        (V, N) rows of the stretch, and of the force that spring and damper would have without the
        band.
    stiffness, damping, play
        (V,) stiffness and damping of the spring, and the mean full width of the band.
    band
        The variation of the width.
    """
    damped = bool((damping > 0).any())
    kinds = 5 if damped else 3
    start_piece = int(np.floor(float(band.phase.mean()) / (2.0 * np.pi) * PIECES_A_TURN))
    # The simulation starts in mode 0, so the modes of the piece at the start come first.
    order = [*range(start_piece, band.last), *range(band.first, start_piece)]
    piece_number = {piece: index for index, piece in enumerate(order)}
    modes: list[Mode] = []
    for piece in order:
        half_width, slope = _band_edge(band, play, piece)
        band_force = (stiffness[:, None] * half_width) + (damping * slope)[
            :, None
        ] * band.angle_rate
        force_above, force_below = spring - band_force, spring + band_force
        above_band, below_band = stretch - half_width, stretch + half_width
        no_force = np.zeros_like(stretch)
        base = kinds * piece_number[piece]
        free = (Guard(row=above_band, high=0.0, high_to=base + 1),
                Guard(row=below_band, low=0.0, low_to=base + 2))  # fmt: skip
        leave_above = (Guard(row=force_above, low=0.0, low_to=base + (3 if damped else 0)),)
        leave_below = (Guard(row=force_below, high=0.0, high_to=base + (4 if damped else 0)),)
        part_above = (Guard(row=above_band, low=0.0, low_to=base),
                      Guard(row=force_above, high=0.0, high_to=base + 1))  # fmt: skip
        part_below = (Guard(row=below_band, high=0.0, high_to=base),
                        Guard(row=force_below, low=0.0, low_to=base + 2))  # fmt: skip
        sides = [
            ("free", no_force, free),
            ("touching above", force_above, leave_above),
            ("touching below", force_below, leave_below),
            ("separating above", no_force, part_above),
            ("separating below", no_force, part_below),
        ]
        for kind, (label, law, guards) in enumerate(sides[:kinds]):
            turn_guard = _turn_guard(band, piece, piece_number, kinds, kind)
            modes.append(
                Mode(name=f"{label}, piece {piece}", law=law, guards=(*guards, turn_guard))
            )
    return Element(name=name, direction=direction, modes=tuple(modes), working_mode=1)


def _band_edge(band: Band, play: FloatArray, piece: int) -> tuple[FloatArray, FloatArray]:
    """Return half the width on a piece as (V, N) rows, and its slope (V,) over the angle."""
    step = 2.0 * np.pi / PIECES_A_TURN
    # Chords lie on the inner side of a cosine. Chords that are moved outwards have errors of equal
    # size at their ends and in their middle.
    chord_height = 2.0 / (1.0 + np.cos(0.5 * step))
    begin = np.full(len(play), chord_height * np.cos(piece * step))
    end = np.full(len(play), chord_height * np.cos((piece + 1) * step))
    if piece in {band.first, band.last - 1}:
        begin = end = 0.5 * (begin + end)
    slope = 0.5 * band.width * (end - begin) / step
    half_width = slope[:, None] * band.angle
    half_width[:, -1] += 0.5 * (play + band.width * begin) + slope * (band.phase - piece * step)
    return half_width, slope


def _turn_guard(
    band: Band, piece: int, piece_number: dict[int, int], kinds: int, kind: int
) -> Guard:
    """Return the guard on the gear's angle, which leads to the same mode of an adjacent piece."""
    step = 2.0 * np.pi / PIECES_A_TURN
    piece_before, piece_after = piece_number.get(piece - 1), piece_number.get(piece + 1)
    return Guard(
        row=band.angle,
        low=-np.inf if piece_before is None else piece * step - band.phase,
        high=np.inf if piece_after is None else (piece + 1) * step - band.phase,
        low_to=-1 if piece_before is None else kinds * piece_before + kind,
        high_to=-1 if piece_after is None else kinds * piece_after + kind,
    )
