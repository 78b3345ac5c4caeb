"""Requests of the drawing: they answer with what was sent in another form, and keep nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from threadline.panel.drawn import Lettering, outlines
from threadline.panel.drawn_apart import read_apart, why_invalid, written_apart
from threadline.panel.project_programs import MOST_UPLOAD

_TELLS: dict[int | str, dict[str, Any]] = {
    413: {"description": "more than is taken"},
    422: {"description": "what was sent cannot be read; a line says why"},
}


class TooLongError(Exception):
    """More was sent than is taken."""


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
    asked = Lettering.model_validate_json(sent)
    return bytes(JSONResponse(await asyncio.to_thread(outlines, asked)).body)


async def _answered(
    request: Request, answer: Callable[[bytes], Awaitable[bytes | str]], media_type: str
) -> Response:
    """Return what is made of the body of a request, or why nothing is."""
    try:
        made = await answer(await whole_body(request))
    except TooLongError:
        return PlainTextResponse(f"more than {MOST_UPLOAD} bytes\n", 413)
    except ClientDisconnect:  # nobody reads the answer
        return PlainTextResponse("the request broke off\n", 400)
    except ValidationError as error:
        return PlainTextResponse(f"{why_invalid(error)}\n", 422)
    if isinstance(made, str):
        return PlainTextResponse(f"{made}\n", 422)
    return Response(made, media_type=media_type)


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
