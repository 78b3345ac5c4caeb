"""Planned path + limits -> time, and the dense check of every limit."""
