"""The tension in the twin: its effect on the axes, and its causes."""

from __future__ import annotations

import pickle
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.tension.conftest import planned
from tests.tension.spool_reference import Numbers, Reference
from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.files import ChannelKind, Recording, TickBlock, TickTable
from threadline.machine import load_machine
from threadline.machine.vary import drawn_days, varied_numbers, vary
from threadline.twin import Session, simulate, simulate_runs
from threadline.verdict.replayed import WoundJob, wound_job


def test_a_product_is_mounted_where_there_is_a_spool(plan: Plan, recorded: Recording) -> None:
    assert plan.machine.mounted is not None
    channel = recorded.find(ChannelKind.TENSION)
    assert channel is not None and (channel.name, channel.unit) == ("tension", "N")
    without = planned(load_machine("lathe-winder"))
    assert without.machine.mounted is None
    assert simulate(without.commands, without.machine).find(ChannelKind.TENSION) is None


def test_a_spool_without_a_mandrel_changes_nothing(beginning: TickTable) -> None:
    plain, spool = load_machine("lathe-winder"), load_machine("lathe-winder+spool")
    one, other = (simulate(beginning, machine, settle_s=0.1) for machine in (plain, spool))
    for name in ("X.load", "A.load", "Y.voltage"):
        assert np.array_equal(one.samples(name)[1], other.samples(name)[1])


def test_the_fibre_pulls_at_the_axes_by_virtual_work(plan: Plan) -> None:
    """The length given out per change of a coordinate equals the change of the replayed fibre."""
    job = wound_job(plan)
    assert job is not None
    samples = _some_places(plan, job)
    step = np.array([1e-6, 1e-6, 1e-6, 1e-6])  # turn, along, across, up
    for eye, before in samples:
        for k in range(4):
            lengths = []
            for sign in (1.0, -1.0):
                replay = job.replay()
                fibre = replay.feed(before)
                moved = eye.copy()
                moved[k] += sign * step[k]
                lengths.append(replay.feed(moved[None]).used_m[0])
            leads = job.replay().leads(eye, fibre.u[-1], fibre.angle[-1])
            change = (lengths[0] - lengths[1]) / (2.0 * step[k])
            assert leads[k] == pytest.approx(change, abs=2e-5), k


