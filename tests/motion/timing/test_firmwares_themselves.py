"""Klipper's host and grblHAL's simulator, step by step, compared with the models here.

The bar is 1 % of the time. Klipper's host agrees within a quarter of a step at every step of its
motors (it moves steps by up to 25 us to compress them: 0.2 of a step here), and in its times within
that; grblHAL's simulator agrees within the millisecond of its output, and the segments of 10 ms in
which it computes its speeds.
"""

from __future__ import annotations

import random
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import NO_FIRMWARE
from tests.jobs.made_machines import made_machine
from tests.motion.timing import grblhal_simulator, klipper_host
from threadline.cli.main import main
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.motion_planner import FirmwarePlanner, GrblPlanner, KlipperPlanner
from threadline.machine.quantity import parse_machine_quantity
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import plan_trajectory
from threadline.motion.timing.types import Trajectory

_RUN_UP_MM = 5.0
LIMITS = {
    "velocity": 100.0,
    "acceleration": 500.0,
    "turning": 600.0,
    "spinning": 2000.0,
    "corner": 5.0,
    "instant": 1.0,
    "alone": 0.0,
}
OF_ITS_OWN = {"instant": 20.0, "alone": 700.0}


def number(text: str, unit: str):
    return parse_machine_quantity(f"{text} exact, assumed", (unit,))


GRBL = GrblPlanner(kind="grbl", junction_deviation=number("0.01 mm", "m"), blocks=number("100", ""))
KLIPPER = KlipperPlanner(
    kind="klipper",
    velocity=number("100 mm/s", "m/s"),
    acceleration=number("500 mm/s^2", "m/s^2"),
    square_corner_velocity=number("5 mm/s", "m/s"),
)


def circuit() -> list[str]:
    """Of 55 degrees on a tube of 100 mm by 300 mm."""
    return ["G1 X300 A490.961 F6000", "G1 A690.961", "G1 X0 A1181.922", "G1 A1391.922"]


def short_moves() -> list[str]:
    """Forty moves of some millimetres and degrees."""
    rng, lines, x, a = random.Random(4), [], 0.0, 0.0
    for k in range(40):
        x = max(0.0, min(200.0, x + rng.uniform(-6, 8)))
        a += rng.uniform(1, 25)
        lines.append(f"G1 X{x:.3f} A{a:.3f}{' F3000' if k == 0 else ''}")
    return lines


def circuits() -> list[str]:
    """Two circuits along 150 mm, whose ends the mandrel alone turns."""
    lines, a = [], 0
    for _ in range(2):
        for places in ((50, 100, 150), (100, 50, 0)):
            for x in places:
                a += 81
                lines.append(f"G1 X{x} A{a}{'' if lines else ' F4500'}")
            a += 190
            lines.append(f"G1 A{a}")
    return lines


TUNED = replace(
    KLIPPER,
    jump={"A": number("20 deg/s", "rad/s")},
    alone={"A": number("700 deg/s^2", "rad/s^2")},
)
JOBS = {"circuit": circuit(), "short": short_moves(), "circuits": circuits()}


def with_limits() -> list[str]:
    """Moves with different limits, below and above those of the configuration."""
    rng, lines, x, a = random.Random(7), ["G1 F9000"], 0.0, 0.0
    for k in range(30):
        limits = {
            "VELOCITY": rng.choice([20, 60, 150]),
            "ACCEL": rng.choice([100, 250, 900]),
            "SQUARE_CORNER_VELOCITY": rng.choice([0, 2, 9]),
            "MINIMUM_CRUISE_RATIO": rng.choice([0, 0.3, 0.8]),
        }
        some = rng.sample(sorted(limits), rng.randint(1, 4))
        lines.append("SET_VELOCITY_LIMIT " + " ".join(f"{name}={limits[name]}" for name in some))
        if k % 7 == 3:
            lines[-1] = f"M204 S{limits['ACCEL']}"
        elif k % 7 == 5:
            lines[-1] = f"m204 P{limits['ACCEL']} T800"
        for _ in range(rng.randint(1, 3)):
            x = max(0.0, min(200.0, x + rng.uniform(-9, 14)))
            a += rng.choice([0.0, 0.0, rng.uniform(1, 20)])
            lines.append(f"G1 X{x:.3f} A{a:.3f}")
    return lines


KLIPPER_JOBS = JOBS | {"limits": with_limits()}


