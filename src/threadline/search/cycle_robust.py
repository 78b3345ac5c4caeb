"""The shortest cycle that is in spec on machines all over a band of modes.

Each move gets the shortest command that its flow controls can make and whose ringing is small
enough at every frequency of the band. The ringing of earlier moves counts with its full amplitude,
because its phase differs at each frequency. The twin then runs the cycle on machines all over the
band. Where the twin rings more than the closed form says, the search lowers the allowed ringing of
the move that causes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.intents import ScheduledMove
from threadline.commands.plan import Plan
from threadline.commands.schedule_moves import levels_text, valves_of
from threadline.dynamics.pneumatic import flow_mode, step_ringing
from threadline.errors import OptionError, Place, PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.vary import band_of, band_parts, mode_off
from threadline.motion.shaping.onoff.flow_search import (
    FlowCommand,
    FlowMove,
    flow_command,
    least_scans,
    shortest_flow_command,
)
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Proof, plan_job, simulate, try_plan
from threadline.search.cycle import cycle_s
from threadline.search.move_list import levels_of_operations, overlapped, with_choices
from threadline.search.paced import Question
from threadline.verdict import Criterion, Judge, Spec, Status, Verdict

MEASURE = "residual_vibration"


@dataclass(frozen=True, slots=True, kw_only=True)
class BandRun:
    """Result of one machine of the band.

    Parameters
    ----------
    relative
        Relative deviation of its modes, for example -0.2 ... 0.2.
    verdict
        Verdict of one run.
    """

    relative: float
    verdict: Verdict

    @property
    def worst_m(self) -> float:
        """The largest residual vibration."""
        vibrations_m = [r.measured for r in self.verdict.results if r.name == MEASURE]
        return max((value for value in vibrations_m if value is not None), default=0.0)


def band_machines(machine: Machine, band: float) -> tuple[tuple[float, Machine], ...]:
    """Return the machines of ``band_of``, each with the relative deviation of its modes.

    Raises
    ------
    OptionError
        If the machine has no spring, or the band is not above 0 and below 1.
    """
    others = (other for _, other in band_of(machine, band).machines)
    return tuple(zip(band_parts(band), others, strict=True))


def over_band(
    plan: Plan, spec: Spec, machines: Sequence[tuple[float, Machine]]
) -> tuple[BandRun, ...]:
    """Return the verdict of each machine of a band on a plan, from one run each."""
    return tuple(
        BandRun(
            relative=part,
            # Amplitudes from place and speed depend on the mode of the machine that ran.
            verdict=Judge(replace(plan, machine=one), spec).verdict([simulate(plan.commands, one)]),
        )
        for part, one in machines
    )


_FREQUENCIES = 33  # number of frequencies of the band in the closed form
_LONGEST_PERIODS = 1.5
_SEEDS = 3  # number of commands with the same duration for each share
_LONGER_PERIODS = 0.4  # periods by which commands of real valves may exceed the bound
_ROUNDS = 10
_SHORTER = 24  # number of cycles to try with one command shorter than in the first cycle in spec
_BEAM = 200
_LESS = 0.97
_HOPED = 1.6  # first allowed share of the limit, above 1 because amplitudes seldom add up fully


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustMove:
    """A move with its command.

    Parameters
    ----------
    step, axis, distance_m, job_line
        Step, axis, distance and line of the move.
    levels
        Levels as text of a move list.
    command_s, unshaped_s, bound_s
        Durations of the chosen command, of the unshaped command, and a lower bound: the shortest
        command of ideal valves in whole scans, with any level between 0 and 1, if the move alone
        may use the whole limit.
    """

    step: str
    axis: str
    distance_m: float
    job_line: int
    levels: str
    command_s: float
    unshaped_s: float
    bound_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustCycle:
    """Result of a search over a band.

    Parameters
    ----------
    job
        The job with its commands; None where no cycle is in spec all over the band.
    proof
        Proof on the machine of the file; where no cycle was found, proof of the last trial.
    over
        The same cycle on each machine of the band.
    moves
        Every move, in order.
    frequencies_hz
        Per cylinder the lowest and the highest frequency of its mode.
    tried
        Number of cycles that the twin ran.
    """

    job: Job | None
    proof: Proof
    over: tuple[BandRun, ...]
    moves: tuple[RobustMove, ...]
    frequencies_hz: dict[str, tuple[float, float]]
    tried: int

    @property
    def cycle_s(self) -> float | None:
        """Duration of the cycle; None where no cycle is in spec all over the band."""
        return None if self.job is None else cycle_s(self.proof)


def robust_cycle(question: Question, band: float) -> RobustCycle:
    """Search the shortest cycle that is in spec on every machine of the band.

    The trials use the machine of the file. In addition, each machine of the band makes one run. If
    the time ends, the cycle being tried is the last.

    Parameters
    ----------
    band
        Half width of the band, as a share of the frequency: 0.2 for +-20 %.

    Raises
    ------
    OptionError
        If the band has no width, or the specification limits no vibration.
    PlanError
        If the machine cannot do the job even unshaped, or every command of its valves rings too
        much.
    """
    machine, spec, progress, until = (
        question.machine,
        question.spec,
        question.progress,
        question.until,
    )
    machines = band_machines(machine, band)
    overlapped_job = overlapped(with_choices(question.job, {}, {}), machine)
    overlapped_plan = plan_job(overlapped_job, machine, Options())
    search = _Search(overlapped_job, question, band, overlapped_plan)
    spec_by_step = replace(spec, criteria=(*spec.criteria, *search.by_step()))
    out_of_time = False
    for tried in range(1, _ROUNDS + 1):
        if progress is not None:
            progress("cycles over the band", (tried - 1) / _ROUNDS)
        chosen = search.next()
        candidate = search.job_of(chosen)
        plan = plan_job(candidate, machine, Options())
        runs = over_band(plan, spec_by_step, machines)
        in_spec = not search.learn(runs)
        proof = try_plan(plan, spec, question.trials if in_spec else NOMINAL)
        passed = in_spec and proof.verdict.passed
        out_of_time = until is not None and until.over()
        if passed or out_of_time:
            break
        if in_spec:
            search.tighten()
    job = candidate if passed else None
    trials = iter(search.shorter(chosen)) if passed else iter(())
    shorter = next(trials, None)
    while shorter is not None and not out_of_time:
        if progress is not None:
            progress("cycles over the band", tried / (_ROUNDS + _SHORTER))
        plan = plan_job(search.job_of(shorter), machine, Options())
        improves = plan.duration_s < proof.plan.duration_s - 1e-9
        if improves:
            tried += 1
            improves = all(run.verdict.passed for run in over_band(plan, spec, machines))
        if improves:
            shorter_proof = try_plan(plan, spec, question.trials)
            improves = shorter_proof.verdict.passed
        if improves:
            job, proof, chosen = search.job_of(shorter), shorter_proof, shorter
            trials = iter(search.shorter(chosen))
        out_of_time = tried >= _ROUNDS + _SHORTER or (until is not None and until.over())
        shorter = next(trials, None)
    return RobustCycle(
        job=job,
        proof=proof,
        over=over_band(proof.plan, spec, machines),
        moves=search.robust_moves(chosen),
        frequencies_hz=search.frequencies_hz,
        tried=tried,
    )


class _Search:
    """One search of ``robust_cycle``: commands and allowed ringing of each move."""

    def __init__(self, job: Job, question: Question, band: float, plain: Plan) -> None:
        machine, progress = question.machine, question.progress
        self._job, self._machine, self._spec = job, machine, question.spec
        self._shares = question.effort.command_shares
        self._base = plain.scheduled.one_cycle
        self._scan_s = float(self._base.commands.clock.period_s)
        self._steps = tuple(e.name for e in self._base.commands.events if e.kind == "tool")
        axes = tuple(dict.fromkeys(move.axis for move in self._base.moves))
        deviations = np.linspace(-band, band, _FREQUENCIES)
        family = [mode_off(machine, float(deviation)) for deviation in deviations]
        ringing = {axis: [step_ringing(one, axis) for one in family] for axis in axes}
        self._turns = {
            a: np.exp(np.array([r.pole for r in rs]) * self._scan_s) for a, rs in ringing.items()
        }
        self._amplitude_m = {
            a: np.array([abs(r.amplitude_m) for r in rs]) for a, rs in ringing.items()
        }
        self.frequencies_hz = {
            a: (flow_mode(family[0], a)[0], flow_mode(family[-1], a)[0]) for a in axes
        }
        self._rests = [
            machine.cylinders[m.axis].rest_s(m.forward) / self._scan_s for m in self._base.moves
        ]
        self._share = [_HOPED] * len(self._base.moves)
        commands_by_key: dict[tuple[object, ...], tuple[int, list[FlowCommand]]] = {}
        self._made: list[tuple[int, list[FlowCommand]]] = []
        for index, move in enumerate(self._base.moves):
            if progress is not None:
                progress("commands for the band", index / len(self._base.moves))
            valves = valves_of(machine.cylinders[move.axis].way(move.forward), self._scan_s)
            key = move.axis, valves, move.levels.wanted_m, self._limit_m(index)
            if key not in commands_by_key:
                commands_by_key[key] = self._commands(index)
            self._made.append(commands_by_key[key])

    def _limit_m(self, index: int) -> float:
        move = self._base.moves[index]
        limits_m = [
            c.limit
            for c in self._spec.criteria
            if c.name == MEASURE
            and c.limit is not None
            and c.axis in {"", move.axis}
            and c.step in {"", move.step}
        ]
        if not limits_m:
            raise OptionError(
                f"the specification {self._spec.name!r} limits no {MEASURE} of {move.axis}, so "
                "that nothing asks for a robust command",
                remedy=f'Write a [[criteria]] with name = "{MEASURE}" and a limit into it.',
            )
        return min(limits_m)

    def _flow_move(self, index: int, share: float) -> FlowMove:
        move = self._base.moves[index]
        assert self._machine.plc is not None
        cylinder = self._machine.cylinders[move.axis]
        way = cylinder.way(move.forward)
        hold_s = way.least_hold_s(self._machine.plc)
        return FlowMove(
            on_scans=move.levels.wanted_m / (cylinder.speed.si * self._scan_s),
            valves=valves_of(way, self._scan_s),
            dwell_scans=max(math.ceil(hold_s / self._scan_s - 1e-9), 1),
            turns=self._turns[move.axis],
            most=share * self._limit_m(index) / self._amplitude_m[move.axis],
        )

    def _commands(self, index: int) -> tuple[int, list[FlowCommand]]:
        """Return a lower bound of the duration, scans, and commands for shares of the limit.

        Raises
        ------
        PlanError
            If no command keeps the limit.
        """
        move = self._base.moves[index]
        turn = complex(self._turns[move.axis][0])
        longest = move.levels.ticks[-1] + int(_LONGEST_PERIODS * 2.0 * np.pi / np.angle(turn))
        extra_scans = max(math.ceil(_LONGER_PERIODS * 2.0 * np.pi / np.angle(turn)), 3)
        commands: list[FlowCommand] = []
        bound = least = None
        for share in self._shares:
            flow_move = self._flow_move(index, share)
            # A smaller share takes at least as long, so the search starts at the previous share's
            # scans.
            least = least_scans(flow_move, longest, 1 if least is None else least)
            bound = least if bound is None else bound
            if least is None:
                break
            if sum(flow_move.quiet(command) for command in commands) >= _SEEDS:
                continue
            shortest = max([least, *(command.scans for command in commands)])
            command = shortest_flow_command(flow_move, shortest, least + extra_scans)
            if command is None:
                break
            # Commands that are equal in closed form differ on the twin, which has friction and an
            # air ramp.
            seeded_commands = (
                flow_command(flow_move, command.scans, seed) for seed in range(1, _SEEDS)
            )
            commands += dict.fromkeys(
                [command, *(one for one in seeded_commands if one is not None)]
            )
        if bound is None or not commands:
            lines = self._base.lines_of(self._job, {move.operation})
            raise PlanError(
                f"a search found no command of the valves of {move.axis} that rings at most "
                f"{self._limit_m(index) * 1e3:g} mm all over the band and takes at most "
                f"{((bound or longest) + extra_scans) * self._scan_s:.3g} s; there may be one",
                place=Place(self._job.file, lines[move.operation]),
                remedy="Ask for a narrower band, or allow more ringing.",
            )
        return bound, commands

    def next(self) -> list[FlowCommand]:
        """Return the shortest command of each move with which the closed form keeps the limits."""
        moves = self._base.moves
        chosen: dict[int, FlowCommand] = {}
        for _ in range(2):  # twice: an operation is as long as its longest move
            for axis in self._turns:
                axis_moves = [i for i, move in enumerate(moves) if move.axis == axis]
                chosen.update(zip(axis_moves, self._next_of(axis, axis_moves, chosen), strict=True))
        return [chosen[i] for i in range(len(moves))]

    def _free(self, index: int, chosen: Mapping[int, FlowCommand]) -> float:
        """Return the scans that a move may take at no cost beside a longer simultaneous move."""
        this_move = self._base.moves[index]
        return max(
            (
                chosen[i].scans + self._rests[i] - self._rests[index]
                for i, move in enumerate(self._base.moves)
                if move.operation == this_move.operation and i != index and i in chosen
            ),
            default=0.0,
        )

    def _next_of(
        self, axis: str, own: list[int], chosen: Mapping[int, FlowCommand]
    ) -> tuple[FlowCommand, ...]:
        no_ringing = np.zeros(len(self._turns[axis]))
        states: list[tuple[float, FloatArray, tuple[FlowCommand, ...]]] = [(0.0, no_ringing, ())]
        last_tick = 0
        for index in own:
            move, next_states = self._base.moves[index], []
            flow_move, free_scans = (
                self._flow_move(index, self._share[index]),
                self._free(index, chosen),
            )
            for cost, ringing, commands_before in states:
                for command in self._made[index][1]:
                    elapsed = move.first_tick - last_tick + command.scans
                    decayed = ringing * np.abs(self._turns[axis]) ** elapsed
                    ringing_after = decayed + np.abs(flow_move.left(command.ticks, command.levels))
                    # If no command keeps the limit, the command with the least excess is preferred.
                    excess = max(float((ringing_after / flow_move.most).max()) - 1.0, 0.0)
                    added_cost = max(command.scans, free_scans) + 1e3 * excess
                    next_states.append(
                        (cost + added_cost, ringing_after, (*commands_before, command))
                    )
            states = sorted(next_states, key=lambda s: (s[0], float(s[1].sum())))[:_BEAM]
            last_tick = move.last_tick
        return states[0][2]

    def shorter(self, chosen: Sequence[FlowCommand]) -> Iterator[list[FlowCommand]]:
        """Yield the commands, each time with one of them replaced by the next shorter one."""
        for index, current in enumerate(chosen):
            shorter_commands = [one for one in self._made[index][1] if one.scans < current.scans]
            longest = max((one.scans for one in shorter_commands), default=0)
            for one in shorter_commands:
                if one.scans == longest:
                    yield [*chosen[:index], one, *chosen[index + 1 :]]

    def by_step(self) -> list[Criterion]:
        """Return the limits on residual vibration as one criterion per step and axis."""
        return [
            replace(criterion, axis=axis, step=step, required=False)
            for criterion in self._spec.criteria
            if criterion.name == MEASURE and criterion.limit is not None
            for axis in self._turns
            if criterion.axis in {"", axis}
            for step in dict.fromkeys(self._steps)
            if criterion.step in {"", step}
        ]

    def learn(self, runs: Sequence[BandRun]) -> bool:
        """Lower the share of moves with too much ringing; return whether a run failed."""
        worst: dict[int, float] = {}
        for run in runs:
            for result in run.verdict.results:
                if result.status is not Status.FAILED or result.measured is None:
                    continue
                index = self._move_behind(result.axis, result.step)
                if result.name == MEASURE and result.step and index is not None and result.limit:
                    ratio = result.measured / result.limit
                    worst[index] = max(worst.get(index, 1.0), ratio)
        for index, ratio in worst.items():
            self._share[index] *= _LESS / ratio
        return any(not run.verdict.passed for run in runs)

    def _move_behind(self, axis: str, step: str) -> int | None:
        """Return the last move of a cylinder in a step or before it."""
        if step not in self._steps:
            return None
        step_index = self._steps.index(step)
        moves_before = [
            i
            for i, move in enumerate(self._base.moves)
            if move.axis == axis and move.step in self._steps[: step_index + 1]
        ]
        return moves_before[-1] if moves_before else None

    def tighten(self) -> None:
        """Lower the share of every move, because the band passed and a repeated run failed."""
        self._share = [share * _LESS for share in self._share]

    def job_of(self, chosen: Sequence[FlowCommand]) -> Job:
        """Return the job with its commands written out."""
        how = levels_of_operations(
            (move.operation, move.axis, self._text(move, command))
            for move, command in zip(self._base.moves, chosen, strict=True)
        )
        return with_choices(self._job, how, {})

    def _text(self, move: ScheduledMove, command: FlowCommand) -> str:
        levels = replace(move.levels, ticks=command.ticks, levels=command.levels, realised=None)
        return levels_text(levels, self._scan_s)

    def robust_moves(self, chosen: Sequence[FlowCommand]) -> tuple[RobustMove, ...]:
        """Return every move with its command and durations to compare."""
        lines = self._base.lines_of(self._job, {m.operation for m in self._base.moves})
        return tuple(
            RobustMove(
                step=move.step,
                axis=move.axis,
                distance_m=move.levels.wanted_m * (1.0 if move.forward else -1.0),
                job_line=lines[move.operation],
                levels=self._text(move, command),
                command_s=command.scans * self._scan_s,
                unshaped_s=move.levels.ticks[-1] * self._scan_s,
                bound_s=made[0] * self._scan_s,
            )
            for move, command, made in zip(self._base.moves, chosen, self._made, strict=True)
        )
