"""Lines of settings: a log without its prompts, the dump in force, and files that are included.

What a firmware answers to ``$$`` or ``M503`` is copied from terminals and logs of senders, of which
each writes something before the answer: ``> $$``, ``< $0=10``, ``Recv: echo:  M92 X80.00``,
``22:24:55.009 : echo:``, ``[12:31:07] $0=10``, ``Config:  M92 X80``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from threadline.errors import Place

_DATE = r"\[?\d{4}[-/.]\d{1,2}[-/.]\d{1,2}[ T]?"
_TIME = r"\[?\d{1,2}:\d{2}(?::\d{2})?(?:[.,]\d+)?(?:\s*[AaPp][Mm]|Z)?\]?"
_WORDS = (
    r"\[?(?:recv|received|rcvd|rx|read|send|sending|sent|tx|write|client|console|feeder|serial\w*|info|"
    r"debug)\b\s*[:>|<\]-]+"
)
_BEFORE = re.compile(
    rf"\s*(?:{_DATE}|{_TIME}|{_WORDS}|echo:|config:|[<>│┃]+|->|<-|=>|[:|-](?=\s))\s*",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class DumpLine:
    """A line of a log.

    Parameters
    ----------
    place
        Where it stands.
    text
        The line without what terminals write before it.
    """

    place: Place
    text: str


@dataclass(frozen=True, slots=True)
class Saying:
    """A setting and its value, as one line of a log has them.

    Parameters
    ----------
    order
        Place of the setting in a dump: firmwares list their settings in one order.
    key
        The setting.
    text
        Its value, as typed.
    place
        Where it stands.
    """

    order: int
    key: str
    text: str
    place: Place


def dump_lines(lines: Sequence[str], file: str) -> list[DumpLine]:
    """Return the lines of a log without prompts, time stamps and echoes; numbered from 1."""
    found = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        while (match := _BEFORE.match(text)) is not None and match.end():
            text = text[match.end() :]
        found.append(DumpLine(Place(file, number), text.strip()))
    return found


def in_force(
    sayings: Sequence[Saying], same: Callable[[str, str], bool]
) -> tuple[list[Saying], str]:
    """Return the settings of the last whole dump among ``sayings``, and a note; empty without one.

    Settings that nowhere contradict each other are one dump. Otherwise a dump begins where the
    order of the settings begins anew, and whole are those that say as much as any. What comes after
    the last whole one is given out behind it: where that contradicts, the caller refuses it.

    Parameters
    ----------
    sayings
        In the order of the log.
    same
        Whether two texts are the same value.
    """
    first: dict[str, Saying] = {}
    if all(same(first.setdefault(one.key, one).text, one.text) for one in sayings):
        return list(first.values()), ""
    dumps: list[list[Saying]] = [[]]
    for one in sayings:
        if dumps[-1] and one.order < dumps[-1][-1].order:
            dumps.append([])
        dumps[-1].append(one)
    most = max(len({one.key for one in dump}) for dump in dumps)
    whole = [at for at, dump in enumerate(dumps) if len({one.key for one in dump}) == most]
    last = whole[-1]
    kept = dumps[last]
    note = ""
    if len(whole) > 1:
        note = (
            f"{kept[0].place}: the last of {len(whole)} whole dumps in this file is read, lines "
            f"{kept[0].place.line} to {kept[-1].place.line}"
        )
    return [one for dump in dumps[last:] for one in dump], note


def files_beside(pattern: str, folder: Path) -> list[Path]:
    """Return the files that ``pattern`` names in ``folder`` and below it; none anywhere else."""
    try:
        found = sorted(folder.glob(pattern)) if pattern.strip("/") else []
    except (NotImplementedError, ValueError, IndexError):
        found = []
    whole = [path.resolve() for path in found if path.is_file()]
    return [path for path in whole if path.is_relative_to(folder)]
