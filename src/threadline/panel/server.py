"""The web server of the panel: the page, the websocket, and HTTP requests."""

from __future__ import annotations

import asyncio
import mimetypes
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse
from fastapi.staticfiles import StaticFiles
from pydantic import ValidationError
from starlette.background import BackgroundTask
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Scope

from threadline.errors import InputError, OptionError, StoreError
from threadline.live.guards import clock_s
from threadline.panel import protocol as say
from threadline.panel.admission import HEADERS, Admission, AdmittingApp, Unknown
from threadline.panel.calculation import MachineGuide, add_guide, add_winding
from threadline.panel.control import Client, in_page_words
from threadline.panel.drawn import TooLongError, add_drawing, whole_body
from threadline.panel.panel import Panel
from threadline.panel.programs import MOST_UPLOAD, ThereAlreadyError, program_names, take_program
from threadline.panel.stored_traces import in_process, report_of, stored_runs, temporary, trace_file

PAGE = Path(__file__).parent / "page"
"""Folder of the built page; ``make panel`` makes it."""
_NUMBERS = re.compile("[0-9]{1,15}")
_REFUSALS: dict[int | str, dict[str, Any]] = {
    404: {"description": "there is none with that name"},
    409: {"description": "the lease is not the one in force"},
    412: {"description": "a file with that name exists: send it with X-Overwrite: yes"},
    413: {"description": "the content is too long"},
    422: {"description": "the content is not accepted, or cannot be read; a line says why"},
}
_REFUSED, _UNREADABLE, _OTHER_PROTOCOL, _SLOW = 4401, 4400, 4406, 4408  # codes of a close


def make_app(
    panel: Panel, guide: MachineGuide, folder: Path, store: Path, admission: Admission
) -> ASGIApp:
    """Return the application behind the admission of requests; see ``make_api``."""
    return AdmittingApp(make_api(panel, guide, folder, store, admission), admission)


def make_api(
    panel: Panel, guide: MachineGuide, folder: Path, store: Path, admission: Admission
) -> FastAPI:
    """Return the application for admitted requests.

    Parameters
    ----------
    panel, guide
        The panel, and the guide to its machine.
    folder, store
        Folders of the programs and of the runs.
    admission
        The checks of a request.
    """

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        panel.connect()
        beat = asyncio.create_task(panel.beat())
        beat.add_done_callback(_tell_of_end)
        yield
        beat.cancel()
        with suppress(asyncio.CancelledError):
            await beat
        await panel.close()

    app = FastAPI(
        title="Threadline operator panel", version=str(say.PANEL_PROTOCOL), lifespan=lifespan,
        docs_url=None, redoc_url=None, openapi_url=None,
    )  # fmt: skip
    _add_requests(app, panel, folder)
    _add_runs(app, store)
    add_drawing(app)
    add_guide(app, guide)
    add_winding(app, panel.calculation, panel.proven_run_s)
    _add_schema(app)
    _add_live(app, panel, admission)
    _add_page(app)
    return app


def _tell_of_end(beat: asyncio.Task[None]) -> None:
    """Log an error of the state loop at once; the owner stops the machine."""
    if not beat.cancelled() and (error := beat.exception()) is not None:
        context = {"message": "no states are sent any more", "exception": error, "task": beat}
        beat.get_loop().call_exception_handler(context)


