"""Laminates: materials with sources, the stiffness of their layers, netting, and shell models."""
