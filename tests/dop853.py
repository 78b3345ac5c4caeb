"""An independent integrator for many short spans: the compiled DOP853 of scipy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import ode

from threadline.base.arrays import FloatArray


def state_after(
    slope: Callable[[float, FloatArray], Sequence[float] | FloatArray],
    state: Sequence[float] | FloatArray,
    span_s: float,
    *,
    rtol: float,
    atol: float,
) -> FloatArray:
    """Return the (n,) state after ``span_s`` of ``state' = slope(t, state)``, t from 0.

    The method and tolerances are the same as of ``solve_ivp`` with DOP853, whose Python code takes
    several times as long per step as the right-hand side. This does not matter in long
    integrations, but if a span is a tick of a controller, it decides the time.
    """
    if span_s == 0.0:
        return np.array(state)
    solver = ode(slope).set_integrator("dop853", rtol=rtol, atol=atol, nsteps=100_000)
    after = solver.set_initial_value(state, 0.0).integrate(span_s)
    assert solver.successful(), solver.get_return_code()
    return np.array(after)
