"""Run an experiment on a machine at the end of a link, and evaluate its recording."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.base.writing import check_output
from threadline.dynamics.loop import axis_loop
from threadline.errors import LimitError, MachineError, OptionError, Place, RecordingError
from threadline.files import Channel, Recording, RecordingBlock, RunEnd, Stream
from threadline.files.recording import columns_of
from threadline.identify.measured_response import OUTPUTS, MeasuredResponse, check_response
from threadline.identify.planned_experiment import Experiment, duration_s
from threadline.identify.recorded_run import CUT_AT
from threadline.live.hal_link import WHAT, check_hal, hal_link
from threadline.live.sim_machine import SimFault
from threadline.live.sim_process import sim_link
from threadline.live.states import Cause, Desk, State
from threadline.live.supervised import run_commands
from threadline.live.wire import Connection
from threadline.machine import Machine
from threadline.twin.simulate import simulate

RESPONSE = "response"
"""Key in a recording's origin whose value is the measured response, as JSON."""
_COAST_FACTOR = 2.0  # an axis may coast this many times as far as its machine file says
LINKS = ("sim", *(f"hal:{what}" for what in WHAT))


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """The experiment as the machine file predicts it, before it runs.

    Parameters
    ----------
    duration_s
        Duration, s.
    lowest, highest
        Ends of the load's motion, m or rad.
    speed
        Largest speed of the load, m/s or rad/s.
    current_a
        Largest current, A.
    """

    duration_s: float
    lowest: float
    highest: float
    speed: float
    current_a: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """The result of an experiment.

    Parameters
    ----------
    recording
        The raw run, with the response in its origin.
    response
        The frequency response of a sweep; None for other experiments, if the run ended early, or if
        the link reports no volts (HAL).
    ended, why
        How the run ended.
    """

    recording: Recording
    response: MeasuredResponse | None
    ended: RunEnd
    why: str


def check_measurement_file(file: Path) -> None:
    """Refuse a file name that cannot hold a measurement, or a file that must not be overwritten.

    Raises
    ------
    OptionError
        If the name does not end in .npz or .mcap, or ``check_output`` refuses it.
    """
    if file.suffix.lower() not in {".npz", ".mcap"}:
        raise OptionError(
            f"{str(file)!r} cannot hold a measurement", remedy="Give one that ends in .npz."
        )
    check_output(file)


def check_same_axes(machine: Machine, actual: Machine) -> None:
    """Refuse to simulate a machine with other axes in place of ``machine``.

    Raises
    ------
    OptionError
        If its axes have other names.
    """
    if actual.axis_names != machine.axis_names:
        raise OptionError(
            f"{actual.name} has other axes than {machine.name}",
            remedy="Name a machine with the same axes.",
        )


def predict(machine: Machine, planned: Experiment) -> Prediction:
    """Simulate an experiment on the machine file; refuse it if it would exceed a limit.

    Raises
    ------
    MachineError
        If a sweep could not be evaluated, because a state-space controller is faster than its
        references.
    LimitError
        If the load would leave its travel or exceed the speed of the axis, or the motor would reach
        its current limit.
    """
    loop = axis_loop(machine, planned.axis)
    tick_s = float(machine.tick_clock.period_s)
    if planned.kind == "sweep" and not loop.single and loop.period_s != tick_s:
        raise MachineError(
            f"axis {planned.axis}: its state-space controller runs every {1e3 * loop.period_s:.4g} "
            f"ms and its references come every {1e3 * tick_s:.4g} ms, so that a recording shows "
            "its volts at some ticks only; nothing has moved",
            place=machine.place,
            remedy="Measure with a controller of another kind on this axis.",
        )
    recording = simulate(planned.commands, planned.on(machine))
    columns = {name.partition(" ")[0]: v for name, v in columns_of(recording).items()}
    axis, limits = planned.axis, machine.axes[planned.axis]
    load = columns[f"{axis}.load"]
    prediction = Prediction(
        duration_s=float(duration_s(planned.commands)),
        lowest=float(load.min()),
        highest=float(load.max()),
        speed=float(np.abs(columns[f"{axis}.velocity"]).max()),
        current_a=float(np.abs(columns[f"{axis}.current_peak"]).max()),
    )
    # A coast measures the friction, which may be far less than the machine file says.
    farthest_si = prediction.highest
    if planned.cut_at_si is not None:
        farthest_si = planned.cut_at_si + _COAST_FACTOR * (prediction.highest - planned.cut_at_si)
    drive = machine.motors[machine.controller_of(axis).drive].amplifier
    low, high = (None, None) if limits.travel is None else limits.travel
    unit = "m" if limits.kind == "linear" else "rad"
    for quantity, value, limit, unit_text in (
        ("position", farthest_si, None if high is None else high.si, unit),
        ("position", -prediction.lowest, None if low is None else -low.si, unit),
        ("velocity", prediction.speed, limits.velocity.si, f"{unit}/s"),
        ("current", prediction.current_a, _si(drive.current_limit), "A"),
    ):
        # A current that is limited is reached, not exceeded.
        reached = limit is not None and value >= limit * (1.0 - 1e-9)
        if limit is not None and (reached if quantity == "current" else value > limit):
            raise LimitError(
                f"axis {axis}: the {planned.kind} would reach a {quantity} of {value:.4g} "
                f"{unit_text}, "
                f"limit {limit:.4g} {unit_text}; nothing has moved",
                axis=axis,
                quantity=quantity,
                value_si=value,
                limit_si=limit,
                remedy="Give a smaller --amplitude.",
            )
    return prediction


