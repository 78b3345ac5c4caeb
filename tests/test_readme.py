"""The README's own words run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from threadline.cli.lazy import COMMANDS

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """One verb per arrow, from job to verdict; a pulled B-spline meets every turning point."""
    monkeypatch.chdir(ROOT)
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)

    turning = names["verdict"].result("turning_point_error", "Y")  # type: ignore[attr-defined]
    assert turning.measured < 0.05e-3
    assert turning.status == "passed"


def test_every_command_of_the_readme_exists() -> None:
    named = set(re.findall(r"^threadline (\w+)", README, re.MULTILINE))
    assert named
    assert named <= set(COMMANDS)


def test_every_link_of_the_documents_leads_somewhere() -> None:
    for file in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", file.read_text(encoding="utf-8")):
            if not target.startswith(("http:", "https:")):
                assert (file.parent / target).exists(), f"{file.name}: {target}"
