"""Plane geometry and the readers of drawings, for everything that is made after a drawing."""
