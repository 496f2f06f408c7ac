"""Pictures, and files for ParaView."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
from fenics_crack.basics.caches import settle_caches
from fenics_crack.basics.untrusted_files import away

settle_caches()
with away():  # matplotlib would read a matplotlibrc
    import matplotlib  # noqa: F401
