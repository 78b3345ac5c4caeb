"""A yield on the workers of a cluster: the same bits as on one computer, or one line of refusal."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

from tests.search.dying import Deadly
from tests.search.fleet import Fleet
from threadline.base import cluster as of_cluster
from threadline.base.cluster import Cluster, parse_cluster
from threadline.base.workers import working_on
from threadline.cli.main import main
from threadline.errors import LinkFaultError, OptionError
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.search.machine_yield import MachineYield
from threadline.search.yield_state import YieldState
from threadline.verdict import load_spec

TURN = "G91\nG1 X5 F1000\nG1 X-5\nM30\n"
RunCommand = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Workers that no test kills."""
    found = Fleet(tmp_path_factory.mktemp("fleet"), 1)
    yield found
    found.end()


@pytest.fixture
def two_workers(fleet: Fleet) -> Fleet:
    """A second fleet, which lives as long as the first."""
    if len(fleet.workers) < 2:
        fleet.workers.append(fleet.with_worker())
    return fleet


@pytest.fixture
def fleets(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[int], Fleet]]:
    """Start fleets whose workers and schedulers tests may kill."""
    begun: list[Fleet] = []

    def begin(workers: int) -> Fleet:
        begun.append(Fleet(tmp_path_factory.mktemp("fleet"), workers))
        return begun[-1]

    yield begin
    for one in begun:
        one.end()


