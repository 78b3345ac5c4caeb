"""Equations of motion of a machine, their analysis, and control design."""
