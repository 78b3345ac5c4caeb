import numpy as np
import pytest
from scipy.integrate import quad

from threadline.errors import OptionError
from threadline.laws import LAWS, law, trapezoid, trapezoidal_acceleration

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
}


def test_the_table_is_complete():
    assert set(LAWS) == set(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_peaks_of_a_dense_scan_are_the_published_ones(name):
    """200 001 instants: a smooth peak is met to (step)^2, an edge peak exactly."""
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
    corners = [1 / 8, 1 / 3, 3 / 8, 1 / 2, 5 / 8, 2 / 3, 7 / 8]
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
