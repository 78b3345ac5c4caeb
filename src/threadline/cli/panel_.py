"""``threadline panel``: the operator's panel in a browser."""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.arguments import MachineOption, ParOption, SpecOption
from threadline.cli.interrupt import TerminatedError
from threadline.cli.messages import at_work, note
from threadline.cli.output import say
from threadline.cli.runs_ import DEFAULT_STORE, StoreOption
from threadline.errors import OptionError
from threadline.live.links import at_link
from threadline.live.port import bare, in_url, is_host
from threadline.live.sim_process import LEAST_SPEED, REAL_TIME
from threadline.live.store.run_store import check_folder
from threadline.proof.pipeline import check_machine
from threadline.proof.request import chosen_machine
from threadline.verdict import load_spec

_MOST_SPEED = 100.0


def panel(
    machine: MachineOption,
    folder: Annotated[
        Path, typer.Argument(help="Project folder: the panel offers its programs.")
    ] = Path(),
    spec: SpecOption = None,
    link: Annotated[
        str,
        typer.Option(
            help="Link to the machine: sim is a simulated one, in its own process; sim:slower runs "
            "slower where the computer is too busy for real time; grbl:HOST:PORT or "
            "grbl:/dev/ttyUSB0 is a controller with grbl; hal:loopback and "
            "hal:plant are LinuxCNC's HAL without a machine."
        ),
    ] = "sim",
    speed: Annotated[
        float,
        typer.Option(
            min=LEAST_SPEED,
            max=_MOST_SPEED,
            help="With sim: simulated seconds per second; 1 is real time.",
        ),
    ] = REAL_TIME,
    host: Annotated[
        str, typer.Option(help="Address to listen at; any but 127.0.0.1 needs --token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to listen at.")] = 8750,
    token: Annotated[
        str, typer.Option(help="Secret word that every client needs; 16 characters or more.")
    ] = "",
    store: StoreOption = DEFAULT_STORE,
    par: ParOption = None,
) -> None:
    """Serve the operator's panel: calculate, home, jog, run, watch, stop.

    A separate process owns the machine. If the panel ends or hangs, that process stops the machine
    along its path. If a browser disconnects, a jog ends within 250 ms and a run goes on, for every
    other browser can stop it. Ctrl-C here ends the panel: it waits until the machine stands, and
    the exit status is 0.

    Example: threadline panel examples -m lathe-winder
    """
    if not folder.is_dir():
        raise OptionError(f"{str(folder)!r} is no folder", remedy="Name the project folder.")
    chosen = chosen_machine(machine, par)
    check_machine(chosen)
    load_spec(spec, chosen)
    check_folder(store)
    host = _checked_host(host)
    far_end = at_link(link, chosen, speed)
    # Imported here, so that no other command waits for a web server.
    import uvicorn

    from threadline.panel.admission import Admission, PromptHttp, PromptWebsocket
    from threadline.panel.calculation import Calculation, MachineGuide
    from threadline.panel.owner_process import OwnerLink, start_owner
    from threadline.panel.panel import Panel
    from threadline.panel.protocol import MOST_TEXT
    from threadline.panel.server import check_page, make_app
    from threadline.panel.stored_runs import Owned

    admission = Admission(host, token)
    check_page()
    owned = Owned(chosen, spec, folder, store, speed, link)
    with tempfile.TemporaryDirectory(prefix="threadline-panel-") as results_folder:
        calculation = Calculation(chosen, spec, folder, Path(results_folder))
        owner = OwnerLink(lambda: start_owner(owned))
        served = Panel(chosen, owner, calculation, link, far_end)
        guide = MachineGuide(chosen, Path(results_folder))
        app = make_app(served, guide, folder, store, admission)
        listening = _listen(host, port)
        url = f"http://{in_url(host)}:{port}/"
        say(f"The panel of {chosen.name} is at {url} (Ctrl-C stops and ends)")
        at_work("serving", shown=True)  # the browser shows its work
        config = uvicorn.Config(
            app,
            log_level="warning",
            http=PromptHttp,
            ws=PromptWebsocket,
            ws_max_size=MOST_TEXT,
            timeout_graceful_shutdown=1,
            access_log=False,
        )
        logging.getLogger("uvicorn.error").addFilter(_of_the_panel)
        logging.getLogger("asyncio").addHandler(to_standard_error())
        try:
            uvicorn.Server(config).run(sockets=[listening])
        except TerminatedError:
            note(f"the panel ends: {served.ended}")
            raise
        except KeyboardInterrupt:  # Ctrl-C ends a panel
            pass
        say(f"The panel has ended: {served.ended.rstrip('.')}.")


def to_standard_error() -> logging.Handler:
    """Return a log handler for errors of tasks and connections, which no caller catches."""
    handler = logging.StreamHandler()
    handler.setLevel(logging.ERROR)
    handler.setFormatter(logging.Formatter("error of the panel: %(message)s"))
    handler.addFilter(_of_the_panel)
    return handler


def _of_the_panel(record: logging.LogRecord) -> bool:
    """Return whether a log record of the server reports a fault of the panel.

    Malformed text from a client is no fault, nor a request abandoned at shutdown.
    """
    error = record.exc_info and record.exc_info[1]
    is_cancelled = isinstance(error, asyncio.CancelledError) or str(record.msg).startswith(
        "Cancel "
    )
    return not (is_cancelled or isinstance(error, UnicodeDecodeError))


def _checked_host(host: str) -> str:
    """Return an address to listen at, without brackets.

    Raises
    ------
    OptionError
        If it is neither an address nor a valid host name.
    """
    if not is_host(host := bare(host)):
        raise OptionError(
            f"--host {host[:60]!r} is no address", remedy="Give one of this computer: 127.0.0.1."
        )
    return host


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address.

    Raises
    ------
    OptionError
        If the address cannot be used.
    """
    try:
        return socket.create_server((host, port), family=_family(host), reuse_port=False)
    except OSError as error:
        why = str(error.strerror or error).partition(" (while")[0]  # the rest repeats the address
        is_port_fault = error.errno in (errno.EADDRINUSE, errno.EACCES)
        raise OptionError(
            f"cannot listen at {in_url(host)}:{port}: {why}",
            remedy="Give another --port, or end the program that has this one."
            if is_port_fault
            else f"--host {host} has to be an address of this computer.",
        ) from error


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("panel")(panel)
