"""The lines, blocks and arcs that each control's own parser takes.

``dialects`` has the words of a control and their meaning. A control may refuse or drop a known
word, or give it to another word; this file refuses such a block, so that the planned motion is
the motion that the control makes.

Sources: grbl 1.1 (``gcode.c``, ``protocol.c``, ``motion_control.c``), FluidNC 4 (``GCode.cpp``,
``MotionControl.cpp``), Marlin 2.1 as its files configure it (the files of each command),
RepRapFirmware 3.5 (``GCodes.cpp``), LinuxCNC 2.9 (``rs274``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from threadline.errors import JobError, Place
from threadline.jobs.gcode.words import ONE, exact

_MOVES = re.compile(r"G0*[0-3](?:\.0*)?")
_COMMENTS = re.compile(r"\([^()]*\)|[ \t]")
_SPLIT_COMMENT = re.compile(r"\([^()]*;")


@dataclass(frozen=True, slots=True, kw_only=True)
class Grammar:
    """The grammar of one control.

    Parameters
    ----------
    longest
        Most characters of a line; 0: only the reader's limit applies.
    packed
        Whether the control does not count blanks and comments as characters of a line.
    letters
        Letters that the control refuses, although the dialect has them.
    most
        Greatest number after each letter.
    unsigned
        Letters whose number must not be negative.
    exclusive
        Ten times the numbers of the G words that exclude each other in a block.
    m_kinds
        Kind of each M word; a block has at most one word of each kind.
    takes_axes
        G words that take the axis words of their block; a block has at most one of them.
    loses_axes
        G words that take the axis words of their block and ignore them.
    needs_p
        M words that need a P.
    of_sender
        M words that the control refuses with their whole line: the sender takes them out and stops
        there. Only N, S and T may stand beside them.
    inner
        Whether a comment in parentheses may hold further ( and ends with its line at the latest.
    split_comments
        Whether a semicolon inside parentheses ends the line.
    feed_first
        Whether G1, G2 and G3 need a feed even in a block without axis words.
    forgets_feed
        Whether G93 and G94 reset F even if they are in force already.
    numbers_up
        Whether N is a number of the link, which must count up; no block is run out of turn.
    numbers_first
        Whether N may stand only at the front of its line.
    cancelled
        Whether axis words are an error while G80 is in force.
    reset_last
        Whether axis words beside G92.1 still count from the zero that G92.1 cancels.
    turns
        Whether P in an arc block is the number of turns.
    arc_ends
        Whether an arc needs an axis word of its plane.
    idle_centre
        Whether a 0 for the centre along the third axis, as posts write it, is passed over.
    round_arcs
        Whether an arc keeps its start radius up to the last chord, which leads to the end.
    single
        Whether positions have single precision.
    exact_circles
        Whether an arc is a full circle only if it ends at its start; an end elsewhere in the same
        direction then gives no turn at all.
    plain_arcs
        Whether an arc is refused with R, and after G91.
    repeats
        Whether axis words alone repeat the G0 to G3 of the command before; behind any other command
        they are an error.
    whole_ms
        Whether P of G4 loses its fraction of a millisecond.
    tape
        Meaning of a line with %: empty: it opens and closes a program; ``first``: it opens a
        program only on the first line; ``refused``: the control reports an error.
    realtime
        Pattern of the bytes that act at once when they are sent, even in a comment; empty if no
        byte does.
    queries
        Lines that ask the control for a report and do nothing else: they are passed over.
    """

    longest: int = 0
    inner: bool = False
    repeats: bool = False
    packed: bool = False
    letters: str = ""
    most: Mapping[str, int] = field(default_factory=dict)
    unsigned: str = ""
    exclusive: frozenset[int] = frozenset()
    m_kinds: Mapping[int, str] = field(default_factory=dict)
    takes_axes: frozenset[int] = frozenset()
    loses_axes: frozenset[int] = frozenset()
    needs_p: frozenset[int] = frozenset()
    of_sender: frozenset[int] = frozenset()
    split_comments: bool = False
    feed_first: bool = False
    forgets_feed: bool = False
    numbers_up: bool = False
    numbers_first: bool = False
    cancelled: bool = False
    reset_last: bool = False
    turns: bool = False
    arc_ends: bool = False
    idle_centre: bool = False
    round_arcs: bool = False
    single: bool = False
    exact_circles: bool = False
    plain_arcs: bool = False
    whole_ms: bool = False
    tape: Literal["", "first", "refused"] = ""
    realtime: str = ""
    queries: frozenset[str] = frozenset()


_NON_MODAL = frozenset({40, 100, 280, 281, 300, 301, 530, 920, 921, 922, 923})
_MOTIONS = frozenset({0, 10, 20, 30})
_COOLANT = dict.fromkeys((7, 8, 9), "coolant")
_OUTPUTS = dict.fromkeys((62, 63, 64, 65), "outputs")
QUERIES = frozenset({"$", "$$", "$#", "$G", "$I", "$N", "?"})
"""Lines that ask grbl and its kin for a report."""
PLAIN = Grammar()
GRBL = Grammar(
    longest=79, packed=True, inner=True, letters="O", most={"N": 10_000_000, "T": 255},
    unsigned="FNPST", exclusive=_NON_MODAL, m_kinds=_COOLANT, takes_axes=_MOTIONS | {280, 920, 490},
    loses_axes=frozenset({490}), feed_first=True, cancelled=True, reset_last=True, arc_ends=True,
    idle_centre=True, round_arcs=True, single=True, of_sender=frozenset({6}), tape="refused",
    realtime=r"[!?~\x84\x85\x90-\x97\x99-\x9e\xa0\xa1]", queries=QUERIES,
)  # fmt: skip
FLUIDNC = Grammar(
    longest=127, letters="O", most={"N": 10_000_000, "T": 255}, unsigned="FNPST",
    exclusive=_NON_MODAL, m_kinds={**_COOLANT, **_OUTPUTS}, takes_axes=_MOTIONS | {280, 920, 490},
    loses_axes=frozenset({490}), needs_p=frozenset(_OUTPUTS), split_comments=True,
    feed_first=True, cancelled=True, reset_last=True, turns=True, arc_ends=True, idle_centre=True,
    round_arcs=True, single=True, tape="first",
    queries=QUERIES, realtime=r"[!?~]|\xc2[\x84-\x8a\x90-\x9e\xa0\xa1\xb2-\xb4]",
)  # fmt: skip
LINUXCNC = Grammar(
    longest=252, unsigned="FST", exclusive=_NON_MODAL, m_kinds={**_COOLANT, **_OUTPUTS},
    takes_axes=_MOTIONS | {50, 280, 920}, needs_p=frozenset(_OUTPUTS), feed_first=True,
    forgets_feed=True, numbers_first=True, turns=True,
)  # fmt: skip
KLIPPER = Grammar(letters="LO", idle_centre=True, round_arcs=True, plain_arcs=True)
MARLIN = Grammar(
    longest=95,
    letters="LO",
    idle_centre=True,
    round_arcs=True,
    single=True,
    exact_circles=True,
    whole_ms=True,
    numbers_up=True,
)
REPRAPFIRMWARE = Grammar(
    longest=255, letters="LO", idle_centre=True, round_arcs=True, single=True, exact_circles=True,
    whole_ms=True,
)  # fmt: skip


def only_asks(text: str, grammar: Grammar) -> bool:
    """Say whether a line asks the control for a report and does nothing else.

    grbl takes comments and blanks out of a line before it reads it.
    """
    code = _COMMENTS.sub("", text).partition(";")[0] if grammar.packed else text
    return code.strip().upper() in grammar.queries


def check_line(text: str, grammar: Grammar, name: str, place: Place) -> None:
    """Refuse a line that the control would cut off or read differently.

    Raises
    ------
    JobError
        If the line is too long, or a semicolon in a comment ends it for the control.
    """
    if grammar.split_comments and _SPLIT_COMMENT.search(text):
        raise JobError(
            f"a semicolon in parentheses ends the line for {name}, and words behind it are not run",
            place=place,
            remedy="Take the semicolon out of the comment.",
        )
    check_length(text, grammar, name, place)


def check_length(text: str, grammar: Grammar, name: str, place: Place) -> None:
    """Refuse a line that is too long for the control.

    Raises
    ------
    JobError
        If the line is too long; the message has its length.
    """
    if grammar.longest and len(text) > grammar.longest:
        size = len(text)
        if grammar.packed:
            size = len(_COMMENTS.sub("", text).partition(";")[0])
        if size > grammar.longest:
            blanks = " (without blanks and comments)" if grammar.packed else ""
            raise JobError(
                f"the line has {size} characters{blanks}; {name} takes {grammar.longest}",
                place=place,
                remedy="Take its comment out."
                if not grammar.packed and any(mark in text for mark in "(;")
                else "Write its words in two blocks, or fewer decimals.",
            )


def check_one_command(words: Sequence[tuple[str, str]], name: str, place: Place) -> None:
    """Refuse words that a one-command firmware would not run.

    Raises
    ------
    JobError
        If the line has a second command, or an F that the firmware does not read.
    """
    commands = [f"{letter}{number}" for letter, number in words if letter in "GMT"]
    if not commands:
        return
    if commands[0][0] == "M":  # T behind it says whose value this is: M104 S200 T0
        commands = [command for command in commands if command[0] != "T"]
    if len(commands) > 1:
        raise JobError(
            f"{name} runs only the first command of a line ({commands[0]}), and not {commands[1]}",
            place=place,
            remedy="Write each command on a line of its own.",
        )
    if commands[0][0] == "G" and _MOVES.fullmatch(commands[0]) is None:
        for letter, number in words:
            if letter == "F":
                raise JobError(
                    f"{name} does not read F{number} beside {commands[0]}",
                    place=place,
                    remedy="Write it beside G0 or G1.",
                )


def check_words(
    words: Sequence[tuple[str, str]],
    axes: Mapping[str, int],
    grammar: Grammar,
    name: str,
    at: Place,
) -> None:
    """Refuse words that a control does not take together in a block.

    Raises
    ------
    JobError
        If the block has such words; the message names them.
    """
    exclusive_words: list[str] = []
    axis_takers: list[str] = []
    word_of_kind: dict[str, str] = {}
    has_axes = any(letter in axes for letter, _ in words)
    for index, (letter, number) in enumerate(words):
        value = exact(number)
        if value is None:
            continue  # ``block_of`` refuses it
        if letter == "N" and (index or "." in number) and grammar.numbers_first:
            raise JobError(
                f"{name} takes N{number} only at the beginning of a line, and without a point",
                place=at,
                remedy="Write it there.",
            )
        word = f"{letter}{number}"
        if letter in grammar.letters:
            raise JobError(
                f"{name} has no word {letter}", place=at, remedy="Take it out of the program."
            )
        if letter in grammar.unsigned and value < 0:
            raise JobError(
                f"{word} must not be negative for {name}", place=at, remedy="Correct it."
            )
        if letter in grammar.most and value > grammar.most[letter] * ONE:
            raise JobError(
                f"{word} is beyond {grammar.most[letter]}, the most that {name} takes",
                place=at,
                remedy="Write a smaller number.",
            )
        if letter == "G":
            code = 10 * value // ONE
            if code in grammar.exclusive:
                exclusive_words.append(word)
            if code in grammar.takes_axes:
                axis_takers.append(word)
            if code in grammar.loses_axes and has_axes:
                raise JobError(
                    f"{name} uses the axis words beside {word} for {word}, not for a motion",
                    place=at,
                    remedy=f"Write {word} in a block of its own.",
                )
        elif letter == "M" and value // ONE in grammar.m_kinds:
            kind = grammar.m_kinds[value // ONE]
            _refuse_two([word_of_kind[kind], word] if kind in word_of_kind else [], name, at)
            word_of_kind[kind] = word
        if letter == "M" and value // ONE in grammar.of_sender:
            refused_words = [f"{a}{b}" for a, b in words if a not in "NST" and f"{a}{b}" != word]
            if refused_words:
                raise JobError(
                    f"{name} refuses {word} with its whole line, {refused_words[0]} too",
                    place=at,
                    remedy=f"Write {word} in a line of its own, where the sender program "
                    "removes it and stops.",
                )
        if (
            letter == "M"
            and value // ONE in grammar.needs_p
            and all(other_letter != "P" for other_letter, _ in words)
        ):
            raise JobError(
                f"{word} needs the number of its output as P", place=at, remedy="Write it."
            )
    _refuse_two(exclusive_words, name, at)
    _refuse_two(axis_takers, name, at)


def _refuse_two(words: Sequence[str], name: str, at: Place) -> None:
    if len(words) > 1:
        raise JobError(
            f"{name} takes one of {words[0]} and {words[1]} in a block",
            place=at,
            remedy="Write two blocks.",
        )
