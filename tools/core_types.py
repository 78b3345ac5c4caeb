"""Run the tests of the numerics as other processors would: ``python -m tools.core_types``.

numpy and scipy multiply and factor matrices with OpenBLAS, which has a kernel per kind of
processor; the kernels round differently. A decision that hangs on the last bits of such a result
is right on one processor and wrong on another. ``OPENBLAS_CORETYPE`` picks the kernel, so that one
machine can play the others.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NUMERICS = (
    "control",
    "identify",
    "jobs_winding",
    "laws",
    "onoff",
    "path",
    "plant",
    "plant_analysis",
    "search",
    "shaping",
    "signals",
    "stitching",
    "targets",
    "tension",
    "trajectory",
    "twin",
    "verdict",
    "winding",
)
"""Folders of tests whose outcome could hang on rounding in linear algebra."""
ON_LINUXCNC = "linuxcnc and waits"
"""Tests that wait for LinuxCNC's own planner in real time. What Threadline computes in them is
computed in tests beside them, too."""
CORE_TYPES = ("SkylakeX", "Haswell", "Prescott")
"""512-bit and 256-bit with fused multiply-add, and 128-bit, which no processor of today picks."""
NEEDS = {"SkylakeX": "avx512f", "Haswell": "fma", "Prescott": "pni"}
"""Flag of /proc/cpuinfo without which the kernel of a core type stops at an illegal instruction."""


def flags_of(cpuinfo: str) -> frozenset[str]:
    """Return the flags of the first processor in the text of /proc/cpuinfo."""
    for line in cpuinfo.splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "flags":
            return frozenset(value.split())
    return frozenset()


def own_core_type() -> str | None:
    """Return the kernel that numpy's OpenBLAS has picked here; None where it does not say."""
    import numpy as np

    for library in (Path(np.__file__).parent.parent / "numpy.libs").glob("*openblas*"):
        tell = getattr(ctypes.CDLL(str(library)), "scipy_openblas_get_corename64_", None)
        if tell is not None:
            tell.restype = ctypes.c_char_p
            return str(tell().decode())
    return None


def runs(flags: frozenset[str], own: str | None = None) -> list[str]:
    """Return the core types to run on, for a processor with these flags.

    A core type that the processor cannot play is left out, and so is ``own``, on which every test
    has been run.
    """
    return [core for core in CORE_TYPES if NEEDS[core] in flags and core != own]


def words_for(*, long: bool) -> tuple[str, ...]:
    """Return pytest's words for a run, with or without the long tests.

    A worker for each core: nothing waits, and each worker more imports everything once more.
    """
    words = ("-q", "-n", str(os.cpu_count() or 1), "--dist", "worksteal")
    left_out = ("-m", f"not ({ON_LINUXCNC})")
    folders = tuple(f"tests/{name}" for name in NUMERICS)
    return (*words, *(() if long else ("--without-long",)), *left_out, *folders)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests; return 1 if any run failed, or if there was nothing to run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--others", action="store_true", help="not on the core type of a plain run of the suite"
    )
    parser.add_argument("--long", action="store_true", help="with the long tests")
    parser.add_argument("rest", nargs="*", help="arguments for pytest, after --")
    chosen = parser.parse_args(arguments)
    if platform.machine() not in ("x86_64", "AMD64"):
        print(f"core types are those of x86-64, this is {platform.machine()}: nothing to run")
        return 0
    flags = flags_of(Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    own = own_core_type() if chosen.others else None
    planned = runs(flags, own)
    if own is not None:
        print(f"a plain run of the suite is on {own}: left out")
    left_out = sorted(core for core in CORE_TYPES if NEEDS[core] not in flags)
    if left_out:
        print(f"this processor cannot play {', '.join(left_out)}: left out")
    failed = []
    for core in planned:
        print(f"== {core}", flush=True)
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words_for(long=chosen.long), *chosen.rest],
            cwd=ROOT,
            env=os.environ | {"OPENBLAS_CORETYPE": core},
            check=False,
        )
        print(f"== {core}: {time.monotonic() - began:.0f} s", flush=True)
        if done.returncode != 0:
            failed.append(core)
    if failed or not planned:
        print(f"failed on {', '.join(failed) or 'every core type: none could run'}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
