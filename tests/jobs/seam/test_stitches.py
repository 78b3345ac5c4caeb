"""Stitches: lengths within tolerance, a stitch in every corner, the clock of the needle."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from threadline.errors import JobError
from threadline.jobs import read_job
from threadline.jobs.operations import Dwell, FeedMode, Job, Move, MoveRun, Operation, ToolEvent
from threadline.jobs.seam import read_seam
from threadline.jobs.seam.corners import swinging_modes
from threadline.jobs.seam.placement import stitch_count, stitch_lengths
from threadline.jobs.seam.settings import Accelerations, Stitching
from threadline.machine import Machine, load_machine
from threadline.motion.path import programmed_path
from threadline.sizing import corner_error_m

SPEED = {"stitch_length": "2.5 mm", "needle_speed": "50 stitch/s"}
SQUARE = "points = [[0, 0], [100, 0], [100, 100], [0, 100]]\nclosed = true"


def sew(folder: Path, machine: Machine, contour: str, **options: object) -> Job:
    path = folder / "t.seam.toml"
    path.write_text(f'[[contour]]\nunit = "mm"\n{contour}\n', encoding="utf-8")
    return read_seam(path, machine, **{**SPEED, **options})


def stitches(job: Job) -> list[Move]:
    return [op for op in job if isinstance(op, Move) and op.tags["kind"] != "travel"]


def places(job: Job) -> np.ndarray:
    """Return (n + 1, 2) needle-downs, mm; the first is the end of the travel."""
    return np.array([op.target for op in job if isinstance(op, Move)]) * 1e3


def tag(job: Job, name: str) -> np.ndarray:
    return np.array([op.tags[name] for op in stitches(job)])


def untagged(operation: Operation) -> Operation:
    return replace(operation, tags={}) if isinstance(operation, Move) else operation


def test_printed_test_path_under_the_two_stitch_rule(sewer: Machine, examples: Path) -> None:
    """Discrete motion: each leg of 25 stitch lengths takes 27 turns, 1/4 and 3/4 at its ends."""
    job = read_seam(examples / "stitcher-test-path.seam.toml", sewer)
    lengths = tag(job, "length_m") / 2.54e-3

    leg = [0.25, 0.75, *[1.0] * 23, 0.75, 0.25]
    assert lengths == pytest.approx(leg * 3, abs=1e-9)
    assert tag(job, "exempt").tolist() == [1, 1, *[0] * 23, 1, 1] * 3
    assert tag(job, "needle_s") == pytest.approx(np.arange(1, 82) / 75.0, rel=1e-15)
    assert [k for k, corner in enumerate(tag(job, "corner")) if corner] == [26, 53]
    assert all(op.feed.mode is FeedMode.INVERSE_TIME for op in stitches(job))
    # v = needle speed x stitch length in the middle of a leg: 7.5 in/s.
    assert lengths[10] * 2.54e-3 * stitches(job)[10].feed.value / 0.0254 == pytest.approx(7.5)
    kinds = [type(op).__name__ for op in job if not isinstance(op, Move)]
    assert kinds == ["ToolEvent", "Dwell", "Dwell", "ToolEvent"]
    assert job.warnings == ()


@pytest.mark.parametrize(("down", "more"), [(9, {}), (5, {"deceleration": "5 m/s^2"})])
def test_needle_places_are_those_of_a_trapezoid(
    down: float, more: dict[str, str], sewer: Machine, tmp_path: Path
) -> None:
    """For any acceleration: an independently integrated trapezoid at the needle's clock."""
    job = sew(
        tmp_path, sewer, "points = [[0, 0], [80, 0]]", motion="discrete", acceleration="9 m/s^2",
        **more,
    )  # fmt: skip
    x, n = places(job)[:, 0] * 1e-3, len(stitches(job))
    t = np.linspace(0, n / 50.0, n * 4000 + 1)
    v = np.minimum(np.minimum(9 * t, down * (t[-1] - t)), np.diff(x).max() * 50)
    travelled = np.concatenate([[0], np.cumsum((v[1:] + v[:-1]) / 2 * np.diff(t))])

    assert x == pytest.approx(travelled[::4000], abs=2e-8)
    assert x[-1] == pytest.approx(0.08, abs=1e-15)


