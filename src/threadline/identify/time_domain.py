"""Residuals of recorded runs: measured positions less the positions of the simulated machine.

A sample is taken before the controller acts on it (``Recording``), so the volts of sample k + 1 act
from tick k on.

*Driven by volts.* Where the volts of every tick of a controller were recorded, they drive the
simulated plant, without the loop. The residuals are then the rounding of the encoder alone.

*Driven by commands.* A controller with a faster clock than its references (``stitcher``) changes
its volts between the samples. Then the whole loop is simulated under the recorded commands, with
every quantiser, and the positions are compared. The recording does not tell where between two
counts an encoder stands, so the model is the mean over several such places.

Both simulations have the dead times, friction, play and limits of the machine file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import MachineError, OptionError, Place, RecordingError
from threadline.files import ChannelKind, Recording, Stream, TickBlock, TickTable
from threadline.identify.recorded_run import (
    columns_in,
    commands_in,
    cut_as_recorded,
    moves,
    refuse_clipped,
)
from threadline.machine import Machine
from threadline.machine.controllers import Dac, PController, StateSpaceController
from threadline.machine.parts import Body, Encoder
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.variants import load_by_counts
from threadline.twin.batch import BatchOptions, simulate_batch

_PHASES = 8
_MOVING_S = 0.5
_WINDOWS = 40
_UNLIKELY = 6.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingData:
    """A recorded run on a machine, ready to be compared with simulated variants.

    Parameters
    ----------
    machine
        The machine that ran.
    simulated
        The machine that is simulated: the same, or one whose commands are volts.
    commands
        Commands of the simulated machine, tick by tick.
    measured
        Per channel of the simulated machine: (n,) measured positions, in counts.
    used
        (n,) whether a sample is used: an axis at rest carries no information.
    scale
        Per channel: counts per unit of the simulated samples.
    place
        The file of the recording.
    by_volts
        Whether recorded volts drive the simulation.
    """

    machine: Machine
    simulated: Machine
    commands: TickTable
    measured: Mapping[str, FloatArray]
    used: NDArray[np.bool_]
    scale: Mapping[str, float]
    place: Place
    by_volts: bool

    @property
    def name(self) -> str:
        """Name of the file."""
        return str(self.place)

    @property
    def step(self) -> float:
        """Relative step of a numerical derivative, larger where quantisation makes the model rough.

        Stiction makes it rough, too: a body breaks away at the first level of the volts above it.
        """
        sticks = any(body.friction is not None for body in self.machine.bodies.values())
        return 1e-3 if self.by_volts and not sticks else 0.03

    @property
    def floor(self) -> FloatArray:
        """(m,) least noise: the rounding of an encoder, 1/sqrt(12) of a count."""
        return np.full(len(self.sources), 1.0 / np.sqrt(12.0))

    @property
    def robust(self) -> bool:
        """Whether the fit discounts outliers: no, residuals are rounding or errors of the model."""
        return False

    @property
    def normalised(self) -> bool:
        """Whether all magnitudes share an unknown factor: no, positions and volts are absolute."""
        return False

    @property
    def length(self) -> int:
        """Number of samples of a channel that are used."""
        return int(np.sum(self.used))

    @property
    def sources(self) -> IntArray:
        """(m,) source of each residual: one for each channel."""
        return np.repeat(np.arange(len(self.measured)), self.length)

    def residuals(self, numbers: Mapping[str, FloatArray]) -> FloatArray:
        """Return the (variants, m) residuals, channel after channel, in counts.

        Parameters
        ----------
        numbers
            Dotted name to (variants,) SI values.
        """
        (count,) = {len(value) for value in numbers.values()} or {1}
        phase_count = 1 if self.by_volts else _PHASES
        repeated = {name: np.repeat(value, phase_count) for name, value in numbers.items()}
        phases = (np.arange(phase_count) + 0.5) / phase_count
        phase = np.tile(phases[:, None], (count, len(self.machine.axes)))
        try:
            batch = simulate_batch(
                self.commands,
                self.simulated,
                repeated,
                encoder_phase=phase,
                options=BatchOptions(
                    settle_s=0.0, channels=tuple(self.measured), watch_current=False
                ),
            )
        except MachineError:
            # A variant cannot be simulated: find it; the caller takes NaN as infinitely wrong.
            if count == 1:
                return np.full((1, len(self.measured) * self.length), np.nan)
            parts = [
                self.residuals({name: value[k : k + 1] for name, value in numbers.items()})
                for k in range(count)
            ]
            return np.concatenate(parts)
        parts = []
        for name, recorded in self.measured.items():
            simulated = batch.samples[name][: len(self.used)][self.used] * self.scale[name]
            mean = simulated.reshape(self.length, count, phase_count).mean(axis=2)
            differences = recorded[self.used] - mean.T
            if self.by_volts:
                # The place between two counts at the start is unknown: the mean is removed.
                differences -= differences.mean(axis=1, keepdims=True)
            parts.append(differences)
        return np.concatenate(parts, axis=1)

    def left_over(self, residual: FloatArray, noise: FloatArray) -> list[str]:
        """Describe where the recording differs from the fit by more than its noise allows.

        The mean over each fortieth of the run is compared with six times the noise of a sample.

        Parameters
        ----------
        residual, noise
            (m,) residuals, channel after channel, and their noise.
        """
        width = max(self.length // _WINDOWS, 1)
        time_s = np.flatnonzero(self.used) * float(self.machine.tick_clock.period_s)
        texts = []
        for k, name in enumerate(self.measured):
            rows = slice(k * self.length, (k + 1) * self.length)
            mean = np.convolve(residual[rows], np.ones(width) / width, mode="valid")
            worst = int(np.argmax(np.abs(mean)))
            if abs(mean[worst]) > _UNLIKELY * noise[rows][0]:
                texts.append(
                    f"{name} from {time_s[worst]:.4g} to {time_s[worst + width - 1]:.4g} s: "
                    f"{mean[worst]:+.3g} counts from the fit, noise {noise[rows][0]:.2g} counts"
                )
        return texts


def recording_data(
    recording: Recording, machine: Machine, path: Path, axis: str = ""
) -> RecordingData:
    """Return a recording as data for a fit.

    Parameters
    ----------
    machine
        The machine that ran, or one with the same parts.
    path
        File of the recording.
    axis
        Axis to use; empty: all axes that moved.

    Raises
    ------
    RecordingError
        If commands or measured positions are missing, have gaps or another tick than the machine,
        it has several runs, nothing moves, or the controller was at its clamp for a fifth of the
        run.
    OptionError
        If there is no such axis, or an axis of the machine has no controller.
    MachineError
        If a state-space controller moves several axes together, and volts drive the simulation.
    """
    place = Place(str(path))
    if not machine.axes or not all(axis_part.controller for axis_part in machine.axes.values()):
        raise OptionError(
            f"machine {machine.name!r} has no control loops, so a recording of it has no volts",
            remedy="Fit a measured response.",
        )
    if axis and axis not in machine.axes:
        raise OptionError(
            f"machine {machine.name!r} has no axis {axis!r}",
            remedy=f"It has: {', '.join(machine.axes)}.",
        )
    if recording.runs != 1:
        raise RecordingError(f"it has {recording.runs} runs", place=place, remedy="Give one run.")
    columns = columns_in(recording, machine, place)
    commands = commands_in(columns, machine, recording.job_sha256, place)
    moving_axes = [name for name in machine.axes if moves(columns, name, machine)]
    machine, powered = cut_as_recorded(recording, machine, place)
    fitted_axes = [name for name in moving_axes if axis in {"", name}]
    fitted_axes = [name for name in fitted_axes if (ChannelKind.MEASURED, name) in columns]
    if not fitted_axes:
        raise RecordingError(
            f"axis {axis or ', '.join(machine.axes)} does not move, or its measured position is "
            "missing",
            place=place,
            remedy="Record a run with a move of it, or name another axis.",
        )
    for name in fitted_axes:
        if (volts := columns.get((ChannelKind.VOLTAGE, name))) is not None:
            refuse_clipped(machine, name, volts[:powered], place)
    by_volts = all(_volts_of_each_tick(columns, name, machine) for name in fitted_axes)
    # In the loop the volts follow from the positions, with more rounding, and add no information.
    ending = "load" if by_volts else "measured"
    scale = {f"{name}.{ending}": machine.axes[name].counts.si for name in fitted_axes}
    measured = {
        f"{name}.{ending}": columns[ChannelKind.MEASURED, name] * scale[f"{name}.{ending}"]
        for name in fitted_axes
    }
    used = _in_motion(columns, fitted_axes, machine)
    simulated = machine
    if by_volts:
        simulated = driven_by_volts(machine, fitted_axes)
        acting = {name: columns[ChannelKind.VOLTAGE, name] for name in fitted_axes}
        commands = _volt_commands(commands, machine, acting)
    return RecordingData(
        machine=machine,
        simulated=simulated,
        commands=commands,
        measured=measured,
        used=used,
        scale=scale,
        place=place,
        by_volts=by_volts,
    )


_LEVELS = 20
_STILL = "still-for-fit"  # a body that no force moves


def _volts_of_each_tick(
    columns: Mapping[tuple[ChannelKind, str], FloatArray], name: str, machine: Machine
) -> bool:
    controller = machine.controller_of(name)
    same_clock = machine.clock(controller.clock).period_s == machine.tick_clock.period_s
    return same_clock and (ChannelKind.VOLTAGE, name) in columns


def driven_by_volts(machine: Machine, axes: Sequence[str]) -> Machine:
    """Return a machine whose commands are volts: one count is ``2 range / 2^20`` at the amplifier.

    The controller of each axis reads the encoder of a body that stands still, with a gain of 1, and
    the load of the axis is the reading of its own encoder, in m or rad.

    Parameters
    ----------
    axes
        Axes to change; the others keep their loops.

    Raises
    ------
    MachineError
        If a state-space controller moves one of the axes together with others.
    """
    unity = Quantity(si=1.0, unit="", tolerance_si=0.0, provenance=Provenance.ASSUMED)
    bodies, sensors = dict(machine.bodies), dict(machine.sensors)
    controllers, axes_changed = dict(machine.controllers), dict(machine.axes)
    for name in axes:
        axis = machine.axes[name]
        shared = machine.controllers[axis.controller]
        if isinstance(shared, StateSpaceController) and len(shared.references) > 1:
            raise MachineError(
                f"controllers.{axis.controller} moves the axes {', '.join(shared.references)} "
                f"together, and a fit of a recording takes axis {name} alone",
                place=machine.place,
                remedy="Fit with a machine file in which each axis has a controller of its own.",
            )
        old_controller, still_body = machine.controller_of(name), f"{_STILL}-{name}"
        bodies[still_body] = Body(kind="linear", inertia=replace(unity, unit="kg"))
        sensors[still_body] = Encoder(
            kind="encoder", reads={still_body: replace(unity, unit="count/m")}
        )
        dac = Dac(
            bits=replace(unity, si=float(_LEVELS), unit="bit"), range=old_controller.dac.range
        )
        controllers[axis.controller] = PController(
            kind="p",
            clock=old_controller.clock,
            reference_clock=old_controller.reference_clock,
            sensor=still_body,
            drive=old_controller.drive,
            kp=replace(unity, unit="dac/count"),
            dac=dac,
        )
        axes_changed[name] = replace(axis, load=load_by_counts(machine, name))
    return replace(
        machine, bodies=bodies, sensors=sensors, controllers=controllers, axes=axes_changed
    )


def _volt_commands(
    commands: TickTable, machine: Machine, volts: Mapping[str, FloatArray]
) -> TickTable:
    """Return commands in which the axes of ``volts`` have levels of volts instead of counts."""
    (block,) = commands
    rows = block.counts.copy()
    for name, samples in volts.items():
        level = 2.0 * machine.controller_of(name).dac.range.si / 2.0**_LEVELS
        # The volts that act from tick k on are sampled at tick k + 1; the first row follows tick 0.
        acting = np.rint(samples[1:] / level).astype(np.int64)
        changes = np.diff(acting, append=acting[-1:])
        changes[0] += acting[0]  # a run may begin with volts that hold a load
        rows[:, machine.axis_names.index(name)] = changes
    volt_block = TickBlock(first_tick=0, counts=rows, operation=block.operation)
    return replace(commands, blocks=Stream(iter, (volt_block,)))


def _in_motion(
    columns: Mapping[tuple[ChannelKind, str], FloatArray], axes: Sequence[str], machine: Machine
) -> NDArray[np.bool_]:
    """Return the samples at which a command changes, or has changed within half a second."""
    moving = np.zeros(len(columns[ChannelKind.COMMANDED, axes[0]]), dtype=np.bool_)
    for name in axes:
        moving[1:] |= np.diff(columns[ChannelKind.COMMANDED, name]) != 0.0
    window = max(round(_MOVING_S / float(machine.tick_clock.period_s)), 1)
    return np.convolve(moving, np.ones(window), mode="full")[: len(moving)] > 0.5
