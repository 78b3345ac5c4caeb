"""Processes that answer one request of the panel; each is killed when nobody waits for it."""

from __future__ import annotations

import asyncio
import json
import sys
from bisect import bisect_right
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query, Response
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse

from threadline.base.importing import import_and_call, program_apart
from threadline.errors import CommandError
from threadline.machine import Machine
from threadline.panel.protocol import Calculate, Figures, Proven


async def answer_of(
    *words: str, sent: bytes = b"", longest_s: float | None = None
) -> tuple[int, bytes, bytes]:
    """Return the exit status of a process, and its outputs.

    It is killed when its time is over, or when the request or the panel ends: a thread could not be
    killed, and the panel would have to wait for it.

    Parameters
    ----------
    words
        The program and its arguments.
    sent
        Bytes for its standard input.
    longest_s
        Time limit in s; None for no limit.

    Raises
    ------
    TimeoutError
        If it takes longer.
    """
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *words, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True
    )
    try:
        async with asyncio.timeout(longest_s):
            output, why = await process.communicate(sent)
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    return process.returncode or 0, output, why


_WHY = {422: {"description": "there is no guide; a line says why"}}


class MachineGuide:
    """Writes the guide to a machine at the first request.

    Parameters
    ----------
    machine, kept
        The machine, and the folder in which its guide is kept.
    """

    def __init__(self, machine: Machine, results: Path) -> None:
        self._reference, self._folder = machine.reference, results / "guide"
        self._one_at_a_time = asyncio.Lock()
        self._found: dict[str, Any] | None = None

    @property
    def printable(self) -> Path:
        """File of the guide as PDF; ``tables`` makes it."""
        return self._folder / "guide.pdf"

    async def tables(self) -> dict[str, Any] | str:
        """Return the machine's name and the tables of its guide, or why there is none."""
        async with self._one_at_a_time:
            if self._found is None:
                status, output, why = await answer_of(
                    sys.executable, "-P", "-m", "threadline", "guide", self._reference,
                    "-o", str(self._folder), "--json",
                )  # fmt: skip
                if status:
                    return why.decode("utf-8", "replace").strip()[-500:]
                found = json.loads(output)
                self._found = {"machine": found["machine"], "tables": found["tables"]}
        return self._found


def add_guide(app: FastAPI, guide: MachineGuide) -> None:
    """Add the requests for the guide, which are read-only."""

    @app.get("/api/guide", responses=_WHY)  # type: ignore[arg-type]
    async def tables() -> Response:
        tables_or_refusal = await guide.tables()
        if isinstance(tables_or_refusal, str):
            return PlainTextResponse(f"{tables_or_refusal}\n", 422)
        return JSONResponse(tables_or_refusal)

    @app.get("/api/guide.pdf", responses=_WHY)  # type: ignore[arg-type]
    async def printable() -> Response:
        tables_or_refusal = await guide.tables()
        if isinstance(tables_or_refusal, str):
            return PlainTextResponse(f"{tables_or_refusal}\n", 422)
        return FileResponse(guide.printable, media_type="application/pdf")


CHILD = import_and_call("threadline.panel.calculating", "main")
_PREVIEW = import_and_call("threadline.panel.job_views", "main")
PREVIEW_S = 20.0  # time limit for reading a program that is shown before its calculation
_MOST_LINE = 32 << 20


