"""A grbl board for a panel, and its console: typed lines, and a log.

A typed line must never move anything, since no lease would end such a motion. It must not change
how the numbers of a later program are read. It is sent only while nothing moves.

Sources: "Grbl v1.1 Commands" (``$`` commands, realtime bytes) of gnea/grbl.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from threadline.errors import CommandError, LinkFaultError
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_settings import INCHES, REPORTS, BoardSetting
from threadline.live.grbl_words import Status, in_words
from threadline.live.guards import clock_s

_MOST_CHARACTERS = 70  # grbl 1.1 takes 80 with its line feed; older builds 70
_MOST_LINES = 400
_QUESTIONS = frozenset({"$", "$$", "$#", "$G", "$I", "$I+", "$N"})
_SWITCH_OFF = frozenset({"M5", "M9"})
_SETTING = re.compile(r"\$(\d{1,3})=(-?\d{1,9}(?:\.\d{0,9})?)")
_AT_ONCE = {
    "?": "the panel asks for the state ten times a second, and shows it",
    "!": "it holds at once: press Hold",
    "~": "it resumes at once: press Resume",
}
_REASONS: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"\$J="), "it moves, and a line has no lease that ends it: jog with the buttons"),
    (re.compile(r"\$H"), "it moves: press Home all, which STOP can end"),
    (re.compile(r"\$X"), "it clears an alarm: press Reset, which compares the settings again"),
    (re.compile(r"\$C"), "in check mode programs are read and nothing moves: runs would fail"),
    (re.compile(r"\$SLP"), "it switches the motors off, and the positions are lost"),
    (re.compile(r"\$RST="), "it deletes settings that were compared with the machine file"),
    (re.compile(r"\$N\d"), "a start-up line runs by itself after each reset"),
    (re.compile(r"\$\d+="), "only a number can be written into a setting"),
    (re.compile(r"\$"), "it is not one of $ $$ $# $G $I $I+ $N, nor a setting like $110=5000"),
)
_PROGRAM = (
    "it moves, switches something on, or changes how a program is read: jog with the buttons, or "
    "make it a program, which is calculated and can be stopped"
)
_ANSWER_S = 3.0
_LISTEN_S = 0.05


@dataclass(frozen=True, slots=True)
class ConsoleLine:
    """A typed line that may be sent.

    Parameters
    ----------
    text
        The line, without blanks and in capitals, as grbl reads it.
    setting
        Number of the setting that it writes; None if it changes none.
    """

    text: str
    setting: int | None = None


def console_line(typed: str) -> ConsoleLine:
    """Return a typed line as it is sent.

    Raises
    ------
    CommandError
        If a console must not send it; the message says why, and what to do instead.

    Examples
    --------
    >>> console_line(" $ 110 = 4800 ")
    ConsoleLine(text='$110=4800', setting=110)
    >>> console_line("g0 x10")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    threadline.errors.CommandError: [COMMAND] the console does not send 'G0X10': it moves, ...
    """
    text = re.sub(r"[ \t]+", "", typed).upper()
    if not text:
        raise CommandError("the line is empty", remedy="Type $$ for the settings.")
    if len(text) > _MOST_CHARACTERS:
        raise CommandError(
            f"the line has {len(text)} characters, the most is {_MOST_CHARACTERS}",
            remedy="Type a shorter one.",
        )
    if why := _refusal(text):
        shown = text if text.isprintable() and text.isascii() else ascii(text)[1:-1]
        raise CommandError(f"the console does not send {shown[:40]!r}: {why}")
    form = _SETTING.fullmatch(text)
    return ConsoleLine(text, None if form is None else int(form[1]))


def _refusal(text: str) -> str:
    """Return why a line is not sent; empty if it may be."""
    for character in text:
        if character in _AT_ONCE:
            return _AT_ONCE[character]
        if not " " < character <= "~":
            return "it has a character that the controller acts on at once, or does not know"
    setting = _SETTING.fullmatch(text)
    if setting is not None:
        return _unreadable(int(setting[1]), float(setting[2]))
    if text in _QUESTIONS or text in _SWITCH_OFF:
        return ""
    return next((why for pattern, why in _REASONS if pattern.match(text)), _PROGRAM)


def _unreadable(setting: int, value: float) -> str:
    """Return why a setting would make the reports unreadable; empty if it would not."""
    if setting == INCHES and value:
        return "it would report inches, and millimetres are read"
    if setting == REPORTS and not int(value) & 1:
        return "it would report work positions, and machine positions are read: add 1"
    return ""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A line that was sent to the controller, or came from it.

    Parameters
    ----------
    at_s
        When, by the clock of this computer, s since 1970.
    kind
        ``typed``, ``sent`` (by this program), ``program`` (of a run) or ``heard``.
    text
        The line, or the name of a byte that acts at once.
    words
        Meaning of a code; empty without one.
    """

    at_s: float
    kind: str
    text: str
    words: str = ""


