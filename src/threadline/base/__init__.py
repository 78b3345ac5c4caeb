"""Tools for all packages: checked arrays, compiled code, safe files, progress, and safe text."""
