"""The needle columns of a compiled seam, compared with the seam's own numbers."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.files import tick_table
from threadline.files.formats import read_table
from threadline.jobs import read_job
from threadline.machine import Machine
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, write

SEAM = """
[stitching]
stitch_length = "2.5 mm"
needle_speed = "20 stitch/s"
acceleration = "4 m/s^2"
settle = "0.2 s"
travel_speed = "50 mm/s"
trim = "0.3 s"

[[contour]]
unit = "mm"
points = [[10, 0], [60, 0]]

[[contour]]
unit = "mm"
points = [[60, 20], [10, 20]]
"""
TICK_S = 0.005  # clock of the winder that sews


@pytest.fixture
def plan(sewer: Machine, tmp_path: Path) -> Plan:
    seam = tmp_path / "two.seam.toml"
    seam.write_text(SEAM, encoding="utf-8")
    return plan_job(read_job(seam, sewer), sewer, Options(interpolation="linear"))


@pytest.fixture
def rows(plan: Plan, tmp_path: Path) -> tuple[list[dict[str, str]], int]:
    (written,) = write(plan, "csv", tmp_path / "two.csv")
    lines = [x for x in (tmp_path / "two.csv").read_text().splitlines() if not x.startswith("#")]
    assert read_table(tmp_path / "two.csv").rows_sha256() == tick_table(plan.commands).rows_sha256()
    stitches = sum("stitch" in getattr(o, "tags", {}) for o in plan.job)
    assert written.path == tmp_path / "two.csv"
    return list(csv.DictReader(lines)), stitches


def downs(rows: list[dict[str, str]]) -> np.ndarray:
    return np.array(
        [
            int(row["tick"]) * TICK_S + float(cell)
            for row in rows
            for cell in row["needle_down [s]"].split()
        ]
    )


def test_every_turn_of_the_needle_stands_in_its_tick(rows) -> None:
    """20 a second, even except for the rounding of linear motion to ticks, in two contours."""
    table, stitches = rows
    found = downs(table)
    apart = np.diff(found)
    (gap,) = np.flatnonzero(apart > 0.5)
    assert len(found) == stitches + 2
    np.testing.assert_allclose(np.delete(apart, gap), 0.05, atol=TICK_S + 1e-9)


def test_between_contours_the_needle_is_up_and_the_thread_trimmed_for_as_long_as_asked(
    rows,
) -> None:
    table, _ = rows
    found = downs(table)
    gap = int(np.diff(found).argmax())
    up = np.array([row["needle_up"] == "1" for row in table if row["needle_up"]])
    middle_s = (np.arange(len(up)) + 0.5) * TICK_S
    sewing = ((middle_s >= found[0]) & (middle_s <= found[gap])) | (
        (middle_s >= found[gap + 1]) & (middle_s <= found[-1])
    )
    np.testing.assert_array_equal(up, ~sewing)
    trim = np.array([row["trim"] == "1" for row in table if row["trim"]])
    begins = np.flatnonzero(np.diff(trim.astype(int), prepend=0) == 1)
    assert trim.sum() == 2 * round(0.3 / TICK_S)
    assert up[trim].all()
    # The first follows the last needle-down of its contour, within two ticks.
    assert 0.0 <= begins[0] * TICK_S - found[gap] <= 2 * TICK_S


def test_the_archive_says_the_same_as_the_text(rows, plan: Plan, tmp_path: Path) -> None:
    table, _ = rows
    write(plan, "npz", tmp_path / "two.npz")
    with np.load(tmp_path / "two.npz") as found:
        down_s = found["needle_down_tick"] * TICK_S + found["needle_down_s"]
        np.testing.assert_allclose(down_s, downs(table), atol=2e-9)  # nine digits of text
        for name in ("needle_up", "trim"):
            assert found[name].tolist() == [int(row[name]) for row in table if row[name]]
    assert read_table(tmp_path / "two.npz").rows_sha256() == tick_table(plan.commands).rows_sha256()


def test_the_trajectory_array_says_the_same_line_by_line(rows, plan: Plan, tmp_path: Path) -> None:
    """Each of its lines lasts many ticks: needle and thread stay the same in all of them."""
    table, _ = rows
    write(plan, "ticks", tmp_path / "two.ticks")
    lines = [x for x in (tmp_path / "two.ticks").read_text().splitlines() if not x.startswith("#")]
    array = [row for row in csv.DictReader(lines) if row["needle_up"]]
    spans = np.array([int(row["ticks"]) for row in array])
    assert 2 * len(spans) < spans.sum()
    for name in ("needle_up", "trim"):
        expected = np.repeat([int(row[name]) for row in array], spans)
        assert expected.tolist() == [int(row[name]) for row in table if row[name]]
    begins_s = (np.cumsum(spans) - spans) * TICK_S
    found = [
        begin_s + float(cell)
        for begin_s, row in zip(begins_s, array, strict=True)
        for cell in row["needle_down [s]"].split()
    ]
    np.testing.assert_allclose(found, downs(table), atol=2e-9)
    assert (
        read_table(tmp_path / "two.ticks").rows_sha256() == tick_table(plan.commands).rows_sha256()
    )
