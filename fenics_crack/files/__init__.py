"""Results on disk."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
