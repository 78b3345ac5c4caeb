"""The plans of firmwares along chords: closed forms, and the times of their own planners.

The figures of ``GRBL_S`` come from grbl 1.1h's own ``planner.c`` (commit bfb67f0c), compiled for
this machine, its buffer kept full; those of ``KLIPPER_S`` from Klipper's own ``toolhead.py``
(commit 84104bbb), its look-ahead queue flushed as its host does; those of ``REPRAP_S`` from
RepRapFirmware's own ``DDA.cpp`` (commit fc1cd16c), compiled for this machine with a ring that holds
58 moves ahead. Grbl and RepRapFirmware compute with 24 bits: 1e-5 of a time, and 1e-6. Klipper and
this package use doubles: 1e-12.
"""

from __future__ import annotations

import numpy as np
import pytest

from threadline.machine.motion_planner import (
    FirmwarePlanner,
    GrblPlanner,
    KlipperPlanner,
    MarlinPlanner,
    RepRapPlanner,
)
from threadline.machine.quantity import parse_machine_quantity
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.firmware import look_ahead as moves_in_hand
from threadline.motion.timing.firmware import trapezoids
from threadline.motion.timing.firmware.marlin_moves import held_back
from threadline.motion.timing.firmware.rules import Moves, Rules, by_junction_deviation


def number(text: str, unit: str):
    return parse_machine_quantity(f"{text} exact, assumed", (unit,))


GRBL = GrblPlanner(kind="grbl", junction_deviation=number("0.02 mm", "m"))
MARLIN = MarlinPlanner(kind="marlin", junction_deviation=number("0.013 mm", "m"))
KLIPPER = KlipperPlanner(
    kind="klipper",
    velocity=number("150 mm/s", "m/s"),
    acceleration=number("900 mm/s^2", "m/s^2"),
    square_corner_velocity=number("5 mm/s", "m/s"),
)


def planned(
    planner: FirmwarePlanner,
    points,
    speed,
    *,
    acceleration=(1e9, 1e9, 100.0),
    velocity=(1e9, 1e9, 20.0),
    axes=("X", "Y", "Z"),
):
    """Return the pieces of the motion through ``points``, mm, at ``speed``, mm/s (0: rapid)."""
    points = np.vstack([np.zeros(len(axes)), points]) / 1e3
    way = np.diff(points, axis=0)
    length = np.linalg.norm(way, axis=1)
    speed = np.broadcast_to(np.asarray(speed, dtype=float), length.shape) / 1e3
    count = len(way)
    rest = np.zeros(count, dtype=int)
    rest[-1] = 1
    block = PieceBlock(
        coefficients=np.stack([points[:-1], way], axis=1),
        operation=np.arange(count),
        nominal_s=np.where(speed > 0, length / np.where(speed > 0, speed, 1.0), 0.0),
        rest_after=rest,
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )
    rules = Rules(
        planner,
        axes,
        np.full(len(axes), 1e3),
        np.array(velocity[: len(axes)], dtype=float),
        np.array(acceleration[: len(axes)], dtype=float),
    )
    return list(trapezoids.moves_of(rules).extend(block, slice(0, count), is_last=True))


def times(blocks, count):
    """Return the duration of each move."""
    found = np.zeros(count)
    for block in blocks:
        np.add.at(found, block.operation, block.duration_s)
    return found


def helix(count: int):
    turn = np.linspace(0.0, 20.0, count + 1)[1:]
    points = np.stack([30.0 * np.cos(turn) - 30.0, 30.0 * np.sin(turn), 0.1 * turn], axis=1)
    return np.round(points, 4)


def zigzag(count: int):
    k = np.arange(1, count + 1)
    return np.stack([2.0 * k + (k % 3), (-1.0) ** k * (k % 7), 0.1 * (k % 5)], axis=1)


