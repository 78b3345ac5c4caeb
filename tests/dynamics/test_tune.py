"""Designed controllers, limits of gains, and ``threadline tune``, by other computations."""

from __future__ import annotations

import dataclasses
import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

import threadline as tl
from threadline.cli.main import main
from threadline.dynamics.analysis import analyse_axis
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.loop_design import CONTROLLERS, design, with_controller
from threadline.dynamics.worst_margins import spread_of
from threadline.machine import load_machine
from threadline.machine.numbers import number_at
from threadline.search.ziegler_nichols import Ultimate, reaction_curve, ultimate

EXAMPLES = Path(__file__).parents[2] / "examples"
TICK = 5e-3
POLE = 46.7
J, KT, KE, R = 3.606e-4, 0.082, 8.6 * 60 / (2 * np.pi * 1000), 0.4


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main(["tune", *map(str, arguments)])
    out = capsys.readouterr()
    return left.value.code or 0, out.out, out.err


def winder_x(inertia=1.0, torque=1.0, emf=1.0, resistance=1.0):
    """Return X of the winder, counts per DAC level, held for 5 ms: numerator, denominator in z."""
    per_volt = 0.45 * KT * torque / (R * resistance * J * inertia)
    pole = KT * torque * KE * emf / (R * resistance * J * inertia)
    counts = 4000 / (2 * np.pi) * 20 / 4096
    num, den, _ = cont2discrete(([counts * per_volt], [1, pole, 0]), TICK, "zoh")
    return np.ravel(num), den


def filter_of(kind, gains):
    """Return the difference equations of the documents: numerator and denominator in z."""
    if kind == "lead":
        return gains["gain"] * np.array([1, -gains["zero"]]), np.array([1, gains["pole"]])
    kp, ki, kd = (gains.get(key, 0.0) for key in ("kp", "ki", "kd"))
    if "ki" not in gains:
        return np.array([kp + kd, -kd]), np.array([1.0, 0.0])
    return np.array([kp + ki + kd, -kp - 2 * kd, kd]), np.array([1.0, -1.0, 0.0])


def margins(kind, gains, **plant):
    """Return gain margin and phase margin on a fine grid."""
    z = np.exp(1j * np.geomspace(1e-3, np.pi * (1 - 1e-9), 200_000))
    (a, b), (c, d) = winder_x(**plant), filter_of(kind, gains)
    L = np.polyval(np.polymul(a, c), z) / np.polyval(np.polymul(b, d), z)
    crossings = np.flatnonzero((np.abs(L[:-1]) > 1) & (np.abs(L[1:]) <= 1))
    phase = np.degrees(np.angle(-L[crossings])).min()
    flips = np.flatnonzero((L.imag[:-1] < 0) & (L.imag[1:] >= 0) & (L.real[:-1] < 0))
    return (-1 / L.real[flips]).min(initial=np.inf), phase


def poles(kind, gains):
    (a, b), (c, d) = winder_x(), filter_of(kind, gains)
    return np.roots(np.polyadd(np.polymul(a, c), np.polymul(b, d)))


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_a_designed_loop_has_the_margins_that_it_was_designed_for(kind):
    """All are stable, have 60 degrees, and a gain margin of at least 2, by polynomials in z."""
    machine = load_machine("lathe-winder")
    gains = design(machine, axis_loop(machine, "X"), kind, 60.0)
    gain, phase = margins(kind, gains)
    assert phase == pytest.approx(60.0, abs=0.3)
    assert gain > 2.0
    assert np.abs(poles(kind, gains)).max() < 1.0


def test_more_gain_at_the_same_margin_is_not_to_be_had():
    """Of PD controllers with 60 degrees and a gain margin of 2, none on a grid has more Kp."""
    machine = load_machine("lathe-winder")
    gains = design(machine, axis_loop(machine, "X"), "pd", 60.0)
    for factor, kd in product((1.05, 1.2, 1.5), np.geomspace(2.0, 80.0, 25)):
        gain, phase = margins("pd", {"kp": factor * gains["kp"], "kd": kd})
        assert phase < 60.0 or gain < 2.0


