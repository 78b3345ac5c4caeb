"""Every number of every machine file of the library, one by one, with all kinds of odd values.

A file with one such number is proved, analysed or compiled, or refused in one line. ``python -m
tools.fuzz_commands --kind machine-number`` goes through all of them.
"""

from __future__ import annotations

import json
import random
import signal
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from tools import fuzz_commands

LIBRARY = Path(__file__).resolve().parents[2] / "src" / "threadline" / "machine" / "library"
CASES = 14


@pytest.fixture(scope="module")
def commands() -> Iterator[ModuleType]:
    watches = (signal.SIGALRM, signal.SIGPROF)
    before = [signal.getsignal(watch) for watch in watches]
    fuzz_commands.answer_alarms()
    yield fuzz_commands
    for watch, answer in zip(watches, before, strict=True):
        signal.signal(watch, answer)


@pytest.mark.parametrize("index", range(CASES))
def test_a_number_out_of_range_is_refused_in_one_line(
    commands: ModuleType, index: int, tmp_path: Path
) -> None:
    case = commands.machine_number(random.Random(f"5/{index}"), index)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = commands.run_case(case, tmp_path)
    assert not found.problem, (case.words, case.files["m.toml"])


def test_no_number_is_left_out(commands: ModuleType) -> None:
    """There is a case for each line with a number, and each case changes one of them."""
    machines = [p for p in LIBRARY.glob("*.toml") if ".spec." not in p.name]
    assert {n.machine for n in commands.NUMBERS} >= {"lathe-winder", "stepper-winder", "stitcher"}
    lines = [line for p in machines for line in p.read_text().splitlines()]
    written = sum(line.count(" exact") + line.count(" +- ") for line in lines if line[:1] != "#")
    assert len(commands.NUMBERS) >= 0.9 * written
    total = len(commands.NUMBERS) * len(commands.CHANGES)
    found = {
        json.dumps(tomllib.loads(text)) + text
        for k in range(total)
        for text in commands.machine_number(random.Random(0), k).files.values()
    }
    assert len(found) > 0.99 * total  # -1 is the negative of the numbers that are 1
