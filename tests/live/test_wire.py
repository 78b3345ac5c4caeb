"""Messages come back as sent; any other bytes are refused in one line."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import LinkFaultError
from threadline.files import Event
from threadline.live.wire import Connection, Message, decoded, event_of, event_row

HEADS = st.dictionaries(
    st.text(max_size=10),
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text() | st.lists(st.integers()),
    max_size=5,
)


@given(st.text(max_size=20), HEADS, st.integers(0, 40), st.integers(1, 3))
def test_a_message_comes_back(kind: str, head: dict[str, object], rows: int, axes: int) -> None:
    ours, theirs = socket.socketpair()
    numbers = np.random.default_rng(rows).normal(size=rows)
    counts = np.arange(rows * axes, dtype=np.int64).reshape(rows, axes) - 7
    first, second = Connection(ours), Connection(theirs)
    first.send(Message(kind, head, {"counts": counts, "numbers": numbers}))
    first.send(Message("after"))
    found = second.receive(1.0)
    assert found is not None
    assert (found.kind, dict(found.head)) == (kind, head)
    assert np.array_equal(found.arrays["counts"], counts)
    assert np.array_equal(found.arrays["numbers"], numbers)
    after = second.receive(1.0)
    assert after is not None
    assert after.kind == "after"
    assert second.receive(0.0) is None
    assert not second.lost
    first.close()
    assert second.receive(1.0) is None
    assert second.lost
    second.close()


@given(st.binary(max_size=60))
def test_bytes_that_are_no_message_are_refused(content: bytes) -> None:
    with pytest.raises(LinkFaultError):
        decoded(content)


@given(st.data())
def test_a_damaged_message_is_refused_or_reads(data: st.DataObject) -> None:
    """One changed byte is a fault of the link, or another message of the same form; no crash."""
    rows = np.arange(6, dtype=np.int64).reshape(2, 3)
    whole = bytearray(Message("refill", {"first": 3, "events": []}, {"counts": rows}).encoded())
    at = data.draw(st.integers(4, len(whole) - 1))
    whole[at] ^= data.draw(st.integers(1, 255))
    with suppress(LinkFaultError):
        read = decoded(bytes(whole[4:]))
        assert isinstance(read.head, dict)
        assert all(values.ndim >= 1 for values in read.arrays.values())


@pytest.mark.parametrize("length", [0, 3, (1 << 24) + 1, 0xFFFFFFFF])
def test_a_length_out_of_range_is_refused(length: int) -> None:
    ours, theirs = socket.socketpair()
    ours.sendall(struct.pack("<I", length) + b"x" * 8)
    connection = Connection(theirs)
    with pytest.raises(LinkFaultError, match="not a message"):
        connection.receive(1.0)
    ours.close()
    connection.close()


def test_events_are_checked() -> None:
    event = Event(tick=3, kind="tool", operation=2, name="trim", value=1.0)
    assert event_of(event_row(event)) == event
    for message in (None, [], [1, "explode", 0, "", 0.0], ["x", "tool", 0, "", 0.0]):
        with pytest.raises(LinkFaultError):
            event_of(message)
