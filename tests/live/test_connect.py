"""``threadline connect`` against controllers that answer like their firmwares.

The answers come from logs of real controllers (grbl 1.1h, FluidNC 3.7, Marlin 2.1, RepRapFirmware
3.4) and from Moonraker's documentation of ``/printer/objects/query``.
"""

from __future__ import annotations

import json
import os
import pty
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.live import settings_link

GRBL = {
    "$I": "[VER:1.1h.20190830:]\n[OPT:V,15,128]\nok",
    "$$": "$0=10\n$1=25\n$11=0.010\n$100=80.000\n$101=80.000\n$102=400.000\n$110=6000.000\n"
    "$111=6000.000\n$112=600.000\n$120=300.000\n$121=300.000\n$122=50.000\n$130=400.000\n"
    "$131=400.000\n$132=80.000\nok",
    "M115": "error:20",
}
FLUIDNC = {
    "$I": "[VER:3.7 FluidNC v3.7.8:]\n[OPT:PHSW]\n[MSG:INFO: Machine: Router]\nok",
    "$CD": "name: Router\nboard: 6 Pack\nkinematics:\n  Cartesian:\naxes:\n"
    "  shared_stepper_disable_pin: NO_PIN\n"
    "  x:\n    steps_per_mm: 80.000000\n    max_rate_mm_per_min: 5000.000000\n"
    "    acceleration_mm_per_sec2: 200.000000\n    max_travel_mm: 300.000000\nok",
}
MARLIN = {
    "M115": "FIRMWARE_NAME:Marlin 2.1.2 (May 10 2023 12:00:00) SOURCE_CODE_URL:github.com/"
    "MarlinFirmware/Marlin PROTOCOL_VERSION:1.0\nCap:EEPROM:1\nok",
    "M503": "echo:; Steps per unit:\necho:  M92 X80.00 Y80.00 Z400.00 E93.00\n"
    "echo:; Max feedrates (units/s):\necho:  M203 X300.00 Y300.00 Z5.00 E25.00\n"
    " T:21.3 /0.0 B:20.9 /0.0\n"
    "echo:; Max Acceleration (units/s2):\necho:  M201 X3000.00 Y3000.00 Z100.00 E10000.00\n"
    "echo:; Acceleration (units/s2) (P<print-accel> R<retract-accel> T<travel-accel>):\n"
    "echo:  M204 P1000.00 R1000.00 T1000.00\n"
    "echo:; Advanced (B<min_segment_time_us> S<min_feedrate> T<min_travel_feedrate> "
    "J<junc_dev>):\necho:  M205 B20000.00 S0.00 T0.00 J0.013\nok P15 B3",
}
RRF = {
    "M115": "FIRMWARE_NAME: RepRapFirmware for Duet 2 WiFi/Ethernet FIRMWARE_VERSION: 3.4.5\nok",
    "M503": '; Configuration file\nM550 P"cnc"\nM584 X0 Y1 Z2\nM92 X80 Y80 Z400\n'
    "M566 X900 Y900 Z60\nM203 X6000 Y6000 Z180\nM201 X500 Y500 Z20\nok",
}
SECTIONS = {
    "printer": {"kinematics": "cartesian", "max_velocity": "300", "max_accel": "3000"},
    "stepper_x": {
        "microsteps": "16", "rotation_distance": "40", "position_endstop": "0",
        "position_max": "235", "step_pin": "PC2", "dir_pin": "PB9", "enable_pin": "!PC3",
    },
    "gcode_macro START": {"gcode": "\nG28\nG1 X5"},
}  # fmt: skip


def unknown(firmware: str, line: str) -> str:
    """Return the answer of a firmware to an unknown line."""
    return f'echo:Unknown command: "{line}"\nok' if firmware == "marlin" else "error:20"


@contextmanager
def controller(
    answers: Mapping[str, str], *, firmware: str = "grbl", banner: str = "", status: str = ""
) -> Iterator[tuple[str, list[str]]]:
    """Run a controller behind a TCP port; yield its address and the received lines."""
    heard: list[str] = []
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        client, _ = server.accept()
        with client:
            client.sendall(banner.encode())
            _answer(client.recv, client.sendall, heard, answers, firmware, status)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.getsockname()[1]}", heard
    finally:
        server.close()


def _answer(
    receive: Callable[[int], bytes],
    send: Callable[[bytes], object],
    heard: list[str],
    answers: Mapping[str, str],
    firmware: str,
    status: str,
) -> None:
    rest = b""
    while more := _received(receive):
        if firmware == "grbl" and b"?" in more:
            more = more.replace(b"?", b"")
            send(f"<{status or 'Idle'}|MPos:0.000,0.000,0.000>\r\n".encode())
        *lines, rest = (rest + more).split(b"\n")
        for line in (one.decode().strip() for one in lines):
            if not line and firmware == "grbl":
                send(b"ok\r\n")  # protocol.c: an empty line, for syncing
            if line:
                heard.append(line)
                text = answers.get(line, unknown(firmware, line))
                send(text.replace("\n", "\r\n").encode() + b"\r\n")


def _received(receive: Callable[[int], bytes]) -> bytes:
    """Return received bytes; nothing if the other end is gone."""
    try:
        return receive(1024)
    except OSError:
        return b""


@dataclass(frozen=True, slots=True)
class Done:
    """Return the output of a command, and its exit status."""

    exit_code: int
    stdout: str
    stderr: str


