"""A block of a part program: its words by meaning, each checked within its block."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import (
    CANCEL,
    SILENT,
    Reading,
)
from threadline.jobs.gcode.foreign import MACROS
from threadline.jobs.gcode.grammar import (
    PLAIN,
    check_line,
    check_one_command,
    check_words,
    only_asks,
)
from threadline.jobs.gcode.printer_lines import commands_of, text_of_stop
from threadline.jobs.gcode.refused_words import (
    refuse_number,
    refuse_without_point,
    refuse_word,
    whole,
)
from threadline.jobs.gcode.words import MAX_MAGNITUDE, ONE, RawBlock, exact, split_words

if TYPE_CHECKING:
    from threadline.jobs.gcode.klipper_commands import Named
    from threadline.jobs.program_limits import LimitChange

MAX_PASSES = 10**12
_MAX_LABEL = 10**9
_LIMIT = MAX_MAGNITUDE * ONE

DRILLING = frozenset({73, 81, 82, 83, 85, 89})
"""G words of the drilling cycles that are read; the other cycles stop or turn back the spindle."""
_MOTIONS = {
    0: 0, 10: 1, 20: 2, 30: 3, 50: 5, 800: CANCEL, **{10 * code: code for code in DRILLING},
}  # fmt: skip
_MODES = frozenset(
    {"units", "distance", "feed", "blending", "plane", "system", "machine", "retract"}
)
_FIRST_SYSTEM = 540  # no effect when it is the only system used
_LENGTH, _NO_LENGTH = 430, 490
_OUTPUTS = (62, 63, 64, 65)
_SPINDLE: dict[str, float] = {"on": 1.0, "off": 0.0}
_ENDS = frozenset({"stop", "end", "call", "return"})
_ACTS = frozenset({"stop", "on", "off", "wait", "idle"})
_CURVE = "IJKRQ"
_CURVED = (2, 3, 5)
DWELL, RESET = 40, 921
CHANGE = 6
"""Number of the M word that changes the tool."""
SHIFT, SET_NATIVE = 920, 929
TAKES_AXES = (280, SHIFT, SET_NATIVE)
"""Actions that take the axis words of their block; otherwise the motion takes them."""


class Block(NamedTuple):
    """One block; an exact number is the written number as an integer multiple of 10**-18.

    Parameters
    ----------
    line
        Line number, from 1.
    motion
        Number of the motion's G word (0, 1, 2, 3, 5, or one of ``DRILLING``), ``CANCEL`` for G80,
        else -1.
    action
        Ten times the number of G4, G28, G28.1, G92 to G92.3 or G92.9, else -1.
    settings
        Ten times the numbers of the G words for units, distance, feed, blending, plane,
        coordinate system, and the end of drilling cycles (G98, G99).
    axes
        Index of each axis and its exact number, in the order written.
    feed
        Exact F, or None.
    p, passes
        Exact P, or None; number of passes (L), 0 without L.
    curve
        Letter and exact number of each I, J, K, R and Q.
    dwell_s
        Dwell of G4, in s.
    program
        Number of M0, M1, M2, M6, M30, M98 or M99, else -1.
    ends
        Effect of the ``program`` M word (``MMode``); empty without such a word.
    spindle
        1 for M3 and M4, 0 for M5, None without a spindle word.
    waits
        Whether the motion rests after the block, to wait for a temperature or to finish.
    idle
        Words that have no effect on motion.
    label
        O number, -1 without one.
    tags
        Names and numbers from a comment like ``tension=6.5``.
    acts
        Words that switch or set something other than the axes, as written: ``M3``, ``S300``,
        ``M280 P0 S90``.
    power
        Number of the S word in ``acts``, 0 without one.
    length
        G43 with its H as written, empty without G43; ``acts`` contains it, too.
    back
        Wrapped axes (``Reading.wrapped``) whose words have a minus sign, the word of 0 as well.
    limits
        Limits that the block sets for all moves behind it.
    macro
        Name of the macro that the block runs, whose moves are left out.
    """

    line: int
    motion: int
    action: int
    settings: tuple[int, ...]
    axes: tuple[tuple[int, int], ...]
    feed: int | None
    p: int | None
    passes: int
    curve: tuple[tuple[str, int], ...]
    dwell_s: float
    program: int
    ends: str
    spindle: float | None
    waits: bool
    idle: tuple[str, ...]
    label: int
    tags: tuple[tuple[str, float], ...]
    acts: tuple[str, ...] = ()
    power: float = 0.0
    length: str = ""
    back: tuple[int, ...] = ()
    limits: LimitChange | None = None
    macro: str = ""

    @property
    def goes(self) -> bool:
        """Whether the block moves the axes."""
        return bool(self.axes) and self.action not in (SHIFT, SET_NATIVE)


def parse_line(text: str, line: int, reading: Reading) -> tuple[Block, ...]:
    """Return the blocks on a line, none when the line has no words.

    A line is one block, except where the firmware runs every command of a line.

    Raises
    ------
    JobError
        If a word is unknown, doubled, out of range, or has no use in its block.
    """
    dialect, place = reading.dialect, Place(reading.file, line)
    if only_asks(text, dialect.grammar):
        return ()
    if dialect.name == "klipper":
        from threadline.jobs.gcode.klipper_commands import named_command

        command_name = named_command(text, place, without_macros=MACROS in reading.dropped)
        if command_name is not None:
            return (_named_block(command_name, line),)
    if dialect.one_command:
        texts = commands_of(text, dialect.name, place)
    else:
        check_line(text, dialect.grammar, dialect.name, place)
        texts = [text]
    one_block, inner = not dialect.semicolon_ends, dialect.grammar.inner
    split_blocks = [
        split_words(command, reading.file, line, one_block=one_block, inner=inner)
        for command in texts
    ]
    blocks = tuple(block_of(words, line, reading) for words in split_blocks if words.words)
    stop_text = text_of_stop(text) if dialect.one_command and len(blocks) == 1 else ""
    if stop_text and blocks[0].ends == "stop" and blocks[0].acts:
        return (blocks[0]._replace(acts=(*blocks[0].acts, stop_text)),)
    return blocks


def _named_block(named: Named, line: int) -> Block:
    """Return the block of a command with a name, which moves nothing; a macro is a rest."""
    return Block(
        line, -1, -1, (), (), None, None, 0, (), 0.0, -1, "", None, bool(named.macro),
        (named.idle,) if named.idle else (), -1, (), (named.text,), limits=named.limits,
        macro=named.macro,
    )  # fmt: skip


def block_of(  # noqa: PLR0915 - one loop over the words, the hot path of the reader
    raw: RawBlock, line: int, reading: Reading
) -> Block:
    """Return the block made of words that are already split.

    Raises
    ------
    JobError
        If ``parse_line`` would refuse the line.
    """
    dialect = reading.dialect
    words, tags = raw
    if dialect.one_command:
        check_one_command(words, dialect.name, Place(reading.file, line))
    if dialect.grammar is not PLAIN:
        check_words(words, reading.axes, dialect.grammar, dialect.name, Place(reading.file, line))
    motion = action = program = label = -1
    ends = ""
    settings: tuple[int, ...] = ()
    axes: tuple[tuple[int, int], ...] = ()
    curve: tuple[tuple[str, int], ...] = ()
    idle: tuple[str, ...] = ()
    acts: tuple[str, ...] = ()
    power = 0.0
    feed = p = passes = spindle = None
    dwell_s: float | None = None
    p_number = ""
    waits = output = False
    letters_seen = length = tool = ""
    negative_axes: tuple[int, ...] = ()
    groups: tuple[str, ...] = ()
    for letter, number in words:
        value = exact(number)
        if value is None or not -_LIMIT <= value <= _LIMIT:
            refuse_number(letter, number, value, line, reading)
        if letter == "G":
            code = 10 * value // ONE if 10 * value % ONE == 0 else -1
            group = dialect.g.get(code)
            if group is None:
                refuse_word(letter, number, code, line, reading)
            if group in groups:
                raise JobError(
                    f"two G words of one kind ({group}) in a block, the second is G{number}",
                    place=Place(reading.file, line),
                    remedy="Keep one of them.",
                )
            groups = (*groups, group)
            if group == "motion":
                motion = _MOTIONS[code]
            elif group == "action":
                action = code
            elif code == _LENGTH:
                length = "G43"
            elif group in _MODES:
                settings = (*settings, code)
                idle = (*idle, f"G{number}") if code == _FIRST_SYSTEM else idle
            else:
                settings = (*settings, code) if code == _NO_LENGTH else settings
                idle = (*idle, f"G{number}")
            continue
        if letter == "M":
            code = value // ONE if value % ONE == 0 else -1
            effect = dialect.m.get(code)
            if effect is None or (effect in _SPINDLE and spindle is not None):
                refuse_word(letter, number, code, line, reading)
            if effect in _ENDS:
                if program != -1:
                    raise JobError(
                        f"two M words that direct the program in a block, the second is M{number}",
                        place=Place(reading.file, line),
                        remedy="Keep one of them.",
                    )
                program, ends = code, effect
            elif effect in _SPINDLE:
                spindle = _SPINDLE[effect]
            else:
                waits = waits or effect in {"rest", "wait"}
                idle = (*idle, f"M{number}") if effect in {"idle", "wait"} else idle
                output = output or code in _OUTPUTS
            if effect in _ACTS and code not in SILENT:
                acts = (*acts, f"M{code}")
            if dialect.one_command:
                if acts:
                    own_words = words[words.index((letter, number)) + 1 :]
                    acts = (*acts, *map("".join, own_words))
                    power = next((float(text) for name, text in own_words if name == "S"), 0.0)
                break
            continue
        if letter in letters_seen:
            raise JobError(
                f"the word {letter} stands twice in the block",
                place=Place(reading.file, line),
                remedy="Keep one of them.",
            )
        letters_seen += letter
        if action == 40 and letter in dialect.dwell_s:
            p = value if letter == "P" else p
            if dwell_s is not None and not dialect.one_command:
                raise JobError(
                    f"G4 has two times, the second is {letter}{number}",
                    place=Place(reading.file, line),
                    remedy="Keep one of them.",
                )
            if dialect.grammar.whole_ms and letter == "P":
                value -= value % ONE  # the firmware drops parts of a millisecond
            if dwell_s is None or letter != "P":  # S wins over P
                dwell_s = value / ONE * dialect.dwell_s[letter]["." in number]
            continue
        index = reading.axes.get(letter)
        if index is not None:
            if dialect.points and "." not in number and value:
                refuse_without_point(letter, number, line, reading)
            axes = (*axes, (index, value))
            if number.startswith("-") and index in reading.wrapped:
                negative_axes = (*negative_axes, index)
        elif letter in reading.dropped:
            idle = (*idle, letter)
        elif letter == "F":
            feed = value
        elif letter == "P":
            p, p_number = value, number
        elif letter == "L":
            passes = whole(letter, number, value, MAX_PASSES, line, reading)
        elif letter == "O":
            label = whole(letter, number, value, _MAX_LABEL, line, reading)
        elif letter == "N":
            whole(letter, number, value, MAX_MAGNITUDE, line, reading)
        elif letter in _CURVE and 20 in dialect.g:
            curve = (*curve, (letter, value))
        elif letter == "H" and _LENGTH in dialect.g:
            tool = f" H{whole(letter, number, value, _MAX_LABEL, line, reading)}"
        elif letter in dialect.idle_letters:
            if dialect.one_command and value:
                refuse_word(letter, number, -1, line, reading)
            idle, acts = (*idle, letter), (*acts, f"{letter}{number}")
            power = value / ONE if letter == "S" else power
        else:
            refuse_word(letter, number, -1, line, reading)
    if tool and not length:
        raise JobError(
            "H has no use in this block",
            place=Place(reading.file, line),
            remedy="H is the tool whose length G43 takes.",
        )
    length += tool
    if length and length not in reading.lengths:
        acts = (length, *acts)  # only the control knows this length, so its word is kept
    if curve and 640 in settings and not axes and motion not in (*_CURVED, *DRILLING):
        # G64 P Q sets how far LinuxCNC's planner may leave the path; the reader ignores it.
        curve = tuple(word for word in curve if word[0] != "Q")
    if action in (SHIFT, SET_NATIVE, 280) and not axes and not reading.dropped.isdisjoint(idle):
        action = -1  # it names axes that the user leaves out; without words it would take all axes
    if action == 40 and dwell_s is None and p is not None:  # P stands before G4
        dwell_s = p / ONE * dialect.dwell_s["P"]["." in p_number]
    block = Block(
        line, motion, action, settings, axes, feed, p, passes or 0, curve,
        dwell_s or 0.0, program, ends, spindle, waits, idle, label, tags,
        (*acts, f"P{p_number}") if output else acts, power, length,
        negative_axes,
    )  # fmt: skip
    if (
        p is not None or action != -1 or feed is not None or program == 98 or passes is not None
        or curve
    ):  # fmt: skip
        curved = bool(motion in _CURVED or motion in DRILLING or (motion == -1 and curve))
        _check_use(block, passes, dwell_s, taken=curved or output, reading=reading)
    return block


def _check_use(
    block: Block, passes: int | None, dwell_s: float | None, *, taken: bool, reading: Reading
) -> None:
    """Refuse words that have no use in their block, or that two other words could take."""
    place = Place(reading.file, block.line)
    action, motion, program = block.action, block.motion, block.program
    feed, p, axes = block.feed, block.p, block.axes
    if feed is not None and feed <= 0:
        raise JobError(
            f"feed F {feed / ONE:g} must be greater than 0", place=place, remedy="Give a feed."
        )
    if p is not None and p < 0 and not taken:  # a control point may lie anywhere
        raise JobError(f"P {p / ONE:g} must not be negative", place=place)
    if action == 40 and (axes or dwell_s is None):
        fault = "has no P" if dwell_s is None else "stands with axis words"
        raise JobError(
            f"G4 {fault}", place=place, remedy="Write a dwell as a block G4 P with its time."
        )
    if dwell_s is not None and dwell_s < 0:
        raise JobError(f"the dwell of {dwell_s:g} s must not be negative", place=place)
    home_with_motion = action == 280 and motion in (0, 1) and reading.dialect.home_beside
    if action in TAKES_AXES and motion not in (-1, CANCEL) and not home_with_motion:
        raise JobError(
            f"G{action / 10:g} and G{motion} both take the axis words of the block",
            place=place,
            remedy="Write two blocks.",
        )
    users = (action == 40) + (program == 98) + (640 in block.settings) + taken
    if p is not None and users != 1:
        fault = "has no use in this block" if users == 0 else "could belong to two words"
        raise JobError(f"P {fault}", place=place, remedy="P belongs to G4, G64 or M98.")
    if program == 98 and (p is None or p % ONE or p > _MAX_LABEL * ONE):
        raise JobError(
            f"M98 needs the number of a subroutine as P from 0 to {_MAX_LABEL}",
            place=place,
            remedy="Write M98 P 999 L 3 for three passes of O 999.",
        )
    drills = motion in DRILLING or (motion == -1 and axes and 810 in reading.dialect.g)
    if passes is not None and program != 98 and not drills:
        raise JobError("L has no use in this block", place=place, remedy="L belongs to M98.")
    if passes == 0:
        fault = "calls the subroutine" if program == 98 else "drills"
        raise JobError(f"L 0 {fault} no times", place=place, remedy="Give L 1 or more.")
    if action in (SHIFT, SET_NATIVE) and not axes:
        raise JobError(
            f"G{action / 10:g} names no axis",
            place=place,
            remedy="Write the axes that get other positions.",
        )
