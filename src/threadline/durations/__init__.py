"""The least time of each piece of a motion, and the smoothing in time that jerk limits need."""