def planned(
    folder: Path,
    planner: FirmwarePlanner,
    lines: list[str],
    rotary: str,
    dialect: str,
    axes: str = "",
) -> Trajectory:
    """Return the plan on X and the other axis, which is rotary or linear."""
    linear, other = ("X", "A") if rotary else ("XY", "Y")
    unit = "deg" if rotary else "mm"
    base = made_machine(folder, linear, rotary, f'[programs]\ndialect = "{dialect}"\n')
    file = folder / "measured.toml"
    file.write_text(
        f'base = "{Path(base.file).name}"\nname = "measured"\n'
        f'[axes.X]\nvelocity = "{LIMITS["velocity"]} mm/s exact, assumed"\n'
        f'acceleration = "{LIMITS["acceleration"]} mm/s^2 exact, assumed"\n'
        f'[axes.{other}]\nvelocity = "{LIMITS["turning"]} {unit}/s exact, assumed"\n'
        f'acceleration = "{LIMITS["spinning"]} {unit}/s^2 exact, assumed"\n'
    )
    machine = replace(load_machine(file), planner=planner)
    program = folder / "job.nc"
    program.write_text("\n".join(["G21", "G90", *lines]) + "\n")
    job = read_job(program, machine, **({"axes": axes} if axes else {}))
    return plan_trajectory(plan_path(programmed_path(job, machine), machine, "firmware"), machine)


@pytest.mark.parametrize(
    ("name", "planner", "more"),
    [(name, KLIPPER, {}) for name in KLIPPER_JOBS]
    + [(name, TUNED, OF_ITS_OWN) for name in KLIPPER_JOBS],
)
def test_klippers_host_makes_every_step_where_ours_is(
    tmp_path: Path, name: str, planner: KlipperPlanner, more: dict[str, float]
) -> None:
    klipper = klipper_host.installed()
    if klipper is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_KLIPPER names a checkout of Klipper")
    ours = planned(tmp_path, planner, KLIPPER_JOBS[name], "A", "klipper")
    moves = "".join(f"{line}\n" for line in KLIPPER_JOBS[name])
    theirs = klipper_host.steps_on_klipper(moves, tmp_path, LIMITS | more, klipper)
    begin_s = 1.25  # a quarter of a second behind its start, and the pause
    sizes = {"X": klipper_host.STEP_MM / 1e3, "A": np.radians(klipper_host.STEP_DEG)}
    for column, axis in enumerate("XA"):
        own = theirs[axis]
        assert len(own.time_s) > 100
        places = ours(np.clip(own.time_s - begin_s, 0.0, ours.duration_s))[:, column]
        assert np.abs(places / sizes[axis] - own.middle).max() < 0.25
    last_s = max(own.time_s[-1] for own in theirs.values()) - begin_s
    # The last step is made half a step before the end, at rest: sqrt of 2 s / a.
    half_s = max(np.sqrt(klipper_host.STEP_DEG / LIMITS["spinning"]), 0.01)
    assert last_s <= ours.duration_s < last_s + 2.0 * half_s


@pytest.mark.parametrize("name", JOBS)
def test_grblhals_simulator_is_where_ours_is(tmp_path: Path, name: str) -> None:
    simulator = grblhal_simulator.installed()
    if simulator is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_GRBLHAL names grblHAL's simulator")
    moves = [line.replace("A", "Y") for line in JOBS[name]]
    ours = planned(tmp_path, GRBL, moves, "", "grbl")
    per_min = {"$110": LIMITS["velocity"] * 60.0, "$111": LIMITS["turning"] * 60.0}
    settings = [f"${code}=0" for code in (20, 21, 22)]
    settings += [f"${code}={grblhal_simulator.STEPS_PER_MM}" for code in (100, 101)]
    settings += [f"{code}={value}" for code, value in per_min.items()]
    settings += [f"$120={LIMITS['acceleration']}", f"$121={LIMITS['spinning']}", "$11=0.01"]
    time_s, places = grblhal_simulator.places_on_grblhal(
        _behind_a_run_up(moves), settings, tmp_path, simulator
    )
    # The job begins where the way back ends, farthest from it.
    begins = len(time_s) - 1 - int(np.argmin(places[::-1].sum(axis=1)))
    time_s, places = time_s[begins:], places[begins:] - places[begins]
    moving = np.flatnonzero(np.diff(places, axis=0).any(axis=1))
    time_s, places = time_s[: moving[-1] + 2], places[: moving[-1] + 2]
    # The time at which the plan is as far along: both go the same way.
    fine_s = np.linspace(0.0, ours.duration_s, int(ours.duration_s / 1e-4))
    way = _way(1e3 * ours(fine_s))
    at_s = np.interp(_way(places), way, fine_s)
    lag_s = (time_s - time_s[0]) - (at_s - at_s[0])
    missing_s = ours.duration_s - at_s[-1]
    print(f"{name}: {ours.duration_s:.4f} s, {1e3 * lag_s[-1]:.2f} ms later after {at_s[-1]:.3f} s")
    assert missing_s < 0.12
    assert abs(lag_s[-1]) < 1e-3 * ours.duration_s
    assert np.abs(lag_s).max() < 0.02