@pytest.mark.parametrize(("up", "down"), [(4.0, 4.0), (4.0, 1.5), (1.5, 4.0)])
def test_slowed_needle_speeds_up_and_slows_down_as_told(
    up: float, down: float, sewer: Machine, tmp_path: Path
) -> None:
    """A leg from rest to rest takes L/v + v/2a + v/2d; corners are passed at their own speed."""
    slowed = {"needle": "slowed", "acceleration": f"{up} m/s^2", "deceleration": f"{down} m/s^2"}
    job = sew(tmp_path, sewer, "points = [[0, 0], [80, 0]]", motion="discrete", **slowed)
    v = 0.125
    assert tag(job, "needle_s")[-1] == pytest.approx(0.08 / v + v / 2 / up + v / 2 / down)

    job = sew(
        tmp_path, sewer, "points = [[0, 0], [40, 0], [40, 40]]", placement="0.3 mm", **slowed
    )  # fmt: skip
    at_corner = int(np.flatnonzero(tag(job, "corner"))[0])
    # The first leg, from rest to the speed c of the corner: up to v and down to c.
    time = float(tag(job, "needle_s")[at_corner])
    c = brentq(lambda c: corner_error_m(c, up, np.pi / 2, down) - 3e-4, 1e-3, 1.0)
    covered = v**2 / 2 / up + (v**2 - c**2) / 2 / down
    expected = v / up + (v - c) / down + (0.04 - covered) / v
    assert c < v and time == pytest.approx(expected, rel=1e-6)


@given(st.floats(0.2e-3, 0.3), st.booleans(), st.booleans(), st.floats(1e-3, 4e-3))
def test_lengths_fill_the_leg_and_keep_the_tolerance(
    length: float, first: bool, last: bool, expected: float
) -> None:
    """On any leg, only the exempt stitches may be off by more than half the tolerance."""
    settings = Stitching(stitch_length_m=expected, needle_speed_hz=50.0)
    a = settings.speed_m_s**2 / (2 * expected)
    lengths = stitch_lengths(length, settings, Accelerations(a, a), (first, last))

    assert lengths.sum() == pytest.approx(length, rel=1e-12)
    assert (lengths > 0).all()
    middle = lengths[2:-2]
    assert np.abs(middle / expected - 1).max(initial=0.0) < 0.025 + 1e-9
    # Exempt stitches absorb the remainder; none grows beyond a stitch and a half.
    assert lengths.max() < 1.5 * expected


@given(st.floats(1e-3, 0.3), st.floats(0.02, 50.0), st.sampled_from([(True, False), (True, True)]))
def test_no_other_number_of_stitches_is_nearer_to_the_wanted_length(
    length: float, a: float, rests: tuple[bool, bool]
) -> None:
    """All numbers that a trapezoid of speed can make are tried: n l - r N^2 l^2 / 2 a.

    A leg too short for its ramps once had far too many: 157 million on 20 mm.
    """
    settings = Stitching(stitch_length_m=2.5e-3, needle_speed_hz=40.0)
    loss = sum(rests) * 40.0**2 / (2 * a)
    n = np.arange(1.0, 2000.0)
    rows = np.stack([n / loss, np.full(len(n), -length / loss)], axis=1)  # as np.roots has them
    roots = np.linalg.eigvals(np.stack([rows, np.tile([1.0, 0.0], (len(n), 1))], axis=1))
    real = ~roots.imag.any(axis=1)
    far = np.abs(np.log(roots.real.min(axis=1) / 2.5e-3))
    off = dict(zip(n[real].tolist(), far[real].tolist(), strict=True))
    count = stitch_count(length, settings, Accelerations(a, a), rests)
    # A double root comes out complex where it is rounded: then the next number is the best.
    assert off.get(count, 0.0) <= min(off.values()) + 1e-9


@pytest.mark.parametrize("rests", [(False, False), (True, False), (True, True)])
def test_legs_of_few_stitches_keep_the_tolerance(rests: tuple[bool, bool]) -> None:
    """11.44 stitches long: 4 to 5 % too much for each without the four at the ends."""
    settings = Stitching(stitch_length_m=2e-3, needle_speed_hz=50.0)
    a = settings.speed_m_s**2 / (2 * 2e-3)
    lengths = stitch_lengths(11.44 * 2e-3, settings, Accelerations(a, a), rests)
    assert lengths.sum() == pytest.approx(11.44 * 2e-3)
    assert lengths[2:-2] / 2e-3 == pytest.approx(1.025, abs=1e-9)


