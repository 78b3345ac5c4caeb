"""What the declaration of an option says: its name, value, help, verbs, kinds and doors."""

from __future__ import annotations

import keyword
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

Word = object
"""What an option is given: mostly its text as typed, for a flag whether it is given."""
TICKS, SWITCHES, STEPS = "ticks", "switches", "steps"
"""Names of the kinds of work, as ``kinds`` has them."""
MOST_TEXT = 200
"""Longest text of an option that the panel takes."""


class Type(StrEnum):
    """What is typed for an option."""

    TEXT = "text"
    FLAG = "flag"
    COUNT = "whole number"
    RATIO = "ratio"
    FILE = "file"
    SPEC = "specification file"
    MACHINE = "machine file or library name"


class Group(StrEnum):
    """What an option is for."""

    INPUT = "Input files"
    PLAN = "Planning"
    LEVEL = "Level of the verdict"
    SEARCH = "Search for the fastest"


class Door(StrEnum):
    """Where an option can be given, besides recordings and proofs, which only repeat it."""

    LINE = "command line"
    PYTHON = "Python"
    PANEL = "panel"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """How a planning option is written into recordings and proofs, and read from there.

    Parameters
    ----------
    key
        Its name there.
    write
        Returns the text of a value; None writes nothing.
    read
        Returns the value of a text.
    required
        Whether a recording that does not name it is refused.
    """

    key: str
    write: Callable[[Any], str | None]
    read: Callable[[str], Any]
    required: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """One option.

    Parameters
    ----------
    name
        As typed on the command line, without the dashes.
    help
        What it does, as ``--help`` says it.
    group
        What it is for.
    verbs
        The verbs that take it.
    type, unit
        What is typed, and the SI unit of the value; empty for a value without a unit.
    default
        What holds where it is not given.
    defaults
        By verb: the default of a verb that has another.
    kinds
        The kinds of work for which it has a meaning.
    doors
        Where it can be given.
    attribute, parse
        The attribute of ``Options`` that holds its value, and the reader of its text; empty for an
        option that ``options_of`` makes part of another.
    recorded
        How recordings and proofs say it; None where they do not.
    helps
        By verb: the help of a verb for which it does something else.
    short
        Short form on the command line.
    least, most
        Of a whole number.
    choices
        The texts that it may be given, where they are few.
    many
        The verbs that take several values, separated by commas.
    label, placeholder
        Its field on the panel's page; without a label the page has no field for it.
    most_text
        Longest text that the panel takes.
    """

    name: str
    help: str
    group: Group
    verbs: tuple[str, ...]
    type: Type = Type.TEXT
    unit: str = ""
    default: str | bool | None = None
    defaults: Mapping[str, str] = field(default_factory=dict)
    kinds: tuple[str, ...] = (TICKS, SWITCHES, STEPS)
    doors: tuple[Door, ...] = tuple(Door)
    attribute: str = ""
    parse: Callable[[Any], Any] | None = None
    recorded: Recorded | None = None
    helps: Mapping[str, str] = field(default_factory=dict)
    short: str = ""
    least: int | None = None
    most: int | None = None
    choices: tuple[str, ...] = ()
    many: tuple[str, ...] = ()
    label: str = ""
    placeholder: str = ""
    most_text: int = MOST_TEXT

    @property
    def word(self) -> str:
        """Its name in Python."""
        word = self.name.replace("-", "_")
        return f"{word}_" if keyword.iskeyword(word) else word

    @property
    def typed(self) -> str:
        """Its name on the command line."""
        return f"--{self.name}"

    def default_of(self, verb: str) -> str | bool | None:
        """Return the default of a verb: ``judge`` takes what a recording names."""
        open_ended = verb == "judge" and self.type is not Type.FLAG
        return None if open_ended or verb in self.many else self.defaults.get(verb, self.default)

    def help_of(self, verb: str) -> str:
        """Return the help of a verb."""
        return self.helps.get(verb, self.help)
