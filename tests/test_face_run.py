"""``tl.run``: a job over the simulated link from Python, as ``threadline run`` does it."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import threadline as tl
from threadline.errors import InputError
from threadline.live.store.run_store import opened

JOB = "G91\nG1 X5 F600\nG1 X-5\nM30\n"
pytestmark = pytest.mark.usefixtures("forked_machine")
MACHINE = "stepper-winder"


@pytest.fixture
def job(tmp_path: Path) -> Path:
    file = tmp_path / "a.gcode"
    file.write_text(JOB)
    return file


@pytest.mark.waits
def test_a_run_does_what_its_proof_says_and_is_kept(job: Path, tmp_path: Path) -> None:
    """With an existing proof, and from another thread, which gets no signals in Python."""
    proved = tl.prove(job, MACHINE, level="nominal")
    proved.write(tmp_path / "p.json")
    store = tmp_path / "runs"

    def asked() -> list[object]:
        whole = tl.run(job, MACHINE, speed=0, store=store, level="nominal")
        by_file = tl.run(job, MACHINE, speed=0, store=store, proof=tmp_path / "p.json")
        return [whole, by_file]

    with ThreadPoolExecutor(1) as other:
        for run in other.submit(asked).result():
            assert run.passed and run.ended == "completed"
            assert run.folder.parent == store and run.recording.job_sha256 == run.plan.job.sha256
            assert run.result("contour_error").measured == pytest.approx(
                proved.result("contour_error").measured, rel=1e-9
            )
    run_store = opened(store)
    assert run_store is not None
    assert [one.ended for one in run_store.index.runs()] == ["completed", "completed"]


@pytest.mark.waits
def test_an_interrupt_stops_it_on_the_path(job: Path, tmp_path: Path) -> None:
    job.write_text("G91\n" + "G1 X5 F600\nG1 X-5\n" * 20 + "M30\n")
    before = signal.getsignal(signal.SIGINT)
    store = tmp_path / "runs"

    def when_it_moves() -> None:
        sizes: set[int] = set()
        while len(sizes) < 5 and not over.wait(0.1):  # the trace grows
            sizes |= {file.stat().st_size for file in store.glob("*/*.mcap")}
        os.kill(os.getpid(), signal.SIGINT)

    over = threading.Event()
    stopping = threading.Thread(target=when_it_moves)
    stopping.start()
    try:
        run = tl.run(job, MACHINE, link="sim:slower", store=store, level="nominal")
    finally:
        over.set()
        stopping.join()
    assert run.ended == "stopped" and not run.passed
    assert "NOT PROVEN" in repr(run)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"link": "wire"}, "wire"),
        ({"speed": -1.0}, "speed= -1 is not between 0"),
        ({"override": " - "}, "override= gives no reason"),
        ({"feed": "fast"}, "feed"),
        ({"proof": "none.json"}, "none.json"),
        ({"store": __file__}, "test_face_run.py"),
        ({"pass_stops": False, "job": "G91\nG1 X5 F600\nM0\nX-5\nM30\n"}, "pass_stops=True"),
    ],
)
def test_wrong_run_is_refused_by_argument_and_keeps_nothing(
    job: Path, tmp_path: Path, words: dict[str, object], message: str
) -> None:
    if "job" in words:
        job.write_text(str(words["job"]))
    given = {"store": tmp_path / "runs", "level": "nominal"} | words
    given.pop("job", None)
    with pytest.raises(InputError) as refused:
        tl.run(job, MACHINE, **given)
    assert message in str(refused.value) and "--" not in str(refused.value)
    assert not (tmp_path / "runs").exists() or not opened(tmp_path / "runs").index.runs()


def test_a_job_out_of_spec_runs_for_a_reason_alone(tmp_path: Path) -> None:
    job = tmp_path / "a.prg"
    job.write_text("G91 G1 X50 A300 F6000\nX-50\nM30\n")
    asked = {"speed": 0, "store": tmp_path / "runs", "level": "nominal", "interpolation": "linear"}
    with pytest.raises(InputError, match="override="):
        tl.run(job, "lathe-winder", **asked)
    run = tl.run(job, "lathe-winder", **asked, override="test of the brake")
    assert not run.passed and run.ended == "completed"
    assert run.recording.origin["override"] == "test of the brake"


def test_run_keeps_the_notes_that_the_command_prints(tmp_path: Path) -> None:
    """A hold waits if it would spoil the work, and the operator has to know that."""
    job = Path(__file__).parents[1] / "examples" / "helix.gcode"
    run = tl.run(job, MACHINE, speed=0, store=tmp_path / "runs", level="nominal")
    assert any("braking at full speed would shake the load" in note for note in run.notes)
