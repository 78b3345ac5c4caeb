"""Run the tests of the numerics as other processors would: ``python -m tools.core_types``.

numpy and scipy multiply and factor matrices with OpenBLAS, which has a kernel per kind of
processor; the kernels round differently. A decision that hangs on the last bits of such a result
is right on one processor and wrong on another. ``OPENBLAS_CORETYPE`` picks the kernel, so that one
machine can play the others.

All runs go on at the same time and share the cores. A process then imports, loads machine code and
makes the plans of a test file once for a kernel, and not once for a kernel and a core.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile

ROOT = Path(__file__).resolve().parent.parent
NUMERICS = (
    "commands",
    "dynamics",
    "files",
    "identify",
    "jobs/winding",
    "motion",
    "onoff",
    "search",
    "stitching",
    "tension",
    "twin",
    "verdict",
    "winding",
)
"""Folders of tests whose outcome could hang on rounding in linear algebra."""
WITHOUT = ("commands/plc",)
"""Folders below them whose outcome could not."""
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


def words_for(*, long: bool, workers: int) -> tuple[str, ...]:
    """Return pytest's words for a run, with or without the long tests.

    A run with one worker is one process. Several take from each other what is left.
    """
    spread = ("-n", str(workers), "--dist", "worksteal") if workers > 1 else ("-p", "no:xdist")
    left_out = (
        *("-m", f"not ({ON_LINUXCNC})"),
        *(f"--ignore=tests/{name}" for name in WITHOUT),
    )
    folders = tuple(f"tests/{name}" for name in NUMERICS)
    return ("-q", *spread, *(() if long else ("--without-long",)), *left_out, *folders)


def _processor_s() -> float:
    """Return the processor time of all children that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_together(commands: Mapping[str, Sequence[str]], key: str) -> list[str]:
    """Run commands at the same time, print the output of each in one piece, in their order.

    Parameters
    ----------
    commands
        By name, a command each.
    key
        Environment variable that each command finds its own name in.

    Returns
    -------
    list of str
        Names of the commands that failed.
    """
    failed = []
    with ExitStack() as stack:
        begun = []
        for name, words in commands.items():
            said = stack.enter_context(TemporaryFile("w+", encoding="utf-8", errors="replace"))
            environment = os.environ | {key: name}
            run = subprocess.Popen(
                words, cwd=ROOT, env=environment, stdout=said, stderr=subprocess.STDOUT
            )
            stack.callback(run.wait)
            stack.callback(run.terminate)  # one that has ended is left alone
            begun.append((name, run, said))
        for name, run, said in begun:
            before_s = _processor_s()
            code = run.wait()
            took_s = _processor_s() - before_s
            said.seek(0)
            print(f"== {name}\n{said.read()}", end="")
            print(f"== {name} ended with {code}, {took_s:.0f} s of the processor", flush=True)
            if code != 0:
                failed.append(name)
    return failed


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
    print(f"all at the same time, told when they have ended: {', '.join(planned)}", flush=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # and end the runs
    cores = os.cpu_count() or 1
    words = words_for(long=chosen.long, workers=max(cores // max(len(planned), 1), 1))
    one = [sys.executable, "-m", "pytest", *words, *chosen.rest]
    failed = run_together(dict.fromkeys(planned, one), "OPENBLAS_CORETYPE")
    if failed or not planned:
        print(f"failed on {', '.join(failed) or 'every core type: none could run'}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