def test_corners_get_a_stitch_and_chords_are_even(sewer: Machine, tmp_path: Path) -> None:
    job = sew(tmp_path, sewer, SQUARE)
    at = places(job)

    for corner in ([100, 0], [100, 100], [0, 100], [0, 0]):
        assert np.abs(at - corner).max(axis=1).min() < 1e-9
    assert tag(job, "corner").sum() == 3  # the fourth is where the seam starts and ends
    assert (np.abs(tag(job, "length_m") / 2.5e-3 - 1)[tag(job, "exempt") == 0] < 1e-9).all()


def test_tight_circle_is_sewn_in_even_chords(sewer: Machine, tmp_path: Path) -> None:
    """Radius 4 mm: the arcs are 4 % longer than their chords; all chords come out alike."""
    circle = 'points = [[4, 0], {to = [4, 0], centre = [0, 0], turn = "ccw"}]'
    job = sew(tmp_path, sewer, circle, needle="slowed")
    chords = tag(job, "length_m")

    assert np.ptp(chords) < 2e-3 * chords.mean()
    n = len(chords)
    assert chords.mean() == pytest.approx(8e-3 * np.sin(np.pi / n), rel=1e-6)
    assert np.hypot(*places(job).T) == pytest.approx(4.0, abs=1e-9)


def test_ellipse_keeps_chords_even_where_it_bends(sewer: Machine, tmp_path: Path) -> None:
    """By arc length alone, chords at the tips (radius 1.25 mm) would be 13 % short."""
    svg = tmp_path / "e.svg"
    svg.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="50mm" '
        'viewBox="0 0 100 50"><ellipse cx="40" cy="20" rx="20" ry="5" stroke="red"/></svg>'
    )
    job = read_seam(
        svg, sewer, stitch_length="2 mm", needle_speed="50 stitch/s", needle="slowed", bow="0.5 mm"
    )
    middle = tag(job, "length_m")[2:-2]

    assert np.ptp(middle) < 0.01 * middle.mean()


def test_slowed_needle_keeps_length_and_the_motor_its_acceleration(
    sewer: Machine, tmp_path: Path
) -> None:
    """Lengths stay even; head and needle speed change no faster than allowed."""
    job = sew(
        tmp_path, sewer, SQUARE, needle="slowed", motion="discrete",
        acceleration="20 m/s^2", needle_acceleration="1500 stitch/s^2",
    )  # fmt: skip
    lengths, ends = tag(job, "length_m"), tag(job, "needle_s")
    times = np.diff(ends, prepend=0.0)
    assert lengths == pytest.approx(2.5e-3, rel=1e-9)

    # On one leg: 40 stitches, from rest to rest, ramp v^2 / (2 a) with a = 1500 x 2.5 mm.
    a, v = 1500 * 2.5e-3, 0.125
    s = np.linspace(0, 0.1, 41)
    ramp = v**2 / (2 * a)
    clock = np.where(s < ramp, np.sqrt(2 * np.minimum(s, ramp) / a), v / a + (s - ramp) / v)
    expected = np.diff(np.concatenate([clock[:21], 2 * clock[20] - clock[:20][::-1]]))
    assert times[:40] == pytest.approx(expected, rel=1e-9)
    assert times[:40].sum() == pytest.approx(0.1 / v + v / a, rel=1e-9)
    # Feed and clock are one: a move lasts what its feed says.
    feeds = np.array([op.feed.value for op in stitches(job)])
    assert 1 / feeds == pytest.approx(times, rel=1e-9)


def test_slowed_needle_passes_corners_at_the_speed_of_the_placement(
    sewer: Machine, tmp_path: Path
) -> None:
    """sqrt(2) v^2 / (8 a) = placement at a right angle; exact times of the stitches around it."""
    job = sew(
        tmp_path, sewer, SQUARE, needle="slowed", acceleration="10 m/s^2", placement="0.05 mm"
    )
    times = np.diff(tag(job, "needle_s"), prepend=0.0)
    v = np.sqrt(0.05e-3 * 8 * 10 / np.sqrt(2))
    # Constant acceleration over the stitch before the corner, up to the full speed.
    reached = min(0.125, np.sqrt(v**2 + 2 * 10 * 2.5e-3))
    ramp_s = (reached - v) / 10
    whole = ramp_s + (2.5e-3 - (reached**2 - v**2) / 20) / reached
    assert times[39] == pytest.approx(whole, rel=1e-9)
    assert times[40] == pytest.approx(whole, rel=1e-9)
    assert times[20] == pytest.approx(1 / 50, rel=1e-9)


