"""Run the tests as other processors would: ``python -m tools.core_types [--whole] [--others]``.

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
    "laws",
    "onoff",
    "path",
    "plant",
    "plant_analysis",
    "shaping",
    "targets",
    "trajectory",
    "twin",
    "verdict",
    "winding",
)
"""Folders of tests whose outcome could hang on rounding in linear algebra."""
ON_LINUXCNC = "linuxcnc and waits"
"""Tests that wait for LinuxCNC's own planner in real time. What Threadline computes in them is
computed in tests beside them, too."""
WHOLE = "Prescott"
"""The kernel that no processor of today picks by itself: the whole suite runs on it."""
CORE_TYPES = ("SkylakeX", "Haswell")
"""512-bit and 256-bit, with fused multiply-add: the numerics run on each."""
NEEDS = {"SkylakeX": "avx512f", "Haswell": "fma", "Prescott": "pni"}
"""Flag of /proc/cpuinfo without which the kernel of a core type stops at an illegal instruction."""
BROWSED = "tests/panel/test_page*.py"
"""Tests of the page in a browser, whose arithmetic OpenBLAS does not do: a plain run has them."""

LEFT_OUT = (
    f"--ignore-glob={BROWSED}",
    "-m",
    f"not ({ON_LINUXCNC})",
)
"""What no other kernel can change, in pytest's words."""


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


def runs(
    flags: frozenset[str], *, whole: bool, own: str | None = None
) -> list[tuple[str, tuple[str, ...]]]:
    """Return what is to run, as (core type, folders), on a processor with these flags.

    No folders mean the whole suite. A core type that the processor cannot play is left out, and so
    is ``own``, on which every test has been run.
    """
    planned: list[tuple[str, tuple[str, ...]]] = [(WHOLE, ())] if whole else []
    folders = tuple(f"tests/{name}" for name in NUMERICS)
    planned += [(core, folders) for core in CORE_TYPES]
    return [(core, each) for core, each in planned if NEEDS[core] in flags and core != own]


def words_for(folders: tuple[str, ...]) -> tuple[str, ...]:
    """Return pytest's words for a run: over every core, without what no other kernel can change.

    The whole suite has more workers than cores, as in ``make test``: some wait for machines. In the
    numerics nothing waits, and each worker more imports everything once more.
    """
    workers = str(os.cpu_count() or 1) if folders else "auto"
    return ("-q", "-n", workers, "--dist", "worksteal", *LEFT_OUT, *folders)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests; return 1 if any run failed, or if there was nothing to run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--whole", action="store_true", help=f"the whole suite on {WHOLE}, too")
    parser.add_argument(
        "--others", action="store_true", help="not on the core type of a plain run of the suite"
    )
    parser.add_argument("rest", nargs="*", help="arguments for pytest, after --")
    chosen = parser.parse_args(arguments)
    if platform.machine() not in ("x86_64", "AMD64"):
        print(f"core types are those of x86-64, this is {platform.machine()}: nothing to run")
        return 0
    flags = flags_of(Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    own = own_core_type() if chosen.others else None
    planned = runs(flags, whole=chosen.whole, own=own)
    if own is not None:
        print(f"a plain run of the suite is on {own}: left out")
    left_out = sorted(core for core in CORE_TYPES if NEEDS[core] not in flags)
    if left_out:
        print(f"this processor cannot play {', '.join(left_out)}: left out")
    failed = []
    for core, folders in planned:
        print(f"== {core}: {' '.join(folders) or 'the whole suite'}", flush=True)
        began = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words_for(folders), *chosen.rest],
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
