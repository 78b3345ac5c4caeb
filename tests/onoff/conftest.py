"""The placer's cycle, and its proof with a shaper."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.onoff.cycles import TRIMMED
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, prove
from threadline.verdict import load_spec


@pytest.fixture(scope="module")
def cycle() -> Path:
    return Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"


@pytest.fixture(scope="module")
def shaped(cycle: Path) -> Proof:
    machine = load_machine(TRIMMED)
    return prove(cycle, machine, load_spec(None, machine), Options(shaper="zv"))
