"""Matrices and models as other programs write them."""