_BYTES = {b"\x18": "reset (0x18)", b"!": "feed hold (!)", b"~": "resume (~)"}
_UNTOLD = re.compile(r"<.*>|\$J=.*")


class Traffic:
    """Keeps the latest lines to and from a controller, for the console.

    It leaves out status requests and reports, which come ten times a second, the pieces of a jog
    and their answers, the steps of an override, and the answers to the lines of a program.

    Parameters
    ----------
    in_program, in_jog
        Whether the lines of the moment belong to a program, or to a jog.
    """

    def __init__(self, in_program: Callable[[], bool], in_jog: Callable[[], bool]) -> None:
        self._in_program, self._in_jog = in_program, in_jog
        self._fresh: deque[Exchange] = deque(maxlen=_MOST_LINES)
        self._typed = ""

    def typed(self, text: str) -> None:
        """Note that the next line that is sent was typed."""
        self._typed = text

    def sent(self, content: bytes) -> None:
        """Note bytes that were sent."""
        if content in _BYTES:
            self._keep("sent", _BYTES[content])
            return
        if not content.endswith(b"\n"):
            return
        text = content.decode("latin-1").strip()
        if not text or _UNTOLD.fullmatch(text):
            return
        if self._typed == text:
            self._typed = ""
            self._keep("typed", text)
        else:
            self._keep("program" if self._in_program() else "sent", text)

    def heard(self, line: str) -> None:
        """Note a line from the controller."""
        text = line.strip()
        if _UNTOLD.fullmatch(text) or (text == "ok" and (self._in_program() or self._in_jog())):
            return
        words = in_words(text)
        self._keep("heard", text, words.partition(", ")[2] if words != text else "")

    def take(self) -> list[Exchange]:
        """Return the exchanges since the last call."""
        exchanges = list(self._fresh)
        self._fresh.clear()
        return exchanges

    def _keep(self, kind: str, text: str, words: str = "") -> None:
        self._fresh.append(Exchange(round(time.time(), 3), kind, text, words))


@dataclass(frozen=True, slots=True)
class Fill:
    """The use of the controller's planner and receive buffer, as it reports it.

    Parameters
    ----------
    blocks, characters
        Used blocks of its planner, and used characters of its receive buffer.
    of_blocks, of_characters
        Number of blocks of the planner, and of characters of the receive buffer.
    """

    blocks: int
    of_blocks: int
    characters: int
    of_characters: int


class GrblBoard:
    """A grbl board, for a panel.

    Parameters
    ----------
    controller
        The controller.
    traffic
        Its latest lines.

    Attributes
    ----------
    fill
        Use of its planner and buffer; None if it does not report it.
    readings
        How often its settings were read for a panel.
    """

    def __init__(self, controller: Controller, traffic: Traffic) -> None:
        self._controller, self._traffic = controller, traffic
        self.fill: Fill | None = None
        self.readings = 0
        self._most = (0, 0)  # most free blocks and characters: some boards have more than they say

    @property
    def identity(self) -> str:
        """Version of the firmware; empty if it is unknown."""
        return self._controller.identity

    @property
    def settings(self) -> list[BoardSetting]:
        """Its settings, compared with the machine file."""
        return self._controller.settings

    def take(self) -> list[Exchange]:
        """Return the lines since the last call."""
        return self._traffic.take()

    def report(self, found: Status) -> None:
        """Update ``fill`` from a status report."""
        if found.free is None:
            self.fill = None
            return
        blocks, characters = found.free
        self._most = max(self._most[0], blocks), max(self._most[1], characters)
        of_blocks = max(self._controller.blocks, self._most[0])
        of_characters = max(self._controller.room, self._most[1])
        self.fill = Fill(of_blocks - blocks, of_blocks, of_characters - characters, of_characters)

    def send(self, line: ConsoleLine, look: Callable[[], object]) -> str:
        """Send a typed line at rest, and return its answer: ``ok``, or a refusal.

        Parameters
        ----------
        look
            Called every 50 ms while the answer is awaited.

        Raises
        ------
        LinkFaultError
            If it does not answer: a later answer would be taken for another line's.
        """
        port = self._controller.port
        self._traffic.typed(line.text)
        port.send(f"{line.text}\n".encode())
        until_s = clock_s() + _ANSWER_S
        while clock_s() < until_s and not port.lost:
            heard = port.receive(_LISTEN_S)
            if heard == "ok" or (heard is not None and heard.startswith(("error", "ALARM"))):
                return heard
            look()
        raise LinkFaultError(f"the controller did not answer {line.text!r} within {_ANSWER_S:g} s")
