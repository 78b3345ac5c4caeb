"""Linear models of the connected pieces of the network, and their natural frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics import elements as el
from threadline.dynamics.groups import Group, connected_groups
from threadline.dynamics.network import PiecewiseLinear, piecewise_linear
from threadline.dynamics.sampled import StateSpace
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import StateSpaceController


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelVariants:
    """The linear models of one connected piece, for every variant of its numbers, SI throughout.

    Parameters
    ----------
    A, B, C
        (variants, n, n), (variants, n, inputs) and (variants, outputs, n).
    delay_s
        (variants, inputs) dead time of each input, s.
    states, inputs, outputs
        Names, in the order of the rows and columns.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    delay_s: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def one(self, variant: int) -> StateSpace:
        """Return the model of one variant."""
        return StateSpace(
            A=self.A[variant],
            B=self.B[variant],
            C=self.C[variant],
            D=np.zeros((len(self.outputs), len(self.inputs))),
            delay_s=self.delay_s[variant],
            states=self.states,
            inputs=self.inputs,
            outputs=self.outputs,
        )

    def response(self, drive: str, output: str, omega_rad_s: FloatArray) -> ComplexArray:
        """Return the (variants, k) response from one input to one output, dead time exact.

        Parameters
        ----------
        drive, output
            Names of the input and the output.
        omega_rad_s
            (k,) frequencies; none may be a pole on the imaginary axis.

        Raises
        ------
        ValueError
            If there is no such input or output.
        """
        column, row = self.inputs.index(drive), self.outputs.index(output)
        s = 1j * np.asarray(omega_rad_s, dtype=np.float64)
        resolvent = s[:, None, None] * np.eye(len(self.states)) - self.A[:, None]
        force = np.broadcast_to(self.B[:, None, :, column, None], (*resolvent.shape[:3], 1))
        state = np.linalg.solve(resolvent, force)[..., 0]
        value = np.einsum("vn,vkn->vk", self.C[:, row], state)
        return np.asarray(value * np.exp(-s * self.delay_s[:, column, None]), dtype=np.complex128)


def linear_variants(
    machine: Machine, values: Values | None = None, *, drive: str = ""
) -> tuple[ModelVariants, ...]:
    """Return the linear models of every connected piece of the network, all variants at once.

    Inputs, outputs and omissions are the same as in ``linear_model``.

    Parameters
    ----------
    drive
        Only the piece with this motor; empty for all pieces.

    Raises
    ------
    MachineError
        If a combination of parts has no equations.
    """
    given_values = Values.of(machine) if values is None else values
    # A piece with position-commanded drives has no input in volts: see ``prescribed``.
    return tuple(
        _linear(machine, piece, given_values)
        for piece in piecewise_linear(machine, given_values, drive=drive)
        if not piece.group.sources
    )


def linear_model(machine: Machine, values: Values | None = None) -> tuple[StateSpace, ...]:
    """Return the linear model of every connected piece of the network, of the first variant.

    The model holds for small motions about a working point: limits and friction are omitted, play
    is closed and a preloaded belt is tight. Inputs are the drives, ``"drives.x"``, in volts of the
    controller. Outputs are ``"sensors.x"`` in counts, V or m/s^2 and, for each axis,
    ``"X.measured"``, ``"X.load"`` and ``"X.frame"`` in m or rad. An accelerometer on which a motor
    has a direct effect (feedthrough) has no output. ``delay_s`` has the dead time of each drive.

    Raises
    ------
    MachineError
        If a combination of parts has no equations.
    """
    return tuple(variants.one(0) for variants in linear_variants(machine, values))


