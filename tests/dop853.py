"""An integrator that is not ours, for many short spans: the compiled DOP853 of scipy."""

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

    The method and tolerances are those of ``solve_ivp`` with DOP853, which works several times as
    long around each of its steps as the right-hand side takes: no matter for long integrations, all
    that counts where a span is a tick of a controller.
    """
    if span_s == 0.0:
        return np.array(state)
    solver = ode(slope).set_integrator("dop853", rtol=rtol, atol=atol, nsteps=100_000)
    after = solver.set_initial_value(state, 0.0).integrate(span_s)
    assert solver.successful(), solver.get_return_code()
    return np.array(after)
