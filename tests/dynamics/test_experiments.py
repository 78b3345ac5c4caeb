"""Experiments on the quantised simulated machine, compared with its file and the print."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from threadline.dynamics.loop import axis_loop
from threadline.errors import OptionError
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine import load_machine
from threadline.report.searches import experiment_figure, experiment_table
from threadline.search.experiments import (
    Campaign,
    Sweep,
    constant_speed_gain,
    identify,
    position_step,
    run_experiments,
    stepped_sine,
)
from threadline.twin import simulate

from . import reference as ref

INCH = 25.4e-3


def test_identify_finds_what_a_sweep_was_made_of():
    """500 rad/s, 0.7, 42 and 3 ms, by formula: 1e-6, the fit's own tolerance."""
    hertz = np.geomspace(1, 200, 30)
    s = 2j * np.pi * hertz
    response = 42 * 500**2 / (s**2 + 2 * 0.7 * 500 * s + 500**2) * np.exp(-3e-3 * s)
    found = identify(Sweep(frequency_hz=hertz, response=response))
    assert found.natural_rad_s == pytest.approx(500, rel=1e-6)
    assert found.damping == pytest.approx(0.7, rel=1e-6)
    assert found.gain == pytest.approx(42, rel=1e-6)
    assert found.delay_s == pytest.approx(3e-3, rel=1e-6)


def test_the_actuator_is_identified_through_the_quantised_loop():
    """500 rad/s, 0.7, 3 ms and 42 rad/s/V in print; 8-bit words leave 1 % on the damping."""
    found = run_experiments(load_machine("stitcher+unloaded"), "X")
    assert found.fitted.natural_rad_s == pytest.approx(500, rel=0.01)
    assert found.fitted.damping == pytest.approx(0.7, abs=0.015)
    assert found.delay_s == pytest.approx(3e-3, abs=10e-6)
    assert found.gain == pytest.approx(42, rel=0.01)
    # The onset of saturation lies between two of the tried steps, and stays above it.
    forth = [run for size, run in found.steps if size > 0]
    assert max(size for size, _ in found.steps) == pytest.approx(8 * np.pi)
    assert min(size for size, _ in found.steps) < 0  # back as well
    flags = [run.saturated for run in forth]
    assert flags == sorted(flags) and flags[0] is False and flags[-1] is True
    assert found.steps[0][1].peak_current_a < 27
    rises = [run.rise_s for run in forth]
    assert rises == sorted(rises)


def test_head_steps_on_the_simulated_machine():
    """3 pi/8 ... 3 pi/4 rad are 0.23 ... 0.45 in; limited at 27 A, larger steps rise slower."""
    machine = load_machine("stitcher")
    runs = [position_step(machine, "X", k * np.pi / 8 * ref.RATIO) for k in (3, 4, 5, 6)]
    for run, inches in zip(runs, (0.23, 0.30, 0.38, 0.45), strict=True):
        assert run.load_si / INCH == pytest.approx(inches, rel=0.03)
        assert run.saturated and run.peak_current_a <= 27.0 + 1e-9
        assert run.load_overshoot > run.overshoot
    assert [r.rise_s for r in runs] == sorted(r.rise_s for r in runs)
    assert [r.load_overshoot for r in runs] == sorted(
        (r.load_overshoot for r in runs), reverse=True
    )
    # The amplifier saturates: with ten times the current the overshoot stays the same.
    drive = machine.drives["x"]
    amplifier = drive.amplifier
    strong = dataclasses.replace(
        amplifier, current_limit=dataclasses.replace(amplifier.current_limit, si=2700.0)
    )
    free = dataclasses.replace(
        machine, drives={**machine.drives, "x": dataclasses.replace(drive, amplifier=strong)}
    )
    assert not position_step(free, "X", 3 * np.pi / 8 * ref.RATIO).saturated


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_simulated_machine_and_sampled_loop_are_one(axis):
    """Two codes for one machine, without rounding: 1e-11 m where their clocks coincide."""
    machine = load_machine("stitcher")
    rows = np.zeros((50, 2), dtype=np.int64)
    rows[0, machine.axis_names.index(axis)] = 40
    table = TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(2, dtype=np.int64),
        blocks=Stream.of([TickBlock(first_tick=0, counts=rows, operation=np.zeros(50, dtype=int))]),
        job_sha256="job",
        machine_sha256=machine.sha256,
    )
    _, load = simulate(table, machine, quantised=False, settle_s=0.2).samples(f"{axis}.load")
    loop = axis_loop(machine, axis)
    closed = loop.closed()
    time_s = np.arange(1750) * loop.period_s
    reference = np.where(time_s > 1e-3 - 1e-9, 40.0, 0.0)[:, None]
    mine = closed.respond(reference)[:, closed.outputs.index(f"{axis}.load")]
    # 17 reference ticks are 125 ticks of the filter.
    assert np.abs(mine).max() > 1e-4
    np.testing.assert_allclose(load[: 17 * 13 + 1 : 17], mine[: 125 * 13 + 1 : 125], atol=1e-11)


