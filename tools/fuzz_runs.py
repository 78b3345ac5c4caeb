"""Short runs of every kind of machine, and what is known of them: for ``fuzz_recordings.py``."""

from __future__ import annotations

import atexit
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from tests.verdict.interpreter import Facts, Stitch
from tests.winding import programs
from tools import short_jobs

from threadline.commands.plan import Motion, Plan
from threadline.commands.turns import Stitched
from threadline.files import Stream
from threadline.jobs.operations import Move, OperationStream
from threadline.machine import Machine, load_machine
from threadline.machine.pneumatics import Way
from threadline.machine.tool import PathLimits
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, prove, with_product
from threadline.verdict import Criterion, judge, load_spec
from threadline.verdict.demands import BRAKING, NEEDLE_USE, PATH_USE, measure_demands
from threadline.verdict.registry import MEASURES
from threadline.verdict.stitch_run import measure_tables
from threadline.winding.product import product_of_text, product_text

_FOLDER = Path(tempfile.mkdtemp(prefix="threadline-fuzz-"))  # a job is read again and again
atexit.register(shutil.rmtree, _FOLDER, ignore_errors=True)
_EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
_BRIDGED, _LIFTED = 110, 60  # blocks of a circuit: over the waist, and less
_COARSE = 5  # points of a geodesic that are one block
_SHAPER = "zv:12Hz:0.02"
_PLACER = "letter-placer+whole-scans+own-damping"


@dataclass(frozen=True)
class Seed:
    """A run that is judged, what there is to know of it, and its samples."""

    proof: Proof
    facts: Facts
    period_s: float
    samples: dict[str, np.ndarray]
    file: Path
    options: Options


@cache
def seeds() -> tuple[Seed, ...]:
    """Return a short run of each kind of machine: winder, stitcher, on/off placer, embroiderer."""
    found = []
    for file, text, name, options in (
        ("short.prg", short_jobs.PROGRAM_OF_ALL_AXES, "lathe-winder", Options()),
        ("short.seam.toml", short_jobs.SEAM, "stitcher", Options()),
        ("short.toml", short_jobs.MOVES, _PLACER, Options(shaper="zv")),
        ("short.dst", short_jobs.DESIGN, "schiffli-frame", Options()),
    ):
        (_FOLDER / file).write_bytes(text if isinstance(text, bytes) else text.encode())
        machine = load_machine(name)
        proof = prove(_FOLDER / file, machine, load_spec(None, machine), options)
        found.append(seed_of(proof, _FOLDER / file, options, _facts(proof)))
    return tuple(found)


