"""Clients of the panel: control over the machine, and messages in the words of the page.

Errors and warnings are shared with the command line, and name its options. If the page has a field
for an option, the label of the field replaces the name of the option. Other options are marked as
options of the command line.

Methods get the present time as an argument, and read no clock of their own.
"""

from __future__ import annotations

import asyncio
import hmac
import re
import secrets
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass

from pydantic import BaseModel

from threadline.panel import protocol as say
from threadline.proof.option_table import TABLE

FIELDS = {one.name: one.label for one in TABLE if one.label} | {
    "at": "from",
    "override": "Reason to run out of specification",
}
"""Labels of the page, by option."""
_CODE = re.compile(r"^\[[A-Z_-]+\] ")
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*[a-z])(?![\w-])")


def in_page_words(text: str) -> str:
    """Return a text with the labels of the page in place of options of the command line.

    The code of an error is for programs, and is left out.

    >>> in_page_words("Choose another feed with --feed, or another machine (--actual).")
    "Choose another feed with 'Feed', or another machine (--actual of the command line)."
    >>> in_page_words("[COMMAND] you are not in control. Take control first.")
    'you are not in control. Take control first.'
    """
    return _OPTION.sub(_label, _CODE.sub("", text))


def _label(found: re.Match[str]) -> str:
    label = FIELDS.get(found[1])
    return f"{found[0]} of the command line" if label is None else f"'{label}'"


def in_words_of_page(message: BaseModel) -> BaseModel:
    """Return a message with its texts for people in the words of the page."""
    if isinstance(message, say.Said | say.Answer):
        return message.model_copy(update={"text": in_page_words(message.text)})
    if isinstance(message, say.Figures):
        warnings = [in_page_words(one) for one in message.warnings]
        return message.model_copy(update={"warnings": warnings})
    return message


CONTROL_LEASE_S = 5.0
"""Time in s after which control is free unless its holder sends something."""
ASKED_S = 10.0
"""Time in s after which control passes to the client that asks, unless its holder keeps it."""


@dataclass(frozen=True, slots=True)
class Lease:
    """Control over the machine.

    Parameters
    ----------
    client
        Number of the client that has it.
    word
        Secret word that its commands must carry.
    """

    client: int
    word: str


class ControlLease:
    """The lease of control over one machine.

    Parameters
    ----------
    make
        Makes a word that nobody can guess.
    """

    def __init__(self, make: Callable[[], str] = lambda: secrets.token_urlsafe(16)) -> None:
        self._make = make
        self._held: Lease | None = None
        self._until_s = 0.0
        self._asks: int | None = None
        self._transfer_s = 0.0  # instant at which control passes to the asking client

    def holder(self, now_s: float) -> Lease | None:
        """Return the lease in force; None if it has run out, or nobody has control."""
        return self._held if now_s < self._until_s else None

    def left_s(self, now_s: float) -> float:
        """Return the time until the lease runs out unless it is renewed, s."""
        return max(self._until_s - now_s, 0.0) if self._held is not None else 0.0

    @property
    def asks(self) -> int | None:
        """The client that asks for control; None if nobody does."""
        return self._asks

    def passes_in_s(self, now_s: float) -> float:
        """Return the time after which control passes to the asking client, s; 0 without one."""
        return max(self._transfer_s - now_s, 0.0) if self._asks is not None else 0.0

    def take(self, client: int, now_s: float) -> Lease | None:
        """Give control to a client if nobody has it; else note its request, and return None.

        Only the first asking client waits; others have to ask again.
        """
        held = self.holder(now_s)
        if held is None or held.client == client:
            return self._grant(client, now_s)
        if self._asks is None:
            self._asks, self._transfer_s = client, now_s + ASKED_S
        return None

    def give(self, client: int, now_s: float) -> Lease | None:
        """Give control to the asking client; None if none asks, or ``client`` is not in control."""
        held = self.holder(now_s)
        if held is None or held.client != client or self._asks is None:
            return None
        return self._grant(self._asks, now_s)

    def keep(self, client: int, now_s: float) -> bool:
        """Keep control against a request; return whether ``client`` had it."""
        held = self.holder(now_s)
        if held is None or held.client != client:
            return False
        self._asks = None
        return True

    def renew(self, word: str, now_s: float, client: int | None = None) -> bool:
        """Renew the lease; return False if ``word`` does not belong to the lease in force.

        Parameters
        ----------
        client
            The sending client, if known: it must be the one in control.
        """
        held = self.holder(now_s)
        if held is None or client not in {None, held.client}:
            return False
        if not hmac.compare_digest(held.word.encode(), word.encode()):
            return False
        self._until_s = now_s + CONTROL_LEASE_S
        return True

    def release(self, client: int) -> bool:
        """Give control back, for example when a client leaves; return whether it had it."""
        if self._asks == client:
            self._asks = None
        if self._held is None or self._held.client != client:
            return False
        self._held = None
        self._until_s = 0.0
        return True

    def pass_if_due(self, now_s: float) -> Lease | None:
        """Pass control to the asking client if that is due; return the new lease, or None."""
        if self._asks is None:
            return None
        if self.holder(now_s) is not None and now_s < self._transfer_s:
            return None
        return self._grant(self._asks, now_s)

    def _grant(self, client: int, now_s: float) -> Lease:
        if self._asks == client:
            self._asks = None
        self._held = Lease(client, self._make())
        self._until_s = now_s + CONTROL_LEASE_S
        return self._held


SEEN_S = 0.5
"""Largest age in s of a state on which a client may act."""
_MOST_SENT = 64
_MOST_WAITING = 64


class Client:
    """A client, and the messages that wait to be sent to it.

    A new state replaces a waiting one, so that a slow client gets fewer states, and no old ones.

    Parameters
    ----------
    number, name
        Its number, and the name that it gave.
    """

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self._sent: OrderedDict[int, float] = (
            OrderedDict()
        )  # instant at which each state was sent, by its number
        self._waiting: deque[str] = deque()
        self._state: tuple[int, str] | None = None
        self._ready = asyncio.Event()
        self._last = 0  # number of the client's latest command
        self.full = False
        """Whether it does not read its messages."""

    def show(self, seq: int, text: str) -> None:
        """Queue a state, in place of a waiting one."""
        self._state = (seq, text)
        self._ready.set()

    def tell(self, message: BaseModel) -> None:
        """Queue a message in order; a waiting state is older, and is dropped."""
        self._state = None
        self.full = self.full or len(self._waiting) >= _MOST_WAITING
        self._waiting.append(in_words_of_page(message).model_dump_json())
        self._ready.set()

    async def next_text(self, clock: Callable[[], float]) -> str | None:
        """Wait for the next message and return it; None if it was dropped meanwhile."""
        await self._ready.wait()
        if self._waiting:
            return self._waiting.popleft()
        self._ready.clear()
        if self._state is None:
            return None
        (seq, text), self._state = self._state, None
        self._sent[seq] = clock()
        while len(self._sent) > _MOST_SENT:
            self._sent.popitem(last=False)
        return text

    def saw(self, seq: int, now_s: float) -> bool:
        """Return whether the state ``seq`` is new enough for the client to act on it."""
        sent_s = self._sent.get(seq)
        return sent_s is not None and now_s - sent_s <= SEEN_S

    def is_next(self, number: int) -> bool:
        """Return whether a command's number is larger than all earlier ones, and note it."""
        later = number > self._last
        self._last = max(self._last, number)
        return later
