"""A scene made ready and solved."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
