"""Finding in a stream of blocks the passes of subroutines that are alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, groupby, islice

from threadline.targets.nc_blocks import OutBlock

MAX_BODY = 100_000
_MAX_KEPT = 1_000_000


@dataclass(frozen=True, slots=True)
class Loop:
    """``body``, run ``passes`` times."""

    body: tuple[OutBlock, ...]
    passes: int


def fold(blocks: Iterable[OutBlock]) -> Iterator[OutBlock | Loop]:
    """Return ``blocks`` with the passes of outermost subroutines as loops, nested ones unrolled.

    Passes that differ, as where a program sets absolute positions, become loops of their own.
    Bodies are in memory until the end of the program: one longer than ``MAX_BODY`` blocks, and
    all that follow the millionth block, are written out instead.
    """
    kept: dict[tuple[OutBlock, ...], None] = {}
    kept_blocks = 0
    pending: Loop | None = None
    for pass_, group in groupby(blocks, key=_outermost_pass):
        if pass_ == 0:
            if pending is not None:
                yield pending
                pending = None
            yield from group
            continue
        body = tuple(block._replace(passes=()) for block in islice(group, MAX_BODY + 1))
        if pending is not None and pass_ > 1 and body == pending.body:
            pending = Loop(body, pending.passes + 1)
            continue
        if pending is not None:
            yield pending
            pending = None
        if body not in kept:
            if len(body) > MAX_BODY or kept_blocks + len(body) > _MAX_KEPT:
                yield from chain(body, group)
                continue
            kept[body] = None
            kept_blocks += len(body)
        pending = Loop(body, 1)
    if pending is not None:
        yield pending


def _outermost_pass(block: OutBlock) -> int:
    return block.passes[0] if block.passes else 0
