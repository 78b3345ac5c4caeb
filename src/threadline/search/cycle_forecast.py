"""Forecast of the vibration that proposes the next cycle to try, corrected by the twin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.commands.intents import ScheduledMove
from threadline.commands.schedule_moves import levels_text, valves_of
from threadline.dynamics.pneumatic import step_ringing
from threadline.files import ChannelKind
from threadline.jobs.moves import REST
from threadline.jobs.operations import Job, Move
from threadline.machine import Machine
from threadline.motion.shaping.onoff.switched import Valves
from threadline.proof.pipeline import Proof
from threadline.search.move_commands import LevelCommand, MoveCommands, step_scans, time_optimal_s
from threadline.search.move_list import levels_of_operations, with_choices
from threadline.verdict import Spec
from threadline.verdict.switch_run import SwitchRun

_BEAM = 300
_BRANCHES = 24  # largest number of pairs of command and wait that are tried from each state
_GRID = 0.25  # share of the limit: states whose ringing differs by less are taken as equal
_LONGEST_WAIT = 6  # steps: a longer wait costs more than another command
_MEASURE = "residual_vibration"
_LESS = 0.93
_LEAST_SEEN = 0.7  # periods: a shorter record cannot separate amplitude from rest position
_BY_SPEED = 0.05  # periods: a shorter record cannot separate place from speed


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveChoice:
    """The chosen command and wait of a move, with durations to compare.

    Parameters
    ----------
    step, axis, distance_m, job_line
        Step, axis, distance and line of the move.
    how
        A shaper's text, ``none``, or levels as a move list writes them.
    command_s, wait_s
        Duration of the command, and of the wait before it.
    unshaped_s, time_optimal_s
        Durations of the unshaped command, and of the shortest command that leaves no ringing.
    """

    step: str
    axis: str
    distance_m: float
    job_line: int
    how: str
    command_s: float
    wait_s: float
    unshaped_s: float
    time_optimal_s: float


@dataclass(frozen=True, slots=True)
class Cycle:
    """Command, wait in scans, and forecast ringing in full steps, for each move of a cycle."""

    commands: tuple[LevelCommand, ...]
    waits: tuple[int, ...]
    left: tuple[complex, ...]
    scans: int


@dataclass(frozen=True, slots=True)
class _State:
    cost: int
    ringing: Mapping[str, complex]
    commands: tuple[LevelCommand, ...] = ()
    waits: tuple[int, ...] = ()
    left: tuple[complex, ...] = ()
    lasts: int = 0  # scans of the operation so far, with its rest


class CycleForecast:
    """The forecast of one search, corrected after each cycle that the twin runs.

    Parameters
    ----------
    machine
        The machine that commands are made for.
    unshaped
        The job without a shaper.
    actual
        The machine that runs the cycles; the forecast uses its modes.
    """

    def __init__(
        self, job: Job, machine: Machine, spec: Spec, unshaped: Proof, actual: Machine
    ) -> None:
        base = unshaped.plan.scheduled.one_cycle
        self._job, self._machine, self._base = job, machine, base
        self._scan_s = float(base.commands.clock.period_s)
        axes = {move.axis for move in base.moves}
        self._ringing = {axis: step_ringing(actual, axis) for axis in axes}
        self._turn = self._turns(actual, axes)
        self._limits = [self._limit(spec, move) for move in base.moves]
        self._share = dict.fromkeys(axes, 1.0)
        self._carried = dict.fromkeys(axes, 0j)  # ringing as the last cycle begins
        self._bias: list[complex] = [0j] * len(base.moves)
        # A correction for one command (its piston hits a stop) need not hold for another duration.
        self._own: list[dict[int, complex]] = [{} for _ in base.moves]
        self._rests = self._rest_scans(job)
        self._with_before = [
            i > 0 and base.moves[i - 1].operation == move.operation
            for i, move in enumerate(base.moves)
        ]
        run = SwitchRun(unshaped.recording, unshaped.plan)
        self._pauses = self._between(run, [0] * len(base.moves))
        self._tried: set[tuple[tuple[tuple[int, ...], ...], tuple[int, ...]]] = set()
        commands = MoveCommands(job, machine, self._scan_s, self._turns(machine, axes))
        self._commands = [
            [
                command.on(self._turn[move.axis], self._valves(move))
                for command in commands.of(move, limit)
            ]
            for move, limit in zip(base.moves, self._limits, strict=True)
        ]

    def _valves(self, move: ScheduledMove) -> Valves:
        return valves_of(self._machine.cylinders[move.axis].way(move.forward), self._scan_s)

    def _turns(self, machine: Machine, axes: set[str]) -> dict[str, complex]:
        """Return the factor on the complex ringing of each cylinder in one scan."""
        poles = {axis: step_ringing(machine, axis).pole for axis in axes}
        return {axis: complex(np.exp(pole * self._scan_s)) for axis, pole in poles.items()}

    def _limit(self, spec: Spec, move: ScheduledMove) -> float:
        """Return the allowed ringing after a move, in units of a full step."""
        limits = [
            c.limit
            for c in spec.criteria
            if c.name == _MEASURE and c.limit is not None and c.axis in {"", move.axis}
            and c.step in {"", move.step}
        ]  # fmt: skip
        return min(limits, default=np.inf) / abs(self._ringing[move.axis].amplitude_m)

    def _rest_scans(self, job: Job) -> list[int]:
        """Return the rest after the last switching of each move, in scans."""
        tags = {i: o.tags for i, o in enumerate(job) if isinstance(o, Move)}
        rests_s = [
            float(
                tags[move.operation].get(
                    REST, self._machine.cylinders[move.axis].rest_s(move.forward)
                )
            )
            for move in self._base.moves
        ]
        return [max(1, math.ceil(rest_s / self._scan_s - 1e-9)) for rest_s in rests_s]

    def next(self) -> Cycle | None:
        """Return the shortest untried cycle whose forecast is within the limits."""
        states = [_State(0, self._carried)]
        for index, move in enumerate(self._base.moves):
            states = _best_states(
                [next_state for state in states for next_state in self._after(state, index, move)],
                {m.axis: self._limits[i] for i, m in enumerate(self._base.moves)},
            )
        for state in sorted(states, key=lambda s: s.cost):
            key = tuple(c.ticks for c in state.commands), state.waits
            if key not in self._tried:
                self._tried.add(key)
                return Cycle(state.commands, state.waits, state.left, state.cost)
        return None

    def _after(self, state: _State, index: int, move: ScheduledMove) -> list[_State]:
        """Return the next states: pairs of wait and command whose ringing is within the limit."""
        axis, sign = move.axis, 1.0 if move.forward else -1.0
        previous_scans = state.commands[-1].scans if state.commands else 0
        simultaneous = self._with_before[index]
        # ``pause`` counts from the last switching of the previous move; both moves may start
        # together.
        pause = (
            -previous_scans if simultaneous else self._pauses[index] + state.lasts - previous_scans
        )
        so_far = state.lasts if simultaneous else 0
        most_ringing = self._share[axis] * self._limits[index]
        commands = self._commands[index]
        bias = [self._own[index].get(c.scans, self._bias[index]) for c in commands]
        ringing_left = sign * np.array([command.left for command in commands]) + np.array(bias)
        scans = np.array([command.scans for command in commands])
        turn_per_scan = self._turn[axis]
        quiet = abs(state.ringing[axis]) < 1e-9
        waits = np.arange(1 if quiet or simultaneous else _LONGEST_WAIT + 1) * step_scans(
            turn_per_scan
        )
        elapsed = pause + waits[:, None] + scans
        ringing_after = state.ringing[axis] * np.exp(np.log(turn_per_scan) * elapsed) + ringing_left
        row, column = np.nonzero(np.abs(ringing_after) <= most_ringing)
        lasts = np.maximum(scans + self._rests[index], so_far)
        cost = waits[row] + lasts[column] - so_far
        best = np.lexsort((np.abs(ringing_after[row, column]), cost))[:_BRANCHES]
        next_states = []
        for wait_index, command_index in zip(
            row[best].tolist(), column[best].tolist(), strict=True
        ):
            command, wait = commands[command_index], int(waits[wait_index])
            elapsed_scans = pause + wait + command.scans
            ringing = {a: s * self._turn[a] ** elapsed_scans for a, s in state.ringing.items()}
            ringing[axis] = complex(ringing_after[wait_index, command_index])
            next_states.append(
                _State(
                    state.cost + wait + int(lasts[command_index]) - so_far,
                    ringing,
                    (*state.commands, command),
                    (*state.waits, wait),
                    (*state.left, ringing[axis]),
                    int(lasts[command_index]),
                )
            )
        return next_states

    def _between(self, run: SwitchRun, waits: Sequence[int]) -> list[int]:
        """Return the scans between each operation's end and the next moving operation, less waits.

        Measured times differ from the schedule where the list waits for a moving piston.
        """
        pauses, ends = [0], list[int]()
        moves = run.moves[-len(self._base.moves) :]
        for index, move in enumerate(moves):
            end = round(move.end_s / self._scan_s) + self._rests[index]
            ends.append(max(end, ends[-1]) if self._with_before[index] else end)
        for index, next_move in enumerate(moves[1:], start=1):
            begin = round(next_move.begin_s / self._scan_s)
            pauses.append(max(begin - ends[index - 1] - waits[index], 0))
        return pauses

    def learn(self, cycle: Cycle, proof: Proof) -> None:
        """Correct the forecast by the twin's ringing; if both agree, lower the limit."""
        run = SwitchRun(proof.recording, proof.plan)
        self._pauses = self._between(run, cycle.waits)
        last_ringing: dict[str, tuple[float, complex]] = {}
        learned = False
        steady = len(run.moves) - len(self._base.moves)
        for run_index, move in enumerate(run.moves):
            index = run_index % len(self._base.moves)
            axis, sign = move.planned.axis, 1.0 if move.planned.forward else -1.0
            if run_index and run_index == steady:
                self._carried |= {
                    a: ringing * np.exp(self._ringing[a].pole * (move.begin_s - since_s))
                    for a, (since_s, ringing) in last_ringing.items()
                }
            before_s, ringing_before = last_ringing.get(axis, (move.end_s, 0j))
            decayed = ringing_before * np.exp(self._ringing[axis].pole * (move.end_s - before_s))
            forecast = complex(decayed + sign * cycle.commands[index].left)
            measured = self._measured(run, run_index)
            if measured is None:
                scans = cycle.commands[index].scans
                bias = self._own[index].get(scans, self._bias[index])
                last_ringing[axis] = move.end_s, forecast + bias
                continue
            last_ringing[axis] = move.end_s, measured
            if run_index < steady:
                continue
            deviation = measured - forecast
            scans = cycle.commands[index].scans
            believed = self._own[index].get(scans, self._bias[index])
            learned = learned or abs(deviation - believed) > 0.02 * self._limits[index]
            self._bias[index] = self._own[index][scans] = deviation
        if not learned:
            for axis in self._share:
                self._share[axis] *= _LESS

    def _measured(self, run: SwitchRun, index: int) -> complex | None:
        """Return the ringing at a move's last switching, in full steps, by least squares."""
        move = run.moves[index]
        axis = move.planned.axis
        frame, ringing = run.find(ChannelKind.FRAME, axis), self._ringing[axis]
        later_begins_s = [m.begin_s for m in run.moves[index + 1 :] if m.planned.axis == axis]
        if frame is None:
            return None
        period_s = 2.0 * np.pi / ringing.pole.imag
        cylinder = self._machine.cylinders[axis]
        begin_s = move.end_s + cylinder.rest_s(move.planned.forward)
        end_s = min([*later_begins_s, begin_s + period_s, float(frame[0][-1])])
        if end_s < begin_s - 1e-9:
            return None
        short_window = end_s - begin_s < _LEAST_SEEN * period_s
        if short_window:  # short record: the rest position from before the cycle is used
            begin_s = min(begin_s, end_s - _BY_SPEED * period_s)
        inside = (frame[0] >= begin_s) & (frame[0] <= end_s)
        time_s = frame[0][inside] - (move.end_s + cylinder.delay.si)
        wave = np.exp(ringing.pole * time_s) * ringing.amplitude_m
        regressors = np.column_stack((wave.real, -wave.imag, np.ones(len(time_s))))
        if short_window:
            regressors = regressors[:, :2]
        moved = frame[1][inside] - frame[1][0]
        real, imag = np.linalg.lstsq(regressors, moved, rcond=None)[0][:2]
        return complex(real, imag)

    def job_of(self, cycle: Cycle) -> Job:
        """Return the job with the commands and waits of a cycle."""
        waits: dict[int, float] = {}
        how: dict[int, tuple[str, str]] = {}
        simultaneous = {
            m.operation
            for m, with_before in zip(self._base.moves, self._with_before, strict=True)
            if with_before
        }
        levels_of_moves = []
        for move, command, wait in zip(self._base.moves, cycle.commands, cycle.waits, strict=True):
            waits.setdefault(move.operation, wait * self._scan_s)
            if move.operation in simultaneous:
                levels_of_moves.append((move.operation, move.axis, self._levels(move, command)))
            else:
                how[move.operation] = self._how(move, command)
        return with_choices(self._job, how | levels_of_operations(levels_of_moves), waits)

    def _how(self, move: ScheduledMove, command: LevelCommand) -> tuple[str, str]:
        if command.name != "levels":
            return "shaper", command.name
        return "levels", self._levels(move, command)

    def _levels(self, move: ScheduledMove, command: LevelCommand) -> str:
        levels = replace(move.levels, ticks=command.ticks, levels=command.levels, realised=None)
        return levels_text(levels, self._scan_s)

    def move_choices(self, cycle: Cycle | None) -> tuple[MoveChoice, ...]:
        """Return every move with its chosen command and wait; without a cycle, as unshaped."""
        lines = self._base.lines_of(self._job, {m.operation for m in self._base.moves})
        optimal_s: dict[tuple[str, bool, int], float] = {}
        rows = []
        for index, move in enumerate(self._base.moves):
            scans = move.levels.ticks[-1]
            key = move.axis, move.forward, scans
            if key not in optimal_s:
                pole = self._ringing[move.axis].pole
                longer_s = self._valves(move).longer * self._scan_s
                flow_s = scans * self._scan_s + longer_s
                optimal_s[key] = time_optimal_s(flow_s, pole) - longer_s
            command = None if cycle is None else cycle.commands[index]
            rows.append(
                MoveChoice(
                    step=move.step,
                    axis=move.axis,
                    distance_m=move.levels.wanted_m * (1.0 if move.forward else -1.0),
                    job_line=lines[move.operation],
                    how="none" if command is None else self._how(move, command)[1],
                    command_s=(scans if command is None else command.scans) * self._scan_s,
                    wait_s=0.0 if cycle is None else cycle.waits[index] * self._scan_s,
                    unshaped_s=scans * self._scan_s,
                    time_optimal_s=optimal_s[key],
                )
            )
        return tuple(rows)


def _best_states(states: list[_State], limits: Mapping[str, float]) -> list[_State]:
    """Return the states with the least cost; of states with equal ringing only one is kept."""
    seen: dict[tuple[int, ...], _State] = {}
    for state in sorted(states, key=lambda s: (s.cost, sum(map(abs, s.ringing.values())))):
        grid_cell: tuple[int, ...] = ()
        for axis, ringing in state.ringing.items():
            grid = _GRID * limits[axis] if np.isfinite(limits[axis]) else 1.0
            grid_cell += round(ringing.real / grid), round(ringing.imag / grid)
        seen.setdefault(grid_cell, state)
    return sorted(seen.values(), key=lambda s: s.cost)[:_BEAM]
