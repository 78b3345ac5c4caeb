"""The stitcher on the twin, compared with scipy: every filter, belt, limit and gear.

The tolerances are 0.1 um at the head without quantisers, and one encoder count with them (3.8 um),
also while the current is limited. Every run needs more current than the amplifier has, and more
than the 8-bit word holds.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.made import read_once
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.load import load_machine
from threadline.twin import simulate

from .chip_reference import COUNTS, LIMIT, RATIO, Axis, run

COUNT_M = RATIO / COUNTS
LEAD_X = ((0.89, -0.89 * 0.976, 0.0), (0.004, 0.0))
LEAD_Y = ((0.85, -0.85 * 0.973, 0.0), (0.004, 0.0))
Y = {"j": 8.1e-4, "b": 0.29, "ka": 42.0, "m": 70.0, "d": 2080.0, "k": 1e6, "mf": 175.0}


def there_and_back(ticks: int = 40) -> np.ndarray:
    """Counts per ms: 15 in/s after 5 ms, as fast back from 22 ms on, at rest from 35 ms on."""
    top = 15 * 25.4e-3 * 1e-3 / COUNT_M
    speed = np.interp(np.arange(ticks), [0, 5, 16, 22, 30, 35], [0, top, top, -top, -top, 0])
    return np.diff(np.rint(np.cumsum(speed)), prepend=0).astype(np.int64)


def overlaid(tmp_path: Path, text: str, base: str = "stitcher") -> Machine:
    """Return a machine file of its own, based on the library's."""
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "{base}"\nname = "mine"\n{text}')
    return load_machine(str(file))


def filters(kind: str, numbers: str) -> str:
    """Return controllers of another kind on both axes."""
    lines = "\n".join(f'{n} = "none"' for n in ("gain", "zero", "pole"))
    return "".join(
        f'[controllers.{c}]\nkind = "{kind}"\n{numbers}\n'
        + (lines if "gain" not in numbers else 'zero = "none"\npole = "none"\n')
        + "\n"
        for c in "xy"
    )


def check_against(
    machine: Machine, axis: str, reference: Axis, law: object, table: object, *,
    quantised: bool = False,
) -> np.ndarray:  # fmt: skip
    """Assert that load and frame follow the reference at every tick; return its states."""
    given = there_and_back()
    states = run(reference, given, law, quantised=quantised)
    recording = read_once(simulate(table(machine, {axis: given}), machine, quantised=quantised))
    tolerance = COUNT_M if quantised else 1e-7
    _, load = recording.samples(f"{axis}.load")
    head = states[:, 3] if reference.m else RATIO * states[:, 0]
    assert np.ptp(head) > 5e-4
    np.testing.assert_allclose(load[: len(states)], head, rtol=0, atol=tolerance)
    _, measured = recording.samples(f"{axis}.measured")
    seen = COUNTS * states[:, 0]
    if not reference.at_head:
        # With whole counts, one count moves the load by that much and a hair.
        seen, near = (np.floor(seen + 0.5), 1.001 * COUNT_M) if quantised else (seen, 1e-7)
        np.testing.assert_allclose(measured[: len(states)], COUNT_M * seen, rtol=0, atol=near)
    if reference.mf:
        _, frame = recording.samples(f"{axis}.frame")
        np.testing.assert_allclose(frame[: len(states)], -states[:, 5], atol=tolerance)
        assert np.ptp(states[:, 5]) > 3e-4
    _, current = recording.samples(f"{axis}.current_peak")
    assert np.abs(current).max() == pytest.approx(LIMIT, abs=1e-9)
    return states


@pytest.mark.parametrize("quantised", [False, True])
def test_x_as_built(quantised, table):
    """Lead, 22.06 ticks of dead time, coil with a clamped current, belt outside the loop."""
    check_against(load_machine("stitcher"), "X", Axis(), LEAD_X, table, quantised=quantised)


@pytest.mark.parametrize("quantised", [False, True])
def test_y_with_its_frame(quantised, table):
    """Y and its frame, whose own coordinate counts away from the head."""
    check_against(load_machine("stitcher"), "Y", Axis(**Y), LEAD_Y, table, quantised=quantised)


@pytest.mark.parametrize("quantised", [False, True])
def test_belt_inside_the_loop(quantised, table):
    """The encoder sits at the head; the loop becomes unstable after a while, and stays exact."""
    machine = load_machine("stitcher+head-feedback")
    check_against(machine, "X", Axis(at_head=True), LEAD_X, table, quantised=quantised)


@pytest.mark.parametrize("quantised", [False, True])
def test_clipped_output(quantised, table, tmp_path):
    """Equations 3.14d and 3.15e: the integrator of the current runs on beyond its limit."""
    form = 'amplifier = { mode = "voltage", limits = "output" }\n'
    machine = overlaid(tmp_path, f"[drives.x]\n{form}[drives.y]\n{form}")
    wound = check_against(machine, "X", Axis(clamp="output"), LEAD_X, table, quantised=quantised)
    held = run(Axis(), there_and_back(), LEAD_X, quantised=quantised)
    assert np.abs(wound[:, 2]).max() > 1.3 * LIMIT
    assert np.abs(wound[:, 3] - held[:, 3]).max() > 1e-5


def test_clipped_output_needs_a_coil(table, tmp_path):
    machine = overlaid(
        tmp_path,
        '[drives.x]\ninductance = "none"\namplifier = { mode = "voltage", limits = "output" }\n',
    )
    with pytest.raises(MachineError, match="without an inductance"):
        simulate(table(machine, {"X": there_and_back()}), machine)


