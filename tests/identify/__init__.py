"""Tests of the step from measurements to a machine file."""
