"""Analysis of axes without a control loop: cylinders, and position-commanded drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.dynamics.analysis import analyse_axis
from threadline.dynamics.eccentric import drive_rate, drive_unit, rigid_force, rigid_motion
from threadline.dynamics.linear_model import Oscillation, locked_modes
from threadline.dynamics.margins import DOUBLE, size_of, swinging
from threadline.dynamics.pneumatic import cylinder_equations, flow_mode
from threadline.dynamics.prescribed import piece_of, resonance_hz
from threadline.machine import Machine
from threadline.machine.model import check_dynamics


class Analysis(Protocol):
    """The analysis of an axis with or without a control loop."""

    @property
    def axis(self) -> str:
        """Name of the axis or cylinder."""

    @property
    def stable(self) -> bool:
        """Whether all its motions decay."""

    def verdict(self) -> str:
        """Return one sentence about its stability."""

    def as_json(self) -> dict[str, Any]:
        """Return the analysis as JSON content."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderAnalysis:
    """The analysis of a cylinder, which has no control loop but makes its frame vibrate.

    Parameters
    ----------
    axis
        Name of the cylinder.
    standing, sliding
        Modes of the connected bodies, slowest first: while the piston sticks in its housing, and
        while it slides, driven by the air.
    shaped
        Mode that the valves excite most, the design mode of shapers.
    speed_m_s
        Speed of the piston at level 1.
    growing
        Number of unstable poles while the piston slides.
    """

    axis: str
    standing: tuple[Oscillation, ...]
    sliding: tuple[Oscillation, ...]
    shaped: Oscillation
    speed_m_s: float
    growing: int

    @property
    def stable(self) -> bool:
        """Whether every motion decays."""
        return self.growing == 0

    def verdict(self) -> str:
        """Return one sentence with the vibration frequency of the frame."""
        return (
            f"axis {self.axis} has no loop: its valves set the speed of the piston; its frame "
            f"rings at {self.shaped.frequency_hz:.4g} Hz, damping ratio "
            f"{self.shaped.damping:.4g}" + ("" if self.stable else ", and a motion of it GROWS")
        )

    def as_json(self) -> dict[str, Any]:
        """Return the analysis as JSON content; figures that only a loop has are None."""
        return {
            "stable": self.stable,
            "bandwidth_hz": None,
            "gain_margin": None,
            "phase_margin_deg": None,
            "dc_gain": self.speed_m_s,
            "verdict": self.verdict(),
            "modes_hz": [m.frequency_hz for m in self.standing],
            "modes_damping": [m.damping for m in self.standing],
            "modes_free_hz": [m.frequency_hz for m in self.sliding],
            "modes_free_damping": [m.damping for m in self.sliding],
            "shaped_hz": self.shaped.frequency_hz,
            "shaped_damping": self.shaped.damping,
        }


def analyse_cylinder(machine: Machine, axis: str) -> CylinderAnalysis:
    """Return the analysis of one cylinder.

    Raises
    ------
    MachineError
        If its network has no vibration mode, or cannot be analysed.
    """
    cylinder, plant = machine.cylinders[axis], cylinder_equations(machine, axis)
    sliding = plant.sliding()[0]
    poles = np.linalg.eigvals(sliding)
    frequency_hz, damping = flow_mode(machine, axis)
    return CylinderAnalysis(
        axis=axis,
        standing=_oscillations(plant.standing()[0]),
        sliding=_oscillations(sliding),
        shaped=Oscillation(frequency_hz=frequency_hz, damping=damping),
        speed_m_s=cylinder.speed.si,
        growing=int(np.count_nonzero(poles.real > DOUBLE * size_of(sliding))),
    )