JOBS = {
    "helix": (helix(200), 80.0),
    "zigzag": (zigzag(60), 120.0),
    "slow and fast": (zigzag(40), np.where(np.arange(40) % 4 < 2, 8.0, 90.0)),
    "rapid": (zigzag(25), 0.0),
}
"""Points in mm from 0, and speeds in mm/s."""
ON_GRBL = {"acceleration": (800.0, 700.0, 100.0), "velocity": (200.0, 180.0, 20.0)}
GRBL_S = {"helix": 7.5985201, "zigzag": 10.3452722, "slow and fast": 19.8970916, "rapid": 4.2793812}
KLIPPER_S = {
    "helix": 7.585805679874329,
    "zigzag": 10.229918597306852,
    "slow and fast": 19.851004162898523,
}


@pytest.mark.parametrize("job", JOBS)
def test_grbl_takes_the_time_of_its_own_planner(job: str) -> None:
    points, speed = JOBS[job]
    found = times(planned(GRBL, points, speed, **ON_GRBL), len(points)).sum()
    assert found == pytest.approx(GRBL_S[job], rel=1e-5)


@pytest.mark.parametrize("job", [name for name in JOBS if name != "rapid"])
def test_klipper_takes_the_time_of_its_own_host(job: str) -> None:
    points, speed = JOBS[job]
    found = times(planned(KLIPPER, points, speed), len(points)).sum()
    assert found == pytest.approx(KLIPPER_S[job], rel=1e-12)


def reprap(policy: int, jumps: tuple[float, float, float], acceleration: float) -> RepRapPlanner:
    return RepRapPlanner(
        kind="reprapfirmware",
        jump={axis: number(f"{v} mm/s", "m/s") for axis, v in zip("XYZ", jumps, strict=True)},
        policy=number(str(policy), ""),
        acceleration=number(f"{acceleration} mm/s^2", "m/s^2"),
    )


def in_turn(count: int):
    """One axis at a time: X or Y to Z and back is where the policy of jerks counts."""
    k = np.arange(count)
    return np.cumsum(np.eye(3)[k * k % 3] * (2.0 + k % 5)[:, None] * (-1.0) ** k[:, None], axis=0)


JOBS_REPRAP = {**JOBS, "in turn": (in_turn(200), 60.0)}
REPRAP_S = {
    ("helix", 0): 7.5985201,
    ("helix", 1): 7.7635835,
    ("zigzag", 0): 9.7638841,
    ("zigzag", 1): 14.6216445,
    ("slow and fast", 0): 19.6207847,
    ("slow and fast", 1): 21.2586290,
    ("rapid", 0): 4.0346365,
    ("rapid", 1): 6.0372163,
    ("in turn", 0): 24.2916481,
    ("in turn", 1): 34.2570695,
}


@pytest.mark.parametrize(("job", "policy"), REPRAP_S)
def test_reprapfirmware_takes_the_time_of_its_own_planner(job: str, policy: int) -> None:
    points, speed = JOBS_REPRAP[job]
    planner = reprap(policy, (15.0, 12.0, 10.0), 300.0 if policy else 1e6)
    found = times(planned(planner, points, speed, **ON_GRBL), len(points)).sum()
    assert found == pytest.approx(REPRAP_S[job, policy], rel=1e-6)


