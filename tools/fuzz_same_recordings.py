"""A recording that is changed where that must not matter: every value and status as before.

A run with noise below any resolution, cut into other blocks, with channels permuted or renamed, at
twice the rate, written to a file and read again. The recordings are made once and judged many
times. Changed samples lie side by side as runs of one recording, so that a case holds ``RUNS`` of
them.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from tools.fuzz_recordings import MAKERS
from tools.fuzz_runs import Seed, more_seeds, plan_measured_once, seeds
from tools.fuzz_same_programs import SAME, WHOLE, Key

from threadline.errors import Place
from threadline.files import ChannelKind, Recording, RecordingBlock, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.common import in_si
from threadline.verdict import Criterion, Judge, Spec, Status
from threadline.verdict.bow import FOLLOWED

RUNS = 8
_POOL, _FEW = 6, 2  # recordings of each machine: one as it ran, the others with a fault
_NOISE = (-300.0, -12.0)
"""Decades: the squares of many are numbers without digits, or nothing."""
_BITS = (ChannelKind.INPUT, ChannelKind.OUTPUT, ChannelKind.OPERATION)
_NAMELESS = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.LOAD, ChannelKind.FRAME)
"""Channels that are known by kind and axis, whatever their name."""
_SPREADS = 20
"""One of so many recordings is several, whose spread is judged."""
_FACTORS = (None, 0.999, 1.001, 0.5, 2.0)
_HELD = (*_BITS, ChannelKind.VOLTAGE)
"""What stands from one sample to the next: a controller holds its output."""
_AT_TWICE_THE_RATE = (
    "contour_error", "turning_point_error", "tracking_error", "current_peak", "current_rms",
    "residual_vibration", "settling_time", "dac_saturation",
    "seam_error", "stitch_placement_error", "stitch_residual", "servo_force", "travel",
)  # fmt: skip
"""What a straight line between two samples leaves as it is."""
_BY_SWITCHINGS = ("residual_vibration", "settling_time")
"""Of a frame, they begin at the sample in which an output switches."""
_TURNS, _WITHIN = 0.05, 0.2
"""Shares of the longest way in a sample interval by which the progress error may grow and fall
then. It is measured at samples, and where the tool cuts a corner it may be larger between two of
them; and a tool within a place of the command is known by the ends of the place."""

Samples = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Kept:
    """A recording that is judged many times, and what was measured in it."""

    seed: Seed
    samples: Samples
    measured: Mapping[Key, float]
    most: int = RUNS

    @property
    def runs(self) -> int:
        """How many runs its judge takes side by side."""
        if self.seed.options.product is not None:
            return 2  # where a fibre lies takes long
        alone = self.seed.facts.switched or self.seed.facts.places is not None
        return 1 if alone else self.most


@cache
def pool() -> tuple[Kept, ...]:
    """Return the recordings, some with a fault for a while in one channel."""
    found = []
    for number, seed in enumerate((*seeds(), *more_seeds())):
        for k in range(_POOL if seed in seeds() else _FEW):
            samples: Samples = seed.samples
            if k:
                channels = MAKERS["judge-axes"](random.Random(f"{number}/{k}"), seed)
                samples = {name: one.chunks[0][1] for name, one in channels.items()}
                samples = _switched_wrong(random.Random(f"{number}/{k}"), seed, samples, k - 1)
            known = values_of(seed, recording_of(seed, samples), seed.proof.spec)
            found.append(Kept(seed, samples, known))
    return tuple(found)


def _switched_wrong(rng: random.Random, seed: Seed, samples: Samples, way: int) -> Samples:
    """Return the samples of an on/off machine with one of five faults.

    All valves are late, or open against each other; one is late, or flickers; a piston stops short.
    """
    if not seed.facts.switched:
        return samples
    outputs = [c.name for c in seed.proof.recording.channels if c.kind is ChannelKind.OUTPUT]
    switching = [name for name in outputs if np.ptp(samples[name]) == 1.0]
    late = rng.randint(3, 15)
    found = {n: samples[n].copy() for n in outputs}
    one = next(n for n in reversed(switching) if n.endswith("_a2"))
    open_at = np.flatnonzero(samples[one])
    if way == 0:
        found = {n: np.concatenate([samples[n][:late], samples[n][:-late]]) for n in switching}
    elif way == 1:
        begin = rng.randrange(len(samples[one]) - 300)
        for values in found.values():
            values[begin : begin + 10 * late] = 1.0
    elif way in (2, 3):
        at = int(open_at[0] if way == 2 else np.median(open_at))
        found[one][at : at + late] = 0.0
    else:
        moved = [n for n in samples if n.endswith(".load") and np.ptp(samples[n]) > 0.01]
        found = {n: np.minimum(samples[n], samples[n].max() - 1e-4 * late) for n in moved}
    return {**samples, **found}


def recording_of(
    seed: Seed, samples: Samples, edges: tuple[int, ...] = (), runs: int = 1
) -> Recording:
    """Return (n,) or (n, runs) samples as a recording, cut into blocks before rows ``edges``."""
    recording = seed.proof.recording
    channels = tuple(c for c in recording.channels if c.name in samples)
    count = len(next(iter(samples.values())))
    ends = (0, *edges, count)
    blocks = [
        RecordingBlock(
            first_tick={channels[0].clock.name: a},
            samples={name: values[a:b] for name, values in samples.items()},
        )
        for a, b in pairwise(ends)
    ]
    return replace(recording, channels=channels, blocks=Stream.of(blocks), runs=runs)


def rows_of(
    seed: Seed, recording: Recording, spec: Spec
) -> list[tuple[Key, np.ndarray, np.ndarray]]:
    with plan_measured_once(seed.proof.plan):
        each = Judge(seed.proof.plan, spec).each(in_si(recording, Place("case")))
    return [((r.name, r.axis, r.step), r.values, r.failed) for r in each.rows]


def values_of(seed: Seed, recording: Recording, spec: Spec) -> dict[Key, float]:
    """Return the value of each criterion of the only run of a recording."""
    return {key: float(values[0]) for key, values, _ in rows_of(seed, recording, spec)}


def spec_about(rng: random.Random, kept: Kept) -> tuple[Spec, dict[Key, bool]]:
    """Return a specification with limits about what was measured, and whether each must fail."""
    criteria, must = [], {}
    named = {(c.name, c.axis, c.step): c for c in reversed(kept.seed.proof.spec.criteria)}
    for key, value in kept.measured.items():
        name, axis, step = key
        plain = named.get((name, "", ""))
        own = named.get(key, named.get((name, axis, ""), named.get((name, "", step), plain)))
        if own is None or (name, axis, step) in must:
            continue
        factor = rng.choice(_FACTORS)
        limited = factor is not None and math.isfinite(value) and abs(value) > 1e-9
        limit = value + (factor - 1.0) * abs(value) if limited and factor is not None else None
        criteria.append(replace(own, axis=axis, step=step, limit=limit, hard=False, required=False))
        must[key] = limit is not None and value > limit
    return replace(kept.seed.proof.spec, criteria=tuple(criteria)), must


def noisy(rng: random.Random, kept: Kept) -> dict[str, np.ndarray]:
    """Return the samples of all runs, side by side, with noise far below any resolution.

    Where there are several, the first is left as it was but for its commands.
    """
    kinds = {c.name: c.kind for c in kept.seed.proof.recording.channels}
    names = sorted(name for name in kept.samples if kinds[name] not in _BITS)
    chosen = rng.sample(names, rng.randint(1, len(names)))
    draw = np.random.default_rng(rng.getrandbits(64))
    found = dict(kept.samples)
    for name in sorted(set(kept.samples) - set(names)):
        if kinds[name] is ChannelKind.INPUT and kept.runs > 1:
            found[name] = np.repeat(found[name][:, None], kept.runs, axis=1)
    for name in names:
        runs = 1 if kinds[name] is ChannelKind.COMMANDED else kept.runs  # the same of all runs
        values = np.repeat(kept.samples[name][:, None], runs, axis=1)
        for run in range(min(1, runs - 1), runs if name in chosen else 0):
            size = 10.0 ** draw.uniform(*_NOISE)
            first = int(draw.integers(len(values))) if draw.random() < 0.5 else 0
            stop = first + int(draw.integers(1, 9)) if draw.random() < 0.3 else len(values)
            part = values[first:stop, run]
            part += size * draw.uniform(-1.0, 1.0, len(part))
        found[name] = values if runs > 1 else values[:, 0]
    return found


def with_other_channel_names(rng: random.Random, recording: Recording) -> Recording:
    """Return a recording with its channels in another order and by other names."""
    order = list(recording.channels)
    rng.shuffle(order)
    return renamed(replace(recording, channels=tuple(order)), "another")


def renamed(recording: Recording, clock_name: str) -> Recording:
    """Return a recording with other names of its clock and of channels known by kind and axis."""
    order = recording.channels
    by = {c.name: f"{n} {c.name}" if c.kind in _NAMELESS else c.name for n, c in enumerate(order)}
    clock = replace(order[0].clock, name=clock_name)
    blocks = [
        replace(
            block,
            first_tick={clock.name: next(iter(block.first_tick.values()))},
            samples={by[c.name]: block.samples[c.name] for c in order if c.name in block.samples},
        )
        for block in recording
    ]
    channels = tuple(replace(c, name=by[c.name], clock=clock) for c in order)
    return replace(recording, channels=channels, blocks=Stream.of(blocks))


def at_twice_the_rate(recording: Recording) -> Recording:
    """Return a recording with one more sample in the middle between every two."""
    (block,) = recording
    clock = replace(
        recording.channels[0].clock, period_s=recording.channels[0].clock.period_s / Fraction(2)
    )
    held = {c.name for c in recording.channels if c.kind in _HELD}
    samples = {}
    for name, values in block.samples.items():
        twice = np.repeat(values, 2, axis=0)[:-1]
        if name not in held:
            twice[1::2] = 0.5 * (values[:-1] + values[1:])
        samples[name] = twice
    channels = tuple(replace(c, clock=clock) for c in recording.channels)
    blocks = [RecordingBlock(first_tick={clock.name: 0}, samples=samples)]
    return replace(recording, channels=channels, blocks=Stream.of(blocks))


def _longest_m(kept: Kept) -> float:
    """Return the longest way at the tool between two samples, of the command or of the load."""
    plan = kept.seed.proof.plan
    radius = dict(zip(plan.motion.programmed.axes, plan.motion.programmed.radius_m, strict=True))
    longest = 0.0
    for kind in (ChannelKind.COMMANDED, ChannelKind.LOAD):
        ways = [
            radius[c.axis] * np.diff(kept.samples[c.name])
            for c in kept.seed.proof.recording.channels
            if c.kind is kind and c.axis in radius and c.name in kept.samples
        ]
        if ways:
            longest = max(longest, float(np.linalg.norm(ways, axis=0).max()))
    return longest


def edges_of(rng: random.Random, count: int) -> tuple[int, ...]:
    """Return where a recording of so many samples is cut into blocks."""
    return tuple(sorted(rng.sample(range(1, count), rng.choice((0, 0, 1, 3, 30)))))


def check_recording(path: Path) -> None:
    """Judge a recording that was changed, and hold it against the one before.

    Raises
    ------
    AssertionError
        If a value or a status differs.
    """
    rng = random.Random(path.read_bytes())
    if rng.randrange(_SPREADS) == 0:
        _check_spread(rng)
        return
    kept = rng.choice(pool())
    spec, must = spec_about(rng, kept)
    count = len(next(iter(kept.samples.values())))
    edges = edges_of(rng, count)
    whole = rng.randrange(WHOLE) == 0
    twice = not whole and rng.random() < 0.2
    if whole:
        recording = recording_of(kept.seed, kept.samples)
        file = path.with_name(f"case.{rng.choice(('npz', 'csv', 'mcap'))}")
        write_recording(recording, file)
        recording = read_recording(file)
    else:
        runs = noisy(rng, kept)
        recording = recording_of(kept.seed, runs, () if twice else edges, kept.runs)
    if twice:
        recording = at_twice_the_rate(recording)
    if not whole and rng.random() < 0.5:
        recording = with_other_channel_names(rng, recording)
    hold_against(kept, recording, (spec, must), twice, f"twice the rate: {twice}, file: {whole}")


def hold_against(
    kept: Kept,
    recording: Recording,
    judged_by: tuple[Spec, Mapping[Key, bool]],
    twice: bool,
    how: str,
) -> None:
    """Hold every value and status of a changed recording against those of the recording before.

    Parameters
    ----------
    judged_by
        A specification, and whether each of its criteria must fail.
    twice
        Whether there is one more sample between every two.
    how
        What was changed, for the message.

    Raises
    ------
    AssertionError
        If a value or a status differs.
    """
    spec, must = judged_by
    count = len(next(iter(kept.samples.values())))
    # With velocities the way between two samples is no straight line.
    bowed = any(channel.kind is ChannelKind.VELOCITY for channel in recording.channels)
    rows = rows_of(kept.seed, recording, spec)
    known = {key for key, _, _ in rows}
    assert known == set(must), f"criteria {known ^ set(must)} in one of the two alone"
    for key, values, failed in rows:
        turns = twice and key[0] == "progress_error"
        if twice and not turns and key[0] not in _AT_TWICE_THE_RATE:
            continue
        if twice and kept.seed.facts.switched and key[0] in _BY_SWITCHINGS:
            continue
        if twice and key[0] in FOLLOWED and bowed:
            continue
        with np.errstate(invalid="ignore"):  # what never settles does so without end
            off = values - kept.measured[key]
        small = SAME * abs(kept.measured[key]) + 1e-10
        low = small + (_WITHIN * _longest_m(kept) if turns else 0.0)
        small += _TURNS * _longest_m(kept) if turns else 0.0
        if twice and key[0] == "dac_saturation":
            small += 1.0 / count  # the last sample stands for half of the time
        same = (off <= small) & (off >= -max(low, small))
        same |= np.isnan(values) & np.isnan(kept.measured[key])
        same |= values == kept.measured[key]
        where = f"{' '.join(key)} of {kept.seed.proof.plan.machine.name}"
        found = f"{values.tolist()}, before {kept.measured[key]!r}"
        assert same.all(), f"{where} is {found} ({how})"
        if not turns and (twice, key[0]) != (True, "dac_saturation"):
            assert (failed == must[key]).all(), f"{where} failed {failed.tolist()}: {found}"


def _check_spread(rng: random.Random) -> None:
    """Hold the spread of several runs against one that is known, and their order against another's.

    In one run a load lies beside the others for a while, at an on/off machine to the end.
    """
    followed = [k for k in pool() if k.measured.get(("switching_order", "", ""), 0.0) == 0.0]
    kept = rng.choice([one for one in followed if one.seed.options.product is None])
    seed, switched = kept.seed, kept.seed.facts.switched
    if seed.facts.places is not None:
        return  # an embroiderer is not repeated
    channels = [c for c in seed.proof.recording.channels if c.name in kept.samples]
    loads = [c for c in channels if c.kind is ChannelKind.LOAD and c.unit == "m"]
    if switched:
        loads = [c for c in loads if np.ptp(kept.samples[c.name]) > 0.01]
    name, count = rng.choice(loads).name, rng.randint(2, 5)
    beside = 10.0 ** rng.uniform(-5.0, -2.0) * rng.choice((1.0, -1.0))
    values = kept.samples[name].copy()
    begin = rng.randrange(len(values) // (4 if switched else 1))
    values[begin : len(values) if switched else begin + rng.randint(1, 50)] += beside
    each = [kept.samples] * (count - 1) + [{**kept.samples, name: values}]
    rng.shuffle(each)
    wanted = abs(beside) * (count - 1) / count
    together = not switched and rng.random() < 0.5
    length = len(values)
    if together:
        once = (ChannelKind.COMMANDED, ChannelKind.OUTPUT, ChannelKind.OPERATION)
        own = {c.name for c in channels if c.kind in once}
        side = {n: v if n in own else np.stack([run[n] for run in each], axis=1)
                for n, v in kept.samples.items()}  # fmt: skip
        runs = [recording_of(seed, side, edges_of(rng, length), count)]
    else:
        runs = [recording_of(seed, run, edges_of(rng, length)) for run in each]
    for factor in (None, 0.999, 1.001):
        limit = None if factor is None else factor * wanted
        own_one = Criterion(name="repeatability", limit=limit, options={"recordings": count})
        spec = replace(seed.proof.spec, criteria=(own_one,))
        with plan_measured_once(seed.proof.plan):
            result = Judge(seed.proof.plan, spec).verdict(runs).result("repeatability")
        about = f"{name} beside by {beside} in one of {count}: {result}, wanted {wanted}"
        assert result.measured is not None, about
        assert abs(result.measured - wanted) < 1e-6 * wanted + 1e-12, about
        assert (result.status is Status.FAILED) == (factor == 0.999), about
