"""How gently a mandrel can stop on its belt: a search over the shape of the deceleration.

    python -m tools.mandrel_stops

The mandrel of ``stepper-winder`` on its belt as one mode, apart from the simulated machine: the
motor stands at its step and at the error of its microsteps, which repeats every full step. A stop
is 20 decelerations of 12.5 ms within the limit of the axis. The search (differential evolution)
minimises how far the mandrel swings back, in the worst of six places of the full step.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.signal import cont2discrete, lfilter

from threadline.dynamics.without_loop import modes_held
from threadline.machine import load_machine
from threadline.machine.sources import Stepper

FloatArray = NDArray[np.float64]
DT_S = 2e-4
BINS, BIN_S = 20, 0.0125
_BEFORE_S, _AFTER_S, _SETTLED_S = 0.1, 0.15, 0.05
_OFF = (0.85, 0.95, 0.98, 1.0, 1.02, 1.05, 1.15)  # times the frequency of the mode


class Mandrel:
    """The mandrel on its belt; degrees."""

    def __init__(self) -> None:
        machine = load_machine("stepper-winder")
        axis, column = machine.axes["A"], machine.axis_names.index("A")
        source = machine.source_of("A")
        assert isinstance(source, Stepper) and source.microstep_error is not None
        assert axis.acceleration is not None
        self.mode = modes_held(machine, "A")[0]
        turns = source.counts / float(machine.counts_per_unit[column])  # of the axis, per motor's
        self.full_step = math.degrees(turns / source.full_steps.si)
        self.error = math.degrees(turns * source.microstep_error.si)
        self.braking = math.degrees(axis.acceleration.si)

    def swing(self, speed: FloatArray, places: Sequence[float], times: float = 1.0) -> float:
        """Return how far the mandrel swings back at most, deg.

        Parameters
        ----------
        speed
            (n,) deg/s every ``DT_S``, from full speed to the rest.
        places
            Places in a full step at which the stop begins, as shares of it.
        times
            Factor on the frequency of the mode.
        """
        full = float(speed[0])
        whole = np.concatenate(
            [np.full(round(_BEFORE_S / DT_S), full), speed, np.zeros(round(_AFTER_S / DT_S))]
        )
        even = full * DT_S * np.arange(len(whole))
        at = np.cumsum(whole) * DT_S + self.full_step * np.array(places)[:, None]
        motor = at + self.error * np.sin(2.0 * math.pi * at / self.full_step)
        load = lfilter(*self._filter(times), motor - even - motor[:, :1]) + even
        load = load[:, round(_SETTLED_S / DT_S) :]
        return float((np.maximum.accumulate(load, axis=1) - load).max())

    @cache  # noqa: B019 - one mandrel
    def _filter(self, times: float) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients of the mode at a factor on its frequency, in steps of time."""
        omega, damping = 2.0 * math.pi * times * self.mode.frequency_hz, self.mode.damping
        mode: Any = [2.0 * damping * omega, omega**2], [1.0, 2.0 * damping * omega, omega**2]
        numerator, denominator, _ = cont2discrete(mode, DT_S, method="foh")
        return numerator[0], denominator

    def stop(self, shares: FloatArray, full: float) -> FloatArray:
        """Return the speeds of a stop from ``full`` deg/s by shares of 20 decelerations."""
        rate = shares + 1e-9
        rate = np.minimum(rate * full / (rate.sum() * BIN_S), self.braking)
        for _ in range(5):
            room = self.braking - rate
            rate += room * (full - rate.sum() * BIN_S) / (BIN_S * room.sum())
        at = (np.arange(round(BINS * BIN_S / DT_S)) + 0.5) * DT_S
        rates = np.interp(at, (np.arange(BINS) + 0.5) * BIN_S, rate)
        rates *= full / (rates.sum() * DT_S)
        return np.asarray(full - np.cumsum(rates) * DT_S)


def half_cosine(full: float, lasts_s: float) -> FloatArray:
    """Return the speeds of the stop that windings are planned with."""
    return np.asarray(0.5 * full * (1.0 + np.cos(np.linspace(0.0, math.pi, round(lasts_s / DT_S)))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=float, default=305.0, help="of the mandrel, deg/s")
    parser.add_argument("--rounds", type=int, default=400, help="of the search")
    options = parser.parse_args()
    mandrel, full = Mandrel(), options.speed
    six, many = [k / 6 for k in range(6)], [k / 24 for k in range(24)]
    mode = mandrel.mode
    print(f"the mandrel rings at {mode.frequency_hz:.2f} Hz, damped {mode.damping:.1%}")

    def outcomes(name: str, speed: FloatArray) -> None:
        swings = [mandrel.swing(speed, many, times) for times in _OFF]
        print(
            f"{name}: "
            + ", ".join(
                f"{100 * t - 100:+.0f} %: {s:.3f} deg" for t, s in zip(_OFF, swings, strict=True)
            )
        )

    outcomes("half cosine within 0.5 s, at frequencies off by", half_cosine(full, 0.5))

    def worst(shares: FloatArray) -> float:
        return mandrel.swing(mandrel.stop(shares, full), six)

    bounds: Any = [(0.0, 1.0)] * BINS
    found: Any = differential_evolution(
        worst, bounds, maxiter=options.rounds, popsize=6, rng=1, tol=1e-9
    )
    outcomes("the best stop that was found", mandrel.stop(found.x, full))


if __name__ == "__main__":
    main()
