"""Commands while the panel judges, checks and calculates, and after a link was lost."""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.live.bench import winder
from tests.panel import bench
from tests.panel.bench import Known, Operator, operator, proven, served
from threadline.cli.panel_ import to_standard_error
from threadline.errors import CommandError
from threadline.live.guards import clock_s
from threadline.panel import owner_process as owner_link
from threadline.panel import stored_runs
from threadline.panel.calculation import Calculation
from threadline.panel.owner_process import OwnerLink
from threadline.panel.panel import Panel
from threadline.panel.protocol import Calculate, Figures
from threadline.panel.stored_runs import StoredRuns

ASKED = Calculate(what="calculate", program="there.prg")


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    proven(folder)
    return folder


@contextmanager
def held(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> Iterator[threading.Event]:
    """Make a function wait until an event is set; the end of the block sets it."""
    go_on, real = threading.Event(), getattr(owner, name)

    def waits(*given: Any) -> Any:
        go_on.wait(60.0)
        return real(*given)

    monkeypatch.setattr(owner, name, waits)
    try:
        yield go_on
    finally:
        go_on.set()


def started(anna: Operator) -> str:
    assert anna.act("calculate", program="there.prg") == ""
    return str(anna.until("state")["proven"]["proof"])


SAFE = {"disable", "home", "jog", "step", "zero", "zero-axis"}
"""What never waits for the judge, for a check or for a calculation."""


def test_a_machine_is_switched_off_while_its_last_run_is_judged(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        held(monkeypatch, stored_runs, "judged_apart") as judge,
        served(project) as client,
        operator(client) as anna,
    ):
        anna.ready()
        assert anna.act("start", proof=started(anna)) == ""
        anna.see("running")
        anna.say(type="stop")
        anna.see("idle")
        while anna.until("state")["busy"] != "the last run is being judged":
            pass
        assert set(anna.state["allowed"]) >= SAFE
        assert not {"start", "calculate"} & set(anna.state["allowed"])
        refused = anna.act("calculate", program="there.prg")
        assert "the machine is idle, and the last run is being judged. Wait." in refused
        assert anna.act("step", axis="X", by=1e-3) == ""
        anna.see("idle")
        assert anna.act("home") == ""
        assert anna.act("disable") == ""
        assert anna.see("disabled")["progress"]["verdict"] == ""
        judge.set()
        while not anna.until("state")["progress"]["verdict"]:
            pass
        assert anna.state["busy"] == ""


@pytest.mark.parametrize("what", ["disable", "home"])
def test_a_start_that_is_being_checked_is_given_up(
    project: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    with (
        held(monkeypatch, StoredRuns, "_prepared") as check,
        served(project) as client,
        operator(client) as anna,
    ):
        anna.ready()
        number = anna.ask("start", proof=started(anna))
        while anna.until("state")["busy"] != "a start is being checked":
            pass
        assert set(anna.state["allowed"]) >= SAFE
        assert anna.act(what) == ""
        check.set()
        while (answer := anna.until("answer"))["number"] != number:
            pass
        assert answer["text"] == f"it was not begun: the command {what!r} came meanwhile"
        anna.allows("calculate")
        assert anna.state["progress"] is None  # no run was opened


def test_a_machine_is_switched_off_while_a_program_is_calculated(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begin(self: Known, *_: Any) -> None:
        self.share = 0.25

    monkeypatch.setattr(Known, "begin", begin)
    with served(project) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        assert anna.until("state")["busy"] == "a program is being calculated"
        assert set(anna.state["allowed"]) >= SAFE | {"cancel"}
        assert "calculate" not in anna.state["allowed"]
        assert anna.act("disable") == ""


# --- calculations that are cancelled, or never begin --------------------------------------


def calculated(folder: Path, what: Any) -> list[Figures | str]:
    """Run a function on a calculation in an event loop, and return its messages."""
    answers: list[Figures | str] = []

    async def work() -> None:
        calculation = Calculation(winder(), None, folder, folder)
        await what(calculation, answers.append)
        assert calculation.share is None
        await calculation.close()

    asyncio.run(work())
    return answers


@pytest.mark.parametrize("turns", [0, 1, 2, 5])
def test_a_calculation_that_is_cancelled_at_once_is_over(tmp_path: Path, turns: int) -> None:
    """This holds even before its task has taken a step: another calculation can begin."""

    async def cancelled(calculation: Calculation, tell: Any) -> None:
        for _ in range(2):
            calculation.begin(ASKED, tell)
            with pytest.raises(CommandError, match="a calculation is under way"):
                calculation.begin(ASKED, tell)
            for _ in range(turns):
                await asyncio.sleep(0)
            calculation.cancel()
            async with asyncio.timeout(60.0):
                while calculation.share is not None:
                    await asyncio.sleep(0.01)

    assert calculated(tmp_path, cancelled) == []


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (OSError(11, "no more processes"), "cannot be started: no more processes"),
        (ValueError("4711"), "the calculation has failed: 4711"),
    ],
)
def test_a_calculation_that_cannot_be_started_is_told_and_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, says: str
) -> None:
    async def no_process(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(asyncio, "create_subprocess_exec", no_process)

    async def refused(calculation: Calculation, tell: Any) -> None:
        calculation.begin(ASKED, tell)
        async with asyncio.timeout(60.0):
            while calculation.share is not None:
                await asyncio.sleep(0.01)

    (answer,) = calculated(tmp_path, refused)
    assert isinstance(answer, str)
    assert says in answer


# --- a link that is lost ------------------------------------------------------------------


def test_a_lost_link_is_begun_anew(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine's process is gone and its owner is not: only a new link helps."""
    ends: list[socket.socket] = []
    real = bench.machine_thread

    def noted(end: socket.socket, *given: Any) -> None:
        ends.append(end)
        real(end, *given)

    monkeypatch.setattr(bench, "machine_thread", noted)
    with served(project) as client, operator(client) as anna:
        anna.ready()
        ends[0].shutdown(socket.SHUT_RDWR)
        while anna.until("state")["state"] != "fault":
            pass
        assert "gone" in anna.state["why"]
        assert anna.state["allowed"] == ["reconnect", "calculate"]
        assert "Reconnect." in anna.act("reset")
        assert anna.act("reconnect") == ""
        anna.until("state")
        anna.see("disabled")
        assert anna.state["axes"]["X"]["commanded"] is None
        assert anna.act("enable") == ""
        assert anna.act("home") == ""
        anna.see("idle")


def test_an_owner_that_cannot_be_started_is_told() -> None:
    def none() -> Any:
        raise OSError(12, "no memory")

    async def begun() -> OwnerLink:
        link = OwnerLink(none)
        link.connect(lambda _: None)
        return link

    assert asyncio.run(begun()).gone == (
        "the process that owns the machine cannot be started: no memory"
    )


def test_axes_that_were_never_homed_have_no_place(project: Path) -> None:
    with served(project) as client, operator(client) as anna:
        anna.take().see("disabled")

        def places() -> set[float | None]:
            axes = anna.state["axes"].values()
            return {at[kind] for at in axes for kind in ("commanded", "measured", "load")}

        assert places() == {None}
        assert anna.act("enable") == ""
        anna.see("enabled")
        assert places() == {None}
        assert anna.act("home") == ""
        anna.see("idle")
        assert {at["commanded"] for at in anna.state["axes"].values()} == {0.0}
        assert anna.act("disable") == ""
        anna.see("disabled")
        assert places() == {None}


def test_request_from_before_a_sleep_is_refused(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No motion begins from a request that waited while the computer slept."""
    with served(project) as client, operator(client) as anna:
        anna.ready()
        monkeypatch.setattr(owner_link, "clock_s", lambda: clock_s() - 60.0)
        assert "it was asked for 60 s ago" in anna.act("step", axis="X", by=1e-3)
        assert "60 s ago" in anna.act("disable")
        anna.say(type="stop")
        assert anna.until("state")["state"] == "idle"


# --- errors that no caller sees -----------------------------------------------------------


def test_an_error_that_ends_the_states_is_logged(
    project: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def beat(_: Panel) -> None:
        raise RuntimeError("4711")

    monkeypatch.setattr(Panel, "beat", beat)
    with (
        caplog.at_level(logging.ERROR, "asyncio"),
        pytest.raises(RuntimeError, match="4711"),
        served(project) as client,
    ):
        assert client.post("/api/stop").status_code == 204
        assert "no states are sent any more" in caplog.text


def test_errors_of_asyncio_are_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without the handler nobody writes them, because libraries are silenced."""
    monkeypatch.setattr(logging, "lastResort", None)
    log = logging.getLogger("asyncio")
    monkeypatch.setattr(log, "handlers", [to_standard_error()])

    async def work() -> None:
        asyncio.get_running_loop().call_exception_handler({"message": "no files left"})
        asyncio.get_running_loop().call_exception_handler(
            {"message": "at the end", "exception": asyncio.CancelledError()}
        )

    asyncio.run(work())
    errors = capsys.readouterr().err
    assert "error of the panel: no files left" in errors
    assert "at the end" not in errors
