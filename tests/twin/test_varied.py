"""Variants of a batch with another dead time or counts equal machines with these numbers."""

from __future__ import annotations

import numpy as np
import pytest

from tests.machine.test_variants import with_one_at_end
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.network import piecewise_linear
from threadline.dynamics.values import Values
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import load_machine
from threadline.machine.numbers import with_numbers
from threadline.machine.variants import drawn, numbers_at, variant
from threadline.twin.batch import BatchOptions, simulate_batch
from threadline.twin.kernel.piece import prepared
from threadline.twin.simulate import simulate


def moves(machine, ticks: int = 60) -> TickTable:
    """Return a table in which all axes go forth and back."""
    axes = len(machine.axes)
    shape = 40 * np.sin(np.linspace(0.0, 2.0 * np.pi, ticks))
    block = TickBlock(
        first_tick=0,
        counts=np.rint(np.repeat(shape[:, None], axes, axis=1)).astype(np.int64),
        operation=np.zeros(ticks, dtype=np.int64),
        events=(),
    )
    return TickTable(
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        clock=machine.tick_clock,
        start_counts=np.zeros(axes, dtype=np.int64),
        blocks=Stream.of([block]),
        job_sha256="",
        machine_sha256=machine.sha256,
    )


@pytest.mark.parametrize("name", ["stitcher", "lathe-winder"])
def test_drawn_variants_equal_their_own_machines(name: str) -> None:
    """Dead times (stitcher) and counts (winder) vary with everything else, in mixed order.

    Equal up to rounding: the fastest variant of a batch cuts its advances.
    """
    machine = load_machine(name)
    table = moves(machine)
    parts = drawn(machine, 5, np.arange(6))
    numbers = numbers_at(machine, parts)
    varied = "drives.x.delay" if name == "stitcher" else "axes.X.counts"
    assert len(set(numbers[varied].tolist())) == 6
    loads = tuple(f"{axis}.load" for axis in machine.axes)
    batch = simulate_batch(
        table, machine, numbers, options=BatchOptions(channels=loads, settle_s=0.05)
    )
    for k in range(6):
        one = simulate(table, variant(machine, parts[k]), settle_s=0.05)
        for channel in loads:
            np.testing.assert_allclose(
                batch.samples[channel][:, k], one.samples(channel)[1], rtol=1e-11, atol=1e-14
            )


def test_machines_of_many_dead_times_share_a_few_kernels() -> None:
    """A dead time cuts the 17 ms in which 1 ms and 136 us meet into 26 to 34 different lengths."""
    machine = load_machine("stitcher")
    shapes: list[set[object]] = [set(), set()]
    for delay_s in np.random.default_rng(7).uniform(2.7e-3, 3.3e-3, 30):
        late = with_numbers(machine, {"drives.x.delay": delay_s, "drives.y.delay": delay_s})
        pieces = piecewise_linear(late, Values.of(late), np.zeros(2))
        for known, piece in zip(shapes, pieces, strict=True):
            ready = prepared(late, piece, Values.of(late))
            known.add(ready.shape(1, 1, peak=True, quantised=True))
    assert max(len(known) for known in shapes) <= 4


def test_a_later_command_moves_later() -> None:
    """A dead time longer by 1 ms delays the first response of an open loop by 1 ms."""
    machine = load_machine("stitcher")
    table = moves(machine)
    delays = np.array([3e-3, 4e-3, 3e-3])
    batch = simulate_batch(
        table,
        machine,
        {"drives.x.delay": delays},
        options=BatchOptions(channels=("X.load",), settle_s=0.0),
    )
    load = batch.samples["X.load"]
    np.testing.assert_array_equal(load[:, 0], load[:, 2])
    tick = int(machine.tick_clock.period_s * 1000)
    assert tick == 1
    # Until the sensor reports motion both loops send the same levels, one of them a tick later.
    early = int(np.flatnonzero(load[:, 0])[0])
    assert int(np.flatnonzero(load[:, 1])[0]) == early + 1
    assert load[early, 0] == pytest.approx(load[early + 1, 1], rel=1e-6)


def test_the_linear_model_has_the_dead_time_of_its_variant() -> None:
    machine = load_machine("stitcher")
    (model, *_) = linear_model(machine, Values.of(machine, {"drives.x.delay": np.array([4e-3])}))
    assert model.delay_s[model.inputs.index("drives.x")] == 4e-3
    assert with_one_at_end(machine, "drives.x.delay").drives["x"].delay.si == 3.3e-3