def _oscillations(matrix: FloatArray) -> tuple[Oscillation, ...]:
    poles = sorted(swinging(matrix), key=abs)
    return tuple(
        Oscillation(
            frequency_hz=float(abs(pole)) / (2.0 * np.pi), damping=float(-pole.real / abs(pole))
        )
        for pole in poles
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionDriveAnalysis:
    """The analysis of an axis with a position-commanded drive, whose load may vibrate.

    Parameters
    ----------
    axis, drive
        Names of the axis and of its drive.
    locked
        Modes of the load with a locked motor, slowest first.
    resonance_hz
        Resonance of a stepper without load about its step; None for a servo.
    torque, torque_at_speed
        Torque or force of the drive at standstill, and at the speed limit of the axis.
    needed
        Torque or force needed at the axis' limits of speed and acceleration, with rigid links.
    unit
        Unit of these three: N m, or N for a linear drive.
    """

    axis: str
    drive: str
    locked: tuple[Oscillation, ...]
    resonance_hz: float | None
    torque: float
    torque_at_speed: float
    needed: float
    unit: str

    @property
    def stable(self) -> bool:
        """True: without a control loop the axis cannot be unstable."""
        return True

    def verdict(self) -> str:
        """Return one sentence with the vibration frequency of the load and the needed torque."""
        ringing_text = (
            f"its load rings at {self.locked[0].frequency_hz:.4g} Hz" if self.locked else ""
        )
        resonance_text = (
            ""
            if self.resonance_hz is None
            else f"; the motor's step resonance is {self.resonance_hz:.4g} Hz"
        )
        return (
            f"axis {self.axis} has no loop: drives.{self.drive} takes positions, and "
            f"{ringing_text or 'its load does not ring'}{resonance_text}; at the axis' limits it "
            "needs "
            f"{self.needed:.4g} of {self.torque_at_speed:.4g} {self.unit}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the analysis as JSON content; figures that only a loop has are None."""
        return {
            "stable": True,
            "bandwidth_hz": None,
            "gain_margin": None,
            "phase_margin_deg": None,
            "dc_gain": None,
            "verdict": self.verdict(),
            "modes_hz": [m.frequency_hz for m in self.locked],
            "modes_damping": [m.damping for m in self.locked],
            "step_resonance_hz": self.resonance_hz,
            "torque": self.torque,
            "torque_at_speed_limit": self.torque_at_speed,
            "torque_needed": self.needed,
            "torque_unit": self.unit,
        }


def held_motor_modes(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis' load with its position-commanded drive at rest.

    Raises
    ------
    MachineError
        If its piece has a part that is not linear.
    """
    return _oscillations(piece_of(machine, axis).matrix)


def analyse_position_drive(machine: Machine, axis: str) -> PositionDriveAnalysis:
    """Return the analysis of an axis with a position-commanded drive.

    Raises
    ------
    MachineError
        If its piece has a part that is not linear.
    """
    piece, axis_part = piece_of(machine, axis), machine.axes[axis]
    source = machine.position_sources[axis_part.drive]
    drive_per_axis = abs(drive_rate(machine, axis, rigid_motion(machine, axis)))
    speeds = np.array([0.0, axis_part.velocity.si * drive_per_axis])
    torque_at_rest, torque_at_speed = source.most_torque(speeds).tolist()
    return PositionDriveAnalysis(
        axis=axis,
        drive=axis_part.drive,
        locked=held_motor_modes(machine, axis),
        resonance_hz=resonance_hz(
            source, float(piece.inertia[piece.drives.index(axis_part.drive)])
        ),
        torque=torque_at_rest,
        torque_at_speed=torque_at_speed,
        needed=rigid_force(machine, axis, axis_part.velocity.si, axis_part.acceleration.si)
        / drive_per_axis,
        unit=drive_unit(machine, axis),
    )


def modes_held(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis of ``machine`` with its drive locked, slowest first.

    Empty for a machine without dynamics.

    Raises
    ------
    MachineError
        If its equations are not linear.
    """
    if machine.without_dynamics:
        return ()
    if machine.axes[axis].drive:
        return held_motor_modes(machine, axis)
    return tuple(sorted(locked_modes(machine, axis), key=lambda mode: mode.frequency_hz))


ANALYSES: Mapping[str, Callable[[Machine, str], Analysis]] = {
    "linear": analyse_axis,
    "rotary": analyse_axis,
    "stepper": analyse_position_drive,
    "pulse-servo": analyse_position_drive,
    "stepped": analyse_position_drive,
    "cylinder": analyse_cylinder,
}
"""Analysis function for each kind in ``Machine.moving``."""


def analyse_moving(machine: Machine, name: str) -> Analysis:
    """Return the analysis of an axis or cylinder by its name.

    Raises
    ------
    MachineError
        If its equations cannot be analysed.
    OptionError
        If the machine file has no dynamics.
    """
    check_dynamics(f"the modes of axis {name} and the torque of its drive", machine)
    return ANALYSES[machine.moving[name]](machine, name)
