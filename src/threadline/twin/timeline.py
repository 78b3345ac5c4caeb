"""Places the clocks and dead times of a machine on one exact grid of integers.

All clocks repeat after the hyperperiod, the least common multiple of their periods. Its instants
are exact fractions. A dead time that is not a multiple of a tick splits a step exactly at the
arrival of the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import groupby
from math import gcd, lcm
from operator import itemgetter

from threadline.base.arrays import IntArray, Locked, read_only_int
from threadline.dynamics.groups import Group
from threadline.dynamics.matrix_controller import loop_parts
from threadline.errors import MachineError
from threadline.files import common_period_s
from threadline.machine import Machine

TICK, CONTROL, ARRIVE = 0, 1, 2
"""Kinds of actions: TICK takes the next row and a sample, CONTROL runs a controller, ARRIVE applies
its delayed command."""

_MAX_ACTIONS = 200_000
_MAX_LENGTHS = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule(Locked):
    """One hyperperiod as a list of steps: actions first, then the advance to the next instant.

    Parameters
    ----------
    grid_s
        Period of the grid: every advance is a whole multiple of it.
    first_action
        (steps + 1,) int: step i has the actions from ``first_action[i]`` to
        ``first_action[i+1] - 1``.
    actions
        (actions, 2) int: TICK, CONTROL or ARRIVE; and the index of the controller in the group.
    length
        (steps,) int: index into ``lengths`` of the advance after the actions.
    lengths
        (k,) int: the different advances, in grid periods.
    in_flight
        (controllers,) int: number of commands of each that wait for their dead time to end.
    delayed
        Whether any command has a dead time.
    """

    grid_s: Fraction
    first_action: IntArray
    actions: IntArray
    length: IntArray
    lengths: IntArray
    in_flight: IntArray
    delayed: bool

    def __post_init__(self) -> None:
        for name, ndim in (
            ("first_action", 1),
            ("actions", 2),
            ("length", 1),
            ("lengths", 1),
            ("in_flight", 1),
        ):
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=ndim))


def make_schedule(machine: Machine, group: Group) -> Schedule:
    """Return the schedule of one connected piece of ``machine``.

    Raises
    ------
    MachineError
        If the clocks and dead times have no practical common grid.
    """
    tick = machine.tick_clock.period_s
    periods, delays = [], []
    for part in loop_parts(machine, group.controllers):
        periods.append(machine.clock(part.settings.clock).period_s)
        delay = machine.motors[part.settings.drive].delay
        exact = Fraction(0) if delay is None else delay.exact_s
        assert exact is not None
        delays.append(exact)
    return _schedule(tick, tuple(periods), tuple(delays))


@lru_cache(maxsize=8)
def _schedule(
    tick: Fraction, periods: tuple[Fraction, ...], delays: tuple[Fraction, ...]
) -> Schedule:
    """Return the schedule for these periods and dead times, s.

    It is cached: a search simulates machines with the same clocks thousands of times.
    """
    hyper = _least_common([tick, *periods])
    count = sum(int(hyper / p) for p in (tick, *periods, *periods))
    if count > _MAX_ACTIONS:
        raise MachineError(
            f"the clocks repeat only after {float(hyper):.6g} s, {count} actions, "
            f"limit {_MAX_ACTIONS}",
            remedy="Choose clock periods with a common multiple.",
        )
    # Instants are counted in the largest common divisor of all periods and dead times.
    finest = common_period_s([tick, *periods, *(delay_s for delay_s in delays if delay_s)])
    end = int(hyper / finest)
    happenings = [(at, TICK, 0) for at in range(0, end, int(tick / finest))]
    for index, (period, delay_s) in enumerate(zip(periods, delays, strict=True)):
        late = int(delay_s / finest)
        for at in range(0, end, int(period / finest)):
            happenings.append((at, CONTROL, index))
            happenings.append(((at + late) % end, ARRIVE, index))
    happenings.sort()
    instants = sorted({at for at, _, _ in happenings})
    advances = [b - a for a, b in zip(instants, [*instants[1:], end], strict=True)]
    grid = gcd(*advances)
    distinct = sorted({a // grid for a in advances})
    if len(distinct) > _MAX_LENGTHS:
        raise MachineError(
            f"clocks and dead times cut time into {len(distinct)} different lengths, "
            f"limit {_MAX_LENGTHS}",
            remedy="Choose clock periods and dead times with a coarser common grid.",
        )
    first, actions = [0], []
    for _, same_instant in groupby(happenings, key=itemgetter(0)):
        actions += [(what, index) for _, what, index in same_instant]
        first.append(len(actions))
    number = {length: k for k, length in enumerate(distinct)}
    return Schedule(
        grid_s=grid * finest,
        first_action=first,  # type: ignore[arg-type]
        actions=actions,  # type: ignore[arg-type]
        length=[number[a // grid] for a in advances],  # type: ignore[arg-type]
        lengths=distinct,  # type: ignore[arg-type]
        delayed=any(delays),
        in_flight=[int(d / p) for p, d in zip(periods, delays, strict=True)],  # type: ignore[arg-type]
    )


def _least_common(periods: list[Fraction]) -> Fraction:
    numerator = lcm(*(p.numerator for p in periods))
    denominator = gcd(*(p.denominator for p in periods))
    return Fraction(numerator, denominator)
