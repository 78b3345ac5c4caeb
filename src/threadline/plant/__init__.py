"""Equations of motion of a machine, and what follows from them: modes, margins, responses."""
