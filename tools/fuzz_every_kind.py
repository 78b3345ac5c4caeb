"""Each change that must not matter, and each that must, for each kind of machine equally often.

    python -m tools.fuzz_every_kind --rounds 300 --processes 2 --kept counts.jsonl

A round draws one short job for each kind (winder, stitcher, schiffli frame, letter placer, machines
with a firmware), proves it, and makes every change ``EACH`` times: to the job, to the machine, to
the recording, to the limits. A case is one changed thing beside the one before. A changed recording
is judged, and every value and status must be as before; those that may lie side by side are runs
of one recording, each with a noise of its own. A changed job or machine is read and compared number
by number; one of ``--proved`` is proved by the face, and one of ``--whole`` by a process of the
command line, and the verdicts are compared.

What each round counted goes to the file ``--kept``; rounds that it has are not run again. The table
says how many cases each change and kind had; what only some works allow (inches, without a turning
axis) is done to these more often. The exit status is 1 if anything differed; ``--round 7 --rounds 1
--kind winder`` runs a part of them again.
"""

from __future__ import annotations

import argparse
import atexit
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from tools import fuzz_runs
from tools.fuzz_changed_runs import (
    JUDGED_BY_THE_FACE,
    LIMITS,
    OF_MACHINE,
    RECORDED,
    Base,
    RunCheck,
    bases_of,
)
from tools.fuzz_read_works import hold_machines, hold_read, numbers_of, read
from tools.fuzz_same_programs import Outcomes, outcomes_of_proof, same_verdicts
from tools.fuzz_works import Change, Kind, Programs, Work, Written
from tools.fuzz_works_of_others import Embroiderer, Placer, Stitcher

import threadline as tl
from threadline.errors import ThreadlineError
from threadline.face.answers import Proved
from threadline.machine import Machine

EACH = 32
"""How often a round makes each change of each kind."""
_HANG_S = 20  # of the processor
_WAITING = 180  # times as long by the clock, for what waits without working
_SHOWN = 5
_MADE_HERE = ("axes in another order", "axes renamed")
"""Changes of a machine in memory: no file has it, so that no other process can load it."""


@dataclass
class Tally:
    """What came of a round with a kind, or with all of them."""

    seed: int
    round: int
    kind: str = ""
    cases: Counter[str] = field(default_factory=Counter)
    doors: Counter[str] = field(default_factory=Counter)
    spent_s: dict[str, float] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    processor_s: float = 0.0


class HangError(Exception):
    """A case took too long."""


def _on_alarm(_signal: int, _frame: FrameType | None) -> None:
    raise HangError(f"more than {_HANG_S} s")


@contextmanager
def _watched() -> Iterator[None]:
    signal.setitimer(signal.ITIMER_PROF, _HANG_S)
    signal.alarm(_WAITING * _HANG_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)


@cache
def _folders() -> Path:
    memory = Path("/dev/shm")
    made = tempfile.mkdtemp(prefix="threadline-", dir=memory if memory.is_dir() else None)
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def _folder() -> Path:
    """Return the folder of this process: a job in it is written again and again."""
    folder = _folders() / str(os.getpid())
    folder.mkdir(exist_ok=True)
    return folder


def kinds() -> tuple[Kind, ...]:
    """Return the kinds of machines; each process has its own, with files of its own."""
    return _kinds(_folder())


@cache
def _kinds(folder: Path) -> tuple[Kind, ...]:
    return (
        Programs("winder", folder),
        Stitcher(),
        Embroiderer(),
        Placer(),
        Programs("firmware", folder),
    )


# --- a changed job, or a changed machine ---


def _placed(written: Written) -> tuple[Path, Machine, str]:
    """Write the files of a job; return it, its machine, and the machine's reference."""
    file = _folder() / "case" / written.file
    shutil.rmtree(file.parent, ignore_errors=True)
    file.parent.mkdir()
    file.write_bytes(written.data)
    if not written.machine_text:
        return file, written.machine, written.machine.reference
    mine = file.with_name("mine.toml")
    mine.write_text(written.machine_text)
    reference = f"{mine}{written.overlays}"
    return file, tl.load_machine(reference), reference


def proved(written: Written) -> Proved:
    """Prove a job in one run, by the face."""
    file, machine, _ = _placed(written)
    return tl.prove(file, machine, level="nominal", **written.words)


def _by_a_process(written: Written) -> Outcomes:
    """Prove a job in one run, by a process of the command line."""
    file, _, reference = _placed(written)
    words = [text for key, value in written.words.items() for text in (f"--{key}", str(value))]
    command = ["-m", "threadline", "prove", str(file), "-m", reference, "--nominal", "--json"]
    done = subprocess.run(
        [sys.executable, *command, *words],
        capture_output=True,
        text=True,
        timeout=_WAITING * _HANG_S,
        check=False,
    )
    assert done.returncode in (0, 1) and "Traceback" not in done.stderr, done.stderr
    return {
        (one["name"], one["axis"], one.get("step", "")): (
            one["measured"], one["status"], one["limit"],
        )
        for one in json.loads(done.stdout)["criteria"]
    }  # fmt: skip