@cache
def more_seeds() -> tuple[Seed, ...]:
    """Return runs with the criteria that no other has.

    A fibre over a waist that it bridges, with the eye too near; one that lifts; more than a circuit
    of a short vessel; steps lost on a machine that brakes otherwise than it speeds up, with limits
    along the path; a needle that follows the head; cylinders whose valves are open too far.
    """
    winder, stepper = load_machine("lathe-winder"), load_machine("stepper-winder")
    waist = product_text(_EXAMPLES / "vessel-waist.wind.toml").replace("2 mm", "60 mm")
    smooth = product_of_text(product_text(_EXAMPLES / "vessel.wind.toml")).surface
    circuit = programs.eyes(smooth, programs.geodesic(smooth)[1])
    bridged, lifted = (programs.steps(circuit[:end]) for end in (_BRIDGED, _LIFTED))
    lifted[_LIFTED // 2] = -8.0, 0.0, 0.0
    wound = (programs.program(circuit[:2], 1, rows) for rows in (bridged, lifted))
    x = stepper.axes["X"]
    braking = replace(x, deceleration=replace(x.acceleration, si=0.7 * x.acceleration.si))
    limited = replace(
        stepper,
        axes={**stepper.axes, "X": braking},
        path=PathLimits(acceleration=replace(x.acceleration, si=0.9 * x.acceleration.si)),
    )
    of_fibre = Options(product=waist, shaper=_SHAPER)
    short, coarse = short_vessel()
    closing = programs.program(coarse, 1, programs.steps(coarse[: 2 * len(coarse) // 3]))
    closing = closing.replace("F 1200", "F 9000")
    return (
        *(_seed(f"{k}.prg", text, winder, of_fibre) for k, text in enumerate(wound)),
        _seed("closes.prg", closing, winder, replace(of_fibre, product=short)),
        _wide_open(seeds()[2]),
        _seed("follows.seam.toml", short_jobs.FOLLOWED_SEAM, load_machine("stitcher"), Options()),
        _seed("steps.nc", short_jobs.PROGRAM_OF_STEPS, limited, Options(interpolation="optimal")),
    )


@cache
def short_vessel() -> tuple[str, np.ndarray]:
    """Return a product, and (n, 3) turn, rad, and places of the eye, m, of a circuit on it."""
    text = product_text(_EXAMPLES / "vessel.wind.toml").replace("96.05 mm", "12 mm")
    text = text.replace("125 mm", "60 mm")
    surface = product_of_text(text).surface
    path = programs.geodesic(surface)[1]
    rows = np.linspace(0, len(path) - 1, len(path) // _COARSE).astype(int)
    return text, programs.eyes(surface, path[rows])


def _wide_open(seed: Seed) -> Seed:
    """Return a run of an on/off machine whose flow controls are open by 5 % more."""
    machine = seed.proof.plan.machine
    cylinders = {
        name: replace(one, forward=_opened(one.forward), back=_opened(one.back))
        for name, one in machine.cylinders.items()
    }
    plan = replace(seed.proof.plan, machine=replace(machine, cylinders=cylinders))
    return replace(seed, proof=replace(seed.proof, plan=plan))


def _opened(way: Way) -> Way:
    flows = {name: replace(flow, si=1.05 * flow.si) for name, flow in way.flows.items()}
    return replace(way, flows=flows)


def _seed(file: str, text: str, machine: Machine, options: Options) -> Seed:
    """Return a run with the least facts: the second reading reads none of these."""
    (_FOLDER / file).write_text(text)
    spec = with_product(load_spec(None, machine), machine, options)
    names = (BRAKING, PATH_USE, *((NEEDLE_USE,) if text is short_jobs.FOLLOWED_SEAM else ()))
    own = tuple(Criterion(name=name) for name in names)
    spec = replace(spec, criteria=(*spec.criteria, *own))
    proof = prove(_FOLDER / file, machine, spec, options)
    return seed_of(proof, _FOLDER / file, options, None)


def seed_of(proof: Proof, file: Path, options: Options, facts: Facts | None) -> Seed:
    """Return a proof with its plan and samples in memory; ``facts`` None: the least."""
    proof = replace(proof, plan=_held(proof.plan))
    blocks = list(proof.recording)
    samples = {
        c.name: np.concatenate([b.samples[c.name] for b in blocks])
        for c in proof.recording.channels
    }
    period_s = float(proof.recording.channels[0].clock.period_s)
    known = facts or Facts(list(proof.plan.axes), set(), False, 0.0, 0.0)
    return Seed(proof, known, period_s, samples, file, options)


def _held(plan: Plan) -> Plan:
    """Return the plan with all its streams in memory."""
    job = replace(plan.job, operations=OperationStream(Stream.of(plan.job.runs())))
    if not isinstance(plan.intent, Motion):
        return replace(plan, job=job)

    def hold(stage: Any) -> Any:
        return None if stage is None else replace(stage, blocks=Stream.of(stage.blocks))

    stages = ("programmed", "path", "trajectory", "timed")
    motion = replace(plan.intent, **{name: hold(getattr(plan.intent, name)) for name in stages})
    return replace(plan, job=job, commands=hold(plan.commands), intent=motion)


@contextmanager
def plan_measured_once(plan: Plan) -> Iterator[None]:
    """Let the judge take what it measures of a plan alone from the first time that it did."""
    judging: Any = sys.modules[judge.__module__]
    measure = judging._of_plan
    known = _of_plan(plan)
    judging._of_plan = lambda _, keys: {k: known[k[0]] for k in keys if k[0] in known}
    try:
        yield
    finally:
        judging._of_plan = measure


@cache
def _of_plan(plan: Plan) -> dict[str, list[Any]]:
    """Return what every measure of a plan alone finds, by name."""
    measured = sys.modules[judge.__module__]._of_plan(plan, {(name, ()): None for name in MEASURES})
    return {name: found for (name, _), found in measured.items()}


def forget_plans() -> None:
    """Forget what was measured of plans that are judged no more."""
    _of_plan.cache_clear()


def _facts(proof: Proof) -> Facts:
    plan, machine = proof.plan, proof.plan.machine
    axes = list(plan.axes)
    if machine.cylinders:
        own = {("travel", axis): 0.0 for axis in axes}
        return Facts(axes, set(), True, 0.0, 0.0, own=own)
    if isinstance(plan.intent, Stitched):
        return _facts_of_stitches(proof)
    begin_s, end_s = plan.motion.trajectory.moves_s
    programmed = plan.motion.programmed
    own, planned = {}, {}
    for name, rows in measure_demands(plan).items():
        for row in rows:
            if row.value is not None:
                planned[name, row.axis] = row.value
    for axis in axes:
        of = machine.axes[axis]
        for name, limit in (("velocity", of.velocity), ("acceleration", of.acceleration)):
            own[name, axis] = limit.si
        if of.jerk is not None:
            own["jerk", axis] = of.jerk.si
    dacs = {axis: machine.controller_of(axis).dac for axis in axes}
    return Facts(
        axes,
        {a for a in axes if machine.axes[a].kind == "rotary"},
        False,
        begin_s,
        end_s,
        radius_m=programmed.radius_m,
        vertices=np.concatenate([b.positions for b in programmed]),
        clamp_v={a: d.range.si - 1.5 * d.volt_per_level for a, d in dacs.items()},
        own=own,
        planned=planned,
        stitches=_stitches(plan),
        lag_s=proof.spec.lag_s,
        off_m=1e-4,  # the tolerance of the default interpolation
    )


def _stitches(plan: Plan) -> list[Stitch]:
    """Return the stitches of a seam, as the job's tags and the trajectory have them."""
    moved: dict[int, tuple[float, float]] = {}
    for block in plan.motion.trajectory:
        ends = block.start_s + block.duration_s
        for number, begin, end in zip(block.operation, block.start_s, ends, strict=True):
            moved[int(number)] = (moved.get(int(number), (float(begin), 0.0))[0], float(end))
    return [
        Stitch(*moved[number], float(one.tags["target_m"]), bool(one.tags["exempt"]))
        for number, one in enumerate(plan.job)
        if isinstance(one, Move) and "stitch" in one.tags
    ]


def _facts_of_stitches(proof: Proof) -> Facts:
    plan, stitched = proof.plan, proof.plan.stitched
    axes = list(plan.axes)
    planned = {
        (name, row.axis): row.value
        for name, rows in measure_tables(plan).items()
        for row in rows
        if row.value is not None
    }
    own = {(name, axis): 1.0 for name in ("servo_force",) for axis in axes}
    own |= {("window_use", ""): 1.0, ("fetch_use", ""): 1.0}
    own |= {("travel", axis): 0.0 for axis in axes}
    return Facts(
        axes,
        set(),
        False,
        0.0,
        # The last entry of the needle is what has to be seen.
        float(proof.plan.duration_s) * 0.9,
        own=own,
        planned=planned,
        places=stitched.places_m[stitched.turns.stitch > 0],
    )
