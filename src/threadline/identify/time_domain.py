"""Residuals of recorded runs: measured positions less the positions of the simulated machine.

The recorded positions are compared with a simulation, which is driven in one of two ways:

*Driven by volts.* If the volts of every tick of the controller were recorded, they drive the
simulated plant, without its loop. If the model is right, the residuals are only the rounding of the
encoder. Each sample is taken before the controller acts on it (``Recording``), so the volts in
sample k + 1 act from tick k on.

*Driven by commands.* Without recorded volts, or if the controller's clock is faster than the clock
of its references (``stitcher``), the volts between the samples are unknown. Then the recorded
commands drive the whole simulated loop, with every quantiser. The recording does not show where
within a count each encoder starts, so the simulated position is a mean over several such starts.

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

_PHASES = 8  # starts of an encoder within a count
_MOVING_S = 0.5  # time after a change of the command in which an axis counts as moving
_WINDOWS = 40  # length of the run over the window of a mean residual
_UNLIKELY = 6.0  # mean residual that no noise explains, in deviations of a sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingData:
    """A recorded run on a machine, ready to be compared with simulated variants.

    Parameters
    ----------
    machine
        The machine that ran.
    simulated
        The machine that is simulated: the same, or its copy with commands in volts
        (``driven_by_volts``).
    commands
        Commands of the simulated machine, tick by tick.
    measured
        For each channel of the simulated machine: (n,) measured positions, in counts.
    used
        (n,) whether a sample is used. An axis at rest carries no information.
    scale
        For each channel: counts per m or rad of its simulated samples.
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
        """Relative step of numerical derivatives, larger where the model is not smooth.

        Quantisers in the loop make it rough. So does stiction: a body breaks away at the first DAC
        level whose force exceeds the stiction.
        """
        sticks = any(body.friction is not None for body in self.machine.bodies.values())
        return 1e-3 if self.by_volts and not sticks else 0.03

    @property
    def floor(self) -> FloatArray:
        """(m,) least standard deviation of the noise: rounding to counts, 1/sqrt(12) of a count."""
        return np.full(len(self.sources), 1.0 / np.sqrt(12.0))

    @property
    def robust(self) -> bool:
        """False: residuals are rounding or errors of the model, so none counts as an outlier."""
        return False

    @property
    def normalised(self) -> bool:
        """False: positions and volts are absolute, so no unknown factor is common to all."""
        return False

    @property
    def length(self) -> int:
        """Number of samples used of each channel."""
        return int(np.sum(self.used))

    @property
    def sources(self) -> IntArray:
        """(m,) index of the channel of each residual."""
        return np.repeat(np.arange(len(self.measured)), self.length)

    def residuals(self, numbers: Mapping[str, FloatArray]) -> FloatArray:
        """Return the (variants, m) residuals, channel after channel, in counts.

        Parameters
        ----------
        numbers
            (variants,) SI values of each number, by its dotted name in the machine file.
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
            # One of the variants cannot be simulated: simulate each alone. The bad one gets NaN,
            # which the fit takes as an infinite residual.
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
            residual = recorded[self.used] - mean.T
            if self.by_volts:
                # The start of the encoder within a count is unknown, so the mean is removed.
                residual -= residual.mean(axis=1, keepdims=True)
            parts.append(residual)
        return np.concatenate(parts, axis=1)

    def left_over(self, residual: FloatArray, noise: FloatArray) -> list[str]:
        """Describe where each channel differs from the fit by more than noise explains.

        The largest mean residual over any window of a fortieth of the used samples is compared with
        six standard deviations of the noise of one sample.

        Parameters
        ----------
        residual, noise
            (m,) residuals, channel after channel, and the standard deviation of their noise.
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
    """Prepare a recording as data for a fit.

    Parameters
    ----------
    machine
        The machine that ran, or one with the same parts.
    path
        File of the recording.
    axis
        The only axis to use; empty for all axes that moved.

    Raises
    ------
    RecordingError
        If commands or measured positions are missing, have gaps or another tick than the machine,
        the recording has several runs, nothing moves, or the controller was at its clamp for more
        than a fifth of the run.
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
    # In a simulated loop only positions are compared: the controller computes the volts from them.
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


_LEVELS = 20  # bits of the DAC that turns a command into volts
_STILL = "still-for-fit"  # a body that no force moves


def _volts_of_each_tick(
    columns: Mapping[tuple[ChannelKind, str], FloatArray], name: str, machine: Machine
) -> bool:
    controller = machine.controller_of(name)
    same_clock = machine.clock(controller.clock).period_s == machine.tick_clock.period_s
    return same_clock and (ChannelKind.VOLTAGE, name) in columns


def driven_by_volts(machine: Machine, axes: Sequence[str]) -> Machine:
    """Return a copy of the machine with open loops and commands in volts.

    One count of a command is ``2 range / 2^20`` volts at the amplifier: the controller becomes a
    gain of 1, whose encoder reads a body that never moves. The position of the load becomes the
    reading of the axis's own encoder, in m or rad.

    Parameters
    ----------
    axes
        Axes whose loops are opened; the other axes keep their loops.

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
        controller = machine.controllers[axis.controller]
        if isinstance(controller, StateSpaceController) and len(controller.references) > 1:
            raise MachineError(
                f"controllers.{axis.controller} moves the axes {', '.join(controller.references)} "
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
    """Return commands in which a count of each axis in ``volts`` is a step of its voltage."""
    (block,) = commands
    rows = block.counts.copy()
    for name, samples in volts.items():
        level = 2.0 * machine.controller_of(name).dac.range.si / 2.0**_LEVELS
        # Sample k + 1 has the volts that act from tick k on; row 0 acts from tick 0 on.
        acting = np.rint(samples[1:] / level).astype(np.int64)
        changes = np.diff(acting, append=acting[-1:])
        changes[0] += acting[0]  # the first volts may not be 0: they may hold a load
        rows[:, machine.axis_names.index(name)] = changes
    volt_block = TickBlock(first_tick=0, counts=rows, operation=block.operation)
    return replace(commands, blocks=Stream(iter, (volt_block,)))


def _in_motion(
    columns: Mapping[tuple[ChannelKind, str], FloatArray], axes: Sequence[str], machine: Machine
) -> NDArray[np.bool_]:
    """Return (n,) whether a command changes at the sample or changed in the half second before."""
    moving = np.zeros(len(columns[ChannelKind.COMMANDED, axes[0]]), dtype=np.bool_)
    for name in axes:
        moving[1:] |= np.diff(columns[ChannelKind.COMMANDED, name]) != 0.0
    window = max(round(_MOVING_S / float(machine.tick_clock.period_s)), 1)
    return np.convolve(moving, np.ones(window), mode="full")[: len(moving)] > 0.5
