"""Search a machine within the tolerances, or a day, that breaks a claim: an independent search.

    python -m tools.break_claims 600 days 'threadline prove examples/x-180.prg -m lathe-winder'
    python -m tools.break_claims 3600 machines seed=2 'threadline prove ... --needle "24 stitch/s"'

searches for so many seconds of processor time, the plan and the compilation of the simulation left
out. ``days`` keeps the machine of the file and changes friction, supply and the place of every
encoder between two counts, all within what runs are drawn from. ``machines`` changes every number
within its tolerance as well. Each candidate is one run of the planned commands, judged by every
criterion that has a limit. ``repeatability`` of a day is its largest distance from the mean of
1200 drawn days, as a verdict counts it. It is left out of ``machines``, which have days of their
own, and where runs are simulated one by one (frames, on/off machines, drives that take positions).
A day of such a machine is one of the days that its verdict draws from. A criterion that allows
nothing, such as ``dac_saturation``, counts as 1000 % where it fails, and so does a required one
that could not be measured, and a run that never ends.

The program's own search (``proof/worst_search.py``) climbs from corner to corner by single changes.
This one shares no step with it. Climbs of three methods go side by side, and where one has ended
another begins:

- an evolution strategy with a full covariance matrix (CMA-ES; Hansen, "The CMA evolution strategy:
  a tutorial", 2016) over the whole box, with mirrored bounds, from a random start;
- the same from a short step beside the worst that is known;
- the cross-entropy method over the corners of the box (Rubinstein and Kroese, 2004): each number is
  at its upper end with a probability that follows the worst tenth of the candidates. ``days`` has
  no such corners.

What it prints is the largest used share of a limit that is not of the plan alone, and where it is.

    python -m tools.break_claims grid=2000 days 'threadline prove examples/x-180.prg ...'

covers a claim that depends on at most two numbers of a day, such as supply and the place of one
encoder, by a grid of 2000 by 2000 days. It first finds the numbers that change any result. It also
prints what every second, fourth and eighth value of each finds: how little the worst grows with a
finer grid tells what may hide between its points.
"""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.errors import MachineError, OptionError, RecordingError
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import number_at
from threadline.machine.variants import numbers_at, uncertain, variant
from threadline.machine.vary import REPEAT_SEED, Days, drawn_days, varied_numbers
from threadline.proof.judge_runs import RunsJudge
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import with_machine_hash
from threadline.proof.option_form import Door, Word
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.request import Words
from threadline.verdict import EachRun, Judge, Spec
from threadline.verdict.finding import RunFindings, Worst
from threadline.verdict.measure import Measure, MeasureKind, OfRun
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Block, Setting

ROOT = Path(__file__).resolve().parent.parent
FRICTION, SUPPLY = 0.3, 0.05  # of a day, as shares on either side (docs/specs.md)
CANDIDATES = 64  # of a generation of one climb
BESIDE = 6  # climbs that go side by side: 384 candidates are judged at once
FAR, NEAR = 0.6, 0.1  # first steps from a random place, and beside the worst that is known
ENDED = 1e-3  # steps of this part of the box end a climb
GENERATIONS = 40  # of a climb at most
BROKEN = 10.0  # share of a limit of 0 that was not kept
MEAN_OF = 1200  # days
SPREAD, MEAN, AWAY = "repeatability", "mean of days", "distance from the mean of days"
REPORT_PERIOD_S = 60.0  # of processor time between two lines about candidates without news

MOST_OF_A_GRID = 2  # numbers
GRID_AT_ONCE = BESIDE * CANDIDATES

Climb = Generator[FloatArray, FloatArray, None]
"""Yields (k, size) places, and is sent their (k,) used shares."""
ELITE, SMOOTHED = 0.1, 0.7  # of the cross-entropy method


class Box:
    """What a claim holds for: places between -1 and 1 of numbers, then of a day.

    Parameters
    ----------
    machines
        Whether the numbers of the machine file vary within their tolerances.

    Attributes
    ----------
    ends
        (n,) largest part of the tolerance of each number; empty: the machine of the file alone.
    together
        (n,) whether all candidates of a restart share the number, as dead times.
    day
        Numbers of a day.
    endless
        The last of them, which have no ends: encoders between two counts, scans.
    """

    def __init__(self, machine: Machine, machines: bool, day: int, endless: int) -> None:
        found = uncertain(machine) if machines else ()
        delays = [any(path.endswith(".delay") for path in one.numbers) for one in found]
        self.machine, self.day, self.endless = machine, day, endless
        self.ends = np.array([one.farthest for one in found])
        self.together = np.array(delays, dtype=np.bool_)
        self.size = len(found) + day