def _si(quantity: object) -> float | None:
    return getattr(quantity, "si", None)


class _SampleSink:
    """A sink that keeps the samples."""

    def __init__(self) -> None:
        self.channels: tuple[Channel, ...] = ()
        self.simulated = True
        self.blocks: list[RecordingBlock] = []

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        self.channels, self.simulated = channels, simulated

    def block(self, block: RecordingBlock) -> None:
        self.blocks.append(block)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Ignore changes of state: the run's end is in its events."""


def measure(
    machine: Machine,
    planned: Experiment,
    *,
    link: str = "sim",
    actual: Machine | None = None,
    speed: float = 0.0,
    fault: SimFault | None = None,
) -> Measurement:
    """Run an experiment that ``predict`` has passed.

    After a fault the recording up to the fault is kept; a response needs the whole run.

    Parameters
    ----------
    link
        ``"sim"``, ``"hal:plant"`` or ``"hal:loopback"``.
    actual
        Machine that the simulated link simulates; None for the machine itself.
    speed
        With ``"sim"``: seconds of machine time per second, 0 for as fast as possible.
    fault
        With ``"sim"``: injected fault.

    Raises
    ------
    OptionError
        If there is no such link, or an option does not apply to it.
    LinkFaultError
        If the machine does not answer.
    RecordingError
        If nothing was recorded.
    """
    samples = _SampleSink()
    with closing(Desk()) as desk:
        ended, why, _ = run_commands(
            planned.commands,
            planned.on(machine),
            _connected(machine, planned, link, actual, speed, fault),
            desk,
            samples,
            speed=speed if link == "sim" else 1.0,
        )
    origin = {"machine": machine.reference, "experiment": planned.kind, "axis": planned.axis}
    recording = Recording(
        channels=samples.channels,
        blocks=Stream.of(samples.blocks),
        job_sha256="",
        machine_sha256=machine.sha256,
        simulated=samples.simulated,
        origin={**origin, "link": link, **_cut_origin(planned)},
    )
    if not any(len(v) for block in samples.blocks for v in block.samples.values()):
        raise RecordingError(f"nothing was recorded: {why or ended.value}")
    response = None
    has_volts = any(
        channel.name.partition(" ")[0] == f"{planned.axis}.voltage" for channel in samples.channels
    )
    if planned.kind == "sweep" and ended is RunEnd.COMPLETED and has_volts:
        response = evaluate(machine, planned, recording)
        with_response = {**recording.origin, RESPONSE: _written(response)}
        recording = replace(recording, origin=with_response)
    return Measurement(recording=recording, response=response, ended=ended, why=why)


def _cut_origin(planned: Experiment) -> dict[str, str]:
    return {} if planned.cut_at_si is None else {CUT_AT: repr(planned.cut_at_si)}


def _connected(
    machine: Machine,
    planned: Experiment,
    link: str,
    actual: Machine | None,
    speed: float,
    fault: SimFault | None,
) -> AbstractContextManager[Connection]:
    start = planned.commands.start_counts
    if link == "sim":
        # The simulated machine reports itself as the machine in the file, as a real one would.
        far_machine = machine if actual is None else replace(actual, sha256=machine.sha256)
        check_same_axes(machine, far_machine)
        return sim_link(planned.on(far_machine), start, speed, fault)
    if link not in LINKS:
        raise OptionError(
            f"there is no link {link[:20]!r} to measure on", remedy=f"Use {', '.join(LINKS)}."
        )
    if actual is not None or fault is not None:
        raise OptionError("--actual and --inject are for --link sim", remedy="Leave them out.")
    if planned.cut_at_si is not None:
        raise OptionError(
            f"the link {link} keeps the drives of a moving axis on, and a coast needs one without",
            remedy="Use --experiment constant: its volts at several speeds show friction, too.",
        )
    check_hal(machine)
    return hal_link(machine, start, plant=link == "hal:plant")


