"""Margins, poles and stability, compared with hand-written formulas and other methods."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import lambertw

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics import margins
from threadline.dynamics.analysis import analyse_axis, loop_figures, unstable_loops
from threadline.dynamics.loop import Loop, axis_loop, axis_loops
from threadline.dynamics.margins import loop_margins, margins_of, refined_grid, unstable_count
from threadline.dynamics.poles import closed_poles, root_locus, zeros_of
from threadline.dynamics.sampled import DigitalFilter, StateSpace
from threadline.errors import MachineError, OptionError
from threadline.machine import load_machine

from . import reference as ref


@pytest.mark.parametrize(
    ("name", "axis", "numbers", "options"),
    [
        ("stitcher", "X", ref.X, {}),
        ("stitcher", "Y", ref.Y, {}),
        ("stitcher-rigid", "X", ref.X, {"rigid": True}),
        ("stitcher-rigid", "Y", ref.Y, {"rigid": True}),
        ("stitcher-rigid-half-mass", "X", ref.X, {"rigid": True, "mass": 0.5}),
        ("stitcher-rigid-half-mass", "Y", ref.Y, {"rigid": True, "mass": 0.5}),
    ],
)
def test_margins_against_a_dense_grid(name, axis, numbers, options):
    """1e-5: the dense grid's own interpolation; python-control with Pade is wrong there."""
    filters = ref.FILTERS[name if name in ref.FILTERS else "stitcher-rigid"][axis]
    gain, phase = ref.dense_margins(
        lambda w: ref.open_loop(numbers, *filters, w, **options), 0.5, 2e4
    )
    margins = loop_margins(axis_loop(load_machine(name), axis), "continuous")
    assert margins.raise_to == pytest.approx(gain, rel=1e-5)
    assert margins.worst_phase.phase_margin_deg == pytest.approx(phase, abs=1e-3)
    sampled = loop_margins(axis_loop(load_machine(name), axis), "sampled")
    assert sampled.raise_to == pytest.approx(gain, rel=1e-3)
    assert sampled.worst_phase.phase_margin_deg == pytest.approx(phase, abs=0.02)


def test_python_control_with_pade_is_wrong_where_we_are_not():
    """Its polynomial margin of the printed X loop is 3 % off by the Pade delay of the thesis."""
    import control  # with half of matplotlib: for one worker alone

    K, A, B = ref.FILTERS["stitcher-rigid"]["X"]
    gain, _ = ref.dense_margins(lambda w: ref.open_loop(ref.X, K, A, B, w, rigid=True), 0.5, 2e4)
    s = control.tf("s")
    J = ref.X["J"] + ref.X["M"] * ref.RATIO**2
    D = ref.X["B"] + ref.X["b"] * ref.RATIO**2
    motor = ref.X["Ka"] * ref.KT / (s * ((J * s + D) * (ref.R + ref.L * s) + ref.KT * ref.KV))
    a, b = 2 / ref.TICK * (1 - A) / (1 + A), 2 / ref.TICK * (1 + B) / (1 - B)
    lead = K * (1 + A) / (1 - B) * ref.VOLTS * ref.COUNTS * (s + a) / (s + b)
    late = ref.TAU + ref.TICK / 2
    by_pade = control.margin(lead * motor * (2 - late * s) / (2 + late * s))[0]
    assert abs(by_pade / gain - 1) > 0.03
    ours = loop_margins(axis_loop(load_machine("stitcher-rigid"), "X"), "continuous").raise_to
    assert ours == pytest.approx(gain, rel=1e-5)


def integrator(k: float, delay_s: float, *, tick: float = 1e-3) -> Loop:
    """x' = u(t - delay), u = k (r - x), its hold left out."""
    plant = StateSpace(
        A=np.zeros((1, 1)), B=np.ones((1, 1)), C=np.ones((3, 1)), D=np.zeros((3, 1)),
        delay_s=np.array([delay_s]), states=("x",), inputs=("drives.x",),
        outputs=("sensors.x", "X.measured", "X.load"),
    )  # fmt: skip
    digital = DigitalFilter(
        numerator=np.array([k, 0.0, 0.0]), denominator=np.array([1.0, 0.0, 0.0]),
        continuous_numerator=np.array([k]), continuous_denominator=np.array([1.0]), period_s=tick,
    )  # fmt: skip
    return Loop(
        axis="X", plant=plant, controllers=("x",), sensors=("sensors.x",), filters=(digital,),
        index=0, counts_per_unit=1.0, hold=False,
    )  # fmt: skip


