"""Commands of a trajectory, and one writer per controller."""
