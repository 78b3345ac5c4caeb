"""Runs every arrow of the house in order, and nothing else."""
