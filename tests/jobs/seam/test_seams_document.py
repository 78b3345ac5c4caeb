"""The document on seams agrees with the readers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from threadline.errors import JobError, Place
from threadline.geometry.contours import CONTOUR_KEYS, POINT_KEYS
from threadline.geometry.read_csv import COLUMNS
from threadline.jobs import read_job
from threadline.jobs.seam.read_toml import DEFAULT_GAP_M, DRAWING_KEYS, SEAM_KEYS
from threadline.jobs.seam.settings import SETTINGS, Stitching, stitching
from threadline.machine import load_machine

TEXT = (Path(__file__).resolve().parents[3] / "docs" / "seams.md").read_text(encoding="utf-8")
PARTS = dict(zip(*[iter(re.split(r"^## (.+)$", TEXT, flags=re.MULTILINE)[1:])] * 2, strict=True))
GIVEN = {"stitch_length": "2 mm", "needle_speed": "20 stitch/s"}


def tables(heading: str) -> list[dict[str, list[str]]]:
    """Return the tables of a section: the cells of each row by its key."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", PARTS[heading], flags=re.MULTILINE):
        rows = [[c.strip() for c in line.strip("|").split("|")] for line in block.splitlines()[2:]]
        found.append({cells[0].strip("`"): cells for cells in rows})
    return found


def test_every_key_is_told_and_no_other() -> None:
    contour, point = tables("`[[contour]]`")
    assert list(tables("`[drawing]`")[0]) == ["file", "unit", "origin", "gap", "by"]
    assert set(DRAWING_KEYS) == {"file", "unit", "origin", "gap", "by"}
    assert list(tables("`[[seam]]`")[0]) == list(SEAM_KEYS)
    assert set(tables("`[stitching]`")[0]) == set(SETTINGS)
    assert set(contour) == set(CONTOUR_KEYS) and set(point) == set(POINT_KEYS)
    for column in COLUMNS:
        assert f"`{column}`" in PARTS["Drawings"]


def test_defaults_and_choices_are_those_of_the_program() -> None:
    rows = tables("`[stitching]`")[0]
    plain = stitching(GIVEN, {}, Place("a.seam.toml"))
    for key, cells in rows.items():
        setting = SETTINGS[key]
        for choice in setting.choices:
            assert f"`{choice}`" in cells[1]
        if setting.choices:
            assert cells[2] == f"`{getattr(plain, setting.field)}`"
        elif re.match(r"[\d.]+( |$)", cells[2]):
            text = int(cells[2]) if setting.kind is int else cells[2]
            if text == "0":  # of a length
                text = "0 mm"
            again = stitching({**GIVEN, key: text}, {}, Place("a.seam.toml"))
            assert getattr(again, setting.field) == pytest.approx(getattr(plain, setting.field))
        elif cells[2] == "refused":
            with pytest.raises(JobError, match=f"{key} is not given"):
                stitching({k: v for k, v in GIVEN.items() if k != key}, {}, Place("a.seam.toml"))
    assert Stitching(stitch_length_m=1.0, needle_speed_hz=1.0).tolerance == 0.05
    assert tables("`[drawing]`")[0]["gap"][2] == f"{DEFAULT_GAP_M * 1e3:g} mm"


def test_the_examples_are_read(tmp_path) -> None:
    """The second runs as it stands; the first needs a drawing with its layers beside it."""
    first, second = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)
    machine = load_machine("stitcher")
    written = tmp_path / "points.seam.toml"
    written.write_text(second)
    job = read_job(written, machine)
    # Three straight sides of 60, 60 and 40 mm, and an arc of bulge 0.5 over 40 mm: 46.4 mm.
    assert sum(1 for _ in job) == pytest.approx((60 + 60 + 40 + 46.4) / 2.5, abs=8)
    (tmp_path / "table.csv").write_text(
        "x [mm];y [mm];layer\n0;0;POCKET\n40;0;POCKET\n\n0;10;MARKS\n10,5;10;MARKS\n"
    )
    drawn = tmp_path / "drawn.seam.toml"
    drawn.write_text(first.replace("pocket.dxf", "table.csv"))
    assert sum(1 for _ in read_job(drawn, machine)) > 40 / 2.5 + 10.5 / 1.5
