"""Pictures, and files for ParaView."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
from fenics_crack.basics.caches import replace_unusable_caches
from fenics_crack.basics.untrusted_files import leave_working_folder

replace_unusable_caches()
with leave_working_folder():  # matplotlib would read a matplotlibrc
    import matplotlib  # noqa: F401