def compiled(folder: Path, lines: list[str], rotary: str, target: str) -> list[str]:
    """Return the blocks that ``compile`` writes for a firmware, on the machine of ``planned``."""
    return compiled_with(folder, lines, rotary, target, "marlin")


def compiled_with(
    folder: Path, lines: list[str], rotary: str, target: str, dialect: str, axes: str = ""
) -> list[str]:
    """Return the result of ``compiled`` for a program in any dialect."""
    planned(folder, GRBL, lines, rotary, dialect, axes)
    out = folder / "out.gcode"
    words = ["compile", str(folder / "job.nc"), "-m", str(folder / "measured.toml")]
    words += ["--axes", axes] if axes else []
    with pytest.raises(SystemExit) as left:
        main([*words, "--target", target, "-o", str(out)])
    assert left.value.code == 0
    return out.read_text().splitlines()


def test_klippers_host_takes_what_is_compiled_for_it(tmp_path: Path) -> None:
    """Every block runs to the end of the job; an unknown word would end its run."""
    klipper = klipper_host.installed()
    if klipper is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_KLIPPER names a checkout of Klipper")
    blocks = compiled(tmp_path, circuit(), "A", "klipper")
    text = "".join(f"{line}\n" for line in blocks)
    steps = klipper_host.steps_on_klipper(text, tmp_path, LIMITS, klipper)
    assert abs(steps["X"].middle[-1]) == 0.5
    assert steps["A"].middle[-1] == pytest.approx(1391.922 / klipper_host.STEP_DEG, abs=1.0)
    with pytest.raises(AssertionError, match="NO_SUCH_WORD"):
        klipper_host.steps_on_klipper(f"NO_SUCH_WORD\n{text}", tmp_path, LIMITS, klipper)


def test_grblhals_simulator_takes_what_is_compiled_for_it(tmp_path: Path) -> None:
    """Every block is answered with ok; its motors go to the end of the job."""
    simulator = grblhal_simulator.installed()
    if simulator is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_GRBLHAL names grblHAL's simulator")
    blocks = compiled(tmp_path, [line.replace("A", "Y") for line in circuit()], "", "grbl")
    settings = [f"${code}=0" for code in (20, 21, 22)]
    settings += [f"${code}={grblhal_simulator.STEPS_PER_MM}" for code in (100, 101)]
    settings += ["$110=6000", "$111=36000", "$120=500", "$121=2000", "$11=0.01"]
    _, places = grblhal_simulator.places_on_grblhal(blocks, settings, tmp_path, simulator)
    assert places[:, 0].max() == pytest.approx(300.0, abs=0.02)
    assert places[-1] == pytest.approx([0.0, 1391.922], abs=15.0)  # the missing last 0.1 s


def _behind_a_run_up(moves: list[str]) -> list[str]:
    """Return the moves behind a slow one, straight away from the first, at whose end all rest.

    While it goes on, the simulator reads the others: at once it would begin with one in hand.
    """
    ends = np.array([[_place(line, "X"), _place(line, "Y")] for line in moves])
    places = np.array(ends)
    for column in range(2):
        known = 0.0
        for row, value in enumerate(ends[:, column]):
            known = known if np.isnan(value) else value
            places[row, column] = known
    away = -_RUN_UP_MM * places[0] / np.linalg.norm(places[0])
    lines = [f"G1 X{away[0]:.4f} Y{away[1]:.4f} F60"]
    for line, (x, y) in zip(moves, places + away, strict=True):
        feed = re.search(r"F\d+", line)
        lines.append(f"G1 X{x:.4f} Y{y:.4f} {feed[0] if feed else ''}")
    return ["G21 G90 G94", *lines]


def _place(line: str, axis: str) -> float:
    found = re.search(rf"{axis}([\d.]+)", line)
    return float(found[1]) if found else np.nan


def _way(places) -> np.ndarray:
    steps = np.abs(np.diff(places, axis=0)).sum(axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))
