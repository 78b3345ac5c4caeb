"""Judging many machines asks for its memory once, and not again for every part of them."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = """
import resource, sys
from pathlib import Path
import numpy as np
from threadline.machine import load_machine
from threadline.machine.variants import drawn
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof import judge_runs
from threadline.search.machine_yield import MachineYield
from threadline.verdict import load_spec

if sys.argv[1] == "not kept":
    judge_runs.keep_freed_memory = lambda: None
machine = load_machine("lathe-winder")
plan = plan_job(open_job(Path("examples/x-180.prg"), machine, Options()), machine, Options())
judged = MachineYield(plan, load_spec(None, machine), threads=1)
parts = drawn(machine, 1, np.arange(512))
judged.judged(parts)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
judged.judged(parts)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(how: str) -> int:
    ran = subprocess.run(
        [sys.executable, "-c", FAULTS, how], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return int(ran.stdout)


def test_pages_are_asked_for_once() -> None:
    """Of two parts of 256 machines each: some ten thousand pages where nothing is kept."""
    if platform.libc_ver()[0] != "glibc":
        return  # other C libraries have ways of their own
    assert resource.getpagesize() <= 1 << 16
    kept, not_kept = faults("kept"), faults("not kept")
    assert not_kept > 3000
    assert kept < 0.4 * not_kept
