"""Spool, brake and spring arm in scipy: DOP853 with events, written from docs/winding.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Numbers:
    """The numbers of a spool, in SI."""

    radius: float
    inertia: float
    torque: float
    stiction: float
    stiffness: float
    damping: float
    mass: float
    spring: float
    damper: float
    preload: float
    travel: float
    release: float


class Reference:
    """The spool as a hybrid system; each of its modes is integrated up to the next event."""

    def __init__(self, n: Numbers, speed: Callable[[float], float]) -> None:
        self.n, self.speed, self.time_s = n, speed, 0.0
        # Held and taut: the arm balances the brake.
        most = n.torque + n.release * n.travel / 2
        y = (2 * most / n.radius - n.preload) / (n.spring + 2 * n.release / n.radius)
        self.stop = "low" if y <= 0 else "high" if y >= n.travel else ""
        y = min(max(y, 0.0), n.travel)
        tension = (most - n.release * y) / n.radius
        self.x = np.array([tension / n.stiffness, 0.0, y, 0.0])  # fibre, spool, arm, its speed
        self.held, self.taut = True, True
        self.changes = 0

    def brake(self, y: float) -> float:
        n = self.n
        return max(n.torque - n.release * (y - n.travel / 2), 0.0)

    def pull(self, t: float, x: np.ndarray) -> float:
        n = self.n
        if not self.taut:
            return 0.0
        arm = x[3] if self.stop == "" else 0.0
        rate = self.speed(t) - n.radius * x[1] - 2 * arm
        return max(n.stiffness * x[0] + n.damping * rate, 0.0)

    def slope(self, t: float, x: np.ndarray) -> list[float]:
        n, pull = self.n, self.pull(t, x)
        arm = x[3] if self.stop == "" else 0.0
        turning = 0.0 if self.held else (pull * n.radius - self.brake(x[2])) / n.inertia
        force = 2 * pull - n.preload - n.spring * x[2] - n.damper * arm
        return [
            self.speed(t) - n.radius * x[1] - 2 * arm,
            turning,
            arm,
            force / n.mass if self.stop == "" else 0.0,
        ]

    def events(self) -> list[tuple[str, Callable[[float, np.ndarray], float]]]:
        """Return events: each function becomes positive at its event."""
        n = self.n
        found: list[tuple[str, Callable[[float, np.ndarray], float]]] = []
        if self.held:
            share = n.stiction / n.torque
            found.append(
                ("breaks", lambda t, x: self.pull(t, x) * n.radius - share * self.brake(x[2]))
            )
        else:
            found.append(("sticks", lambda t, x: -x[1]))
        if self.stop == "":
            found += [("low", lambda t, x: -x[2]), ("high", lambda t, x: x[2] - n.travel)]
        elif self.stop == "low":
            found.append(("leaves", lambda t, x: 2 * self.pull(t, x) - n.preload))
        else:
            most = n.preload + n.spring * n.travel
            found.append(("leaves", lambda t, x: most - 2 * self.pull(t, x)))
        found.append(("fibre", (lambda t, x: -x[0]) if self.taut else (lambda t, x: x[0])))
        return found

    def advance(self, at_s: np.ndarray) -> np.ndarray:
        """Return the tension at increasing instants; the speed has no kink before the last one."""
        found = np.full(len(at_s), np.nan)
        until_s = float(at_s[-1])
        while self.time_s < until_s - 1e-13:
            named = self.events()
            hit = next((name for name, f in named if f(self.time_s, self.x) > 0.0), None)
            if hit is None:
                for _, function in named:
                    function.__dict__.update(terminal=True, direction=1.0)
                ran = solve_ivp(
                    self.slope, (self.time_s, until_s), self.x, method="DOP853", rtol=1e-10,
                    atol=1e-13, max_step=2e-3, dense_output=True,
                    events=[function for _, function in named],
                )  # fmt: skip
                assert ran.success, ran.message
                end_s = float(ran.t[-1])
                for k in np.flatnonzero((at_s > self.time_s) & (at_s <= end_s)):
                    found[k] = self.pull(float(at_s[k]), ran.sol(at_s[k]))
                self.time_s, self.x = end_s, ran.y[:, -1].copy()
                if ran.status != 1:
                    break
                hit = next(
                    name for (name, _), at in zip(named, ran.t_events, strict=True) if len(at)
                )
            self.change(hit)
        return found

    def change(self, event: str) -> None:
        self.changes += 1
        if event in ("breaks", "sticks"):
            self.held, self.x[1] = event == "sticks", 0.0
        elif event == "fibre":
            self.taut, self.x[0] = not self.taut, 0.0
        elif event == "leaves":
            self.stop, self.x[3] = "", 0.0
        else:
            self.stop, self.x[2], self.x[3] = event, 0.0 if event == "low" else self.n.travel, 0.0