@pytest.mark.parametrize("k_delay", [0.1, 1 / np.e, 0.8, 1.4, 1.7, 3.0])
def test_delayed_poles_are_lambert_w(k_delay):
    """x' = -k x(t - d) has the poles W_n(-k d) / d: every one within reach, and no others."""
    delay = 4e-3
    loop = integrator(k_delay / delay, delay)
    within = 12 / delay
    found = closed_poles(loop, within_rad_s=within)
    exact = np.concatenate([[lambertw(-k_delay, n) / delay] for n in range(-8, 8)]).ravel()
    exact = exact[np.abs(exact) < within]
    for pole in exact:
        # A double root (k d = 1/e) is found to half the digits.
        assert np.abs(found - pole).min() < (
            1e-3 if abs(k_delay * np.e - 1) < 1e-6 else 1e-8
        ) * abs(pole)
    for pole in found:
        assert abs(pole + k_delay / delay * np.exp(-pole * delay)) < 1e-4 * abs(pole)
    assert unstable_count(loop) == np.count_nonzero(exact.real > 0)
    critical = loop_margins(loop, "continuous").phase_crossovers[0].gain_factor
    assert critical * k_delay == pytest.approx(np.pi / 2, rel=1e-9)


@pytest.mark.parametrize("name", ["stitcher", "stitcher+head-feedback", "stitcher-rigid"])
def test_three_ways_to_stability_agree(name):
    """Eigenvalues of the sampled loop, exact continuous poles, and the count from the response."""
    for axis, loop in axis_loops(load_machine(name)).items():
        critical = loop_margins(loop, "continuous").phase_crossovers
        lowest = min(c.gain_factor for c in critical)
        for gain in (0.9 * lowest, 1.1 * lowest):
            scaled = Loop(
                axis=axis, plant=loop.plant, controllers=loop.controllers, sensors=loop.sensors,
                filters=tuple(_scaled(f, gain) for f in loop.filters), index=loop.index,
                counts_per_unit=loop.counts_per_unit,
            )  # fmt: skip
            poles = closed_poles(loop, gain)
            unstable = int(np.count_nonzero(poles.real > 0))
            assert unstable == (2 if gain > lowest else 0)
            assert unstable_count(scaled) == unstable
            assert (loop.closed(gain).spectral_radius > 1) == (unstable > 0)
            z = loop.closed(gain).eigenvalues()
            s = np.log(z[np.abs(z) > 0.5]) / loop.period_s
            assert np.abs(s - poles[0]).min() < 1e-3 * abs(poles[0])


def _scaled(digital: DigitalFilter, gain: float) -> DigitalFilter:
    return DigitalFilter(
        numerator=gain * digital.numerator, denominator=digital.denominator,
        continuous_numerator=gain * digital.continuous_numerator,
        continuous_denominator=digital.continuous_denominator, period_s=digital.period_s,
    )  # fmt: skip


def test_shared_bodies_see_the_other_loop_closed():
    """Two motors on one mass: L of one with the other closed, from the 2 x 2 determinant."""
    A = np.array(
        [[0.0, 1.0, 0, 0], [-900.0, -6.0, 500.0, 0], [0, 0, 0, 1.0], [400.0, 0, -800.0, -9.0]]
    )
    B = np.array([[0.0, 0], [2.0, 0], [0, 0], [0, 3.0]])
    C = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    plant = StateSpace(
        A=A, B=B, C=C, D=np.zeros((2, 2)), delay_s=np.array([2e-3, 5e-3]),
        states=("a", "a'", "b", "b'"), inputs=("drives.a", "drives.b"),
        outputs=("sensors.a", "sensors.b"),
    )  # fmt: skip
    one, two = (integrator(k, 0.0).filters[0] for k in (90.0, 40.0))
    loop = Loop(
        axis="A", plant=plant, controllers=("a", "b"), sensors=plant.outputs, filters=(one, two),
        index=0, counts_per_unit=1.0, hold=False,
    )  # fmt: skip
    omega = np.array([1.0, 25.0, 33.0])
    G = plant.response(omega)
    whole = np.linalg.det(np.eye(2) + G * np.array([90.0, 40.0]))
    other = 1 + 40.0 * G[:, 1, 1]
    np.testing.assert_allclose(1 + loop.response(omega, "continuous"), whole / other, rtol=1e-10)
    poles = closed_poles(loop)
    for pole in poles[:4]:
        K = np.diag([90.0 * np.exp(-2e-3 * pole), 40.0 * np.exp(-5e-3 * pole)])
        assert abs(np.linalg.det(pole * np.eye(4) - A + B @ K @ C)) < 1e-6 * abs(pole) ** 4
    assert (poles[0].real > 0) == (loop.closed().spectral_radius > 1)


