"""The judge against a second reading of the specification: nothing passes that cannot pass.

Runs of a winder, a stitcher, an on/off placer and an embroidery machine lose random channels,
change units, have blocks cut, overlapped and reordered, and have single axes named. ``python -m
tools.fuzz`` runs the same classes for a long time.
"""

from __future__ import annotations

import random
import warnings
from pathlib import Path

import pytest
from tools import fuzz_recordings as cases

from threadline.errors import ThreadlineError
from threadline.verdict import spec
from threadline.verdict.coverage import Coverage
from threadline.verdict.motion_run import MotionRun
from threadline.verdict.stitch_run import StitchRun

CASES = 25


def run(kind: str, folder: Path, count: int, seed: int = 11) -> tuple[int, int]:
    """Return the number of judged cases, and the number that passed although they cannot."""
    judged = wrong = 0
    path = folder / "case.seed"
    for index in range(count):
        path.write_bytes(cases.case(random.Random(f"{seed}/{kind}/{index}")))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                cases.check(kind, path)
            judged += 1
        except ThreadlineError as error:
            assert "\n" not in str(error)
        except AssertionError:
            wrong += 1
    return judged, wrong


@pytest.mark.parametrize("kind", ["judge-channels", "judge-blocks", "judge-axes"])
def test_nothing_passes_that_cannot(kind: str, tmp_path: Path) -> None:
    judged, wrong = run(kind, tmp_path, CASES)
    assert wrong == 0
    assert judged > CASES // 4


@pytest.mark.parametrize(
    ("kind", "owner", "name", "careless", "found"),
    [
        ("judge-channels", MotionRun, "_absent", lambda *_: {}, "passed, although"),
        ("judge-channels", MotionRun, "_lacking", lambda *_: [], "passed, although"),
        ("judge-blocks", Coverage, "lack", lambda *_: None, "passed, although"),
        ("judge-blocks", Coverage, "_take", lambda *_: None, "judged, although"),
        ("judge-axes", spec, "_has_unit", lambda _: True, "read, although"),
        ("judge-blocks", StitchRun, "unseen_why", lambda _: "", "passed, although"),
    ],
)
def test_a_careless_judge_is_found_out(
    kind, owner, name, careless, found, tmp_path: Path, monkeypatch
) -> None:
    """A verdict must show it; an error in a judge that neglects a rule does not count."""
    monkeypatch.setattr(owner, name, careless)
    path = tmp_path / "case.seed"
    for index in range(400):
        path.write_bytes(cases.case(random.Random(f"11/{kind}/{index}")))
        try:
            cases.check(kind, path)
        except (ThreadlineError, ValueError):
            continue
        except AssertionError as error:
            if not str(error):  # an error of the judge itself
                continue
            assert found in str(error), (index, name)
            return
    pytest.fail(f"{kind} passes a judge without {name}")
