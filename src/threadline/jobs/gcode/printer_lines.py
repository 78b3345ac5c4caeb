"""The lines of printers' firmwares: their numbers, checksums, texts and commands.

Marlin and Klipper run one command of a line, RepRapFirmware every command. These functions return
the commands as words with numbers; they refuse lines that the firmware would run otherwise than
written.

Sources: Marlin 2.1 (``parser.cpp``, ``queue.cpp``), Klipper (``gcode.py``), RepRapFirmware 3.5
(``StringParser.cpp``, ``GCodes2.cpp``).
"""

from __future__ import annotations

import re

from threadline.errors import JobError, Place
from threadline.jobs.gcode.grammar import MARLIN, REPRAPFIRMWARE

_NUMBER_OF_LINE = re.compile(r" *N *([0-9]+) *")
_CHECKSUM = re.compile(r"\*[ \t]*([0-9]{1,3})[ \t]*$")
_TEXT = re.compile(
    r" *(?:N *[0-9]+ *)?M *0*"
    r"(?:(?:11[78]|23|28|30|32|928)(?![0-9.])|[01](?![0-9.])(?: *[PS] *[0-9]+(?:\.[0-9]*)?)*)"
)
_STOP = re.compile(r" *(?:N *[0-9]+ *)?M *0*[01](?![0-9.])(?: *[PS] *[0-9]+(?:\.[0-9]*)?)*", re.I)
_FLAGS = re.compile(r" *(?:N *[0-9]+ *)?(?:G *28|M *(?:1[78]|84))(?![0-9.])")
_BARE_LETTER = re.compile(r"([A-Z])(?! *[-+.0-9])")
_COMMAND = re.compile(r" *(?:N *[0-9]+ *)?[GMT] *[0-9]")
_PARENTHESES = re.compile(r"\((?:[^()]|\([^()]*\))*(?:\)|$)")
_STRAIGHT = re.compile(r" *(?:N *[0-9]+ *)?G *0*[01](?![0-9.])")
_MOTORS = re.compile(r" *(?:N *[0-9]+ *)?M *(?:17|18|84)(?![0-9.])")
_NOT_OF_KLIPPER = re.compile(r"[^A-Z0-9+\-. ]|[A-Z_]{2,}")
_CODE = re.compile(r'(?:[^;"]|"[^"]*"?)*')
_QUOTED = re.compile(r'"[^"]*"?')
_NUMBERED = re.compile(r"[ \t]*[Nn][0-9]*[ \t]*")
_META = re.compile(
    r"[ \t]*(if|elif|else|while|break|continue|var|global|set|abort|echo|skip)(?=[ \t{\"(]|$)"
)
_BRACKETED = re.compile(r'"[^"]*"?|;.*|\([^)]*\)?')
_AXIS_WORD = re.compile(r"[XYZUVWABC](?![A-Z])")
_SAYS = re.compile(r'[ \t]*(?:skip(?:[ \t].*)?|echo[ \t]*"[^"]*"[ \t]*)')
_BEGINS = re.compile(r"[GM](?:-?[0-9]+(?:\.[0-9])?)?|T-?[0-9]+")
_TAKES_LINE = re.compile(r'[Mm](?:23|28|30|32|36|38|117)(?![0-9.])(?=[ \t]*[^" \t])')
_TAKES_TEXT = frozenset({"M23", "M28", "M30", "M32", "M36", "M38", "M98", "M117", "M118"})
_REPRAP_CHECKSUM = re.compile(r"\*([0-9]{1,3})(?![0-9])")


def commands_of(text: str, name: str, place: Place) -> list[str]:
    """Return the commands that a firmware runs of a line, each as words with numbers.

    Parameters
    ----------
    name
        Name of the firmware's dialect.

    Raises
    ------
    JobError
        If the firmware would run other words than written.
    """
    if name.startswith("reprapfirmware"):
        return _for_reprapfirmware(text, place, cnc=name.endswith("-cnc"))
    return [one_command(text, name, place)]