def test_zeros_against_python_control():
    for name, output in (
        ("stitcher", "measured"),
        ("stitcher", "load"),
        ("stitcher-rigid", "load"),
    ):
        for axis, loop in axis_loops(load_machine(name)).items():
            own = loop.plant.select([loop.plant.inputs[0]], [f"{axis}.{output}"])
            p = ref.X if axis == "X" else ref.Y
            expected: list[complex] = []
            if name == "stitcher" and "Mf" in p:
                expected += list(np.roots([p["Mf"], p["bf"], p["kf"]])) if output == "load" else []
            if name == "stitcher" and output == "measured":
                head, belt = np.array([p["M"], p["b"], 0]), np.array([p["k"]])
                frame = np.array([p["Mf"], p["bf"], p["kf"]]) if "Mf" in p else np.array([1.0])
                poly = np.polymul(np.polyadd(head, belt), frame)
                if "Mf" in p:
                    poly = np.polyadd(poly, np.polymul(head, belt))
                expected += list(np.roots(poly))
            got = zeros_of(own)
            assert len(got) == len(expected)
            for zero in expected:
                assert np.abs(got - zero).min() < 1e-6 * abs(zero)


def test_unstable_loop_is_named_with_its_margin():
    found = unstable_loops(load_machine("stitcher+head-feedback"))
    assert len(found) == 2
    assert "axis X: the loop is UNSTABLE (2 poles); it is at its limit at 0.623 times" in found[0]
    assert unstable_loops(load_machine("stitcher")) == []
    analysis = analyse_axis(load_machine("stitcher+head-feedback"), "X")
    assert not analysis.stable and analysis.steps == {}
    assert analysis.as_json()["gain_margin"] == pytest.approx(0.623, abs=1e-3)


def test_a_clock_a_thousand_times_too_slow_is_told_at_once(tmp_path, monkeypatch):
    """5 s for 5 ms: half a tick of dead time turns the continuous response a million times.

    The sampled loop's stability needs none of it. The test counts the evaluated frequencies, of
    which the three axes once took 400 000 each.
    """
    slow = tmp_path / "slow.toml"
    slow.write_text('base = "lathe-winder"\n[clocks]\nservo = "5 s exact, assumed"\n')
    looked_at = []

    def counted(*arguments):
        grid = refined_grid(*arguments)
        looked_at.append(len(grid))
        return grid

    monkeypatch.setattr(margins, "refined_grid", counted)
    found = unstable_loops(load_machine(slow))
    assert [sentence.partition(" (")[0] for sentence in found] == [
        f"axis {axis}: the loop is UNSTABLE" for axis in "AXY"
    ]
    assert 0 < sum(looked_at) < 10_000


def test_locus_crosses_where_the_margin_says():
    loop = axis_loop(load_machine("stitcher+head-feedback"), "X")
    locus = root_locus(loop, np.array([0.6, 0.62, 0.626, 0.65]))
    gain, omega = locus.critical[0]
    worst = [p.real.max() for p in locus.poles]
    assert worst[1] < 0 < worst[2] and 0.62 < gain < 0.626
    at = closed_poles(loop, gain)[0]
    assert abs(at.real) < 1e-6 * abs(at) and abs(at.imag) == pytest.approx(omega, rel=1e-9)


def test_wrong_questions_are_refused():
    with pytest.raises(OptionError, match="no axis 'Q'"):
        axis_loop(load_machine("stitcher"), "Q")
    with pytest.raises(MachineError, match="does not move"):
        zeros_of(
            StateSpace(
                A=np.zeros((1, 1)),
                B=np.zeros((1, 1)),
                C=np.ones((1, 1)),
                D=np.zeros((1, 1)),
                delay_s=np.zeros(1),
                states=("x",),
                inputs=("drives.x",),
                outputs=("sensors.x",),
            )
        )


