"""The plant of the winder's X from one sweep, beside subspace identification of the same run.

Both see the recorded volts and positions of the simulated machine, rounded by its encoder and its
DAC. The error is that of the response from volts to counts, 1 to 20 Hz, beside the printed plant.
The peer, nfoursid (N4SID, Van Overschee and De Moor 1994), knows nothing of the machine but that
it has two states; Threadline knows the machine file and fits its two numbers.

The second row is a real axis, EMPS, where ``THREADLINE_EMPS`` names its recording: the simulated
position under the recorded references, beside the measured one, at all samples in motion. The peer
sees references and positions of the first six seconds, and takes the number of states that fits
best; Threadline knows the loop of the rig and fits mass, viscous and Coulomb friction.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tests.identify.emps import COUNTS, NAMES, recorded

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.loop import axis_loop
from threadline.files import Recording, Stream
from threadline.files.recording import columns_of
from threadline.identify.parameter_fit import fit
from threadline.identify.planned_experiment import experiment
from threadline.identify.time_domain import recording_data
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import number_at, with_numbers
from threadline.twin.simulate import simulate

NUMBERS = ("bodies.x.inertia", "drives.x.amplifier.gain")
HERTZ = np.geomspace(1.0, 20.0, 40)
_ROWS = 10
_STATES = (2, 3, 4)
_PEER_SAMPLES = 6000  # of 24 841, for which the peer takes 0.8 GB; for all of them 8 GB


def printed() -> ComplexArray:
    """Counts per volt that is held for 5 ms, from the printed pole and gain."""
    from scipy.signal import cont2discrete

    J, Kt, Ke, R = 3.606e-4, 0.082, 8.6 * 60 / (2 * np.pi * 1000), 0.4
    top = np.array([4000 / (2 * np.pi) * 0.45 * Kt / (R * J)])
    num, den, _ = cont2discrete((top, np.array([1.0, Kt * Ke / (R * J), 0.0])), 5e-3, "zoh")
    z = np.exp(2j * np.pi * HERTZ * 5e-3)
    return np.asarray(np.polyval(np.ravel(num), z) / np.polyval(den, z))


def ours(guess: Machine, recording: Recording) -> ComplexArray:
    fitted = fit(guess, [recording_data(recording, guess, Path("sweep"), "X")], NUMBERS).fitted
    return axis_loop(fitted, "X").plant_response(2 * np.pi * HERTZ)


def subspace(
    inputs: FloatArray, outputs: FloatArray, states: Sequence[int] = (2,)
) -> list[Any] | None:
    """Return nfoursid's models with the matrices a, b, c, d; None where it is not installed."""
    try:
        import pandas
        from nfoursid.nfoursid import NFourSID
    except ImportError:
        return None
    table = pandas.DataFrame({"u": inputs, "y": outputs})
    found = NFourSID(table, output_columns=["y"], input_columns=["u"], num_block_rows=_ROWS)
    found.subspace_identification()
    return [found.system_identification(rank=count)[0] for count in states]


def response_of(model: Any) -> ComplexArray:
    """Return the response of a model of two states at ``HERTZ``."""
    z = np.exp(2j * np.pi * HERTZ * 5e-3)
    states = np.linalg.solve(
        z[:, None, None] * np.eye(2) - model.a, np.broadcast_to(model.b, (len(z), 2, 1))
    )
    return np.asarray((model.c @ states + model.d)[:, 0, 0])


def simulated_position(model: Any, inputs: FloatArray) -> FloatArray:
    """Return what a model answers to inputs from rest, without seeing an output."""
    state, outputs = np.zeros((len(model.a), 1)), np.empty(len(inputs))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable model has no error
        for k, value in enumerate(inputs.tolist()):
            outputs[k] = float((model.c @ state + model.d * value)[0, 0])
            state = model.a @ state + model.b * value
    return outputs


def emps() -> dict[str, Any]:
    """Return the row of the real axis."""
    name = "position of the recorded axis EMPS under its references, beside nfoursid"
    row = {"name": name, "ours": None, "peer": "nfoursid", "peer_value": None, "ratio": None}
    file = Path(os.environ.get("THREADLINE_EMPS", ""))
    if not file.is_file():
        return {**row, "unit": "m", "note": "skipped: THREADLINE_EMPS names no DATA_EMPS.mat"}
    with tempfile.TemporaryDirectory() as folder:
        data = recorded(file, Path(folder))
        (block,) = data.commands
        found = fit(data.machine, [data], NAMES, starts=0)
    start = int(data.commands.start_counts[0])
    goal = start + np.append(0, np.cumsum(block.counts[:, 0]))
    measured = data.measured["X.measured"]
    mine = float(np.sqrt(np.mean(found.estimate.residual**2))) / COUNTS
    millimetres = COUNTS * 1e-3
    best, states = np.inf, 0
    first = slice(_PEER_SAMPLES)
    models = subspace(goal[first] / millimetres, measured[first] / millimetres, _STATES)
    for count, model in zip(_STATES, models or [], strict=False):
        apart = simulated_position(model, goal / millimetres) - measured / millimetres
        with np.errstate(over="ignore"):
            error = 1e-3 * float(np.linalg.norm(apart[data.used]) / np.sqrt(data.length))
        if error < best:
            best, states = error, count
    note = f"ours {1e6 * mine:.3g} um (rms), "
    if models is None:
        return {**row, "ours": mine, "unit": "m", "note": f"{note}nfoursid is not installed"}
    note += f"theirs {1e6 * best:.3g} um with {states} states, of the first {_PEER_SAMPLES} samples"
    return {**row, "ours": mine, "peer_value": best, "ratio": best / mine, "unit": "m"} | {
        "note": note
    }


def run() -> list[dict[str, Any]]:
    machine = load_machine("lathe-winder")
    planned = experiment(machine, "X", "sweep", band_hz=(1.0, 20.0))
    recording = simulate(planned.commands, machine)
    recording = Recording(
        channels=recording.channels, blocks=Stream.of(list(recording)), job_sha256="",
        machine_sha256=machine.sha256, simulated=True,
    )  # fmt: skip
    columns = {name.partition(" ")[0]: v for name, v in columns_of(recording).items()}
    volts = np.append(columns["X.voltage"][1:], 0.0)  # the volts of a sample act before it
    counts = columns["X.measured"] * machine.axes["X"].counts.si
    off = {
        name: number_at(machine, name).si * by for name, by in zip(NUMBERS, (1.3, 0.7), strict=True)
    }
    true = printed()

    def error(response: ComplexArray) -> float:
        return float(np.sqrt(np.mean(np.abs(response / true - 1.0) ** 2)))

    mine = error(ours(with_numbers(machine, off), recording))
    found = subspace(volts, counts)
    theirs = None if found is None else error(response_of(found[0]))
    return [
        {
            "name": "response of the winder's X after a fit of one sweep, beside nfoursid",
            "ours": mine,
            "peer": "nfoursid",
            "peer_value": theirs,
            "ratio": None if theirs is None else theirs / mine,
            "unit": "",
            "note": f"ours {100 * mine:.2g} % (rms, 1 to 20 Hz, from a file 30 % off), "
            + (
                "nfoursid is not installed"
                if theirs is None
                else f"theirs {100 * theirs:.2g} % with two states"
            ),
        },
        emps(),
    ]