def test_slowed_needle_minds_tight_bends(sewer: Machine, tmp_path: Path) -> None:
    """A circle of 2 mm at 4 m/s^2: v = sqrt(a r), far below the programmed speed."""
    circle = 'points = [[2, 0], {to = [2, 0], centre = [0, 0], turn = "cw"}]'
    job = sew(
        tmp_path, sewer, circle, needle="slowed", acceleration="4 m/s^2",
        stitch_length="0.5 mm", needle_speed="300 stitch/s",
    )  # fmt: skip
    times = np.diff(tag(job, "needle_s"), prepend=0.0)
    middle = slice(6, -6)
    speed = tag(job, "length_m")[middle] / times[middle]
    assert speed == pytest.approx(np.sqrt(4 * 2e-3), rel=5e-3)


def test_lock_stitches_go_forth_and_back(sewer: Machine, tmp_path: Path) -> None:
    job = sew(
        tmp_path, sewer, "points = [[0, 0], [50, 0]]",
        lock_start=3, lock_end=2, needle="slowed", motion="discrete",
    )  # fmt: skip
    x = places(job)[:, 0]
    kinds = [op.tags["kind"] for op in stitches(job)]

    expected = [0, 2.5, 5, 7.5, 5, 2.5, *np.arange(0, 50.1, 2.5), 47.5, 45, 47.5, 50]
    assert x == pytest.approx(expected, abs=1e-9)
    assert kinds == ["lock"] * 6 + ["sew"] * 20 + ["lock"] * 4
    # The head rests at each reversal, so that no interpolation rounds it off.
    assert sum(isinstance(op, Dwell) for op in job) == 4
    assert tag(job, "stitch").tolist() == list(range(30))


def test_start_end_overlap_and_reverse(sewer: Machine, tmp_path: Path) -> None:
    begin = places(sew(tmp_path, sewer, SQUARE, start="150 mm", end="600 mm"))
    assert begin[0] == pytest.approx([100, 50])
    assert begin[-1] == pytest.approx([0, 0], abs=1e-9) or begin[-1] == pytest.approx([100, 100])
    assert begin[-1] == pytest.approx([100, 100])  # 600 mm is 200 mm into the second lap
    back = places(sew(tmp_path, sewer, "points = [[0, 0], [30, 0], [30, 10]]", reverse=True))
    assert back[0] == pytest.approx([30, 10])
    assert back[-1] == pytest.approx([0, 0])


def test_many_contours_each_with_travel_and_trim(sewer: Machine, examples: Path) -> None:
    job = read_seam(examples / "badge.seam.toml", sewer)
    events = [op for op in job if isinstance(op, ToolEvent)]
    travels = [op for op in job if isinstance(op, Move) and op.tags["kind"] == "travel"]

    assert [e.name for e in events] == ["sew", "trim"] * 5
    assert len(travels) == 5
    assert all(t.feed.mode is FeedMode.RAPID for t in travels)
    by_contour = defaultdict(list)
    for op in stitches(job):
        by_contour[op.tags["seam"], op.tags["contour"]].append(op.tags["needle_s"])
    assert list(by_contour) == [
        ("SEAM", 0), ("SEAM", 1), ("PETALS", 2), ("PETALS", 3), ("PETALS", 4)
    ]  # fmt: skip
    for clock in by_contour.values():
        assert clock == pytest.approx(np.arange(1, len(clock) + 1) / 40.0)


def test_every_example_is_in_tolerance_and_replays(sewer: Machine, examples: Path) -> None:
    """All seams of the project, read twice as streams, and once as a path.

    Each is for the machine of its own name, if there is one.
    """
    for path in sorted(examples.glob("*.seam.toml")):
        own = path.with_name(path.name.replace(".seam.toml", ".toml"))
        machine = load_machine(own) if own.exists() else sewer
        job = read_seam(path, machine)
        assert job.warnings == (), path.name
        first, second = list(job), list(job)
        assert first == second
        free = tag(job, "exempt") == 0
        off = np.abs(tag(job, "length_m") / tag(job, "target_m") - 1)[free]
        assert off.max() <= 0.05, path.name
        runs = [op for item in job.runs() for op in (item if isinstance(item, MoveRun) else [item])]
        assert [untagged(op) for op in runs] == [untagged(op) for op in first]
        vertices = sum(len(block) for block in programmed_path(job, machine))
        assert vertices == 1 + sum(isinstance(op, Move) for op in first)


