"""Plane geometry, and the readers of drawings (DXF, SVG, CSV)."""
