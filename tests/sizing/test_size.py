"""The calculator, compared with the printed figures of both theses, and with integration."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

from threadline.errors import OptionError
from threadline.sizing import PROFILES, Demands, SpeedProfile, size

IN = 0.0254
STITCHER_X = {
    "needle_speed_hz": 75.0,
    "stitch_length_m": 0.1 * IN,
    "placement_m": 0.02 * IN,
    "load_mass_kg": 111.0,
    "pulley_radius_m": 0.029,
    "gear_ratio": 6.0,
    "motor_inertia_kg_m2": 4.75e-4,
    "motor_damping_n_m_s": 0.24,
    "torque_constant_n_m_a": 0.5,
    "back_emf_v_s": 60 / 1000 * 60 / (2 * math.pi),
    "resistance_ohm": 0.8,
    "current_limit_a": 27.0,
    "encoder_lines": 2000.0,
}


def speed_at(profile: SpeedProfile, t: float) -> float:
    """Return the speed over unit time for unit distance, drawn by hand."""
    if profile.name == "parabolic":
        return 6 * t * (1 - t)
    ramp = 0.5 if profile.name == "triangular" else profile.ramp
    return min(t / ramp, 1.0, (1 - t) / ramp) / (1 - ramp)


def test_printed_efficiencies() -> None:
    """Figure 6-3: 0.75, 0.889 and 1."""
    found = {name: SpeedProfile(name=name).efficiency for name in PROFILES}
    assert found == pytest.approx({"triangular": 0.75, "trapezoidal": 8 / 9, "parabolic": 1.0})


def test_a_third_is_the_best_trapezoid() -> None:
    best = minimize_scalar(
        lambda r: -SpeedProfile(name="trapezoidal", ramp=r).efficiency,
        bounds=(0.05, 0.5),
        method="bounded",
    )
    assert best.x == pytest.approx(1 / 3, abs=1e-4)


@given(
    st.sampled_from(PROFILES), st.floats(0.05, 0.5), st.floats(0.01, 5), st.floats(0.02, 3),
    st.floats(0, 2), st.floats(0, 3), st.floats(0, 2),
)  # fmt: skip
def test_torques_against_integration(
    name: str,
    ramp: float,
    distance: float,
    time: float,
    damping: float,
    friction: float,
    dwell: float,
) -> None:
    """Quadrature of the torque over the move; accelerations by differences."""
    profile = SpeedProfile(name=name, ramp=ramp)
    inertia = 0.3
    h = 1e-7

    def torque(u: float) -> float:
        acceleration = (speed_at(profile, u + h) - speed_at(profile, u - h)) / (2 * h)
        v = speed_at(profile, u) * distance / time
        return inertia * acceleration * distance / time**2 + damping * v + friction

    breaks = (0.0, 1.0) if name == "parabolic" else (0.0, 0.5, 1.0)
    if name == "trapezoidal":
        breaks = (0.0, ramp, 1 - ramp, 1.0)
    square = 0.0
    peak = 0.0
    for a, b in itertools.pairwise(breaks):
        if b - a < 1e-5:
            continue
        square += quad(lambda u: torque(u) ** 2, a + 2 * h, b - 2 * h, epsrel=1e-9)[0]
        peak = max(peak, *(torque(u) for u in np.linspace(a + 2 * h, b - 2 * h, 801)))
    rms = math.sqrt(square * time / (time + dwell))
    load = (distance, time, inertia, damping, friction)
    assert profile.rms_torque(*load, dwell_s=dwell) == pytest.approx(rms, rel=1e-4)
    assert profile.peak_torque(*load) == pytest.approx(peak, rel=1e-4)
    assert quad(lambda u: speed_at(profile, u), 0, 1)[0] == pytest.approx(1.0, rel=1e-6)


def test_stitcher_as_printed() -> None:
    result = size(Demands(**STITCHER_X))

    assert result["head speed"].value / IN == pytest.approx(7.5, rel=1e-12)
    assert result["ramp acceleration"].value / IN == pytest.approx(281.25, rel=1e-12)
    # 546 is printed, which belongs to 7.86 in/s. At the text's 7.5 in/s it is 497.
    assert result["corner acceleration"].value / IN == pytest.approx(497.2, abs=0.05)
    assert result["acceleration"].value == result["corner acceleration"].value
    assert result["corner speed"].value == pytest.approx(result["head speed"].value, rel=1e-12)
    assert result["corner error"].value == pytest.approx(0.02 * IN, rel=1e-12)
    # 8000 counts a turn are 1273 a radian.
    assert result["encoder resolution"].value * 0.029 / 6 == pytest.approx(1273, abs=0.5)
    # 18.9 of 27 A go into the printed damping at sewing speed.
    assert result["cruise current"].value == pytest.approx(18.9, abs=0.05)
    assert any("cruising alone" in text for text in result.warnings)
    assert any("15 % apart" in text for text in result.warnings)


def test_546_belongs_to_a_faster_head() -> None:
    faster = {**STITCHER_X, "needle_speed_hz": 78.6}
    assert size(Demands(**faster))["corner acceleration"].value / IN == pytest.approx(546, abs=0.5)


def test_matched_ratio_takes_the_least_torque() -> None:
    """Pure acceleration: torque (J N/r + m r/N) a is least at the matched ratio."""
    result = size(Demands(**{**STITCHER_X, "gear_ratio": None}))

    def torque(ratio: float) -> float:
        return 4.75e-4 * ratio / 0.029 + 111 * 0.029 / ratio

    best = minimize_scalar(torque, bounds=(1, 60), method="bounded", options={"xatol": 1e-9})
    assert result["matched ratio"].value == pytest.approx(best.x, rel=1e-6)
    assert result["inertia ratio"].value == pytest.approx(1.0, rel=1e-12)
    # The stitcher's 6:1 is far from it: its load weighs 5.5 rotors.
    assert size(Demands(**STITCHER_X))["inertia ratio"].value == pytest.approx(5.46, abs=0.01)


def test_winder_as_printed_and_where_the_print_is_wrong() -> None:
    """The motor of section 6.3 on the carriage of section 4.4."""
    result = size(
        Demands(
            load_mass_kg=4.0,
            pulley_radius_m=11.94e-3,
            gear_ratio=1.0,
            motor_inertia_kg_m2=1.2e-4,
            torque_constant_n_m_a=0.082,
            back_emf_v_s=8.6e-3 * 60 / (2 * math.pi),
            resistance_ohm=0.4,
            encoder_lines=1000.0,
            speed_m_s=1.0,
            count_rate_limit_hz=100_000.0,
        )
    )

    # 55.358 counts a millimetre are printed; the printed radius gives 53.32.
    assert result["encoder resolution"].value * 1e-3 == pytest.approx(53.32, abs=0.005)
    # KM is printed as 11.0 ms; R J / (Kt Ke) of the printed constants is 7.1 ms.
    assert result["mechanical time constant"].value * 1e3 == pytest.approx(7.13, abs=0.01)
    assert not result.warnings  # Kt and Ke agree, and 53 320 counts/s can be followed


def test_mandrel_counts_erratum() -> None:
    """38/12 teeth make 35.18519 counts a degree; 35.18159 is printed."""
    result = size(
        Demands(load_mass_kg=1.0, pulley_radius_m=1.0, gear_ratio=38 / 12, encoder_lines=1000.0)
    )
    assert result["encoder resolution"].value * math.pi / 180 == pytest.approx(35.18519, abs=5e-6)


def test_move_lines_are_those_of_the_profile() -> None:
    result = size(
        Demands(**{**STITCHER_X, "move_m": 0.0635, "move_s": 0.4, "dwell_s": 0.1,
                   "profile": "triangular"})
    )  # fmt: skip
    inertia = 4.75e-4 + 111 * (0.029 / 6) ** 2
    angle = 0.0635 * 6 / 0.029
    assert result["move speed"].value == pytest.approx(2 * 0.0635 / 0.4)
    assert result["move acceleration"].value == pytest.approx(4 * 0.0635 / 0.16)
    assert result["move peak torque"].value == pytest.approx(
        inertia * 4 * angle / 0.16 + 0.24 * 2 * angle / 0.4
    )
    assert result["move rms current"].value == pytest.approx(result["move rms torque"].value / 0.5)


DRIVE = {
    "speed_m_s": 0.4,
    "acceleration_m_s2": 3.0,
    "load_mass_kg": 20.0,
    "load_damping_n_s_m": 30.0,
    "friction_n": 15.0,
    "pulley_radius_m": 0.02,
    "gear_ratio": 2.5,
    "motor_inertia_kg_m2": 2e-4,
    "motor_damping_n_m_s": 1e-3,
    "torque_constant_n_m_a": 0.1,
    "back_emf_v_s": 0.1,
    "resistance_ohm": 1.5,
}


def test_the_motor_against_the_forces_on_the_load() -> None:
    """Newton at the load and at the rotor, which turns by 125 rad for a metre of the load."""
    per_m = 2.5 / 0.02
    cruise = (30.0 * 0.4 + 15.0) / per_m + 1e-3 * 0.4 * per_m
    peak = cruise + 20.0 * 3.0 / per_m + 2e-4 * 3.0 * per_m
    result = size(Demands(**DRIVE))

    assert result["motor speed"].value == pytest.approx(0.4 * per_m, rel=1e-12)
    assert result["cruise torque"].value == pytest.approx(cruise, rel=1e-12)
    assert result["peak torque"].value == pytest.approx(peak, rel=1e-12)
    assert result["peak current"].value == pytest.approx(peak / 0.1, rel=1e-12)
    volts = 0.1 * 0.4 * per_m + 1.5 * peak / 0.1
    assert result["peak voltage"].value == pytest.approx(volts, rel=1e-12)

    # 100 mm in 0.5 s, a third of it at 0.3 m/s between two ramps, then a rest as long.
    moved = size(Demands(**DRIVE, move_m=0.1, move_s=0.5, dwell_s=0.5))
    inertia, damping = 2e-4 + 20.0 / per_m**2, 1e-3 + 30.0 / per_m**2
    turn, friction = 0.3 * per_m, 15.0 / per_m
    ramp = inertia * turn * 6.0  # the ramp takes a sixth of a second
    u = (np.arange(20_000) + 0.5) / 20_000
    up, down = ramp + damping * turn * u + friction, -ramp + damping * turn * u + friction
    square = (np.mean(up**2) + np.mean(down**2) + (damping * turn + friction) ** 2) / 3.0
    assert moved["move rms torque"].value == pytest.approx(math.sqrt(square / 2.0), rel=1e-6)


def test_an_amplifier_that_is_too_small_is_named_and_one_that_suffices_is_not() -> None:
    """The peak is 8.21 A, and 2.66 A are needed at full speed."""
    figures = size(Demands(**DRIVE))
    peak, cruise = figures["peak current"].value, figures["cruise current"].value
    assert cruise < 0.45 * peak
    for limit, warned in ((0.999 * peak, True), (1.001 * peak, False)):
        warnings = size(Demands(**DRIVE, current_limit_a=limit)).warnings
        assert any("the motion needs" in text for text in warnings) is warned
        assert not any("cruising alone" in text for text in warnings)
    for limit, warned in ((1.999 * cruise, True), (2.001 * cruise, False)):
        warnings = size(Demands(**DRIVE, current_limit_a=limit)).warnings
        assert any("cruising alone" in text for text in warnings) is warned


def test_size_takes_the_larger_acceleration_of_two_rules() -> None:
    """With a loose placement limit, the ramp of two stitches needs more."""
    result = size(Demands(**{**STITCHER_X, "placement_m": 0.2 * IN}))
    assert result["corner acceleration"].value < result["ramp acceleration"].value
    assert result["acceleration"].value == result["ramp acceleration"].value


def test_every_line_says_where_it_comes_from() -> None:
    result = size(Demands(**STITCHER_X, move_m=0.1, move_s=0.5, count_rate_limit_hz=1e4))

    names = [line.name for line in result.lines]
    assert len(set(names)) == len(names) >= 18
    for line in result.lines:
        assert line.formula
        assert line.source
        assert math.isfinite(line.value)
    assert any("counts/s" in text for text in result.warnings)
    with pytest.raises(KeyError, match="head speed"):
        result["nonsense"]


@pytest.mark.parametrize(
    ("demands", "text"),
    [
        ({"needle_speed_hz": -1.0}, "above 0"),
        ({"stitch_length_m": math.nan}, "finite"),
        ({"stitch_length_m": 1e300}, "it must be from 1e-15 to 1e15"),
        ({"resistance_ohm": 1e-300}, "it must be from 1e-15 to 1e15"),
        ({"turn_rad": 4.0}, "at most pi"),
        ({"needle_speed_hz": 1.0, "stitch_length_m": 1.0, "speed_m_s": 1.0}, "given twice"),
    ],
)
def test_nonsense_is_refused(demands: dict[str, float], text: str) -> None:
    with pytest.raises(OptionError, match=text):
        Demands(**demands)


def test_nothing_from_nothing() -> None:
    with pytest.raises(OptionError, match="not enough for any result"):
        size(Demands())
    with pytest.raises(OptionError, match="no profile"):
        size(Demands(move_m=1.0, move_s=1.0, profile="square"))


def test_the_torque_margin_is_that_of_a_frame_by_hand() -> None:
    """1150 kg by a trapezoid of thirds: 4.5 x 16.5 mm / (120 ms)^2 = 5.156 m/s^2, 5.93 kN.

    On a pinion of 20 mm that is 118.6 N m; a servo of 712 N m has 6 times that.
    """
    frame = {
        "load_mass_kg": 1150.0,
        "pulley_radius_m": 0.02,
        "gear_ratio": 1.0,
        "motor_inertia_kg_m2": 1e-9,
        "move_m": 0.0165,
        "move_s": 0.12,
        "motor_torque_n_m": 712.0,
    }
    needed = 1150.0 * 4.5 * 0.0165 / 0.12**2 * 0.02
    for expected, warned in ((6.0, 0), (10.0, 1)):
        found = size(Demands(**frame, torque_margin=expected))
        (margin,) = (line.value for line in found.lines if line.name == "move torque margin")
        assert margin == pytest.approx(712.0 / needed, rel=1e-8)  # the rotor's share is 2e-9
        assert len(found.warnings) == warned
    assert "required are 10 times: 1186 N m" in found.warnings[0]
