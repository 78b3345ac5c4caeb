"""The swing after laws: the printed table, an integrator, and laws made for a mode."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.dop853 import state_after
from tests.second_order import states_of
from threadline.base.arrays import FloatArray
from threadline.cli import law_mode
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.motion.laws import LAWS, Law, law
from threadline.motion.shaping import (
    Demand,
    FlexibleMode,
    MadeLaw,
    ShaperError,
    design,
    made_law,
    mode_law,
    outside,
    residual_m,
    ringing,
    shaped_windows,
    usual_jerk_m_s3,
)
from threadline.motion.shaping.shaped_law import law_named, shaped_law

MOVE, WINDOW, ZETA = 0.0165, 0.120, 0.02
# Residual amplitude, mm: 16.5 mm in 120 ms at 8, 12, 16, 20, 25 and 40 Hz, damping ratio 0.02.
PRINTED = {
    "trapezoid": (5.9, 0.46, 1.27, 0.64, 0.01, 0.14),
    "double-parabola": (6.8, 1.76, 0.03, 0.35, 0.62, 0.20),
    "simple-harmonic": (5.8, 0.43, 1.04, 0.22, 0.40, 0.12),
    "modified-trapezoid": (7.7, 2.58, 0.16, 0.05, 0.43, 0.02),
    "modified-sine": (7.1, 1.66, 0.71, 0.58, 0.23, 0.04),
    "4-5-6-7": (9.1, 4.14, 0.94, 0.24, 0.16, 0.03),
}
FREQUENCIES = (8.0, 12.0, 16.0, 20.0, 25.0, 40.0)


# The implicit Runge-Kutta method of Gauss of order 6 (Hairer, Norsett & Wanner, II.7, table 7.4).
ROOT = np.sqrt(15.0)
NODES = np.array([0.5 - ROOT / 10, 0.5, 0.5 + ROOT / 10])
WEIGHTS = np.array([5 / 18, 4 / 9, 5 / 18])
STAGES = np.array([
    [5 / 36, 2 / 9 - ROOT / 15, 5 / 36 - ROOT / 30],
    [5 / 36 + ROOT / 24, 2 / 9, 5 / 36 - ROOT / 24],
    [5 / 36 + ROOT / 30, 2 / 9 + ROOT / 15, 5 / 36],
])  # fmt: skip


def simulated(motion: Law, frequencies_hz: Sequence[float], window_s: float) -> FloatArray:
    """Return amplitudes after the move by Runge-Kutta steps of order 6, none across a corner.

    The steps have a fixed length, a twentieth of a radian of the fastest mode: one step is the same
    function of state and law for a whole stretch, and the law is evaluated for all its nodes at
    once.
    """
    omega = 2 * np.pi * np.asarray(frequencies_hz)
    mode = np.zeros((len(omega), 2, 2))
    mode[:, 0, 1], mode[:, 1, 0], mode[:, 1, 1] = 1.0, -(omega**2), -2 * ZETA * omega
    state = np.zeros((len(omega), 2, 1))
    for a, b in pairwise((motion.edges * window_s).tolist()):
        steps = int(np.ceil(omega.max() * (b - a) / 0.05))
        h = (b - a) / steps
        # At the nodes the slopes are k = mode (y + h STAGES k) - (0, base); y gains h WEIGHTS k.
        implicit = np.eye(6) - h * np.einsum("ij,fkl->fikjl", STAGES, mode).reshape(-1, 6, 6)
        of_state = np.linalg.solve(implicit, np.tile(mode, (1, 3, 1)))
        of_base = np.linalg.solve(implicit, np.kron(np.eye(3), [[0.0], [-1.0]]))
        total = h * np.kron(WEIGHTS, np.eye(2))
        turn, push = np.eye(2) + total @ of_state, total @ of_base
        t = a + h * (np.arange(steps)[:, None] + NODES)
        base = motion(t.ravel() / window_s, 2).reshape(t.shape) * MOVE / window_s**2
        for at_nodes in base:
            state = turn @ state + (push @ at_nodes)[:, :, None]
    damped = omega * np.sqrt(1 - ZETA**2)
    away, rate = state[:, 0, 0], state[:, 1, 0]
    return np.hypot(away, (rate + ZETA * omega * away) / damped)


def sampled(motion: Law, frequency_hz: float, window_s: float) -> float:
    """Return the amplitude after the move by matrix exponentials, for a law with many pieces.

    The acceleration counts as straight between 20,001 instants.
    """
    omega = 2 * np.pi * frequency_hz
    t = np.linspace(0.0, 1.0, 20_001)
    mode = np.array([[0.0, 1.0], [-(omega**2), -2 * ZETA * omega]]), np.array([0.0, -1.0])
    away, rate = states_of(*mode, motion(t, 2) * MOVE / window_s**2, window_s / 20_000)[-1]
    return float(np.hypot(away, (rate + ZETA * omega * away) / (omega * np.sqrt(1 - ZETA**2))))


@pytest.mark.parametrize("name", PRINTED)
def test_the_printed_table_is_met(name: str) -> None:
    """To 0.01 mm, or 1 % where two digits are printed."""
    for f, printed in zip(FREQUENCIES, PRINTED[name], strict=True):
        found = 1e3 * residual_m(law(name), FlexibleMode(f, ZETA), MOVE, np.array([WINDOW]))[0]
        assert abs(found - printed) <= max(0.01, 0.01 * printed), (f, found, printed)


def test_the_integrator_agrees_with_scipys() -> None:
    """DOP853, restarted at each corner of the law."""
    motion, omega = law("modified-sine"), 2 * np.pi * 12.0
    state = np.zeros(2)
    for a, b in pairwise((motion.edges * WINDOW).tolist()):

        def slope(t: float, y: FloatArray, a: float = a) -> list[float]:
            base = float(motion((a + t) / WINDOW, 2)[0]) * MOVE / WINDOW**2
            return [y[1], -base - 2 * ZETA * omega * y[1] - omega**2 * y[0]]

        state = state_after(slope, state, b - a, rtol=1e-11, atol=1e-14)
    away, rate = state
    left = np.hypot(away, (rate + ZETA * omega * away) / (omega * np.sqrt(1 - ZETA**2)))
    assert simulated(motion, [12.0], WINDOW)[0] == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_an_independent_integrator_agrees(name: str) -> None:
    for f, left in zip((12.0, 40.0), simulated(law(name), (12.0, 40.0), WINDOW), strict=True):
        found = residual_m(law(name), FlexibleMode(f, ZETA), MOVE, np.array([WINDOW]))[0]
        assert found == pytest.approx(left, rel=1e-6, abs=1e-12)
        assert sampled(law(name), f, WINDOW) == pytest.approx(left, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "frequency", "printed_ms"),
    [("modified-sine", 12, 471), ("modified-sine", 20, 283), ("cycloidal", 12, 318),
     ("cycloidal", 20, 191)],
)  # fmt: skip
def test_shortest_windows_for_every_longer_one(
    name: str, frequency: float, printed_ms: float
) -> None:
    """The printed windows to 0.5 %; every longer window of a dense scan is still."""
    mode = FlexibleMode(frequency, ZETA)
    found = ringing(law(name), mode, MOVE, WINDOW, residual=5e-5, acceleration=6.33)
    assert found.window_s == pytest.approx(1e-3 * printed_ms, rel=5e-3)
    longer = found.window_s * np.linspace(1.0, 3.0, 4001)
    assert residual_m(law(name), mode, MOVE, longer).max() <= 5e-5 * (1 + 1e-9)
    assert residual_m(law(name), mode, MOVE, np.array([0.999 * found.window_s]))[0] > 5e-5
    scanned = residual_m(law(name), mode, MOVE, np.linspace(WINDOW, 1.0, 20_001)).max()
    assert found.worst_m == pytest.approx(scanned, rel=1e-4)


def demand(frequency: float, band: float = 0.1) -> Demand:
    return Demand(
        mode=FlexibleMode(frequency, ZETA), band=band, move_m=MOVE, residual_m=5e-5,
        acceleration_m_s2=6.33, jerk_m_s3=usual_jerk_m_s3(MOVE, 6.33),
    )  # fmt: skip


@cache
def made_once(asked: Demand) -> MadeLaw:
    """Return the law for a demand: it takes two seconds, so only requested ones are made."""
    return made_law(asked)


@pytest.mark.long(but="20.0-119")
@pytest.mark.parametrize(
    ("frequency", "most_ms"), [(12.0, 171), (16.0, 135), (20.0, 119), (25.0, 120)]
)
def test_a_law_made_for_the_mode_is_short_and_still(frequency: float, most_ms: float) -> None:
    """The windows of a quick study; limits by a dense scan, residuals by another integrator."""
    one = made_once(demand(frequency))
    assert 1e3 * one.window_s <= most_ms
    assert one.demand.rigid_s <= one.time_optimal_s <= one.free_levels_s <= one.window_s
    t = np.linspace(0, 1, 50_001)
    for derivative, limit in ((2, 6.33), (3, one.demand.jerk_m_s3)):
        peak = np.abs(one.law(t, derivative)).max() * MOVE / one.window_s**derivative
        assert peak <= 1.0005 * limit
    band = frequency * np.linspace(0.9, 1.1, 7)
    assert (simulated(one.law, band, one.window_s) <= 5e-5).all()
    assert np.abs(one.law(one.law.inverse(t)) - t).max() <= 1e-15


def test_time_optimal_windows_are_the_printed_ones() -> None:
    """113 and 102 ms to a grid of 160 levels; less is possible only with a rigid machine."""
    assert 1e3 * made_once(demand(12.0)).time_optimal_s == pytest.approx(113, abs=0.6)
    assert 1e3 * made_once(demand(20.0)).time_optimal_s == pytest.approx(102, abs=0.6)


def test_a_made_law_is_a_notch() -> None:
    one = made_once(demand(12.0))
    inside = outside(one, np.linspace(0.9, 1.1, 41))
    assert inside.max() <= 5e-5
    below, above = outside(one, np.array([0.8, 2.0]))
    assert below > 10 * 5e-5 and above > 10 * 5e-5
    assert below == pytest.approx(simulated(one.law, [9.6], one.window_s)[0], rel=1e-5)


def test_an_impossible_demand_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A demand that nine frequencies of the band cannot meet is not met at 161 either."""
    monkeypatch.setattr(mode_law, "MOST_FREQUENCIES", 9)
    with pytest.raises(ShaperError, match="no window up to"):
        made_law(
            Demand(
                mode=FlexibleMode(12.0, 0.0),
                band=0.99,
                move_m=1.0,
                residual_m=1e-3,
                acceleration_m_s2=1e3,
                jerk_m_s3=1e6,
            )
        )
    for wrong in (
        {"residual_m": 0.0},
        {"residual_m": 1e-9},
        {"band": 1.0},
        {"acceleration_m_s2": -1.0},
    ):
        values = {
            "mode": FlexibleMode(12.0), "band": 0.1, "move_m": MOVE, "residual_m": 5e-5,
            "acceleration_m_s2": 6.33, "jerk_m_s3": 1e3,
        } | wrong  # fmt: skip
        with pytest.raises(OptionError, match="law for a mode"):
            Demand(**values)


