"""Hostile stores of runs, and options of runs and laws, for ``tools/fuzz_commands.py``."""

from __future__ import annotations

import random
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import asdict
from functools import cache
from pathlib import Path

from threadline.live.store.index import RunIndex, RunRecord

Words = list[str]
Files = dict[str, str | bytes]
Number = Callable[[random.Random, str, str], str]

VALUES = [
    None, 0, -1, 1.5, float("inf"), 9e999, 1 << 62, "", "x", "..", "../../etc", "a\0b",
    "[/b]\x1b[2J", b"\0\xff", "a" * 100_000, "\u202egrp", "last", "1994-01-01",
]  # fmt: skip
LAWS = ("trapezoid", "trapezoidal-acceleration", "modified-constant-velocity", "harmonic")
FAULTS = (
    "stuck-encoder:X",
    "lost-link",
    "power-loss",
    "late-ticks",
    "explode",
    "switch-hit:x_high",
)


@cache
def _good_index() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "index.sqlite"
        index = RunIndex(file)
        index.add(
            RunRecord(
                run="20261122-120000-a", started="2026-11-22T12:00:00+00:00", job="a.prg",
                machine="m", link="sim", speed=0.0, level="nominal", proof_passed=True,
                job_sha256="", machine_sha256="", commands_sha256="", proof_sha256="",
                threadline="0",
            )
        )  # fmt: skip
        return file.read_bytes()


def store(rng: random.Random) -> tuple[Words, Files]:
    """List or judge the runs of an index that holds other values, other columns, or is damaged."""
    data = bytearray(_good_index())
    kind = rng.randrange(4)
    if kind == 0:
        for _ in range(rng.choice((1, 5, 50))):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif kind == 1:
        del data[rng.randrange(len(data)) :]
    else:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "index.sqlite"
            file.write_bytes(data)
            with closing(sqlite3.connect(file)) as index, index:
                names = list(asdict(RunRecord(**dict.fromkeys(_REQUIRED, ""))))  # type: ignore[arg-type]
                column = rng.choice(names)
                if kind == 2:
                    # Some columns are never null; others take no number of that size.
                    with suppress(sqlite3.Error, OverflowError):
                        index.execute(f"update runs set {column} = ?", (rng.choice(VALUES),))
                else:
                    index.execute(f"alter table runs rename column {column} to other")
            data = bytearray(file.read_bytes())
    words = rng.choice((["runs"], ["runs", "--json"], ["report", "last"], ["report", "a"]))
    return [*words, "--store", "."], {"index.sqlite": bytes(data)}


def options(rng: random.Random, number: Number) -> tuple[Words, Files]:
    """Give a run, or a proof by a law, numbers of all sizes; most are refused before the work."""
    words = ["prove", "short.prg", "-m", "lathe-winder", "--nominal"]
    if rng.random() < 0.5:
        words = ["run", "short.prg", "-m", "lathe-winder", "--nominal", "--speed", "0"]
        words += ["--store", rng.choice(("s", "a?b", "a%b", "short.prg", "", "kept.csv"))]
        fault = f"{rng.choice(FAULTS)}@{number(rng, 's', '0.1')}"
        words += ["--inject", fault] if rng.random() < 0.7 else ["--speed", number(rng, "", "0")]
    elif rng.random() < 0.7:
        law = f"{rng.choice(LAWS)}:{number(rng, '', '0.2')}"
        if rng.random() < 0.5:
            mode = f"{number(rng, 'Hz', '12')}:{number(rng, '', '0.02')}".replace(" ", "")
            law = f"modified-sine*zv:{mode} in {number(rng, 'ms', '160')}"
        words += ["--law", law]
    else:
        words += ["--radius", f"A={number(rng, 'mm', '40')}"]
    return words, {}


_REQUIRED = (
    "run", "started", "job", "machine", "link", "speed", "level", "proof_passed", "job_sha256",
    "machine_sha256", "commands_sha256", "proof_sha256", "threadline",
)  # fmt: skip