def number_of_line(text: str) -> int | None:
    """Return the line number (N) at the front of a line, None without one."""
    number_match = _NUMBER_OF_LINE.match(text)
    return None if number_match is None else int(number_match[1])


def text_of_stop(text: str) -> str:
    """Return the text after M0 or M1, which a one-command firmware shows at the stop.

    >>> text_of_stop("N3 M0 S5 Turn the part*17"), text_of_stop("M117 hello")
    ('Turn the part', '')
    """
    code = _CHECKSUM.sub("", text.partition(";")[0])
    stop = _STOP.match(code)
    return "" if stop is None else code[stop.end() :].strip()


def one_command(text: str, name: str, place: Place) -> str:
    """Return a line of a one-command firmware as words with numbers.

    The text of M0, M117 and similar words, the line number and the checksum are removed; the
    checksum is compared first. Letters without a number, which name axes behind G28, M17, M18 and
    M84, get the number 0.

    >>> here = Place("a.gcode", 1)
    >>> one_command("N3 G28 X Y*17", "marlin", here), one_command("M117 hello", "marlin", here)
    (' G28 X0 Y0', 'M117')
    >>> one_command("n3 g28 x*9", "klipper", here)
    ' G28 X0'

    Raises
    ------
    JobError
        If a checksum is wrong or missing, or the firmware would run other words than written.
    """
    code, semicolon, comment = text.partition(";")
    if name == "klipper":
        return f"{_for_klipper(code, place)}{semicolon}{comment}"
    code = _without_checksum(code, place)
    text_match = _TEXT.match(code)
    if text_match is not None:
        return text_match[0]
    code = _without_parentheses(code, place)
    if not code.isascii() or code != code.upper():
        raise JobError(
            "marlin reads only capital letters, unless it is built with GCODE_CASE_INSENSITIVE",
            place=place,
            remedy="Write the line in capital letters, and a comment behind a semicolon.",
        )
    if "\t" in code:
        raise JobError(
            "the line has a tab, and marlin reads only blanks",
            place=place,
            remedy="Write a blank.",
        )
    if len(code) > MARLIN.longest:
        raise JobError(
            f"the line has {len(code)} characters; marlin cuts it off behind {MARLIN.longest}",
            place=place,
            remedy="Write fewer blanks or decimals.",
        )
    if code.strip(" \t%") and _COMMAND.match(code) is None:
        raise JobError(
            "marlin ignores the line, because it does not begin with a command (G, M or T and a "
            "number)",
            place=place,
            remedy="Write the command in front, like G1 X5 F600.",
        )
    if _FLAGS.match(code):
        code = _BARE_LETTER.sub(r"\g<1>0", code)
    return f"{code}{semicolon}{comment}"


def _without_parentheses(code: str, place: Place) -> str:
    """Return a line of Marlin without its parentheses, which Marlin reads as other text.

    Parentheses alone are no command (``parser.cpp``). Marlin takes words after a command only in
    capital letters, and so nothing from a text in small letters. G0 and G1 read no P, as in ``G1 Z0
    (Penetrate)``, and the letters after M17, M18 and M84 move nothing.

    Raises
    ------
    JobError
        If Marlin would read a word in the parentheses.
    """
    bare = _PARENTHESES.sub("", code)
    if bare == code and ")" not in code:
        return code
    in_parentheses = "".join(_PARENTHESES.findall(code))
    read_letters = "[A-OQ-Z]" if _STRAIGHT.match(bare) else "[A-Z]"
    reads_no_words = not bare.strip() or _MOTORS.match(bare) is not None
    if ")" in bare or not (reads_no_words or re.search(read_letters, in_parentheses) is None):
        raise JobError(
            "marlin reads the capital letters in parentheses as words, unless it is built with "
            "PAREN_COMMENTS",
            place=place,
            remedy="Write a comment behind a semicolon.",
        )
    return bare


