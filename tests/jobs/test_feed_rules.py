"""The meaning of F by the rules of controllers and planners, compared with their own figures."""

from __future__ import annotations

import math
import random
import re
import shutil
from pathlib import Path
from unittest.mock import patch

import pytest

from tests.jobs.controls_themselves import interpreted
from threadline.errors import MachineError, OptionError
from threadline.jobs import Job, Move, read_job
from threadline.jobs.feed_times import programmed_time_s
from threadline.jobs.gcode.plain_blocks import PlainReader
from threadline.machine import Machine, library_file, load_machine
from threadline.motion.path import programmed_path

WINDER = load_machine("lathe-winder")


def read(folder: Path, machine: Machine, *lines: str, feed_mode: str | None = None) -> Job:
    path = folder / "a.nc"
    path.write_text("\n".join([*lines, "M30"]) + "\n")
    return read_job(path, machine, **({} if feed_mode is None else {"feed_mode": feed_mode}))


def minutes(job: Job, machine: Machine) -> list[float]:
    """Nominal time of each move."""
    times = [t for block in programmed_path(job, machine) for t in block.nominal_s.tolist()]
    return [t / 60.0 for t in times[1:]]


@pytest.fixture
def winder(tmp_path: Path) -> Machine:
    """Axes X and A without an operator."""
    file = tmp_path / "mine.toml"
    file.write_text('base = "lathe-winder"\nname = "mine"\n')
    return load_machine(file)


def test_fanuc_as_its_manual_reckons(tmp_path: Path, winder: Machine) -> None:
    """B-63174EN section 4.2: X20.0 C40.0 F300.0 takes 0.14907 min, C turns at 268.3 deg/min."""
    job = read(tmp_path, winder, "G91 G1 X20.0 A40.0 F300.0", feed_mode="fanuc")
    (taken,) = minutes(job, winder)
    assert taken == pytest.approx(0.14907, abs=5e-6)  # half of the last printed digit
    assert 40.0 / taken == pytest.approx(268.3, abs=0.05)


def test_marlin_as_its_planner_reckons(tmp_path: Path, winder: Machine) -> None:
    """Its comments: 60 mm of X Y Z at 120 mm/s, and 60 degrees alone at 120 deg/s, take 0.5 s."""
    lines = ("G91 G1 F7200", "X36 Y48", "A60", "X36 Y48 A60", "X60 A3600")
    job = read(tmp_path, winder, *lines, feed_mode="marlin")
    assert [60.0 * t for t in minutes(job, winder)] == pytest.approx([0.5] * 4, rel=1e-12)


@pytest.mark.parametrize("rule", ["cadfil", "grbl", "fluidnc"])
def test_all_axes_in_one_length(tmp_path: Path, winder: Machine, rule: str) -> None:
    """CADFIL's report: each block takes sqrt(A^2 + X^2 + Y^2) / F, with A in degrees."""
    rng = random.Random(3)
    steps = [[round(rng.uniform(-9, 9), 3) for _ in range(3)] for _ in range(50)]
    lines = [f"X{x} Y{y} A{a} F{100 + k}" for k, (x, y, a) in enumerate(steps)]
    job = read(tmp_path, winder, "G91 G1", *lines, feed_mode=rule)
    reported = [math.hypot(*step) / (100 + k) for k, step in enumerate(steps)]

    assert minutes(job, winder) == pytest.approx(reported, rel=1e-9)
    assert programmed_time_s(job, winder) == pytest.approx(60 * sum(reported), rel=1e-9)
    assert job.feed_rule == rule


@pytest.mark.linuxcnc
@pytest.mark.parametrize("rule", ["linuxcnc", "rs274"])
def test_linuxcnc_by_its_own_interpreter(tmp_path: Path, winder: Machine, rule: str) -> None:
    """In G93 with F 1 the interpreter sets the rate at which a move takes a minute.

    This rate is LinuxCNC's own length of the move. Given as F in G94 it has to make every move take
    a minute here, to the 4 printed decimals.
    """
    rs274 = shutil.which("rs274")
    if rs274 is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    rng = random.Random(7)
    moves = []
    for _ in range(30):
        names = rng.sample("AXY", rng.randint(1, 3))
        out = " ".join(f"{n}{rng.uniform(20, 90):.3f}" for n in names)
        moves += [out, re.sub(r"([AXY])", r"\1-", out)]
    program = tmp_path / "theirs.ngc"
    program.write_text("\n".join(["G21 G91 G93", *(f"G1 {m} F1" for m in moves), "M2"]) + "\n")
    output = interpreted(rs274, program)
    rates = re.findall(r"SET_FEED_RATE\(([\d.]+)\)[^S]*STRAIGHT_FEED", output)
    assert len(rates) == len(moves)

    lines = [f"G1 {m} F{rate}" for m, rate in zip(moves, rates, strict=True)]
    job = read(tmp_path, winder, "G21 G91", *lines, feed_mode=rule)
    assert minutes(job, winder) == pytest.approx([1.0] * len(moves), rel=1e-5)


