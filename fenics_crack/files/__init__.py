"""Store results on disk."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
