"""The declaration of an option: name, value, help, verbs, kinds and doors."""

from __future__ import annotations

import keyword
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

Word = object
"""Value of an option: mostly its text as typed; for a flag whether it was given."""
TICKS, SWITCHES, STEPS = "ticks", "switches", "steps"
"""Names of the kinds of work, as in ``kinds``."""
MOST_TEXT = 200
"""Longest option text that the panel accepts."""


class Type(StrEnum):
    """Type of an option's value."""

    TEXT = "text"
    FLAG = "flag"
    COUNT = "whole number"
    RATIO = "ratio"
    FILE = "file"
    SPEC = "specification file"
    MACHINE = "machine file or library name"


class Group(StrEnum):
    """Purpose of an option."""

    INPUT = "Input files"
    PLAN = "Planning"
    LEVEL = "Level of the verdict"
    SEARCH = "Search for the fastest"
    WHERE = "Where machines are judged"


class Door(StrEnum):
    """Interface through which an option can be given; recordings and proofs only store it."""

    LINE = "command line"
    PYTHON = "Python"
    PANEL = "panel"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileForm:
    """How a planning option is written into recordings and proofs, and read from them.

    Parameters
    ----------
    key
        Its name in the file.
    write
        Returns the text for a value; nothing is written if the text is None.
    read
        Returns the value for a text.
    required
        Whether a recording without it is refused.
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
        Text for ``--help``.
    group
        Purpose of the option.
    verbs
        The verbs that take this option.
    type, unit
        Type of the value, and its SI unit; empty for a value without a unit.
    default
        Value if the option is not given.
    defaults
        Other defaults, by verb.
    kinds
        The kinds of work to which it applies.
    doors
        Interfaces through which it can be given.
    attribute, parse
        The attribute of ``Options`` that holds its value, and the parser of its text; empty for an
        option that ``options_of`` merges into another option.
    recorded
        How recordings and proofs write the option; None if they do not write it.
    helps
        Other help texts, by verb.
    short
        Short form on the command line.
    least, most
        Smallest and largest value of a whole number.
    choices
        The permitted texts, if there are only a few.
    values
        Returns the usual texts of an option whose values are names; None for other values.
    many
        The verbs for which the option takes several values, separated by commas; in Python also as
        a list.
    label, placeholder
        Label and placeholder of its field on the panel's page; without a label there is no field.
    most_text
        Longest text that the panel accepts.
    """

    name: str
    help: str
    group: Group
    verbs: tuple[str, ...]
    type: Type = Type.TEXT
    unit: str = ""
    default: str | bool | None = None
    defaults: Mapping[str, str | None] = field(default_factory=dict)
    kinds: tuple[str, ...] = (TICKS, SWITCHES, STEPS)
    doors: tuple[Door, ...] = tuple(Door)
    attribute: str = ""
    parse: Callable[[Any], Any] | None = None
    recorded: FileForm | None = None
    helps: Mapping[str, str] = field(default_factory=dict)
    short: str = ""
    least: int | None = None
    most: int | None = None
    choices: tuple[str, ...] = ()
    values: Callable[[], tuple[str, ...]] | None = None
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
        """Return the default for a verb; None for ``judge``, which takes the recording's value."""
        open_ended = verb == "judge" and self.type is not Type.FLAG
        return None if open_ended or verb in self.many else self.defaults.get(verb, self.default)

    def help_of(self, verb: str) -> str:
        """Return the help text for a verb."""
        return self.helps.get(verb, self.help)
