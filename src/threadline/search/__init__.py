"""Searches over the whole pipeline: the fastest motion in spec."""