def evaluate(machine: Machine, planned: Experiment, recording: Recording) -> MeasuredResponse:
    """Return the response of the encoder to the volts of the controller, from whole periods.

    With M and U the transforms of a period, H is ``sum(M U*) / sum(|U|^2)`` and the coherence
    ``|sum(M U*)|^2 / (sum(|M|^2) sum(|U|^2))`` (Bendat and Piersol, *Random Data*, 2010, section
    6.1). Volts that are held for a tick act as the continuous volts times
    ``(1 - exp(-j w T)) / (j w T)``, which is divided out; aliased components remain.

    If a controller runs faster than its references (``stitcher``), its volts are recorded at some
    of its ticks only, the same ones after each new reference. The volts are then computed from the
    error, by the controller's own difference equation and with the references held, too. The
    rounding of its DAC then counts as noise.
    """
    axis = planned.axis
    columns = {name.partition(" ")[0]: v for name, v in columns_of(recording).items()}
    position = columns[f"{axis}.measured"] * machine.axes[axis].counts.si
    volts = columns[f"{axis}.voltage"]
    tick_s = float(machine.tick_clock.period_s)
    loop = axis_loop(machine, axis)
    same_period = loop.period_s == tick_s
    if same_period:  # the volts that act from a sample on are recorded with the next sample
        volts = np.append(volts[1:], volts[-1])
    periods = (len(position) - planned.first) // planned.period
    periods = min(periods, (planned.commands.tick_count() // planned.period) - 2)
    hertz = planned.lines / (planned.period * tick_s)

    def lines(values: FloatArray) -> ComplexArray:
        periods_used = values[planned.first : planned.first + periods * planned.period]
        return np.fft.rfft(periods_used.reshape(periods, planned.period), axis=1)[:, planned.lines]

    M, U = lines(position), lines(volts)
    if not same_period:
        reference = lines(columns[f"{axis}.commanded"] * machine.axes[axis].counts.si)
        error = reference * _hold(hertz, tick_s) - M
        U = error * loop.filters[loop.index].sampled_response(2.0 * np.pi * hertz)
    cross, volts_power = (M * U.conj()).sum(axis=0), (np.abs(U) ** 2).sum(axis=0)
    position_power = (np.abs(M) ** 2).sum(axis=0)
    has_motion = (volts_power > 0.0) & (position_power > 0.0)
    hertz = hertz[has_motion]
    value = cross[has_motion] / volts_power[has_motion] / _hold(hertz, loop.period_s)
    return MeasuredResponse(
        frequency_hz=hertz,
        value=np.asarray(value, dtype=np.complex128),
        coherence=np.minimum(
            np.abs(cross[has_motion]) ** 2 / (volts_power * position_power)[has_motion], 1.0
        ),
        unit="count",
        axis=axis,
        output=f"sensors.{machine.controller_of(axis).sensor}",
    )


def _hold(hertz: FloatArray, period_s: float) -> ComplexArray:
    """Return the (k,) response of values that are held for a period."""
    turn = 2j * np.pi * hertz * period_s
    return np.asarray((1.0 - np.exp(-turn)) / turn)


def _written(response: MeasuredResponse) -> str:
    assert response.coherence is not None
    return json.dumps(
        {
            "axis": response.axis,
            "output": response.output,
            "unit": f"{response.unit}/V",
            "frequency_hz": response.frequency_hz.tolist(),
            "real": response.value.real.tolist(),
            "imag": response.value.imag.tolist(),
            "coherence": response.coherence.tolist(),
        }
    )


def response_of(origin: Mapping[str, str], place: Place | None = None) -> MeasuredResponse | None:
    """Return the response that a measured recording has in its origin, None if it has none.

    Parameters
    ----------
    place
        The file, for messages.

    Raises
    ------
    RecordingError
        If the response is damaged, or ``check_response`` refuses it.
    """
    if RESPONSE not in origin:
        return None
    try:
        content = json.loads(origin[RESPONSE])
        frequency, real, imag, coherence = (
            np.array(content[key], dtype=np.float64)
            for key in ("frequency_hz", "real", "imag", "coherence")
        )
        words = [content[key] for key in ("unit", "axis", "output")]
        if (
            len({column.shape for column in (frequency, real, imag, coherence)}) != 1
            or real.ndim != 1
        ):
            raise ValueError("columns of different lengths")
        if not all(np.isfinite(column).all() for column in (frequency, real, imag, coherence)):
            raise ValueError("a number that is not finite")
        if not all(isinstance(word, str) for word in words):
            raise ValueError("its unit, axis or output is no text")
        unit, axis, output = words
        if unit.removesuffix("/V") not in OUTPUTS:
            raise ValueError(f"{unit[:20]!r} is no output per volt")
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        fault = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise RecordingError(
            f"its response is damaged: {fault}", place=place, remedy="Measure again."
        ) from error
    response = MeasuredResponse(
        frequency_hz=frequency,
        value=np.asarray(real + 1j * imag, dtype=np.complex128),
        coherence=coherence,
        unit=unit.removesuffix("/V"),
        axis=axis,
        output=output,
        place=place,
    )
    check_response(response)
    return response
