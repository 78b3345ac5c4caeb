"""Limits of braking and along the path in a machine file, compared with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threadline.errors import LimitError, MachineError
from threadline.files import Stream
from threadline.machine import load_machine
from threadline.machine.load import library_file
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.tool import PathLimits
from threadline.machine.vary import derate
from threadline.motion.laws import shortest_move
from threadline.motion.path import plan_path
from threadline.motion.path.runs import resting_at_reversals
from threadline.motion.path.types import ProgrammedPath, VertexBlock
from threadline.motion.timing import check_limits, limit_peaks, plan_trajectory
from threadline.motion.timing.optimal.along_path import path_use
from threadline.motion.timing.optimal.motion_limits import along_of

from .builders import without_drives

WINDER = without_drives(load_machine("lathe-winder"))
CORNERS = [[0.0, 0.0], [0.1, 0.02], [0.15, 0.1], [0.02, 0.12], [0.1, 0.05], [0.1, 0.2]]


def of(si: float, unit: str) -> Quantity:
    return Quantity(si, unit, 0.0, Provenance.ASSUMED)


def machine_of(jerk: float | None = None, path: dict | None = None, **axes: tuple[float, ...]):
    """Return the winder with (velocity, acceleration, deceleration) of some axes."""
    limited = {
        name: replace(
            WINDER.axes[name],
            velocity=of(v, "m/s"),
            acceleration=of(up, "m/s^2"),
            deceleration=None if up == down else of(down, "m/s^2"),
            jerk=None if jerk is None else of(jerk, "m/s^3"),
        )
        for name, (v, up, down) in axes.items()
    }
    units = {"velocity": "m/s", "jerk": "m/s^3"}
    own = path and PathLimits(**{k: of(v, units.get(k, "m/s^2")) for k, v in path.items()})
    return replace(WINDER, axes={**WINDER.axes, **limited}, path=own)


def vertices(places) -> VertexBlock:
    count = len(places)
    return VertexBlock(
        positions=np.array(places, dtype=float),
        operation=np.maximum(np.arange(count) - 1, 0),
        nominal_s=np.zeros(count),
        rest=(np.arange(count) == count - 1).astype(np.int64),
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )


def planned(machine, interpolation, *blocks, tolerance_m=1e-3):
    axes = ("X", "Y")
    programmed = ProgrammedPath(
        axes=axes, radius_m=np.ones(2), blocks=Stream.of([vertices(block) for block in blocks])
    )
    return plan_trajectory(plan_path(programmed, machine, interpolation, tolerance_m), machine)


@pytest.mark.parametrize(("up", "down"), [(4.0, 10.0), (10.0, 4.0)])
def test_a_trapezoid_that_brakes_otherwise_takes_the_time_of_its_closed_form(up, down):
    """l / v + v / 2a + v / 2d, to the 0.5 % that elements may cost; ``auto`` takes the lower."""
    machine = machine_of(X=(1.0, up, down))
    least_s = 1.0 + 0.5 / up + 0.5 / down
    motion = planned(machine, "optimal", [[-0.5, 0.0], [0.5, 0.0]])
    assert least_s * (1.0 - 1e-9) <= motion.duration_s < 1.005 * least_s
    found = {p.quantity: p for p in check_limits(motion, machine) if p.axis == "X"}
    assert found["acceleration"].limit_si == up and found["deceleration"].limit_si == down
    assert min(found[name].ratio for name in ("acceleration", "deceleration")) > 0.97
    slower = planned(machine, "auto", [[-0.5, 0.0], [0.5, 0.0]])
    check_limits(slower, machine)
    # The smoothing of the other axes' jerk comes on top.
    assert 0.0 <= slower.duration_s - (1.0 + 1.0 / min(up, down)) < 0.02


def test_a_diagonal_within_limits_of_the_path_is_the_shortest_move_of_its_length():
    """3 : 4 : 5: the axes could do 1 m/s, 10 m/s^2 and 1000 m/s^3 each."""
    limits = {"velocity": 0.5, "acceleration": 2.0, "jerk": 40.0}
    machine = machine_of(1000.0, limits, X=(1.0, 10.0, 10.0), Y=(1.0, 10.0, 10.0))
    motion = planned(machine, "optimal", [[0.0, 0.0], [0.3, 0.4]])
    assert motion.duration_s == pytest.approx(shortest_move(0.5, 0.5, 2.0, 40.0).duration_s, 1e-9)
    assert path_use(motion, along_of(machine, np.ones(2))).share == pytest.approx(1.0, 1e-6)


def test_a_diagonal_that_brakes_otherwise_along_the_path():
    limits = {"velocity": 0.5, "acceleration": 2.0, "deceleration": 5.0}
    machine = machine_of(None, limits, X=(1.0, 10.0, 10.0), Y=(1.0, 10.0, 10.0))
    motion = planned(machine, "optimal", [[0.0, 0.0], [0.3, 0.4]])
    least_s = 0.5 / 0.5 + 0.25 / 2.0 + 0.25 / 5.0
    assert least_s * (1.0 - 1e-9) <= motion.duration_s < 1.005 * least_s


@pytest.mark.parametrize("interpolation", ["optimal", "auto", "parabolic", "quintic"])
def test_limits_of_the_path_hold_in_corners_and_at_a_reversal(interpolation):
    """At random instants by the formulas of a curve; without ``[path]`` they are far exceeded.

    At the last corner but one the path turns back by 180 degrees, and ``optimal`` rests.
    """
    limits = {"velocity": 0.2, "acceleration": 1.0, "centripetal": 0.8}
    axes = {"X": (1.0, 4.0, 4.0), "Y": (1.0, 4.0, 4.0)}
    machine, free = machine_of(200.0, limits, **axes), machine_of(200.0, None, **axes)
    back = [*CORNERS, [0.1, 0.1]]
    motion, beyond = (planned(m, interpolation, back) for m in (machine, free))
    check_limits(motion, machine)
    for found, held in ((motion, True), (beyond, False)):
        times = np.random.default_rng(5).uniform(0.0, found.duration_s, 20_000)
        v, a = found(times, 1), found(times, 2)
        speed = np.linalg.norm(v, axis=1)
        moving = speed > 1e-3 * speed.max()
        push = (v * a).sum(axis=1)[moving] / speed[moving]
        across = np.sqrt(np.maximum((a[moving] ** 2).sum(axis=1) - push**2, 0.0))
        used = (speed.max() / 0.2, np.abs(push).max() / 1.0, across.max() / 0.8)
        assert bool(max(used) <= 1.001) is held, used
    with pytest.raises(LimitError, match=r"of path\.\w+, .* optimal"):
        check_limits(beyond, machine)


def test_braking_beyond_its_limit_is_refused_by_name():
    motion = planned(machine_of(X=(1.0, 4.0, 4.0)), "optimal", [[-0.5, 0.0], [0.5, 0.0]])
    machine = machine_of(X=(1.0, 4.0, 3.0))
    with pytest.raises(LimitError, match="axis X: deceleration reaches"):
        check_limits(motion, machine)
    # An axis that turns back within a piece brakes before it and accelerates after it.
    assert {p.quantity for p in limit_peaks(motion, machine) if p.axis == "X"} == {
        "travel", "velocity", "acceleration", "deceleration", "jerk",
    }  # fmt: skip


def test_a_path_rests_where_it_turns_back_wherever_its_blocks_end():
    places = [[0, 0], [1, 0], [1, 0], [0.5, 0], [0.5, 1], [0.5, 1], [0.5, 0], [2, 0]]
    expected = [0, 0, 1, 0, 0, 1, 0, 1]
    for cuts in ([], [1], [2], [3], [5], [6], [2, 3], [5, 6], [1, 2, 3, 4, 5, 6, 7]):
        blocks = [vertices(part) for part in np.split(np.array(places, dtype=float), cuts)]
        blocks = [replace(b, rest=np.zeros(len(b), dtype=np.int64)) for b in blocks[:-1]] + [
            blocks[-1]
        ]
        path = ProgrammedPath(axes=("X", "Y"), radius_m=np.ones(2), blocks=Stream.of(blocks))
        rests = np.concatenate([block.rest for block in resting_at_reversals(path)])
        assert rests.tolist() == expected, cuts


def test_less_of_the_limits_is_less_of_braking_and_along_the_path_too():
    limits = {"velocity": 0.5, "acceleration": 2.0, "jerk": 40.0, "centripetal": 3.0}
    half = derate(machine_of(None, limits, X=(1.0, 4.0, 6.0)), 0.5)
    assert half.axes["X"].deceleration.si == 3.0 and half.path.velocity.si == 0.5
    assert (half.path.acceleration.si, half.path.jerk.si, half.path.centripetal.si) == (1, 20, 1.5)


@pytest.mark.parametrize(
    ("name", "under", "text", "message"),
    [
        ("lathe-winder", "axes.X", "deceleration = '3 rad/s^2 exact, assumed'", "deceleration"),
        ("lathe-winder", "axes.X", "deceleration = '0 m/s^2 exact, assumed'", "deceleration"),
        ("lathe-winder", "path", "", r"a \[path\] without limits"),
        (
            "lathe-winder",
            "path",
            "deceleration = '3 m/s^2 exact, assumed'",
            "needs an acceleration",
        ),
        ("lathe-winder", "path", "speed = '3 m/s exact, assumed'", "unknown key 'path.speed'"),
        ("letter-placer", "path", "velocity = '3 m/s exact, assumed'", "path: .*cylinders"),
        ("schiffli-frame", "path", "velocity = '3 m/s exact, assumed'", "path: step tables"),
        ("schiffli-frame", "axes.X", "deceleration = '1 m/s^2 exact, assumed'", "step tables"),
    ],
)
def test_limits_that_mean_nothing_are_refused_by_name(tmp_path, name, under, text, message):
    own = library_file(name).read_text(encoding="utf-8")
    if f"[{under}]\n" in own:
        own = own.replace(f"[{under}]\n", f"[{under}]\n{text}\n")
    else:
        own += f"\n[{under}]\n{text}\n"
    (tmp_path / "mine.toml").write_text(own, encoding="utf-8")
    with pytest.raises(MachineError, match=message) as caught:
        load_machine(tmp_path / "mine.toml")
    assert "mine.toml:" in str(caught.value)


def test_a_verdict_lists_both_where_the_machine_has_them(examples):
    """The braking equals dense samples of the plan; for other machines neither is listed."""
    import threadline as tl

    limits = {"velocity": 0.4, "acceleration": 3.0}
    x = WINDER.axes["X"]
    braking = replace(x, deceleration=of(5.0, "m/s^2"))
    machine = replace(
        load_machine("lathe-winder"),
        axes={**WINDER.axes, "X": braking},
        path=PathLimits(
            **{k: of(v, "m/s" if k == "velocity" else "m/s^2") for k, v in limits.items()}
        ),
    )
    proof = tl.prove(
        examples / "x-180.prg", machine, interpolation="optimal", contour="none", level="nominal"
    )
    found = {(r.name, r.axis): r for r in proof.of.verdict.results}
    plan = proof.of.plan.motion.trajectory
    times = np.linspace(0.0, plan.duration_s, 40_001)
    column = plan.axes.index("X")
    v, a = plan(times, 1)[:, column], plan(times, 2)[:, column]
    result = found["deceleration", "X"]
    assert result.limit == 5.0 and result.measured == pytest.approx(
        np.abs(a[v * a < 0]).max(), rel=0.02
    )
    use = found["path_use", ""]
    assert use.limit == 1.0 and 0.97 < use.measured <= 1.001 and "of path.acceleration" in use.note
