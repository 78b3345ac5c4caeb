"""Each hazard in the table of docs/safety.md has a guard, and tests that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def hazards() -> list[tuple[str, str, list[str]]]:
    """Return the rows of the table: hazard, guard, files of tests."""
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8").partition("## Hazards")[2]
    rows = [line.strip("|").split("|") for line in page.splitlines() if line.startswith("| ")]
    return [(h.strip(), g.strip(), re.findall(r"`([^`]+)`", tests)) for h, g, tests in rows[1:]]


def names_in(file: Path) -> list[str]:
    """Return the names of the tests of a file, in Python or of the page."""
    if file.suffix == ".ts":
        return re.findall(r'\bit\(\s*"([^"]+)"', file.read_text(encoding="utf-8"))
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]
    stateful = [n.targets[0].id for n in tree.body if isinstance(n, ast.Assign)
                and isinstance(n.targets[0], ast.Name)]  # fmt: skip
    return [n.name for n in functions if n.name.startswith("test_")] + [
        name for name in stateful if name.startswith("Test")
    ]


@pytest.mark.parametrize(("hazard", "guard", "tests"), hazards())
def test_a_hazard_has_a_guard_and_tests(hazard: str, guard: str, tests: list[str]) -> None:
    assert hazard
    assert guard
    assert tests, hazard
    for named in tests:
        path = ROOT / named
        files = sorted(path.glob("test_*.py")) if path.is_dir() else [path]
        assert files, named
        assert all(names_in(file) for file in files), named


def test_every_file_of_live_tests_stands_in_the_table() -> None:
    """A test that no hazard names would be forgotten when its guard is reviewed."""
    named = {test for _, _, tests in hazards() for test in tests}
    here = {f"tests/live/{file.name}" for file in Path(__file__).parent.glob("test_*.py")}
    about_others = {
        f"tests/live/test_{name}.py"
        for name in ("hazards", "signals", "guards_removed", "host_names")
    }
    assert here - about_others <= named
