"""The page on the architecture names every room, in the order that the linter holds."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_rooms_stand_in_their_order() -> None:
    """The table goes down the house; the contract has the same layers, the highest first."""
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    layers = contracts["importlinter:contract:layers"]["layers"].split("\n")
    wanted = [set(re.findall(r"\w+", layer)) for layer in reversed(layers) if layer.strip()]

    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [re.findall(r"`(\w+)/?`", cell) for cell in re.findall(r"^\| (`.*?) \|", page, re.M)]

    assert set(rows[0]) == wanted[0] | wanted[1]  # the ground floor is one row
    assert [set(row) for row in rows[1:]] == wanted[2:]
