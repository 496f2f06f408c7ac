"""Scenes: the inputs of all computations; nothing that computes."""
