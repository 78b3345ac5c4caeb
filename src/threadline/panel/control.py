"""Who controls the machine: one client, by a lease that it has to renew; all others watch.

Time is an argument of every method, so that nothing here waits.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass

CONTROL_LEASE_S = 5.0
"""Time in s after which control is free unless its holder was heard."""
ASKED_S = 10.0
"""Time in s after which control passes to the one who asked, unless its holder keeps it."""


@dataclass(frozen=True, slots=True)
class Lease:
    """Control over the machine.

    Parameters
    ----------
    client
        Number of the client that has it.
    word
        What its commands have to carry; nobody else knows it.
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
        self._passes_s = 0.0  # when control passes to the one who asks

    def holder(self, now_s: float) -> Lease | None:
        """Return the lease in force; None where it has run out, or nobody has control."""
        return self._held if now_s < self._until_s else None

    def left_s(self, now_s: float) -> float:
        """Return the time for which the lease goes on unless it is renewed, s."""
        return max(self._until_s - now_s, 0.0) if self._held is not None else 0.0

    @property
    def asks(self) -> int | None:
        """The client that asks for control; None where nobody does."""
        return self._asks

    def passes_in_s(self, now_s: float) -> float:
        """Return the time after which control passes to the one who asks, s; 0 if nobody does."""
        return max(self._passes_s - now_s, 0.0) if self._asks is not None else 0.0

    def take(self, client: int, now_s: float) -> Lease | None:
        """Give control to a client if nobody has it; else note that it asks, and return None.

        The first who asks is the one who waits; others have to ask again.
        """
        held = self.holder(now_s)
        if held is None or held.client == client:
            return self._grant(client, now_s)
        if self._asks is None:
            self._asks, self._passes_s = client, now_s + ASKED_S
        return None

    def give(self, client: int, now_s: float) -> Lease | None:
        """Give control to the one who asks; None if nobody does, or ``client`` has none."""
        held = self.holder(now_s)
        if held is None or held.client != client or self._asks is None:
            return None
        return self._grant(self._asks, now_s)

    def keep(self, client: int, now_s: float) -> bool:
        """Keep control, in answer to one who asks; return whether ``client`` had it."""
        held = self.holder(now_s)
        if held is None or held.client != client:
            return False
        self._asks = None
        return True

    def renew(self, word: str, now_s: float, client: int | None = None) -> bool:
        """Renew the lease; False if the word is not that of the lease in force.

        Parameters
        ----------
        client
            The client that says it, where it is known: it must be the one that has control.
        """
        held = self.holder(now_s)
        if held is None or client not in {None, held.client}:
            return False
        if not hmac.compare_digest(held.word.encode(), word.encode()):
            return False
        self._until_s = now_s + CONTROL_LEASE_S
        return True

    def release(self, client: int) -> bool:
        """Give control back, as when a client leaves; return whether it had it."""
        if self._asks == client:
            self._asks = None
        if self._held is None or self._held.client != client:
            return False
        self._held = None
        self._until_s = 0.0
        return True

    def passes(self, now_s: float) -> Lease | None:
        """Pass control to the one who asks, where that is due; return the new lease, or None."""
        if self._asks is None:
            return None
        if self.holder(now_s) is not None and now_s < self._passes_s:
            return None
        return self._grant(self._asks, now_s)

    def _grant(self, client: int, now_s: float) -> Lease:
        if self._asks == client:
            self._asks = None
        self._held = Lease(client, self._make())
        self._until_s = now_s + CONTROL_LEASE_S
        return self._held