def _add_requests(app: FastAPI, panel: Panel, folder: Path) -> None:
    """Add the HTTP requests; no GET changes anything."""

    @app.middleware("http")
    async def with_headers(request: Request, following: Any) -> Response:
        answer: Response = await following(request)
        answer.headers.update(HEADERS)
        if answer.status_code == 200 and request.url.path.startswith(f"/{_HASHED}"):
            answer.headers["Cache-Control"] = _CACHE_CONTROL
        return answer

    @app.get("/api/state")
    async def state() -> JSONResponse:
        return JSONResponse(panel.state().model_dump())

    @app.get("/api/programs")
    def programs() -> JSONResponse:
        return JSONResponse(program_names(folder, panel.machine))

    @app.get("/api/programs/{name}/preview", responses={**_REFUSALS, 200: {"model": say.Preview}})
    async def preview(name: str) -> Response:
        found = await panel.calculation.preview(name)
        if isinstance(found, str):
            return PlainTextResponse(f"{in_page_words(found)}\n", 422)
        return Response(found, media_type="application/json")

    @app.put("/api/programs/{name}", status_code=204, responses=_REFUSALS)
    async def upload(name: str, request: Request) -> PlainTextResponse:
        if not panel.may_change(request.headers.get("x-lease", "")):
            return PlainTextResponse("you are not in control\n", 409)
        try:
            content = await whole_body(request)
        except TooLongError:
            refusal = (
                f"{name[:60]} has more than {MOST_UPLOAD // 1024**2} MiB, the most that the page "
                "takes: copy it into the project folder"
            )
            return PlainTextResponse(f"{refusal}\n", 413)
        except ClientDisconnect:  # nobody reads the answer
            return PlainTextResponse("the request broke off\n", 400)
        try:
            overwrite = request.headers.get("x-overwrite") == "yes"
            await asyncio.to_thread(take_program, folder, name, content, overwrite=overwrite)
        except ThereAlreadyError as error:
            return PlainTextResponse(f"{error.message}\n", 412)
        except InputError as error:
            return PlainTextResponse(f"{error}\n", 422)
        panel.calculation.forget()
        return PlainTextResponse("", 204)

    @app.post("/api/stop", status_code=204)
    async def stop(request: Request) -> PlainTextResponse:
        # On the event loop: it needs no free thread.
        who, _, number = request.headers.get("x-stop", "").partition("/")
        is_numbered = bool(_NUMBERS.fullmatch(who) and _NUMBERS.fullmatch(number))
        panel.stop(int(who) if is_numbered else 0, int(number) if is_numbered else None)
        return PlainTextResponse("", 204)


def _add_schema(app: FastAPI) -> None:
    """Add the schema of the messages, and the description of the requests above."""

    @app.get("/api/schema")
    def schema() -> JSONResponse:
        return JSONResponse(schema_of(app))


def schema_of(api: FastAPI) -> dict[str, Any]:
    """Return the schema of the messages in both directions, and of the requests."""
    return {**say.schema(), "http": api.openapi()}


def _add_runs(app: FastAPI, store: Path) -> None:
    """Add requests for stored runs; they are read-only."""

    @app.get("/api/runs", responses=_REFUSALS)
    async def runs() -> Response:
        try:
            return JSONResponse(await asyncio.to_thread(stored_runs, store))
        except StoreError as error:
            return PlainTextResponse(f"{error}\n", 422)

    @app.get("/api/runs/{run}/trace", responses=_REFUSALS)
    async def trace(run: str) -> Response:
        return await _read_trace(store, run, "json")

    @app.get("/api/runs/{run}/recording.{ending}", responses=_REFUSALS)
    async def recording(run: str, ending: Literal["csv", "npz", "plt", "mcap"]) -> Response:
        return await _read_trace(store, run, ending)

    @app.get("/api/runs/{run}/report.pdf", responses=_REFUSALS)
    async def report(run: str) -> Response:
        try:
            await asyncio.to_thread(trace_file, store, run)
        except StoreError as error:
            return PlainTextResponse(f"{error}\n", 404)
        out = temporary("pdf").with_name("report.pdf")
        removal = BackgroundTask(shutil.rmtree, out.parent)
        if failure := await report_of(store, run, out):
            return PlainTextResponse(f"{in_page_words(failure)}\n", 422, background=removal)
        return FileResponse(out, background=removal)


