import numpy as np
import pytest
from scipy.integrate import quad

from threadline.errors import OptionError
from threadline.motion.laws import (
    LAWS,
    Pieces,
    extremes,
    harmonic,
    jerk_limited,
    law,
    measured_law,
    modified_constant_velocity,
    trapezoid,
    trapezoidal_acceleration,
)
from threadline.motion.shaping.designs import ShaperKind, design
from threadline.motion.shaping.shaped_law import shaped_law
from threadline.motion.shaping.types import FlexibleMode

# Published table, exact: Cv, Ca, Cj; None is infinite.
PI = np.pi
TABLE = {
    "double-parabola": (2, 4, None),
    "trapezoid": (1.5, 4.5, None),
    "cubic": (1.5, 6, None),
    "simple-harmonic": (PI / 2, PI**2 / 2, None),
    "cycloidal": (2, 2 * PI, 4 * PI**2),
    "modified-trapezoid": (2, 8 * PI / (PI + 2), 32 * PI**2 / (PI + 2)),
    "modified-sine": (4 * PI / (4 + PI), 4 * PI**2 / (4 + PI), 16 * PI**3 / (4 + PI)),
    "3-4-5": (15 / 8, 10 / np.sqrt(3), 60),
    "4-5-6-7": (35 / 16, 84 * np.sqrt(5) / 25, 52.5),
    "trapezoidal-acceleration": (2, 16 / 3, 128 / 3),
    # MCV50 of the tables of cam curves: 1.28, 8.01, 201.4.
    "modified-constant-velocity": (
        8 * PI / (5 * PI + 4),
        16 * PI**2 / (5 * PI + 4),
        128 * PI**3 / (5 * PI + 4),
    ),
    "5-6-7-8-9": (315 / 128, 9.371976218494105, 78.75),
    # Freudenstein 1-3: s = t - (27/28 sin 2 pi t + sin 6 pi t / 84) / 2 pi; 1-3-5 with 1125/1192,
    # 1/54 and 1/1250.
    "harmonic-3": (2, 2 * PI * 27 / 28 * 8 / 9, 4 * PI**2 * 27 / 28 * 4 / 3),
    "harmonic-5": (
        2,
        2 * PI * 1125 / 1192 * (1 - 1 / 6 + 1 / 50),
        4 * PI**2 * 1125 / 1192 * (1 + 1 / 2 + 1 / 10),
    ),
    # Seven equal phases.
    "jerk-limited": (7 / 4, 49 / 8, 343 / 8),
}
OTHERS = {
    "trapezoid:0.2": trapezoid(0.2),
    "harmonic:15": harmonic(15),
    "modified-constant-velocity:0": modified_constant_velocity(0.0),
    "jerk-limited:1,2,1.5,3,0.5,4,2": jerk_limited(1, 2, 1.5, 3, 0.5, 4, 2),
    "jerk-limited:1,0,1,0,3,0,3": jerk_limited(1, 0, 1, 0, 3, 0, 3),
}


