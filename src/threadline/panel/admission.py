"""Who is let in: host, origin and token of every request, before anything reads it.

A page of another site can make a browser send requests to this machine. It cannot choose their
``Origin``; and a name that was bent to this address shows in their ``Host``.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from threadline.errors import OptionError
from threadline.live.host_names import in_url

LOCAL = ("127.0.0.1", "localhost", "[::1]")
"""Names of this computer, to which no token is needed."""
_READS = frozenset({"GET", "HEAD"})
_LEAST_TOKEN = 16
_FIRST, _LAST = "!", "~"  # of the characters that are visible in ASCII
_MOST_NAMED = 5
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
"""Of every answer: no page of another site may frame this one, or be loaded into it."""


@dataclass(frozen=True, slots=True)
class Admission:
    """What a request has to show.

    Parameters
    ----------
    host
        Address that the server listens at.
    token
        Word that every client has to know; empty for none.

    Raises
    ------
    OptionError
        If the address is not this computer's own and there is no token; if the token is short, or
        holds what a word in an HTTP header cannot: a blank, or anything but visible ASCII.
    """

    host: str
    token: str

    def __post_init__(self) -> None:
        wrong = sorted({one for one in self.token if not _FIRST <= one <= _LAST})
        if wrong:
            named = ", ".join(map(ascii, wrong[:_MOST_NAMED]))
            more = " and others" if len(wrong) > _MOST_NAMED else ""
            raise OptionError(
                f"--token holds {named}{more}, which cannot stand in a word of an HTTP header",
                remedy="Give 16 or more of the characters ! to ~: letters, digits, signs.",
            )
        if self.token and len(self.token) < _LEAST_TOKEN:
            raise OptionError(
                f"--token has {len(self.token)} characters, the least is {_LEAST_TOKEN}",
                remedy="Give a longer one.",
            )
        if in_url(self.host) not in LOCAL and not self.token:
            raise OptionError(
                f"--host {self.host}: who may reach this computer could move the machine",
                remedy="Give a --token of 16 characters or more, or leave --host out.",
            )

    def refusal(self, headers: Headers, reads: bool) -> str:
        """Return why a request is refused; empty if it is not.

        Parameters
        ----------
        reads
            Whether it can change nothing.
        """
        host = headers.get("host", "")
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
        if not self.token and name not in LOCAL:
            return "this name is not that of the computer itself"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return "the request comes from a page of another site"
        if not reads and origin is None and headers.get("sec-fetch-site", "none") != "none":
            return "the request comes from a page that does not say whose it is"
        return ""

    def knows(self, token: str) -> bool:
        """Return whether a token is the right one."""
        return hmac.compare_digest(token.encode(), self.token.encode())


class AdmittingApp:
    """An application that is reached only by requests that are admitted.

    The page itself is there for all, for it holds nothing; what is behind ``/api`` asks for the
    token. The token of a websocket comes in its first message, which the application checks.

    Parameters
    ----------
    app
        The application.
    admission
        What is asked of a request.
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
        why = self._admission.refusal(headers, not socket and scope["method"] in _READS)
        status = 403
        if not why and not socket and scope["path"].startswith("/api"):
            token = headers.get("authorization", "").removeprefix("Bearer ")
            if not self._admission.knows(token if self._admission.token else ""):
                why, status = "the token is not the right one", 401
        if not why:
            await self._app(scope, receive, send)
        elif socket:
            await send({"type": "websocket.close", "code": 4403, "reason": why})
        else:
            answer = PlainTextResponse(f"{why}\n", status_code=status, headers=dict(HEADERS))
            await answer(scope, receive, send)