def test_a_shaped_law_is_one_law() -> None:
    """Superposed by hand; its inverse; the printed windows of modified sine + EI, +-20 %."""
    mode = FlexibleMode(12.0, ZETA)
    shaper = design("ei", mode)
    one = shaped_law(law("modified-sine"), shaper, 0.242)
    own = 0.242 - shaper.duration_s
    t = np.linspace(0, 0.242, 2001)
    by_hand = sum(
        a * law("modified-sine")((t - d) / own)
        for a, d in zip(shaper.amplitudes, shaper.times_s, strict=True)
    )
    assert one(t / 0.242) == pytest.approx(by_hand, abs=1e-14)
    x = np.linspace(0, 1, 100_001)
    assert np.abs(one(one.inverse(x)) - x).max() <= 1e-15
    at = residual_m(one, mode, MOVE, np.array([0.242]))[0]
    assert at == pytest.approx(simulated(one, [12.0], 0.242)[0], rel=1e-6)
    with pytest.raises(OptionError, match="the shaper ei takes"):
        shaped_law(law("cubic"), shaper, 0.08)
    for frequency, printed in ((12.0, 242), (20.0, 145)):
        windows = shaped_windows(law("modified-sine"), demand(frequency, 0.2))
        ei = next(w for w in windows if w.law.name.startswith("modified-sine*ei:"))
        assert 1e3 * ei.window_s == pytest.approx(printed, abs=1.5)


