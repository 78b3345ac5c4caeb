"""One cylinder of an on/off machine, step by step: exact between events, events located.

It slides, sticks, or stands at an end stop. In each state the equations are linear with constant
input, so that a step is one product with a matrix exponential; the instant at which a piston stops
is found by halving the step, and one that stands breaks away at the beginning of a step.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.plant.pneumatic import CylinderPlant, cylinder_plant

SLIDES, STICKS, AT_START, AT_END = 0, 1, 2, 3
_RAMP_STEPS = 8
_HALVINGS = 12
_STANDSTILL_M_S = 1e-3
_ADHESION_N = 1.0
"""A piston leaves its stop once more than this pulls at it; less would only make it flutter."""


@dataclass(slots=True)
class CylinderTwin:
    """A cylinder that is being simulated.

    Parameters
    ----------
    machine, axis
        What it is.
    step_s
        Length of a step.
    """

    machine: Machine
    axis: str
    step_s: float
    plant: CylinderPlant = field(init=False)
    state: FloatArray = field(init=False)
    mode: int = SLIDES
    sense: float = 0.0
    start_m: float = 0.0
    _steps: dict[tuple[object, ...], list[FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.plant = cylinder_plant(self.machine, self.axis)
        self.state = np.zeros(len(self.plant.states) + 2)
        # Behind the states: the level and a constant 1.
        self.state[-1] = 1.0
        if self._friction:
            self.mode = STICKS

    @property
    def _friction(self) -> float:
        part = self.machine.cylinders[self.axis].friction
        return 0.0 if part is None else part.si

    @property
    def _stiction(self) -> float:
        part = self.machine.cylinders[self.axis].stiction
        return self._friction if part is None else part.si

    @property
    def stroke_m(self) -> float:
        """Where the piston is."""
        return float(self.plant.stroke @ self.state[:-2])

    @property
    def frame_m(self) -> float:
        """Where the frame is."""
        return float(self.plant.frame @ self.state[:-2])

    def advance(self, level: float) -> None:
        """Go one step with ``level`` at the valves (delay already applied)."""
        self.state[-2] = level
        if self.mode != SLIDES and self._released(self.state[:-2]) != 0.0:
            # A standing piston breaks away at the beginning of a step, to within one step.
            self._change()
        key = self._key()
        ahead = self._transition(key, 0) @ self.state
        if self.mode != SLIDES or not self._ended(ahead):
            self.state = ahead
            return
        # Halves, quarters ... of the step that end before the event, and one last part more.
        left = 1 << _HALVINGS
        for halvings in range(1, _HALVINGS + 1):
            ahead = self._transition(key, halvings) @ self.state
            if not self._ended(ahead):
                self.state = ahead
                left -= 1 << (_HALVINGS - halvings)
        self.state = self._transition(key, _HALVINGS) @ self.state
        left -= 1
        self._change()
        # It stands for the rest of the step.
        key = self._key()
        for halvings in range(1, _HALVINGS + 1):
            if left & (1 << (_HALVINGS - halvings)):
                self.state = self._transition(key, halvings) @ self.state

    def _key(self) -> tuple[object, ...]:
        cylinder = self.machine.cylinders[self.axis]
        rate = float(self.plant.stroke_rate @ self.state[:-2])
        place = self.stroke_m
        if abs(rate) < _STANDSTILL_M_S or self.mode != SLIDES:
            self.start_m = place
        ramp = _RAMP_STEPS
        if cylinder.air_ramp is not None:
            gone = abs(place - self.start_m) / cylinder.air_ramp.si
            ramp = min(_RAMP_STEPS, 1 + int(gone * _RAMP_STEPS))
        cushioned = cylinder.cushion is not None and (
            (rate > 0 and place > cylinder.stroke.si - cylinder.cushion.length.si)
            or (rate < 0 and place < cylinder.cushion.length.si)
        )
        return self.mode, ramp, cushioned, self.sense if self.mode == SLIDES else 0.0

    def _air(self, ramp: int) -> FloatArray:
        """Return the row of the force of the air."""
        cylinder = self.machine.cylinders[self.axis]
        return self.plant.air_force(
            cylinder.air_stiffness.si, cylinder.air_damping.si * ramp / _RAMP_STEPS
        )

    def _matrix(self, key: tuple[object, ...]) -> FloatArray:
        mode, ramp, cushioned, sense = key
        assert isinstance(ramp, int) and isinstance(sense, float)
        n = len(self.plant.states)
        full = np.zeros((n + 2, n + 2))
        matrix = self.plant.matrix.copy()
        if mode == SLIDES:
            matrix += np.outer(self.plant.force, self._air(ramp))
            full[:n, -1] = -sense * self._friction * self.plant.force
        else:
            piston, housing, share = self._locked()
            together = share * matrix[piston] + (1.0 - share) * matrix[housing]
            matrix[piston] = matrix[housing] = together
        full[:n, :n] = matrix
        cushion = self.machine.cylinders[self.axis].cushion
        flow = cushion.flow.si if cushioned and cushion is not None else 1.0
        full[:n, -2] = flow * self.plant.level
        return full

    def _locked(self) -> tuple[int, int, float]:
        cylinder = self.machine.cylinders[self.axis]
        masses = [self.machine.bodies[b].inertia.si for b in (cylinder.pushes, cylinder.reacts_on)]
        piston = self.plant.states.index(f"{cylinder.pushes}'")
        housing = self.plant.states.index(f"{cylinder.reacts_on}'")
        return piston, housing, masses[0] / sum(masses)

    def _transition(self, key: tuple[object, ...], halvings: int) -> FloatArray:
        """Return what a step that was halved so often does to the state."""
        found = self._steps.get(key)
        if found is None:
            # The shortest part by series, the longer ones each the square of the one before.
            found = [np.asarray(expm(self._matrix(key) * (self.step_s * 0.5**_HALVINGS)))]
            for _ in range(_HALVINGS):
                found.append(found[-1] @ found[-1])
            found.reverse()
            self._steps[key] = found
        return found[halvings]

    def _ended(self, state: FloatArray) -> bool:
        """Say whether a sliding piston has come to a stop or turned."""
        x = state[:-2]
        rate = float(self.plant.stroke_rate @ x)
        place = float(self.plant.stroke @ x)
        stroke = self.machine.cylinders[self.axis].stroke.si
        at_stop = (place >= stroke and rate > 0) or (place <= 0.0 and rate < 0)
        return at_stop or (self.sense != 0.0 and rate * self.sense < 0.0)

    def _holding_n(self, x: FloatArray) -> float:
        """Return the force that would have to hold the piston still against the housing.

        At an end stop only that of the air counts: what the beam rings with, at 1.6 kHz, would
        lift the piston by less than a micrometre, a thousand times a second.
        """
        if self.mode in {AT_START, AT_END}:
            return float(-self._air(_RAMP_STEPS) @ x)
        piston, housing, share = self._locked()
        cylinder = self.machine.cylinders[self.axis]
        mass = self.machine.bodies[cylinder.pushes].inertia.si
        matrix = self.plant.matrix
        together = share * matrix[piston] + (1.0 - share) * matrix[housing]
        return float((mass * (together - matrix[piston]) - self._air(1)) @ x)

    def _released(self, x: FloatArray) -> float:
        """Return the sense in which a standing piston breaks away, 0 if it stands."""
        holding = self._holding_n(x)
        least = self._stiction
        if self.mode in {AT_START, AT_END}:
            least = max(least, _ADHESION_N)
        if holding < -least and self.mode != AT_END:
            return 1.0
        if holding > least and self.mode != AT_START:
            return -1.0
        return 0.0

    def _change(self) -> None:
        x = self.state[:-2]
        if self.mode != SLIDES:
            self.sense = self._released(x) if self._friction else 0.0
            self.mode = SLIDES
            return
        piston, housing, share = self._locked()
        # Standing: both go on with their common momentum.
        self.state[[piston, housing]] = share * x[piston] + (1.0 - share) * x[housing]
        place, stroke = self.stroke_m, self.machine.cylinders[self.axis].stroke.si
        if place >= stroke - 1e-9:
            self.mode = AT_END
        elif place <= 1e-9:
            self.mode = AT_START
        else:
            self.mode = STICKS
