"""The files of a controller, read by a reader that shares no code with their writer."""

from __future__ import annotations

import csv
import hashlib
import json
import struct
from fractions import Fraction
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.commands.step_tables import step_tables
from threadline.machine import load_machine
from threadline.motion.laws import law
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, write

MACHINE = load_machine("schiffli-frame")


def read_tables(content: bytes) -> list[tuple[int, list[int]]]:
    assert content[:8] == b"TLSTEPT1"
    (count,) = struct.unpack_from("<I", content, 8)
    at, found = 12, []
    for _ in range(count):
        units, steps = struct.unpack_from("<II", content, at)
        found.append((units, list(struct.unpack_from(f"<{steps}I", content, at + 8))))
        at += 8 + 4 * steps
    assert at == len(content)
    return found


ROW = "<qqiiiiiiq"


def test_compile_prints_the_checks_of_step_tables(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Count, shortest interval, ends and residual, compared with the tables in another reader."""
    out = tmp_path / "rosette.json"
    design = str(examples / "rosette.dst")
    asked = [design, "-m", "schiffli-frame", "--target", "steps", "-o", str(out)]
    with pytest.raises(SystemExit) as left:
        main(["compile", *asked, "--feed", "120 stitch/min"])
    assert not left.value.code
    printed = capsys.readouterr().out
    tables = read_tables((tmp_path / "rosette.tables.bin").read_bytes())
    window = round(16e6 / 6)
    shortest = min(min(intervals) for _, intervals in tables)
    ends = [int(16e6 / 6) - sum(intervals) for _, intervals in tables]
    assert "165 tables of 48 steps a unit, 48 to 7920, counted by time" in printed
    assert f"shortest interval {shortest} periods" in printed
    assert f"due {min(ends)} to {max(ends)} periods before the end" in printed
    assert abs(window - sum(tables[-1][1])) <= 1
    # The swing of 7920 steps of 2.08 um at 12 Hz, summed here step by step.
    times = np.cumsum(tables[-1][1]) / 16e6
    omega = 2 * np.pi * 12.0
    pole = omega * (0.02 + 1j * np.sqrt(1 - 0.02**2))
    swung = np.exp(-pole * (window / 16e6 - times)).sum() / 480e3 / np.sqrt(1 - 0.02**2)
    swing_mm = float(printed.split("at most ")[1].split(" mm")[0])
    assert swing_mm == pytest.approx(abs(swung) * 1e3, rel=5e-3)


@pytest.mark.parametrize("feed", [None, "60 stitch/min"])
def test_every_row_reads_as_it_was_planned(
    feed: str | None, examples: Path, tmp_path: Path
) -> None:
    options = Options(feed=None if feed is None else parse_feed(feed))
    plan = plan_job(open_job(examples / "rosette.dst", MACHINE, options), MACHINE, options)
    files = write(plan, "steps", tmp_path / "rosette.json")
    names = [file.path.name for file in files]
    assert names == ["rosette.json"] + [
        f"rosette.{part}" for part in (
            "tables.bin", "tables.csv", "stitches.bin", "stitches.csv", "events.csv")
    ]  # fmt: skip
    folder = tmp_path
    manifest = json.loads((folder / "rosette.json").read_text())
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert set(manifest["files"]) == set(names[1:])
    assert manifest["counted_by"] == ("angle" if feed is None else "time")
    assert Fraction(manifest["timer_s"]) == Fraction(1, 16_000_000)
    assert manifest["angles_of_window"] == manifest["angles_per_turn"] // 3
    assert manifest["rows_sha256"] == plan.commands.rows_sha256()

    tables = read_tables((folder / "rosette.tables.bin").read_bytes())
    assert [units for units, _ in tables] == list(range(1, 166))
    window = 0.12 if feed is None else 1.0 / 3.0
    motion = law("modified-sine")
    for units, intervals in tables:
        assert len(intervals) == 48 * units
        assert min(intervals) >= 1
        assert 0 <= window * 16e6 - sum(intervals) < 1
        half = np.cumsum(intervals)[24 * units - 1] / (window * 16e6)
        assert motion(np.array([half]))[0] == pytest.approx(0.5, abs=1e-5)
    with (folder / "rosette.tables.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, (units, intervals) in zip(rows, tables, strict=True):
        assert int(row["units"]) == units
        assert list(map(int, row["intervals"].split())) == intervals
        assert int(row["sum"]) == sum(intervals) and int(row["shortest"]) == min(intervals)

    content = (folder / "rosette.stitches.bin").read_bytes()
    assert content[:8] == b"TLSTEPS1"
    (count,) = struct.unpack_from("<I", content, 8)
    turns = list(struct.iter_unpack(ROW, content[12:]))
    assert len(turns) == count == manifest["turns"]
    with (folder / "rosette.stitches.csv").open(newline="") as file:
        read_rows = [list(map(int, row)) for row in list(csv.reader(file))[1:]]
    assert read_rows == [[k, *row] for k, row in enumerate(turns)]

    # Played like a controller: the frame comes to every place of the design.
    position, free = np.zeros(2, dtype=int), 0
    places = []
    for begin, width, start, needle, table_x, sign_x, table_y, sign_y, _ in turns:
        assert begin >= free and start == 0
        free = begin + width
        for axis, (table, sign) in enumerate(((table_x, sign_x), (table_y, sign_y))):
            if table >= 0:
                position[axis] += sign * len(tables[table][1])
        if needle:
            places.append(position / 480e3)
    assert free <= manifest["duration_ticks"]
    stitched = plan.stitched
    assert np.abs(np.array(places) - stitched.places_m[stitched.turns.stitch > 0]).max() < 1e-12
    assert len(places) == 185
    with (folder / "rosette.events.csv").open(newline="") as file:
        events = [row["name"] or row["kind"] for row in csv.DictReader(file)]
    assert events == ["trim", "colour", "end"]


def test_all_tables_are_cut_in_less_than_a_second() -> None:
    """Processor time; the limit is 1 s, and 0.3 s are usual."""
    step_tables(law("modified-sine"), window_s=Fraction(1, 10), timer_s=Fraction(1, 10**7),
                steps_per_unit=1, longest_units=3)  # fmt: skip
    begun = process_time()
    step_tables(
        law("modified-sine"), window_s=Fraction(12, 100), timer_s=Fraction(1, 16_000_000),
        steps_per_unit=48, longest_units=165,
    )  # fmt: skip
    assert process_time() - begun < 1.0
