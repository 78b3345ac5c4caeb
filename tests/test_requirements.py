"""The needs of the package agree: imports, declarations, and the lock."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
DECLARED = [Requirement(line) for line in PROJECT["dependencies"]]
OF_CLUSTER = [Requirement(line) for line in PROJECT["optional-dependencies"]["cluster"]]
"""What an extra adds: only the code that needs it imports it."""
OLDEST = {"python_full_version": "3.11.0", "python_version": "3.11"}
"""The oldest Python that is supported."""
COME_WITH = {
    "h11": "uvicorn",
    "markupsafe": "jinja2",
    "pydantic_core": "pydantic",
    "starlette": "fastapi",
}
"""What is imported and belongs to a package that is declared."""


def imported(file: Path) -> set[str]:
    """Return the packages that a file imports anywhere."""
    names: list[str] = []
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.append(str(node.module))
    return {name.partition(".")[0] for name in names}


def locked(name: str) -> list[Requirement]:
    text = (ROOT / "requirements" / f"{name}.txt").read_text("utf-8")
    return [Requirement(found) for found in re.findall(r"^([a-z].*?) \\$", text, re.M)]


def for_the_oldest(marker: Marker | None) -> bool:
    return marker is None or marker.evaluate(dict(OLDEST))


def test_all_that_is_imported_is_declared_and_the_other_way_round() -> None:
    used = set().union(*map(imported, (ROOT / "src").rglob("*.py")))
    used -= {"threadline", *sys.stdlib_module_names}
    declared = {requirement.name for requirement in [*DECLARED, *OF_CLUSTER]}
    # The server reads the websocket with the package that its option ``ws`` names.
    assert {COME_WITH.get(name, name) for name in used} | {"websockets"} == declared


def test_the_lower_bounds_are_the_releases_of_the_lock() -> None:
    """Compared up to the feature release: 2.4 for 2.4.6."""
    held = {one.name: one.specifier for one in locked("cluster") if for_the_oldest(one.marker)}
    for requirement in [*DECLARED, *OF_CLUSTER]:
        (bound,), (lock,) = requirement.specifier, held[requirement.name]
        assert bound.operator == ">=", requirement
        assert Version(bound.version).release == Version(lock.version).release[:2], requirement


def test_every_lock_holds_what_the_package_needs() -> None:
    for name in ("run", "cluster", "dev", "bench"):
        held = {one.name: str(one.specifier) for one in locked(name)}
        needed = DECLARED if name == "run" else [*DECLARED, *OF_CLUSTER]
        assert {requirement.name for requirement in needed} <= set(held), name


def test_a_cluster_has_the_versions_of_a_computer_alone() -> None:
    """A worker of another version is refused: both locks must hold the same."""
    run, cluster = (
        {(one.name, str(one.marker)): str(one.specifier) for one in locked(name)}
        for name in ("run", "cluster")
    )
    assert run.items() <= cluster.items()