class Calculation:
    """Calculates one program at a time, in a separate process.

    Parameters
    ----------
    machine, spec_file
        The machine, and the specification; None: the machine's own.
    folder, kept
        Folder of the programs, and folder for the proof.

    Attributes
    ----------
    proven
        The latest calculation, if unchanged since; else None.
    share
        Share done; None while nothing is calculated.
    wound
        The mandrel and the fibre of the latest calculation, as ``calculating.wound`` gives them;
        None without a product.
    """

    def __init__(
        self, machine: Machine, spec_file: Path | None, folder: Path, results: Path
    ) -> None:
        self._machine, self._spec_file, self._folder = machine, spec_file, folder
        self._results = results
        self.proven: Proven | None = None
        self.share: float | None = None
        self.figures: Figures | None = None
        self.wound: dict[str, Any] | None = None
        self._words: Mapping[str, Any] = {}
        self._starts: list[int] = []
        self._task: asyncio.Task[None] | None = None
        self._one_preview = asyncio.Semaphore(1)

    @property
    def starts(self) -> list[int]:
        """Starting position of the proven program, in counts of the axes."""
        return self._starts

    async def preview(self, program: str) -> bytes | str:
        """Return the ``Preview`` of a program as JSON, or why there is none."""
        content = {
            "folder": str(self._folder), "program": program,
            "machine": self._machine.reference, "par": self._machine.parameters or None,
        }  # fmt: skip
        words, sent = program_apart(_PREVIEW), json.dumps(content).encode()
        try:
            async with self._one_preview:
                status, output, _ = await answer_of(*words, sent=sent, longest_s=PREVIEW_S)
        except TimeoutError:
            return f"{program[:60]!r} takes longer than {PREVIEW_S:g} s to read: calculate it"
        if status:
            return f"{program[:60]!r} cannot be shown: the process that read it has ended"
        why = json.loads(output).get("error")
        return output if why is None else str(why)

    def begin(self, request: Calculate, tell: Callable[[Figures | str], None]) -> None:
        """Begin a calculation, and forget the previous one.

        Parameters
        ----------
        request
            The request.
        tell
            Called with the figures, or with the reason for having none.

        Raises
        ------
        CommandError
            If a calculation is under way.
        """
        if self.share is not None:
            raise CommandError("a calculation is under way", remedy="Wait for it.")
        self.forget()
        self.share = 0.0
        self._task = asyncio.create_task(self._run(request, tell))
        self._task.add_done_callback(lambda task: self._over(task, tell))

    def _over(self, task: asyncio.Task[None], tell: Callable[[Figures | str], None]) -> None:
        """Clear the share done when the calculation has ended, and report an unexpected error.

        The task cannot do this itself, because it never runs if it is cancelled before its first
        step.
        """
        self.share = None
        if not task.cancelled() and (error := task.exception()) is not None:
            tell(f"the calculation has failed: {error}")

    def forget(self) -> None:
        """Forget the latest calculation, because a program was changed."""
        self.proven, self.figures, self._starts, self.wound = None, None, [], None

    def to_start(self, proof: str) -> Mapping[str, Any]:
        """Return the request to the owner that runs the proven program.

        Raises
        ------
        CommandError
            If ``proof`` is not the calculation that the client was shown.
        """
        if self.proven is None or self.proven.proof != proof:
            raise CommandError(
                "this is not the program that was proven last", remedy="Calculate it again."
            )
        return {**self._words, "proof": proof}

    async def _run(self, request: Calculate, tell: Callable[[Figures | str], None]) -> None:
        words = {
            **request.model_dump(exclude={"what"}),
            "proof_file": str(self._results / "proof.json"),
        }
        machine = self._machine
        content = {
            **words,
            "folder": str(self._folder),
            "machine": machine.reference,
            "par": machine.parameters or None,
            "spec": None if self._spec_file is None else str(self._spec_file),
        }
        try:
            process = await asyncio.create_subprocess_exec(
                *program_apart(CHILD),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
                limit=_MOST_LINE, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            tell(f"the process that calculates cannot be started: {error.strerror or error}")
            return
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(json.dumps(content).encode())
            process.stdin.close()
            failure = "the calculation has ended without an answer"
            async for line in process.stdout:
                message = json.loads(line)
                self.share = message.get("share", self.share)
                failure = message.get("error", failure)
                if "figures" in message:
                    tell(self._taken(message["figures"], words))
                    return
            tell(failure)
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _taken(self, found: dict[str, Any], words: Mapping[str, Any]) -> Figures:
        self._starts = found.pop("starts")
        self._words = {**words, **found.pop("words")}
        self.wound = found.pop("wound")
        self.figures = Figures.model_validate(found)
        self.proven = Proven(
            program=str(words["program"]),
            proof=self.figures.proof,
            passed=self.figures.passed,
            closing=self.figures.closing,
        )
        return self.figures

    def cancel(self) -> None:
        """End a running calculation."""
        if self._task is not None:
            self._task.cancel()

    async def close(self) -> None:
        """End a running calculation, and wait for its end."""
        self.cancel()
        if self._task is not None:
            await asyncio.wait([self._task])


_OF_FIBRE = ("times_s", "along", "radius", "angle", "winding", "begins", "slips")
_NOT_WOUND = {404: {"description": "the latest calculation has no product, or there is none"}}


def add_winding(
    app: FastAPI, calculation: Calculation, running_s: Callable[[], float | None]
) -> None:
    """Add the request for the fibre of the latest calculation; it is read-only.

    ``running_s`` returns the time of the program's run in s, or None if the program does not run.
    During a run, the answer holds the fibre that the simulated run has laid by that time; otherwise
    all of it.
    """

    @app.get("/api/wound", responses=_NOT_WOUND)  # type: ignore[arg-type]
    def wound(proof: str = "", after: Annotated[int, Query(ge=0)] = 0) -> Response:
        found, proven = calculation.wound, calculation.proven
        if found is None or proven is None:
            return PlainTextResponse("nothing was calculated with a product\n", 404)
        now_s, times_s = running_s(), found["times_s"]
        until = len(times_s) if now_s is None else bisect_right(times_s, now_s)
        first = after if proof == proven.proof and after <= until else 0
        fibre = {name: found[name][first:until] for name in _OF_FIBRE}
        content = {"proof": proven.proof, "first": first, "next": until, "count": len(times_s)}
        content["running"] = now_s is not None
        if first == 0:
            content |= {"mandrel": found["mandrel"], "width": found["width"]}
        return JSONResponse({**content, "fibre": fibre})
