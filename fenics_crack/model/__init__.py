"""Structures, their modes, reductions and contact laws."""
