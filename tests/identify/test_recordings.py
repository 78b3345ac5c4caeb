"""Numbers fitted to recorded runs of the simulated machine, through its rounding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.errors import RecordingError
from threadline.files import ChannelKind, Recording, RecordingBlock
from threadline.files.formats import write_recording
from threadline.identify.parameter_fit import fit
from threadline.identify.time_domain import recording_data
from threadline.machine import load_machine
from threadline.machine.numbers import number_at, with_numbers
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin.simulate import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
WINDER = ("bodies.x.inertia", "drives.x.amplifier.gain")


def commands(job, machine):
    options = options_of()
    return plan_job(open_job(EXAMPLES / job, machine, options), machine, options).commands


@pytest.fixture(scope="module")
def winder():
    """Return the machine, and a recording of x-180 with its encoder between two counts."""
    machine = load_machine("lathe-winder")
    table = commands("x-180.prg", machine)
    recording = simulate(table, machine, encoder_phase=np.array([0.2, 0.83, 0.6]))
    return machine, replace(recording, blocks=list(recording))


def off(machine, names, factors):
    true = np.array([number_at(machine, name).si for name in names])
    changed = dict(zip(names, (true * factors).tolist(), strict=True))
    return with_numbers(machine, changed), true


def pole_and_gain(machine):
    """Return the X plant of the winder, K / (s (s + p)), from the volts of its controller."""
    J = number_at(machine, "bodies.x.inertia").si
    motor = machine.motors["x"]
    Kt, Ke, R = motor.torque_constant.si, motor.back_emf.si, motor.resistance.si
    return np.array([Kt * Ke / (R * J), motor.amplifier.gain.si * Kt / (R * J)])


def test_one_recording_gives_pole_and_gain_of_the_winder_within_one_percent(winder):
    machine, recording = winder
    guess, _ = off(machine, WINDER, [1.3, 0.7])
    found = fit(guess, [recording_data(recording, guess, Path("x.npz"))], WINDER)
    assert pole_and_gain(found.fitted) == pytest.approx(pole_and_gain(machine), rel=0.01)
    for number in found.numbers:
        true = number_at(machine, number.name).si
        assert number.interval[0] < true < number.interval[1]
        assert number.tolerance < 0.02
    assert not found.unexplained


def test_samples_that_are_shifted_by_a_tick_give_a_pole_that_is_wrong_by_a_quarter(winder):
    """The volts of a sample act before it; samples taken after the controller mislead."""
    machine, recording = winder
    guess, _ = off(machine, WINDER, [1.3, 0.7])
    data = recording_data(recording, guess, Path("x.npz"))
    for ticks in (1, -1):
        shifted = {name: np.roll(values, ticks) for name, values in data.measured.items()}
        found = fit(guess, [replace(data, measured=shifted)], WINDER)
        pole, _ = pole_and_gain(found.fitted) / pole_and_gain(machine)
        assert 0.18 < abs(pole - 1.0) < 0.35


def test_the_machine_that_is_driven_by_volts_moves_as_the_one_in_the_loop(winder):
    """Exactly, with the numbers of the machine: only the rounding of the encoder is left."""
    machine, recording = winder
    data = recording_data(recording, machine, Path("x.npz"))
    residual = data.residuals({WINDER[0]: np.array([number_at(machine, WINDER[0]).si])})
    assert data.by_volts and np.abs(residual).max() <= 1.0 + 1e-9
    loads = [block.samples["X.load"] for block in recording]
    exact = replace(data, measured={"X.load": np.concatenate(loads) * data.scale["X.load"]})
    residual = exact.residuals({WINDER[0]: np.array([number_at(machine, WINDER[0]).si])})
    assert np.abs(residual).max() < 1e-6  # counts


@pytest.mark.long(
    shown_by="test_one_recording_gives_pole_and_gain_of_the_winder_within_one_percent"
)
def test_the_play_of_a_gear_is_found_in_the_loop_within_ten_percent():
    """The filter of the stitcher is faster than its samples: the loop is simulated as a whole."""
    machine = load_machine("stitcher+backlash")
    table = commands("stitcher-test-path.seam.toml", machine)
    recording = simulate(table, machine, encoder_phase=np.array([0.3, 0.9]))
    names = ("links.x_belt.play",)
    guess, true = off(machine, names, [1.4])
    data = recording_data(recording, guess, Path("x.npz"), "X")
    found = fit(guess, [data], names, starts=2)
    assert not data.by_volts
    assert found.numbers[0].value == pytest.approx(true[0], rel=0.1)


def test_inertia_torque_constant_and_resistance_give_two_numbers_at_most(
    winder, tmp_path, monkeypatch, capsys
):
    _, recording = winder
    monkeypatch.chdir(tmp_path)
    write_recording(recording, Path("x.npz"))
    numbers = "bodies.x.inertia,drives.x.torque_constant,drives.x.resistance"
    with pytest.raises(SystemExit) as left:
        main(["fit", "x.npz", "-m", "lathe-winder", "--numbers", numbers, "-o", "no.toml"])
    err = capsys.readouterr().err
    assert left.value.code == 2 and not Path("no.toml").exists()
    assert "3 numbers, but the data determines only 1 combination" in err
    assert "drives.x.torque_constant" in err and err.count("\n") == 1


def without(recording, kind):
    channels = tuple(c for c in recording.channels if c.kind is not kind)
    return replace(recording, channels=channels)


def changed(recording, name, change):
    blocks = [
        replace(block, samples={**block.samples, name: change(block.samples[name])})
        for block in recording.blocks
    ]
    return replace(recording, blocks=blocks)


def gap(recording: Recording) -> Recording:
    first, *others = recording.blocks
    half = {name: values[:50] for name, values in first.samples.items()}
    again = {name: values[60:] for name, values in first.samples.items()}
    late = {clock: tick + 60 for clock, tick in first.first_tick.items()}
    return replace(
        recording,
        blocks=[
            RecordingBlock(first_tick=first.first_tick, samples=half),
            RecordingBlock(first_tick=late, samples=again),
            *others,
        ],
    )


def in_radians(recording: Recording) -> Recording:
    channels = (replace(c, unit="rad" if c.unit == "m" else c.unit) for c in recording.channels)
    return replace(recording, channels=tuple(channels))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: without(r, ChannelKind.COMMANDED), "the commanded position is missing"),
        (lambda r: without(r, ChannelKind.MEASURED), "its measured position is missing"),
        (lambda r: changed(r, "X.commanded", lambda v: 0 * v), "does not move"),
        (lambda r: changed(r, "X.commanded", lambda v: v * 1.003), "beside whole counts"),
        (lambda r: changed(r, "X.voltage", lambda v: v * 0 + 10.0), "is at its clamp of"),
        (lambda r: changed(r, "X.commanded", lambda v: v + np.nan), "X.commanded is nan at 0 s"),
        (lambda r: changed(r, "X.measured", lambda v: v * 0 + 1e308), "X.measured is 1e.308"),
        (lambda r: changed(r, "X.voltage", lambda v: v * 0 - 9.98), "is at its clamp of"),
        (in_radians, "X.commanded is in rad, but axis X of lathe-winder is linear: m"),
        (gap, "samples are missing at 0.25 s"),
        (lambda r: replace(r, runs=2), "it has 2 runs"),
    ],
)
def test_recordings_that_say_nothing_are_refused(winder, spoil, message):
    machine, recording = winder
    with pytest.raises(RecordingError, match=message):
        recording_data(spoil(recording), machine, Path("x.npz"))


def test_a_recording_of_another_machine_is_refused(winder):
    _, recording = winder
    with pytest.raises(RecordingError, match="has a sample each 5 ms, but the tick of stitcher"):
        recording_data(recording, load_machine("stitcher"), Path("x.npz"))