def test_a_lead_at_a_given_crossover_is_that_of_analyse(capsys):
    machine = load_machine("stitcher-rigid")
    gains = design(machine, axis_loop(machine, "X"), "lead", 65.0, 13.5)
    with pytest.raises(SystemExit):
        main(["analyse", "stitcher-rigid", "--axis", "X", "--lead", "13.5 Hz, 65 deg", "--json"])
    printed = json.loads(capsys.readouterr().out)["axes"]["X"]["lead"]
    assert gains["gain"] == pytest.approx(printed["gain_dac_per_count"], rel=1e-9)
    assert gains["zero"] == pytest.approx(printed["zero"], rel=1e-9)


def test_the_worst_margins_are_those_of_the_worst_of_all_corners():
    """Four numbers act on X of the winder: sixteen corners, each by polynomials in z."""
    machine = load_machine("lathe-winder")
    gains = {"kp": 6.4, "kd": 23.0}
    found = spread_of(machine, "X").worst("pd", gains)
    corners = [
        margins("pd", gains, inertia=a, torque=b, emf=c, resistance=d)
        for a, b, c, d in product((0.95, 1.05), *[(0.9, 1.1)] * 3)
    ]
    assert found.stable and len(found.at) == 4
    assert found.gain_margin == pytest.approx(min(gain for gain, _ in corners), rel=5e-3)
    assert found.phase_margin_deg == pytest.approx(min(phase for _, phase in corners), abs=0.2)


def test_a_loop_that_is_unstable_on_some_machines_says_so():
    machine = load_machine("lathe-winder")
    gains = {"kp": 8.39, "ki": 0.915}  # stable for the file's numbers alone
    found = spread_of(machine, "X").worst("pi", gains)
    assert margins("pi", gains)[1] > 0.0
    assert not found.stable and found.phase_margin_deg < 0.0


@pytest.mark.long(but="lathe-winder")
@pytest.mark.parametrize("name", ["stitcher", "stitcher+unloaded", "lathe-winder"])
def test_the_ultimate_gain_of_the_twin_is_the_gain_margin_of_analyse(name):
    """Within 1 %. The twin's motion finds it; the linear model only gives the search range."""
    machine = load_machine(name)
    controllers = {
        key: dataclasses.replace(one, dac=dataclasses.replace(one.dac, zero_on_reversal=False))
        for key, one in machine.controllers.items()
    }
    machine = dataclasses.replace(machine, controllers=controllers)
    found = ultimate(machine, "X")
    half = with_controller(machine, "X", "p", {"kp": 0.5 * found.kp})
    assert analyse_axis(half, "X").sampled.gain_margin == pytest.approx(2.0, rel=0.01)


def test_a_tick_of_zero_volts_at_each_reversal_costs_a_quarter_of_the_gain():
    """The linear model does not know it, but the experiment does."""
    found = ultimate(load_machine("lathe-winder"), "X")
    limit = margins("p", {"kp": 1.0})[0]
    assert limit == pytest.approx(24.43, rel=1e-3)
    assert found.kp == pytest.approx(0.76 * limit, rel=0.02)


def test_the_step_gives_slope_and_lag_of_the_printed_plant():
    """K / (s (s + p)) answers a step with the slope K/p after 1/p."""
    found = reaction_curve(load_machine("lathe-winder"), "X")
    assert found.lag_s == pytest.approx(1 / POLE, rel=5e-3)
    assert found.slope == pytest.approx(1771.8 * 0.45 / POLE, rel=5e-3)
    assert found.gains("pid", TICK)["kp"] == pytest.approx(1.2 / (found.slope * found.lag_s))


def test_the_rules_are_those_of_ziegler_and_nichols():
    """Their table: 0.45 Ku and Tu/1.2; 0.6 Ku, Tu/2 and Tu/8."""
    limit = Ultimate(kp=10.0, period_s=0.8)
    assert limit.gains("p", 0.01) == {"kp": 5.0}
    assert limit.gains("pi", 0.01) == pytest.approx({"kp": 4.5, "ki": 4.5 * 0.01 / (0.8 / 1.2)})
    assert limit.gains("pid", 0.01) == pytest.approx(
        {"kp": 6.0, "ki": 6.0 * 0.01 / 0.4, "kd": 6.0 * 0.1 / 0.01}
    )


