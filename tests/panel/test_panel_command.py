"""``threadline panel`` as a program: its refusals, and its end."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import uvicorn
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.panel.bench import PROGRAM, Operator
from tests.panel.test_panel_killed import Spoken
from threadline.cli.main import main
from threadline.panel import server

WITH_PAGE = (
    "import pathlib, sys; from threadline.panel import server; "
    "server.PAGE = pathlib.Path(sys.argv.pop(1)); from threadline.cli.start import run; run()"
)
"""The program, with the page of the panel in the folder that its first argument names."""


@pytest.fixture(autouse=True)
def page(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a page to serve, because a fresh checkout has none."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "index.html").write_text("the page", "utf-8")
    monkeypatch.setattr(server, "PAGE", folder)
    return folder


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--link", "mill"], "unknown link 'mill'"),
        (["--link", "hal:mill"], "there is no link hal:mill"),
        (["--link", "grbl:127.0.0.1:23", "--speed", "2"], "need the simulated machine"),
        (["--host", "0.0.0.0"], "anyone who can reach this computer could move the machine"),
        (["--token", "short"], "--token has 5 characters, the least is 16"),
        (["nowhere"], "'nowhere' is no folder"),
        (["--host", "203.0.113.7", "--token", "x" * 16], "cannot listen at 203.0.113.7:"),
        (
            ["--host", "nosuch.invalid", "--token", "x" * 16],
            "--host nosuch.invalid has to be an address of this computer.\n",
        ),
        (["--host", ""], "--host '' is no address"),
        (["--host", "", "--token", "x" * 16], "--host '' is no address"),
        (["--host", "a..b", "--token", "x" * 16], "--host 'a..b' is no address"),
        (["--token", " " * 16], "--token holds ' ', which an HTTP header does not allow"),
        (
            ["--token", "x" * 16 + "\n\xe4"],
            r"--token holds '\n', '\xe4', which an HTTP header does not",
        ),
        (["--link", "grbl:localhost:99999"], "port 99999 is not between 1 and 65535"),
        (["--store", ""], "Invalid value for '--store': it is empty; name a folder, or . for this"),
        (["--store", "a-file"], "'a-file' is no folder of runs. Give the folder with --store"),
        (["--store", "a-file/runs"], "'a-file/runs' is no folder of runs: 'a-file' is a file"),
    ],
)
def test_panel_reports_wrong_options_in_one_line(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("a-file").touch()
    with pytest.raises(SystemExit) as ended:
        main(["panel", "-m", "lathe-winder", *words])
    assert ended.value.code == 2
    errors = capsys.readouterr().err
    assert says in errors
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--link", "grbl:localhost:99999"], "port 99999 is not between 1 and 65535"),
        (["--link", "hal:mill"], "there is no link hal:mill"),
        (["--store", ""], "Invalid value for '--store': it is empty; name a folder"),
        (["--store", "a-file"], "'a-file' is no folder of runs"),
    ],
)
def test_a_run_is_refused_before_its_job_is_read(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The job is not a program: if it were read first, that would be the error."""
    monkeypatch.chdir(tmp_path)
    Path("a-file").touch()
    Path("job.prg").write_text("none", "utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["run", "job.prg", "-m", "lathe-winder", *words])
    assert ended.value.code == 2
    assert says in capsys.readouterr().err
    assert {file.name for file in tmp_path.iterdir()} == {"a-file", "job.prg"}


def test_a_port_that_another_has_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SystemExit) as ended:
            main(["panel", "-m", "lathe-winder", "--port", str(port)])
    assert ended.value.code == 2
    assert f"cannot listen at 127.0.0.1:{port}: Address already in use" in capsys.readouterr().err


