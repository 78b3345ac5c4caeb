"""Paths in axis space: what is programmed, what is planned, how far the two are apart."""
