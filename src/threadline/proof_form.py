"""The form of a proof's file: what has to be in it, and of which type, before any of it is used."""

from __future__ import annotations

from collections.abc import Mapping
from types import UnionType
from typing import Any

_Form = Mapping[str, Any] | list[Any] | type | UnionType
"""Entries by name; a list of one form for all its entries; or a type."""
_MACHINE: _Form = {"name": str, "reference": str, "par": str | None, "sha256": str}
_CRITERION: _Form = {"name": str, "axis": str | None, "status": str, "required": bool}
_PROOF: Mapping[str, _Form] = {
    "threadline": str,
    "level": str,
    "job": {"name": str, "file": str, "sha256": str},
    "machine": _MACHINE,
    "actual": dict | None,  # as "machine", where it is there
    "options": {"given": dict, "sha256": str},
    "spec": {"name": str, "file": str | None, "sha256": str},
    "commands": {"kind": str, "sha256": str},
    "verdict": {"passed": bool, "simulated": bool, "criteria": [_CRITERION]},
}


def misformed(content: Mapping[str, Any]) -> str:
    """Return the name of the first entry of a proof that lacks or is of another type; else empty.

    Parameters
    ----------
    content
        All that the file says.
    """
    given = content.get("options")
    options = given.get("given") if isinstance(given, dict) else None
    return (
        _wrong(content, _PROOF, "")
        or ("" if content["actual"] is None else _wrong(content["actual"], _MACHINE, "actual"))
        or _wrong(options, dict.fromkeys(options or (), str), "options.given")
    )


def _wrong(found: object, form: _Form, at: str) -> str:
    if isinstance(form, Mapping):
        if not isinstance(found, dict):
            return at
        names = ((found.get(key, ...), of, f"{at}.{key}".lstrip(".")) for key, of in form.items())
    elif isinstance(form, list):
        if not isinstance(found, list):
            return at
        names = ((one, form[0], f"{at}.{number}") for number, one in enumerate(found))
    else:
        return "" if isinstance(found, form) else at
    return next(filter(None, (_wrong(*one) for one in names)), "")