def _linear(machine: Machine, piece: PiecewiseLinear, values: Values) -> ModelVariants:
    group, n = piece.group, len(piece.states)
    rates = el.working_rates(piece.base, piece.elements)
    rows, names = [], []
    B = rates[:, :, n : n + len(group.drives)] * piece.input_gain[:, None, :]
    for index, sensor in enumerate(group.sensors):
        felt_row = piece.felt_rows[:, index, None, :]
        if (felt_row @ B).any():
            _refuse_direct_reading(machine, sensor)
            continue
        rows.append(piece.sensor_rows[:, index, :n] + (felt_row @ rates[:, :, :n])[:, 0])
        names.append(f"sensors.{sensor}")
    for index, axis in enumerate(group.axes):
        sensor = machine.controller_of(axis).sensor
        counts = piece.sensor_rows[:, group.sensors.index(sensor), :n]
        rows += [counts / machine.axes[axis].counts.si, piece.load_rows[:, index, :n]]
        names += [f"{axis}.measured", f"{axis}.load"]
        if piece.has_frame[index]:
            rows.append(piece.frame_rows[:, index, :n])
            names.append(f"{axis}.frame")
    if not rows:
        raise MachineError(
            f"bodies.{group.bodies[0]}: no drive, sensor or axis is connected with it",
            remedy="Remove it, or connect it by a link.",
        )
    delays = np.zeros((piece.variants, len(group.drives)))
    for index, drive in enumerate(group.drives):
        delays[:, index] = values.at(f"drives.{drive}.delay", machine.motors[drive].delay)
    return ModelVariants(
        A=rates[:, :, :n],
        B=B,
        C=np.stack(rows, axis=1),
        delay_s=delays,
        states=piece.states,
        inputs=tuple(f"drives.{d}" for d in group.drives),
        outputs=tuple(names),
    )


def _refuse_direct_reading(machine: Machine, sensor: str) -> None:
    """Refuse a controller that reads an accelerometer on which a motor has a direct effect."""
    for name, controller in machine.controllers.items():
        if isinstance(controller, StateSpaceController) and sensor in controller.sensors:
            raise MachineError(
                f"controllers.{name} reads sensors.{sensor}, whose body a motor accelerates at "
                "once: a linear model of that loop has no states for it",
                place=machine.place,
                remedy="Put the accelerometer on a body behind a link, or give the motor an "
                "inductance.",
            )


_RIGID = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Oscillation:
    """A natural mode.

    Parameters
    ----------
    frequency_hz
        Undamped natural frequency.
    damping
        Damping ratio of the mode's pole pair; 1 if its poles are real.
    """

    frequency_hz: float
    damping: float


def locked_modes(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis' network piece with locked motors."""
    group, model = _piece(machine, axis)
    locked_bodies = {b for d in group.drives for b in machine.motors[d].acts_on}
    return _modes(model, [b for b in group.bodies if b not in locked_bodies])


def free_modes(machine: Machine, axis: str) -> tuple[Oscillation, ...]:
    """Return the modes of an axis' network piece with free motors, without current."""
    group, model = _piece(machine, axis)
    return _modes(model, list(group.bodies))


def _piece(machine: Machine, axis: str) -> tuple[Group, StateSpace]:
    groups = [group for group in connected_groups(machine) if not group.sources]
    for group, model in zip(groups, linear_model(machine), strict=True):
        if axis in group.axes:
            return group, model
    raise KeyError(axis)


def _modes(model: StateSpace, bodies: list[str]) -> tuple[Oscillation, ...]:
    if not bodies:
        return ()
    positions = [model.states.index(b) for b in bodies]
    speeds = [model.states.index(f"{b}'") for b in bodies]
    stiffness = -model.A[np.ix_(speeds, positions)]
    omega2 = np.sort(np.linalg.eigvals(stiffness).real)
    omega2 = omega2[omega2 > _RIGID * max(float(omega2.max()), 1.0)]
    if not len(omega2):
        return ()
    return tuple(
        Oscillation(
            frequency_hz=float(w / (2 * np.pi)), damping=_damping(model, positions, speeds, w)
        )
        for w in np.sqrt(omega2)
    )


def _damping(model: StateSpace, positions: list[int], speeds: list[int], omega: float) -> float:
    """Return the damping ratio of the pole pair of an undamped mode.

    All damping is increased from 0 to its value in 64 steps, and the pair is followed from step to
    step.
    """
    n = len(positions)
    companion = np.zeros((2 * n, 2 * n))
    companion[:n, n:] = np.eye(n)
    companion[n:, :n] = model.A[np.ix_(speeds, positions)]
    damping: FloatArray = model.A[np.ix_(speeds, speeds)]
    pole = 1j * omega
    for share in np.linspace(0.0, 1.0, 65)[1:]:
        companion[n:, n:] = share * damping
        poles = np.linalg.eigvals(companion)
        pole = poles[int(np.argmin(np.abs(poles - pole)))]
    # A pair that has met on the real axis has the ratio 1, even if rounding lost one of its poles.
    return float(-pole.real / abs(pole)) if pole else 1.0
