"""Play that varies with the angle of an eccentric gear, as a dead band with straight pieces.

The full width is ``play + width cos(angle)``. A piecewise linear system has no cosine, so each turn
is divided into 80 straight pieces, which differ from it by at most 2e-4 of ``width``. On a piece
the edge of the band is ``level + slope angle``. The force of the contact acts along the stretch, as
without eccentricity; its moment on the gear itself, ``slope`` times as large, is neglected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.parts import Eccentric
from threadline.plant.elements import Element, Guard, Mode
from threadline.plant.rigid import rigid_motion

PIECES_A_TURN = 80
_MOST_PIECES = 20_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """A dead band of straight pieces, for V variants.

    Parameters
    ----------
    angle, angle_rate
        (V, N) rows that give the gear's angle, counted from the start of the machine, and its rate.
    width, phase
        (V,) amplitude of the full width; angle of the gear at the start, rad.
    first, last
        Number of the first piece, and one more than that of the last; piece j begins at j / 80
        turns.
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
    """Return ``first`` and ``last`` of a band for all travels and a turn beyond on either side.

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
    if last - first > _MOST_PIECES:
        raise MachineError(
            f"links.{link}.eccentric: the gear makes {(last - first) / PIECES_A_TURN:.0f} turns "
            f"over the travel, limit {_MOST_PIECES // PIECES_A_TURN}",
            place=machine.place,
            remedy="Correct its angle, or leave the eccentricity out.",
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

    On every piece of the band it has the modes of ``elements.play``: free, touching above and below
    and, where the contact is damped, separating above and below.

    Parameters
    ----------
    name, direction
        As in ``Element``.
    stretch, spring
        (V, N) rows of the stretch, and of the force of spring and damper without the band.
    stiffness, damping, play
        (V,) stiffness and damping of the spring, and the mean full width of the band.
    band
        How the width varies.
    """
    damped = bool((damping > 0).any())
    kinds = 5 if damped else 3
    begins = int(np.floor(float(band.phase.mean()) / (2.0 * np.pi) * PIECES_A_TURN))
    # The simulation starts in mode 0, so pieces are numbered from the one that it starts on.
    order = [*range(begins, band.last), *range(band.first, begins)]
    number = {piece: at for at, piece in enumerate(order)}
    modes: list[Mode] = []
    for piece in order:
        half, bent = _edge(band, play, piece)
        gone = (stiffness[:, None] * half) + (damping * bent)[:, None] * band.angle_rate
        above, below = spring - gone, spring + gone
        over, under = stretch - half, stretch + half
        none = np.zeros_like(stretch)
        base = kinds * number[piece]
        free = (Guard(row=over, high=0.0, high_to=base + 1),
                Guard(row=under, low=0.0, low_to=base + 2))  # fmt: skip
        up = (Guard(row=above, low=0.0, low_to=base + (3 if damped else 0)),)
        down = (Guard(row=below, high=0.0, high_to=base + (4 if damped else 0)),)
        leaving_up = (Guard(row=over, low=0.0, low_to=base),
                      Guard(row=above, high=0.0, high_to=base + 1))  # fmt: skip
        leaving_down = (Guard(row=under, high=0.0, high_to=base),
                        Guard(row=below, low=0.0, low_to=base + 2))  # fmt: skip
        sides = [
            ("free", none, free),
            ("touching above", above, up),
            ("touching below", below, down),
            ("separating above", none, leaving_up),
            ("separating below", none, leaving_down),
        ]
        for kind, (label, law, guards) in enumerate(sides[:kinds]):
            turned = _turned(band, piece, number, kinds, kind)
            modes.append(Mode(name=f"{label}, piece {piece}", law=law, guards=(*guards, turned)))
    return Element(name=name, direction=direction, modes=tuple(modes), working_mode=1)


def _edge(band: Band, play: FloatArray, piece: int) -> tuple[FloatArray, FloatArray]:
    """Return half the width on a piece as a (V, N) row, and its slope (V,) against the angle."""
    step = 2.0 * np.pi / PIECES_A_TURN
    # Chords lie inside a cosine; raised, they are as far outside it at their ends as inside it
    # half way.
    raised = 2.0 / (1.0 + np.cos(0.5 * step))
    begin = np.full(len(play), raised * np.cos(piece * step))
    end = np.full(len(play), raised * np.cos((piece + 1) * step))
    if piece in {band.first, band.last - 1}:
        begin = end = 0.5 * (begin + end)
    slope = 0.5 * band.width * (end - begin) / step
    half = slope[:, None] * band.angle
    half[:, -1] += 0.5 * (play + band.width * begin) + slope * (band.phase - piece * step)
    return half, slope


def _turned(band: Band, piece: int, number: dict[int, int], kinds: int, kind: int) -> Guard:
    """Return the guard that leads to the pieces next to this one, in the same kind of mode."""
    step = 2.0 * np.pi / PIECES_A_TURN
    before, after = number.get(piece - 1), number.get(piece + 1)
    return Guard(
        row=band.angle,
        low=-np.inf if before is None else piece * step - band.phase,
        high=np.inf if after is None else (piece + 1) * step - band.phase,
        low_to=-1 if before is None else kinds * before + kind,
        high_to=-1 if after is None else kinds * after + kind,
    )