def ran(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(["law", *arguments])
    out, err = capsys.readouterr()
    return caught.value.code, out, err


MODE = ("--mode", "12Hz", "--damping", "0.02", "--move", "16.5 mm", "--time", "120 ms")
MAKE = ("--limit", "6.33 m/s^2", "--residual", "0.05 mm", "--band", "0.1")


def test_the_command_ranks_and_makes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The best comes first; modified sine needs 6.33 m/s^2 and 6.3 kN a tonne."""
    asked = []

    def made(expected: Demand, progress: Callable[[str, float], None]) -> MadeLaw:
        progress("law for the mode", 0.5)
        asked.append(expected)
        return made_once(expected)

    monkeypatch.setattr(law_mode, "made_law", made)
    file, folder = tmp_path / "made.csv", tmp_path / "report"
    code, out, _ = ran(capsys, *MODE, *MAKE, "--out", str(file), "--report", str(folder), "--json")
    content = json.loads(out)
    assert code == 0
    assert asked == [demand(12.0)]
    residuals = [each["residual_m"] for each in content["laws"]]
    assert residuals == sorted(residuals) and len(residuals) == len(LAWS)
    sine = next(each for each in content["laws"] if each["name"] == "modified-sine")
    assert sine["residual_m"] == pytest.approx(1.66e-3, abs=1e-5)
    assert sine["velocity_m_s"] == pytest.approx(0.242, rel=5e-3)
    assert sine["acceleration_m_s2"] == pytest.approx(6.33, rel=1e-3)
    assert sine["jerk_m_s3"] == pytest.approx(663, rel=1e-3)
    assert sine["force_n"] == pytest.approx(6330, rel=1e-3)
    assert content["made"]["window_s"] <= 0.171
    assert "notch" in content["made"]["warning"]
    for name in ("law.html", "law.pdf", "law-laws.svg", "law-residual.png"):
        assert (folder / name).stat().st_size > 1000
    read = law(str(file))
    assert read.acceleration == pytest.approx(content["made"]["Ca"], rel=1e-6)
    assert sampled(read, 12.0, content["made"]["window_s"]) <= 5e-5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--mode", "0Hz", *MODE[2:]), "--mode '0Hz': a frequency must be greater than 0 Hz"),
        ((*MODE, "--damping", "2"), "--damping 2: a damping ratio must be from 0 to below 0.3"),
        ((*MODE, "--damping", "nan"), "--damping 'nan': 'nan' is not a number"),
        (("--mode", "12Hz"), "needs the move"),
        (MODE[2:], "--move needs a mode"),
        ((*MODE[:6], "--time", "0 s"), "--time '0 s' must be greater than 0"),
        ((*MODE, "--limit", "6 m/s^2"), "--limit makes a law"),
        ((*MODE, "--band", "0.1"), "--band needs a law to be made"),
        ((*MODE, "--mass", "0 kg"), "--mass '0 kg' must be greater than 0"),
        ((*MODE, "--residual", "0 mm"), "--residual '0 mm' must be greater than 0"),
        ((*MODE, "--residual", "1e-9 mm"), "is reached for certain only after"),
        ((*MODE[:6], "--time", "1e-300 s"), "periods of the mode, it must be from"),
        ((*MODE[:6], "--time", "1e300 s"), "periods of the mode, it must be from"),
        ((*MODE[:4], "--move", "1e300 m", "--time", "1 s"), "the move must be from"),
        ((*MODE, *MAKE[2:], "--limit", "1e300 m/s^2"), "periods of the mode; it must be from"),
        ((*MODE, *MAKE[2:], "--limit", "1e-9 m/s^2"), "periods of the mode; it must be from"),
        (("trapezoid:9",), "ramp must be in"),
        (("none.csv",), "cannot read"),
        (("--out", "x.csv"), "is for one law"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = ran(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in err and err.count("\n") == 1


def test_the_name_of_a_shaped_law_makes_it_again() -> None:
    """The printed name can be typed: the same rise, with the found value at the mode."""
    asked = demand(12.0, 0.1)
    for one in shaped_windows(law("modified-sine"), asked):
        again = law_named(one.law.name)
        t = np.linspace(0.0, 1.0, 1001)
        assert np.abs(again(t) - one.law(t)).max() <= 1e-12
        assert again.name == one.law.name
        left = residual_m(again, asked.mode, MOVE, np.array([one.window_s]))[0]
        assert left <= asked.residual_m * (1 + 1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("modified-sine*zv:12Hz", "does not say its window"),
        ("modified-sine*zv:12Hz in soon", "in 160 ms"),
        ("modified-sine*zv:12Hz in -1 ms", "longer than 0"),
        ("modified-sine*zv:12Hz in 10 ms", "the shaper"),
        ("modified-sin*zv:12Hz in 160 ms", "unknown motion law 'modified-sin'"),
        ("cubic*X=zv:12Hz in 160 ms", "not one for each axis"),
        ("cubic*zw:12Hz in 160 ms", "zw"),
    ],
)
def test_a_shaped_law_that_cannot_be_is_told(text: str, message: str) -> None:
    with pytest.raises(OptionError) as caught:
        law_named(text)
    assert message in str(caught.value)
