"""Tools for every room: checked arrays, compiled code, safe files, progress, and safe text."""
