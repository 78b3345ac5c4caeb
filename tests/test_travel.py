"""Values handed between stages can be sent to another process, and read the same there."""

from __future__ import annotations

import ast
import hashlib
import multiprocessing
import os
import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import threadline
from tests.files.makers import recording_of, table_of
from tests.motion.path.builders import job_of, polylines, there_and_back
from tests.with_firmware import winder_with_grbl
from threadline.commands.feedforward import followed_by_loads
from threadline.commands.planned_job import planned_job
from threadline.commands.schedule import compile_schedule
from threadline.commands.ticks import compile_ticks
from threadline.errors import JobError, LimitError, Place, RecordingError
from threadline.files.formats import read_recording, read_table, write_recording
from threadline.files.formats.tick_table import write_table_csv, write_table_npz
from threadline.files.formats.trajectory_array import write_array
from threadline.jobs import read_job
from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.interpolations import chord_path, interpolation_names
from threadline.motion.shaping import parse_shaper, shape_trajectory
from threadline.motion.timing import Pace, even_averages, plan_trajectory
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.twin import simulate
from threadline.twin.switching import simulate_switching
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"
SOURCE = Path(threadline.__file__).parent


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[ProcessPoolExecutor]:
    """A freshly started process knows only the data that it is sent."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield pool


def feed(value: Any, digest: Any) -> None:
    """Add the whole content of ``value`` to a hash."""
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype} {value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        feed([*map(list, value.items())], digest)
    elif isinstance(value, list | tuple):
        digest.update(f"{len(value)} of".encode())
        for item in value:
            feed(item, digest)
    elif is_dataclass(value):
        feed([getattr(value, field.name) for field in fields(value)], digest)
    else:
        digest.update(repr(value).encode())


def digest_of(items: Any) -> str:
    """Return the hash of all blocks of a stream."""
    digest = hashlib.sha256()
    for item in items:
        feed(item, digest)
    return digest.hexdigest()


def same_elsewhere(pool: ProcessPoolExecutor, stream: Any) -> list[Any]:
    """Check that a stream gives the same blocks there and here; return the copy that came back."""
    found = pool.submit(list, stream).result(timeout=120)
    assert found
    assert digest_of(found) == digest_of(stream)
    return found


def job() -> Any:
    pause = {5: Dwell(0.02, Source("job.prg", 5))}
    return job_of(there_and_back(), ("X",), Feed(FeedMode.COUNT_PER_TICK, 20.0), extra=pause)


@pytest.mark.parametrize("name", interpolation_names())
def test_a_planned_motion_travels(elsewhere: ProcessPoolExecutor, name: str) -> None:
    machine = winder_with_grbl()
    programmed = programmed_path(job(), machine)
    path = plan_path(programmed, machine, name)
    trajectory = plan_trajectory(path, machine)
    table = compile_ticks(trajectory, machine, job())
    for stream in (programmed, path, trajectory, table):
        same_elsewhere(elsewhere, stream)
    there = pickle.loads(pickle.dumps(table))
    for name in ("counts_per_unit", "start_counts"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(there, name)[0] = 1
    assert dict(pickle.loads(pickle.dumps(path)).summary) == dict(path.summary)


def test_shaped_and_fed_forward_motions_travel(elsewhere: ProcessPoolExecutor) -> None:
    machine = load_machine("lathe-winder")
    planned = plan_trajectory(plan_path(programmed_path(job(), machine), machine), machine)
    shaper = parse_shaper("zvd:12Hz:0.02", 0.005)
    shaped = shape_trajectory(planned, shaper, machine, centroid_shift=True)
    same_elsewhere(elsewhere, shaped)
    same_elsewhere(elsewhere, compile_ticks(shaped, machine, job()))
    same_elsewhere(elsewhere, planned_job(job(), shaped, machine))

    timed = plan_trajectory(chord_path(programmed_path(job(), machine)), machine, Pace.PROGRAMMED)
    ahead = followed_by_loads(timed, machine, job(), even_averages(0.3))
    for stream in (ahead.timed, ahead.trajectory, ahead.commands):
        same_elsewhere(elsewhere, stream)
    assert pickle.loads(pickle.dumps(ahead)).demands == ahead.demands


@pytest.mark.parametrize("options", [{}, {"record_every": 3, "quantised": False}])
def test_simulated_recordings_travel(
    elsewhere: ProcessPoolExecutor, options: dict[str, Any]
) -> None:
    """Another process simulates by itself, and agrees to the bit."""
    for name in ("lathe-winder", "lathe-winder+physical"):
        machine = load_machine(name)
        trajectory = plan_trajectory(plan_path(programmed_path(job(), machine), machine), machine)
        table = compile_ticks(trajectory, machine, job())
        recording = simulate(table, machine, **options)
        same_elsewhere(elsewhere, recording)
        there = pickle.loads(pickle.dumps(recording))
        assert (there.channels, there.job_sha256) == (recording.channels, recording.job_sha256)


def test_recordings_of_on_off_machines_travel(elsewhere: ProcessPoolExecutor) -> None:
    machine = load_machine("letter-placer")
    scheduled = compile_schedule(read_job(EXAMPLES / "letter-cycle.toml", machine), machine)
    there = pickle.loads(pickle.dumps(scheduled))
    assert there.commands.rows_sha256() == scheduled.commands.rows_sha256()
    assert not there.commands.levels.flags.writeable
    same_elsewhere(elsewhere, simulate_switching(scheduled.commands, machine))


PLANS = {
    "ticks": ("x-180.prg", "lathe-winder", {"interpolation": "linear"}),
    "ticks with every limit": ("cone-dome-cylinder.prg", "lathe-winder", {}),
    "shaped": ("x-180.prg", "lathe-winder", {"shaper": "zv:12Hz:0.02"}),
    "loads that follow": ("stitcher-test-path.seam.toml", "stitcher", {"feed_forward_s": 0.04}),
    "switches": ("letter-cycle.toml", "letter-placer+whole-scans+own-damping", {"shaper": "zv"}),
    "step tables": ("rosette.dst", "table-embroiderer", {}),
    "steppers": ("helix.gcode", "stepper-winder", {}),
}


@pytest.mark.parametrize("name", PLANS)
def test_a_whole_plan_travels(elsewhere: ProcessPoolExecutor, name: str) -> None:
    """Its rows, samples and verdict are the same there, to the bit."""
    example, machine_name, options = PLANS[name]
    machine = load_machine(machine_name)
    chosen = Options(**options)
    plan = plan_job(open_job(EXAMPLES / example, machine, chosen), machine, chosen)
    there = elsewhere.submit(type(plan.commands).rows_sha256, plan.commands).result(timeout=120)
    assert there == plan.commands.rows_sha256()
    copy = pickle.loads(pickle.dumps(plan))
    assert (copy.options, copy.machine, copy.axes) == (plan.options, plan.machine, plan.axes)
    assert copy.commands.rows_sha256() == there
    spec = load_spec(None, machine)
    proof = prove_plan(plan, spec)
    proved = elsewhere.submit(prove_plan, plan, spec).result(timeout=120)
    assert proved.verdict == proof.verdict == pickle.loads(pickle.dumps(proof.verdict))
    assert digest_of(proved.recording) == digest_of(proof.recording)
    assert proved.plan.commands.rows_sha256() == there


@settings(deadline=None, max_examples=25)
@given(polylines(), st.sampled_from(interpolation_names()), st.floats(1.0, 200.0))
def test_any_path_is_the_same_from_its_pickle(
    drawn: tuple[tuple[str, ...], list[list[float]]], name: str, counts: float
) -> None:
    axes, points = drawn
    machine = winder_with_grbl()
    programmed = programmed_path(
        job_of(points, axes, Feed(FeedMode.COUNT_PER_TICK, counts)), machine
    )
    path = plan_path(programmed, machine, name)
    trajectory = plan_trajectory(path, machine)
    for stream in (programmed, path, trajectory):
        assert digest_of(pickle.loads(pickle.dumps(stream))) == digest_of(stream)


def test_arrays_that_were_locked_are_locked_there(elsewhere: ProcessPoolExecutor) -> None:
    machine = load_machine("lathe-winder")
    path = plan_path(programmed_path(job(), machine), machine)
    for stream in (programmed_path(job(), machine), path, plan_trajectory(path, machine)):
        for block in same_elsewhere(elsewhere, stream):
            arrays = [getattr(block, field.name) for field in fields(block)]
            arrays = [array for array in arrays if isinstance(array, np.ndarray)]
            assert arrays
            assert not any(array.flags.writeable for array in arrays)


@pytest.mark.parametrize("name", ["lathe-winder+physical", "stitcher", "letter-placer"])
def test_machines_and_specifications_travel(name: str) -> None:
    machine = load_machine(name)
    spec = load_spec(None, machine)
    assert pickle.loads(pickle.dumps((machine, spec))) == (machine, spec)


@pytest.mark.parametrize("ending", ["npz", "csv", "ticks"])
def test_a_table_of_a_file_is_read_there_if_it_is_the_same(
    elsewhere: ProcessPoolExecutor, tmp_path: Path, ending: str
) -> None:
    file = tmp_path / f"t.{ending}"
    table = table_of([[1, 2], [3, 4], [0, -5]])
    write = {"npz": write_table_npz, "csv": write_table_csv, "ticks": write_array}[ending]
    write(table, file)
    read = read_table(file)
    same_elsewhere(elsewhere, read)
    # Another modification time is no other content, neither there nor here.
    status = file.stat()
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns - 10**9))
    same_elsewhere(elsewhere, read)
    # Other content counts, although it has the same length.
    content = file.read_bytes()
    file.write_bytes(content[:-2] + bytes([content[-2] ^ 1]) + content[-1:])
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns - 10**9 // 2))
    with pytest.raises(RecordingError, match=rf"t\.{ending}: the file has changed") as caught:
        elsewhere.submit(list, read).result(timeout=120)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", ["npz", "csv", "plt"])
def test_a_recording_of_a_file_is_read_there_if_it_is_the_same(
    elsewhere: ProcessPoolExecutor, tmp_path: Path, ending: str
) -> None:
    file = tmp_path / f"r.{ending}"
    write_recording(recording_of({"X.measured": [0.0, 0.001, 0.0025]}, rows=2), file)
    read = read_recording(file)
    same_elsewhere(elsewhere, read)
    trace = tmp_path / "trace.csv"
    trace.write_text("time [s],X [mm]\n0.000,1.0\n0.005,2.0\n0.010,2.5\n")
    same_elsewhere(elsewhere, read_recording(trace))
    file.write_bytes(file.read_bytes() + b" ")
    with pytest.raises(RecordingError, match=rf"r\.{ending}: the file has changed"):
        elsewhere.submit(list, read).result(timeout=120)
    with pytest.raises(RecordingError, match=rf"r\.{ending}: the file has changed"):
        list(read)


PROGRAM = """%
O1
N10 G91 G1 X10 F600
N20 X-10
N30 M99
O2
N40 G90 G1 X5 F900
N50 G4 P0.1
N60 M98 P1 L4
N70 A90
N80 M30
%
"""


def test_part_programs_travel_with_the_hash_of_their_file(
    elsewhere: ProcessPoolExecutor, tmp_path: Path
) -> None:
    file = tmp_path / "job.prg"
    file.write_text(PROGRAM)
    read = read_job(file, load_machine("lathe-winder"))
    same_elsewhere(elsewhere, read)
    there = pickle.loads(pickle.dumps(read))
    for name in ("runs", "folded"):
        assert digest_of(getattr(there, name)()) == digest_of(getattr(read, name)())
    file.write_text(PROGRAM.replace("X5", "X6"))
    with pytest.raises(JobError, match=r"job\.prg: the file was changed while it was in use"):
        elsewhere.submit(list, read).result(timeout=120)


@pytest.mark.parametrize(
    ("example", "name"),
    [("stitcher-test-path.seam.toml", "stitcher"), ("letter-cycle.toml", "letter-placer")],
)
def test_seams_and_move_lists_travel(
    elsewhere: ProcessPoolExecutor, example: str, name: str
) -> None:
    read = read_job(EXAMPLES / example, load_machine(name))
    same_elsewhere(elsewhere, read)
    there = pickle.loads(pickle.dumps(read))
    assert digest_of(there.runs()) == digest_of(read.runs())


def classes_with_locked_arrays() -> Iterator[tuple[str, ast.ClassDef]]:
    for file in sorted(SOURCE.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if "read_only" not in text:
            continue  # parsing everything that lacks the word takes seconds
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.ClassDef):
                continue
            called = {
                n.func.id
                for n in ast.walk(node)
                if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
            }
            if called & {"read_only", "read_only_int"}:
                yield f"{file.relative_to(SOURCE)}:{node.name}", node


def test_unpickled_classes_keep_their_arrays_locked() -> None:
    """A class that forgot this would hand out writable arrays in another process."""
    found = dict(classes_with_locked_arrays())
    assert len(found) > 10
    forgot = [
        name
        for name, node in found.items()
        if not any(isinstance(base, ast.Name) and base.id == "Locked" for base in node.bases)
    ]
    assert forgot == []


def test_errors_come_back_whole(elsewhere: ProcessPoolExecutor) -> None:
    error = LimitError(
        "too fast",
        axis="X",
        quantity="velocity",
        value_si=2.0,
        limit_si=1.0,
        place=Place("job.prg", 7),
        remedy="Slow down.",
    )
    back = pickle.loads(pickle.dumps(error))
    assert (str(back), vars(back)) == (str(error), vars(error))
    machine = load_machine("lathe-winder")
    far = job_of([[0.0], [99.0]], ("X",), Feed(FeedMode.COUNT_PER_TICK, 20.0))
    with pytest.raises(LimitError, match=r"job\.prg:1"):
        elsewhere.submit(list, programmed_path(far, machine)).result(timeout=120)
