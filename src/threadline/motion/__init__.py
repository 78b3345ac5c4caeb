"""Planned motion: the shape of its path, its laws, its timing within all limits, its shaping."""
