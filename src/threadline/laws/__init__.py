"""Normalised rest-to-rest motion laws."""
