"""Numerical methods that know nothing of contact."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
