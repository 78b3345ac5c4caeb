"""Requests of the panel's page about drawings."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from threadline.base.importing import import_and_call, program_apart
from threadline.panel.calculation import answer_of
from threadline.panel.drawings import WRONG, Lettering, outlines, why_invalid
from threadline.panel.programs import MOST_UPLOAD

LONGEST_S = 20.0
"""Longest time in s for reading a drawing."""
CHILD = import_and_call("threadline.panel.drawings", "main")
_one_at_a_time = asyncio.Semaphore(1)


async def read_apart(name: str, content: bytes) -> bytes | str:
    """Return the result of ``opened`` for a drawing as JSON, or a line that says why not."""
    return await _apart("shapes", name, content)


async def written_apart(content: bytes) -> bytes | str:
    """Return the DXF of shapes given as JSON, or a line that says why there is none."""
    return await _apart("dxf", "drawing.dxf", content)


async def _apart(what: str, name: str, content: bytes) -> bytes | str:
    words = (*program_apart(CHILD), what, name)
    try:
        async with _one_at_a_time:
            status, output, why = await answer_of(*words, sent=content, longest_s=LONGEST_S)
    except TimeoutError:
        return f"{name[:60]!r} takes longer than {LONGEST_S:g} s. Split it, or simplify it."
    except (OSError, ValueError) as error:  # a name that cannot be a process argument
        return f"{name[:60]!r} cannot be read: {getattr(error, 'strerror', None) or error}"
    if status == 0:
        return output
    if status == WRONG:
        return why.decode("utf-8", "replace").strip()
    return f"{name[:60]!r} cannot be read: the reading process has ended"


_TELLS: dict[int | str, dict[str, Any]] = {
    413: {"description": "the content is too long"},
    422: {"description": "the content cannot be read; a line says why"},
}


class TooLongError(Exception):
    """The content is too long."""


def add_drawing(app: FastAPI) -> None:
    """Add the requests."""

    @app.post("/api/drawing/shapes", responses=_TELLS)
    async def shapes(request: Request, name: str) -> Response:
        return await _answered(
            request, lambda sent: read_apart(name, sent), media_type="application/json"
        )

    @app.post("/api/drawing/dxf", responses=_TELLS)
    async def as_dxf(request: Request) -> Response:
        return await _answered(request, written_apart, media_type="image/vnd.dxf")

    @app.post("/api/drawing/text", responses=_TELLS)
    async def text(request: Request) -> Response:
        return await _answered(request, _lettered, media_type="application/json")


async def _lettered(sent: bytes) -> bytes | str:
    lettering = Lettering.model_validate_json(sent)
    return bytes(JSONResponse(await asyncio.to_thread(outlines, lettering)).body)


async def _answered(
    request: Request, answer: Callable[[bytes], Awaitable[bytes | str]], media_type: str
) -> Response:
    """Return the answer to the body of a request, or why there is none."""
    try:
        answer_content = await answer(await whole_body(request))
    except TooLongError:
        return PlainTextResponse(f"more than {MOST_UPLOAD} bytes\n", 413)
    except ClientDisconnect:  # nobody reads the answer
        return PlainTextResponse("the request broke off\n", 400)
    except ValidationError as error:
        return PlainTextResponse(f"{why_invalid(error)}\n", 422)
    if isinstance(answer_content, str):
        return PlainTextResponse(f"{answer_content}\n", 422)
    return Response(answer_content, media_type=media_type)


async def whole_body(request: Request) -> bytes:
    """Return the body of a request.

    Raises
    ------
    TooLongError
        If it is longer than a program may be.
    ClientDisconnect
        If it breaks off.
    """
    content = bytearray()
    async for part in request.stream():
        content += part
        if len(content) > MOST_UPLOAD:
            raise TooLongError
    return bytes(content)
