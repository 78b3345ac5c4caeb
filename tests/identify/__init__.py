"""Tests of the room from measurements to a machine file."""
