"""Motion in time."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
