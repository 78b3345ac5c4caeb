"""Checks of the arguments of Python callers: a wrong type raises an ``InputError``.

The parsers of options check the text of the command line. A caller in Python may pass any object,
so ``checked`` compares each argument with the annotation of its parameter.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, get_args, get_origin

from threadline.base.reading import noting_inputs
from threadline.errors import BudgetError, OptionError

P = ParamSpec("P")
T = TypeVar("T")
_MOST = 60  # characters of a value in a message
_WORDS = {
    str: "a text",
    Path: "a path",
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    NoneType: "None",
}


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that refuses arguments whose types differ from its annotations.

    Inside the returned function, unusable files and a lack of memory raise the same errors as on
    the command line, and no output replaces a file that the same call has read.

    Raises
    ------
    OptionError
        Raised by the returned function for a wrong type; names the argument and its valid types.
    """

    @wraps(function)
    def wrapper(*positional: P.args, **named: P.kwargs) -> T:
        _check(function, positional, named)
        try:
            with noting_inputs():
                return function(*positional, **named)
        except OSError as error:
            raise OptionError(
                f"cannot use {error.filename or 'a file'}: {error.strerror or error}",
                remedy="Give another path.",
            ) from error
        except MemoryError as error:
            raise BudgetError(
                "this needs more memory than there is",
                remedy="Give a shorter job, a higher feed or a longer clock.",
            ) from error

    return wrapper


def _check(function: Callable[..., Any], positional: Sequence[Any], named: dict[str, Any]) -> None:
    signature = inspect.signature(function)
    try:
        bound = signature.bind(*positional, **named)
    except TypeError as error:
        raise OptionError(
            f"{function.__name__}: {error}",
            remedy=f"It is {function.__name__}{_signature_text(signature)}.",
        ) from None
    for name, value in bound.arguments.items():
        is_variadic = signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
        if not is_variadic and (takes := _takes(function, name)) is not Any:
            check_argument(name, value, takes)


@cache
def _takes(function: Callable[..., Any], name: str) -> Any:
    """Return the types that an argument may have; Any if the function itself checks it."""
    annotation = inspect.signature(function).parameters[name].annotation
    if annotation is inspect.Parameter.empty:
        return Any
    # Evaluate parameters only: return types may be imported only for type checkers.
    return eval(annotation, function.__globals__) if isinstance(annotation, str) else annotation  # noqa: S307


def check_argument(name: str, value: object, takes: Any) -> None:
    """Refuse a value whose type the argument does not allow.

    Raises
    ------
    OptionError
        If the type is wrong, or a text cannot be encoded as UTF-8 or contains a null.
    """
    if not _fits(value, takes):
        raise OptionError(
            f"{name} is {_shown(value)}, of type {type(value).__name__}",
            remedy=f"Give {_named(takes)}.",
        )
    texts: Sequence[object] = value if isinstance(value, list | tuple) else [value]
    for text in texts:
        if isinstance(text, str | Path) and not _is_text(str(text)):
            raise OptionError(
                f"{name} is {_shown(text)}, not valid UTF-8 text", remedy="Correct it."
            )


def _fits(value: object, takes: Any) -> bool:
    if isinstance(takes, UnionType):
        return any(_fits(value, one) for one in get_args(takes))
    if get_origin(takes) is not None:  # a sequence of items of one type
        (item_type,) = get_args(takes)
        if isinstance(value, str | bytes) or not isinstance(value, Sequence):
            return False
        return all(_fits(one, item_type) for one in value)
    if takes in {int, float} and isinstance(value, bool):
        return False
    return isinstance(value, int | float if takes is float else takes)


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def _named(takes: Any) -> str:
    """Return the names of types as words for an error message."""
    if isinstance(takes, UnionType):
        *other_names, last_name = dict.fromkeys(map(_named, get_args(takes)))
        return f"{', '.join(other_names)} or {last_name}" if other_names else last_name
    if get_origin(takes) is not None:
        return f"a list, each item {_named(get_args(takes)[0])}"
    return _WORDS.get(takes, f"a {takes.__name__}")


def _shown(value: object) -> str:
    try:
        text = ascii(value)
    except Exception:
        return "an object"
    return text if len(text) <= _MOST else f"{text[:_MOST]}..."


def _signature_text(signature: inspect.Signature) -> str:
    return "(" + ", ".join(map(str, signature.parameters)) + ")"
