"""Evaluation of many candidates at once; lead filters come from exact frequency responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.option_defaults import FEED_FORWARD
from threadline.base.workers import Done, answers
from threadline.dynamics.elements import working_rates
from threadline.dynamics.lead import lead_deg, lead_from_response
from threadline.dynamics.network import PiecewiseLinear, piecewise_linear
from threadline.dynamics.values import Values
from threadline.errors import MachineError, PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.controllers import COEFFICIENT_HIGH, COEFFICIENT_LOW
from threadline.machine.numbers import with_numbers
from threadline.proof.option_words import parse_width_s
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, plan_job
from threadline.search.design_judge import HOPELESS, DesignJudge, OtherRuns, Ratios, design_judge
from threadline.search.design_single_proofs import (
    NO_COMMANDS,
    SingleItem,
    SingleProofs,
    Used,
    bits_of_used,
)
from threadline.search.design_space import Space
from threadline.verdict import Spec

_ROUNDING = 1e-9
_TERMS = 14  # terms of the series, for norms up to a half: 0.5^15 / 15! is below rounding


def design_gains(
    space: Space, points: FloatArray
) -> tuple[dict[str, FloatArray], NDArray[np.bool_]]:
    """Return the lead filters of candidates, and which candidates have one.

    Parameters
    ----------
    points
        (n, dims): the last two coordinates are the wanted crossover and phase margin.

    Returns
    -------
    tuple
        Path of each controller number to its (n,) values, and an (n,) mask, False where a filter
        cannot give enough lead. A loop with enough phase without lead keeps its phase: the zero
        stays as far out as the chip allows.

    Raises
    ------
    MachineError
        If several controllers share bodies.
    """
    machine, count = space.machine, len(points)
    crossover_hz, margin_deg = np.exp(points[:, -2]), points[:, -1]
    omega_rad_s = 2.0 * np.pi * crossover_hz
    values = Values.of(machine, space.numbers(points))
    numbers: dict[str, FloatArray] = {}
    possible: NDArray[np.bool_] = np.ones(count, dtype=np.bool_)
    for piece in piecewise_linear(machine, values):
        if not piece.group.axes:
            continue
        if len(piece.group.controllers) != 1:
            raise MachineError(
                f"the controllers {', '.join(piece.group.controllers)} share bodies",
                place=machine.place,
                remedy="Take crossover and phase_margin out of [design.settings]; give gains.",
            )
        name = piece.group.controllers[0]
        controller = machine.controllers[name]
        period_s = float(machine.clock(controller.clock).period_s)
        response = sampled_response(piece, values, omega_rad_s, period_s)
        gain, zero = lead_from_response(response, omega_rad_s, margin_deg, period_s)
        # The phase is enough without lead: the zero goes as far out as the chip allows.
        beyond_need = ~(zero <= COEFFICIENT_HIGH) & (lead_deg(response, margin_deg) <= 0.0)
        zero = np.where(beyond_need | (zero < COEFFICIENT_LOW), COEFFICIENT_LOW, zero)
        z = np.exp(1j * omega_rad_s * period_s)
        gain = np.abs(z + COEFFICIENT_LOW) / (np.abs(z - zero) * np.abs(response))
        possible &= (zero <= COEFFICIENT_HIGH) & np.isfinite(gain)
        usable_zero = np.where(possible, zero, COEFFICIENT_LOW)
        numbers[f"controllers.{name}.gain"] = np.where(
            possible, gain / controller.dac.volt_per_level, 0.0
        )
        numbers[f"controllers.{name}.zero"] = usable_zero
        numbers[f"controllers.{name}.pole"] = np.full(count, COEFFICIENT_LOW)
    return numbers, possible


def sampled_response(
    piece: PiecewiseLinear, values: Values, omega_rad_s: FloatArray, period_s: float
) -> ComplexArray:
    """Return (n,) the response of each variant of a piece at its own frequency, counts per volt.

    Equals ``SampledPlant.response`` of each variant: a held output behind a dead time of
    ``d T + f`` delivers the older value for ``f`` of each tick and the newer value for the rest.

    Parameters
    ----------
    piece
        A piece with one controller.
    omega_rad_s
        (n,) one frequency for each variant.
    """
    machine, n = values.machine, len(piece.states)
    rates = working_rates(piece.base, piece.elements)
    count = len(rates)
    drive = piece.group.drives[0]
    delay_s = np.broadcast_to(
        values.at(f"drives.{drive}.delay", machine.motors[drive].delay), (count,)
    )
    whole_periods = np.floor(delay_s / period_s + _ROUNDING)
    part_s = np.maximum(delay_s - whole_periods * period_s, 0.0)
    block = np.zeros((count, n + 1, n + 1))
    block[:, :n, :n] = rates[:, :, :n]
    block[:, :n, n] = rates[:, :, n] * piece.input_gain[:, :1]
    first_part = _exponentials(block * part_s[:, None, None])
    second_part = _exponentials(block * (period_s - part_s)[:, None, None])
    transition = second_part[:, :n, :n] @ first_part[:, :n, :n]
    older_input = (second_part[:, :n, :n] @ first_part[:, :n, n:])[:, :, 0]
    z = np.exp(1j * omega_rad_s * period_s)
    input_vector = (second_part[:, :n, n] + older_input / z[:, None]) * (z**-whole_periods)[:, None]
    state = np.linalg.solve(z[:, None, None] * np.eye(n) - transition, input_vector[:, :, None])[
        :, :, 0
    ]
    sensor_index = piece.group.sensors.index(machine.controller_of(piece.group.axes[0]).sensor)
    return np.asarray((piece.sensor_rows[:, sensor_index, :n] * state).sum(axis=1))


def _exponentials(matrices: FloatArray) -> FloatArray:
    """Return the exponentials of (n, m, m) matrices: halved until small, summed, squared back.

    All matrices are handled at once. scipy's function handles one at a time, through a threaded
    library in which thousands of small matrices wait for each other.
    """
    norm = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halvings = max(int(np.ceil(np.log2(max(norm, 0.5)))) + 1, 0)
    small = matrices / 2.0**halvings
    unit = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    total = unit.copy()
    for k in range(_TERMS, 0, -1):
        total = unit + small @ total / k
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """Effort of a search.

    Parameters
    ----------
    sample_log2, settings_log2
        Number of candidates of the first sample at each level, and of settings alone, as powers of
        2.
    proposals, rounds
        Proposals per round, and rounds, of the search for the least change.
    trade_rounds
        Rounds of the search for the least change with more margin.
    side
        Side of the region's grid; 0 for no region.
    modelled
        Whether each round of the search for the least change also tries the cheapest candidates by
        planes fitted to the ratio. This pays if a candidate takes long.
    """

    sample_log2: int = 8
    settings_log2: int = 5
    proposals: int = 192
    rounds: int = 24
    trade_rounds: int = 5
    side: int = 13
    modelled: bool = False


THOROUGH = Effort()
FEW = Effort(sample_log2=4, proposals=10, rounds=8, trade_rounds=0, side=0)
"""Effort for candidates that are proved one by one: each takes a second or two."""
AHEAD = Effort(
    sample_log2=5,
    settings_log2=2,
    proposals=12,
    rounds=14,
    trade_rounds=0,
    side=0,
    modelled=True,
)
"""Effort for candidates with commands of their own, through their own inverse."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """Candidates that were simulated, n of them.

    Parameters
    ----------
    points
        (n, dims) as in the space.
    level
        (n,) index of the share of the acceleration.
    ratio
        (n,) worst ratio of measured to limit, at the best needle delay. It includes other runs and
        machines if they are wanted and the first run is in spec. At most 1 is in spec.
    nominal
        (n,) the ratio of the first run.
    delay
        (n,) index of the best needle delay.
    binding
        (n,) criterion that uses the largest share of its limit.
    """

    points: FloatArray
    level: IntArray
    ratio: FloatArray
    nominal: FloatArray
    delay: IntArray
    binding: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ratio)

    def taken(self, index: IntArray) -> Tried:
        """Return the candidates at ``index``."""
        return Tried(
            points=self.points[index],
            level=self.level[index],
            ratio=self.ratio[index],
            nominal=self.nominal[index],
            delay=self.delay[index],
            binding=tuple(self.binding[i] for i in index.tolist()),
        )

    def join(self, other: Tried) -> Tried:
        """Return the candidates of both, these first."""
        return Tried(
            points=np.concatenate([self.points, other.points]),
            level=np.concatenate([self.level, other.level]),
            ratio=np.concatenate([self.ratio, other.ratio]),
            nominal=np.concatenate([self.nominal, other.nominal]),
            delay=np.concatenate([self.delay, other.delay]),
            binding=(*self.binding, *other.binding),
        )


class Evaluator:
    """Plans a job once for each share of the acceleration, then judges candidates in batches.

    Machines that cannot be simulated in batches are planned for and proved one by one.

    Parameters
    ----------
    space
        The parameters and settings that may be changed.
    read
        Reads the job for a given machine.
    spec, options
        Specification and planning options of the job.
    others
        Other runs and machines that a candidate must hold in; None for no others.
    """

    def __init__(
        self,
        space: Space,
        read: Callable[[Machine], Job],
        spec: Spec,
        options: Options,
        others: OtherRuns | None = None,
        effort: Effort = THOROUGH,
    ) -> None:
        self.space, self.effort = space, effort
        self.others = others or OtherRuns.of(space, NOMINAL)
        self.read, self._spec, self._options = read, spec, options
        self.simulated = 0
        self.judges: tuple[DesignJudge, ...] = ()
        self._single_proofs: SingleProofs | None = None
        if space.ahead:
            return
        if space.serial:
            plan_job(read(space.machine), space.machine, options)  # may refuse the machine
            self._single_proofs = SingleProofs(
                space.machine, read, spec, options, self.others.repeats
            )
            return
        judges = []
        for share in space.levels:
            # The seam reader uses the machine's acceleration, so the job is read again.
            machine = with_numbers(space.machine, space.slower(share))
            plan = plan_job(read(machine), machine, options)
            judges.append(design_judge(plan, machine, spec, space.delays_s))
        self.judges = tuple(judges)

    def delay_s(self, level: int, delay: int) -> float | None:
        """Return a needle delay; None where the job has no stitches."""
        if self._single_proofs is not None:
            return None
        if self.space.ahead:
            return float(self.space.delays_s[delay])
        delays = self.judges[level].delays_s
        return float(delays[delay]) if len(delays) else None

    def tried(self, points: FloatArray, level: IntArray, *, beyond: float = 1.0) -> Tried:
        """Simulate and judge candidates.

        Parameters
        ----------
        points, level
            (n, dims) points and (n,) levels.
        beyond
            Other runs and machines are tried for candidates with a nominal ratio of at most this.
        """
        if self.space.ahead:
            return self._ahead(points, level, beyond)
        if self._single_proofs is not None:
            return self._one_by_one(self._single_proofs, points, level, beyond)
        order = np.argsort(level, kind="stable")
        parts = [
            self._at_level(points[order][level[order] == k], k, beyond)
            for k in np.unique(level).tolist()
        ]
        joined = parts[0]
        for part in parts[1:]:
            joined = joined.join(part)
        original_order = np.argsort(order, kind="stable")
        return joined.taken(original_order)

    def gains(self, points: FloatArray) -> tuple[dict[str, FloatArray], np.ndarray]:
        """Return the filters of candidates, and which candidates have one."""
        if not self.space.designs_gains:
            return {}, np.ones(len(points), dtype=np.bool_)
        return design_gains(self.space, points)

    def options_at(self, point: FloatArray) -> Options:
        """Return the planning options at a (dims,) point, for a machine with its numbers."""
        width_s = self.space.smoothing_s(point)
        if width_s is None:
            return self._options
        if self._options.robust_share is None:
            return replace(self._options, feed_forward_s=width_s)
        # In a robust plan the smoothing width is the time in which the speed may change.
        return replace(self._options, feed_forward_s=parse_width_s(FEED_FORWARD), change_s=width_s)

    def _one_by_one(
        self, proofs: SingleProofs, points: FloatArray, level: IntArray, beyond: float
    ) -> Tried:
        """Prove every candidate by itself."""
        items = []
        for point, level_index in zip(points, level.tolist(), strict=True):
            numbers = {k: float(v[0]) for k, v in self.space.numbers(point[None]).items()}
            numbers |= self.space.slower(self.space.levels[level_index])
            items.append(SingleItem(numbers=numbers, beyond=beyond))
        return self._tried_apart(points, level, list(answers(proofs, items)))

    def _ahead(self, points: FloatArray, level: IntArray, beyond: float) -> Tried:
        """Plan every candidate through its own inverse, then judge the plan."""
        items = [(point, int(level[k]), beyond) for k, point in enumerate(points)]
        return self._tried_apart(points, level, list(answers(_Ahead(self), items)))

    def _tried_apart(self, points: FloatArray, level: IntArray, results: Sequence[Used]) -> Tried:
        self.simulated += sum(one.simulated for one in results)
        return Tried(
            points=points,
            level=np.asarray(level, dtype=np.int64),
            ratio=np.array([one.worst for one in results]),
            nominal=np.array([one.first for one in results]),
            delay=np.zeros(len(points), dtype=np.int64),
            binding=tuple(one.binding for one in results),
        )

    def one_ahead(self, point: FloatArray, level: int, beyond: float) -> Used:
        """Return the used share of a (dims,) candidate's limits, with commands of its own."""
        numbers = {k: float(v[0]) for k, v in self.space.numbers(point[None]).items()}
        slower_limits = self.space.slower(self.space.share(point, level))
        machine = with_numbers(self.space.machine, numbers | slower_limits)
        try:
            plan = plan_job(self.read(machine), machine, self.options_at(point))
            judge = design_judge(plan, machine, self._spec, self.space.delays_s)
        except (PlanError, MachineError):
            return Used(first=HOPELESS, worst=HOPELESS, binding=NO_COMMANDS, simulated=0)
        arrays = {k: np.array([v]) for k, v in numbers.items()}
        first_ratios, worst_ratios, simulated = self._judged(judge, point[None], arrays, beyond)
        return Used(
            first=float(first_ratios.best()[0][0]),
            worst=float(worst_ratios.best()[0][0]),
            binding=worst_ratios.binding(0),
            simulated=simulated,
        )

    def _at_level(self, points: FloatArray, level: int, beyond: float) -> Tried:
        judge, count = self.judges[level], len(points)
        gains, possible = self.gains(points)
        ratio = np.full(count, HOPELESS)
        nominal = ratio.copy()
        delay = np.zeros(count, dtype=np.int64)
        binding = ["phase margin"] * count
        possible_indices = np.flatnonzero(possible)
        if len(possible_indices):
            numbers = self.space.numbers(points[possible_indices]) | {
                k: v[possible_indices] for k, v in gains.items()
            }
            first_ratios, worst_ratios, simulated = self._judged(
                judge, points[possible_indices], numbers, beyond
            )
            self.simulated += simulated
            nominal[possible_indices] = first_ratios.best()[0]
            ratio[possible_indices], delay[possible_indices] = worst_ratios.best()
            for i, k in enumerate(possible_indices.tolist()):
                binding[k] = worst_ratios.binding(i)
        return Tried(
            points=points,
            level=np.full(count, level, dtype=np.int64),
            ratio=ratio,
            nominal=nominal,
            delay=delay,
            binding=tuple(binding),
        )

    def _judged(
        self,
        judge: DesignJudge,
        points: FloatArray,
        numbers: Mapping[str, FloatArray],
        beyond: float,
    ) -> tuple[Ratios, Ratios, int]:
        """Return the used limits of (n, dims) candidates in the first run, and at worst.

        The number of simulated machines follows.
        """
        first = judge.ratios(numbers)
        worst, simulated = self.others.worst(judge, points, numbers, first, beyond)
        return first, worst, len(points) + simulated


@dataclass(frozen=True, slots=True, eq=False)
class _Ahead:
    """Judges candidates that have commands of their own, through their own inverse."""

    evaluator: Evaluator

    def answer(self, item: tuple[FloatArray, int, float], _done: Done | None = None) -> Used:
        """Return the used share of a candidate's limits."""
        return self.evaluator.one_ahead(*item)

    def machines(self, _item: tuple[FloatArray, int, float]) -> int:
        """Return 1: candidates are judged one by one."""
        return 1

    def known(self) -> bytes:
        """Return the bits of the result of the machine as its file says, at its least settings."""
        space = self.evaluator.space
        point = np.clip(np.zeros(len(space.low)), space.low, space.high)
        return bits_of_used(self.evaluator.one_ahead(point, 0, -1.0))
