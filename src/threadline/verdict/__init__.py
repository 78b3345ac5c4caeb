"""Specifications, measures, and the judge."""
