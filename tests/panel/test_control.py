"""Control over the machine: two clients never have it at once, whatever they do at any time."""

from __future__ import annotations

import asyncio
from itertools import count

from hypothesis import given, settings
from hypothesis import strategies as st

from threadline.panel.control import ASKED_S, CONTROL_LEASE_S, SEEN_S, Client, ControlLease

STEPS = st.lists(
    st.tuples(
        st.sampled_from(["take", "give", "keep", "release", "renew", "stale", "wait"]),
        st.sampled_from([1, 2]),
        st.sampled_from([0.0, 0.04, 1.0, CONTROL_LEASE_S, ASKED_S]),
    ),
    max_size=40,
)


class Model:
    """A plain model of control: its holder, its end, and the asking client with its time."""

    def __init__(self) -> None:
        self.holder: int | None = None
        self.until = 0.0
        self.asks: int | None = None
        self.due = 0.0

    def now(self, now: float) -> int | None:
        return self.holder if now < self.until else None

    def give(self, client: int, now: float) -> None:
        self.holder, self.until = client, now + CONTROL_LEASE_S
        self.asks = None if self.asks == client else self.asks


# One bug at a time: a group of errors would not be the AssertionError that
# test_panel_guards_removed expects.
@settings(max_examples=300, report_multiple_bugs=False)
@given(STEPS)
def test_lease_of_control_agrees_with_a_simple_model(steps: list[tuple[str, int, float]]) -> None:
    numbers = count()
    control, model, now = ControlLease(lambda: f"lease {next(numbers)}"), Model(), 0.0
    words: dict[int, str] = {1: "", 2: ""}
    spent: set[str] = set()
    for what, client, pause in steps:
        now += pause
        if (passed := control.pass_if_due(now)) is not None:
            assert model.asks == passed.client
            assert model.now(now) is None or now >= model.due
            spent |= {w for w in words.values() if w}
            words[passed.client] = passed.word
            model.give(passed.client, now)
        elif model.asks is not None:
            assert model.now(now) is not None
            assert now < model.due
        if what == "take":
            free = model.now(now) in (None, client)
            lease = control.take(client, now)
            assert (lease is not None) == free
            if lease is not None:
                spent |= {w for w in words.values() if w}
                words[client] = lease.word
                model.give(client, now)
            elif model.asks is None:
                model.asks, model.due = client, now + ASKED_S
        elif what == "give":
            asks = model.asks
            lease = control.give(client, now)
            assert (lease is not None) == (model.now(now) == client and asks is not None)
            if lease is not None:
                assert lease.client == asks
                spent |= {w for w in words.values() if w}
                words[lease.client] = lease.word
                model.give(lease.client, now)
        elif what == "keep":
            if control.keep(client, now):
                assert model.now(now) == client
                model.asks = None
        elif what == "release":
            had = model.holder == client
            assert control.release(client) == had
            model.asks = None if model.asks == client else model.asks
            if had:
                model.holder, model.until = None, 0.0
        elif what == "renew":
            good = model.now(now) == client and words[client] not in spent
            assert control.renew(words[client], now) == good
            if good:
                model.until = now + CONTROL_LEASE_S
        elif what == "stale":
            for word in spent - {words[model.now(now) or 0] if model.now(now) else ""}:
                assert not control.renew(word, now)
        held = control.holder(now)
        assert (held.client if held else None) == model.now(now)
        assert control.asks == model.asks


def test_the_word_of_another_is_of_no_use() -> None:
    control = ControlLease()
    first = control.take(1, 0.0)
    assert first is not None
    assert not control.renew(first.word, 1.0, 2)
    assert control.left_s(1.0) == CONTROL_LEASE_S - 1.0
    assert control.renew(first.word, 1.0, 1)


def test_control_passes_after_ten_seconds_without_an_answer() -> None:
    control = ControlLease()
    first = control.take(1, 0.0)
    assert first is not None
    assert control.take(2, 1.0) is None
    for k in range(1, 11):
        assert control.renew(first.word, float(k))
        assert control.pass_if_due(float(k)) is None
    second = control.pass_if_due(11.0)
    assert second is not None
    assert second.client == 2
    assert not control.renew(first.word, 11.0)


def test_control_is_free_five_seconds_after_its_holder_is_gone() -> None:
    control = ControlLease()
    first = control.take(1, 0.0)
    assert first is not None
    assert control.take(2, 4.9) is None
    assert control.pass_if_due(4.9) is None
    assert control.pass_if_due(5.0) is not None


def test_leases_cannot_be_guessed() -> None:
    words = {lease.word for _ in range(50) if (lease := ControlLease().take(1, 0.0))}
    assert len(words) == 50
    assert min(map(len, words)) >= 20


def test_a_state_may_be_acted_on_for_half_a_second() -> None:
    client = Client(1, "Anna")
    client.show(7, "seven")
    client.show(8, "eight")  # the next state replaces it: a slow client gets no old states
    assert asyncio.run(client.next_text(lambda: 10.0)) == "eight"
    assert client.saw(8, 10.0 + SEEN_S)
    assert not client.saw(8, 10.01 + SEEN_S)
    assert not client.saw(7, 10.0)
    assert client.is_next(1)
    assert not client.is_next(1)
    assert client.is_next(5)
    assert not client.is_next(4)
