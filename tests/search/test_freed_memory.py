"""Judging many machines requests its memory once, not again for every part."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = """
import os, resource, sys
from pathlib import Path
import numpy as np
from threadline.machine import load_machine
from threadline.machine.variants import drawn
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof import judge_runs
from threadline.search.machine_yield import MachineYield
from threadline.verdict import load_spec

machine = load_machine("lathe-winder")
plan = plan_job(open_job(Path(sys.argv[1]), machine, Options()), machine, Options())
parts = drawn(machine, 1, np.arange(512))
for kept in (False, True):
    if child := os.fork():
        os.waitpid(child, 0)
        continue
    if not kept:
        judge_runs.keep_freed_memory = lambda: None
    judged = MachineYield(plan, load_spec(None, machine), threads=1)
    judged.judged(parts)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    judged.judged(parts)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before, flush=True)
    os._exit(0)
"""


def test_pages_are_asked_for_once(tmp_path: Path) -> None:
    """Two parts of 256 machines each: unless memory is kept, some ten thousand page faults."""
    if platform.libc_ver()[0] != "glibc":
        return  # other C libraries manage memory in other ways
    assert resource.getpagesize() <= 1 << 16
    job = tmp_path / "there-and-back.prg"
    job.write_text("G91\nG1 X20 F1000\nG1 X-20\nM30\n", encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "-c", FAULTS, str(job)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    not_kept, kept = map(int, ran.stdout.split())
    assert not_kept > 3000
    assert kept < 0.4 * not_kept
