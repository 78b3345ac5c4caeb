"""Tune the loops of a machine: controllers of five kinds by four rules, side by side on jobs.

The rules are the margins of the loop (``loop_design``), the two of Ziegler and Nichols
(``ziegler_nichols``), and the fastest settling of a PD controller. The thesis on the winder
searched the last one by hand over the operable range of Kp and Kd.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.base.wording import ascii_only, toml_string
from threadline.dynamics.analysis import LoopFigures, loop_figures
from threadline.dynamics.loop import Loop, axis_loop
from threadline.dynamics.loop_design import (
    CONTROLLERS,
    NAMES,
    NUMBERS,
    ControllerKind,
    check_goal,
    design,
    grid_margins,
    open_plant,
    with_controller,
)
from threadline.dynamics.responses import Step, step_response
from threadline.dynamics.worst_margins import spread_of
from threadline.errors import MachineError, OptionError, PlanError
from threadline.files.formats.common import atomic_file
from threadline.identify.parameter_fit import base_lines
from threadline.machine import Machine
from threadline.machine.numbers import number_at
from threadline.proof.options import options_of
from threadline.proof.pipeline import prove
from threadline.search.tuning import RULES, JobRun, Rule, TunedAxis, TunedLoop, Tuning
from threadline.search.ziegler_nichols import reaction_curve, ultimate
from threadline.units import parse_number
from threadline.verdict import Spec
from threadline.verdict.spec import load_spec

_ZIEGLER: tuple[ControllerKind, ...] = ("p", "pi", "pid")
_STEP_RAD = 60.0  # length of a computed step response, in radians at the crossover
_STEP_LEAST_S = 0.2
_SMOOTH = 1e-3  # largest overshoot that counts as none
_OVERSHOOT, _MODULUS = (
    0.05,
    0.5,
)  # bounds of the rule settling: largest overshoot, least modulus margin
_TRIES = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class TuningGoal:
    """The goal of a tuning.

    Parameters
    ----------
    phase_margin_deg
        Phase margin of the rule ``margin``.
    crossover_hz
        Crossover of that rule; None for the crossover with the largest gain at low frequencies.
    axes
        Axes to tune; all with a loop where it is empty.
    """

    phase_margin_deg: float = 60.0
    crossover_hz: float | None = None
    axes: tuple[str, ...] = ()


def tune(
    machine: Machine,
    goal: TuningGoal,
    jobs: Sequence[Path] = (),
    spec: Spec | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Tune the loops of a machine; nothing moves.

    Parameters
    ----------
    jobs
        Jobs that are run on the twin with each kind of controller.
    spec
        The specification of the jobs; its measures are read, not its limits.
    progress
        Called with the name of the present step and the share done.

    Raises
    ------
    OptionError
        If there is no such axis, it has no loop, or a number is out of range.
    MachineError
        If an axis has a state-space controller, or shares bodies with one.
    JobError
        If a job cannot be read.
    """
    names = goal.axes or tuple(name for name, one in machine.axes.items() if one.controller)
    if not names:
        raise OptionError(
            f"machine {machine.name!r} has no control loops", remedy="It has nothing to tune."
        )
    loops = {name: axis_loop(machine, name) for name in names}
    for loop in loops.values():
        if not loop.single:
            raise MachineError(
                f"axis {loop.axis}: controllers.{machine.axes[loop.axis].controller} or one beside "
                "it has the kind state-space, and the rules are for a controller with one error "
                "and one drive",
                place=machine.place,
                remedy="Name another --axis, or tune the machine file without that controller.",
            )
        check_goal(loop, goal.phase_margin_deg, goal.crossover_hz)
    axes = []
    for k, name in enumerate(names):
        if progress is not None:
            progress(f"axis {name}", k / (len(names) + len(jobs)))
        axes.append(_tuned_axis(machine, loops[name], goal))
    tuning = Tuning(machine=machine, axes=tuple(axes))
    runs = []
    for k, job in enumerate(jobs):
        if progress is not None:
            progress(job.name, (len(names) + k) / (len(names) + len(jobs)))
        runs += _job_runs(tuning, job, spec)
    return Tuning(machine=machine, axes=tuple(axes), runs=tuple(runs))


