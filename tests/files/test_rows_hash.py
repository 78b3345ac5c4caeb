"""The hash of the rows of commands, recomputed independently by hashlib and struct."""

from __future__ import annotations

import hashlib
import struct
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.files.makers import table_of, tables
from threadline.errors import RecordingError
from threadline.files import Clock, Event, SwitchSchedule, TickTable
from threadline.files.formats import read_table
from threadline.files.formats.tick_table import write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import write_array

WRITERS = {"csv": write_table_csv, "npz": write_table_npz, "ticks": write_array}


def text(value: str) -> bytes:
    return struct.pack("<Q", len(value.encode())) + value.encode()


def as_documented(
    title: str, period: str, names: list[str], numbers: bytes, rows: list[list[int]], events: Any
) -> str:
    """Return the hash by docs/files.md, "The hash of the rows"."""
    rows_part = b"".join(struct.pack(f"<{len(row)}q", *row) for row in rows)
    events_part = b"".join(
        struct.pack("<qqd", e.tick, e.operation, e.value) + text(e.kind) + text(e.name)
        for e in events
    )
    return hashlib.sha256(
        text(title)
        + text(period)
        + struct.pack("<Q", len(names))
        + b"".join(map(text, names))
        + numbers
        + struct.pack("<Q", len(rows))
        + hashlib.sha256(rows_part).digest()
        + struct.pack("<Q", len(events))
        + hashlib.sha256(events_part).digest()
    ).hexdigest()


def documented(table: TickTable) -> str:
    blocks = list(table)
    rows = [
        [*counts, operation]
        for block in blocks
        for counts, operation in zip(block.counts.tolist(), block.operation.tolist(), strict=True)
    ]
    count = len(table.axes)
    numbers = struct.pack(f"<{count}d{count}q", *table.counts_per_unit, *table.start_counts)
    events = [event for block in blocks for event in block.events]
    period = f"{table.clock.period_s.numerator}/{table.clock.period_s.denominator}"
    return as_documented("threadline tick table 1", period, list(table.axes), numbers, rows, events)


@given(tables())
def test_another_program_computes_the_same(table: TickTable) -> None:
    assert table.rows_sha256() == documented(table)


@given(st.integers(1, 9), st.integers(1, 9))
def test_blocks_make_no_difference(first: int, second: int) -> None:
    counts = [[k, -k] for k in range(8)]
    events = [Event(tick=k, kind="output", operation=k, name="valve", value=1.0) for k in (0, 3, 8)]
    hashes = {
        table_of(counts, events=events, rows=rows).rows_sha256() for rows in (first, second, 99)
    }
    assert len(hashes) == 1


def schedule(**changes: Any) -> SwitchSchedule:
    settings: dict[str, Any] = {
        "clock": Clock("plc", Fraction(1, 500)),
        "outputs": ("up", "näher"),
        "ticks": np.array([0, 4]),
        "levels": np.array([[1, 0], [0, 1]]),
        "operation": np.array([0, 2]),
        "duration_ticks": 9,
        "job_sha256": "a",
        "machine_sha256": "b",
        "events": (Event(tick=3, kind="wait", operation=1, name="is_up", value=1.0),),
    }
    return SwitchSchedule(**settings | changes)


def test_a_schedule_has_the_documented_hash() -> None:
    found = schedule()
    assert found.rows_sha256() == as_documented(
        "threadline switch schedule 1", "1/500", ["up", "näher"], struct.pack("<q", 9),
        [[0, 1, 0, 0], [4, 0, 1, 2]], found.events,
    )  # fmt: skip


def test_every_field_sent_to_a_controller_changes_the_hash() -> None:
    base = schedule().rows_sha256()
    other = [
        {"clock": Clock("plc", Fraction(1, 501))},
        {"outputs": ("up", "down")},
        {"ticks": np.array([0, 5])},
        {"levels": np.array([[1, 0], [1, 1]])},
        {"operation": np.array([0, 3])},
        {"duration_ticks": 10},
        {"events": ()},
    ]
    hashes = {schedule(**change).rows_sha256() for change in other}
    assert len(hashes | {base}) == len(other) + 1
    # Hashes of their own identify its sources.
    assert schedule(job_sha256="c", machine_sha256="d").rows_sha256() == base

    rows = [[1, 2], [3, 4]]
    event = Event(tick=1, kind="output", operation=0, name="v", value=1.0)
    tables = [
        table_of(rows),
        table_of(rows, clock=Clock("servo", Fraction(1, 100))),
        table_of(rows, axes=("A", "Y")),
        table_of([[1, 2], [3, 5]]),
        table_of([[1, 2, 3, 4]], axes=("A", "B", "C", "X")),
        table_of(rows, operation=[0, 1]),
        table_of(rows, events=[event]),
        table_of([*rows, [0, 0]]),
    ]
    assert len({table.rows_sha256() for table in tables}) == len(tables)


@pytest.mark.parametrize("ending", list(WRITERS))
def test_a_changed_row_is_refused(tmp_path: Path, ending: str) -> None:
    """By file, with the actual and the expected hash."""
    file = tmp_path / f"table.{ending}"
    table = table_of([[1, 2], [3, 4], [5, 6]])
    WRITERS[ending](table, file)
    assert read_table(file).rows_sha256() == table.rows_sha256()
    other = tmp_path / f"other.{ending}"
    WRITERS[ending](table_of([[1, 2], [3, 5], [5, 6]]), other)
    if ending == "npz":
        splice(file, other)
    else:
        kept, changed = file.read_text().splitlines(), other.read_text().splitlines()
        head = [line for line in kept if line.startswith("# ")]
        assert any(table.rows_sha256() in line for line in head)
        body = [line for line in changed if not line.startswith("# ")]
        file.write_text("\n".join([*head[:-1], *body, head[-1]]) + "\n")
    with pytest.raises(RecordingError, match=rf"table\.{ending}: the rows were changed") as caught:
        read_table(file)
    assert table.rows_sha256()[:12] in str(caught.value)
    assert "\n" not in str(caught.value)
    if ending != "npz":  # an older table, without a hash
        lines = [line for line in file.read_text().splitlines() if "rows_sha256" not in line]
        file.write_text("\n".join(lines) + "\n")
        assert read_table(file).rows_sha256() != table.rows_sha256()


def splice(file: Path, other: Path) -> None:
    """Give the archive ``file`` the counts of ``other``; all else stays right except the hash."""
    with zipfile.ZipFile(file) as kept, zipfile.ZipFile(other) as changed:
        parts = {name: kept.read(name) for name in kept.namelist()}
        parts["counts.npy"] = changed.read("counts.npy")
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in parts.items():
            out.writestr(name, content)