def _for_klipper(code: str, place: Place) -> str:
    """Return a line as words with numbers, as ``klippy/gcode.py`` splits it.

    Small letters count as capital ones, a line number is passed over, a checksum is not compared.
    A line of parentheses alone is an unknown command, which klipper passes over.
    """
    if code.lstrip().startswith("(") and not _PARENTHESES.sub("", code).strip():
        return ""
    code = _CHECKSUM.sub("", code.upper().replace("\t", " ").strip())
    number_match = _NUMBER_OF_LINE.match(code)
    code = code if number_match is None else f" {code[number_match.end() :]}"
    text_match = _TEXT.match(code)
    if text_match is not None:
        return text_match[0]
    if not code.strip(" %"):
        return code
    unreadable = _NOT_OF_KLIPPER.search(code)
    if unreadable is not None or _COMMAND.match(code) is None:
        raise JobError(
            f"klipper cannot read {code.strip()[:40]!r} as a command (G, M or T and a number) with "
            "a number behind each letter"
            + (f", for {unreadable[0]!r} in it" if unreadable is not None else ""),
            place=place,
            remedy="Write it like G1 X5 F600, and a comment behind a semicolon.",
        )
    return _BARE_LETTER.sub(r"\g<1>0", code) if _FLAGS.match(code) else code


def _without_checksum(code: str, place: Place) -> str:
    """Return a line without its checksum and without its line number."""
    number_match, checksum_match = _NUMBER_OF_LINE.match(code), _CHECKSUM.search(code)
    if number_match is None and checksum_match is None:
        return code
    if number_match is not None and checksum_match is None:
        raise JobError(
            f"the line has the number N{number_match[1]} and no checksum: marlin asks for it again",
            place=place,
            remedy="Take the number out: the program that sends the file writes its own.",
        )
    assert checksum_match is not None
    body = code[: checksum_match.start()]
    checksum = 0
    for byte in body.lstrip(" ").encode():
        checksum ^= byte
    if number_match is not None and int(checksum_match[1]) != checksum:
        raise JobError(
            f"the checksum of the line is {checksum_match[1]} and must be {checksum}: marlin does "
            "not run the line",
            place=place,
            remedy="Have the program written again: the line was changed, or take the N word and "
            "the checksum out.",
        )
    return body if number_match is None else body[number_match.end() - 1 :]


