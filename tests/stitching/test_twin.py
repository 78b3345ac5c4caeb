"""The twin of a frame driven by steps, against an integrator without power series."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.made import read_once
from threadline.commands.step_tables import step_tables
from threadline.errors import MachineError, RecordingError
from threadline.files import Clock, Event, StepPlay, StepTable, StitchBlock, Stream
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import with_numbers
from threadline.motion.laws import law
from threadline.motion.shaping import FlexibleMode, residual_m
from threadline.twin import stitching
from threadline.twin.stitching import simulate_stitching

MACHINE = load_machine("schiffli-frame")
TIMER = Fraction(1, 16_000_000)
TURN, WINDOW = 5_760_000, 1_920_000


def commands(
    library: tuple[StepTable, ...],
    table: list[list[int]],
    sign: list[list[int]],
    machine: Machine = MACHINE,
    *,
    chunk: int = 100,
    stretched: float = 1.0,
) -> StepPlay:
    """Return turns of ``stretched`` times the shortest duration, counted by angle if stretched."""
    count = len(table)
    begin = np.rint(TURN * stretched * np.arange(count)).astype(np.int64)
    blocks = [
        StitchBlock(
            first_stitch=k,
            begin=begin[k : k + chunk],
            window=np.full(len(begin[k : k + chunk]), round(WINDOW * stretched)),
            table=np.array(table[k : k + chunk]),
            sign=np.array(sign[k : k + chunk]),
            start=np.zeros(len(begin[k : k + chunk]), dtype=np.int64),
            needle=np.ones(len(begin[k : k + chunk]), dtype=np.int64),
            operation=np.arange(count)[k : k + chunk],
            events=(Event(tick=k, kind="tool", operation=k, name="trim"),),
        )
        for k in range(0, count, chunk)
    ]
    return StepPlay(
        clock=Clock("timer", TIMER),
        counted_by="time" if stretched == 1.0 else "angle",
        steps_per_turn=TURN,
        window_angle=WINDOW,
        axes=("X", "Y"),
        steps_per_unit=machine.counts_per_unit,
        start_steps=np.array([480, 0]),
        library=library,
        blocks=Stream.of(blocks),
        duration_ticks=round(TURN * stretched * count),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


@pytest.mark.parametrize("stretched", [1.0, 1.2345])
def test_steps_are_placed_exactly_in_time(stretched: float) -> None:
    """The axes get steps at odd instants, ten on X and seven on Y; DOP853 restarts at each step."""
    library = (
        StepTable(units=1, intervals=np.array([7, 9001, 130_007, 3, 55_555, 1, 1, 800_000, 5, 77])),
        StepTable(units=2, intervals=np.array([15_999, 1, 16_001, 123_456, 700_000, 17, 2])),
    )
    play = commands(library, [[0, 1], [1, 0]], [[1, -1], [-1, 1]], stretched=stretched)
    recording = simulate_stitching(play, MACHINE)
    times, load = recording.samples("X.load")
    _, commanded = recording.samples("X.commanded")

    scale = 1.0 if stretched == 1.0 else round(WINDOW * stretched) / WINDOW
    dues = []
    for turn, (which, sign) in enumerate(((0, 1), (1, -1))):
        at = round(TURN * stretched * turn) + library[which].times * scale
        dues += [(float(t) / 16e6, sign) for t in at]
    k, c, guides, mass = 5.685e6, 2916.0, 100.0, 1000.0
    w, step = 2.0 * np.pi * 150.0, 1.0 / 480e3

    def rates(_: float, z: np.ndarray, p: float) -> list[float]:
        x, v, m, u = z
        pull = k * (m - x) + c * (u - v) - guides * v
        return [v, pull / mass, u, w * w * (p - m) - 2.0 * w * u]

    z, now, p = np.zeros(4), 0.0, 0.0
    kept = {}
    ends = [*dues, (float(times[-1]) + 1e-9, 0)]
    for due, sign in ends:
        inside = times[(times >= now) & (times <= due)]
        if due > now:
            found = solve_ivp(
                rates, (now, due), z, "DOP853", t_eval=np.unique(np.append(inside, due)), args=(p,),
                rtol=1e-12, atol=1e-18,
            )  # fmt: skip
            for t, value in zip(inside, found.y[0], strict=False):
                kept.setdefault(float(t), (value, p))
            z = found.y[:, -1]
        now, p = due, p + sign * step
    expected = np.array([kept[float(t)] for t in times])
    assert np.abs(load - 1e-3 - expected[:, 0]).max() < 1e-13
    assert np.abs(commanded - 1e-3 - expected[:, 1]).max() < 1e-15


@pytest.mark.parametrize("frequency", [8.0, 12.0, 25.0])
def test_residual_of_a_move_agrees_with_the_closed_form_of_its_law(frequency: float) -> None:
    """On a stiff servo, 16.5 mm in 120 ms leave the closed form's amplitude within 1 %."""
    stiffness = 1000.0 * (2.0 * np.pi * frequency) ** 2
    machine = with_numbers(
        MACHINE,
        {
            "links.x_train.stiffness": stiffness,
            "links.x_train.damping": 2.0 * 0.02 * np.sqrt(stiffness * 1000.0),
            "drives.x.bandwidth": 1000.0,
        },
    )
    motion = law("modified-sine")
    tables = step_tables(
        motion, window_s=Fraction(12, 100), timer_s=TIMER, steps_per_unit=48, longest_units=165
    )
    recording = simulate_stitching(commands(tables, [[164, -1]], [[1, 0]], machine), machine)
    times, load = recording.samples("X.load")
    after = times >= 0.12
    mode = FlexibleMode(frequency, 0.02)
    rings = load[after] - 1e-3 - 16.5e-3
    envelope = np.exp(0.02 * 2 * np.pi * frequency * (times[after] - 0.12))
    peak = np.abs(rings * envelope)[: int(500 / frequency * 2)].max()
    exact = residual_m(motion, mode, 16.5e-3, np.array([0.12]))[0]
    assert peak == pytest.approx(exact, rel=0.01, abs=3e-6)


