"""Designs of state-space controllers, compared with least squares, recursions and scipy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.linalg import lstsq

from tests.twin.test_state_space import compare, run, swinger
from threadline.cli.main import main
from threadline.dynamics.analysis import analyse_axis
from threadline.dynamics.contouring import cross_coupled
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.state_designs import (
    Designed,
    lqg,
    preview,
    regulators,
    zero_phase,
    zero_phase_ticks,
)
from threadline.errors import MachineError
from threadline.identify.time_domain import driven_by_volts
from threadline.machine import Machine, load_machine
from threadline.search.controller_design import overlay_text


def written(folder, machine: Machine, base: str, designs: list[Designed]) -> Machine:
    (folder / "designed.toml").write_text(overlay_text(machine, base, "made for a test", designs))
    return load_machine(folder / "designed.toml")


@pytest.mark.parametrize("ahead", [0, 1, 4, 12])
def test_gains_are_those_of_least_squares_over_a_long_horizon(ahead):
    """The first of the outputs that make ``sum (q e)^2 + u^2`` least over 500 ticks of 1 ms.

    Only the plant is shared: there is no Riccati equation. 500 ticks are ten times the slowest
    pole.
    """
    regulator = regulators(load_machine("stitcher"), 2.0)[0]
    F, G, C, q = regulator.F, regulator.G[:, 0], regulator.load[0], regulator.weight[0]
    horizon, n = 500, len(F)
    free, answer = [], [0.0]
    state, forced = np.eye(n), G.copy()
    for _ in range(horizon):
        state = F @ state
        free.append(C @ state)
        answer.append(float(C @ forced))
        forced = F @ forced
    effect = np.array(
        [[answer[k - j + 1] if j <= k else 0.0 for j in range(horizon)] for k in range(horizon)]
    )
    left = np.vstack([q * effect, np.eye(horizon)])
    random = np.random.default_rng(7)
    x = random.normal(size=n) * np.abs(1.0 / np.maximum(np.abs(regulator.K[0]), 1e-3))
    known = random.normal(size=ahead) * 100.0 if ahead else np.zeros(0)
    last = known[-1] if ahead else 70.0
    references = np.concatenate([known, np.full(horizon - len(known), last)])
    target = np.concatenate([q * (references - np.array(free) @ x), np.zeros(horizon)])
    first = lstsq(left, target)[0][0]
    gains = [float(g[0, 0]) for g in regulator.ahead(ahead)]
    reordered = [last, *known[:-1][::-1]]
    found = -float(regulator.K[0] @ x) + sum(g * r for g, r in zip(gains, reordered, strict=True))
    assert found == pytest.approx(first, rel=1e-6, abs=1e-6 * abs(regulator.K[0]) @ abs(x))


def test_the_observer_is_the_limit_of_kalmans_recursion():
    regulator = regulators(load_machine("lathe-winder"))[0]
    n, m = regulator.push.shape
    F = np.block([[regulator.F, regulator.push], [np.zeros((m, n)), np.eye(m)]])
    H = np.hstack([regulator.H, np.zeros((1, m))])
    Q = np.zeros((n + m, n + m))
    Q[:n, :n] = regulator.push @ regulator.push.T
    Q[n:, n:] = 0.05**2
    P = np.eye(n + m)
    for _ in range(5000):
        gain = P @ H.T / (H @ P @ H.T + 1.0 / 12.0)
        P = F @ (P - gain @ H @ P) @ F.T + Q
    np.testing.assert_allclose(gain, regulator.observer, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("base", ["stitcher", "lathe-winder"])
def test_the_loop_has_the_poles_of_feedback_and_observer_apart(tmp_path, base):
    """The file's controller closes to the poles of ``F - G K`` and of the observer: separation."""
    machine = load_machine(base)
    found = regulators(machine)
    made = written(tmp_path, machine, base, [lqg(one) for one in found])
    for one in found:
        n, m = one.push.shape
        F = np.block([[one.F, one.push], [np.zeros((m, n)), np.eye(m)]])
        H = np.hstack([one.H, np.zeros((len(one.H), m))])
        apart = np.concatenate(
            [
                np.linalg.eigvals(one.closed),
                np.linalg.eigvals(F @ (np.eye(n + m) - one.observer @ H)),
            ]
        )
        poles = axis_loop(made, one.parts[0].axis).closed().eigenvalues()
        assert np.abs(poles).max() < 1.0
        for pole in apart[np.abs(apart) > 0.5]:  # those at 0 are chains, known to few digits
            assert np.abs(poles - pole).min() < 1e-6


