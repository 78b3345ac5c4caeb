"""Tick-exact simulation: commands + machine -> recording."""