def test_simulated_stitching_does_not_depend_on_its_blocks() -> None:
    tables = step_tables(
        law("cycloidal"), window_s=Fraction(12, 100), timer_s=TIMER, steps_per_unit=48,
        longest_units=20,
    )  # fmt: skip
    table = [[k % 20, -1 if k % 3 == 0 else (k * 7) % 20] for k in range(30)]
    sign = [[1 if k % 2 else -1, 0 if k % 3 == 0 else 1] for k in range(30)]
    whole = read_once(simulate_stitching(commands(tables, table, sign), MACHINE))
    for chunk in (30, 7, 1):
        play = commands(tables, table, sign, chunk=chunk)
        cut = read_once(simulate_stitching(play, MACHINE))
        for name in ("X.load", "Y.load", "X.torque_share", "needle", "operation", "Y.commanded"):
            assert np.array_equal(whole.samples(name)[1], cut.samples(name)[1])
        end = play.end_steps() / play.steps_per_unit
        for axis, place in zip("XY", end, strict=True):
            assert cut.samples(f"{axis}.commanded")[1][-1] == pytest.approx(place, abs=1e-12)
            assert cut.samples(f"{axis}.load")[1][-1] == pytest.approx(place, abs=2e-4)


def test_a_long_stretch_is_recorded_in_short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive's clock of 1 us makes a hundred million samples of some turns; blocks hold a few."""
    tables = step_tables(
        law("cycloidal"), window_s=Fraction(12, 100), timer_s=TIMER, steps_per_unit=48,
        longest_units=20,
    )  # fmt: skip
    table = [[k % 20, (k * 7) % 20] for k in range(12)]
    play = commands(tables, table, [[1 if k % 2 else -1, 1] for k in range(12)], chunk=7)
    whole = read_once(simulate_stitching(play, MACHINE))
    monkeypatch.setattr(stitching, "AT_ONCE", 101)
    cut = read_once(simulate_stitching(play, MACHINE))
    assert max(len(block.samples["needle"]) for block in cut) == 101
    assert [e for block in cut for e in block.events] == [e for b in whole for e in b.events]
    for block in cut:
        first = block.first_tick["servo"]
        assert all(first <= event.tick <= first + 101 for event in block.events)
    for channel in whole.channels:
        for ours, theirs in zip(
            cut.samples(channel.name), whole.samples(channel.name), strict=True
        ):
            assert np.array_equal(ours, theirs), channel.name


def test_the_force_is_what_moves_both_masses() -> None:
    """F = M a of 1150 kg on a link that is stiff and damped; steps and lag account for 5 %."""
    tables = step_tables(
        law("modified-sine"), window_s=Fraction(12, 100), timer_s=TIMER, steps_per_unit=48,
        longest_units=165,
    )  # fmt: skip
    machine = with_numbers(
        MACHINE, {"links.x_train.stiffness": 5.685e9, "links.x_train.damping": 1.2e6}
    )
    recording = simulate_stitching(commands(tables, [[164, -1]], [[1, 0]], machine), machine)
    share = recording.samples("X.torque_share")[1].max()
    assert share * 58e3 == pytest.approx(1150.0 * 6.33, rel=0.05)


def test_the_needle_is_down_between_its_angles() -> None:
    """Turns of 360 ms at an even speed keep it down from 120 to 330 degrees: 120 to 330 ms."""
    tables = (StepTable(units=1, intervals=np.full(48, 1000)),)
    recording = simulate_stitching(commands(tables, [[0, -1]] * 3, [[1, 0]] * 3), MACHINE)
    times, down = recording.samples("needle")
    phase = np.rint(times * 1000).astype(int) % 360
    inside = (phase >= 120) & (phase < 330) & (times < 3 * 0.36)
    assert np.array_equal(down == 1, inside)


def test_unplayable_step_tables_are_refused_in_one_line() -> None:
    tables = (StepTable(units=1, intervals=np.full(48, 1000)),)
    play = commands(tables, [[0, -1]], [[1, 0]])
    with pytest.raises(RecordingError, match="another machine file"):
        simulate_stitching(replace(play, machine_sha256="x"), MACHINE)
    fast = with_numbers(MACHINE, {"links.x_train.stiffness": 1e15, "bodies.x_frame.inertia": 1e-3})
    with pytest.raises(MachineError, match="too fast for samples"):
        simulate_stitching(replace(play, machine_sha256=fast.sha256), fast)
