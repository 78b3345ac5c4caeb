"""A figure as SVG: alone, with the lines above it, and without them, as it stands in a page."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

from threadline.report.style import HEAD

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

_HEAD_GROUP = re.compile(rf'^( *)<g id="{HEAD}">\n.*?^\1</g>\n', re.DOTALL | re.MULTILINE)
_SIZE = re.compile(r'height="([0-9.]+)pt" viewBox="0 0 ([0-9.]+) \1"')


def svg_text(figure: Figure, area: Bbox | None = None) -> str:
    """Return a figure as SVG; the same figure gives the same text each time.

    Parameters
    ----------
    area
        Which part of the plane is drawn, inches; None is the figure itself.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, bbox_inches=area)
    return buffer.getvalue()


def without_head(svg: str, strip_in: float) -> str:
    """Return the SVG of a figure without the lines above it, which are cut off and taken out.

    It takes some milliseconds; to draw the figure once more takes a fifth of a second.

    Parameters
    ----------
    svg
        As ``svg_text`` writes a ``headed`` figure.
    strip_in
        Height of the lines, inches.
    """
    strip = 72.0 * strip_in  # points
    headless, groups = _HEAD_GROUP.subn("", svg, count=1)
    cut, sizes = _SIZE.subn(
        lambda found: (
            f'height="{float(found[1]) - strip:.6g}pt" '
            f'viewBox="0 {strip:.6g} {found[2]} {float(found[1]) - strip:.6g}"'
        ),
        headless,
        count=1,
    )
    assert groups == sizes == 1
    return cut