async def _read_trace(store: Path, run: str, ending: str) -> Response:
    """Return the trace of a run in another form, made by a separate process."""
    try:
        file = await asyncio.to_thread(trace_file, store, run)
    except StoreError as error:
        return PlainTextResponse(f"{error}\n", 404)
    out = temporary(ending)
    removal = BackgroundTask(shutil.rmtree, out.parent)
    if failure := await in_process(file, out):
        return PlainTextResponse(f"{failure}\n", 422, background=removal)
    return FileResponse(out, background=removal)


def _add_live(app: FastAPI, panel: Panel, admission: Admission) -> None:
    """Add the websocket for states and commands."""
    unknown = Unknown()

    @app.websocket("/api/live")
    async def live(socket: WebSocket) -> None:
        await socket.accept()
        client = await _greeted(socket, panel, admission, unknown)
        if client is None:
            return
        sending = asyncio.create_task(_send(socket, client))
        try:
            while True:
                panel.take(client, _read(await socket.receive_text()))
        except (ValidationError, KeyError):  # not a message, or bytes instead of text
            await _close(socket, _UNREADABLE, "this is no message of the protocol")
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            panel.leave(client)
            sending.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sending


def check_page() -> None:
    """Refuse to serve a panel whose page was not built.

    Raises
    ------
    OptionError
        If this is a checkout in which ``make panel`` has not run; a wheel holds the page.
    """
    if not (PAGE / "index.html").exists():
        raise OptionError(
            "the page of the panel was not built in this checkout", remedy="Run: make panel"
        )


class _BuiltPage(StaticFiles):
    """The built page, compressed if the browser accepts that."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        packed = PAGE / f"{path}.gz"
        accepted = Headers(scope=scope).get("accept-encoding", "")
        if path.startswith(_HASHED) and "gzip" in accepted and packed.is_file():
            kind, _ = mimetypes.guess_type(path)
            return FileResponse(
                packed, media_type=kind, headers={"Content-Encoding": "gzip", **_VARIES}
            )
        return await super().get_response(path, scope)


_HASHED = "assets/"
_VARIES = {"Vary": "Accept-Encoding"}
_CACHE_CONTROL = "private, max-age=31536000, immutable"


def _add_page(app: FastAPI) -> None:
    """Add the page if it was built; the rest of the interface works without."""
    if (PAGE / "index.html").exists():
        app.mount("/", _BuiltPage(directory=PAGE, html=True))


def _read(text: str) -> say.Stop | say.Control | say.Alive | say.Act:
    message = say.CLIENT_MESSAGE.validate_json(text)
    if isinstance(message, say.Hello):
        raise KeyError("a second hello")
    return message


async def _greeted(
    socket: WebSocket, panel: Panel, admission: Admission, unknown: Unknown
) -> Client | None:
    """Return the client at a socket after its hello; close the socket without one."""
    try:
        async with unknown.one_more():
            hello = say.CLIENT_MESSAGE.validate_json(await socket.receive_text())
    except (ValidationError, KeyError):
        await _close(socket, _UNREADABLE, "this is no message of the protocol")
        return None
    except TimeoutError:
        await _close(socket, _SLOW, "no hello came")
        return None
    except (WebSocketDisconnect, RuntimeError):
        return None
    if not isinstance(hello, say.Hello):
        await _close(socket, _UNREADABLE, "the first message is not a hello")
    elif not admission.knows(hello.token if admission.token else ""):
        await _close(socket, _REFUSED, "the token is not the right one")
    elif hello.protocol != say.PANEL_PROTOCOL:
        await _close(socket, _OTHER_PROTOCOL, f"this panel speaks protocol {say.PANEL_PROTOCOL}")
    else:
        return panel.welcome(hello.name)
    return None


async def _send(socket: WebSocket, client: Client) -> None:
    while not client.full:
        if (text := await client.next_text(clock_s)) is not None:
            await socket.send_text(text)
    await _close(socket, _SLOW, "the client does not read its messages")


async def _close(socket: WebSocket, code: int, why: str) -> None:
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(code, why)
