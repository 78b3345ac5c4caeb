"""Blocks and positions for tests of dialects."""

from __future__ import annotations

import math
from pathlib import Path

from threadline.jobs import Job, Move, read_job
from threadline.machine import Machine


def read(folder: Path, machine: Machine, text: str, dialect: str | None, name: str = "a.nc") -> Job:
    """Return the job of a text."""
    path = folder / name
    path.write_text(text if text.endswith("\n") else text + "\n")
    return read_job(path, machine, **({} if dialect is None else {"dialect": dialect}))


def moves(job: Job) -> list[Move]:
    """Return its moves."""
    return [operation for operation in job if isinstance(operation, Move)]


def millimetres(job: Job) -> list[tuple[float, ...]]:
    """Return X Y Z in mm and A in degrees after every move."""
    return [(*(1e3 * p for p in m.target[:3]), math.degrees(m.target[3])) for m in moves(job)]


def numbered(number: int, code: str) -> str:
    """Return a line of a firmware with its number and checksum."""
    line, checksum = f"N{number} {code}", 0
    for byte in line.encode():
        checksum ^= byte
    return f"{line}*{checksum}"