def _for_reprapfirmware(text: str, place: Place, *, cnc: bool = False) -> list[str]:
    """Return the commands of a line, as ``StringParser.cpp`` decodes them one after the other.

    A G or M outside quotes begins a command. Small letters count as capital ones; N needs no
    checksum, and a line with a wrong one is not run. The comment of a line belongs to each command.
    With ``cnc`` (M453) parentheses are comments, and a line may begin with an axis word.

    >>> _for_reprapfirmware("n5 g21 G90G1 X5 ; (a", Place("a.g", 1))
    ['G21 ; (a', 'G90; (a', 'G1 X5; (a']
    >>> _for_reprapfirmware('M117 "G1 X9" M400', Place("a.g", 1))
    ['M117', 'M400']
    >>> _for_reprapfirmware("(to the right) X5 F600", Place("a.g", 1), cnc=True)
    ['X5 F600']
    """
    text = (
        _BRACKETED.sub(lambda match: "" if match[0][0] == "(" else match[0], text) if cnc else text
    )
    code_match = _CODE.match(text)
    assert code_match is not None
    code, comment = code_match[0], text[code_match.end() :]
    code = _numbered_for_reprapfirmware(code, place).strip(" \t\r")
    if not code.strip("% \t") or _SAYS.fullmatch(code):
        return []
    bare = _QUOTED.sub(lambda text_match: '"' * len(text_match[0]), code)
    text_command = _TAKES_LINE.search(bare)
    if text_command is not None:  # the rest of the line is a name or a message
        code, bare = code[: text_command.end()], bare[: text_command.end()]
    _refuse_for_reprapfirmware(code, bare, place)
    starts = [index for index, letter in enumerate(bare) if letter in "GMgm" or index == 0]
    pieces = []
    for start, end in zip(starts, [*starts[1:], len(code)], strict=True):
        piece = code[start:end].upper()
        if cnc and start == 0 and _AXIS_WORD.match(piece) and '"' not in piece:
            pieces.append(piece)
            continue
        command_match = _BEGINS.match(piece)
        if command_match is None or command_match[0] in {"G", "M"}:
            raise JobError(
                f"reprapfirmware answers to {piece[:40]!r} with an error: a command is G, M or T "
                "with its number directly behind",
                place=place,
                remedy="Write it like G1 X5 F600, and a comment behind a semicolon.",
            )
        word, rest = command_match[0], piece[command_match.end() :].lstrip()
        if word in _TAKES_TEXT:
            pieces.append(word)
            continue
        if '"' in piece:
            raise JobError(
                f"the text in quotes beside {word} is not read",
                place=place,
                remedy="Take the command out, or write it without a text.",
            )
        if word[0] == "G" and "T" in rest:
            raise JobError(
                f"reprapfirmware ignores T behind {word}: T is a command only at the beginning of "
                "a line",
                place=place,
                remedy="Write T on a line of its own, or take it out.",
            )
        pieces.append(_BARE_LETTER.sub(r"\g<1>0", piece) if _FLAGS.match(piece) else piece)
    return [f"{piece}{comment}" for piece in pieces]


def _refuse_for_reprapfirmware(code: str, bare: str, place: Place) -> None:
    """Refuse a line that RepRapFirmware evaluates, or reads otherwise than written.

    ``bare`` is the line with quotes in place of its texts.
    """
    meta_match = _META.match(code)
    fault, remedy = "", "Have the program written with numbers and commands alone."
    if meta_match is not None:
        fault = f"{meta_match[1]} is a meta command of reprapfirmware, which is not run here"
    elif "{" in bare or "}" in bare:
        fault = "expressions in braces are not read: only the firmware knows their values"
    elif "(" in bare or ")" in bare:
        fault = (
            "reprapfirmware reads the letters in parentheses as words, unless M453 has made it a "
            "CNC machine"
        )
        remedy = "Write a comment behind a semicolon."
    elif "'" in bare:
        fault = "an apostrophe names an axis with a small letter, which no machine here has"
        remedy = "Name the axis by a capital letter, without the apostrophe."
    elif len(code) > REPRAPFIRMWARE.longest:
        fault = (
            f"the line has {len(code)} characters; reprapfirmware takes {REPRAPFIRMWARE.longest}"
        )
        remedy = "Write its commands on lines of their own, or fewer decimals."
    if fault:
        raise JobError(fault, place=place, remedy=remedy)


def _numbered_for_reprapfirmware(code: str, place: Place) -> str:
    """Return a line without its number, and without its checksum, which must be right."""
    number_match = _NUMBERED.match(code)
    if number_match is None:
        return code
    star = _QUOTED.sub(lambda text_match: '"' * len(text_match[0]), code).find("*")
    if star < 0:
        return code[number_match.end() :]
    checksum = 0
    for byte in code[:star].lstrip(" \t").encode():
        checksum ^= byte
    checksum_match = _REPRAP_CHECKSUM.match(code, star)
    if checksum_match is None or int(checksum_match[1]) != checksum:
        raise JobError(
            f"the checksum of the line is {code[star + 1 :].strip()[:20] or 'missing'} and must be "
            f"{checksum}: reprapfirmware does not run the line",
            place=place,
            remedy="Have the program written again: the line was changed, or take the N word and "
            "the checksum out.",
        )
    return code[number_match.end() : star]
