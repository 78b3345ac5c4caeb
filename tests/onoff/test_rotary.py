"""A rotary cylinder: two pistons on a rack swivel an arm on a springy column.

The equations are Newton's law by hand, with the numbers of ``examples/swivel.toml``, integrated by
scipy. The stiffness of the air belongs to two chambers with adiabatic changes, by numerical
differentiation of p V^1.4, not by the formula of the program.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.onoff.cycles import run
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.errors import MachineError
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ARM, COLUMN, TORSION, GROUND, BEARING = 0.012, 1.2, 580.0, 0.3, 0.02
AIR_C, LAG_S, DELAY_S, SPEED, RADIUS_M = 0.33, 0.06, 0.05, math.radians(240.0), 0.25
SWIVEL = """
[[operation]]
valve = "main_air"
[[operation]]
step = "swivel"
move = { C = "120 deg" }
levels = "0.6 for 100 ms, 1 for 370 ms, 0.4 for 175 ms"
[[operation]]
dwell = "500 ms"
"""


def changed(folder: Path, *pairs: tuple[str, str]) -> Path:
    """Write the machine of the example with changes; return its file."""
    text = (EXAMPLES / "swivel.toml").read_text("utf-8")
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    file = folder / "swivel.toml"
    file.write_text(text, "utf-8")
    return file


def chambers_n_m_rad() -> float:
    """Return the air's stiffness in the middle of 180 deg: two chambers, 16 cm^2, 6 bar."""
    area, pinion, absolute = 2 * 8e-4, 0.015, 5e5 + 101_325.0
    half = area * pinion * math.radians(180.0) / 2.0  # m^3 of each chamber

    def torque(angle: float) -> float:
        swept = area * pinion * angle
        pressures = (absolute * (half / (half + sign * swept)) ** 1.4 for sign in (1.0, -1.0))
        pushed, behind = pressures
        return area * pinion * (behind - pushed)

    step = 1e-4
    return (torque(step) - torque(-step)) / (2.0 * step)


def test_an_arm_swivels_as_newtons_law_has_it(tmp_path: Path) -> None:
    """Angle of the arm and place of the column, against DOP853, within a millionth of the way."""
    file = changed(tmp_path, ('air_ramp = "5 deg +- 50 %, assumed"\n', ""))
    text = file.read_text("utf-8").replace('scan = "10 ms', 'scan = "5 ms')
    file.write_text(text.replace('watchdog = "25 ms', 'watchdog = "13 ms'), "utf-8")
    machine = load_machine(file)
    job = tmp_path / "one.toml"
    job.write_text(SWIVEL, "utf-8")
    proof = prove(job, machine, load_spec(None, machine), Options())
    assert proof.recording is not None
    times, found = proof.recording.samples("C.load")
    column = proof.recording.samples("C.frame")[1]
    on = {n: proof.recording.samples(n)[1] for n in ("c_out", "c_out_a1", "c_out_a2")}
    level = on["c_out"] * (0.6 * on["c_out_a1"] + 0.4 * on["c_out_a2"])
    at = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist()]
    arrivals = [0.0, *(float(times[k]) + DELAY_S for k in at[1:]), float(times[-1])]
    air_k = chambers_n_m_rad()

    def rates(_t: float, x: np.ndarray, flow: float) -> list[float]:
        _, arm_v, base, base_v, speed, air = x
        relative = arm_v - base_v
        torque = air_k * air + AIR_C * (speed - relative) - BEARING * relative
        return [
            arm_v,
            torque / ARM,
            base_v,
            (-torque - TORSION * base - GROUND * base_v) / COLUMN,
            (SPEED * flow - speed) / LAG_S,
            speed - relative,
        ]

    state, angles, places = np.zeros(6), [], []
    for flow, begin, end in zip(level[at], arrivals[:-1], arrivals[1:], strict=True):
        inside = times[(times >= begin - 1e-12) & ((times < end - 1e-12) | (end == arrivals[-1]))]
        done = solve_ivp(
            rates, (begin, end), state, method="DOP853", t_eval=np.union1d(inside, [end]),
            rtol=1e-10, atol=1e-13, args=(float(flow),),
        )  # fmt: skip
        angles += list((done.y[0] - done.y[2])[: len(inside)])
        places += list(RADIUS_M * done.y[2][: len(inside)])
        state = done.y[:, -1]
    assert math.degrees(max(angles)) == pytest.approx(120.0, abs=3.0)
    assert max(np.abs(places)) > 1e-4
    # The stiffness by differentiation is exact to 1e-8 of itself; the rest is the integrator's.
    assert np.abs(found - np.array(angles)).max() < 1e-6
    assert np.abs(column - np.array(places)).max() < 1e-9