class Together:
    """Runs that are simulated side by side."""

    def __init__(self, plan: Plan, spec: Spec, machines: bool) -> None:
        axes = len(plan.machine.axis_names)
        self.box = Box(plan.machine, machines, 2 + axes, axes)
        self.judge = RunsJudge(plan, spec if machines else with_distance(plan, spec), threads=1)

    def judged(self, places: FloatArray) -> EachRun:
        """Return the results of (k, size) places."""
        return self.judge.judged(*self._runs(places))

    def named(self, place: FloatArray) -> dict[str, object]:
        """Return the numbers of a (size,) place, and its encoder phases."""
        numbers, phases = self._runs(place[None])
        return {
            "numbers": {path: float(values[0]) for path, values in numbers.items()},
            "phases": phases[0].tolist(),
        }

    def _runs(self, places: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return numbers of the machine file, and (k, axes) encoder phases."""
        machine, count = self.box.machine, len(self.box.ends)
        days = 1.0 + places[:, count : count + 2] * np.array([FRICTION, SUPPLY])
        found = numbers_at(machine, places[:, :count] * self.box.ends) if count else {}
        of_days = Days(
            friction=days[:, 0],
            supply=days[:, 1],
            phases=0.5 + 0.5 * places[:, count + 2 :],
            tension=np.ones(len(days)),
        )
        varied = varied_numbers(machine, of_days)
        for path, values in varied.items():
            if path in found:
                found[path] = found[path] * (values / number_at(machine, path).si)
            else:
                found[path] = values
        return found, of_days.phases


class OneByOne:
    """Runs of a kind of machines that are simulated one by one, on the days of that kind."""

    def __init__(self, plan: Plan, spec: Spec, machines: bool) -> None:
        self._plan, self._kind = plan, kind_of(plan.machine)
        ranges = self._kind.ranges_of_days(plan.commands)
        self.box = Box(plan.machine, machines, ranges, ranges)
        self.judge = Judge(plan, spec)

    def judged(self, places: FloatArray) -> EachRun:
        """Return the results of (k, size) places."""
        return EachRun.joined([self._one(place) for place in places])

    def named(self, place: FloatArray) -> dict[str, object]:
        """Return the numbers of a (size,) place, and where its day is in its ranges (0 to 1)."""
        parts, day = self._split(place)
        numbers = numbers_at(self.box.machine, parts[None]) if len(parts) else {}
        return {
            "numbers": {path: float(values[0]) for path, values in numbers.items()},
            "day": day.tolist(),
        }

    def _split(self, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        count = len(self.box.ends)
        return place[:count] * self.box.ends, 0.5 + 0.5 * place[count:]

    def _one(self, place: FloatArray) -> EachRun:
        parts, day = self._split(place)
        plan, machine = self._plan, self._plan.machine
        if len(parts):
            machine = variant(machine, parts)
        commands = with_machine_hash(plan.commands, machine)
        try:
            (run,) = self._kind.on_days(commands, machine, day[None])
            return self.judge.each(run)
        except (MachineError, RecordingError):
            own = self._kind.simulate(plan.commands, plan.machine)
            return self.judge.each(own).without_answer()


def used(found: EachRun) -> tuple[FloatArray, list[str]]:
    """Return the largest used share of a limit of each run, and the criterion that has it."""
    rows = [row for row in found.rows if row.limit is not None and not row.of_plan]
    shares = np.zeros((len(rows), found.runs))
    for share, row in zip(shares, rows, strict=True):
        if row.limit:
            share[:] = np.nan_to_num(row.values / row.limit, nan=0.0, posinf=1e3)
        # A plan uses the machine's own limits to the full: they count where they fail.
        if row.hard:
            share[~row.failed] = 0.0
        if not row.limit:
            share[row.failed] = BROKEN
        share[row.missed] = BROKEN
    return shares.max(axis=0), [rows[k].text for k in shares.argmax(axis=0).tolist()]


class Mean:
    """The sum of all runs, sample by sample (a measure that finds nothing).

    Parameters
    ----------
    sums
        Takes, of each recording, (samples, axes) sums of the positions of its runs.
    """

    def __init__(self, sums: list[FloatArray]) -> None:
        self._sums, self._blocks = sums, list[FloatArray]()

    def feed(self, block: Block) -> None:
        """Take the next samples of all runs."""
        if block.actual is not None:
            self._blocks.append(block.actual.sum(axis=1))

    def finish(self) -> Sequence[RunFindings]:
        """Hand on the sum."""
        self._sums.append(np.concatenate(self._blocks))
        return ()


class Away:
    """The largest distance of each run, at the tool, from the mean of many days (a measure).

    Parameters
    ----------
    mean
        (samples, axes) positions.
    """

    def __init__(self, setting: Setting, mean: FloatArray) -> None:
        self._setting, self._mean, self._at = setting, mean, 0
        self._worst = Worst(setting.runs, len(setting.axes))

    def feed(self, block: Block) -> None:
        """Take the next samples of all runs."""
        if block.actual is None:
            return
        mean = self._mean[self._at : self._at + len(block), None]
        self._at += len(block)
        away = self._setting.lengths(block.actual - mean, block.actual)
        self._worst.offer(np.sqrt((away**2).sum(axis=2).max(axis=0)))

    def finish(self) -> Sequence[RunFindings]:
        """Return the one finding of all runs."""
        return [self._worst.found()]


def limited(spec: Spec) -> Spec:
    """Return the specification without criteria that are only reported: no claim rests on them."""
    return replace(spec, criteria=tuple(c for c in spec.criteria if c.limit is not None))


def with_distance(plan: Plan, spec: Spec) -> Spec:
    """Return the specification with the distance from the mean of many days in place of the spread.

    Its limit is the limit of ``repeatability``, which one run does not have.
    """
    of_spread = next((c for c in spec.criteria if c.name == SPREAD), None)
    if of_spread is None or not plan.machine.motors:
        return spec
    sums: list[FloatArray] = []
    with_measure(MEAN, lambda _run, _options: Mean(sums))
    machine = plan.machine
    days = drawn_days(MEAN_OF, len(machine.axis_names), np.random.default_rng(REPEAT_SEED))
    only = replace(spec, criteria=(replace(of_spread, name=MEAN, options={}),))
    RunsJudge(plan, only, threads=1).judged(varied_numbers(machine, days), days.phases)
    mean = np.asarray(np.sum(sums, axis=0) / MEAN_OF)
    with_measure(AWAY, lambda run, _options: Away(run, mean))
    away = replace(of_spread, name=AWAY, options={})
    return replace(spec, criteria=(*spec.criteria, away))


def with_measure(name: str, start: Callable[[Setting, Mapping[str, float]], Measure]) -> None:
    """Add a measure at the tool to the measures of specifications, or replace it."""
    needs = MEASURES[SPREAD].needs
    reads = (OfRun(run=Setting, start=start, needs=tuple(needs), follows=True),)
    MEASURES[name] = MeasureKind(name=name, dimension="tool", per_axis=False, reads=reads)


class Claim:
    """A plan, its judge, and the worst that was found so far."""

    def __init__(self, command: str, machines: bool) -> None:
        job, reference, given = asked(command)
        words, machine = Words.of("prove", Door.PYTHON, given), load_machine(reference)
        options = words.options(job)
        plan = plan_job(open_job(Path(job), machine, options), machine, options)
        self.plan, self.spec = plan, limited(words.spec(machine))
        together = bool(machine.motors) and kind_of(machine).together(machine)
        self.runs = (Together if together else OneByOne)(plan, self.spec, machines)
        self.box = self.runs.box
        self.tried, self.worst, self.at = 0, 0.0, np.zeros(self.box.size)
        self.criterion = ""
        self._begun_s = self._reported_s = time.process_time()

    def shares(self, places: FloatArray) -> FloatArray:
        """Return the (k,) used shares of (k, size) places; print what is worse than all before."""
        shares, names = used(self.runs.judged(places))
        self.tried += len(places)
        best = int(np.argmax(shares))
        if shares[best] > self.worst * (1.0 + 1e-4):
            self.worst, self.at, self.criterion = float(shares[best]), places[best], names[best]
            self._tell()
        elif time.process_time() - self._reported_s > REPORT_PERIOD_S:
            self._tell()
        return shares

    def _tell(self) -> None:
        self._reported_s = time.process_time()
        spent_s, share = self._reported_s - self._begun_s, 100.0 * self.worst
        print(f"    {self.tried}, {spent_s:.0f} s: {share:.2f} % of {self.criterion}", flush=True)

    def answer(self) -> dict[str, object]:
        """Return what was found, with the numbers of that machine and day."""
        return {
            "share": self.worst,
            "criterion": self.criterion,
            "tried": self.tried,
            "processor_s": round(time.process_time() - self._begun_s, 1),
            **self.runs.named(self.at),
        }


def asked(command: str) -> tuple[str, str, dict[str, Word]]:
    """Return job, machine and options of the words of ``threadline prove``; levels are left out."""
    words = shlex.split(command)[2:]
    given: dict[str, Word] = {}
    job, at = words[0], 1
    while at < len(words):
        name, value = words[at], words[at + 1] if at + 1 < len(words) else "--"
        flag = value.startswith("--")
        given[{"-m": "machine", "-s": "spec"}.get(name, name[2:].replace("-", "_"))] = (
            True if flag else value
        )
        at += 1 if flag else 2
    for level in ("nominal", "tolerances", "ends", "json"):
        given.pop(level, None)
    return job, str(given.pop("machine")), given


def mirrored(places: FloatArray) -> FloatArray:
    """Return places folded back into -1 to 1."""
    folded = np.mod(places + 1.0, 4.0)
    return np.asarray(np.where(folded > 2.0, 4.0 - folded, folded) - 1.0)


def strategy(claim: Claim, random: np.random.Generator, mean: FloatArray, sigma: float) -> Climb:
    """Climb by a CMA-ES from a place, with steps of ``sigma`` at first."""
    n, kept = claim.box.size, CANDIDATES // 2
    weights = np.log(kept + 0.5) - np.log(np.arange(1, kept + 1))
    weights /= weights.sum()
    mu = 1.0 / (weights**2).sum()
    rate, damp = (mu + 2.0) / (n + mu + 5.0), 1.0
    damp += rate + 2.0 * max(0.0, np.sqrt((mu - 1.0) / (n + 1.0)) - 1.0)
    of_path = (4.0 + mu / n) / (n + 4.0 + 2.0 * mu / n)
    one = 2.0 / ((n + 1.3) ** 2 + mu)
    many = min(1.0 - one, 2.0 * (mu - 2.0 + 1.0 / mu) / ((n + 2.0) ** 2 + mu))
    usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2))
    shape, shared = np.eye(n), np.flatnonzero(claim.box.together)
    step, path = np.zeros(n), np.zeros(n)
    for _ in range(GENERATIONS):
        lengths, axes = np.linalg.eigh(shape)
        lengths = np.sqrt(np.maximum(lengths, 1e-12))
        drawn = (random.standard_normal((CANDIDATES, n)) * lengths) @ axes.T
        drawn[:, shared] = 0.0
        shares = yield mirrored(mean + sigma * drawn)
        chosen = drawn[np.argsort(-shares, kind="stable")[:kept]]
        moved = weights @ chosen
        mean = mean + sigma * moved
        white = axes @ ((axes.T @ moved) / lengths)
        step = (1.0 - rate) * step + np.sqrt(rate * (2.0 - rate) * mu) * white
        path = (1.0 - of_path) * path + np.sqrt(of_path * (2.0 - of_path) * mu) * moved
        shape = (
            (1.0 - one - many) * shape
            + one * np.outer(path, path)
            + many * (chosen * weights[:, None]).T @ chosen
        )
        sigma *= float(np.exp(rate / damp * (np.linalg.norm(step) / usual - 1.0)))
        if sigma * lengths.max() < ENDED:
            break
        sigma = min(sigma, 1.0)


def corners(claim: Claim, random: np.random.Generator) -> Climb:
    """Go from random corners to those that the worst have in common."""
    n = claim.box.size
    chance = np.full(n, 0.5)
    shared = np.flatnonzero(claim.box.together)
    chance[shared] = random.integers(0, 2, len(shared))
    elite = max(int(ELITE * CANDIDATES), 2)
    for _ in range(GENERATIONS):
        places = np.where(random.random((CANDIDATES, n)) < chance, 1.0, -1.0)
        endless = claim.box.endless
        places[:, n - endless :] = random.uniform(-1.0, 1.0, (CANDIDATES, endless))
        shares = yield places
        order = np.argsort(-shares, kind="stable")
        seen = (places[order[:elite]] > 0.0).mean(axis=0)
        chance = (1.0 - SMOOTHED) * chance + SMOOTHED * seen
        chance[shared] = np.round(chance[shared])
        if (np.abs(chance - 0.5) > 0.49).all():
            break


def begun(claim: Claim, random: np.random.Generator, turn: int, machines: bool) -> Climb:
    """Return the climb number ``turn``: the methods take turns."""
    ways = ("far", "corners", "far", "near") if machines else ("far", "near")
    way = ways[turn % len(ways)]
    if way == "corners":
        return corners(claim, random)
    if way == "near" and claim.worst > 0.0:
        return strategy(claim, random, claim.at.copy(), NEAR)
    mean = random.uniform(-1.0, 1.0, claim.box.size)
    shared = np.flatnonzero(claim.box.together)
    mean[shared] = np.sign(mean[shared])
    return strategy(claim, random, mean, FAR)


def searched(command: str, machines: bool, limit_s: float, seed: int = 1) -> Mapping[str, object]:
    """Search until the processor time is spent; return what was found."""
    claim, random = Claim(command, machines), np.random.default_rng(seed)
    claim.shares(np.zeros((2, claim.box.size)))  # compiles
    until_s, turn = time.process_time() + limit_s, 0
    climbs: list[Climb] = []
    places: list[FloatArray] = []
    while time.process_time() < until_s:
        while len(climbs) < BESIDE:
            climbs.append(begun(claim, random, turn, machines))
            places.append(next(climbs[-1]))
            turn += 1
        shares = np.split(claim.shares(np.concatenate(places)), len(climbs))
        going = zip(climbs, shares, strict=True)
        climbs, places = [], []
        for climb, own in going:
            try:
                places.append(climb.send(own))
            except StopIteration:
                continue
            climbs.append(climb)
    return claim.answer()


def changing(claim: Claim, random: np.random.Generator) -> list[int]:
    """Return the numbers of a place that change any result of any of some random places."""

    def results(places: FloatArray) -> FloatArray:
        return np.stack([row.values for row in claim.runs.judged(places).rows])

    places = random.uniform(-1.0, 1.0, (CANDIDATES, claim.box.size))
    before, found = results(places), []
    for k in range(claim.box.size):
        changed = places.copy()
        changed[:, k] = random.uniform(-1.0, 1.0, CANDIDATES)
        if not np.array_equal(results(changed), before, equal_nan=True):
            found.append(k)
    return found


def covered(command: str, count: int) -> Mapping[str, object]:
    """Judge a grid of ``count`` values of each number of a day that changes any result.

    Raises
    ------
    OptionError
        If more than two numbers do.
    """
    claim = Claim(command, machines=False)
    numbers = changing(claim, np.random.default_rng(1))
    if len(numbers) > MOST_OF_A_GRID:
        raise OptionError(
            f"{len(numbers)} numbers of a day change the results; a grid covers {MOST_OF_A_GRID}",
            remedy="Give a time in seconds instead of grid=N, which searches them.",
        )
    endless = claim.box.size - claim.box.endless
    ends = np.linspace(-1.0, 1.0, count)
    cells = (2.0 * np.arange(count) + 1.0) / count - 1.0  # the last is beside the first
    values = [cells if k >= endless else ends for k in numbers]
    grid = np.stack(np.meshgrid(*values, indexing="ij")).reshape(len(numbers), -1).T
    shares = np.empty(len(grid))
    for low in range(0, len(grid), GRID_AT_ONCE):
        part = grid[low : low + GRID_AT_ONCE]
        places = np.zeros((len(part), claim.box.size))
        places[:, numbers] = part
        shares[low : low + len(part)] = claim.shares(places)
    best = int(np.argmax(shares))
    claim.worst, claim.at[numbers] = float(shares[best]), grid[best]
    whole = shares.reshape([count] * len(numbers))
    coarser = {n: float(whole[tuple([slice(0, None, n)] * len(numbers))].max()) for n in (8, 4, 2)}
    return {**claim.answer(), "changing": len(numbers), "every": coarser}


def main(limit: str, what: str, *words: str) -> None:
    """Search each claim, and print what was found."""
    seed = int(words[0].removeprefix("seed=")) if words[0].startswith("seed=") else 1
    for command in words if not words[0].startswith("seed=") else words[1:]:
        print(command, flush=True)
        if limit.startswith("grid="):
            found = covered(command, int(limit.removeprefix("grid=")))
        else:
            found = searched(command, what == "machines", float(limit), seed)
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
