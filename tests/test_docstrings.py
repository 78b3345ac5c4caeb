"""The examples in docstrings run.

There is one test for each file with examples: pytest's own collector imports and searches all files
of the package in each of its workers, which takes a tenth of the time of all tests.
"""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import threadline

PACKAGE = Path(threadline.__file__).parent
FILES = sorted(
    str(file.relative_to(PACKAGE.parent))
    for file in PACKAGE.rglob("*.py")
    if ">>> " in file.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("file", FILES)
def test_examples_run(file: str) -> None:
    name = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 0 and found.failed == 0