def test_inside_allowance_shifts_the_stitches(sewer: Machine, tmp_path: Path) -> None:
    at = places(sew(tmp_path, sewer, SQUARE, allowance="5 mm", side="inside"))
    distance = np.minimum(at, 100 - at).min(axis=1)
    assert distance == pytest.approx(5.0, abs=1e-6)


def test_a_trim_takes_its_time(sewer: Machine, examples: Path) -> None:
    """The head rests at the end of each contour before it travels; stitches are unchanged."""
    job = read_seam(examples / "pocket.seam.toml", sewer, trim="300 ms", settle="0 s")
    plain = read_seam(examples / "pocket.seam.toml", sewer, settle="0 s")
    operations = list(job)
    trims = [
        k for k, op in enumerate(operations) if isinstance(op, ToolEvent) and op.name == "trim"
    ]

    assert len(trims) > 1
    for k in trims:
        rest = operations[k + 1]
        assert isinstance(rest, Dwell) and rest.duration_s == 0.3
        assert rest.source == operations[k].source
    without = [op for k, op in enumerate(operations) if k - 1 not in trims]
    assert without == list(plain)


def test_needle_speed_scales_the_clock_only(sewer: Machine, tmp_path: Path) -> None:
    """``fastest`` varies the speed: at interpolated corners the places stay, the times shrink."""
    slow = sew(tmp_path, sewer, SQUARE, needle="slowed", needle_speed="20 stitch/s")
    fast = sew(tmp_path, sewer, SQUARE, needle="slowed", needle_speed="40 stitch/s")
    assert places(slow) == pytest.approx(places(fast), abs=1e-9)
    assert tag(slow, "needle_s")[-1] > 1.9 * tag(fast, "needle_s")[-1]


def test_a_million_stitches_stream(sewer: Machine, tmp_path: Path) -> None:
    """2 km of zigzag in 1000 runs of 2 m; the stream is read in part, so nothing is kept."""
    rows = ["x [m],y [m]"]
    for k in range(1000):
        x = (0, 2) if k % 2 == 0 else (2, 0)
        rows += [f"{x[0]},{k * 2e-3}", f"{x[1]},{k * 2e-3}"]
    path = tmp_path / "big.csv"
    path.write_text("\n".join(rows))
    job = read_seam(
        path, sewer, stitch_length="2 mm", needle_speed="50 stitch/s", motion="discrete"
    )

    count = 0
    for op in job:
        if isinstance(op, Move):
            count += 1
        if count > 30_000:
            break
    assert op.tags["seam"] == "seam"
    assert len(next(iter(programmed_path(job, sewer)))) < 10_000
    assert job.warnings == ()


def test_drawing_alone_needs_to_be_told_how(sewer: Machine, examples: Path) -> None:
    with pytest.raises(JobError, match=r"stitch_length is not given.*seam\.toml"):
        read_seam(examples / "pocket.dxf", sewer)
    job = read_seam(examples / "pocket.dxf", sewer, **SPEED)
    assert {op.tags["seam"] for op in stitches(job)} == {"POCKET", "MARKS"}


def test_read_job_knows_seams(sewer: Machine, examples: Path) -> None:
    """By their endings, ``.seam.toml`` before ``.toml``; with the settings as options."""
    assert read_job(examples / "pocket.seam.toml", sewer).name == "pocket.seam.toml"
    job = read_job(examples / "strap.csv", sewer, **SPEED)
    slower = read_job(examples / "strap.csv", sewer, **{**SPEED, "needle_speed": "25 stitch/s"})
    assert tag(slower, "needle_s")[-1] > 1.9 * tag(job, "needle_s")[-1]
    assert job.sha256 == slower.sha256


def test_a_frame_on_pulse_servos_is_sewn(tmp_path: Path) -> None:
    """It has no loops; a mode of 70 Hz rings while its drives stand, as its file says."""
    frame = replace(load_machine("table-embroiderer"), shaft=None, tables=None)
    job = sew(tmp_path, frame, "points = [[0, 0], [100, 0], [100, 100]]")
    assert len(stitches(job)) >= 80  # of 2.5 mm over 200 mm, and the locks
    found = [mode.frequency_hz for mode in swinging_modes(frame, ("X", "Y"))]
    assert found == pytest.approx([70.0, 70.0], rel=1e-3)
