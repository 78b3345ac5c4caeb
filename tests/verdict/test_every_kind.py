"""Changes that must not matter, for each kind of machine: the verdict stays, all are counted.

``python -m tools.fuzz_every_kind`` makes the same changes for a long time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tools import fuzz_changed_runs, fuzz_every_kind, fuzz_same_recordings

from threadline.files import Recording
from threadline.jobs import read_job
from threadline.jobs.gcode import modal
from threadline.verdict import judge

VALUE_OF = modal.value_of
JUDGE = sys.modules[judge.__module__]
NEVER = 10**9
CHANGES, RUNS = 13, len(fuzz_changed_runs.RECORDED) + len(fuzz_changed_runs.LIMITS)
LESS = {"stitcher": 1, "schiffli-frame": 1, "letter-placer": 4}
"""Axes without letters; no path to be mirrored or shifted; no limit that a plan comes near."""


@pytest.fixture(autouse=True)
def _one_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz_every_kind, "EACH", 1)
    monkeypatch.setattr(fuzz_changed_runs, "SIDE", 2)


def run(kind: str, number: int, change: str = "", proved: int = NEVER) -> fuzz_every_kind.Tally:
    return fuzz_every_kind.run_round(5, number, (proved, NEVER), kind, change)


@pytest.mark.parametrize("kind", [kind.name for kind in fuzz_every_kind.kinds()])
def test_no_change_of_a_kind_changes_its_verdict(kind: str, tmp_path: Path) -> None:
    """Some kinds are proved, others are read; inches suit only work without a rotary axis."""
    tally = run(kind, 3, proved=4)
    assert tally.failures == []
    expected = CHANGES + RUNS - LESS.get(kind, 0)
    assert len(tally.cases) in (expected, expected - (kind in ("winder", "firmware")))
    assert min(tally.cases.values()) >= 1
    assert any(cell.endswith("|proved") for cell in tally.doors)
    kept = tmp_path / "kept.jsonl"
    fuzz_every_kind.keep(kept, tally)
    (again,) = fuzz_every_kind.kept_tallies(kept)
    assert again == tally
    assert f"{tally.cases.total()} cases in 1 rounds" in fuzz_every_kind.table([again])


def _wider(criterion, plan):
    return None if criterion.limit is None else 1.002 * criterion.limit


def _in_millimetres(content, _, **mode):
    return VALUE_OF(content, 10, **mode)


def _first(recording, kind, axis=""):
    return next((c for c in recording.channels if c.kind is kind), None)


@pytest.mark.parametrize(
    ("kind", "change", "owner", "name", "careless"),
    [
        ("schiffli-frame", "limits: one a thousandth below", JUDGE, "limit_of", _wider),
        ("winder", "inches", modal, "value_of", _in_millimetres),
        ("firmware", "recording: channels in another order", Recording, "find", _first),
        ("stitcher", "recording: in mm, inches, degrees, mA", fuzz_same_recordings, "in_si",
         lambda recording, _: recording),
        ("winder", "shifted", sys.modules[f"{read_job.__module__.rpartition('.')[0]}.shifted"],
         "_shifted_item", lambda item, _: item),
    ],
)  # fmt: skip
def test_a_careless_program_is_found_out(
    kind, change, owner, name, careless, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Limits 0.2 % wider, inches taken as millimetres, no shift, a wrong channel."""
    monkeypatch.setattr(owner, name, careless)
    assert any(run(kind, number, change).failures for number in range(4))