@pytest.mark.parametrize("kernel", [True, False])
def test_degrees_have_no_inches(tmp_path: Path, winder: Machine, kernel: bool) -> None:
    """RS274/NGC 2.1.2.5: a move of rotary axes alone has F in degrees a minute, in G20 too."""
    lines = ("G20 G91 G1 F120", "A60", "X1 A60", "A60", "G21 A60", "A60 F60", "X25.4")
    try_it = PlainReader.worth_trying if kernel else lambda _: False
    with patch.object(PlainReader, "worth_trying", try_it):
        job = read(tmp_path, winder, *lines, feed_mode="linuxcnc")
        taken = minutes(job, winder)
    expected = [0.5, 1 / 120, 0.5, 0.5, 1.0, 25.4 / 60]
    assert taken == pytest.approx(expected, rel=1e-12)


def test_the_machine_file_names_the_rule(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('base = "lathe-winder"\nname = "m"\n[programs]\nfeed_mode = "grbl"\n')
    machine = load_machine(file)
    job = read(tmp_path, machine, "G91 G1 X3 A4 F5")
    assert (job.feed_rule, minutes(job, machine)) == ("grbl", [pytest.approx(1.0)])
    other = read(tmp_path, machine, "G91 G1 X3 A4 F5", feed_mode="linuxcnc")
    assert (other.feed_rule, minutes(other, machine)) == ("linuxcnc", [pytest.approx(0.6)])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('feed_mode = "gbrl"', "programs.feed_mode"),
        ('feed_mode = "base-axes"', "base_axes and feed_mode"),
        ('base_axes = ["A"]', "base_axes and feed_mode"),
        ('feed_mode = "base-axes"\nbase_axes = ["Q"]', "programs.base_axes names the axis 'Q'"),
    ],
)
def test_a_rule_that_is_none_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "lathe-winder"\n[programs]\n{text}\n')
    with pytest.raises(MachineError, match=re.escape(message)):
        load_machine(file)


def test_a_rule_without_u_is_refused_on_a_machine_with_u(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    text = library_file("lathe-winder").read_text(encoding="utf-8")
    file.write_text(text.replace("axes.Y", "axes.U").replace('axis = "Y"', 'axis = "U"'))
    machine = load_machine(file)
    with pytest.raises(OptionError, match="RS274/NGC does not say what F means to the axis U"):
        read(tmp_path, machine, "G91 G1 X3 U4 F5", feed_mode="rs274")
    lines = ("G91 G1 X3 U4 F5", "U4 A10", "A10")
    job = read(tmp_path, machine, *lines, feed_mode="linuxcnc")
    assert minutes(job, machine) == pytest.approx([0.6, 0.8, 2.0])


def test_an_operator_stays_at_his_machine(tmp_path: Path, winder: Machine) -> None:
    """F 12000 is 200 mm/s on a machine made from the winder; 10 count/tick of X were 36 mm/s."""
    job = read(tmp_path, winder, "G91 G1 X100 F12000")
    assert job.suspicions(own_feed=True) == ()
    assert minutes(job, winder)[0] * 60.0 == pytest.approx(0.5)
    old = read(tmp_path, WINDER, "G91 G1 X100 F12000")
    assert minutes(old, WINDER)[0] * 60.0 > 2.0
    assert "caps it" in old.capped[0]
    assert programmed_time_s(old, WINDER) == pytest.approx(0.5)  # the speed by F alone


def test_rapids_dwells_and_repeats_count(tmp_path: Path, winder: Machine) -> None:
    """Nominal time: rapids at the velocity limit, dwells, and all passes."""
    lines = ("G91 G1 F60", "M98 P2 L1000", "M30", "O2", "X1", "G4 P2", "G0 X-1", "G1", "M99")
    path = tmp_path / "a.nc"
    path.write_text("\n".join(lines) + "\n")
    job = read_job(path, winder)
    limit_m_s = float(winder.velocity_limit[winder.axis_names.index("X")])
    assert programmed_time_s(job, winder) == pytest.approx(1000 * (3.0 + 1e-3 / limit_m_s))
    assert isinstance(next(iter(job)), Move)
