"""Pictures, and files for ParaView."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
from fenics_crack.caches import settle_caches
from fenics_crack.outside import away

settle_caches()
with away():  # matplotlib would read a matplotlibrc
    import matplotlib  # noqa: F401
