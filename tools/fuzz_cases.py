"""A hostile command line: what it may read, how it is run, and what is wrong with its answer.

``tools/fuzz_commands.py`` makes the cases; ``tools/fuzz_interrupts.py`` runs the same jobs.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from tools import short_jobs

from threadline.cli.main import main as run_program

LIBRARY = Path(__file__).resolve().parent.parent / "src" / "threadline" / "machine" / "library"
HANG_S = 60  # of the processor: the machine may be busy with something else
_WAITING = 15  # times as long by the clock, for what waits without working
_LONG = 124  # as ``timeout`` has it
WORD = re.compile(r"^still at work after \d+ s.*\n", re.MULTILINE)
COMPILING = re.compile(r"^compiling machine code.*\n", re.MULTILINE)
"""Word of a first run, which is no part of what the command says."""

JOBS = {
    "lathe-winder": "short.prg", "stitcher": "short.seam.toml", "letter-placer": "short.toml",
    "stepper-winder": "short.prg", "schiffli-frame": "short.dst", "table-embroiderer": "short.dst",
}  # fmt: skip

PLAIN = frozenset({"letter-placer", "schiffli-frame", "table-embroiderer"})
"""Machines that take no interpolation."""


@dataclass(frozen=True)
class Case:
    """A command line, and files that are written before it."""

    words: list[str]
    files: Mapping[str, str | bytes]
    reads: frozenset[str] | None = None
    """Files that must stay as they were; None for all."""


def lay_out(folder: Path) -> None:
    """Write what every case may read."""
    (folder / "short.prg").write_text(short_jobs.PROGRAM)
    (folder / "short.seam.toml").write_text(short_jobs.DRAWN_SEAM)
    (folder / "short.dst").write_bytes(short_jobs.DESIGN)
    (folder / "line.csv").write_text("x [mm],y [mm]\n10,10\n30,10\n30,20\n")
    (folder / "short.toml").write_text(short_jobs.MOVES)
    for name in JOBS:
        shutil.copy(LIBRARY / f"{name}.toml", folder / f"{name}-base.toml")
        for own in (name, f"{name}-base"):
            shutil.copy(LIBRARY / f"{name}.spec.toml", folder / f"{own}.spec.toml")


class HangError(BaseException):
    """A case took too long; nothing in the program catches this."""


def _on_alarm(_signal: int, _frame: FrameType | None) -> None:
    raise HangError


def watch(seconds: float) -> None:
    """Stop the case after so long; 0 for no longer watching it."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(int(_WAITING * seconds))


def answer_alarms() -> None:
    """Let both watches end a case."""
    for name in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(name, _on_alarm)


@dataclass(frozen=True)
class Outcome:
    """What came of a case: its status, and what is wrong with it (empty where nothing is)."""

    status: int
    problem: str
    took_s: float


def run_case(case: Case, folder: Path) -> Outcome:
    """Run a case in a folder of its own."""
    lay_out(folder)
    for name, text in case.files.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    _links(folder, ["short.prg", "lathe-winder-base.toml"])
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != "fifo.csv"}
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO()
    status, hung = 0, False
    began = time.process_time()
    watch(HANG_S)
    try:
        with (
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            run_program(case.words)
    except SystemExit as stopped:
        status = stopped.code if isinstance(stopped.code, int) else int(bool(stopped.code))
    except HangError:
        hung = True
    finally:
        watch(0)
    took_s = time.process_time() - began
    out.flush()
    output = out.buffer.getvalue().decode("utf-8", "replace")
    said = WORD.sub("", err.getvalue())
    if hung and said != err.getvalue():
        return Outcome(_LONG, "", took_s)
    said = COMPILING.sub("", said)
    problem = f"more than {HANG_S} s" if hung else _problem(case, status, output, said)
    if not hung and not problem:
        problem = _changed(case, before, folder, status)
    return Outcome(status, problem, took_s)


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is no JSON")


def _problem(case: Case, status: int, out: str, err: str) -> str:
    if status == 3 and err.startswith("error: [FAULT]") and err.count("\n") == 1:
        return ""  # of a fault that the case injected; what it prints of the run stays
    if status not in {0, 1, 2}:
        kept = re.search(r"the file (\S+\.txt)", err)
        trace = Path(kept[1]).read_text(encoding="utf-8")[-1500:] if kept else ""
        if kept:
            Path(kept[1]).unlink()
        return f"status {status}: {err}{trace}"
    if status == 2 and (out or err.count("\n") != 1 or not err.startswith("error: [")):
        return f"an error told otherwise than in one line: {err[:400]!r}, {out[:200]!r}"
    if set(err + out) & {"\x1b", "\x00", "\u202e", "\x9b"}:
        return f"controls of a terminal: {err[:400]!r} {out[:400]!r}"
    if status < 2 and "--json" in case.words:
        try:
            json.loads(out, parse_constant=_refuse)
        except (ValueError, TypeError):
            return f"no JSON: {out[:400]!r}"
    if any(word in err for word in ("Warning:", "Traceback")):
        return f"a library speaks: {err[:400]!r}"
    return ""


def _changed(case: Case, before: dict[Path, bytes], folder: Path, status: int) -> str:
    lost = [
        p.name
        for p, data in before.items()
        if (case.reads is None or p.name in case.reads)
        and (not p.is_file() or p.read_bytes() != data)
    ]
    if lost:
        return f"files that were there changed: {lost}"
    left = [p.name for p in folder.rglob(".*") if p.is_file() or p.is_dir()]
    fresh = [p.name for p in folder.rglob("*") if p.is_file() and p not in before]
    if left or (status == 2 and [name for name in fresh if name != "fifo.csv"]):
        return f"left behind: {left + fresh}"
    return ""


def _links(folder: Path, machine_files: list[str]) -> None:
    (folder / "soft.csv").symlink_to(machine_files[0])
    (folder / "hard.csv").hardlink_to(folder / machine_files[-1])
    (folder / "loop.csv").symlink_to("loop.csv")
    (folder / "dangling.csv").symlink_to("fresh.csv")
    (folder / "folder.csv").mkdir()
    (folder / "taken" / "report.html").mkdir(parents=True)
    (folder / "kept.csv").write_text("kept")
    (folder / "kept.csv").chmod(0o444)
    os.mkfifo(folder / "fifo.csv")
