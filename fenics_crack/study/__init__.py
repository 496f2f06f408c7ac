"""From a scene to its results."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
