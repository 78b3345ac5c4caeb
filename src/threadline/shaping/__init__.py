"""Input shapers designed exactly, their robustness, and on/off commands."""
