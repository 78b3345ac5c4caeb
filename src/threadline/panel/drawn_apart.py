"""Drawings read and written in a process of their own, which can be ended at any time."""

from __future__ import annotations

import asyncio
import json
import sys

from pydantic import ValidationError

from threadline.errors import InputError
from threadline.importing import words_of
from threadline.panel.children import answer_of
from threadline.panel.drawn import SHAPES, dxf, opened

LONGEST_S = 20.0
"""Time in s that a drawing may take."""
_CHILD = words_of("threadline.panel.drawn_apart", "main")
_WRONG = 2
_one_at_a_time = asyncio.Semaphore(1)


async def read_apart(name: str, content: bytes) -> bytes | str:
    """Return, as JSON, what ``opened`` finds in a drawing, or a line that says why nothing."""
    return await _apart("shapes", name, content)


async def written_apart(content: bytes) -> bytes | str:
    """Return the DXF of shapes that come as JSON, or a line that says why there is none."""
    return await _apart("dxf", "drawing.dxf", content)


async def _apart(what: str, name: str, content: bytes) -> bytes | str:
    words = (sys.executable, "-c", _CHILD, what, name)
    try:
        async with _one_at_a_time:
            status, told, why = await answer_of(*words, sent=content, longest_s=LONGEST_S)
    except TimeoutError:
        return f"{name[:60]!r} takes longer than {LONGEST_S:g} s. Split it, or simplify it."
    except (OSError, ValueError) as error:  # a name that no process can be told
        return f"{name[:60]!r} cannot be read: {getattr(error, 'strerror', None) or error}"
    if status == 0:
        return told
    if status == _WRONG:
        return why.decode("utf-8", "replace").strip()
    return f"{name[:60]!r} cannot be read: the process that did has ended"


def why_invalid(error: ValidationError) -> str:
    """Return what is wrong with the first part that is, and where it stands."""
    first = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'it'}: {first['msg']}"


def main() -> None:
    """Answer what standard input has: a drawing, or shapes of which one is to be made."""
    what, name = sys.argv[1:]
    content = sys.stdin.buffer.read()
    try:
        if what == "shapes":
            made = json.dumps(opened(name, content), allow_nan=False).encode()
        else:
            made = dxf(SHAPES.validate_json(content))
    except (InputError, ValidationError) as error:
        why = why_invalid(error) if isinstance(error, ValidationError) else str(error)
        sys.stderr.write(f"{why}\n")
        sys.exit(_WRONG)
    sys.stdout.buffer.write(made)
