"""A compiled reader of the text behind a semicolon: tags (names with numbers), or plain comments.

Behind the words of a block, ``; tension_N=25 layer=3`` gives tags to the move of the block. A
comment gives tags only if it consists of such pairs alone; any other comment is ignored. A pair
without a number is an error. This reader follows the same rule as ``words``. ``words`` reads every
line that is wrong, has letters outside ASCII, or has more than this reader can hold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import IntArray
from threadline.base.compiled import njit

TAB, LF, CR, BLANK, OPEN, CLOSE, COMMA, PLUS, MINUS, DOT = 9, 10, 13, 32, 40, 41, 44, 43, 45, 46
ZERO, NINE, SEMICOLON, EQUALS, UPPER_A, UPPER_Z, UNDERSCORE, LOWER_A, LOWER_Z = (
    48, 57, 59, 61, 65, 90, 95, 97, 122,
)  # fmt: skip
LAST_ASCII = 126
MAX_DIGITS = 15
NOT_PLAIN = -1

NAMES = 16
"""Most tag names that this reader holds; ``words`` reads the blocks with further names."""
_LETTERS = 32
POWERS = np.array([float(10**k) for k in range(MAX_DIGITS + 1)])

# Layout of a book of tags: the number of known names, the number of tags in the block, the length
# of each name, the letters of each name; then, for each tag of the block, the index of its name,
# its digits, and its number of decimals (inverted with ``~`` for a negative number).
KNOWN, IN_BLOCK, _SIZE = 0, 1, 2
_NAME = _SIZE + NAMES
WHICH = _NAME + NAMES * _LETTERS
DIGITS = WHICH + NAMES
DECIMALS = DIGITS + NAMES
BOOK_SIZE = DECIMALS + NAMES


def name_of(book: IntArray, which: int) -> str:
    """Return the name of a tag.

    >>> book = np.zeros(BOOK_SIZE, np.int64)
    >>> text = np.frombuffer(b" tension_N=25.5 layer=-3", np.uint8)
    >>> follow_comment(text, 0, True, book), name_of(book, 0), name_of(book, 1)
    (24, 'tension_N', 'layer')
    >>> book[DIGITS : DIGITS + 2].tolist(), book[DECIMALS : DECIMALS + 2].tolist()
    ([255, 3], [1, -1])
    """
    name_begin = _NAME + which * _LETTERS
    return bytes(book[name_begin : name_begin + book[_SIZE + which]].tolist()).decode("ascii")


def _follow_comment(  # noqa: PLR0915 - one loop over the bytes; calls would cost half the speed
    data: NDArray[np.uint8], at: int, behind_words: bool, book: IntArray
) -> int:
    """Read a comment from the byte behind its semicolon; note the tags of the block in ``book``.

    Returns
    -------
    int
        Index of the line feed that ends the line, or of the carriage return before it; NOT_PLAIN
        if ``words`` has to read the line.
    """
    # ruff: noqa: PLR1714, SIM109 - the compiler makes two comparisons of these, not a search
    end = data.shape[0]
    while at < end and (data[at] == BLANK or data[at] == TAB):
        at += 1
    if behind_words and at + 1 < end:
        # The reader refuses "X 5; Y 6": leave a comment that looks like words to ``words``.
        c, d = data[at], data[at + 1]
        if ((UPPER_A <= c <= UPPER_Z) or (LOWER_A <= c <= LOWER_Z)) and not (
            (UPPER_A <= d <= UPPER_Z) or (LOWER_A <= d <= LOWER_Z) or d == EQUALS or d == UNDERSCORE
        ):
            return NOT_PLAIN
    has_tags = behind_words and at < end and data[at] != COMMA
    is_valid = True
    known = book[KNOWN]
    in_block = seen_names = 0
    which = -1
    while has_tags:
        while at < end and (data[at] == BLANK or data[at] == TAB or data[at] == COMMA):
            at += 1
        if at >= end or data[at] == LF or (at + 1 < end and data[at] == CR and data[at + 1] == LF):
            break
        # Most blocks repeat the order of the tags, so the next known name is tried first.
        size = -1
        for _ in range(known):
            which += 1
            if which >= known:
                which = 0
            length, name = book[_SIZE + which], _NAME + which * _LETTERS
            if at + length < end and data[at + length] == EQUALS:
                k = 0
                while k < length and data[at + k] == book[name + k]:
                    k += 1
                if k == length:
                    size = length
                    break
        if size == -1:
            # A new name starts with a letter or underscore; digits and hyphens may follow.
            size = 0
            while at + size < end:
                c = data[at + size]
                if not (
                    (UPPER_A <= c <= UPPER_Z)
                    or (LOWER_A <= c <= LOWER_Z)
                    or c == UNDERSCORE
                    or (size > 0 and (ZERO <= c <= NINE or c == MINUS))
                ):
                    break
                size += 1
            if size == 0 or at + size >= end or data[at + size] != EQUALS:
                has_tags = False
                break
            if known < NAMES and size <= _LETTERS:
                which = known
                for k in range(size):
                    book[_NAME + which * _LETTERS + k] = data[at + k]
                book[_SIZE + which] = size
                known += 1
            else:
                is_valid = False  # no room
                which = 0
        at += size + 1
        negative = at < end and data[at] == MINUS
        if at < end and (data[at] == MINUS or data[at] == PLUS):
            at += 1
        number = digits = 0
        whole = -1  # digits before the point
        while at < end and digits <= MAX_DIGITS:
            c = data[at]
            if ZERO <= c <= NINE:
                number = number * 10 + int(c - ZERO)
                digits += 1
            elif c == DOT and whole == -1:
                whole = digits
            else:
                break
            at += 1
        decimals = 0 if whole == -1 else digits - whole
        is_valid = is_valid and 0 < digits <= MAX_DIGITS and seen_names & (1 << which) == 0
        seen_names |= 1 << which
        while at < end:
            c = data[at]
            if c <= COMMA and (c == BLANK or c == TAB or c == COMMA or c == LF):
                break
            if c == CR and at + 1 < end and data[at + 1] == LF:
                break
            if c == EQUALS:
                has_tags = False
                break
            if c < BLANK or c > LAST_ASCII or c == SEMICOLON or c == OPEN:
                return NOT_PLAIN
            is_valid = False  # a letter in the number
            at += 1
        if has_tags and is_valid:
            book[WHICH + in_block] = which
            book[DIGITS + in_block] = number
            book[DECIMALS + in_block] = ~decimals if negative else decimals
            in_block += 1
    if has_tags:
        if not is_valid:
            return NOT_PLAIN
        book[KNOWN], book[IN_BLOCK] = known, in_block
        return at
    while at < end:
        c = data[at]
        if c == LF:
            break
        if c == CR and at + 1 < end and data[at + 1] == LF:
            break
        if c > LAST_ASCII or (c < BLANK and c != TAB):
            return NOT_PLAIN
        if behind_words and (c == SEMICOLON or c == OPEN):
            return NOT_PLAIN  # the further part may read as a block
        at += 1
    return at


follow_comment = njit(nogil=True)(_follow_comment)
