"""Elements with several force laws (limits, belts, play, friction), as modes with linear guards.

An element adds ``direction * (law . z)`` to the derivative of the state, where ``z = [states, held
inputs, 1]`` and the law depends on the mode of the element. A mode lasts while every guard ``low <=
row . z <= high`` is true; the first violated guard gives the next mode. A mode may also hold one
state constant (the velocity of a sticking body, a limited current). A guard of such a mode may
watch the force that would change the held state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray

INFINITE = np.inf
STAY = -1
"""Next mode for a bound that is infinite and so cannot be violated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guard:
    """The condition ``low <= row . z <= high``, and the modes after its violation.

    Parameters
    ----------
    row
        (variants, N). With None, the guard watches the net force on the state that the mode holds
        constant.
    low, high
        (variants,) bounds, or one number for all variants.
    low_to, high_to
        Next mode if the value is below ``low``, and if it is above ``high``.
    switch
        Index of the limit switch of this guard, -1 for none.
    """

    row: FloatArray | None
    low: FloatArray | float = -INFINITE
    high: FloatArray | float = INFINITE
    low_to: int = STAY
    high_to: int = STAY
    switch: int = -1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mode:
    """A force law of an element, and the guards that end it.

    Parameters
    ----------
    name
        Name of the mode, for display.
    law
        (variants, N): the element's force (or current) is ``law . z``.
    guards
        The mode lasts while all guards are true.
    holds
        Index of the state that is held constant, -1 for none.
    held_at
        (variants,) value of the held state, set at the beginning of the mode.
    net_scale
        (variants,) factor from the derivative of the held state to the force watched by guards.
    """

    name: str
    law: FloatArray
    guards: tuple[Guard, ...] = ()
    holds: int = -1
    held_at: FloatArray | float = 0.0
    net_scale: FloatArray | float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Element:
    """A force or current with several modes.

    Parameters
    ----------
    name
        Path of its part in the machine file, such as ``"links.belt"``.
    direction
        (variants, n): contribution of a unit force (or current) to the derivative of each state.
    modes
        Its modes; a simulation starts in the first one.
    working_mode
        Mode of the element in a linear model.
    """

    name: str
    direction: FloatArray
    modes: tuple[Mode, ...]
    working_mode: int = 0


def working_rates(base: FloatArray, elements: Sequence[Element]) -> FloatArray:
    """Return (variants, n, N) ``base`` with every element in its working mode.

    Constant parts of the laws are omitted: the rates hold for small motions about a working point.
    """
    rates = base.copy()
    for element in elements:
        law = element.modes[element.working_mode].law.copy()
        law[:, -1] = 0.0
        rates += element.direction[:, :, None] * law[:, None, :]
    return rates


def friction(
    name: str,
    direction: FloatArray,
    velocity: int,
    inertia: FloatArray,
    sliding: FloatArray,
    breakaway: FloatArray,
    size: int,
) -> Element:
    """Return Coulomb friction on a body; modes: sticking, sliding forwards, sliding backwards.

    Parameters
    ----------
    name, direction
        As in ``Element``.
    velocity
        Index of the body's velocity in the state.
    inertia, sliding, breakaway
        (variants,) inertia in kg or kg m^2; friction while sliding and at breakaway in N or N m.
    size
        Length N of ``z``.
    """
    no_force = np.zeros((len(inertia), size))
    forwards, backwards, speed = no_force.copy(), no_force.copy(), no_force.copy()
    forwards[:, -1], backwards[:, -1] = -sliding, sliding
    speed[:, velocity] = 1.0
    return Element(
        name=name,
        direction=direction,
        modes=(
            Mode(
                name="stick",
                law=no_force,
                guards=(Guard(row=None, low=-breakaway, high=breakaway, low_to=2, high_to=1),),
                holds=velocity,
                net_scale=inertia,
            ),
            Mode(name="forwards", law=forwards, guards=(Guard(row=speed, low=0.0, low_to=0),)),
            Mode(name="backwards", law=backwards, guards=(Guard(row=speed, high=0.0, high_to=0),)),
        ),
        working_mode=1,
    )


def belt(
    name: str, direction: FloatArray, spring: FloatArray, preload: FloatArray, first: FloatArray
) -> Element:
    """Return a preloaded belt of two runs; each run pulls only while it is tight.

    The force is ``max(0, P + a s) - max(0, P - (1 - a) s)``, where ``s`` is the force of the linear
    spring and damper. The force is continuous. When one run is slack, only the stiffness of the
    other run remains. Appendix C of the stitcher thesis calls the stiffnesses of the runs ``k1``
    (the short run) and ``k2`` (the long run).

    Parameters
    ----------
    name, direction
        As in ``Element``.
    spring
        (variants, N): the linear law ``k stretch + c stretch'`` of both runs.
    preload
        (variants,) tension P of each run at rest, N.
    first
        (variants,) share ``a`` of the stiffness of the run that a positive stretch tightens.
    """
    upper, lower = first[:, None] * spring, (1.0 - first)[:, None] * spring
    upper[:, -1] += preload
    lower[:, -1] -= preload
    slack, tight = -preload / first, preload / (1.0 - first)
    return Element(
        name=name,
        direction=direction,
        modes=(
            Mode(
                name="tight",
                law=spring,
                guards=(Guard(row=spring, low=slack, high=tight, low_to=2, high_to=1),),
            ),
            Mode(name="stretched", law=upper, guards=(Guard(row=spring, low=tight, low_to=0),)),
            Mode(name="slackened", law=lower, guards=(Guard(row=spring, high=slack, high_to=0),)),
        ),
    )


