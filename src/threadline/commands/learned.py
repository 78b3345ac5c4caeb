"""Learned tables: the planned rows of a job, corrected by the errors of its repeats.

A learned table belongs to a job, a machine and the planned table from which it was learned, and is
refused with any other. Options, recordings and proofs contain it as one text, so that they need no
other file.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import OptionError
from threadline.files import Stream, TickTable, tick_table
from threadline.files.formats import read_table

if TYPE_CHECKING:
    from threadline.commands.plan import Plan

MOST_TEXT = 700_000
"""Longest text of a table; a recording holds at most 1 MB of such text."""
_BEGIN = '{"learned"'
_MOST_ROWS = 1 << 20
_KEYS = ("learned", "began", "job", "machine", "axes", "rows", "counts")


def table_text(text: str) -> str:
    """Return the text of a learned table, from such a text or the name of its file.

    Raises
    ------
    OptionError
        If the text is damaged, the table too long, or not learned.
    RecordingError
        If the file cannot be read.
    """
    if text.startswith(_BEGIN):
        _unpacked(text)
        return text
    table = read_table(Path(text))
    if not table.began_sha256:
        raise OptionError(
            f"--table {text!r} is a plan's table, not a learned one",
            remedy="Leave it out, or give the file that threadline learn -o wrote.",
        )
    return text_of(table)


def table_words(text: str) -> str:
    """Return a few words for the text of a learned table.

    >>> table_words("anything")
    'a learned one, sha256 ee0874170b7f'
    """
    return f"a learned one, sha256 {hashlib.sha256(text.encode()).hexdigest()[:12]}"


def text_of(table: TickTable) -> str:
    """Return a learned table as one text.

    Raises
    ------
    OptionError
        If it is too long.
    """
    blocks = list(table)
    counts = np.concatenate([block.counts for block in blocks]).astype("<i4")
    packed = base64.b64encode(zlib.compress(counts.tobytes(), 9)).decode()
    text = json.dumps(
        {
            "learned": 1,
            "began": table.began_sha256,
            "job": table.job_sha256,
            "machine": table.machine_sha256,
            "axes": list(table.axes),
            "rows": len(counts),
            "counts": packed,
        }
    )
    if len(text) > MOST_TEXT or len(counts) > _MOST_ROWS:
        raise OptionError(
            f"a learned table of {len(counts)} ticks is too long: recordings keep it as text",
            remedy="Divide the job.",
        )
    return text


def _unpacked(text: str) -> tuple[Mapping[str, Any], IntArray]:
    """Return the content of a text, and its (rows, axes) counts."""
    try:
        content = json.loads(text)
        rows, axes = int(content["rows"]), len(content["axes"])
        if set(content) != set(_KEYS) or not 0 < rows <= _MOST_ROWS:
            raise ValueError(text[:20])
        size = rows * axes * 4
        raw = zlib.decompressobj().decompress(
            base64.b64decode(content["counts"], validate=True), size + 1
        )
        counts = np.frombuffer(raw, "<i4").reshape(rows, axes).astype(np.int64)
    except (ValueError, KeyError, TypeError, zlib.error, RecursionError) as error:
        raise OptionError(
            "the text of a learned table is damaged", remedy="Give the file with --table."
        ) from error
    return content, counts


def learned_commands(base: TickTable, text: str) -> TickTable:
    """Return the learned table in ``text`` in place of the planned table ``base``.

    Raises
    ------
    OptionError
        If it was learned on another machine, from another job, or from another plan.
    """
    content, counts = _unpacked(text)
    for key, own, what, remedy in (
        ("machine", base.machine_sha256, "on another machine file", "Give that file with -m."),
        ("job", base.job_sha256, "from another job", "Give that job."),
        (
            "began", base.rows_sha256(), "from another plan of this job",
            "Give the options of planning that threadline learn was given.",
        ),
    ):  # fmt: skip
        if content[key] != own:
            raise OptionError(
                f"--table: its references were learned {what} (sha256 {content[key][:12]}, here "
                f"{own[:12]})",
                remedy=remedy,
            )
    return _replaced(base, counts, str(content["began"]))


def with_offsets(base: TickTable, offset: IntArray) -> TickTable:
    """Return a planned table whose references are changed, as a learned table.

    Parameters
    ----------
    base
        Planned or learned table of n rows.
    offset
        (n + 1, axes) change of the commanded position at the beginning of each tick and at the end,
        in counts; its first row is 0.
    """
    counts = np.concatenate([block.counts for block in base]) + np.diff(offset, axis=0)
    return _replaced(base, counts, base.began_sha256 or base.rows_sha256())


def _replaced(base: TickTable, counts: IntArray, began: str) -> TickTable:
    blocks, first = [], 0
    for block in base:
        blocks.append(replace(block, counts=counts[first : first + len(block)]))
        first += len(block)
    return replace(base, blocks=Stream.of(blocks), began_sha256=began)


def learned_plan(plan: Plan, table: TickTable) -> Plan:
    """Return a plan that plays a learned table, with its options to make it again."""
    return replace(plan, commands=table, options={**plan.options, "table": text_of(table)})


def positions(table: TickTable) -> IntArray:
    """Return the (n + 1, axes) commanded positions at the beginning of each tick and the end."""
    counts = np.concatenate([block.counts for block in tick_table(table)])
    steps = np.concatenate([table.start_counts[None], counts])
    return np.asarray(np.cumsum(steps, axis=0))