def test_wrong_experiments_are_refused():
    machine = load_machine("stitcher")
    with pytest.raises(OptionError, match="slower than its controller"):
        stepped_sine(machine, "X", np.array([10.0]))
    with pytest.raises(OptionError, match="above a quarter of the tick rate"):
        stepped_sine(load_machine("lathe-winder"), "X", np.array([60.0]))
    with pytest.raises(OptionError, match="less than a count"):
        position_step(machine, "X", 1e-9)
    with pytest.raises(OptionError, match="other than 0"):
        constant_speed_gain(machine, "X", 0.0)
    with pytest.raises(OptionError, match="no axis 'Q'"):
        position_step(machine, "Q", 1.0)


def test_steps_forth_and_back_tell_unequal_runs() -> None:
    """A tight belt answers alike both ways (figure C.11), a slack one only with equal runs."""
    size = 3 * np.pi / 8 * 29e-3 / 6

    def both(machine: str) -> tuple[float, float]:
        runs = [position_step(load_machine(machine), "X", s, 0.3) for s in (size, -size)]
        return runs[0].load_overshoot, runs[1].load_overshoot

    for alike in ("stitcher", "stitcher+slack-belt"):
        forth, back = both(alike)
        assert forth == pytest.approx(back, abs=2e-3)  # the 8-bit word has one level more below 0
    forth, back = both("stitcher+unequal-runs")
    assert forth - back > 0.03


@pytest.mark.parametrize("overlay", ["clipped-output", "eccentric-gear"])
def test_overlays_change_a_step(overlay: str) -> None:
    plain, other = (
        position_step(load_machine(name), "X", 3 * np.pi / 8 * 29e-3 / 6, 0.3)
        for name in ("stitcher", f"stitcher+{overlay}")
    )
    assert abs(plain.load_overshoot - other.load_overshoot) > 1e-3


def test_steps_are_drawn() -> None:
    """Every curve ends at its step; the peaks stand at the limit of 27 A."""
    machine = load_machine("stitcher")
    sizes = (np.pi / 8, 3 * np.pi / 8, -3 * np.pi / 8)
    steps = tuple((s, position_step(machine, "X", s * 29e-3 / 6, 0.6)) for s in sizes)
    campaign = Campaign(axis="X", gain=37.0, delay_s=3e-3, fitted=None, steps=steps)

    figure, caption = experiment_figure(campaign)

    motor, load, current, overshoot = figure.axes
    for axes in (motor, load):
        curves = [line for line in axes.lines if "pi rad" in str(line.get_label())]
        assert [line.get_label() for line in curves] == ["0.125 pi rad", "0.375 pi rad"]
        # At rest an error of up to 24 counts, 0.04 of the smaller step, is rounded away.
        assert all(line.get_ydata()[-1] == pytest.approx(1.0, abs=0.05) for line in curves)
    drawn = {line.get_label(): line for line in current.lines}
    assert drawn["forth"].get_ydata()[1] == pytest.approx(27.0)
    assert drawn["back"].get_xdata() == pytest.approx([0.375])
    assert drawn["limit"].get_ydata()[0] == pytest.approx(27.0)
    assert overshoot.lines[0].get_ydata()[1] == pytest.approx(27.9, abs=0.5)  # as in the table
    assert "limited from 1.178 rad on" in caption
    assert len(experiment_table(campaign).rows) == 3