def test_panel_without_its_page_says_how_to_build_it(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (page / "index.html").unlink()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(uvicorn.Server, "run", lambda *_: pytest.fail("it serves"))
    with pytest.raises(SystemExit) as ended:
        main(["panel", "-m", "lathe-winder"])
    assert ended.value.code == 2
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err == (
        "error: [OPTION] the page of the panel was not built in this checkout. Run: make panel\n"
    )


@pytest.mark.parametrize("host", ["::1", "[::1]"])
def test_an_address_of_ipv6_stands_in_brackets(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The address is kept and nothing is served, because a computer may have no IPv6."""
    asked = []

    def listen(address: tuple[str, int], *, family: int, **_: object) -> socket.socket:
        asked.append((address, family))
        return socket.socket()

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(socket, "create_server", listen)
    monkeypatch.setattr(uvicorn.Server, "run", lambda _, sockets: sockets[0].close())
    with pytest.raises(SystemExit) as ended:
        main(["panel", "-m", "lathe-winder", "--host", host, "--port", "8799"])
    assert not ended.value.code
    assert asked == [(("::1", 8799), socket.AF_INET6)]
    assert "is at http://[::1]:8799/ (Ctrl-C" in capsys.readouterr().out


def _state(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/state", timeout=100) as answer:
        return str(json.load(answer)["state"])


@contextmanager
def panel(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a panel, and yield it with its port once its machine has answered."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    panel = subprocess.Popen(
        [
            sys.executable, "-P", "-c", WITH_PAGE, str(server.PAGE), "panel", "-m", "lathe-winder",
            "--port", str(port), *options,
        ],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=dict(os.environ),
    )  # fmt: skip
    try:
        state, end = "", time.monotonic() + 200.0
        while state != "disabled" and time.monotonic() < end:
            assert panel.poll() is None
            time.sleep(0.2)
            try:
                state = _state(port)
            except (urllib.error.URLError, ConnectionError):
                continue
        assert state == "disabled"
        yield panel, port
    finally:
        panel.kill()
        panel.wait()
        for pipe in (panel.stdout, panel.stderr):
            assert pipe is not None
            pipe.close()


def _begins(port: int) -> str:
    return f"The panel of lathe-winder is at http://127.0.0.1:{port}/ (Ctrl-C stops and ends)\n"


def test_panel_starts_and_ends_its_own_processes(tmp_path: Path) -> None:
    with panel(tmp_path, "--link", "sim:slower") as (process, port):
        half = [socket.create_connection(("127.0.0.1", port)) for _ in range(300)]
        stop = urllib.request.Request(f"http://127.0.0.1:{port}/api/stop", b"", method="POST")
        with urllib.request.urlopen(stop) as answer:
            assert answer.status == 204
        assert half[0].recv(1) == b""  # the oldest connections are dropped
        for one in half:
            one.close()
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=100)
    assert out == _begins(port)
    assert process.returncode == 128 + signal.SIGTERM
    assert err == (
        "the panel ends: the machine was stopped, and is disabled\n"
        "error: terminated; nothing was left half-written\n"
    )
    assert list(tmp_path.iterdir()) == []  # without a run there is no folder of runs


@pytest.mark.long(shown_by="test_panel_starts_and_ends_its_own_processes")
def test_no_python_file_of_a_project_is_run(tmp_path: Path) -> None:
    """Owner, machine and readers import the library's modules, whatever files a project has."""
    (tmp_path / "there.prg").write_text(PROGRAM, "utf-8")
    for name in ("token", "secrets", "numpy", "asyncio", "socket", "threadline"):
        (tmp_path / f"{name}.py").write_text("open('was-run', 'w')\nraise SystemExit(9)\n", "utf-8")
    with panel(tmp_path, "--link", "sim:slower") as (_, port):
        url = f"http://127.0.0.1:{port}/api/programs/there.prg/preview"
        try:
            urllib.request.urlopen(url, timeout=100).close()
        except urllib.error.HTTPError as error:
            with error:
                assert "takes longer than" in error.read().decode()  # on a busy computer
    assert not (tmp_path / "was-run").exists()


@pytest.mark.long(shown_by="test_panel_starts_and_ends_its_own_processes")
def test_ctrl_c_in_a_jog_stops_the_machine_and_is_no_error(tmp_path: Path) -> None:
    """A browser is connected, has control, and keeps renewing its jog.

    The machine does not run in real time, where late reports on a busy computer are a fault. A jog
    that was renewed too late has ended, and is started again.
    """
    with panel(tmp_path, "--speed", "2") as (process, port):
        address = f"127.0.0.1:{port}"
        with connect(
            f"ws://{address}/api/live", origin=f"http://{address}", max_size=None, close_timeout=1
        ) as socket_:
            anna = Operator(Spoken(socket_))
            anna.ready()
            while anna.x_mm() < 5.0 or anna.state["state"] != "jogging":
                if anna.state["state"] == "idle":
                    anna.ask("jog", axis="X", share=1.0)
                anna.ask("renew")
                anna.until("state")
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=100)
    assert out == _begins(port) + "The panel has ended: the machine was stopped, and is idle.\n"
    assert process.returncode == 0
    assert err == ""


@pytest.mark.long(shown_by="test_panel_starts_and_ends_its_own_processes")
def test_panel_ends_quietly_during_a_request(tmp_path: Path) -> None:
    """A drawing of 7 MB in one line is being read; earlier this broke the end of the panel."""
    head = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9" width="9mm" height="9mm">'
    with panel(tmp_path) as (process, port):
        address = f"127.0.0.1:{port}"
        with connect(
            f"ws://{address}/api/live", origin=f"http://{address}", close_timeout=1
        ) as live:
            live.send(b"\xff", text=True)
            with pytest.raises(ConnectionClosed) as closed:
                live.recv(100.0)
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1007
        drawing = head + b"<g/>" * 900_000 + b"</svg>"
        with socket.create_connection(("127.0.0.1", port)) as asks:
            asks.sendall(
                f"POST /api/drawing/shapes?name=a.svg HTTP/1.1\r\nHost: {address}\r\n"
                f"Origin: http://{address}\r\nContent-Length: {len(drawing)}\r\n\r\n".encode()
                + drawing
            )
            time.sleep(2.0)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=100)
    assert (process.returncode, err) == (0, "")
    assert out.endswith("The panel has ended: the machine was stopped, and is disabled.\n")
