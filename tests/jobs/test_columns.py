"""Tags stay with their moves, one by one and in runs of columns."""

from __future__ import annotations

import pickle
import random
from pathlib import Path

import numpy as np
import pytest

from threadline.jobs import Job, Move, read_job
from threadline.jobs.operations import (
    NO_TAGS,
    Feed,
    FeedMode,
    MoveRun,
    Operation,
    Source,
    columns_of,
    gathered,
    move_runs,
)
from threadline.machine import load_machine
from threadline.verdict.needle import has_stitches

WINDER = load_machine("lathe-winder")


def flat(runs) -> list[Operation]:
    found: list[Operation] = []
    for item in runs:
        found += list(item) if isinstance(item, MoveRun) else [item]
    return found


def program(folder: Path, seed: int) -> Job:
    """Some blocks have tags, equal or unlike their neighbours; some stand in loops."""
    chance = random.Random(seed)
    lines = ["G91 G94 F600"]
    for k in range(chance.randrange(1, 300)):
        tags = {
            name: chance.choice([25.5, 0, -1, k])
            for name in ("tension_N", "layer", "circuit", "stitch")
            if chance.random() < 0.3
        }
        comment = " ; " + ", ".join(f"{n}={v}" for n, v in tags.items()) if tags else ""
        lines.append(f"G1 X{chance.choice([1, -1])}.5{comment}")
        if chance.random() < 0.05:
            lines.append("G4 P0.1")
    lines += ["M98 P7 L5", "M30", "O7", "G1 X1 ; layer=2", "G1 X-1", "M99"]
    path = folder / "tags.nc"
    path.write_text("\n".join(lines) + "\n")
    return read_job(path, WINDER)


@pytest.mark.parametrize("seed", range(20))
def test_tags_of_a_program_are_the_same_both_ways(seed: int, tmp_path: Path) -> None:
    job = program(tmp_path, seed)
    one_by_one = list(job)

    assert flat(job.runs()) == one_by_one
    assert flat(move_runs(job, longest=7)) == one_by_one
    assert flat(move_runs(job)) == one_by_one
    assert flat(pickle.loads(pickle.dumps(list(move_runs(job))))) == one_by_one
    text = (tmp_path / "tags.nc").read_text().splitlines()
    for move in (op for op in one_by_one if isinstance(op, Move)):
        _, _, comment = text[move.source.line - 1].partition(";")
        values = dict(part.strip().split("=") for part in comment.split(",") if part.strip())
        assert move.tags == {name: float(value) for name, value in values.items()}


@pytest.mark.parametrize("name", ["pocket", "badge", "collar"])
@pytest.mark.parametrize("needle", ["constant", "slowed"])
def test_stitches_have_columns(name: str, needle: str, examples: Path) -> None:
    job = read_job(examples / f"{name}.seam.toml", load_machine("stitcher"), needle=needle)
    one_by_one = list(job)

    assert flat(job.runs()) == one_by_one
    assert flat(move_runs(job)) == one_by_one
    stitched = [r for r in job.runs() if isinstance(r, MoveRun)]
    assert all(run.columns["stitch"].dtype == np.int64 for run in stitched)
    contours = {}
    for run in stitched:
        contours.setdefault(int(run.columns["contour"][0]), []).append(run.columns)
    for parts in contours.values():
        stitch = np.concatenate([part["stitch"] for part in parts])
        needle_s = np.concatenate([part["needle_s"] for part in parts])
        assert (stitch == np.arange(len(stitch))).all()
        assert (np.diff(needle_s) > 0.0).all()


def test_columns_keep_what_is_absent_and_what_is_text() -> None:
    feed, source = Feed(FeedMode.PATH, 0.1), Source("a.nc", 3)
    tags = [
        {"stitch": 1, "thread": "red", "mixed": 1.5},
        {},
        {"stitch": 3, "mixed": "loose"},
        {"stitch": 4, "thread": "blue", "tension_N": 0.0},
    ]
    moves = [Move((float(k),), feed, source, own) for k, own in enumerate(tags)]
    run = gathered(moves)

    assert list(run) == moves
    assert run.columns["stitch"].dtype == np.float64  # one move has none: NaN
    assert np.isnan(run.columns["tension_N"][:3]).all()
    whole = gathered([moves[0], moves[0]])
    assert whole.columns["stitch"].dtype == np.int64
    assert whole.columns["thread"].tolist() == ["red", "red"]


def test_moves_without_tags_share_one_mapping() -> None:
    moves = [Move((0.0,), None, Source("a.nc", 1)) for _ in range(3)]
    assert columns_of([move.tags for move in moves]) == {}
    assert all(move.tags is NO_TAGS for move in gathered(moves))


def test_a_program_with_a_tag_called_stitch_is_no_seam(tmp_path: Path, examples: Path) -> None:
    """Its moves have no contours and no wanted lengths, in runs or one by one."""
    path = tmp_path / "tags.nc"
    path.write_text("G91 G1 F600 X1 ; stitch=1\nX1 ; stitch=2\nX-2 ; stitch=3 contour=1\nM30\n")

    assert not has_stitches(read_job(path, WINDER))
    assert has_stitches(read_job(examples / "badge.seam.toml", load_machine("stitcher")))
