"""Play that varies with the angle of an eccentric gear, as a dead band with straight pieces.

The full width is ``play + width cos(angle)``. A piecewise linear system can't have a cosine, so
each turn is cut into 80 pieces, within 2e-4 of ``width`` of it. Within a piece the edge of the
band is ``level + slope angle``; the contact's force acts along the stretch, as without
eccentricity (the wedge's push on the gear itself, ``slope`` times as large, is left out).
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
    """A dead band on one of whose pieces the machine starts; V variants.

    Parameters
    ----------
    angle, angle_rate
        (V, N) rows: the gear's angle from where the machine starts, and its rate.
    width, phase
        (V,) amplitude of the full width; the angle at the start, rad.
    first, last
        Numbers of the outermost pieces; piece j begins at j turns / 80.
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
    """Return the outermost pieces for the whole travel and a turn beyond it on either side.

    Raises
    ------
    MachineError
        If the gear turns with an endless axis, or too often.
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
    """Return a spring and damper behind a dead band whose width goes with a gear's angle.

    As ``elements.play`` on every piece: free, touching above and below and, where the contact
    is damped, separating from either.

    Parameters
    ----------
    stretch, spring
        (V, N): the stretch and the linear law without the band.
    stiffness, damping, play
        (V,) of the spring, and the mean full width.
    """
    damped = bool((damping > 0).any())
    kinds = 5 if damped else 3
    begins = int(np.floor(float(band.phase.mean()) / (2.0 * np.pi) * PIECES_A_TURN))
    # The simulation starts in mode 0: the numbers of the pieces are turned round to begin there.
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
    # Chords of a cosine lie inside it: raised so that they are as far outside at their ends.
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
