"""Stability of periodic motions, and exact periodic orbits."""
