"""Changes that must not matter leave a verdict unchanged; others change it.

Examples are noise below any resolution in a recording, a program in inches, and a machine file in
another order, from fixed seeds. ``python -m tools.fuzz --reader same-recording`` and similar
commands run the same classes for a long time.
"""

from __future__ import annotations

import random
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from tools import fuzz_metamorphic as cases
from tools.fuzz_same_recordings import pool, recording_of, values_of

from threadline.files import Recording
from threadline.jobs.gcode import modal
from threadline.verdict import each_run, judge

VALUE_OF = modal.value_of
JUDGE = sys.modules[judge.__module__]
CASES = {"same-recording": 60, "same-program": 60, "same-winding": 12, "same-machine": 40}


def run(kind: str, folder: Path, count: int) -> Iterator[str]:
    """Yield the differences found in a number of cases."""
    _, make, check, _ = cases.fuzz_metamorphic()[kind]
    path = folder / "case.seed"
    for index in range(count):
        path.write_bytes(make(random.Random(f"5/{kind}/{index}")))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                check(path)
        except AssertionError as error:
            yield f"{index}: {error}"


@pytest.mark.long(but=("same-program-few", "same-winding-few", "same-machine-few"))
@pytest.mark.parametrize("divisor", [5, 1], ids=["few", "all"])
@pytest.mark.parametrize("kind", cases.CLASSES)
def test_irrelevant_changes_leave_the_verdict_unchanged(
    kind: str, divisor: int, tmp_path: Path
) -> None:
    assert list(run(kind, tmp_path, CASES[kind] // divisor)) == []


@pytest.mark.long(only="1.prg-edges2")
@pytest.mark.parametrize(
    ("name", "edges"),
    [
        ("1.prg", (1572,)),  # in a block that lifts the fibre and slips
        ("1.prg", tuple(range(1, 3459, 7))),
        ("1.prg", tuple(range(2, 3459, 2))),  # at the fastest consumption of fibre
        ("follows.seam.toml", (1500,)),  # between a stop of the head and the end of its contour
        ("follows.seam.toml", tuple(range(1, 2113, 50))),
    ],
)
def test_cutting_a_recording_into_blocks_changes_no_value(
    name: str, edges: tuple[int, ...]
) -> None:
    kept = next(kept for kept in pool() if kept.seed.file.name == name)
    cut = recording_of(kept.seed, kept.samples, edges)
    found = values_of(kept.seed, cut, kept.seed.proof.spec)
    assert found == pytest.approx(kept.measured, rel=1e-9, abs=1e-12, nan_ok=True)


def _wider(criterion, plan):
    return None if criterion.limit is None else 1.002 * criterion.limit


def _in_millimetres(content, _, **mode):
    return VALUE_OF(content, 10, **mode)


def _first(recording, kind, axis=""):
    return next((c for c in recording.channels if (c.kind, c.axis) == (kind, axis)), None)


@pytest.mark.parametrize(
    ("kind", "owner", "name", "careless", "found"),
    [
        ("same-recording", each_run, "limit_of", _wider, "failed [False"),
        (
            "same-recording",
            Recording,
            "find",
            _first,
            "is [",
        ),
        ("same-program", modal, "value_of", _in_millimetres, "and was"),
        ("same-machine", JUDGE, "limit_of", _wider, "times its limit"),
    ],
)
def test_a_careless_program_is_found_out(
    kind, owner, name, careless, found, tmp_path: Path, monkeypatch
) -> None:
    """Limits 0.2 % wider, the first channel of a kind, an F in inches taken as mm."""
    pool()
    monkeypatch.setattr(owner, name, careless)
    assert any(found in message for message in run(kind, tmp_path, CASES[kind]))
