"""``threadline machines``: list the machines of the library, or print the file of one."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from threadline.cli.arguments import JsonOption
from threadline.cli.messages import note
from threadline.cli.output import print_json, say, say_lines
from threadline.machine import Machine, library_file, library_names, load_machine, overlay_names
from threadline.machine.model import clocked


def machines(
    show: Annotated[
        str | None, typer.Option(help="Print the file of this machine instead of the list.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """List the machines of the library: titles, axes, controllers and overlays.

    An overlay changes a few numbers of a machine: lathe-winder+physical. docs/machines.md describes
    the machine file.

    Example: threadline machines --show lathe-winder > mine.toml
    """
    if show is not None:
        _show(show, json)
        return
    entries = [machine_json(name) for name in library_names()]
    if json:
        print_json({"machines": entries})
        return
    for entry in entries:
        axes = ", ".join(f"{axis} {kind}" for axis, kind in entry["axes"].items())
        say(entry["name"])
        say(f"    {entry['title']}")
        say(f"    axes        {axes}")
        say(f"    controller  {', '.join(entry['controllers'])}")
        say(f"    overlays    {', '.join(entry['overlays']) or 'none'}")


def _show(name: str, json: bool) -> None:
    file = library_file(name)
    text = file.read_text(encoding="utf-8")
    if json:
        print_json({"name": name, "file": str(file), "text": text})
        return
    note(f"{file}")
    say_lines(text)


def machine_json(name: str) -> dict[str, Any]:
    """Return name, title, axes, controllers and overlays of a library machine as JSON content."""
    machine = load_machine(name)
    return {
        "name": machine.name,
        "title": machine.title,
        "axes": machine.moving,
        "controllers": controllers_of(machine),
        "overlays": list(overlay_names(name)),
        "file": str(library_file(name)),
        "sha256": machine.sha256,
    }


def controllers_of(machine: Machine) -> list[str]:
    """Return the controllers of a machine by kind, each with the period of its clock."""
    controllers = [f"{kind} every {_period(machine, clock)}" for kind, clock in clocked(machine)]
    return list(dict.fromkeys(controllers))


def _period(machine: Machine, clock: str) -> str:
    return f"{machine.clocks[clock].si * 1e3:g} ms"


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("machines")(machines)
