"""Admission of requests: host, origin and token are checked before anything reads the request.

A page of another site can make a browser send requests to this computer. The checks recognise such
a request by its ``Origin``, which the page cannot choose, or by its ``Host``, which has the foreign
name if a host name was redirected to this address. The number and the time of unfinished requests
are limited, so that they cannot keep other clients out.
"""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import h11
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from threadline.errors import OptionError
from threadline.live.port import in_url

LOCAL = ("127.0.0.1", "localhost", "[::1]")
"""Names of this computer, for which no token is needed."""
_READS = frozenset({"GET", "HEAD"})
_LEAST_TOKEN = 16
_FIRST, _LAST = "!", "~"  # the first and the last visible ASCII character
_MOST_NAMED = 5
HALF_OPEN_S = 5.0
"""Time limit in s for the head of a request, and for each further part of its body."""
MOST_HALF_OPEN = 256
"""Most connections without a complete request; beyond that the oldest is dropped."""
MOST_BODY_S = 60.0  # time limit in s from the first part of a body to its last part
HELLO_S = 5.0
"""Time limit in s for the hello of a websocket."""
MOST_WITHOUT_HELLO = 256
"""Most websockets without a hello so far; beyond that the oldest is closed."""
CLOSING_S = 1.0
"""Time limit in s for the answer to the close of a websocket; then its connection is dropped."""
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; "
        "base-uri 'none'; form-action 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""Headers of every response; they keep pages of other sites from framing or loading this page."""


@dataclass(frozen=True, slots=True)
class Admission:
    """The checks that a request must pass.

    Parameters
    ----------
    host
        Address that the server listens at.
    token
        Secret word that every client needs; empty for none.

    Raises
    ------
    OptionError
        If the address is not this computer's own and there is no token; if the token is short, or
        has a character that a word in an HTTP header cannot have: a blank or non-ASCII.
    """

    host: str
    token: str

    def __post_init__(self) -> None:
        not_allowed = sorted({one for one in self.token if not _FIRST <= one <= _LAST})
        if not_allowed:
            shown = ", ".join(map(ascii, not_allowed[:_MOST_NAMED]))
            others = " and others" if len(not_allowed) > _MOST_NAMED else ""
            raise OptionError(
                f"--token holds {shown}{others}, which an HTTP header does not allow in a word",
                remedy="Give 16 or more of the characters ! to ~: letters, digits, signs.",
            )
        if self.token and len(self.token) < _LEAST_TOKEN:
            raise OptionError(
                f"--token has {len(self.token)} characters, the least is {_LEAST_TOKEN}",
                remedy="Give a longer one.",
            )
        if in_url(self.host) not in LOCAL and not self.token:
            raise OptionError(
                f"--host {self.host}: anyone who can reach this computer could move the machine",
                remedy="Give a --token of 16 characters or more, or leave --host out.",
            )

    def refusal(self, headers: Headers, reads: bool) -> str:
        """Return why a request is refused; empty if it is not.

        Parameters
        ----------
        reads
            Whether the request is read-only.
        """
        host = headers.get("host", "")
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
        if not self.token and name not in LOCAL:
            return "the Host of the request is not this computer's name"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "the request comes from a page of another site"
        if not reads and origin is None and headers.get("sec-fetch-site", "none") != "none":
            return "the request comes from a page without an Origin"
        return ""

    def knows(self, token: str) -> bool:
        """Return whether a token is the right one."""
        return hmac.compare_digest(token.encode(), self.token.encode())


class AdmittingApp:
    """An application that only admitted requests reach.

    The page itself is public, since it holds no data; paths under ``/api`` need the token. A
    websocket sends its token in its first message, which the application checks.

    Parameters
    ----------
    app
        The application.
    admission
        The checks of a request.
    """

    def __init__(self, app: ASGIApp, admission: Admission) -> None:
        self._app, self._admission = app, admission

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or refuse a request."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        socket = scope["type"] == "websocket"
        refusal = self._admission.refusal(headers, not socket and scope["method"] in _READS)
        status = 403
        if not refusal and not socket and scope["path"].startswith("/api"):
            token = headers.get("authorization", "").removeprefix("Bearer ")
            if not self._admission.knows(token if self._admission.token else ""):
                refusal, status = "the token is not the right one", 401
        if not refusal:
            await self._app(scope, receive, send)
        elif socket:
            await send({"type": "websocket.close", "code": 4403, "reason": refusal})
        else:
            answer = PlainTextResponse(f"{refusal}\n", status_code=status, headers=dict(HEADERS))
            await answer(scope, receive, send)


class PromptHttp(H11Protocol):
    """A connection that is dropped if its request is not complete in time.

    uvicorn waits for ever for the rest of a request. Each waiting connection holds one of the
    files that a process may open, and once no file is left, a stop cannot get through.
    """

    half_open: ClassVar[dict[PromptHttp, None]] = {}
    """Connections without a complete request, the oldest first."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._due: asyncio.TimerHandle | None = None
        self._body_until_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start waiting for a request."""
        super().connection_made(transport)
        self._await_until(self.loop.time() + HALF_OPEN_S)
        while len(self.half_open) > MOST_HALF_OPEN:
            next(iter(self.half_open))._drop()

    def data_received(self, data: bytes) -> None:
        """Process received data, and wait for the rest of the request if it is incomplete."""
        super().data_received(data)
        now_s = self.loop.time()
        is_closed = self.transport.is_closing() or self.transport.get_protocol() is not self
        if not is_closed and self.conn.their_state is h11.SEND_BODY:
            self._body_until_s = self._body_until_s or now_s + MOST_BODY_S
            self._await_until(min(now_s + HALF_OPEN_S, self._body_until_s))
        elif is_closed or self.conn.their_state is not h11.IDLE:
            self._have()
        elif self._due is None:  # another request on the same connection
            self._await_until(now_s + HALF_OPEN_S)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._have()
        super().connection_lost(exc)

    def _await_until(self, due_s: float) -> None:
        if self._due is not None:
            self._due.cancel()
        self._due = self.loop.call_at(due_s, self._drop)
        self.half_open.setdefault(self)

    def _have(self) -> None:
        if self._due is not None:
            self._due.cancel()
        self._due, self._body_until_s = None, 0.0
        self.half_open.pop(self, None)

    def _drop(self) -> None:
        self._have()
        self.transport.close()


class PromptWebsocket(WebSocketsSansIOProtocol):
    """A websocket whose connection is dropped if its close is not answered in time."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.close_timeout = CLOSING_S


class Unknown:
    """Websockets without a hello so far: a limited number, for a limited time."""

    def __init__(self) -> None:
        self._due: dict[asyncio.Timeout, None] = {}  # the oldest first

    @asynccontextmanager
    async def one_more(self) -> AsyncIterator[None]:
        """Wait for the hello of a websocket.

        Raises
        ------
        TimeoutError
            If no hello comes within ``HELLO_S``, or newer websockets need the place.
        """
        async with asyncio.timeout(HELLO_S) as due:
            self._due[due] = None
            if len(self._due) > MOST_WITHOUT_HELLO:
                oldest = next(iter(self._due))
                del self._due[oldest]
                oldest.reschedule(asyncio.get_running_loop().time())
            try:
                yield
            finally:
                self._due.pop(due, None)
