"""Requests of the drawing: they answer with what was sent in another form, and keep nothing."""

from __future__ import annotations

import asyncio
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import ValidationError
from starlette.requests import ClientDisconnect

from threadline.errors import InputError
from threadline.panel.drawn import SHAPES, Lettering, dxf, opened, outlines
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
        return await _answered(request, lambda sent: JSONResponse(opened(name, sent)))

    @app.post("/api/drawing/dxf", responses=_TELLS)
    async def as_dxf(request: Request) -> Response:
        return await _answered(
            request,
            lambda sent: Response(dxf(SHAPES.validate_json(sent)), media_type="image/vnd.dxf"),
        )

    @app.post("/api/drawing/text", responses=_TELLS)
    async def text(request: Request) -> Response:
        return await _answered(
            request,
            lambda sent: JSONResponse(outlines(Lettering.model_validate_json(sent))),
        )


async def _answered(request: Request, answer: Any) -> Response:
    """Return what is made of the body of a request, or why nothing is."""
    try:
        sent = await whole_body(request)
        made: Response = await asyncio.to_thread(answer, sent)
    except TooLongError:
        return PlainTextResponse(f"more than {MOST_UPLOAD} bytes\n", 413)
    except ClientDisconnect:  # nobody reads the answer
        return PlainTextResponse("the request broke off\n", 400)
    except InputError as error:
        return PlainTextResponse(f"{error}\n", 422)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        return PlainTextResponse(f"{where or 'it'}: {first['msg']}\n", 422)
    return made


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