@pytest.mark.parametrize(
    "planner",
    [GRBL, MARLIN, KLIPPER, reprap(0, (15.0, 12.0, 10.0), 400.0)],
    ids=["grbl", "marlin", "klipper", "reprapfirmware"],
)
def test_moves_in_parts_are_those_of_the_whole(
    planner: FirmwarePlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many moves are read at once, every piece is the same."""
    points, speed = zigzag(400), np.where(np.arange(400) % 11 < 6, 30.0, 140.0)
    whole = times(planned(planner, points, speed, **ON_GRBL), 400)
    monkeypatch.setattr(moves_in_hand, "AT_ONCE", 1)
    run = trapezoids.moves_of(
        Rules(planner, ("X", "Y", "Z"), np.full(3, 1e3), np.array([200.0, 180.0, 20.0]),
              np.array([800.0, 700.0, 100.0]))
    )  # fmt: skip
    path = np.vstack([np.zeros(3), points]) / 1e3
    way = np.diff(path, axis=0)
    parts = []
    for k in range(400):
        block = PieceBlock(
            coefficients=np.stack([path[k : k + 1], way[k : k + 1]], axis=1),
            operation=np.array([k]),
            nominal_s=np.array([np.linalg.norm(way[k]) * 1e3 / speed[k]]),
            rest_after=np.array([int(k == 399)]),
            dwell_s=np.zeros(1),
            line=np.array([k]),
        )
        parts += list(run.extend(block, slice(0, 1), is_last=k == 399))
    assert len(parts) > 10  # they do come in parts
    np.testing.assert_allclose(times(parts, 400), whole, rtol=1e-9)


@pytest.mark.parametrize("planner", [GRBL, MARLIN], ids=["grbl", "marlin"])
def test_one_move_is_a_trapezoid(planner: FirmwarePlanner) -> None:
    """v / a + L / v if it reaches its speed, otherwise 2 sqrt(L / a)."""
    for length, expected in ((100.0, 50.0 / 800.0 + 100.0 / 50.0), (2.0, 2 * np.sqrt(2.0 / 800.0))):
        blocks = planned(planner, [[length, 0.0, 0.0]], 50.0, **ON_GRBL)
        assert times(blocks, 1).sum() == pytest.approx(expected, rel=1e-12)


def corner_speed(planner: FirmwarePlanner, degrees: float, **limits) -> float:
    """Return the speed, mm/s, at the corner of two long moves that turn by ``degrees``."""
    turn = np.radians(degrees)
    points = [[50.0, 0.0, 0.0], [50.0 + 50.0 * np.cos(turn), 50.0 * np.sin(turn), 0.0]]
    (block,) = planned(planner, points, 100.0, **limits)
    begins = np.flatnonzero(block.operation == 1)[0]
    slope = block.coefficients[begins, 1] / block.duration_s[begins]
    return 1e3 * float(np.linalg.norm(slope))


def test_klipper_takes_a_square_corner_at_its_velocity() -> None:
    assert corner_speed(KLIPPER, 90.0) == pytest.approx(5.0, rel=1e-9)
    assert corner_speed(KLIPPER, 180.0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("planner", [GRBL, MARLIN], ids=["grbl", "marlin"])
def test_a_corner_is_taken_on_its_circle(planner: FirmwarePlanner) -> None:
    """v^2 / r = a with the circle whose distance from the corner is the junction deviation.

    The circle touches both moves: its centre is r + d from the corner and r from the moves, so that
    sin(theta / 2) = r / (r + d) with theta between them.
    """
    limits = {"acceleration": (500.0, 500.0, 500.0), "velocity": (500.0, 500.0, 500.0)}
    assert planner.junction_deviation is not None
    deviation = 1e3 * planner.junction_deviation.si
    for turn in (30.0, 90.0, 135.0):
        sine = np.sin(np.radians(0.5 * (180.0 - turn)))
        radius = deviation * sine / (1.0 - sine)
        # The circle's acceleration points along the corner's bisector: the axes allow more there.
        bend = np.array([np.cos(np.radians(turn)) - 1.0, np.sin(np.radians(turn))])
        allowed = 500.0 / np.abs(bend / np.linalg.norm(bend)).max()
        if planner is MARLIN:
            # The limit of the second move itself, whatever the axes allow across it.
            along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
            allowed = 500.0 / np.abs(along).max()
        expected = np.sqrt(allowed * radius)
        assert corner_speed(planner, turn, **limits) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("turn_deg", "angle"),
    [(0.5, 0.008676), (2, 0.034713), (5, 0.087735), (10, 0.175441), (20, 0.350686), (44, 0.768257)],
)
def test_short_moves_of_marlin_bend_by_its_own_measure(turn_deg: float, angle: float) -> None:
    """The angles come from the table of arc cosines in its ``planner.cpp``."""
    turn = np.radians(turn_deg)
    moves = Moves(
        length=np.array([50.0, 0.5]),
        direction=np.array([[1.0, 0.0], [np.cos(turn), np.sin(turn)]]),
        speed=np.array([1e3, 1e3]),
        acceleration=np.array([500.0, 500.0]),
    )
    free = np.array([1e9, 1e9])
    (square,) = by_junction_deviation(moves, free, 1e6, most=moves.acceleration, arcs=True)
    assert square == pytest.approx(0.5 * 500.0 / angle, rel=1e-3)


def test_marlin_keeps_its_jumps() -> None:
    """A corner of 90 degrees at v steps X and Y by v each; from rest a move starts slowly."""
    jumps = {"X": number("8 mm/s", "m/s"), "Y": number("6 mm/s", "m/s")}
    planner = MarlinPlanner(kind="marlin", jump=jumps)
    limits = {"acceleration": (500.0,) * 3, "velocity": (500.0,) * 3}
    assert corner_speed(planner, 90.0, **limits) == pytest.approx(6.0, rel=1e-9)
    (block,) = planned(planner, [[50.0, 0.0, 0.0]], 100.0, **limits)
    first = 1e3 * block.coefficients[0, 1, 0] / block.duration_s[0]
    assert first == 0.0


def test_short_blocks_are_no_faster_than_the_ring_can_stop() -> None:
    """Of blocks of 0.1 mm in a line the ring holds 1.5 mm: v^2 = 2 a s over that length."""
    points = np.stack([0.1 * np.arange(1, 201), np.zeros(200), np.zeros(200)], axis=1)
    blocks = planned(GRBL, points, 100.0, **ON_GRBL)
    peak = max(float((1e3 * np.abs(b.coefficients[:, 1, 0]) / b.duration_s).max()) for b in blocks)
    # A block begins at a speed that 14 more can stop, and gains half of a block's worth within.
    assert np.sqrt(2 * 800.0 * 1.4) <= peak <= np.sqrt(2 * 800.0 * 1.5)


def test_marlin_raises_what_is_slower_than_its_least_speed() -> None:
    """M205 T10: 50 mm at F60 take 50/10 + 10/1000 s, and not 50/1 + 1/1000; F beyond it counts."""
    slow = MarlinPlanner(
        kind="marlin",
        junction_deviation=number("0.013 mm", "m"),
        least_speed=number("10 mm/s", "m/s"),
    )
    limits = {"acceleration": (1e3, 1e3, 1e3), "velocity": (1e9, 1e9, 1e9)}
    for asked, runs in ((1.0, 10.0), (9.0, 10.0), (25.0, 25.0)):
        (moved,) = times(planned(slow, [[50.0, 0.0, 0.0]], asked, **limits), 1)
        assert moved == pytest.approx(50.0 / runs + runs / 1e3, rel=1e-12)
    # The limit of an axis is not raised.
    limits["velocity"] = (4.0, 4.0, 4.0)
    (moved,) = times(planned(slow, [[50.0, 0.0, 0.0]], 1.0, **limits), 1)
    assert moved == pytest.approx(50.0 / 4.0 + 4.0 / 1e3, rel=1e-12)


@pytest.mark.parametrize(
    ("short", "wanted_ms"),
    [
        ("20 ms", [10.0, 10.0, 20.0, 10.0 + 20.0 / 3.0, 15.0]),
        ("14 ms", [10.0, 10.0, 14.0, 10.0 + 8.0 / 3.0, 12.0]),
        ("0 ms", [10.0] * 5),
    ],
)
def test_marlin_holds_back_moves_that_are_shorter_than_m205_b(
    short: str, wanted_ms: list[float]
) -> None:
    """With n moves before it, 2 to 7, a move of t < B takes t + 2 (B - t) / n, by planner.cpp."""
    planner = MarlinPlanner(
        kind="marlin",
        junction_deviation=number("0.013 mm", "m"),
        short_time=number(short, "s"),
    )
    most = np.array([1e9])
    rules = Rules(planner, ("X",), np.array([1e3]), most, most, np.array([1000.0]))
    asked = held_back(np.ones(5), np.full(5, 100.0), 0, rules.short_time_s)
    assert 1e3 / asked == pytest.approx(wanted_ms)
