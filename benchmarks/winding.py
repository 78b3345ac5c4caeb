"""Blocks per second of the replay and of the coverage, and the time from a product to its program.

The program is the vessel of the examples, wound until it has a million blocks. It is replayed on
its mandrel as it is read; the bands are drawn on a raster of a twentieth of their width. The rates
are of processor time. No peer replays a finished program.

The time to a program is that of the whole command ``threadline wind NAME -m MACHINE -o FILE``, with
its start and its check of the program that it wrote.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict.replayed import WoundJob, wound_job
from threadline.winding.raster import Raster

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
CIRCUITS = 3760
"""Of 266 blocks each."""
VESSEL = """[mandrel]
at = "100 mm"
[[part]]
kind = "hemisphere"
radius = "100 mm"
opening = "17 mm"
pole = "left"
[[part]]
kind = "cylinder"
radius = "100 mm"
length = "400 mm"
[[part]]
kind = "hemisphere"
radius = "100 mm"
opening = "17 mm"
pole = "right"
[band]
width = "6 mm"
[friction]
value = "0.2"
[[layer]]
circuits = 103
shift = 27
"""


def eyes_of(program: Path) -> tuple[WoundJob, Iterator[tuple[FloatArray, IntArray]]]:
    """Return the job on its mandrel, and the eye at the ends of its blocks with their numbers."""
    machine = load_machine("lathe-winder")
    options = options_of(product=str(EXAMPLES / "vessel.wind.toml"), interpolation="linear")
    plan = plan_job(open_job(program, machine, options), machine, options)
    job = wound_job(plan)
    assert job is not None
    blocks = (
        (job.eyes(np.asarray(block.positions)), np.asarray(block.operation))
        for block in plan.motion.programmed
        if len(block)
    )
    return job, blocks


def wind(program: Path) -> tuple[int, float, float]:
    """Return the blocks of a program, and the seconds of the replay and of the coverage."""
    job, blocks = eyes_of(program)
    replay, covered = job.replay(), job.product.covered
    assert covered is not None
    raster, count, times = Raster(job.surface, job.width_m, *covered), 0, [0.0, 0.0]
    for eyes, operation in blocks:
        began = time.process_time()
        fibre = replay.feed(eyes, operation)
        laid = time.process_time()
        raster.lay(fibre.u, fibre.angle, fibre.winding, fibre.known, operation)
        times[0] += laid - began
        times[1] += time.process_time() - laid
        count += len(eyes)
    return count, times[0], times[1]


def to_program(folder: Path) -> tuple[float, int]:
    """Return the processor time from a product file to its program, s, and the program's bytes."""
    product, program = folder / "large.wind.toml", folder / "large.prg"
    product.write_text(VESSEL)
    words = [sys.executable, "-m", "threadline", "wind", str(product), "-m", "lathe-winder"]
    times = []
    for _ in range(3):  # the first one compiles the kernels, if nothing did before
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([*words, "-o", str(program)], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return min(times), program.stat().st_size


def run() -> list[dict[str, Any]]:
    """Return the entries of this comparison."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "long.prg"
        text = (EXAMPLES / "vessel.prg").read_text()
        wind(EXAMPLES / "vessel.prg")  # compiles the kernels, or loads them
        program.write_text(text.replace("L 44;", f"L {CIRCUITS};"))
        count, replayed_s, covered_s = wind(program)
        tracemalloc.start()
        wind(program)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        took_s, size = to_program(Path(folder))
    note = f"{count} blocks, peak {peak / 1e6:.0f} MB allocated for both"
    made = {
        "name": "from mandrel and layer to a program", "ours": took_s, "peer": None,
        "peer_value": None, "ratio": None, "unit": "s",
        "note": f"{took_s:.2f} s of processor time for 103 circuits, {size} bytes",
    }  # fmt: skip
    return [
        entry("replay of a winding", count / replayed_s, note),
        entry("coverage of a winding", count / covered_s, note),
        made,
    ]


def entry(name: str, rate: float, note: str) -> dict[str, Any]:
    return {
        "name": name, "ours": rate, "peer": None, "peer_value": None, "ratio": None,
        "unit": "block/s", "note": f"{rate:,.0f} block/s; {note}",
    }  # fmt: skip
