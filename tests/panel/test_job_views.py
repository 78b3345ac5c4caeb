"""The views of a job: before it is calculated, and over the time of its plan."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.panel.bench import EXAMPLES, LOCAL, proven, served
from threadline.jobs.operations import Move
from threadline.machine import load_machine
from threadline.panel import server
from threadline.panel.calculation import Calculation
from threadline.panel.job_views import MOST_POINTS, preview
from threadline.panel.protocol import Figures, Preview
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("project")


def shown(folder: Path, machine: str) -> tuple[Preview, Figures]:
    words, found = proven(folder, machine)
    figures = {name: one for name, one in found.items() if name not in ("starts", "words")}
    before = preview(folder, words["program"], load_machine(machine))
    return Preview.model_validate(before), Figures.model_validate(figures)


def worst(figures: Figures, name: str) -> tuple[float, float, int]:
    """Return the largest used share of a limit, its time, and its line."""
    own = [c for c in figures.criteria if c.name == name and c.limit and c.measured is not None]
    share, one = max(((c.measured or 0.0) / (c.limit or 1.0), c) for c in own)
    return share, one.time_s or 0.0, one.job_line or 0


def test_the_programmed_path_and_its_lines_are_those_of_the_job(folder: Path) -> None:
    before, figures = shown(folder, "lathe-winder")
    machine = load_machine("lathe-winder")
    job = open_job(folder / "there.prg", machine, Options())
    moves = [one for one in job if isinstance(one, Move)]
    assert before.moves == len(moves)
    assert before.line == [0, *(one.source.line for one in moves)]
    for k, name in enumerate(job.axes):
        expected = [job.start[k], *(one.target[k] for one in moves)]
        assert before.planned[name] == pytest.approx(expected, abs=1e-6)
    assert before.text == (folder / "there.prg").read_text("utf-8").splitlines()
    # There and back at one speed: the second line begins at half of the time.
    assert figures.lines.line == [5, 6]
    assert figures.lines.times_s == pytest.approx([0.0, figures.duration_s / 2], abs=0.02)


@pytest.mark.long(but="schiffli-frame-stitch_residual-swing at the needle")
@pytest.mark.parametrize(
    "machine, criterion, words",
    [
        ("stitcher", "stitch_length_error", "length error"),
        ("schiffli-frame", "stitch_residual", "swing at the needle"),
    ],
)
def test_the_worst_stitch_is_the_one_of_the_verdict(
    folder: Path, machine: str, criterion: str, words: str
) -> None:
    """Its share of the limit, and the time at which it is sewn, to one stitch."""
    before, figures = shown(folder, machine)
    stitches = figures.stitches
    assert stitches is not None
    assert before.stitches is not None
    assert (stitches.x, stitches.y) == (before.stitches.x, before.stitches.y)
    assert stitches.count == len(stitches.x) == len(stitches.use)
    assert stitches.use_of == words
    share, time_s, _ = worst(figures, criterion)
    assert max(stitches.use) == pytest.approx(share, rel=1e-3)
    k = int(np.argmax(stitches.use))
    around = stitches.times_s[max(k - 2, 0) : k + 3]
    assert around[0] <= time_s <= around[-1]
    assert (np.diff(stitches.times_s) >= 0.0).all()
    assert len(stitches.threads) == (2 if machine == "schiffli-frame" else 0)


def test_the_steps_and_lanes_of_a_cycle_are_those_of_its_list(folder: Path) -> None:
    before, figures = shown(folder, "letter-placer")
    names = [one.name for one in figures.steps]
    assert names == [one.name for one in before.steps]
    assert names[:3] == ["start", "descend", "cut"]
    begins = [one.begin_s for one in figures.steps]
    assert begins == sorted(begins)
    knife = next(one for one in figures.lanes if one.name == "knife")
    cut = figures.steps[names.index("cut")].begin_s
    assert not knife.on
    assert cut <= knife.changes_s[0] <= figures.steps[names.index("lift")].begin_s
    assert any(one.input for one in figures.lanes)


def test_a_long_program_is_thinned(folder: Path) -> None:
    moves = [f"N {k} X {k % 100}.{k % 7};" for k in range(3 * MOST_POINTS)]
    lines = ["%", "O 1;", "G90;", "G01 F 2000;", *moves, "M30;", "%"]
    (folder / "long.prg").write_text("\n".join(lines), "utf-8")
    found = preview(folder, "long.prg", load_machine("lathe-winder"))
    assert found["moves"] == 3 * MOST_POINTS
    assert len(found["line"]) <= MOST_POINTS + 1


def test_a_preview_is_read_by_anyone_and_says_why_there_is_none(folder: Path) -> None:
    """A separate process reads the program, because reading may take long or crash."""
    proven(folder, "lathe-winder")
    (folder / "bad.prg").write_text("%\nG01 X nonsense;\n%\n", "utf-8")
    own = Calculation(load_machine("lathe-winder"), None, folder, folder)
    apart = asyncio.run(own.preview("there.prg"))
    with served(folder) as client:
        answer = client.get("/api/programs/there.prg/preview")
        view: dict[str, Any] = answer.json()
        assert Preview.model_validate(view) == Preview.model_validate_json(apart)
        for name, why in (("bad.prg", "bad.prg:2"), ("none.prg", "none.prg"), ("..%2Fx.prg", "")):
            refused = client.get(f"/api/programs/{name}/preview")
            assert refused.status_code in (404, 422)
            assert why in refused.text


def test_the_page_is_sent_compressed_and_kept_by_its_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A browser without compression gets it uncompressed; a file without a hash is not kept."""
    assets = tmp_path / "page" / "assets"
    assets.mkdir(parents=True)
    (assets.parent / "index.html").write_text("the page", "utf-8")
    (assets / "index-1.js").write_text("plain", "utf-8")
    (assets / "index-1.js.gz").write_bytes(b"\x1f\x8b packed")
    monkeypatch.setattr(server, "PAGE", assets.parent)
    (tmp_path / "there.prg").write_bytes((EXAMPLES / "x-180.prg").read_bytes())
    with served(tmp_path) as client:
        with client.stream("GET", "/assets/index-1.js") as packed:
            assert b"".join(packed.iter_raw()) == b"\x1f\x8b packed"
        plain = client.get("/assets/index-1.js", headers={**LOCAL, "accept-encoding": "identity"})
        page = client.get("/")
    assert packed.headers["content-encoding"] == "gzip"
    assert "javascript" in packed.headers["content-type"]
    assert plain.text == "plain"
    assert "immutable" in plain.headers["cache-control"]
    assert page.headers["cache-control"] == "no-store"
    assert page.headers["x-frame-options"] == "DENY"
