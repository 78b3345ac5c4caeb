"""Homing takes time and can be stopped; a refused braking command is sent again."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from tests.live.bench import Bench, Wire, table_of_counts, there_and_back, winder
from tests.live.kill_bench import child
from tests.live.memory_sink import MemorySink
from threadline.files import RunEnd
from threadline.live import sim_process
from threadline.live.executor import Executor
from threadline.live.states import Cause, Desk, State
from threadline.live.supervised import run_commands
from threadline.live.wire import Connection, Message

ROWS = there_and_back(cruise=40)


@contextmanager
def in_real_time() -> Iterator[Connection]:
    """Yield the link to a simulated machine in a fork of this process."""
    ours, theirs = socket.socketpair()

    def serve() -> None:
        ours.close()
        sim_process.serve(theirs, winder(), np.zeros(3, np.int64), 1.0)

    pid = child(serve)
    theirs.close()
    connection = Connection(ours)
    try:
        yield connection
    finally:
        connection.close()
        os.waitpid(pid, 0)


def test_a_stop_ends_homing_at_once_and_it_is_not_homed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stop comes after the begin of homing, which lasts three times as long here."""
    homing_s = 3.0 * sim_process.HOMING_S
    monkeypatch.setattr(sim_process, "HOMING_S", homing_s)
    desk, sink = Desk(), MemorySink()
    with in_real_time() as link:
        executor = Executor(link, winder(), desk, sink, speed=1.0)
        executor.connect()
        executor.enable()
        send = link.send

        def send_and_stop(message: Message) -> None:
            send(message)
            if message.kind == "home":
                desk.ask(Cause.STOP)

        with monkeypatch.context() as asked:
            asked.setattr(link, "send", send_and_stop)
            executor.home()
        assert [cause for _, _, cause, _ in sink.log] == [
            Cause.ENABLE, Cause.HOME, Cause.STOP, Cause.AT_REST_UNHOMED,
        ]  # fmt: skip
        assert executor.state is State.ENABLED
        began = time.monotonic()
        executor.home()  # nothing of the stop is left
        assert time.monotonic() - began >= homing_s
        assert executor.state is State.IDLE
        executor.close()
    desk.close()


def test_a_run_that_is_stopped_while_it_homes_never_begins() -> None:
    desk, sink, sent = Desk(), MemorySink(), list[str]()

    class Slow(Wire):
        """A link that answers only after somebody stops it."""

        def send(self, message: Message) -> None:
            sent.append(message.kind)
            if message.kind == "home":
                desk.ask(Cause.STOP)
            elif message.kind == "stop-home":
                self._receive(Message("refused", {"what": "home", "why": "it was stopped"}))
            else:
                super().send(message)

    @contextmanager
    def link() -> Iterator[Slow]:
        yield Slow(winder())

    ended, text, _ = run_commands(
        table_of_counts(ROWS), winder(), link(), desk, sink, speed=0.0  # type: ignore[arg-type]
    )  # fmt: skip
    assert (ended, text) == (RunEnd.STOPPED, "stopped by the operator while it homed")
    assert sent == ["enable", "home", "stop-home", "leave"]
    desk.close()


@pytest.mark.parametrize("cause", [Cause.HOLD, Cause.STOP])
def test_a_braking_that_is_refused_comes_again_later(cause: Cause) -> None:
    """Its tick was past when it arrived: nothing is lost, and it brakes at the next report."""
    bench = Bench().ready()
    refused = list[int]()
    takes = bench.wire.machine.take

    def take(message: Message) -> None:
        if message.kind == "refill" and asked and not refused:
            refused.append(int(message.head["first"]))
            bench.wire._receive(Message("refused", {"what": "refill", "why": "that tick is past"}))
        else:
            takes(message)

    bench.wire.machine.take = take  # type: ignore[method-assign]
    asked = list[bool]()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(60)
    asked.append(True)
    bench.desk.ask(cause)
    if cause is Cause.HOLD:
        bench.go_on(110)
        assert bench.executor.state is State.HOLDING
        bench.desk.ask(Cause.RESUME)
        bench.go_on()
        assert bench.executor.ended == (RunEnd.COMPLETED, "")
        commanded = bench.commanded()
        assert np.array_equal(commanded[-1], ROWS.sum(axis=0))  # no row is skipped
        assert (commanded[100:110] == commanded[100]).all()
    else:
        bench.go_on()
        assert bench.executor.ended == (RunEnd.STOPPED, "stopped by the operator")
        commanded = bench.commanded()
        still = np.flatnonzero((np.diff(commanded, axis=0) == 0).all(axis=1))
        after = still[still > 60][0]
        assert after <= refused[0] + 20  # a tenth of a second, braking included
        assert (commanded[after:] == commanded[after]).all()
    assert refused


def test_positions_from_before_homing_are_forgotten() -> None:
    """A frame goes home: the reported place before homing is not its place now."""
    bench = Bench().ready()
    bench.executor.latest = {"X.commanded": 0.06, "X.load": 0.06, "door.input": 1.0}
    bench.executor.home()
    assert bench.executor.state is State.IDLE
    assert bench.executor.latest == {"door.input": 1.0}


def test_values_in_the_reply_to_homing_are_known() -> None:
    """Earlier positions are still forgotten."""
    bench = Bench().ready()
    bench.wire.machine._at_home_samples = lambda: {"X.load": np.zeros(1), "door.input": np.ones(1)}
    bench.executor.latest = {"X.commanded": 0.06, "X.load": 0.06, "door.input": 0.0}
    bench.executor.home()
    assert bench.executor.latest == {"X.load": 0.0, "door.input": 1.0}
