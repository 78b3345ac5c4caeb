"""Controllers with faulty grbl: each fault is one line, and a stop always gets through."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from tests.live.grbl_model import GrblModel
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import MACHINE, go_on, meeting, program, ready, settings
from threadline.errors import CommandError, LinkFaultError
from threadline.files import RunEnd
from threadline.live import grbl_run
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_words import settings_of, status_of
from threadline.live.port import Port
from threadline.live.states import Cause, Desk, State

SOON_S = 60.0  # for a busy computer; without this limit the wait never ends


class Saying(GrblModel):
    """A controller that answers one kind of line with something else."""

    def __init__(self, asked: str, *says: str) -> None:
        super().__init__(settings())
        self.asked, self.says = asked, says

    def _do(self, line: str) -> None:
        if line != self.asked:
            super()._do(line)
            return
        for one in self.says:
            self._say(one)
        self._say("ok")


class Deaf(GrblModel):
    """A controller that does not hold."""

    def _at_once(self, byte: int) -> None:
        if byte != ord("!"):
            super()._at_once(byte)


class Idle(GrblModel):
    """A controller that answers every line and does not move."""

    def _take_move(self, line: str) -> None:
        pass


class Few(GrblModel):
    """A controller that reports a single axis from the first line on."""

    def _at_once(self, byte: int) -> None:
        if byte == ord("?") and b"G1" in self.heard:
            self._say("<Run|MPos:0.000|FS:0,0>")
        else:
            super()._at_once(byte)


@contextmanager
def flooding(content: bytes) -> Iterator[str]:
    """Yield the address of a program that sends the same for ever, and reads nothing."""
    server = socket.create_server(("127.0.0.1", 0))

    def send() -> None:
        with suppress(OSError), server.accept()[0] as client:
            while True:
                client.sendall(content)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.getsockname()[1]}"
    finally:
        server.close()
        thread.join(SOON_S)


@pytest.mark.parametrize(
    ("asked", "says"),
    [("$#", "[G54:abc]"), ("$#", "[G54:]"), ("$#", "[G92]"), ("$#", "[G54:nan,0,0,0]")],
)
def test_offsets_that_are_none_are_a_fault(asked: str, says: str) -> None:
    with meeting(Saying(asked, says)) as (one, _, _), pytest.raises(LinkFaultError, match="sent"):
        one.controller.meet()
        one.enable()
        one.home()


@pytest.mark.parametrize("says", ["[AXS:4]", "[AXS:", "[AXS:0:]"])
def test_axes_that_are_none_are_refused(says: str) -> None:
    model = Saying("$I", says)
    with meeting(model) as (one, _, _), pytest.raises(CommandError, match="has no axis A"):
        one.controller.meet()
    assert b"G1" not in model.heard


@pytest.mark.parametrize("message", ["\xb2", "9" * 5000, "-3", "", "1e9"])
def test_blocks_that_are_no_number_are_left_out(message: str) -> None:
    with meeting(Saying("$I", f"[OPT:V,{message},128]", "[AXS:4:XYZA]")) as (one, _, _):
        one.controller.meet()
        assert one.controller.blocks == 15


@pytest.mark.parametrize(
    "says", [("[OPT:V,20,64]", "[AXS:4:XYZA]"), ("[AXS:4:XYZA]", "[OPT:V,20,64]")]
)
def test_the_receive_buffer_is_read_wherever_it_stands(says: tuple[str, str]) -> None:
    """grbl-Mega-5X names its axes first: ``[VER:1.2d.20210930:]``, ``[AXS:...]``, ``[OPT:...]``."""
    with meeting(Saying("$I", *says)) as (one, _, _):
        one.controller.meet()
        assert (one.controller.blocks, one.controller.room) == (20, 64)


def test_settings_that_are_texts_are_no_numbers() -> None:
    """Some controllers list their network's address and name among the settings."""
    found = settings_of(
        ["$100=250.000 (x, step/mm)", "$110=1.2.3", "$74=a house", "$302=192.168.5.1", "$5=."]
    )
    assert found[100] == 250.0
    assert all(np.isnan(found[number]) for number in (110, 74, 302, 5))
    assert settings_of([f"${'9' * 5000}=1", "$N0=G21", "$=1"]) == {}


@pytest.mark.parametrize("value", [0.0, -3000.0])
def test_an_axis_that_could_not_move_is_refused(value: float) -> None:
    model = GrblModel({**settings(), 110: value})
    with meeting(model) as (one, _, _), pytest.raises(CommandError, match="the speed of X"):
        one.controller.meet()


def test_a_number_of_thousands_of_digits_is_no_report() -> None:
    assert status_of(f"<Hold:{'1' * 5000}|MPos:0,0,0,0>") is None
    assert status_of("<Hold:0|MPos:0,0,0,0>") is not None


@pytest.mark.long(but="content0")
@pytest.mark.parametrize(
    "content", [b"x" * 4096, b"[MSG:x]\n" * 512, b"<Idle|MPos:0,0,0,0>\n" * 256]
)
def test_meeting_gives_up_on_a_peer_that_never_stops_sending(content: bytes) -> None:
    with flooding(content) as address:
        port = Port(address)
        began = time.monotonic()
        with pytest.raises(LinkFaultError):
            Controller(port, MACHINE).meet()
        port.close()
    assert time.monotonic() - began < SOON_S


@pytest.mark.parametrize("content", [b"x" * 4096, b"[MSG:x]\n" * 512])
def test_flood_of_text_from_the_controller_does_not_block_the_operator(content: bytes) -> None:
    """The operator, who may have asked for a stop, is served in between."""
    with flooding(content) as address:
        port, desk = Port(address), Desk()
        one = grbl_run.GrblRun(Controller(port, MACHINE), desk, MemorySink())
        one.state = State.RUNNING
        one._heard_s = began = time.monotonic()
        one._listen()
        assert time.monotonic() - began < SOON_S
        port.close()
        desk.close()


def test_lines_that_were_taken_and_not_done_are_no_completed_run() -> None:
    with meeting(Idle(settings())) as (one, _, _):
        ready(one, program("G1 A10 X20 F6000\n"))
        go_on(one)
        ended, text = one.ended or (None, "")
        assert ended is RunEnd.FAULT
        assert "has received every line, and stands" in text
        assert one.state is State.FAULT


def test_a_controller_that_does_not_hold_is_reset() -> None:
    model = Deaf(settings(), faster=0.02)
    with meeting(model) as (one, desk, _):
        ready(one, program())
        go_on(one, lambda: model.state == "Run")
        desk.ask(Cause.STOP)
        began = time.monotonic()
        go_on(one)
        assert time.monotonic() - began >= 2.0 * one.controller.brakes_s + grbl_run._HOLDS_S
        assert one.ended is not None and one.ended[0] is RunEnd.FAULT
        assert "told to hold, reports Run, and was reset" in one.ended[1]
        assert not model.blocks


def test_reports_of_too_few_axes_end_a_run() -> None:
    with meeting(Few(settings())) as (one, _, _):
        ready(one, program())
        go_on(one)
        assert one.ended is not None and one.ended[0] is RunEnd.FAULT
        assert one.ended[1].startswith("the controller reports 1 axes; the controller was silent")