def play(
    name: str,
    direction: FloatArray,
    stretch: FloatArray,
    spring: FloatArray,
    stiffness: FloatArray,
    width: FloatArray,
    damped: bool,
) -> Element:
    """Return a spring and damper behind a dead band; the contact pushes but never pulls.

    The force of a damped contact falls to 0 while the spring is still compressed. The mode is
    ``separating`` from then until the stretch is within the band again.

    Parameters
    ----------
    name, direction
        As in ``Element``.
    stretch, spring
        (variants, N): rows of the stretch, and of the force that spring and damper would have
        without the band.
    stiffness, width
        (variants,) stiffness of the spring, and full width of the band.
    damped
        Whether any variant has damping.
    """
    half_width = 0.5 * width
    no_force = np.zeros_like(stretch)
    force_above, force_below = spring.copy(), spring.copy()
    force_above[:, -1] -= stiffness * half_width
    force_below[:, -1] += stiffness * half_width
    modes = [
        Mode(
            name="free",
            law=no_force,
            guards=(Guard(row=stretch, low=-half_width, high=half_width, low_to=2, high_to=1),),
        ),
        Mode(
            name="touching above",
            law=force_above,
            guards=(Guard(row=force_above, low=0.0, low_to=3 if damped else 0),),
        ),
        Mode(
            name="touching below",
            law=force_below,
            guards=(Guard(row=force_below, high=0.0, high_to=4 if damped else 0),),
        ),
    ]
    if damped:
        modes += [
            Mode(
                name="separating above",
                law=no_force,
                guards=(
                    Guard(row=stretch, low=half_width, low_to=0),
                    Guard(row=force_above, high=0.0, high_to=1),
                ),
            ),
            Mode(
                name="separating below",
                law=no_force,
                guards=(
                    Guard(row=stretch, high=-half_width, high_to=0),
                    Guard(row=force_below, low=0.0, low_to=2),
                ),
            ),
        ]
    return Element(name=name, direction=direction, modes=tuple(modes), working_mode=1)


def motor(
    name: str,
    direction: FloatArray,
    free: FloatArray,
    *,
    current_limit: FloatArray | None,
    voltage_modes: tuple[tuple[FloatArray, float], ...],
    state: int,
    net_scale: FloatArray,
    switches: tuple[Guard, ...],
) -> Element:
    """Return a motor's current: free, limited, or permanently cut off by a limit switch.

    Parameters
    ----------
    name, direction
        As in ``Element``.
    free
        (variants, N): the current without limits.
    current_limit
        (variants,) in A; None for no limit.
    voltage_modes
        For a current amplifier with a limited supply: the currents at the upper and lower limit of
        the supply voltage, each with its sign (+1, -1). Otherwise empty.
    state
        Index of the current in the state; -1 for a motor without inductance, or if the limit clips
        the amplifier's output and does not act on the state.
    net_scale
        (variants,) factor from the derivative of the current state to volts.
    switches
        Guards of the limit switches that cut the supply; this function sets their next modes.
    """
    no_current = np.zeros_like(free)
    limits = (1.0, -1.0) if current_limit is not None else ()
    cut_mode = 1 + len(limits) + len(voltage_modes)
    cut_guards = tuple(
        Guard(
            row=switch.row,
            low=switch.low,
            high=switch.high,
            low_to=cut_mode if np.any(np.isfinite(switch.low)) else STAY,
            high_to=cut_mode if np.any(np.isfinite(switch.high)) else STAY,
            switch=switch.switch,
        )
        for switch in switches
    )
    modes: list[Mode] = []
    if limits:
        assert current_limit is not None
        modes.append(
            Mode(
                name="free",
                law=free,
                guards=(
                    Guard(row=free, low=-current_limit, high=current_limit, low_to=2, high_to=1),
                    *cut_guards,
                ),
            )
        )
        for sign in limits:
            clipped = no_current.copy()
            clipped[:, -1] = sign * current_limit
            return_bound = {"low": 0.0, "low_to": 0} if sign > 0 else {"high": 0.0, "high_to": 0}
            if state >= 0:
                # The current stays at its limit until the voltage drives it back.
                guard = Guard(row=None, **return_bound)  # type: ignore[arg-type]
            else:
                excess = free.copy()
                excess[:, -1] -= sign * current_limit
                guard = Guard(row=excess, **return_bound)  # type: ignore[arg-type]
            modes.append(
                Mode(
                    name=f"limited {'+' if sign > 0 else '-'}",
                    law=free if state >= 0 else clipped,
                    guards=(guard, *cut_guards),
                    holds=state,
                    held_at=sign * current_limit,
                    net_scale=net_scale,
                )
            )
    elif voltage_modes:
        rows = [free - at_limit for at_limit, _ in voltage_modes]
        guards = (Guard(row=rows[0], high=0.0, high_to=1), Guard(row=rows[1], low=0.0, low_to=2))
        modes.append(Mode(name="free", law=free, guards=(*guards, *cut_guards)))
        for (at_limit, sign), row in zip(voltage_modes, rows, strict=True):
            return_guard = (
                Guard(row=row, low=0.0, low_to=0)
                if sign > 0
                else Guard(row=row, high=0.0, high_to=0)
            )
            modes.append(
                Mode(name="supply limit", law=at_limit, guards=(return_guard, *cut_guards))
            )
    else:
        modes.append(Mode(name="free", law=free, guards=cut_guards))
    if cut_guards:
        law = no_current if state < 0 else free
        modes.append(Mode(name="cut", law=law, holds=state))
    return Element(name=name, direction=direction, modes=tuple(modes))
