"""The guide to the machine, made once, in a process of its own, and kept while the panel serves."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse

from threadline.machine import Machine
from threadline.panel.children import answer_of

_WHY = {422: {"description": "there is no guide; a line says why"}}


class MachineGuide:
    """Writes the guide to a machine when it is asked for first.

    Parameters
    ----------
    machine, kept
        The machine, and the folder in which its guide is kept.
    """

    def __init__(self, machine: Machine, kept: Path) -> None:
        self._reference, self._folder = machine.reference, kept / "guide"
        self._one_at_a_time = asyncio.Lock()
        self._found: dict[str, Any] | None = None

    @property
    def printable(self) -> Path:
        """The guide as PDF; it is there once ``tables`` was called."""
        return self._folder / "guide.pdf"

    async def tables(self) -> dict[str, Any] | str:
        """Return the machine's name and the tables of its guide, or why there is none."""
        async with self._one_at_a_time:
            if self._found is None:
                status, told, why = await answer_of(
                    sys.executable, "-m", "threadline", "guide", self._reference,
                    "-o", str(self._folder), "--json",
                )  # fmt: skip
                if status:
                    return why.decode("utf-8", "replace").strip()[-500:]
                found = json.loads(told)
                self._found = {"machine": found["machine"], "tables": found["tables"]}
        return self._found


def add_guide(app: FastAPI, guide: MachineGuide) -> None:
    """Add the requests of the guide, which is only read."""

    @app.get("/api/guide", responses=_WHY)  # type: ignore[arg-type]
    async def tables() -> Response:
        found = await guide.tables()
        if isinstance(found, str):
            return PlainTextResponse(f"{found}\n", 422)
        return JSONResponse(found)

    @app.get("/api/guide.pdf", responses=_WHY)  # type: ignore[arg-type]
    async def printable() -> Response:
        found = await guide.tables()
        if isinstance(found, str):
            return PlainTextResponse(f"{found}\n", 422)
        return FileResponse(guide.printable, media_type="application/pdf")