LAWS = {
    "p": ('kp = "0.03 dac/count exact, assumed"', ((0.03, 0.0, 0.0), (0.0, 0.0))),
    "pd": (
        'kp = "0.02 dac/count exact, assumed"\nkd = "0.8 dac/count exact, assumed"',
        ((0.82, -0.8, 0.0), (0.0, 0.0)),
    ),
    "pi": (
        'kp = "0.02 dac/count exact, assumed"\nki = "4e-5 dac/count exact, assumed"',
        ((0.02004, -0.02, 0.0), (-1.0, 0.0)),
    ),
    "pid": (
        'kp = "0.02 dac/count exact, assumed"\nki = "4e-5 dac/count exact, assumed"\n'
        'kd = "0.8 dac/count exact, assumed"',
        ((0.82004, -1.62, 0.8), (-1.0, 0.0)),
    ),
    "proportional-velocity": (
        'gain = "1.9137 dac/count exact, assumed"',
        ((1.9137, -1.9137, 0.0), (0.0, 0.0)),
    ),
}


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("kind", list(LAWS))
def test_filters(kind, quantised, table, tmp_path):
    """P (the winder's PE), PD, PI, PID and the chip's proportional velocity on X with its belt."""
    numbers, law = LAWS[kind]
    machine = overlaid(tmp_path, filters(kind, numbers))
    check_against(machine, "X", Axis(), law, table, quantised=quantised)


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("share", [0.8, 0.3])
def test_belt_with_unequal_runs(share, quantised, table, tmp_path):
    """k1 = share k, k2 = the rest; each pulls while the preload keeps it tight (eqs C.9-C.11)."""
    text = f'preload = "150 N exact, assumed"\nfirst_run = "{share} exact, assumed"\n'
    machine = overlaid(tmp_path, f"[links.x_belt]\n{text}")
    k1, k2 = share * 6.24e5, (1 - share) * 6.24e5

    def belt(s, _rate, _y):
        return max(0.0, 150 + k1 * s) - max(0.0, 150 - k2 * s)

    bent = check_against(machine, "X", Axis(belt=belt), LEAD_X, table, quantised=quantised)
    other = run(
        Axis(belt=lambda s, _r, _y: max(0.0, 150 + k2 * s) - max(0.0, 150 - k1 * s)),
        there_and_back(), LEAD_X, quantised=quantised,
    )  # fmt: skip
    assert np.abs(bent[:, 3] - other[:, 3]).max() > 1e-4  # here it matters which run is the first
    stretch = RATIO * bent[:, 0] - bent[:, 3]
    assert stretch.max() > 150 / k2  # the second run goes slack
    assert (stretch.min() < -150 / k1) == (share == 0.8)  # and the first, on the way back


@pytest.mark.parametrize("quantised", [False, True])
@pytest.mark.parametrize("phase", [0.0, 1.3, -2.0])
def test_eccentric_gear(phase, quantised, table, tmp_path):
    """A play of 0.2 mm +- 0.2 mm that varies with the angle of the pulley, with bounces."""
    machine = overlaid(
        tmp_path,
        '[links.x_belt]\nplay = "0.2 mm exact, assumed"\n[links.x_belt.eccentric]\n'
        'angle = { x_motor = "0.5 exact, assumed" }\nwidth = "0.2 mm exact, assumed"\n'
        f'phase = "{phase} rad exact, assumed"\n',
    )

    def belt(s, _rate, y):
        half = 0.5 * (2e-4 + 2e-4 * np.cos(0.5 * y[0] + phase))
        return 6.24e5 * (max(0.0, s - half) + min(0.0, s + half))

    states = check_against(machine, "X", Axis(belt=belt), LEAD_X, table, quantised=quantised)
    assert np.ptp(0.5 * states[:, 0]) > 0.3  # a large part of a turn
    plain = Axis(belt=lambda s, _r, _y: 6.24e5 * (max(0.0, s - 1e-4) + min(0.0, s + 1e-4)))
    even = run(plain, there_and_back(), LEAD_X, quantised=quantised)
    assert np.abs(even[:, 3] - states[:, 3]).max() > 5e-6


def test_eccentric_gear_is_checked(table, tmp_path):
    """More variation than play is refused, and so is a gear that turns without end."""
    eccentric = (
        '[links.x_belt.eccentric]\nangle = { x_motor = "0.5 exact, assumed" }\n'
        'width = "0.2 mm exact, assumed"\nphase = "0 rad exact, assumed"\n'
    )
    with pytest.raises(MachineError, match="at least its width"):
        overlaid(tmp_path, f'[links.x_belt]\nplay = "0.1 mm exact, assumed"\n{eccentric}')
    machine = overlaid(tmp_path, f'[links.x_belt]\nplay = "0.2 mm exact, assumed"\n{eccentric}')
    x = dataclasses.replace(machine.axes["X"], travel=None, endless=True)
    endless = dataclasses.replace(machine, axes={**machine.axes, "X": x})
    with pytest.raises(MachineError, match="endless"):
        simulate(table(endless, {"X": there_and_back()}), endless)


def test_on_cloth_that_the_frame_holds_the_head_is_judged_relative_to_it(table) -> None:
    """The same motion: Y is judged as the head less the frame, X as before."""
    ground, frame = (
        read_once(simulate(table(machine, {"X": there_and_back(), "Y": there_and_back()}), machine))
        for machine in (load_machine("stitcher"), load_machine("stitcher+cloth-on-frame"))
    )
    head, moved = ground.samples("Y.load")[1], ground.samples("Y.frame")[1]
    assert np.ptp(moved) > 1e-5
    np.testing.assert_allclose(frame.samples("Y.load")[1], head - moved, rtol=0, atol=1e-12)
    np.testing.assert_allclose(frame.samples("Y.frame")[1], moved, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(frame.samples("X.load")[1], ground.samples("X.load")[1])