def _finite(values: Outcomes) -> Outcomes:
    """Return a verdict as JSON has it: no number for what is not finite."""
    return {
        key: (None if value is None or abs(value) == float("inf") else value, status, limit)
        for key, (value, status, limit) in values.items()
    }


class Known:
    """What is known of a job before it is changed; what only some changes need, when they do."""

    def __init__(self, kind: Kind, work: Work, bases: Mapping[str, Base]) -> None:
        self.written, self.outcomes = kind.plain(work), bases["sound"].outcomes
        self.kind, self.work, self.bases = kind, work, bases
        self._read: dict[tuple[bool, bool], dict[str, np.ndarray]] = {}

    def read(self, of: Written) -> dict[str, np.ndarray]:
        """Return what the job asks for: with or without the way to where it begins, as a change."""
        how = of.from_start, of.switched
        if how not in self._read:
            written = replace(self.written, from_start=of.from_start, switched=of.switched)
            file, machine, _ = _placed(written)
            self._read[how] = read(file, machine, written)
        return self._read[how]

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """The numbers of its machine."""
        return numbers_of(self.work.machine)

    def hold(self, written: Written, door: str) -> None:
        """Hold a changed job or machine against the one before.

        Parameters
        ----------
        door
            ``read``: number by number. ``proved``: the verdict of the face. ``process``: that which
            the command line prints.
        """
        said = f"\n{written.words}\n{written.data[:2000]!r}"
        if door == "read":
            before = self.read(written)  # its file is written, and read, first
            file, machine, _ = _placed(written)
            if written.machine_text:
                hold_machines(self.numbers, numbers_of(machine), written.names)
            else:
                hold_read(before, read(file, machine, written), said)
            return
        process = door == "process"
        known = _finite(self.outcomes) if process else self.outcomes
        after = _by_a_process(written) if process else outcomes_of_proof(proved(written).of)
        names = written.names
        own = {(n, names.get(axis, axis), names.get(step, step)): value
               for (n, axis, step), value in after.items()}  # fmt: skip
        try:
            same_verdicts(known, own, said, False, written.free)
        except AssertionError:
            if not written.moved:
                raise
            same_verdicts(known, own, said, True, written.free)


# --- rounds ---

Check = Callable[[random.Random, str], tuple[int, str]]
"""Makes a case, or several side by side, by a door if it can; returns how many, and by which."""


def _checks(known: Known) -> dict[str, Check]:
    """Return what makes a case of each change of a kind."""

    def of_work(change: Change, rng: random.Random, door: str) -> tuple[int, str]:
        written = change(rng, known.work)
        by = "read" if written.from_start else door
        known.hold(written, by)
        return 1, by

    def of_run(change: RunCheck, rng: random.Random, door: str) -> tuple[int, str]:
        base = known.bases[rng.choice(sorted(known.bases))]
        by_face = door == "proved" and change in JUDGED_BY_THE_FACE
        count = change(rng, base, known.written if by_face else None)
        return count, "proved" if by_face else "judged"

    kind = known.kind
    found: dict[str, Check] = {
        name: partial(of_work, change)
        for name, change in kind.changes.items()
        if not kind.lacks(name, known.work)
    }
    others = RECORDED | LIMITS
    if kind.name == "letter-placer":  # no limit of a machine in numbers that a plan comes near
        del others[OF_MACHINE]
    return found | {name: partial(of_run, change) for name, change in others.items()}


def run_round(
    seed: int, number: int, shares: tuple[int, int], only: str = "", change: str = ""
) -> Tally:
    """Run the cases of a round: all kinds, or one; all changes, or one."""
    tally, began = Tally(seed, number, only), _processor_s()
    for watch in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(watch, _on_alarm)
    warnings.simplefilter("error")
    for kind in kinds():
        if only in ("", kind.name):
            _run_kind(tally, kind, shares, change)
    fuzz_runs.forget_plans()
    tally.processor_s = _processor_s() - began
    return tally


def _processor_s() -> float:
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def _run_kind(tally: Tally, kind: Kind, shares: tuple[int, int], only: str) -> None:
    place = f"{tally.seed}/{kind.name}/{tally.round}"
    work = kind.drawn(random.Random(place), tally.round)
    written = kind.plain(work)
    try:
        proof = proved(written)
        bases = bases_of(proof, random.Random(f"{place}/faults"), _folder() / "case" / written.file)
    except Exception:
        tally.failures.append(f"{place} before any change\n{traceback.format_exc(limit=-4)}")
        return
    for name, check in _checks(Known(kind, work, bases)).items():
        if only not in ("", name):
            continue
        cell, began = f"{kind.name}|{name}", _processor_s()
        k = 0
        while k < EACH * kind.often.get(name, 1):
            rng = random.Random(f"{place}/{name}/{k}")
            door = _door(rng, shares, by_process=name in kind.changes and name not in _MADE_HERE)
            (count, door), problem = _tried(partial(check, rng, door), door)
            tally.cases[cell] += count
            tally.doors[f"{cell}|{door}"] += count
            if problem:
                command = f"--seed {tally.seed} --round {tally.round} --kind {kind.name}"
                tally.failures.append(f'{command} --change "{name}" ({k}, {door})\n{problem}')
            k += count
        tally.spent_s[cell] = round(_processor_s() - began, 4)