def _some_places(plan: Plan, job: WoundJob) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return eyes of the programmed circuit, with all eyes up to each."""
    points = np.vstack([np.asarray(b.positions) for b in plan.motion.programmed if len(b)])
    eyes = job.eyes(points)
    turning = int(np.argmax(np.abs(eyes[:, 0] - eyes[0, 0]) > 0.01))
    return [(eyes[k], eyes[: k + 1]) for k in (turning + 20, turning + 80, turning + 150)]


def test_the_loops_give_way_to_the_tied_fibre(plan: Plan, recorded: Recording) -> None:
    """Force over the stiffness of a loop at rest: Kt / R Kamp kp 10 V / 2048 counts / lever^2."""
    machine = plan.machine
    spool, mandrel = machine.spool, machine.mounted
    assert spool is not None and mandrel is not None and mandrel.leads is not None
    for axis, k in (("A", 0), ("X", 1), ("Y", 2)):
        drive = machine.drive_of(axis)
        counts = machine.axes[axis].counts.si
        lever = 4000.0 / (2.0 * pi) / counts  # m or rad of the axis per rad of its motor
        stiffness = drive.torque_constant.si / drive.resistance.si * drive.amplifier.gain.si
        stiffness *= 2.0 * (10.0 / 2048.0) * counts / lever  # N/m or N m/rad
        force = -spool.tension_n * mandrel.leads[k]
        start = recorded.samples(f"{axis}.load")[1][0] - recorded.samples(f"{axis}.commanded")[1][0]
        # Encoder and DAC each round to whole numbers.
        assert start == pytest.approx(force / stiffness, abs=1.1 / counts)
        assert abs(start) > 2.0 / counts or abs(force) < 1.0


def test_the_tension_follows_from_the_real_positions(plan: Plan, recorded: Recording) -> None:
    """Replay, a spline through the length of fibre, and DOP853: within 0.3 % of the tension."""
    machine, job = plan.machine, wound_job(plan)
    spool = machine.spool
    assert job is not None and spool is not None
    found = recorded.samples_of([*(f"{axis}.load" for axis in job.axes), "tension"])
    times, tension = found["tension"]
    places = np.column_stack([found[f"{axis}.load"][1] for axis in job.axes])
    fibre = job.replay().feed(job.eyes(places))
    used = np.where(fibre.state == 4, 0.0, fibre.used_m)  # 4: nothing laid yet
    length = CubicSpline(times, np.cumsum(used))
    arm = spool.arm
    assert arm.damping is not None and arm.release is not None and spool.damping is not None
    numbers = Numbers(
        radius=spool.radius.si, inertia=spool.inertia.si, torque=spool.torque.si,
        stiction=spool.torque.si, stiffness=spool.stiffness.si, damping=spool.damping.si,
        mass=arm.mass.si, spring=arm.stiffness.si, damper=arm.damping.si, preload=arm.preload.si,
        travel=arm.travel.si, release=arm.release.si,
    )  # fmt: skip
    reference = Reference(numbers, length.derivative())
    expected = np.concatenate([reference.advance(times[k : k + 40]) for k in range(1, 1161, 40)])
    friction = spool.friction
    assert friction is not None
    drawn = length.derivative()(times[1:1161]) > 5e-3
    drawn[: int(drawn.argmax()) + 20] = False  # the spline rings where the motion begins
    own = tension[1:1161][drawn] / (1.0 + friction.si)
    assert drawn.sum() > 500
    assert np.ptp(own) > 0.1
    assert np.abs(own - expected[drawn]).max() < 0.02


def test_pieces_and_pickles_of_a_session_do_not_matter(
    plan: Plan, beginning: TickTable, recorded: Recording
) -> None:
    session = Session(plan.machine, start_counts=beginning.start_counts)
    parts, random = [], np.random.default_rng(3)
    for block in beginning.blocks:
        at = 0
        while at < len(block):
            end = min(at + int(random.integers(1, 200)), len(block))
            rows = TickBlock(
                first_tick=block.first_tick + at,
                counts=block.counts[at:end],
                operation=block.operation[at:end],
            )
            parts.append(session.advance(rows))
            session = pickle.loads(pickle.dumps(session))
            at = end
    whole = recorded.samples_of(["X.load", "A.load", "tension"])
    for name, (_, values) in whole.items():
        own = np.concatenate([part.samples[name] for part in parts])
        assert np.array_equal(own, values[: len(own)]), name


def test_runs_side_by_side_are_those_of_each_day(
    plan: Plan, beginning: TickTable, recorded: Recording
) -> None:
    days = drawn_days(9, 3, np.random.default_rng(1))
    assert days.tension[0] == 1.0
    assert (np.abs(days.tension - 1.0) <= 0.05).all() and np.ptp(days.tension) > 0.05
    values = Values.of(plan.machine, varied_numbers(plan.machine, days))
    together = simulate_runs(beginning, values, settle_s=0.1, encoder_phase=np.full(3, 0.5))
    tension = together.samples("tension")[1]
    assert np.array_equal(tension[:, 0], recorded.samples("tension")[1])
    for day in (2, 7):
        one = vary(
            plan.machine,
            friction=float(days.friction[day]),
            supply=float(days.supply[day]),
            tension=float(days.tension[day]),
        )
        single = simulate(beginning, one, settle_s=0.1)
        assert np.array_equal(tension[:, day], single.samples("tension")[1])
    middle = np.median(tension, axis=0)
    assert np.corrcoef(middle, days.tension)[0, 1] > 0.5


def test_a_fibre_of_unknown_tie_begins_slack(plan: Plan, beginning: TickTable) -> None:
    mandrel = plan.machine.mounted
    assert mandrel is not None
    machine = replace(plan.machine, mounted=replace(mandrel, leads=None))
    tension = simulate(beginning, machine, settle_s=0.1).samples("tension")[1]
    rises = tension[np.argmax(tension > 0.0) :]
    assert tension[0] == 0.0 and rises.max() > 5.0
