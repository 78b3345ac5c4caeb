"""``import threadline as tl``: what it has, that its page is true, and that it costs nothing."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

import threadline as tl
from threadline import face
from threadline.errors import InputError, OptionError
from threadline.jobs.operations import Pace
from threadline.search.by_pace import SEARCHES

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "api.md"


def test_every_pace_of_a_job_has_its_search() -> None:
    assert set(SEARCHES) == set(get_args(Pace))


def test_the_page_lists_the_face_and_nothing_else() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert listed == tl.__all__ == face.__all__
    assert set(tl.__all__) < set(dir(tl))
    for name in tl.__all__:
        assert getattr(tl, name) is getattr(face, name)
        assert getattr(tl, name).__doc__
    stub = (Path(tl.__file__).parent / "__init__.pyi").read_text(encoding="utf-8")
    assert re.findall(r"^from threadline\.face import (\w+) as \1$", stub, re.M) == tl.__all__
    with pytest.raises(AttributeError, match="has no attribute 'prof'"):
        tl.prof  # noqa: B018


def test_the_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder that holds the examples; the files that they write lie there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    found = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert found.attempted > 10
    assert found.failed == 0
    assert (tmp_path / "x.proof.json").is_file()


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import sys, threadline; print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "threadline" in done.stdout
    for heavy in ("numpy", "scipy", "numba", "matplotlib", "pydantic", "typer"):
        assert f"'{heavy}'" not in done.stdout


def test_mistakes_are_told_as_on_the_command_line() -> None:
    example = ROOT / "examples" / "x-180.prg"
    with pytest.raises(OptionError, match=r"unknown option 'interpolaton'\. Did you mean"):
        tl.prove(example, "lathe-winder", interpolaton="linear")
    with pytest.raises(OptionError, match="repeats must be at least 1"):
        tl.prove(example, "lathe-winder", repeats=0)
    with pytest.raises(OptionError, match="there is no recording to judge"):
        tl.judge([])
    with pytest.raises(OptionError, match="no interpolation to compare"):
        tl.compare(example, "lathe-winder", [])
    with pytest.raises(InputError, match="is of another kind of machine"):
        tl.compile(example, "lathe-winder", "st", "x.st")
    with pytest.raises(OptionError, match="is of feed-forward"):
        tl.prove(example, "lathe-winder", smoothing="40 ms")


def test_the_search_is_chosen_by_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of job has its own, with the machine and the margin that were asked for."""
    from threadline.search import by_pace

    asked = []

    def noted(name: str):
        def searched(job, machine, spec, *rest, **more):
            asked.append((name, machine.name, spec))
            raise KeyError(name)

        return searched

    monkeypatch.setattr(by_pace, "fastest_job", noted("feed"))
    monkeypatch.setattr(by_pace, "fastest_needle", noted("needle"))
    monkeypatch.setattr(by_pace, "fastest_cycle", noted("cycle"))
    for job, machine, name in (
        ("x-180.prg", "lathe-winder", "feed"),
        ("stitcher-test-path.seam.toml", "stitcher", "needle"),
        ("letter-cycle.toml", "letter-placer", "cycle"),
    ):
        with pytest.raises(KeyError, match=name):
            tl.fastest(ROOT / "examples" / job, machine, margin="20 %")
    whole = [face.load_spec(None, tl.load_machine(machine)) for _, machine, _ in asked]
    assert [spec for _, _, spec in asked] == [spec.with_margin(0.2) for spec in whole]
