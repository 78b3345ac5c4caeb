"""Drawings in a browser: looks, fills, leaders, changes and files."""

from __future__ import annotations

import re
from pathlib import Path

import ezdxf
import pytest

from tests.panel.browsing import Browser, Page, expect, opened, part, press, shot, typed
from tests.panel.test_panel_killed import Plant
from threadline.geometry.svg.read_svg import read_svg


def data(page: Page, shape: int) -> str:
    return page.locator(f"#paper path[data-at='{shape}']").get_attribute("d") or ""


def seen(page: Page) -> list[float]:
    """Return x, y, width and height of the view, in mm with y downwards."""
    view_box = page.locator("#paper svg").get_attribute("viewBox") or ""
    return [float(one) for one in view_box.split()]


def width(page: Page, shape: int) -> float:
    found: float = page.locator(f"#paper path[data-at='{shape}']").evaluate(
        "path => path.getBBox().width"
    )
    return found


def test_looks_fills_leaders_and_what_changes_them(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Draw")
    page.locator("#line-style").select_option("dashdot")
    page.locator("#fill").select_option("hatched")
    press(page, "Polygon")
    typed(page, (10, 10), (60, 10), (60, 50), (10, 50))
    page.locator("#typed-point").press("Enter")
    page.locator("#line-style").select_option("solid")
    page.locator("#fill").select_option("crossed")
    first = page.locator("#paper path[data-at='0']")
    expect(first).to_have_attribute("fill", "url(#crossed)")  # the shape is chosen
    press(page, "Undo")
    press(page, "Undo")
    expect(first).to_have_attribute("stroke-dasharray", re.compile("8 3"))
    press(page, "Redo")
    expect(first).to_have_attribute("stroke-dasharray", "")
    page.locator("#factor").fill("0.5")
    press(page, "Scale")
    assert abs(width(page, 0) - 25.0) < 1e-3
    page.locator("#angle").fill("90")
    press(page, "Rotate")
    assert abs(width(page, 0) - 20.0) < 1e-3  # its height
    press(page, "Duplicate")
    expect(page.locator("#drawn")).to_contain_text("2 shapes")
    press(page, "To back")
    page.locator("#fill").select_option("solid")
    press(page, "Circle")
    typed(page, (100, 40), (120, 40))
    press(page, "Leader")
    page.locator("#text").fill("cone <30°>")
    typed(page, (115, 55), (135, 75), (145, 75))
    press(page, "Finish")
    expect(page.locator("#paper text")).to_have_text("cone <30°>")
    press(page, "Spline")
    typed(page, (20, 90), (50, 110), (80, 80), (110, 100))
    press(page, "Finish")
    page.get_by_label("Font").select_option("DejaVu Serif")
    page.locator("#text").fill("Rio")
    press(page, "Add text")
    expect(page.locator("#drawn")).to_contain_text("11 shapes")
    shot(page, "19-looks")

    drawn = [data(page, k) for k in range(11)]
    press(page, "Save SVG in the project folder")
    expect(page.locator("#log")).to_contain_text("drawing.svg is in the project folder")
    written = tmp_path / "drawing.svg"
    strokes = read_svg(written.read_bytes(), "drawing.svg").strokes
    assert len(strokes) >= 11  # another reader finds the lines, and no line of a hatch pattern
    assert len(strokes) <= 13
    with page.expect_download() as download:
        press(page, "Download DXF")
    space = ezdxf.readfile(download.value.path()).modelspace()
    assert {one.dxftype() for one in space} == {
        "LWPOLYLINE", "CIRCLE", "SPLINE", "HATCH", "LEADER", "MTEXT",
    }  # fmt: skip
    dxf = tmp_path / "again.dxf"
    download.value.save_as(dxf)
    press(page, "Clear")
    page.locator("#open-drawing").set_input_files(written)
    expect(page.locator("#drawn")).to_contain_text("11 shapes")
    assert [data(page, k) for k in range(11)] == drawn
    expect(page.locator("#paper text")).to_have_text("cone <30°>")
    press(page, "Clear")
    expect(page.locator("#drawn")).to_contain_text("0 shapes")
    page.locator("#open-drawing").set_input_files(dxf)
    expect(page.locator("#drawn")).to_contain_text("11 shapes")
    expect(page.locator("#paper text")).to_have_text("cone <30°>")
    expect(page.locator("#log")).not_to_contain_text("left out: again.dxf")

    page.locator("#text").fill("O")
    press(page, "Add text")
    expect(page.locator("#drawn")).to_contain_text("13 shapes")
    page.locator("#fill").select_option("crossed")
    rings = page.locator("#paper path[data-at='11']")
    expect(rings).to_have_attribute("fill", "url(#crossed)")  # its hole stays empty
    assert (rings.get_attribute("fill-rule"), data(page, 11).count("M")) == ("evenodd", 2)
    expect(page.locator("#paper path[data-at='12']")).to_have_count(0)
    press(page, "Save SVG in the project folder")
    press(page, "Overwrite it")
    expect(page.locator("#log li", has_text="drawing.svg is in the project")).to_have_count(2)
    page.locator("#open-drawing").set_input_files(written)
    expect(page.locator("#drawn")).to_contain_text("13 shapes")
    assert data(page, 11).count("M") == 2
    page.close()


def test_a_click_is_no_change_and_a_pull_snaps(browser: Browser, plant: Plant) -> None:
    """Choosing a shape cannot be undone; a dragged point lands on the grid."""
    page = opened(browser, plant)
    part(page, "Draw")
    press(page, "Line")
    typed(page, (20, 20), (60, 20))
    press(page, "Finish")
    before = data(page, 0)
    press(page, "Select")
    paper = page.locator("#paper svg")
    page.locator("#save-seam").scroll_into_view_if_needed()
    where = page.locator("#paper path[data-at='0']").bounding_box()
    assert where is not None
    at = (where["x"] + where["width"] / 2, where["y"] + where["height"] / 2)
    for _ in range(3):
        page.mouse.click(*at)
    page.mouse.move(*at)
    page.mouse.down()
    box = paper.bounding_box()
    assert box is not None
    page.mouse.move(at[0] + box["width"] * 0.113, at[1], steps=5)
    page.mouse.up()
    moved = data(page, 0)
    assert moved != before
    numbers = [float(one) for one in re.findall(r"-?\d+\.?\d*", moved)]
    assert all(number % 10 == 0 for number in numbers)
    press(page, "Undo")
    assert data(page, 0) == before
    press(page, "Undo")
    expect(page.locator("#drawn")).to_contain_text("0 shapes")
    before = seen(page)
    press(page, "Line")
    typed(page, (-300, 20), (300, 30))
    press(page, "Finish")
    x, y, wide, high = seen(page)  # the view has grown by itself, and still shows the same part
    assert x <= -300 and x + wide >= 300
    assert y <= before[1] and y + high >= before[1] + before[3]
    press(page, "Fit")
    x, _, wide, _ = map(float, (paper.get_attribute("viewBox") or "").split())
    assert x < -300.0 < 300.0 < x + wide
    page.close()


@pytest.mark.long(shown_by="test_looks_fills_leaders_and_what_changes_them")
def test_styles_of_lines_come_back_from_both_files(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Draw")
    styles = ("solid", "dashed", "dotted", "dashdot")
    for k, style in enumerate(styles):
        press(page, "Line")
        typed(page, (10, 10 * k), (60, 10 * k))
        press(page, "Finish")
        page.locator("#line-style").select_option(style)  # style of the chosen line

    def looks() -> list[str | None]:
        expect(page.locator("#drawn")).to_contain_text("4 shapes")
        shapes = [page.locator(f"#paper path[data-at='{k}']") for k in range(4)]
        return [one.get_attribute("stroke-dasharray") for one in shapes]

    drawn = looks()
    assert len(set(drawn)) == 4
    press(page, "Save SVG in the project folder")
    expect(page.locator("#log")).to_contain_text("drawing.svg is in the project folder")
    with page.expect_download() as download:
        press(page, "Download DXF")
    dxf, svg = tmp_path / "again.dxf", tmp_path / "drawing.svg"
    download.value.save_as(dxf)
    other = tmp_path / "other.svg"  # as another program writes it: the server reads its dashes
    other.write_text(re.sub(r' data-[a-z]+="[^"]*"', "", svg.read_text("utf-8")), "utf-8")
    for file in (dxf, svg, other):
        press(page, "Clear")
        expect(page.locator("#drawn")).to_contain_text("0 shapes")
        page.locator("#open-drawing").set_input_files(file)
        assert looks() == drawn, file.name
    page.close()
