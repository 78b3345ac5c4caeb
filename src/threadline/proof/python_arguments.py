"""Options as arguments of the Python functions: their types, signatures, and errors that name them.

The command line writes ``--feed-forward`` where Python writes ``feed_forward=True``. Errors are
written once, with the options of the command line, and reworded here for Python.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

from threadline.errors import ThreadlineError
from threadline.machine import Machine
from threadline.proof.option_form import Door, Option, Type
from threadline.proof.option_table import PYTHON_VERBS, list_argument, options_for, verb_of
from threadline.verdict import Spec

P = ParamSpec("P")
T = TypeVar("T")
VerbT = TypeVar("VerbT", bound=Callable[..., object])


def python_type(one: Option, verb: str) -> str:
    """Return the type of an option of a verb in Python, as ``__init__.pyi`` declares it.

    >>> from threadline.proof.option_table import option
    >>> python_type(option("feed"), "prove"), python_type(option("feed-forward"), "prove")
    ('str | None', 'bool')
    """
    if one.choices:
        return f"Literal[{', '.join(repr(text).replace(chr(39), chr(34)) for text in one.choices)}]"
    plain, _ = _TYPES[one.type]
    if verb in one.many:
        plain = f"{plain} | Sequence[{plain}]"
    return plain if one.default_of(verb) is not None else f"{plain} | None"


_TYPED_OPTION = re.compile(
    r"""(?<![\w-])--([a-z][a-z-]*)(?:[ =]?("[^"]*"|'[^']*')|[ ]([a-z0-9]+(?:-[a-z0-9]+)*))?"""
)
LEVEL_FLAGS = {"nominal": 'level="nominal"', "tolerances": 'level="over tolerances"'}
"""Flags of the command line, as Python writes them."""
_OTHER_ARGUMENTS = {
    **LEVEL_FLAGS, "slower": "slower=True",
    "target": "target=", "out": "out=", "job": "job=", "machine": "machine=", "sign": "sign=",
    "gain": "gain=", "sensors": "sensors=", "ahead": "ahead=", "direction": "direction=",
    "coupling": "coupling=", "controller": "controller=", "rule": "rule=", "axis": "axis=",
    "amplitude": "amplitude=", "link": "link=", "numbers": "numbers=", "experiment": "experiment=",
    "speed": "speed=", "store": "store=", "override": "override=", "proof": "proof=", "key": "key=",
    "approach": "approach=True", "pass-stops": "pass_stops=True", "from": "runs=",
}  # fmt: skip


def as_arguments(text: str, verb: str = "") -> str:
    """Return a message in which command-line options are replaced by Python arguments.

    With a ``verb`` the options are named as its Python function names them.

    >>> as_arguments('--low "1 m/s" is above --high. Leave --feed-forward out.')
    'low="1 m/s" is above high=. Leave feed_forward=True out.'
    >>> as_arguments("Give --interpolation optimal."), as_arguments('Leave --feed out.', "compare")
    ('Give interpolation="optimal".', 'Leave feeds= out.')
    """
    words = {one.name: one for verb in PYTHON_VERBS for one in options_for(verb, Door.PYTHON)}

    def spoken(match: re.Match[str]) -> str:
        entry, value, bare = words.get(match[1]), match[2], match[3]
        rest = "" if bare is None else f" {bare}"
        if entry is None:
            if match[1] in _OTHER_ARGUMENTS:
                return _OTHER_ARGUMENTS[match[1]] + rest
            return match[0]
        if entry.type is Type.FLAG:
            return f"{entry.word}=True{rest}"
        if entry.values is not None and bare in entry.values():
            value, rest = f'"{bare}"', ""
        if name := list_argument(entry, verb):
            return f"{name}={f'[{value}]' if value else ''}{rest}"
        return f"{entry.word}={value or ''}{rest}"

    return _TYPED_OPTION.sub(spoken, text).replace("(-m)", "(machine=)").replace(" -s,", " spec=,")


def types_taken(one: Option, verb: str) -> Any:
    """Return the Python types that an option of a verb accepts."""
    plain: Any = _TYPES[one.type][1]
    if verb in one.many:
        plain = plain | Sequence[plain]
    return plain if one.default_of(verb) is not None else plain | None


_TYPES: Mapping[Type, tuple[str, Any]] = {
    Type.TEXT: ("str", str),
    Type.FLAG: ("bool", bool),
    Type.COUNT: ("int", int),
    Type.RATIO: ("float | str", float | str),
    Type.FILE: ("PathLike", str | Path),
    Type.SPEC: ("PathLike | Spec", str | Path | Spec),
    Type.MACHINE: ("PathLike | Machine", str | Path | Machine),
}


def in_arguments(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function with errors that name Python arguments instead of options."""
    verb_name = verb_of(function.__name__)

    @wraps(function)
    def verb(*positional: P.args, **named: P.kwargs) -> T:
        try:
            return function(*positional, **named)
        except ThreadlineError as error:
            error.message = as_arguments(error.message, verb_name)
            error.remedy = as_arguments(error.remedy, verb_name)
            error.args = (error.message, *error.args[1:])
            raise

    return verb


def with_options(function: VerbT) -> VerbT:
    """Return the function with a signature that lists every option of its verb, with its default.

    Its errors name Python arguments instead of command-line options.
    """
    verb = in_arguments(function)
    verb_name = verb_of(function.__name__)
    signature = inspect.signature(function)
    positional = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
    option_parameters = [
        inspect.Parameter(
            one.word,
            inspect.Parameter.KEYWORD_ONLY,
            default=one.default_of(verb_name),
            annotation=python_type(one, verb_name),
        )
        for one in options_for(verb_name, Door.PYTHON)
        if one.word not in signature.parameters
    ]
    verb.__signature__ = signature.replace(parameters=[*positional, *option_parameters])  # type: ignore[attr-defined]
    verb.words = tuple(one.name for one in option_parameters)  # type: ignore[attr-defined]
    return cast(VerbT, verb)
