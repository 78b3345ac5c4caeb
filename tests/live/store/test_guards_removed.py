"""Remove a guard of the store: the test that the table of hazards names for it fails.

Nobody may leave out a guard, so none has a setting: it is removed where it is, though private.
"""

from __future__ import annotations

import contextlib
import gc
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import pytest
from sqlalchemy import Table, schema
from sqlalchemy.exc import OperationalError
from sqlalchemy.schema import CreateTable

from tests.live.store import test_recording_mcap, test_shared
from tests.live.test_guards_removed import Take, attribute
from threadline.files.formats import recording_mcap
from threadline.live.store.index import RunIndex

_records = recording_mcap._records


def made_anew(table: Table, *, if_not_exists: bool) -> CreateTable:
    """Make the table as if no other program could be making it."""
    return CreateTable(table)


def to_any_end(file: IO[bytes], path: Path) -> Iterator[tuple[Any, bool]]:
    """Take the end of any trace for a regular end."""
    yield from _records(file, path)
    yield None, True


def cut_short(folder: Path) -> None:
    """Read the rest of a crashed trace that has all its blocks and no end."""
    recording = test_recording_mcap.short_recording()
    last = test_recording_mcap.whole_file(recording)[1][-1]
    test_recording_mcap.test_cut_recording_keeps_its_whole_blocks_and_ends_in_a_fault.hypothesis.inner_test(  # type: ignore[attr-defined]
        recording, SimpleNamespace(mktemp=lambda _: folder), SimpleNamespace(draw=lambda _: last)
    )


def locked(folder: Path) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        test_shared.test_a_locked_index_is_one_line_before_anything_moves(folder, monkeypatch)


GUARDS: dict[str, tuple[Take, Callable[[Path], None]]] = {
    "programs that begin at once": (
        attribute(schema, "CreateTable", made_anew),
        test_shared.test_programs_that_begin_at_once_all_get_their_rows,
    ),
    "an index that is locked": (
        attribute(RunIndex, "_clear", lambda _: contextlib.nullcontext()),
        locked,
    ),
    "a trace that breaks off": (
        attribute(recording_mcap, "_records", to_any_end),
        cut_short,
    ),
}


@pytest.mark.long(only="programs that begin at once")
@pytest.mark.parametrize("guard", GUARDS)
def test_without_the_guard_its_test_fails(
    guard: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_away, test = GUARDS[guard]
    take_away(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a failing test closes nothing
        with pytest.raises((AssertionError, OperationalError)):
            test(tmp_path)
        gc.collect()
