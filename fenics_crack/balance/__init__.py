"""Harmonic balance of contact."""
