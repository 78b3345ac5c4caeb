"""Turn the table of options, and a command's own groups of options, into parameters for typer.

A command receives its options as a few objects: ``Words`` for the table, and dataclasses whose
fields are options of this command. ``add`` gives typer each option separately.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from threadline.cli import completion
from threadline.cli.messages import note
from threadline.proof.option_form import Group, Option, Type
from threadline.proof.option_table import options_for
from threadline.proof.request import Words

_NAMED: Mapping[Type, Any] = {
    Type.TEXT: str,
    Type.FLAG: bool,
    Type.COUNT: int,
    Type.RATIO: str,
    Type.FILE: Path,
    Type.SPEC: Path,
    Type.MACHINE: str,
}


def add(app: typer.Typer, verb: str, command: Callable[..., None]) -> None:
    """Add a command to the program.

    Parameters
    ----------
    verb
        Name of the command, and of the verb in the table of options.
    command
        Takes the table's options as the parameter of type ``Words``, its own groups as
        dataclasses, and any other option as a parameter.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, tuple[Callable[..., object], list[str]]] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        kind = parameter.annotation
        if kind is Words:
            table = options_for(verb)
            parameters += [_parameter(one, verb) for one in table]
            groups[name] = (partial(_words, verb), [one.word for one in table])
        elif is_dataclass(kind) and isinstance(kind, type):
            hints = get_type_hints(kind, include_extras=True)
            parameters += [_field(one, hints[one.name]) for one in fields(kind)]
            groups[name] = (kind, [one.name for one in fields(kind)])
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    def called(**given: Any) -> None:
        built = {
            name: make(**{one: given.pop(one) for one in own})
            for name, (make, own) in groups.items()
        }
        words = next((one for one in built.values() if isinstance(one, Words)), None)
        if words is None:
            command(**built, **given)
            return
        with words.judging(note):
            command(**built, **given)

    called.__doc__, called.__name__ = command.__doc__, command.__name__
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    app.command(verb, cls=SectionedCommand)(called)


class SectionedCommand(TyperCommand):
    """A command whose help lists its options by purpose, as the page of the options does."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options for ``--help``; options of this command alone come last."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": []}
        sections |= {group.value: [] for group in Group} | {"Options of this command": []}
        for one in self.get_params(ctx):
            title = getattr(one, "rich_help_panel", None) or "Options of this command"
            if one.param_type_name == "argument":
                title = "Arguments"
            if (record := one.get_help_record(ctx)) is not None:
                sections[title].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def _words(verb: str, **given: Any) -> Words:
    return Words(verb, given)


def _parameter(one: Option, verb: str) -> inspect.Parameter:
    """Return an option of the table as a parameter that typer understands."""
    kind, default = _NAMED[one.type], one.default_of(verb)
    if default is None:
        kind = kind | None
    names = [one.typed, *([f"-{one.short}"] if one.short else [])]
    parameter = typer.Option(
        *names,
        help=one.help_of(verb),
        min=one.least,
        max=one.most,
        autocompletion=_completed(one, verb),
        rich_help_panel=one.group.value,
    )
    return inspect.Parameter(
        one.word,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind, parameter],
    )


def _completed(one: Option, verb: str) -> Callable[[str], list[str]] | None:
    """Return the function that completes the value of an option; None if it has no known values."""
    if one.type is Type.MACHINE:
        return completion.machines
    if one.values is None:
        return None
    complete = completion.one_of(one.values)
    return completion.last_of(complete) if verb in one.many else complete


def _field(one: Field[Any], annotation: Any) -> inspect.Parameter:
    """Return a field of a group of options as a parameter."""
    default = inspect.Parameter.empty if one.default is MISSING else one.default
    return inspect.Parameter(
        one.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