def test_a_table_of_controllers_on_a_job_and_a_machine_file(capsys, tmp_path):
    """The written file has the margins and the contour error of its table."""
    file = tmp_path / "tuned.toml"
    job = EXAMPLES / "x-180.prg"
    words = ("lathe-winder", "--axis", "X", "--job", job, "--controller", "pid", "-o", file)
    code, out, err = run(capsys, *words, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    loops = {(one["controller"], one["rule"]): one for one in answer["axes"]["X"]["loops"]}
    assert set(loops) == {
        ("pd", "file"), ("pd", "settling"),
        *((kind, "margin") for kind in CONTROLLERS),
        *((kind, rule) for kind in ("p", "pi", "pid") for rule in ("ultimate", "step")),
    }  # fmt: skip
    jobs = {(one["controller"], one["rule"]): one for one in answer["jobs"]}
    assert set(jobs) == set(loops)
    assert jobs["pd", "margin"]["contour_error"] < 0.2 * jobs["pd", "file"]["contour_error"]
    fast = loops["pd", "settling"]
    assert fast["settling_s"] < min(0.05, loops["pd", "margin"]["settling_s"])
    assert fast["overshoot"] <= 0.055 and fast["modulus_margin"] > 0.49
    again = load_machine(str(file))
    assert again.controller_of("X").kind == "pid" and again.controller_of("Y").kind == "pd"
    for name in ("kp", "ki", "kd"):
        value = number_at(again, f"controllers.x.{name}").si
        assert value == pytest.approx(loops["pid", "margin"]["gains"][name], rel=1e-5)
    proved = tl.prove(job, file, level="nominal")
    contour = proved.result("contour_error").measured
    assert contour == pytest.approx(jobs["pid", "margin"]["contour_error"], rel=1e-3)


@pytest.mark.long(shown_by="test_a_table_of_controllers_on_a_job_and_a_machine_file")
def test_the_table_for_people_and_a_lead_filter_that_becomes_a_pd(tmp_path):
    """The numbers of the filter are removed from the file that is based on it."""
    file = tmp_path / "tuned.toml"
    found = tl.tune("stitcher+unloaded", file, axis="X", controller="pd")
    assert "gain" not in dir(load_machine(str(file)).controllers["x"])
    assert found.axes[0].limit is not None
    machine = found.tuned("pd")
    assert machine.controller_of("X").kd.si == found.axes[0].loop("pd", "margin").gains["kd"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("lathe-winder", "--axis", "Q"), "has no axis 'Q' with a control loop. It has: A, X, Y"),
        (("letter-placer",), "has no control loops"),
        (("lathe-winder", "--margin", "60"), "'60'"),
        (("lathe-winder", "--axis", "X", "--margin", "200 deg"), "outside 0 ... 180 deg"),
        (("lathe-winder", "--axis", "X", "--crossover", "600 Hz"), "outside 0 ... 100 Hz"),
        (("lathe-winder", "--controller", "pd"), "--controller says what -o writes"),
        (("lathe-winder", "-o", "x.toml", "--controller", "fuzzy"), "no controller 'fuzzy'"),
        (("lathe-winder", "-o", "x.toml", "--rule", "luck"), "there is no rule 'luck'"),
        (("lathe-winder", "-o", "x.spec.toml"), "no name for a machine file"),
        (("lathe-winder", "--actual", "lathe-winder"), "Add --trim"),
        (("lathe-winder", "--trim", "--crossover", "5 Hz"), "designs no controllers"),
        (("lathe-winder", "--trim", "--rule", "settling"), "Leave out --rule"),
        (("lathe-winder", "--trim", "--margin", "50 deg"), "Leave out --margin"),
        (("lathe-winder", "--rule", "settling"), "--rule says what -o writes"),
        (("lathe-winder", "--trim", "--amplitude", "9 mm"), "Name it with --axis"),
        (("stitcher", "--trim"), "its volts are seen at some of its ticks only"),
        (("lathe-winder", "--trim", "--axis", "Y", "--amplitude", "80 mm"), "nothing has moved"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *words)
    assert code == 2 and message in err and err.count("\n") == 1 and not out
    assert not [*tmp_path.iterdir()]
