"""Executed runs: a folder for each, and one index."""
