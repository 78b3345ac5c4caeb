"""An operator's work with stored runs, teach-in, a program's zero and drawings, in a browser."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.panel.browsing import (
    Browser,
    calculate,
    expect,
    held_and_let_go,
    opened,
    part,
    press,
    reached,
    ready,
    shot,
    stands,
    state,
    typed,
)
from tests.panel.test_panel_killed import Plant
from threadline.files.formats import read_recording
from threadline.jobs.operations import Move
from threadline.machine import load_machine
from threadline.panel import drawings
from threadline.panel.thinned_traces import thinned
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job


@pytest.mark.long(shown_by="test_a_report_of_a_run_that_cannot_be_judged_says_why")
def test_the_trace_after_a_run_and_its_export(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    """The exported file is the recording; thinning keeps the peak of the deviation."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press(page, "Start")
    expect(page.locator("#progress-text")).to_contain_text("completed", timeout=60_000)
    part(page, "Review")
    expect(page.locator("#kept")).to_contain_text("completed")
    expect(page.locator("#trace .uplot")).to_have_count(2, timeout=60_000)
    expect(page.get_by_role("button", name="STOP")).to_be_visible()
    shot(page, "11-trace")
    with page.expect_download() as download:
        press(page, "Export")
    file = tmp_path / "out.csv"
    download.value.save_as(file)
    kept = next((tmp_path / "runs").glob("*/trace.mcap"))
    exported, recorded = read_recording(file), read_recording(kept)
    measured = recorded.samples("X.measured")[1]
    assert exported.samples("X.measured")[1] == pytest.approx(measured, abs=1e-9)
    trace = thinned(recorded)["axes"]["X"]
    deviation = recorded.samples("X.load")[1] - recorded.samples("X.commanded")[1]
    shown = np.array(trace["actual"]) - np.array(trace["commanded"])
    assert np.abs(shown).max() == pytest.approx(np.abs(deviation).max(), abs=2e-8)
    with page.expect_download(timeout=120_000) as download:
        press(page, "Report")
    report = tmp_path / "report.pdf"
    download.value.save_as(report)
    assert report.read_bytes().startswith(b"%PDF-")
    expect(page.get_by_role("button", name="Report", exact=True)).to_be_enabled()
    page.close()


def test_a_report_of_a_run_that_cannot_be_judged_says_why(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    """The program was changed after the run, so the run can no longer be judged."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    press(page, "Start")
    expect(page.locator("#progress-text")).to_contain_text("completed", timeout=60_000)
    part(page, "Review")
    expect(page.locator("#kept")).to_contain_text("completed")
    for program in tmp_path.glob("*.prg"):
        program.write_text(program.read_text() + "\n")
    press(page, "Report")
    expect(page.locator("#toasts")).to_contain_text(
        "recorded from another version of there.prg", timeout=120_000
    )
    page.close()


def test_three_points_are_taught_and_checked_like_any_program(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    page = opened(browser, plant)
    ready(page)
    for k, (label, axis) in enumerate((("X plus", "X"), ("Y plus", "Y"), ("X minus", "X"))):
        page.get_by_label(f"Jog {label} while held").focus()
        held_and_let_go(page, f"Jog {label}", 2.0, axis)
        page.keyboard.press("p")
        expect(page.locator("#taught tr")).to_have_count(k + 1)
    part(page, "Teach")
    shot(page, "12-taught")
    press(page, "Save program")
    part(page, "Run")
    expect(page.locator("#program")).to_have_value("taught.prg")
    lines = (tmp_path / "taught.prg").read_text("utf-8").splitlines()
    assert lines[:4] == ["%", "O 1;", "G90;", "G01 F 2000;"]
    assert len(lines) == 9
    expect(page.get_by_role("button", name="Start")).to_be_disabled()
    page.close()


def test_the_programs_zero_is_where_the_machine_was_moved(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    ready(page)
    page.locator("#step").select_option("10")
    for _ in range(20):  # a jog that was renewed too late has ended before its 10 mm
        page.get_by_label("Jog X plus while held").hover()
        page.mouse.down()
        far = reached(page, "> 9.0")  # the loop has not settled when the time of this machine stops
        page.mouse.up()
        stands(page)
        if far:
            break
        press(page, "Zero all")
        reached(page, "== 0")
    state(page, "idle")
    part(page, "Prepare")
    page.locator("summary", has_text="Expert options").click()
    press(page, "Program's zero is here")
    expect(page.locator("#offset")).to_have_value(re.compile(r"^X=(9\.99\d|10\.00\d) mm$"))
    page.close()


@pytest.mark.long(
    shown_by="tests/panel/test_page_drawing.py::test_looks_fills_leaders_and_what_changes_them"
)
def test_a_profile_and_a_stitch_path_are_drawn(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    """Shapes are drawn by typed points and by pointer; changed, undone, saved and read again."""
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Draw")
    press(page, "Line")
    typed(page, (0, 20), (50, 50), (150, 50), (200, 20))
    page.locator("#typed-point").press("Enter")
    press(page, "Use as mandrel")
    expected = "A=20 mm at X 0 mm; 50 mm at X 50 mm; 50 mm at X 150 mm; 20 mm at X 200 mm"
    expect(page.locator("#radius")).to_have_value(expected)

    press(page, "Circle")
    typed(page, (100, 80), (110, 80))
    press(page, "Arc")
    typed(page, (20, 80), (30, 90), (40, 80))
    press(page, "Spline")
    typed(page, (130, 80), (150, 100), (170, 70), (190, 90))
    press(page, "Finish")
    page.locator("#text").fill("Rio")
    press(page, "Add text")
    expect(page.locator("#drawn")).to_contain_text("10 shapes")
    press(page, "Rotate")
    press(page, "Delete")
    expect(page.locator("#drawn")).to_contain_text("4 shapes")
    press(page, "Undo")
    expect(page.locator("#drawn")).to_contain_text("10 shapes")

    press(page, "Polygon")
    paper = page.locator("#paper svg")
    box = paper.bounding_box()
    assert box is not None
    for x, y in ((0.3, 0.8), (0.4, 0.8), (0.35, 0.7)):
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    paper.press("Enter")
    expect(page.locator("#drawn")).to_contain_text("11 shapes")
    shot(page, "15-drawing")
    with page.expect_download() as download:
        press(page, "Download DXF")
    file = tmp_path / "out.dxf"
    download.value.save_as(file)
    kinds = [one["kind"] for one in drawings.opened("out.dxf", file.read_bytes())["shapes"]]
    assert kinds[:4] == ["line", "circle", "arc", "line"]  # a spline becomes chords
    press(page, "Clear")
    expect(page.locator("#drawn")).to_contain_text("0 shapes")
    page.locator("#open-drawing").set_input_files(file)
    expect(page.locator("#drawn")).to_contain_text(f"{len(kinds)} shapes")

    press(page, "Clear")
    press(page, "Line")
    typed(page, (30, 10), (80, 10), (80, -20))
    press(page, "Finish")
    press(page, "Save as seam")
    part(page, "Run")
    expect(page.locator("#program")).to_have_value("drawing.seam.toml")
    machine = load_machine("stitcher")
    job = open_job(tmp_path / "drawing.seam.toml", machine, Options())
    moves = [one.target for one in job if isinstance(one, Move)]
    ends = 1e3 * np.array([moves[0], moves[-1]])
    assert ends == pytest.approx(np.array([[30.0, 10.0], [80.0, -20.0]]), abs=1e-3)
    page.close()
