"""Styles of drawn lines: which of four a pattern of dashes and gaps is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Literal

LineStyle = Literal["solid", "dashed", "dotted", "dashdot"]
_LONGER = 2.0  # times the shortest dash: dashes of two lengths are dashes and dots
_OF_WIDTH = 2.0  # a dash that is no longer than so many widths of its line is a dot
_NUMBER = re.compile(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)(?:px|mm|pt)?")
_BYLAYER, _BYBLOCK = "BYLAYER", "BYBLOCK"


def style_of(dashes: Sequence[float], dot: float = 0.0) -> LineStyle:
    """Return the style of a line with dashes of these lengths; those up to ``dot`` are dots.

    >>> style_of([1.27]), style_of([0.0]), style_of([2.54, 0.0]), style_of([])
    ('dashed', 'dotted', 'dashdot', 'solid')
    """
    if not dashes:
        return "solid"
    if max(dashes) <= dot:
        return "dotted"
    return "dashdot" if min(dashes) <= dot or max(dashes) > _LONGER * min(dashes) else "dashed"


def style_of_dasharray(dasharray: str, width: str) -> LineStyle:
    """Return the style of a line of an SVG by its ``stroke-dasharray`` and ``stroke-width``.

    What is neither a number nor a length is taken for no pattern: nothing is sewn by it.

    >>> style_of_dasharray("4 2", "0.3"), style_of_dasharray("6 2 0.5 2", "0.3")
    ('dashed', 'dashdot')
    """
    lengths = [_length(one) for one in re.split(r"[\s,]+", dasharray.strip())]
    given = [one for one in lengths if one is not None]
    if len(given) != len(lengths) or not any(given):
        return "solid"
    around = given if len(given) % 2 == 0 else [*given, *given]  # as SVG has it
    if not any(around[1::2]):
        return "solid"  # dashes without gaps
    return style_of(around[::2], _OF_WIDTH * (_length(width) or 0.0))


def _length(text: str) -> float | None:
    found = _NUMBER.fullmatch(text)
    return None if found is None else float(found[1])


def style_of_linetype(document: Any, entity: Any, layer: Any, inherited: LineStyle) -> LineStyle:
    """Return the style of an entity of a DXF.

    Parameters
    ----------
    document, entity, layer
        Of ezdxf; the layer is None where the document has none of its name.
    inherited
        Style of the insertion of the block that the entity is in.
    """
    name = str(entity.dxf.get("linetype", _BYLAYER))
    if name.upper() == _BYBLOCK:
        return inherited
    if name.upper() == _BYLAYER:
        name = "CONTINUOUS" if layer is None else str(layer.dxf.get("linetype", "CONTINUOUS"))
    if name not in document.linetypes:
        return "solid"
    tags = document.linetypes.get(name).pattern_tags.tags
    return style_of([tag.value for tag in tags if tag.code == 49 and tag.value >= 0.0])