@pytest.fixture
def ran(capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    def run(*arguments: str) -> Done:
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        out, err = capsys.readouterr()
        return Done(int(stopped.value.code or 0), out, err)

    return run


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(settings_link, "STARTS_S", 0.2)
    monkeypatch.setattr(settings_link, "SILENCE_S", 0.1)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("kind", "answers", "axis", "rate"),
    [
        ("grbl", GRBL, "X", "6000 mm/min"),
        ("fluidnc", FLUIDNC, "X", "5000 mm/min"),
        ("marlin", MARLIN, "X", "18000 mm/min"),
        ("rrf", RRF, "X", "6000 mm/min"),
    ],
)
def test_settings_come_from_the_controller_and_make_a_machine(
    ran: Callable[..., Done], kind: str, answers: Mapping[str, str], axis: str, rate: str
) -> None:
    """``threadline new`` reads the file by the printed command."""
    with controller(answers, firmware="grbl" if "$I" in answers else "marlin") as (address, heard):
        done = ran("connect", address, "--json")
    assert done.exit_code == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["kind"] == kind
    assert {"setting": f"{axis} rate", "value": rate} in [
        {key: row[key] for key in ("setting", "value")} for row in answer["read"]
    ]
    assert not [line for line in heard if line not in ("$I", "$$", "$CD", "M115", "M503", "?")]
    travels = [f"travel.{letter}=300 mm" for letter in "XYZ"] if kind in ("marlin", "rrf") else []
    answered = [word for one in ("rotary=none", *travels) for word in ("--set", one)]
    made = ran(*answer["new"].split()[1:], *answered)
    assert made.exit_code == 0, made.stderr
    text = Path("my-machine/machine.toml").read_text(encoding="utf-8")
    assert ("corner_axes = true" in text) == (kind == "marlin")  # from the answer to M115


def test_a_serial_line_is_read(ran: Callable[..., Done], tmp_path: Path) -> None:
    """The line is a pseudo terminal, at a speed that has no name in termios."""
    ours, theirs = pty.openpty()
    heard: list[str] = []
    threading.Thread(
        target=_answer,
        args=(lambda n: os.read(ours, n), lambda b: os.write(ours, b), heard, MARLIN, "marlin", ""),
        daemon=True,
    ).start()
    done = ran("connect", os.ttyname(theirs), "--baud", "250000", "-o", "mine.txt")
    assert done.exit_code == 0, done.stderr
    assert "Marlin 2.1.2" in done.stdout
    assert "M203 X300.00" in (tmp_path / "mine.txt").read_text()
    assert "T:21.3" not in (tmp_path / "mine.txt").read_text()
    os.close(theirs)


@contextmanager
def moonraker(status: int, content: object) -> Iterator[str]:
    """Run a Moonraker that answers one query; yield its URL."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            assert self.path == "/printer/objects/query?configfile=config"
            self.send_response(status)
            self.end_headers()
            self.wfile.write(json.dumps(content).encode())

        def log_message(self, *_: object) -> None:
            """Write no log."""

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_klipper_is_asked_through_moonraker(ran: Callable[..., Done]) -> None:
    """Included files are in the answer: Klipper sends its combined configuration."""
    answer = {"result": {"status": {"configfile": {"config": SECTIONS}}}}
    with moonraker(200, answer) as url:
        done = ran("connect", url)
    assert done.exit_code == 0, done.stderr
    text = Path("printer.cfg").read_text()
    assert "[stepper_x]\nmicrosteps: 16\nrotation_distance: 40\n" in text
    assert "gcode: \n    G28\n    G1 X5" in text  # a value with several lines stays one value


@pytest.mark.parametrize(
    ("status", "content", "says"),
    [
        (401, {}, "trusted_clients"),
        (200, {"result": {"status": {}}}, "does not tell a configuration of Klipper"),
        (200, [1], "does not tell a configuration of Klipper"),
    ],
)
def test_a_moonraker_that_does_not_tell_is_named(
    ran: Callable[..., Done], status: int, content: object, says: str
) -> None:
    with moonraker(status, content) as url:
        done = ran("connect", url)
    assert done.exit_code == 3
    assert says in done.stderr
    assert not Path("printer.cfg").exists()


def test_a_machine_that_moves_is_not_asked(ran: Callable[..., Done]) -> None:
    with controller(GRBL, status="Run") as (address, heard):
        done = ran("connect", address)
    assert done.exit_code == 3
    assert "in the state Run" in done.stderr
    assert heard == []


@pytest.mark.parametrize(
    ("answers", "says", "code"),
    [
        ({"M115": "FIRMWARE_NAME:Smoothieware\nok"}, "a firmware whose planner is not known", 2),
        ({"M115": "ok FIRMWARE_VERSION:v0.12 FIRMWARE_NAME:Klipper"}, "ask its Moonraker", 2),
        ({**GRBL, "$$": "error:8"}, "answered 'error:8' when it was asked $$", 3),
        ({}, "does not name its firmware", 3),
    ],
)
def test_connect_reports_unreadable_settings_and_writes_nothing(
    ran: Callable[..., Done], answers: Mapping[str, str], says: str, code: int, tmp_path: Path
) -> None:
    with controller(answers, firmware="grbl" if "$I" in answers else "marlin") as (address, _):
        done = ran("connect", address)
    assert done.exit_code == code
    assert says in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "address", ["nohost", "ftp://127.0.0.1", "http://", "127.0.0.1:99999", "/", "", "grbl:"]
)
def test_malformed_address_is_refused(ran: Callable[..., Done], address: str) -> None:
    done = ran("connect", address)
    assert done.exit_code in (2, 3)
    assert done.stderr.startswith("error: ")


def test_a_file_that_is_there_is_kept(ran: Callable[..., Done], tmp_path: Path) -> None:
    (tmp_path / "grbl-settings.txt").write_text("mine")
    with controller(GRBL) as (address, _):
        done = ran("connect", address)
    assert done.exit_code == 2
    assert "is there already" in done.stderr
    assert (tmp_path / "grbl-settings.txt").read_text() == "mine"
