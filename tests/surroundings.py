"""Where the files of the project are, the program, and how ranks are started.

Imports nothing that computes.
"""

from pathlib import Path

from fenics_crack.cli.command_line import main as main

ROOT = Path(__file__).parents[1]
DEMOS = ROOT / "demos"
MPI_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",  # Open MPI 4
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",  # Open MPI 5
    # Other tests run meanwhile: ranks that wait make room, and choose their processor freely.
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",  # Open MPI 4
    "PRTE_MCA_hwloc_default_binding_policy": "none",  # Open MPI 5
}
