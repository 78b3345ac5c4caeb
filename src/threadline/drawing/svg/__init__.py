"""SVG drawings, read strictly: what is not understood is refused, never left out in silence."""

from threadline.drawing.svg.read_svg import read_svg

__all__ = ["read_svg"]
