"""Many variants side by side, compared with the twin of one machine: samples and measures."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.machine.load import load_machine
from threadline.twin import BatchOptions, simulate, simulate_batch

from .belt_reference import ROWS, amplifier


def test_batch_is_the_scalar_twin(belt_axis, table):
    """Every variant of a batch equals ``simulate`` with that machine, to 1e-9 counts."""
    friction = np.array([1.0, 2.0, 4.0])
    line = 'friction = "{} N exact, assumed"\nstiction = "6 N exact, assumed"'
    machine = belt_axis(bodies_head=line.format(1))
    commands = table(machine, {"X": ROWS}, 37)
    batch = simulate_batch(
        commands,
        machine,
        {"bodies.head.friction": friction},
        options=BatchOptions(channels=("X.load", "X.current"), quantised=False),
    )
    for index, value in enumerate(friction):
        single = belt_axis(bodies_head=line.format(value))
        recording = simulate(table(single, {"X": ROWS}), single, quantised=False)
        for channel in ("X.load", "X.current"):
            np.testing.assert_allclose(
                batch.samples[channel][:, index], recording.samples(channel)[1], atol=1e-9 / 5e2
            )
    assert np.ptp(batch.end) > 1e-5


@pytest.mark.parametrize("quantised", [False, True])
def test_wide_batch_is_the_scalar_twin(belt_axis, table, quantised):
    """Variants side by side equal each one alone, to the bit: with a limit and friction."""
    limit = amplifier(1.5)
    inertia = np.linspace(1.0, 2.0, 70)
    machine = belt_axis(drives_m=limit, bodies_head='friction = "3 N exact, assumed"')
    commands = table(machine, {"X": ROWS})
    batch = simulate_batch(
        commands,
        machine,
        {"bodies.head.inertia": inertia},
        options=BatchOptions(
            channels=("X.load", "X.voltage", "X.current_peak"), quantised=quantised
        ),
    )
    assert batch.events > 500
    for index in (0, 7, 33, 69):
        single = belt_axis(
            drives_m=limit,
            bodies_head=f'inertia = "{float(inertia[index])!r} kg exact, assumed"\n'
            'friction = "3 N exact, assumed"',
        )
        recording = simulate(commands, single, quantised=quantised)
        for channel, values in batch.samples.items():
            np.testing.assert_array_equal(values[:, index], recording.samples(channel)[1])


def test_lanes_in_several_modes(table):
    """Sixteen advances of different lengths, with lanes in and out of their limit.

    The stitcher's dead time cuts its ticks unevenly. Each variant alone gives the same to 1e-9
    counts, without quantisers.
    """
    machine = load_machine("stitcher")
    commands = table(machine, {"X": np.full(40, 50), "Y": np.full(40, 45)})
    inertia = np.random.default_rng(3).uniform(60.0, 180.0, 16)
    channels = ("X.load", "Y.load", "X.current_peak")

    def run(values):
        return simulate_batch(
            commands,
            machine,
            {"bodies.x_head.inertia": values},
            options=BatchOptions(channels=channels, settle_s=0.02, quantised=False),
        )

    together = run(inertia)
    assert together.events > 16
    for index in (0, 6, 15):
        one_by_one = run(inertia[index : index + 1])
        for channel in channels:
            one, other = together.samples[channel][:, index], one_by_one.samples[channel][:, 0]
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 / 2.6e5)
    assert np.ptp(together.samples["X.load"][-1]) > 1e-6


def test_batch_measures(belt_axis, table):
    """Worst error, end, window and current peak equal those of the recording."""
    machine = belt_axis()
    commands = table(machine, {"X": ROWS})
    phases = np.array([[0.1], [0.5], [0.9]])
    batch = simulate_batch(
        commands, machine, encoder_phase=phases, options=BatchOptions(window_s=0.28)
    )
    for index, phase in enumerate(phases):
        recording = simulate(commands, machine, encoder_phase=phase)
        times, load = recording.samples("X.load")
        _, commanded = recording.samples("X.commanded")
        _, peak = recording.samples("X.current_peak")
        assert batch.worst_error[index, 0] == pytest.approx(np.abs(commanded - load).max())
        assert batch.end[index, 0] == pytest.approx(load[-1])
        assert batch.highest[index, 0] == pytest.approx(load[times >= 0.28].max())
        assert batch.lowest[index, 0] == pytest.approx(load[times >= 0.28].min())
        assert abs(batch.current_peak[index, 0]) == pytest.approx(np.abs(peak).max())
