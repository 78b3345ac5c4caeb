"""Trajectory -> commands, and one writer per controller."""
