"""From a scene to its structure: gmsh meshes, DOLFINx assembles."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
