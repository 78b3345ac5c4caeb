"""The clients of the panel: what each was sent, and when."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import Callable

from pydantic import BaseModel

from threadline.panel.page_words import told_on_page

SEEN_S = 0.5
"""Age in s of the latest state on which a client may act."""
_MOST_SENT = 64
_MOST_WAITING = 64


class Client:
    """A client, and what waits to be sent to it.

    A state replaces the one before it, so that a slow client gets fewer, and none that is old.

    Parameters
    ----------
    number, name
        Its number, and what it calls itself.
    """

    def __init__(self, number: int, name: str) -> None:
        self.number, self.name = number, name
        self._sent: OrderedDict[int, float] = OrderedDict()  # when each state was sent
        self._waiting: deque[str] = deque()
        self._state: tuple[int, str] | None = None
        self._ready = asyncio.Event()
        self._last = 0  # number of its latest command
        self.full = False
        """Whether it does not take what it is sent."""

    def show(self, seq: int, text: str) -> None:
        """Let it have a state next."""
        self._state = (seq, text)
        self._ready.set()

    def tell(self, message: BaseModel) -> None:
        """Let it have a message, in order: a state that waits is older, and is left out."""
        self._state = None
        self.full = self.full or len(self._waiting) >= _MOST_WAITING
        self._waiting.append(told_on_page(message).model_dump_json())
        self._ready.set()

    async def next_text(self, clock: Callable[[], float]) -> str | None:
        """Wait for what is to be sent, and return it; None if there is nothing after all."""
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
        """Return whether a state was sent to it a short time ago: it may act on that."""
        sent_s = self._sent.get(seq)
        return sent_s is not None and now_s - sent_s <= SEEN_S

    def is_next(self, number: int) -> bool:
        """Return whether the number of a command is larger than all before it, and note it."""
        later = number > self._last
        self._last = max(self._last, number)
        return later
