"""Drawings of CAD and vector programs, from the command line to the verdict."""

from __future__ import annotations

import json
import math
from pathlib import Path

import ezdxf
import pytest

from threadline.cli.main import main
from threadline.jobs import read_job
from threadline.jobs.operations import Dwell, FeedMode, Move
from threadline.machine import load_machine

STITCHING = '[stitching]\nstitch_length = "2 mm"\nneedle_speed = "10 stitch/s"\n'


def drawn(folder: Path) -> Path:
    """Return a DXF with a spline, a block that is scaled and turned, and a text."""
    drawing = ezdxf.new("R2010")
    drawing.units = ezdxf.units.MM
    space = drawing.modelspace()
    space.add_spline([(0, 0), (20, 10), (40, 0), (60, -10)], dxfattribs={"layer": "SPLINE"})
    block = drawing.blocks.new("EAR")
    block.add_line((0, 0), (20, 0), dxfattribs={"layer": "BLOCK"})
    block.add_arc((20, 10), 10, -90, 90, dxfattribs={"layer": "BLOCK"})
    turned = {"xscale": 2, "yscale": 2, "rotation": 30}
    space.add_blockref("EAR", (10, 10), dxfattribs=turned)
    space.add_text("HELLO", dxfattribs={"layer": "TEXT"})
    drawing.saveas(folder / "drawing.dxf")
    return folder / "drawing.dxf"


def prove(
    capsys: pytest.CaptureFixture[str], job: str, machine: str, *more: str
) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["prove", job, "-m", machine, *more])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, " ".join(captured.err.split())


def seam(folder: Path, layer: str) -> str:
    file = folder / f"{layer.lower()}.seam.toml"
    file.write_text(
        f'[drawing]\nfile = "drawing.dxf"\n{STITCHING}[[seam]]\nname = "a"\nlayer = "{layer}"\n'
    )
    return str(file)


@pytest.mark.long(but="BLOCK")
@pytest.mark.parametrize("layer", ["SPLINE", "BLOCK"])
def test_splines_and_blocks_are_sewn(
    layer: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The errors are finite: a spline begins only a rounding away from its stated point."""
    drawn(tmp_path)
    code, out, err = prove(capsys, seam(tmp_path, layer), "stitcher", "--json")
    assert code in {0, 1}, err
    measured = {c["name"]: c["measured"] for c in json.loads(out)["criteria"]}
    assert measured["contour_error"] is not None and 1e-5 < measured["contour_error"] < 2e-3
    # With one pace for each whole piece of the path the needle would wait by 40 % of a turn.
    assert measured["needle_time_error"] < 0.25


def test_text_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn(tmp_path)
    code, _, err = prove(capsys, seam(tmp_path, "TEXT"), "stitcher")
    assert code == 2
    assert "text 'HELLO' cannot be sewn" in err


def test_unstable_machine_is_named_before_planning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A user's machine, based on one of the library, is judged by the base's specification."""
    drawn(tmp_path)
    machine = tmp_path / "mine.toml"
    machine.write_text(
        'base = "stitcher"\nname = "mine"\n[controllers.x]\ngain = "2.5 dac/count exact, assumed"\n'
    )
    code, _, err = prove(capsys, seam(tmp_path, "SPLINE"), str(machine))
    assert code == 2
    assert "axis X: the loop is UNSTABLE" in err and "0.845 times the gain" in err


def test_a_drawing_of_inkscape_is_proven(capsys: pytest.CaptureFixture[str]) -> None:
    """Two contours, a curve and a turned rounded rectangle, in spec with the exact inverse.

    This holds by place and length, in one run: the worst of 20 runs uses 101 % of the stitch
    length, and the head takes 2.4 stitches to its speed.
    """
    job = Path(__file__).parents[2] / "examples" / "yoke.seam.toml"
    place = str(job.with_name("stitcher-place.spec.toml"))
    words = ("-s", place, "--feed-forward", "--nominal", "--json")
    code, out, err = prove(capsys, str(job), "stitcher", *words)
    assert code == 0, err
    content = json.loads(out)
    assert content["passed"] is True
    # 250 mm of seam at 62.5 mm/s, and two journeys at 40 mm/s.
    assert content["duration_s"] > 6.0


def test_the_head_travels_gently_and_settles(tmp_path: Path) -> None:
    """The job states the speed of a journey and the rest after it, before the first stitch."""
    file = tmp_path / "line.seam.toml"
    slow = 'travel_speed = "40 mm/s"\nsettle = "0.3 s"\n'
    contour = '[[contour]]\nunit = "mm"\npoints = [[10, 0], [40, 0]]\n'
    file.write_text(STITCHING + slow + contour)
    travel, rest, *_ = read_job(file, load_machine("stitcher"))
    assert isinstance(travel, Move) and travel.feed is not None
    assert (travel.feed.mode, travel.feed.value) == (FeedMode.PATH, pytest.approx(0.04))
    assert isinstance(rest, Dwell) and rest.duration_s == pytest.approx(0.3)


def test_a_journey_left_to_the_program_keeps_the_contour(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """X at 11.93 Hz, Y at 16.5 and 30.9 Hz: half of 0.5 mm at 75 rad/s, ln 5 / 15 1/s."""
    file = tmp_path / "two.seam.toml"
    contours = "".join(
        f'[[contour]]\nunit = "mm"\npoints = [[10, {y}], [40, {y}]]\n' for y in (0, 40)
    )
    plain = STITCHING + 'motion = "discrete"\n'
    found = {}
    for name, journey in (("left", ""), ("fast", 'travel_speed = "190 mm/s"\nsettle = "0 s"\n')):
        file.write_text(plain + 'travel_speed = "fastest"\n' + contours)
        hurried = next(iter(read_job(file, load_machine("stitcher"))))
        assert isinstance(hurried, Move) and hurried.feed is not None
        assert hurried.feed.mode is FeedMode.RAPID
        file.write_text(plain + journey + contours)
        _, out, _ = prove(capsys, str(file), "stitcher", "--json")
        measured = {c["name"]: c["measured"] for c in json.loads(out)["criteria"]}
        found[name] = measured["contour_error"]
        if not journey:
            travel, rest, *_ = read_job(file, load_machine("stitcher"))
    file.write_text(plain + contours.replace("10, 0", "0, 0"))
    _, first, *_ = read_job(file, load_machine("stitcher"))
    assert not isinstance(first, Dwell)  # at its present place the head does not swing
    assert found["left"] < 5e-4 < found["fast"]
    assert isinstance(travel, Move) and travel.feed is not None
    assert travel.feed.value == pytest.approx(0.5 * 5e-4 * 74.98, rel=1e-3)
    # The slowest decay decides: 30.9 Hz at 0.0225 if it swings enough, 11.93 Hz at 0.2.
    swings = [(74.98, 0.2001), (103.96, 0.12825), (194.33, 0.02249)]
    speed = travel.feed.value
    longest = max(math.log(speed / (w * 5e-5)) / (z * w) for w, z in swings)
    assert isinstance(rest, Dwell) and rest.duration_s == pytest.approx(longest, rel=1e-3)