@pytest.mark.parametrize("gain", [0.01, 0.5, 2.0, 4.5, 20.0])
def test_a_velocity_loop_is_stable_though_nothing_holds_its_position(gain, tmp_path):
    """K (1 - 1/z) cancels the integrator of the position: the other poles decide.

    Eigenvalues of the sampled loop without the one at 1, which rounding puts on either side.
    """
    path = tmp_path / "velocity.toml"
    path.write_text(
        'base = "stitcher"\nname = "velocity"\n[controllers.x]\nkind = "proportional-velocity"\n'
        f'gain = "{gain} dac/count exact, assumed"\nzero = "none"\npole = "none"\n'
    )
    machine = load_machine(path)
    loop = axis_loop(machine, "X")
    z = loop.closed().eigenvalues()
    at_one = np.argmin(np.abs(z - 1.0))
    assert abs(z[at_one] - 1.0) < 1e-11
    rest = np.abs(np.delete(z, at_one))
    assert unstable_count(loop) == np.count_nonzero(rest > 1.0)
    assert loop_figures(loop, "sampled").unstable == np.count_nonzero(rest > 1.0)
    assert len(unstable_loops(machine)) == (1 if rest.max() > 1.0 else 0)


def test_the_phase_margin_of_a_conditionally_stable_loop_is_the_nearest():
    """Ten rad/s and a mode that dead time turns by half a circle; python-control chooses alike.

    The mode crosses at some -80 and +80 degrees, the loop at 72: the smallest number is not the
    margin. The bar is 0.1 deg: python-control takes the nearest of its frequencies.
    """
    import control  # with half of matplotlib: for one worker alone

    w0, zeta = 100.0, 0.01

    def response(omega):
        s = 1j * np.asarray(omega)
        mode = w0**2 / (s**2 + 2 * zeta * w0 * s + w0**2)
        return 10.0 / s * mode * np.exp(-s * np.pi / w0)

    grid = np.geomspace(1.0, 1e3, 20_000)
    margins = margins_of(response, grid)
    assert min(c.phase_margin_deg for c in margins.gain_crossovers) < -45
    found = response(grid)
    pm = control.stability_margins((np.abs(found), np.degrees(np.unwrap(np.angle(found))), grid))[1]
    assert margins.worst_phase.phase_margin_deg == pytest.approx(pm, abs=0.1)
    assert 60 < pm < 75


def test_thousands_of_crossings_are_closed_in_on_together() -> None:
    """K exp(-i w T) / (i w) crosses -180 degrees at w T = pi/2 + 2 pi n, and 1 at w = K.

    A gain typed a thousand times too large gives thousands; one search for each took minutes.
    """
    gain, dead_s, calls = 1e5, 0.02, 0

    def response(omega: FloatArray) -> ComplexArray:
        nonlocal calls
        calls += 1
        return np.asarray(gain * np.exp(-1j * omega * dead_s) / (1j * omega))

    found = margins_of(response, np.geomspace(1.0, 5e5, 400_001))
    turns = np.arange(len(found.phase_crossovers))
    at = np.array([c.omega_rad_s for c in found.phase_crossovers])
    assert len(at) == 1592  # 5e5 x 0.02 / (2 pi) = 1591.5
    np.testing.assert_allclose(at, (np.pi / 2 + 2 * np.pi * turns) / dead_s, rtol=1e-10)
    factors = [c.gain_factor for c in found.phase_crossovers]
    np.testing.assert_allclose(factors, at / gain, rtol=1e-12)
    assert [c.omega_rad_s for c in found.gain_crossovers] == pytest.approx([gain], rel=1e-10)
    assert calls < 150  # each call evaluates thousands of frequencies


def test_a_loop_whose_response_is_rounding_has_no_crossover_there():
    """1/s^5 with noise of 1e-12: where only the noise is left, no grid is fine enough.

    The phase of 1/s^5 is -90 degrees at every frequency; that of the noise passes -180 between any
    two.
    """
    random = np.random.default_rng(3)

    def response(omega: FloatArray) -> ComplexArray:
        noise = 1e-12 * (random.normal(size=len(omega)) + 1j * random.normal(size=len(omega)))
        return np.asarray((1j * omega) ** -5.0 + noise)

    def silent(omega: FloatArray) -> ComplexArray:
        return np.asarray(np.where(omega < 1e3, response(omega), 0.0))

    for found in (response, silent):
        grid = refined_grid(found, 0.1, 1e6)
        assert len(grid) < 20_000
        margins = margins_of(found, grid)
        assert [c.omega_rad_s for c in margins.gain_crossovers] == [pytest.approx(1.0, rel=1e-9)]
        assert not margins.phase_crossovers
