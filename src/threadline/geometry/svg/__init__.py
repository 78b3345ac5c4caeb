"""SVG drawings, read strictly: a construct that is not understood is refused, not ignored."""

from threadline.geometry.svg.read_svg import read_svg

__all__ = ["read_svg"]