def _tuned_axis(machine: Machine, loop: Loop, goal: TuningGoal) -> TunedAxis:
    axis, left_out = loop.axis, []
    found: list[tuple[ControllerKind, Rule, dict[str, float]]] = []

    def tried(kind: ControllerKind, rule: Rule, gains: Callable[[], dict[str, float]]) -> None:
        try:
            found.append((kind, rule, gains()))
        except (MachineError, OptionError) as error:
            left_out.append(f"{NAMES[kind]}, {rule}: {error.message}")

    name = machine.axes[axis].controller
    file_kind = next((one for one in CONTROLLERS if one == machine.controllers[name].kind), None)
    if file_kind is not None:
        numbers = {k: number_at(machine, f"controllers.{name}.{k}").si for k in NUMBERS[file_kind]}
        found.append((file_kind, "file", numbers))
    margin, crossover = goal.phase_margin_deg, goal.crossover_hz
    for kind in CONTROLLERS:
        tried(kind, "margin", partial(design, machine, loop, kind, margin, crossover))
    limit = None
    try:
        limit = ultimate(machine, axis)
        found += [(kind, "ultimate", limit.gains(kind, loop.period_s)) for kind in _ZIEGLER]
    except MachineError as error:
        left_out.append(f"by the ultimate gain: {error.message}")
    try:
        curve = reaction_curve(machine, axis)
        found += [(kind, "step", curve.gains(kind, loop.period_s)) for kind in _ZIEGLER]
    except MachineError as error:
        left_out.append(f"by a step: {error.message}")
    by_margin = next((g for kind, rule, g in found if (kind, rule) == ("pd", "margin")), None)
    if by_margin is not None:
        tried("pd", "settling", partial(_fastest_settling, machine, axis, by_margin))
    spread = spread_of(machine, axis)
    tuned_loops = []
    for kind, rule, gains in found:
        closed = axis_loop(with_controller(machine, axis, kind, gains), axis)
        figures = loop_figures(closed, "sampled")
        tuned_loops.append(
            TunedLoop(
                axis=axis,
                kind=kind,
                rule=rule,
                gains=gains,
                figures=figures,
                worst=spread.worst(kind, gains),
                step=_step(closed, figures) if figures.stable else None,
            )
        )
    smooth_kp = None if limit is None else _smooth_kp(machine, axis, limit.kp)
    return TunedAxis(
        axis=axis,
        limit=limit,
        smooth_kp=smooth_kp,
        loops=tuple(tuned_loops),
        left_out=tuple(left_out),
    )


def _step(loop: Loop, figures: LoopFigures) -> Step | None:
    crossovers = [one.omega_rad_s for one in figures.margins.gain_crossovers]
    lowest_rad_s = min(crossovers, default=math.inf)
    return step_response(loop, "load", max(_STEP_RAD / lowest_rad_s, _STEP_LEAST_S))


def _smooth_kp(machine: Machine, axis: str, ultimate_kp: float) -> float | None:
    """Return the largest proportional gain without overshoot of the load, within a percent."""
    low, high = 1e-3 * ultimate_kp, ultimate_kp
    if _overshoot(machine, axis, low) > _SMOOTH:
        return None
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        if _overshoot(machine, axis, middle) > _SMOOTH:
            high = middle
        else:
            low = middle
    return low


def _overshoot(machine: Machine, axis: str, kp: float) -> float:
    loop = axis_loop(with_controller(machine, axis, "p", {"kp": kp}), axis)
    # A slow loop is an integrator, whose crossover is its gain.
    omega_rad_s = np.array([1e-3])
    crossover_rad_s = float(np.abs(loop.response(omega_rad_s))[0]) * 1e-3
    step = step_response(loop, "load", max(_STEP_RAD / crossover_rad_s, _STEP_LEAST_S))
    return math.inf if step is None else step.overshoot


def _fastest_settling(machine: Machine, axis: str, start: Mapping[str, float]) -> dict[str, float]:
    """Return Kp and Kd whose step settles to 2 % first, by a search from a design.

    The load overshoots by at most 5 %, and the loop keeps a distance of 0.5 from -1.
    """
    from scipy.optimize import minimize

    plant = open_plant(axis_loop(machine, axis))

    def cost(x: FloatArray) -> float:
        gains = {"kp": math.exp(x[0]), "kd": math.exp(x[1])}
        L = plant.response * plant.controller("pd", gains)
        margins = grid_margins(L, plant.omega_rad_s)
        modulus_shortfall = max(_MODULUS - float(margins.modulus[0]), 0.0)
        crossover = float(margins.crossover_rad_s[0])
        loop = axis_loop(with_controller(machine, axis, "pd", gains), axis)
        if crossover == 0.0 or margins.gain_factor[0] <= 1.0 or margins.phase_deg[0] <= 0.0:
            return 1e3
        step = step_response(loop, "load", max(_STEP_RAD / crossover, _STEP_LEAST_S))
        if step is None:
            return 1e3
        excess_overshoot = max(step.overshoot - _OVERSHOOT, 0.0)
        return step.settling_s * (1.0 + 20.0 * excess_overshoot + 20.0 * modulus_shortfall)

    first = np.log([start["kp"], max(start["kd"], 1e-3 * start["kp"])])
    simplex = first + np.array([[0.0, 0.0], [-0.5, 0.0], [0.0, -0.7]])
    solution = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"maxfev": _TRIES, "initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-5},
    )
    if solution.fun >= 1e3:
        raise OptionError("no Kp and Kd near the design by margins settle")
    return {"kp": float(np.exp(solution.x[0])), "kd": float(np.exp(solution.x[1]))}