def test_the_cycle_is_proven_and_written_in_degrees(tmp_path: Path) -> None:
    cycle, machine = EXAMPLES / "swivel-cycle.toml", EXAMPLES / "swivel.toml"
    code, output = run("prove", str(cycle), "-m", str(machine), "--shaper", "um-zv", "--nominal")
    assert code == 0, output
    assert "IN SPEC" in output
    assert any("end_position_error" in row and " deg" in row for row in output.splitlines())
    out = tmp_path / "c.st"
    words = ("compile", str(cycle), "-m", str(machine), "--shaper", "um-zv", "--target", "st")
    assert run(*words, "-o", str(out))[0] == 0
    text = out.read_text("ascii")
    assert "c_0_to_180 : INT := 2; (* 0 to 180 deg *)" in text
    assert "swivel: C 180 deg forward" in text


@pytest.mark.long(shown_by="test_the_cycle_is_proven_and_written_in_degrees")
def test_a_found_cycle_reads_back_with_its_angles(tmp_path: Path) -> None:
    best = tmp_path / "best.toml"
    cycle, machine = EXAMPLES / "swivel-cycle.toml", EXAMPLES / "swivel.toml"
    code, output = run("fastest", str(cycle), "-m", str(machine), "-o", str(best))
    assert code == 0, output
    assert 'move = { C = "180 deg" }' in best.read_text("utf-8")
    assert run("prove", str(best), "-m", str(machine), "--nominal")[0] == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "rotary"\npushes = "arm"', 'pushes = "arm"', 'of a linear cylinder is in m'),
        ('speed = "240 deg/s', 'speed = "0.2 m/s', "speed of a rotary cylinder is in rad/s"),
        ('at = "5 deg +- 1 deg', 'at = "5 mm +- 1 mm',
         r"toml:\d+: contacts\.c_is_in\.at: it is in m"),
        ('pushes = "arm"', 'pushes = "gripper"', "'gripper' is a linear body"),
        ('frame = { column = "250 mm/rad', 'frame = { column = "1', r"column: the weight of a rot"),
        ('radius = "250 mm exact, assumed: where the gripper is"\n', "", "radius is missing"),
        ('air_damping = "0.33', 'air_stiffness = "25 N*m/rad exact, assumed"\nair_damping = "0.33',
         "air_stiffness and torque both"),
        ('pistons = "2 exact', 'pistons = "1.5 exact', "pistons.*must be a whole number"),
        ('air_ramp = "5 deg',
         'cushion = { length = "200 deg exact, assumed", flow = "20 % exact, assumed" }\n'
         'air_ramp = "5 deg', "cushion.length 200 deg is not shorter than the stroke, 180 deg"),
    ],
)  # fmt: skip
def test_lengths_and_angles_are_not_mixed(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(MachineError, match=message):
        load_machine(changed(tmp_path, (old, new)))


def test_a_torque_that_cannot_bring_the_load_to_speed_is_told(tmp_path: Path) -> None:
    """12 N m accelerate 0.3 kg m^2 by 40 rad/s2; 240 deg/s in 60 ms are 69.8 rad/s2."""
    assert plausibility_warnings(load_machine(EXAMPLES / "swivel.toml")) == []
    heavy = changed(tmp_path, ('inertia = "0.012 kg m^2', 'inertia = "0.3 kg m^2'))
    (warnings,) = plausibility_warnings(load_machine(heavy))
    assert "20.94 N m" in warnings
    assert "12 N m" in warnings


def test_a_move_beyond_the_angle_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = tmp_path / "far.toml"
    job.write_text(SWIVEL.replace("120 deg", "200 deg"), "utf-8")
    assert run("prove", str(job), "-m", str(EXAMPLES / "swivel.toml"))[0] == 2
    assert "C would move to 200 deg of 0 ... 180 deg" in capsys.readouterr().err
