"""Fixtures that every folder of tests shares."""

from __future__ import annotations

import gc
import importlib
import math
import os
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests import long_tests
from tests.long_turns import LONG_S, ask_for_turns

# As in the program (cli/start.py): on small matrices threads of OpenBLAS wait for each other
# longer than they work, on a loaded machine a thousand times as long. Read when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# While modules are imported nothing becomes garbage, and each full pass over all that they made
# takes half a second: without a pass the tests are collected in two thirds of the time.
gc.disable()

settings.register_profile(
    "fixed",
    derandomize=True,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("fixed")

# Assertions in these modules show their values, as in tests; some modules are imported for it.
pytest.register_assert_rewrite("tests.live.bench", "tests.live.kill_bench", "tests.panel.bench")

ROOT = Path(__file__).resolve().parent.parent
SHARED_SAMPLES = ROOT.parent / "shared" / "samples"
NO_SAMPLES = "no folder of sample files beside this checkout"
NO_FIRMWARE = "a firmware that is built by hand, from sources that no package index has: "
"""The two reasons to skip that hold in CI, too: not everyone can have those."""


# Fixtures import the tested code: the process that starts the workers does not need it.


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add options: two of them let a run of the suite continue an earlier one."""
    group = parser.getgroup("threadline")
    group.addoption(
        "--note-passed", type=Path, metavar="FILE", help="write the tests that pass into a file"
    )
    group.addoption(
        "--except-noted",
        type=Path,
        metavar="FILE",
        help="leave out the tests that such a file lists; without the file run all",
    )
    group.addoption(
        "--without-long", action="store_true", help="leave out the tests that are marked as long"
    )


class NotePassed:
    """Writes the passed tests, one a line; tests whose fixture failed are left out.

    Parameters
    ----------
    file
        The file, written at the end of the run.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._passed: set[str] = set()
        self._failed: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record the result of one part of a test: its setup, its call, its end."""
        if report.failed:
            self._failed.add(report.nodeid)
        elif report.passed and report.when == "call":
            self._passed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write the file."""
        noted = sorted(self._passed - self._failed)
        self._file.write_text("".join(f"{nodeid!r}\n" for nodeid in noted), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Record in the process that hears of every test: under xdist the workers do not."""
    file = config.getoption("note_passed", None)
    if file is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(NotePassed(file))
    config.pluginmanager.register(long_tests.CountLong())


def _leave_out_noted(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the tests that an earlier run has recorded as passed."""
    file = config.getoption("except_noted", None)
    if file is None or not file.is_file():
        return
    noted = frozenset(file.read_text("utf-8").splitlines())
    left_out = [item for item in items if repr(item.nodeid) in noted]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if repr(item.nodeid) not in noted]


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> Generator[None, int, int]:
    """Have a quarter more workers than cores, two at least: tests of live machines wait."""
    cores = yield
    return cores + max(2, cores // 4)


def _waits(item: pytest.Item) -> bool:
    """Return whether a test waits for machines that move in real time."""
    live = item.nodeid.startswith("tests/live/") and "/store/" not in item.nodeid
    return live or item.get_closest_marker("waits") is not None


def pytest_collection(session: pytest.Session) -> None:
    """Import the test files in a worker, each worker in another order.

    pytest rewrites the assertions of changed files, which takes longer than everything else before
    the tests. In the same order each worker would do that for all files; so each worker does a
    share of them, and reads the files of the others.
    """
    number = os.environ.get("PYTEST_XDIST_WORKER", "")[2:]
    if not number or session.config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    first = len(files) * int(number) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    for file in files[first:] + files[:first]:
        # A file that cannot be imported, or is skipped as a whole, is reported at collection.
        with suppress(Exception, pytest.skip.Exception):
            importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Give tests that compute longer turns on their core, which two workers share.

    With the usual turns of 1.4 ms, four processes that prove the winder's program take a fifth more
    processor time, because others have filled the caches. Tests of live machines have short turns,
    which come in between.
    """
    live = _waits(item) or item.nodeid.startswith("tests/panel/")
    ask_for_turns(0.0 if live else LONG_S)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let two workers begin with the tests that wait for live machines and browsers.

    The other workers compute meanwhile. Each worker gets equally many tests, in this order, and
    takes tests from the end of another queue when its own is empty: waiting tests at the end of a
    queue would leave the cores idle. LinuxCNC runs only once on a computer, so its tests are in one
    queue; otherwise one worker would wait for the other.
    """
    long_tests.leave_out(config, items)
    _leave_out_noted(config, items)
    share = len(items) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    waiting = [item for item in items if _waits(item)]
    others = [item for item in items if not _waits(item)]
    panel = [item for item in others if item.nodeid.startswith("tests/panel/")]
    rest = [item for item in others if not item.nodeid.startswith("tests/panel/")]
    beside = max(share - len(waiting), 0)
    items[:] = [*waiting, *rest[:beside], *panel, *rest[beside:]]


def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave the modules' objects out of later garbage collections, and collect seldom.

    Collecting took a twentieth of the time of the tests, and no test depends on it. Freed memory is
    kept, as in judging many machines; otherwise half of the pages were requested again. The small
    suites that test these rules compute nothing.
    """
    if not any(item.path.is_relative_to(ROOT) for item in session.items[:1]):
        gc.enable()
        return
    from threadline.proof.judge_runs import keep_freed_memory

    keep_freed_memory()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[Any]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn a skipped test into a failed one in CI: its reference is missing there."""
    report = yield
    if os.environ.get("CI") == "true" and report.skipped and not hasattr(report, "wasxfail"):
        reason = str(call.excinfo.value) if call.excinfo else "no reason given"
        if not reason.startswith((NO_SAMPLES, NO_FIRMWARE)):
            report.outcome = "failed"
            report.longrepr = f"skipped, which CI does not allow: {reason}"
    return report


@pytest.fixture(autouse=True, scope="session")
def nothing_said_of_compiling() -> Iterator[None]:
    """Leave out the message about compiling: which test compiles depends on their order."""
    from threadline.cli import messages

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(messages, "COMPILING_S", math.inf)
        yield


COARSE_GRID: dict[str, Any] = {"points": 8, "near": 1, "inside": 2, "beside": (-3, 3)}


@pytest.fixture
def coarse_scan() -> Iterator[None]:
    """Let a search for the fastest feed try a tenth as many feeds at each share of the limits.

    For tests that use its answer; ``tests/search`` tests the answer itself.
    """
    from threadline.search.fastest import Grid
    from threadline.search.paced import Effort, searching_with

    with searching_with(Effort(finest=Grid(**COARSE_GRID))):
        yield


@pytest.fixture
def coarse_search() -> Iterator[None]:
    """Let such a search also try only two shares of the limits."""
    from threadline.search.fastest import Grid
    from threadline.search.paced import Effort, searching_with

    with searching_with(Effort(shares=(1.0, 0.25), finest=Grid(**COARSE_GRID))):
        yield


@pytest.fixture
def forked_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make simulated machines forks of the test's process, which has imported everything.

    For tests of such a machine's work; ``tests/live/test_checked.py`` and ``test_rehearsed.py``
    start new processes.
    """
    from tests.live.kill_bench import forked_link
    from threadline.live import sim_process

    monkeypatch.setattr(sim_process, "process_link", forked_link)


@pytest.fixture
def examples() -> Path:
    """The folder of jobs that belong to the project."""
    return ROOT / "examples"


@pytest.fixture
def shared_samples() -> Path:
    """The folder of files from other programs; it exists only on the project's own machines."""
    if not SHARED_SAMPLES.is_dir():
        if os.environ.get("CI") == "true" and SHARED_SAMPLES.parent.is_dir():
            pytest.fail(f"{SHARED_SAMPLES} is missing")
        pytest.skip(NO_SAMPLES)
    return SHARED_SAMPLES
