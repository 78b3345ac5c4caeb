"""Interrupts at any moment of every command that writes, and disks that are full at any byte.

    python -m tools.fuzz_interrupts --cases 300 --seed 1

Every case is a process of its own, forked from this one, that runs one command in a folder of its
own. One in eleven is forked before anything else ran and has to import and load what its command
needs, which is most of its time; the others find all that loaded and spend theirs at work. It is
sent SIGINT, SIGTERM or SIGHUP, once or often, at a random moment of the time that the command
takes; or no file of it may be longer than so many bytes. What ends by a signal or by the disk says
so in one line, with the status of that, and leaves the folder as it was: no output, no temporary
file, no folder. What ends well has all of its outputs. Everything else is a failure, and the exit
status is 1.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from tools import short_jobs
from tools.fuzz_cases import WORD
from tools.fuzz_odd import ODD

from threadline.cli.interrupt import leaving_on_interrupt
from threadline.cli.main import main as run_program

ROOT = Path(__file__).resolve().parent.parent
_PLACE = "short.toml -m letter-placer+whole-scans+own-damping --shaper zv"
COMMANDS: dict[str, tuple[str, ...]] = {
    "compile short.prg -m lathe-winder --interpolation linear --target csv -o new/out.csv": (
        "new/out.csv",
    ),
    "compile short.prg -m lathe-winder --target npz -o out.npz": ("out.npz",),
    "compile short.prg -m stepper-winder --target grbl -o out.nc": ("out.nc",),
    f"compile {_PLACE} --target st -o out.st": (
        "out.st", "out.configuration.st",
    ),
    f"compile {_PLACE} --target plcopen -o out.xml": ("out.xml",),
    "compile short.dst -m schiffli-frame --target steps -o steps.bin": (),
    "prove short.prg -m lathe-winder --interpolation linear --recording r.npz --proof p.json": (
        "r.npz", "p.json",
    ),
    "prove short.prg -m lathe-winder --interpolation linear --recording r.csv --report rep": (
        "r.csv", "rep/report.html", "rep/report.pdf",
    ),
    "prove short.seam.toml -m stitcher --recording old.npz --nominal": ("old.npz",),
    "prove short.dst -m schiffli-frame --recording r.csv --nominal": ("r.csv",),
    f"prove {_PLACE} --report rep": (
        "rep/report.html",
    ),
    "fastest short.toml -m letter-placer+whole-scans+own-damping --nominal -o faster.toml": (
        "faster.toml",
    ),
    "fastest short.prg -m lathe-winder --interpolation linear --nominal": (),
    "yield short.prg -m lathe-winder --interpolation linear --variants 200 --worst worst.toml": (
        "worst.toml",
    ),
    "cam cam.csv --out law.csv --report rep": ("law.csv",),
    "law modified-sine --out law.csv --report rep": ("law.csv",),
    "analyse lathe-winder --report rep": ("rep",),
    "shaper --mode 3Hz --kind ei --report rep": ("rep",),
    "new winder fresh": ("fresh",),
    "new embroidery fresh": ("fresh",),
}  # fmt: skip
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
_SHOWN = 20
_COLD = 11  # one case of so many begins with nothing loaded; every command in its turn


def lay_out(folder: Path) -> None:
    """Write what the commands read, and an old output."""
    (folder / "short.prg").write_text(short_jobs.PROGRAM)
    (folder / "short.seam.toml").write_text(short_jobs.DRAWN_SEAM)
    (folder / "short.dst").write_bytes(short_jobs.DESIGN)
    (folder / "line.csv").write_text("x [mm],y [mm]\n10,10\n30,10\n30,20\n")
    (folder / "short.toml").write_text(short_jobs.MOVES)
    (folder / "cam.csv").write_bytes(ODD["cam"])
    (folder / "old.npz").write_bytes(b"an old recording")


def tree(folder: Path) -> dict[str, bytes | None]:
    """Return every file and folder below, with the bytes of the files."""
    return {
        str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None
        for p in folder.rglob("*")
    }


def start(words: list[str], folder: Path, side: Path, most_bytes: int) -> int:
    """Run a command in a fork of this process; return its number."""
    child = os.fork()
    if child:
        return child
    try:
        if most_bytes:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
        os.chdir(folder)
        os.environ["TMPDIR"] = tempfile.tempdir = str(side)
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(side / name, os.O_WRONLY | os.O_CREAT), number)
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        status = 70
        try:
            with leaving_on_interrupt():  # as the program's start has it
                run_program(words)
        except SystemExit as stopped:
            status = int(stopped.code or 0)
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


def run(
    words: list[str],
    wanted: tuple[str, ...],
    at: Sequence[tuple[float, int]],
    most_bytes: int = 0,
) -> tuple[int, str]:
    """Run a case; return its status and what is wrong with it."""
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryDirectory() as side:
        folder, side_path = Path(made), Path(side)
        lay_out(folder)
        before = tree(folder)
        child = start(words, folder, side_path, most_bytes)
        for wait_s, number in at:
            time.sleep(wait_s)
            if os.waitpid(child, os.WNOHANG)[0]:
                break
            os.kill(child, number)
        ended = 0
        while not ended:
            try:
                ended, raw = os.waitpid(child, 0)
            except ChildProcessError:
                ended, raw = child, 0
        status = os.waitstatus_to_exitcode(raw)
        after = tree(folder)
        err = WORD.sub("", (side_path / "err").read_text(errors="replace"))
        left = [p.name for p in side_path.iterdir() if p.name not in {"out", "err"}]
    fresh = sorted(set(after) - set(before))
    changed = sorted(p for p in before if after.get(p, b"gone") != before[p])
    hidden = [p for p in fresh if any(part.startswith(".") for part in Path(p).parts)]
    if hidden or left:
        return status, f"left behind: {hidden} {left}"
    if status in STATUS.values() or (status == 2 and most_bytes):
        if "cannot use standard output" in err and {*fresh, *changed} == {*wanted}:
            return status, ""  # its files are whole; what it says of them found no room
        if "its files are written completely" in err and {*wanted} <= {*fresh, *changed}:
            earlier = err.splitlines()[:-1]  # it may have begun to tell its warnings
            if all(line.startswith("warning: ") for line in earlier):
                return status, ""
            return status, f"more than one line: {err[-600:]!r}"
        if fresh or changed:
            return status, f"ended early, and there is {fresh}, changed {changed}"
        said = [line for line in err.splitlines() if not line.startswith("warning: ")]
        if len(said) != 1 or not said[0].startswith("error: "):
            return status, f"told otherwise than in one line: {err[-600:]!r}"
    elif status in {0, 1} or -status in STATUS:  # by a signal itself: before the work or behind it
        lacking = [p for p in wanted if p not in fresh and p not in changed]
        if lacking and not at:
            return status, f"ended well without {lacking}"
        if lacking and len(lacking) < len(wanted):
            return status, f"some of its outputs only: not {lacking}"
    else:
        return status, f"status {status}: {err[-1500:]}"
    return status, ""


def load_all() -> None:
    """Run every command once in this process, which its forks then need not prepare for."""
    with tempfile.TemporaryDirectory() as made, Path(os.devnull).open("w") as nowhere:
        lay_out(Path(made))
        with (
            contextlib.chdir(made),
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            for name in COMMANDS:
                with contextlib.suppress(SystemExit):
                    run_program(name.split())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--full", type=float, default=0.3, help="share of cases on a full disk")
    given = parser.parse_args()
    lasts: dict[str, float] = {}
    tally: Counter[int] = Counter()
    failures = 0
    names = list(COMMANDS)
    every = range(given.first, given.first + given.cases)
    cold = [index for index in every if index % _COLD == _COLD - 1]
    warm = [index for index in every if index % _COLD != _COLD - 1]
    for index in (*cold, *warm):
        if warm and index == warm[0]:
            load_all()
            lasts.clear()
        rng = random.Random(f"{given.seed}/{index}")
        name = names[index % len(names)]
        words, wanted = name.split(), COMMANDS[name]
        if name not in lasts:
            began = time.monotonic()
            status, problem = run(words, wanted, [])
            lasts[name] = time.monotonic() - began
            if problem or status not in {0, 1}:
                failures += 1
                print(f"{name}\nuninterrupted: {status} {problem}\n", file=sys.stderr, flush=True)
        number = rng.choice((signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
        at = [(rng.uniform(0.0, 1.1) * lasts[name], number)]
        more = rng.choice((0, 0, 1, 5))
        at += [(rng.choice((0.0, 1e-4, 1e-3, 2e-2)), number) for _ in range(more)]
        most_bytes = 0
        if rng.random() < given.full:
            at, most_bytes = [], int(10.0 ** rng.uniform(3.0, 6.0))
        status, problem = run(words, wanted, at, most_bytes)
        tally[status] += 1
        if problem:
            failures += 1
            if failures <= _SHOWN:
                again = f"--seed {given.seed} --first {index} --cases 1"
                case = f"{again}\n{name} {at} {most_bytes}"
                print(f"{case}\n{problem}\n", file=sys.stderr, flush=True)
    shown = ", ".join(f"{count} with status {status}" for status, count in sorted(tally.items()))
    print(f"{tally.total()} cases, {shown}; {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