def test_the_table_is_complete():
    assert set(LAWS) == set(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_peaks_of_a_dense_scan_are_the_published_ones(name):
    """200 001 instants: a smooth peak agrees to (step)^2, an edge peak exactly."""
    t = np.linspace(0, 1, 200_001)
    motion = law(name)
    for derivative, published in enumerate(TABLE[name], start=1):
        scanned = np.abs(motion(t, derivative)).max()
        if published is not None:
            assert scanned == pytest.approx(published, rel=1e-6)
    assert (motion.velocity, motion.acceleration, motion.jerk) == pytest.approx(TABLE[name])


@pytest.mark.parametrize("name", TABLE)
def test_each_derivative_is_the_slope_of_the_one_before(name):
    """scipy's quadrature of each derivative, split at the corners, gives the one below."""
    motion = law(name)
    corners = motion.edges[1:-1].tolist()
    for end in (0.45, 1.0):
        inner = [c for c in corners if c < end]
        for derivative in (1, 2):
            area, _ = quad(lambda t, d=derivative: motion(t, d)[0], 0, end, points=inner, limit=200)
            assert motion(end, derivative - 1)[0] == pytest.approx(area, abs=1e-9)
        if motion.jerk is not None:
            area, _ = quad(lambda t: motion(t, 3)[0], 0, end, points=inner, limit=200)
            assert motion(end, 2)[0] == pytest.approx(area, abs=1e-6)


@pytest.mark.parametrize("name", TABLE)
def test_rise_one_from_rest_to_rest(name):
    motion = law(name)
    t = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    assert motion(t) == pytest.approx([0, 0, 0.5, 1, 1], abs=1e-12)
    assert motion(np.array([-0.5, 0.0, 1.0, 1.5]), 1) == pytest.approx(0.0, abs=1e-12)
    rise = motion(np.linspace(0, 1, 10_001))
    assert np.all(np.diff(rise) >= 0)


def test_heat_is_least_for_the_cubic():
    """Closed forms of the integral of the squared acceleration: 12, 13.5, pi^4/8, 2 pi^2, 16."""
    assert law("cubic").efficiency == pytest.approx(1.0)
    assert law("trapezoid").efficiency == pytest.approx(12 / 13.5)
    assert law("simple-harmonic").efficiency == pytest.approx(12 / (PI**4 / 8))
    assert law("cycloidal").efficiency == pytest.approx(12 / (2 * PI**2))
    assert law("double-parabola").efficiency == pytest.approx(12 / 16)


def test_ramps_can_be_chosen():
    assert trapezoid(0.25).acceleration == pytest.approx(16 / 3)
    wide = trapezoidal_acceleration(0.25)
    assert (wide.acceleration, wide.jerk) == pytest.approx((8.0, 32.0))
    assert wide(np.array([0.5]), 1)[0] == pytest.approx(2.0)
    for wrong in (0.0, 0.6, float("nan")):
        with pytest.raises(ValueError, match="ramp"):
            trapezoid(wrong)
        with pytest.raises(ValueError, match="ramp"):
            trapezoidal_acceleration(wrong)


def test_unknown_law_names_the_nearest():
    with pytest.raises(OptionError, match="modified-sine"):
        law("modified-sin")


@pytest.mark.long(but=("modified-sine", "cycloidal", "jerk-limited:1,0,1,0,3,0,3"))
@pytest.mark.parametrize("name", [*TABLE, *OTHERS])
def test_the_inverse_meets_a_million_rises(name):
    """A rise in doubles has steps of 1.1e-16 below 1, and Cv of them belong to one of time."""
    motion = law(name)
    x = np.linspace(0.0, 1.0, 1_000_001)
    t = motion.inverse(x)
    assert np.abs(motion(t) - x).max() <= 1e-15
    assert np.all(np.diff(t) > 0) and t[0] == 0.0 and t[-1] == 1.0


@pytest.mark.parametrize("name", [*TABLE, *OTHERS])
def test_the_inverse_is_right_where_the_rise_is_flat(name):
    """Rises of 1e-18 and less: near rest the law is a power of time, and so is its inverse."""
    motion = law(name)
    x = np.array([1e-30, 1e-24, 1e-18, 1e-12])
    assert motion(motion.inverse(x)) == pytest.approx(x, rel=1e-13, abs=0)
    t = np.array([1e-9, 1e-6, 1e-4])
    slow, fast = motion.left(t), motion.left(2 * t)
    assert np.all(np.round(np.log2(fast / slow), 2) == np.round(np.log2(fast / slow)))


def test_polynomials_with_rational_coefficients_agree():
    """The published coefficients, in fractions, at 1/3 and 6/7."""
    from fractions import Fraction

    for name, coefficients in {
        "3-4-5": {3: 10, 4: -15, 5: 6},
        "4-5-6-7": {4: 35, 5: -84, 6: 70, 7: -20},
        "5-6-7-8-9": {5: 126, 6: -420, 7: 540, 8: -315, 9: 70},
    }.items():
        for at in (Fraction(1, 3), Fraction(6, 7)):
            exact = sum(c * at**k for k, c in coefficients.items())
            assert law(name)(float(at))[0] == pytest.approx(float(exact), rel=4e-16)


def test_freudenstein_has_his_coefficients():
    t = np.linspace(0, 1, 101)
    published = t - 1125 / 1192 / (2 * PI) * (
        np.sin(2 * PI * t) + np.sin(6 * PI * t) / 54 + np.sin(10 * PI * t) / 1250
    )
    assert harmonic(5)(t) == pytest.approx(published, abs=2e-16)
    spectrum = np.abs(np.fft.rfft(harmonic(15)(np.arange(256) / 256, 2)))
    assert spectrum[16:].max() < 1e-12 * spectrum.max() < spectrum[15]


def test_heat_is_exact_with_any_ramp():
    """12 / (2 ramp (top/ramp)^2) with top = 1 / (1 - ramp): 0.768 for 0.2."""
    assert trapezoid(0.2).efficiency == pytest.approx(0.768, rel=1e-14)
    assert trapezoid(0.37).efficiency == pytest.approx(12 * 0.37 * 0.63**2 / 2, rel=1e-14)


def test_free_ramps_need_not_mirror():
    shares = (1, 2, 1.5, 3, 0.5, 4, 2)
    motion = jerk_limited(*shares)
    edges = np.cumsum((0, *shares)) / sum(shares)
    jerks = motion(0.5 * (edges[1:] + edges[:-1]), 3)
    assert np.sign(np.round(jerks, 9)).tolist() == [1, 0, -1, 0, -1, 0, 1]
    for k in range(7):  # constant jerk integrates exactly
        step = edges[k + 1] - edges[k]
        gained = motion(edges[k + 1], 2)[0] - motion(edges[k], 2)[0]
        assert gained == pytest.approx(jerks[k] * step, abs=1e-12)
    assert motion.velocity == pytest.approx(motion(edges[3], 1)[0], rel=1e-14)


@pytest.mark.parametrize("name", [*TABLE, *OTHERS])
def test_peaks_found_from_the_form_alone_are_the_exact_ones(name):
    exact = law(name)
    found = measured_law("found", exact.form, exact.closing, exact.meets)
    assert (found.velocity, found.acceleration) == pytest.approx(
        (exact.velocity, exact.acceleration), rel=1e-13
    )
    assert found.jerk == (None if exact.jerk is None else pytest.approx(exact.jerk, rel=1e-12))


def test_a_law_that_goes_back_has_no_inverse():
    """s = 4 t^3 - 3 t^4 rises and stops; 27 t^2 / 2 - ... overshoots: both as one polynomial."""
    back = np.array([[0.0, 0.0, 9.0, -14.0, 6.0]])  # velocity 6 t (3 - 7 t + 4 t^2): below 0 at 0.9
    closing = np.array([[0.0, 0.0, -3.0, 10.0, -6.0]])
    motion = measured_law("over", Pieces(np.zeros(1), back), Pieces(np.zeros(1), closing))
    low, at, _, _ = extremes(motion, 1)
    assert low < 0 and 0.75 < at < 1
    with pytest.raises(OptionError, match="motion law 'over' goes back"):
        motion.inverse(0.5)
    for wrong in (-0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match="a rise must be in"):
            law("cubic").inverse(wrong)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("trapezoid:0.7", "ramp must be in"),
        ("trapezoid:0.1,0.2", "it takes one number"),
        ("trapezoid:x", "could not convert"),
        ("harmonic:4", "must be odd"),
        ("harmonic:nan", "must be odd"),
        ("harmonic:1e9", "must be odd"),
        ("modified-constant-velocity:1", "must be in"),
        ("jerk-limited:1,2", "seven shares"),
        ("jerk-limited:0,1,1,1,1,1,1", "need some time"),
        ("trapezoid:1e-300", "takes 1e-300 of the time, the least is 1e-07"),
        ("trapezoidal-acceleration:5e-324", "too small or too far apart"),
        ("jerk-limited:1,1e-9,1,1,1,1,1", "of the time, the least is"),
        ("jerk-limited:1e-320,1,1e8,1,1,1,1", "too small or too far apart"),
        ("modified-constant-velocity:0.9999999999999999", "of the time, the least is"),
        ("cubic:3", "unknown motion law"),
        ("spline:3", "unknown motion law"),
    ],
)
def test_wrong_numbers_of_a_family_are_refused(name, message):
    with pytest.raises(OptionError, match=message):
        law(name)


def test_ends_of_stretches_are_no_closer_than_they_can_be_told_apart():
    """A shaper of 42 ms in a window of 1e300 ms is one impulse."""
    plain = law("modified-sine")
    shaper = design(ShaperKind.ZV, FlexibleMode(12.0, 0.02))
    for window_s in (0.16, 1e3, 1e9, 1e297):
        made = shaped_law(plain, shaper, window_s)
        assert np.diff(made.edges).min() > 1e-9
        assert made.edges[0] == 0.0 and made.edges[-1] == 1.0
    t = np.linspace(0.0, 1.0, 101)
    assert made(t) == pytest.approx(plain(t), abs=1e-12)