@pytest.fixture
def run_command(capsys: pytest.CaptureFixture[str]) -> RunCommand:
    """Run ``threadline``; return exit status, answer, and errors without the progress."""

    def run(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main([*map(str, words)])
        captured = capsys.readouterr()
        err = [line for line in captured.err.splitlines(keepends=True) if line.startswith("error")]
        return int(ended.value.code or 0), captured.out, "".join(err)

    return run


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A short job in a folder that no worker can read."""
    monkeypatch.chdir(tmp_path)
    Path("turn.prg").write_text(TURN, encoding="utf-8")
    return Path("turn.prg")


def judged(job: Path) -> MachineYield:
    machine, options = load_machine("lathe-winder"), Options(interpolation="linear")
    plan = plan_job(open_job(job, machine, options), machine, options)
    return MachineYield(plan, load_spec(None, machine))


def bits(found: MachineYield, variants: int, at_once: int | None = None) -> list[bytes]:
    drawn = found.drawn(variants, 5, at_once=at_once)
    return [row.values.tobytes() for row in drawn.found.rows]


@pytest.fixture
def submitted(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Every task that a client sends from now on: a function and its arguments."""
    sent: list[tuple[Any, ...]] = []
    submit = distributed.Client.submit

    def noted(self: distributed.Client, *task: Any, **how: Any) -> Any:
        sent.append(task)
        return submit(self, *task, **how)

    monkeypatch.setattr(distributed.Client, "submit", noted)
    return sent


@pytest.mark.parametrize(("machine", "variants"), [("lathe-winder", 70), ("stepper-winder", 5)])
def test_an_answer_is_that_of_one_computer_to_the_bit(
    machine: str, variants: int, run_command: RunCommand, job: Path, fleet: Fleet
) -> None:
    """Side by side and one by one: count, interval, worst machine, and the file of a part."""
    words = ["yield", job, "-m", machine, "--variants", variants, "--seed", 5, "--json"]
    words += ["--interpolation", "linear"]
    here = run_command(*words)
    assert json.loads(here[1])["variants"] == variants
    assert run_command(*words, "--cluster", fleet.address) == here
    part = [*words, "--part", "2/2", "-o"]
    run_command(*part, "here.yield")
    run_command(*part, "there.yield", "--cluster", fleet.address)
    assert Path("here.yield").read_bytes() == Path("there.yield").read_bytes()


@pytest.mark.long(shown_by="test_an_answer_is_that_of_one_computer_to_the_bit")
def test_bits_do_not_depend_on_the_size_of_a_task_or_on_who_is_quick(
    job: Path, two_workers: Fleet
) -> None:
    own = judged(job)
    here = bits(own, 40)
    for size, ahead in (1, 1), (7, 16), (40, 2):
        cluster = Cluster(two_workers.address, ahead=ahead)
        try:
            with working_on(cluster):
                assert bits(own, 40, size) == here
        finally:
            cluster.close()


def test_a_plan_is_sent_once(job: Path, fleet: Fleet, submitted: list[tuple[Any, ...]]) -> None:
    """For further machines only their numbers are sent."""
    own = judged(job)
    with of_cluster.on_cluster(fleet.address, print):
        own.drawn(4, 5)
        own.drawn(9, 5)
    with_plan = [any(isinstance(part, bytes) for part in task) for task in submitted]
    assert with_plan[0] and with_plan.count(True) == 1 < len(with_plan) - 1


def test_short_items_share_a_task(
    job: Path, fleet: Fleet, submitted: list[tuple[Any, ...]]
) -> None:
    """A task costs the same for one item as for many; the last tasks are small, so nobody waits."""
    own = judged(job)
    here = bits(own, 150)
    with of_cluster.on_cluster(fleet.address, print):
        bits(own, 30, 1)  # so that the time of an item is known
        submitted.clear()
        assert bits(own, 150, 1) == here
    sent = [len(task[-1]) for task in submitted]
    assert sum(sent) == 150 and len(sent) < 50 and max(sent) >= 5 and sent[-1] == 1


@pytest.mark.long(shown_by="test_machines_that_end_every_worker_are_not_tried_for_ever")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_worker_that_ends_in_the_middle_changes_nothing(
    how: signal.Signals, job: Path, fleets: Callable[[int], Fleet]
) -> None:
    """SIGKILL stands for a computer that fails; a batch system sends SIGTERM at its wall time."""
    own, fleet = judged(job), fleets(2)
    here = bits(own, 60)
    with of_cluster.on_cluster(fleet.address, print):
        fractions: list[float] = []

        def done(count: float) -> None:
            fractions.append(count)
            if len(fractions) == 2:
                fleet.workers[0].send_signal(how)

        found = own.drawn(60, 5, done, at_once=4)
    assert [row.values.tobytes() for row in found.found.rows] == here
    assert sum(fractions) == 60 and fleet.workers[0].wait(120) is not None


@pytest.mark.long(shown_by="test_machines_that_end_every_worker_are_not_tried_for_ever")
@pytest.mark.parametrize("which", ["scheduler", "workers"])
def test_judged_machines_are_kept_when_the_cluster_dies(
    which: str, job: Path, run_command: RunCommand, fleets: Callable[[int], Fleet],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Exit status 3 and one line; the same command without the cluster goes on to the same bits."""
    words = ["yield", job, "-m", "lathe-winder", "--variants", 60, "--interpolation", "linear"]
    words += ["--seed", 5, "--json"]
    here, fleet = run_command(*words), fleets(1)
    add, batches = YieldState.add, list[int]()

    def kill(self: YieldState, found: object) -> None:
        add(self, found)  # type: ignore[arg-type]
        batches.append(1)
        if len(batches) == 2:
            dying = [fleet.scheduler] if which == "scheduler" else fleet.workers
            for one in dying:
                one.send_signal(signal.SIGKILL)
            monkeypatch.setattr(of_cluster, "WORKER_S", 1.0)
            monkeypatch.setattr(of_cluster, "CONNECT_S", 1.0)

    monkeypatch.setattr(YieldState, "add", kill)
    code, out, err = run_command(*words, "--resume", "kept", "--cluster", fleet.address)
    assert (code, out, err.count("\n")) == (3, "", 1), err
    assert fleet.address in err and "--resume" in err
    assert ("went away" if which == "scheduler" else "no worker for 1 s") in err
    lines = Path("kept").read_bytes().count(b"\n")
    assert lines >= 3  # the first line of the file, and two batches
    monkeypatch.setattr(YieldState, "add", add)
    assert run_command(*words, "--resume", "kept") == here


@pytest.mark.long(shown_by="test_machines_that_end_every_worker_are_not_tried_for_ever")
def test_a_scheduler_that_comes_back_gets_what_it_lost(
    job: Path, fleets: Callable[[int], Fleet], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(of_cluster, "CONNECT_S", 60.0)
    own, fleet = judged(job), fleets(1)
    here, fractions = bits(own, 60), []

    def done(count: float) -> None:
        fractions.append(count)
        if len(fractions) == 2:
            fleet.begin_again()

    with of_cluster.on_cluster(fleet.address, print):
        found = own.drawn(60, 5, done, at_once=4)
    assert [row.values.tobytes() for row in found.found.rows] == here
    assert sum(fractions) == 60


def test_loggers_of_distributed_are_silent(fleet: Fleet) -> None:
    """``distributed`` has its own loggers with handlers and levels, for example for clients."""
    Cluster(fleet.address).close()
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    assert "distributed.client" in names
    assert not [name for name in names if logging.getLogger(name).isEnabledFor(logging.ERROR)]


def test_machines_that_end_every_worker_are_not_tried_for_ever(
    fleets: Callable[[int], Fleet],
) -> None:
    fleet = fleets(2)
    cluster = Cluster(fleet.address)
    try:
        with pytest.raises(LinkFaultError, match="ended 2 times while they judged the same"):
            list(cluster.answers(Deadly(), [1], None))
    finally:
        cluster.close()


@pytest.mark.parametrize(
    ("name", "version"), [("Threadline", "0.0.0, source 0"), ("numpy", "1.0"), ("numba", "none")]
)
@pytest.mark.parametrize("late", [False, True])
def test_a_worker_of_another_version_is_refused_by_name(
    late: bool, name: str, version: str, job: Path, run_command: RunCommand, fleet: Fleet,
    submitted: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """This holds at the beginning, before anything is sent, and for a worker that joins later."""
    own = of_cluster.versions()
    # Workers take the function by its name, which is the name of the real function.
    monkeypatch.setattr(of_cluster, "versions", lambda: {**own, name: version})
    if late:  # when the workers are asked, there is none
        monkeypatch.setattr(distributed.Client, "run", lambda *_, **__: {})
    words = ["yield", job, "-m", "lathe-winder", "--variants", 9, "--interpolation", "linear"]
    code, out, err = run_command(*words, "--cluster", fleet.address)
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert re.search(
        rf"worker tcp://127\.0\.0\.1:\d+ of .* has {name} .* instead of {version}", err
    )
    assert "requirements/cluster.txt" in err
    assert bool(submitted) is late


def test_a_worker_that_rounds_otherwise_is_refused(
    job: Path, fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("threadline.proof.judge_runs.bits_of", lambda _: b"other")
    with (
        of_cluster.on_cluster(fleet.address, print),
        pytest.raises(LinkFaultError, match=r"worker tcp://127.* gets other bits"),
    ):
        judged(job).drawn(9, 5)


@pytest.mark.parametrize(
    "text",
    [
        "", "8786", "lab:8786", "tcp://lab.example:8786", "tcp://192.168.1.2:8786", "inproc://a:1",
        "ws://localhost:8786", "localhost", "localhost:0", "localhost:99999", "localhost:²",
        "tcp://0.0.0.0:8786", "127.0.0.1.lab:8786", "localhost.lab:8786", "tls://:8786",
    ],
)  # fmt: skip
def test_an_address_without_tls_is_of_this_computer(
    text: str, run_command: RunCommand, job: Path
) -> None:
    with pytest.raises(OptionError):
        parse_cluster(text)
    code, out, err = run_command("yield", job, "-m", "lathe-winder", f"--cluster={text}")
    assert (code, out, err.count("\n")) == (2, "", 1) and "--cluster" in err


def test_an_address_of_this_computer_is_taken() -> None:
    for text in "localhost:8786", "127.0.0.1:8786", "tcp://127.3.2.1:8786", "tcp://[::1]:8786":
        assert parse_cluster(text) == f"tcp://{text.removeprefix('tcp://')}"
    assert parse_cluster("tls://lab.example:8786") == "tls://lab.example:8786"


def test_a_scheduler_that_is_not_there_is_one_line(
    run_command: RunCommand, job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(of_cluster, "CONNECT_S", 0.5)
    code, out, err = run_command("yield", job, "-m", "lathe-winder", "--cluster", "localhost:9")
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert "tcp://localhost:9 cannot be reached" in err and "dask scheduler" in err


def test_a_scheduler_without_workers_is_one_line(
    job: Path,
    run_command: RunCommand,
    fleets: Callable[[int], Fleet],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A batch system may start the first worker late; from then on there is always one."""
    monkeypatch.setattr(of_cluster, "FIRST_S", 1.0)
    address = fleets(0).address
    code, out, err = run_command("yield", job, "-m", "lathe-winder", "--cluster", address)
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert f"{address} has had no worker for 1 s" in err and "dask worker" in err


def test_without_the_package_the_extra_is_named(
    run_command: RunCommand, job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, _, err = run_command("yield", job, "-m", "lathe-winder", "--cluster", "localhost:9")
    assert (code, err.count("\n")) == (2, 1) and 'pip install "threadline[cluster]"' in err


def test_tls_without_certificates_is_refused(
    run_command: RunCommand, job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [one for one in os.environ if one.startswith("DASK_")]:
        monkeypatch.delenv(name)
    code, _, err = run_command("yield", job, "-m", "lathe-winder", "--cluster", "tls://localhost:9")
    assert (code, err.count("\n")) == (2, 1) and "DASK_DISTRIBUTED__COMM__TLS__CA_FILE" in err


@pytest.mark.long(shown_by="test_an_answer_is_that_of_one_computer_to_the_bit")
def test_a_cluster_by_tls_gives_the_same(
    job: Path, run_command: RunCommand, tmp_path: Path
) -> None:
    """The commands are the ones in docs/cluster.md."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("needs openssl to make certificates")
    keys = tmp_path / "keys"
    keys.mkdir()
    page = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text("utf-8")
    for line in re.findall(r"^openssl .*$", page, re.M):
        subprocess.run(line.split(), cwd=keys, check=True, capture_output=True)
    tls = {
        f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(keys / "cluster.pem")
        for name in (
            "CA_FILE", "CLIENT__CERT", "SCHEDULER__CERT", "WORKER__CERT",
            "CLIENT__KEY", "SCHEDULER__KEY", "WORKER__KEY",
        )
    }  # fmt: skip
    fleet = Fleet(keys, 1, tls)
    try:
        words = ["yield", job, "-m", "lathe-winder", "--variants", 9, "--interpolation", "linear"]
        assert fleet.address.startswith("tls://")
        code = "import sys; from threadline.cli.main import main; main(sys.argv[1:])"
        asked = [sys.executable, "-c", code, *map(str, words), "--cluster", fleet.address]
        env = {**os.environ, **tls}
        there = subprocess.run(asked, env=env, capture_output=True, text=True, check=False)
        assert (there.returncode, there.stdout) == run_command(*words)[:2], there.stderr
        # A scheduler with TLS accepts nobody without its certificate.
        plain = fleet.address.replace("tls://", "tcp://")
        asked[-1] = plain
        refused = subprocess.run(asked, env=env, capture_output=True, text=True, check=False)
        assert refused.returncode == 3 and "cannot be reached" in refused.stderr
    finally:
        fleet.end()
