"""Blocks per second of the part-program reader, beside gcodeparser's and pygcode's.

All read the same generated file: G1 and three axis words on each line, an F here and there. Ours
checks every block, keeps exact sums, and gives each move its position, feed and place; the peers
split words (pygcode also sorts them by meaning) and keep neither modes nor positions. Ours is timed
from the file's name on, hash and first checking pass included.

Tags become columns of a run. What they cost is measured beside the same program in which the same
letters are a comment for people: blanks stand where the equals signs stood.
"""

from __future__ import annotations

import random
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

from threadline.jobs import read_job
from threadline.jobs.operations import MoveRun
from threadline.machine import load_machine

BLOCKS = 200_000
PYGCODE_BLOCKS = 5_000  # some seconds of it
LONG_BLOCKS = 5_000_000
REPEATS = 3
TAG_REPEATS = 15
UNIT = "block/s"
MACHINE = load_machine("lathe-winder")


def one_tag(k: int) -> str:
    """Return the tag of a winding program: its tension, which changes now and then."""
    return f" ; tension_N={20 + k // 1000 % 10}"


def five_tags(k: int) -> str:
    """Return five tags, of which some change with each block."""
    return (
        f" ; stitch={k} layer={k // 1000} circuit={k // 100} tension_N={20 + k % 7 / 2} "
        f"thread={k % 3}"
    )


def write_program(path: Path, blocks: int, comment: Callable[[int], str] | None = None) -> None:
    """Write a program of ``blocks`` moves about the start position."""
    rng = random.Random(1994)
    with path.open("w") as stream:
        stream.write("G91\n")
        for k in range(blocks):
            sign = 1 if k % 2 else -1
            feed = " F1200" if k % 100 == 0 else ""
            behind = comment(k) if comment is not None else ""
            a, x, y = rng.uniform(0, 30), rng.uniform(0, 5), rng.uniform(0, 1)
            stream.write(
                f"N{k % 99_999} G1 A{a:.3f} X{sign * x:.3f} Y{-sign * y:.3f}{feed}{behind}\n"
            )
        stream.write("M30\n")


def best_rate(read: Callable[[Path], int], path: Path) -> float:
    """Return the best of some readings, in blocks per second."""
    rates = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        count = read(path)
        rates.append(count / (time.perf_counter() - began))
    return max(rates)


def read_moves(path: Path) -> int:
    """Read a program move by move."""
    return sum(1 for _ in read_job(path, MACHINE))


def read_runs(path: Path) -> int:
    """Read a program in runs of moves, as the planner may."""
    items = read_job(path, MACHINE).runs()
    return sum(len(item) if isinstance(item, MoveRun) else 1 for item in items)


def read_gcodeparser(path: Path) -> int:
    from gcodeparser import parse_gcode_lines

    with path.open() as stream:
        return sum(1 for _ in parse_gcode_lines(stream))


def read_pygcode(path: Path) -> int:
    from pygcode import Line

    count = 0
    with path.open() as stream:
        for text in stream:
            count += bool(Line(text).block.words)
    return count


def run() -> list[dict[str, Any]]:
    """Return the entries of this comparison."""
    with tempfile.TemporaryDirectory() as folder:
        path, short, long = (Path(folder) / name for name in ("a.nc", "short.nc", "long.nc"))
        write_program(path, BLOCKS)
        write_program(short, PYGCODE_BLOCKS)
        read_runs(short)  # compiles the kernel, or loads it
        moves, runs = best_rate(read_moves, path), best_rate(read_runs, path)
        results = [
            entry(f"reader, {how} vs {peer}", ours, peer_rate(read, file), "")
            for peer, read, file in (
                ("gcodeparser", read_gcodeparser, path),
                ("pygcode", read_pygcode, short),
            )
            for how, ours in (("move by move", moves), ("in runs", runs))
        ]
        results += [with_tags(Path(folder), *tags) for tags in ((1, one_tag), (5, five_tags))]
        results.append(long_program(long))
        return results


def with_tags(folder: Path, count: int, tags: Callable[[int], str]) -> dict[str, Any]:
    """Compare a program with tags on every block to the same one with comments as long.

    Processor time, not the clock: the readings take turns, and the best of each counts.
    """
    paths = folder / "comments.nc", folder / "tags.nc"
    write_program(paths[0], BLOCKS, lambda k: tags(k).replace("=", " "))
    write_program(paths[1], BLOCKS, tags)
    best = [float("inf")] * 2
    for _ in range(TAG_REPEATS):
        for index, path in enumerate(paths):
            began = time.process_time()
            blocks = read_runs(path)
            best[index] = min(best[index], (time.process_time() - began) / blocks)
    found = entry(f"reader, tags in columns, {count} to a block", 1.0 / best[1], 1.0 / best[0], "")
    return {**found, "peer": "the same letters as a comment"}


def peer_rate(read: Callable[[Path], int], path: Path) -> float | None:
    try:
        return best_rate(read, path)
    except ImportError:
        return None


def long_program(path: Path) -> dict[str, Any]:
    """Read five million blocks; the note has the peak memory of the reader."""
    write_program(path, LONG_BLOCKS)
    began = time.perf_counter()
    count = read_runs(path)
    rate = count / (time.perf_counter() - began)
    tracemalloc.start()
    read_runs(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    size_mb = path.stat().st_size / 1e6
    note = f"{count} blocks, {size_mb:.0f} MB of text, peak {peak / 1e6:.1f} MB allocated"
    return entry("reader, five million blocks in runs", rate, None, note)


def entry(name: str, ours: float, peer: float | None, note: str) -> dict[str, Any]:
    compared = "" if peer is None else f"{ours:,.0f} against {peer:,.0f} block/s"
    return {
        "name": name,
        "ours": ours,
        "peer": name.rpartition(" vs ")[2] if " vs " in name else None,
        "peer_value": peer,
        "ratio": None if peer is None else ours / peer,
        "unit": UNIT,
        "note": note or compared or f"{ours:,.0f} block/s; the peer is not installed",
    }