def test_the_observer_knows_what_the_ends_of_the_dac_took(tmp_path):
    """A jump of 108 mm drives DAC and current to their ends; without L it overshoots by 62 %."""
    machine = load_machine("lathe-winder")
    made = written(tmp_path, machine, "lathe-winder", [lqg(one) for one in regulators(machine, 4)])
    counts = np.zeros((400, 3), dtype=np.int64)
    counts[5, made.axis_names.index("X")] = 6000
    found = run(made, counts)
    assert np.abs(found["X.voltage"]).max() > 9.9
    target = 6000 / made.axes["X"].counts.si
    assert found["X.load"].max() < 1.15 * target
    assert found["X.load"][-1] == pytest.approx(target, rel=1e-3)


@pytest.mark.parametrize(("base", "smoothing"), [("lathe-winder", 1), ("stitcher", 7)])
def test_zero_phase_tracking_has_no_phase_but_its_delay(tmp_path, base, smoothing):
    """The response from reference to load, times ``z^delay``, is real; its size only falls."""
    machine = load_machine(base)
    found = regulators(machine)
    late = max(zero_phase_ticks(one, smoothing) for one in found)
    made = written(tmp_path, machine, base, [zero_phase(one, late, smoothing) for one in found])
    for axis in made.axes:
        closed = axis_loop(made, axis).closed()
        at = closed.outputs.index(f"{axis}.load")
        scale = made.axes[axis].counts.si
        for hertz in (0.1, 1.0, 5.0, 10.0, 20.0):
            z = np.exp(2j * np.pi * hertz * closed.period_s)
            index = axis_loop(made, axis).index
            state = np.linalg.solve(z * np.eye(len(closed.A)) - closed.A, closed.B[:, index])
            value = (closed.C[at] @ state) * scale * z**late
            assert abs(np.angle(value)) < 1e-5, (axis, hertz)
            assert 0.0 < value.real < 1.0 + 1e-6
            if hertz == 0.1:
                assert value.real == pytest.approx(1.0, abs=1e-3)


def test_a_quantised_run_of_the_winder_lags_by_that_delay_alone(tmp_path):
    """60 mm/s along X with parabolic ends, 12-bit DAC: 0.1 mm of the motion three ticks before."""
    machine = load_machine("lathe-winder")
    found = regulators(machine)
    late = max(zero_phase_ticks(one) for one in found)
    made = written(tmp_path, machine, "lathe-winder", [zero_phase(one, late) for one in found])
    ramp = np.rint(17.0 * 0.5 * (1.0 - np.cos(np.pi * np.arange(40) / 40)))
    counts = np.zeros((400, 3), dtype=np.int64)
    x = made.axis_names.index("X")
    counts[10:50, x], counts[50:150, x], counts[150:190, x] = ramp, 17, ramp[::-1]
    output = run(made, counts)
    behind = output["X.load"][late:] - output["X.commanded"][:-late]
    own = run(machine, counts)
    assert np.abs(behind).max() < 1e-4
    assert np.abs(own["X.load"][late:] - own["X.commanded"][:-late]).max() > 5e-4


def test_preview_within_the_dead_time_changes_nothing(tmp_path):
    """The stitcher's 3 ms and the tick of the held output: four references act like none."""
    regulator = regulators(load_machine("stitcher"))[0]
    gains = regulator.ahead(4)
    assert all(abs(float(g[0, 0])) < 1e-9 * abs(float(gains[0][0, 0])) for g in gains[1:])
    assert any(abs(float(g[0, 0])) > 1e-6 for g in regulator.ahead(12)[1:])
    assert preview(regulator, 4).A.shape[0] == lqg(regulator).A.shape[0] + 3


MATCHED = """base = "lathe-winder"
[bodies.y]
inertia = "3.606e-4 kg m^2 exact, assumed: as X"
[sensors.y]
reads = { y = "4000 count/rev exact, assumed: as X" }
[axes.Y]
counts = "55.358 count/mm exact, assumed: as X"
"""


