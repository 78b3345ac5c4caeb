"""Figures and documents of a verdict."""
