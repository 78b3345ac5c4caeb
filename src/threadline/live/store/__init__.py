"""Runs that were executed: a folder for each of them, and one index."""