def test_matched_axes_on_their_line_run_as_their_own_controllers(tmp_path):
    """Kulkarni and Srinivasan: no error across the line, so no compensation; to 1e-9."""
    (tmp_path / "matched.toml").write_text(MATCHED)
    own = load_machine(tmp_path / "matched.toml")
    design = cross_coupled(own, ("X", "Y"), np.pi / 4, 0.5)
    coupled = written(tmp_path, own, "matched.toml", [design])
    line = np.zeros((300, 3), dtype=np.int64)
    x, y = own.axis_names.index("X"), own.axis_names.index("Y")
    line[20:120, x] = line[20:120, y] = 12
    line[150:200, x] = line[150:200, y] = -20
    for quantised in (False, True):
        one = run(own, line, quantised=quantised)
        assert np.abs(one["X.load"]).max() > 0.01
        compare(one, run(coupled, line, quantised=quantised))
    away = line.copy()
    away[:, y] = 0
    apart = run(own, away, quantised=False)["Y.load"]
    assert np.abs(run(coupled, away, quantised=False)["Y.load"] - apart).max() > 1e-4


def test_a_fit_refuses_axes_that_one_controller_moves(tmp_path):
    own = load_machine("lathe-winder")
    coupled = written(tmp_path, own, "lathe-winder", [cross_coupled(own, ("X", "Y"), 0.8, 0.5)])
    with pytest.raises(MachineError, match="moves the axes X, Y together"):
        driven_by_volts(coupled, ["X"])


def test_axes_that_differ_keep_closer_to_their_line(tmp_path):
    own = load_machine("lathe-winder")
    coupled = written(
        tmp_path, own, "lathe-winder", [cross_coupled(own, ("X", "Y"), np.pi / 4, 1.0)]
    )
    counts = np.zeros((300, 3), dtype=np.int64)
    scale = [own.axes[axis].counts.si for axis in ("X", "Y")]
    for axis, size in zip(("X", "Y"), scale, strict=True):
        way = np.rint(size * np.clip(0.001 * (np.arange(301) - 20), 0.0, 0.1)).astype(np.int64)
        counts[:, own.axis_names.index(axis)] = np.diff(way)
    errors = []
    for machine in (own, coupled):
        found = run(machine, counts, quantised=False)
        errors.append(np.abs(found["Y.load"] - found["X.load"]).max() / np.sqrt(2.0))
    assert errors[1] < 0.7 * errors[0]


def test_an_observer_of_a_noisy_potentiometer_closes_a_stable_loop(tmp_path):
    machine = swinger(tmp_path, pot='noise = "20 mV exact, assumed"')
    (one,) = regulators(machine, 1.0, ("pot",))
    made = written(tmp_path, machine, "swinger.toml", [lqg(one)])
    analysis = analyse_axis(made, "X")
    assert analysis.stable
    assert analysis.steps["load"].steady_state_error == pytest.approx(0.0, abs=1e-6)


def test_the_command_writes_a_machine_that_prove_takes(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["control", "lathe-winder", "--design", "lqg", "-o", "made/lqg.toml", "--json"])
    assert stopped.value.code == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["stable"] is True
    assert printed["controllers"][0]["sensors"] == ["x"]
    machine = load_machine("made/lqg.toml")
    assert machine.controllers["x-designed"].kind == "state-space"
    (tmp_path / "line.prg").write_text("%\nO 1;\nN1 G01 F 2000;\nN2 G91;\nN3 X 20;\nN4 M30;\n%\n")
    with pytest.raises(SystemExit) as stopped:
        main(["prove", "line.prg", "-m", "made/lqg.toml", "--nominal", "--json"])
    assert stopped.value.code in {0, 1}
    assert json.loads(capsys.readouterr().out)["machine"] == machine.name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["stitcher", "--design", "pid"], "no design 'pid'"),
        (["stepper-winder", "--design", "lqg"], "no control loops"),
        (["stitcher", "--design", "lqg", "--gain", "0"], "--gain 0 is not above 0"),
        (["stitcher", "--design", "lqg", "--sensors", "z_pot"], "no sensor 'z_pot'"),
        (["stitcher", "--design", "lqg", "--sensors", "x_pot"], "neither noise nor resolution"),
        (["stitcher", "--design", "preview", "--ahead", "0"], "--ahead 0 is not from 1 to"),
        (["stitcher", "--design", "zpetc", "--smoothing", "4"], "no odd number"),
        (["stitcher", "--design", "cross-coupled", "--axes", "X"], "no pair of the axes"),
        (["stitcher", "--design", "cross-coupled", "--coupling", "-1"], "not between 0 and"),
    ],
)
def test_impossible_controller_design_is_refused_and_writes_nothing(
    tmp_path, capsys, words, message
):
    with pytest.raises(SystemExit) as stopped:
        main(["control", *words, "-o", str(tmp_path / "no.toml")])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "no.toml").exists()
