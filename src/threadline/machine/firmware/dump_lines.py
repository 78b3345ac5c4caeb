"""Lines of settings: strip prompts from a log, find the last dump, and find included files.

Users copy the answers of a firmware to ``$$`` or ``M503`` from terminals and logs of senders, which
add prefixes: ``> $$``, ``< $0=10``, ``Recv: echo: M92 X80.00``, ``22:24:55.009 : echo:``,
``[12:31:07] $0=10``, ``Config: M92 X80``; any other prefix counts if several settings have it.
"""

from __future__ import annotations

import re
from collections import Counter
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
_SETTING = re.compile(r"\$\d{1,3}\s*=|(?<![\w.])M(?:92|20[1345])\s*[A-Z]\s*-?\d")
_NO_PREFIX = re.compile(r"[;#%(/]|.*[\"']|.*\b(?:unknown|invalid|error|default|old|was)\b", re.I)
_ENOUGH = 3  # settings with the same words in front


@dataclass(frozen=True, slots=True)
class DumpLine:
    """A line of a log.

    Parameters
    ----------
    place
        File and line.
    text
        The line without prefixes of terminals.
    """

    place: Place
    text: str


@dataclass(frozen=True, slots=True)
class DumpSetting:
    """A setting and its value in one line of a log.

    Parameters
    ----------
    order
        Rank of the setting in a dump: firmwares list their settings in a fixed order.
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


def dump_lines(lines: Sequence[tuple[int, str]], file: str) -> list[DumpLine]:
    """Return the numbered lines of a log without prompts, time stamps and echoes."""
    texts = [_without(_BEFORE, line.strip()) for _, line in lines]
    shared = Counter(
        re.sub(r"\d+", "0", text[: match.start()].rstrip())
        for text in texts
        if (match := _SETTING.search(text)) is not None and match.start()
    )
    for prefix, count in shared.items():
        if count >= _ENOUGH and _NO_PREFIX.match(prefix) is None:
            form = re.compile("^" + re.escape(prefix).replace("0", r"\d+") + r"\s*")
            texts = [_without(_BEFORE, form.sub("", text, count=1)) for text in texts]
    return [
        DumpLine(Place(file, number), text) for (number, _), text in zip(lines, texts, strict=True)
    ]


def _without(before: re.Pattern[str], text: str) -> str:
    while (match := before.match(text)) is not None and match.end():
        text = text[match.end() :]
    return text.strip()


def in_force(
    sayings: Sequence[DumpSetting], same: Callable[[str, str], bool]
) -> tuple[list[DumpSetting], str]:
    """Return the settings of the last complete dump among ``sayings``, and a note or "".

    Settings without contradictions are one dump. Otherwise a new dump begins where the order of the
    settings restarts, and dumps with the most settings are complete. Settings after the last
    complete dump are appended; the caller refuses contradictions.

    Parameters
    ----------
    sayings
        In the order of the log.
    same
        Returns whether two texts mean the same value.
    """
    first: dict[str, DumpSetting] = {}
    if all(same(first.setdefault(one.key, one).text, one.text) for one in sayings):
        return list(first.values()), ""
    dumps: list[list[DumpSetting]] = [[]]
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
            f"{kept[0].place}: the last of {len(whole)} complete dumps in this file is read, lines "
            f"{kept[0].place.line} to {kept[-1].place.line}"
        )
    return [one for dump in dumps[last:] for one in dump], note


def files_beside(pattern: str, folder: Path) -> list[Path]:
    """Return the files that match ``pattern`` in ``folder`` or below; none outside of it."""
    try:
        found = sorted(folder.glob(pattern)) if pattern.strip("/") else []
    except (NotImplementedError, ValueError, IndexError):
        found = []
    whole = [path.resolve() for path in found if path.is_file()]
    return [path for path in whole if path.is_relative_to(folder)]