def _job_runs(tuning: Tuning, job: Path, spec: Spec | None) -> list[JobRun]:
    rows = [(loop.kind, loop.rule) for loop in tuning.axes[0].loops]
    for axis in tuning.axes[1:]:
        loops_there = {(loop.kind, loop.rule) for loop in axis.loops}
        rows = [row for row in rows if row in loops_there]
    job_runs = []
    for kind, rule in rows:
        machine = tuning.tuned(kind, rule)
        used_spec = load_spec(None, machine) if spec is None else spec
        try:
            verdict = prove(job, machine, used_spec, options_of()).verdict
        except PlanError as error:
            if all(axis.loop(kind, rule).figures.stable for axis in tuning.axes):
                raise
            del error
            verdict = None
        job_runs.append(JobRun(job=job.name, kind=kind, rule=rule, verdict=verdict))
    return job_runs


def tuning_goal(
    machine: Machine, axis: str | None, margin: str, crossover: str | None
) -> TuningGoal:
    """Return the goal of a tuning from its options as typed.

    Raises
    ------
    OptionError
        If there is no such axis with a loop, or a text is no angle or no frequency.
    """
    controlled_axes = [name for name, one in machine.axes.items() if one.controller]
    if axis is not None and axis not in controlled_axes:
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis[:20]!r} with a control loop",
            remedy=f"It has: {', '.join(controlled_axes) or 'none'}.",
        )
    return TuningGoal(
        phase_margin_deg=math.degrees(parse_number("margin", margin, "rad", "60 deg")),
        crossover_hz=None
        if crossover is None
        else parse_number("crossover", crossover, "Hz", "13.5 Hz"),
        axes=() if axis is None else (axis,),
    )


def usual_controller(machine: Machine) -> ControllerKind:
    """Return the kind of controller of the first axis, ``pd`` where it has none of the five."""
    for axis in machine.axes.values():
        if axis.controller:
            own_kind = machine.controllers[axis.controller].kind
            return next((kind for kind in CONTROLLERS if kind == own_kind), "pd")
    return "pd"


NameT = TypeVar("NameT", bound=str)


def parse_controller(text: str) -> ControllerKind:
    """Return a kind of controller; raise OptionError if there is none of that name."""
    return _named(text, CONTROLLERS, "controller")


def parse_rule(text: str) -> Rule:
    """Return a rule; raise OptionError if there is none of that name."""
    return _named(text, RULES, "rule")


def _named(text: str, known: Sequence[NameT], what: str) -> NameT:
    for one in known:
        if text == one:
            return one
    raise OptionError(f"there is no {what} {text[:20]!r}", remedy=f"There are {', '.join(known)}.")


def tuned_toml(tuning: Tuning, kind: ControllerKind, rule: Rule, folder: Path) -> str:
    """Return the text of a machine file with one kind of controller, to lie in ``folder``.

    Raises
    ------
    OptionError
        If an axis has no such controller.
    """
    machine = tuning.machine
    lines = [
        f"# Tuned by threadline tune: {NAMES[kind]}, {rule}.",
        *base_lines(machine, folder),
        f"name = {toml_string(machine.name.split('+')[0] + '-tuned')}",
        f"title = {toml_string(ascii_only(machine.title) + ', tuned')}",
    ]
    for axis in tuning.axes:
        loop = axis.loop(kind, rule)
        name = machine.axes[axis.axis].controller
        old_kind = machine.controllers[name].kind
        lines += ["", f"[controllers.{name}]", f"kind = {toml_string(kind)}"]
        for key in NUMBERS[kind]:
            unit = "" if key in {"zero", "pole"} else " dac/count"
            lines.append(
                f'{key} = "{loop.gains[key]:.6g}{unit} exact, checked: threadline tune, {rule}"'
            )
        unused_numbers = {
            k for other in CONTROLLERS if other == old_kind for k in NUMBERS[other]
        } - {*NUMBERS[kind]}
        lines += [f'{key} = "none"' for key in sorted(unused_numbers)]
    return "\n".join(lines) + "\n"


def write_tuned(tuning: Tuning, kind: ControllerKind, rule: Rule, file: Path) -> None:
    """Write a machine file with one kind of controller; nothing is left if that fails.

    Raises
    ------
    OptionError
        If an axis has no such controller, or one that is unstable.
    RecordingError
        If the file cannot be written.
    """
    for axis in tuning.axes:
        if not axis.loop(kind, rule).figures.stable:
            raise OptionError(
                f"axis {axis.axis}: {NAMES[kind]} by {rule} is unstable",
                remedy="Choose another --controller or --rule.",
            )
    text = tuned_toml(tuning, kind, rule, file.parent)
    with atomic_file(file) as stream:
        stream.write(text.encode())