def _door(rng: random.Random, shares: tuple[int, int], *, by_process: bool) -> str:
    """Return how a case is compared: ``read``, ``proved`` by the face, or by a ``process``."""
    proved_one, process_one = shares
    if by_process and rng.randrange(process_one) == 0:
        return "process"
    return "proved" if rng.randrange(proved_one) == 0 else "read"


def _tried(check: Callable[[], tuple[int, str]], door: str) -> tuple[tuple[int, str], str]:
    """Return what a check returned, and what was wrong."""
    try:
        with _watched():
            return check(), ""
    except AssertionError as error:
        return (1, door), f"differs: {error}"
    except ThreadlineError as error:
        return (1, door), f"refused: {error}"
    except Exception:
        return (1, door), traceback.format_exc(limit=-4)


# --- counting ---


def kept_tallies(file: Path) -> list[Tally]:
    """Return the rounds in a file."""
    if not file.exists():
        return []
    found = []
    for line in file.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        row["cases"], row["doors"] = Counter(row["cases"]), Counter(row["doors"])
        found.append(Tally(**row))
    return found


def keep(file: Path, tally: Tally) -> None:
    """Append a tally to a file, from which ``kept_tallies`` reads it."""
    row = {**vars(tally), "cases": dict(tally.cases), "doors": dict(tally.doors)}
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(row) + "\n")


def table(tallies: list[Tally]) -> str:
    """Return the number of cases of each change and kind, and by which door."""
    cases, doors, spent = Counter[str](), Counter[str](), 0.0
    for tally in tallies:
        cases += tally.cases
        spent += tally.processor_s
        for cell, count in tally.doors.items():
            doors[cell.rpartition("|")[2]] += count
    names = [kind.name for kind in kinds()]
    lines = [f"{'':46}" + "".join(f"{name:>16}" for name in names)]
    for change in dict.fromkeys(cell.partition("|")[2] for cell in cases):
        counts = (cases[f"{name}|{change}"] for name in names)
        lines.append(f"{change:46}" + "".join(f"{count:16}" for count in counts))
    total = cases.total()
    failed = sum(len(tally.failures) for tally in tallies)
    rounds = len({(tally.seed, tally.round) for tally in tallies})
    lines.append(
        f"{total} cases in {rounds} rounds, {doors['proved']} of them by the face and "
        f"{doors['process']} by a process of the command line; "
        f"{1e3 * spent / max(total, 1):.1f} ms of the processor a case; {failed} differences"
    )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--round", type=int, default=0, help="number of the first round")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kind", default="", choices=["", *(kind.name for kind in kinds())])
    parser.add_argument("--change", default="", help="only this one")
    parser.add_argument("--proved", type=int, default=16, help="one case of so many is proved")
    parser.add_argument("--whole", type=int, default=100, help="one case of so many is a process")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no round after them")
    parser.add_argument("--kept", type=Path, help="file of the rounds that were run (JSON lines)")
    options = parser.parse_args()
    tallies = kept_tallies(options.kept) if options.kept else []
    done = {(tally.round, tally.kind) for tally in tallies if tally.seed == options.seed}
    names = [options.kind] if options.kind else [kind.name for kind in kinds()]
    rounds = range(options.round, options.round + options.rounds)
    wanted = [(n, name) for n in rounds for name in names if (n, name) not in done]
    end_s = time.monotonic() + 60.0 * options.minutes
    run = partial(_run_part, options.seed, (options.proved, options.whole), options.change)
    for tally in _tallies(run, wanted, options.processes, end_s):
        tallies.append(tally)
        if options.kept:
            keep(options.kept, tally)
    failures = [failure for tally in tallies for failure in tally.failures]
    for failure in failures[:_SHOWN]:
        print(failure, file=sys.stderr)
    print(table(tallies))
    return 1 if failures else 0


def _run_part(seed: int, shares: tuple[int, int], change: str, part: tuple[int, str]) -> Tally:
    """Run a round with one kind."""
    number, kind = part
    return run_round(seed, number, shares, kind, change)


def _tallies(
    run: Callable[[tuple[int, str]], Tally],
    wanted: list[tuple[int, str]],
    processes: int,
    end_s: float,
) -> Iterator[Tally]:
    if processes == 1:
        for part in wanted:
            if time.monotonic() < end_s:
                yield run(part)
        return
    left = iter(wanted)
    with ProcessPoolExecutor(processes) as pool:
        running: set[Future[Tally]] = set()
        while True:
            while len(running) < processes and time.monotonic() < end_s:
                following = next(left, None)
                if following is None:
                    break
                running.add(pool.submit(run, following))
            if not running:
                return
            done = next(as_completed(running))
            running.remove(done)
            yield done.result()


if __name__ == "__main__":
    sys.exit(main())
