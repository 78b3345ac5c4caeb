"""copp-py on the paths of ``benchmarks.retiming``: its solvers, and nothing of ours.

Its stations are grid points of a spline, at which it holds the limits; between them nothing does.
The third order is solved as its README does it: linearised about the profile of the second order,
and again about its own result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from threadline.motion.timing.optimal.motion_limits import Limits


class Stations:
    """A spline and its limits at stations, as copp-py takes them."""

    def __init__(self, spline: CubicSpline, places: np.ndarray, limits: Limits) -> None:
        import copp_py

        self.copp, self.places, count = copp_py, places, len(places)
        self.robot: Any = copp_py.Robot(spline(0.0).shape[0], capacity=count)
        self.robot.append_s(places)
        derivatives = [np.ascontiguousarray(spline(places, order)) for order in range(4)]
        self.robot.set_q(*derivatives[:3], 0, dddq=derivatives[3])
        whole = {"start_idx_s": 0, "length": count}
        self.robot.add_velocity_limits(limits.velocity, -limits.velocity, **whole)
        self.robot.add_acceleration_limits(limits.acceleration, -limits.acceleration, **whole)
        if np.isfinite(limits.jerk).all():
            self.robot.add_jerk_limits(limits.jerk, -limits.jerk, **whole)

    def second_order(self) -> np.ndarray:
        """Return the (n,) squares of the speed along the stations, by its TOPP2-RA."""
        own = self.copp.solver.topp2_ra
        problem = own.Problem(
            self.robot.constraints,
            idx_s_interval=(0, len(self.places) - 1),
            a_boundary=(0.0, 0.0),
        )
        return np.asarray(own.solve(problem, own.Options()))

    def duration_s(self, squared: np.ndarray) -> float:
        """Return the time at even acceleration between the stations."""
        speed = np.sqrt(squared)
        return float((2.0 * np.diff(self.places) / (speed[1:] + speed[:-1])).sum())

    def third_order(self, how: str, iterations: int) -> list[float]:
        """Return the duration after each of ``iterations`` of ``topp3_lp`` or ``topp3_socp``."""
        own = getattr(self.copp.solver, how)
        about, bent, found = self.second_order(), None, []
        self.robot.constraints.amax_substitute(about, 0)
        options = own.Options(allow_almost_solved=True)
        for _ in range(iterations):
            problem = own.Problem(self.robot.constraints, about, b_linearization=bent)
            profile = own.solve(problem, options)
            about, bent = profile.a, profile.b
            found.append(float(self.copp.interpolation.s_to_t_topp3(self.places, profile)[0]))
        return found


def fitted(points: np.ndarray, tolerance: float) -> Callable[[], Any]:
    """Return a run of its fit of waypoints, which keeps ``tolerance`` along each axis."""
    import copp_py

    def fit() -> Any:
        return copp_py.Path.from_waypoints_fitting(
            points, tolerance=tolerance, max_segments=4 * len(points)
        )

    return fit
