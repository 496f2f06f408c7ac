"""Where the files of the project are, the program, and how ranks are started.

Imports nothing that computes.
"""

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

[PROGRAM] = entry_points(group="console_scripts", name="fenics-crack")
main = PROGRAM.load()
"""The program, as it is installed."""
RunCommand = Callable[..., Any]
"""The fixture ``run_command``: words of a command, and the exit code expected, to what it says."""
ROOT = Path(__file__).parents[1]
DEMOS = ROOT / "demos"
OF_MPIRUN = tempfile.mkdtemp(prefix="mpirun")
atexit.register(shutil.rmtree, OF_MPIRUN, ignore_errors=True)
MPI_ENVIRONMENT = {
    # Open MPI 5 fails where two start in one folder at once ("prte_session_dir failed: Exists").
    "PRTE_MCA_prte_tmpdir_base": OF_MPIRUN,
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


def no_rank() -> dict[str, str]:
    """The environment of a program that mpirun has not started; that of tests has MPI's words."""
    return {
        name: text
        for name, text in os.environ.items()
        if not name.startswith(("OMPI_", "PMIX_", "PMI_"))
    }
