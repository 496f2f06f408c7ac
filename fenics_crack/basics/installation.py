"""Check what the program needs of a machine: libraries, a C compiler, one MPI.

Each function raises an error of one line that says what to do, before a library fails with an
unclear message.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import which as program_on_path

from fenics_crack.basics.errors import InputError

INSTALLATION_ADVICE = (
    "pip install 'fenics-crack[dolfinx]' (Linux on x86-64, Python 3.12 or newer), "
    "conda env create -f environment.yml, or sh install.sh on Debian 12 or 13 (docs/install.md)"
)
"""The three ways to get DOLFINx and the libraries around it."""
RANK_COUNT_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
"""Environment variables with the number of ranks, set by Open MPI and MPICH."""


@contextmanager
def report_missing_libraries() -> Iterator[None]:
    """Turn the import error for a missing library into an InputError.

    The library itself may be missing, or a system library under it. The error says how to install
    it; other errors stay.
    """
    try:
        yield
    except (ImportError, OSError) as error:
        if isinstance(error, ModuleNotFoundError):
            raise InputError(
                error.name or "a library", None, f"installed: {INSTALLATION_ADVICE}"
            ) from error
        library_name, _, reason_text = str(error).partition(": ")
        if not reason_text.startswith("cannot open shared object file"):
            raise
        requirement_text = (
            "installed with the system's package manager (docs/install.md lists the packages)"
        )
        raise InputError(library_name, None, requirement_text) from error


def find_c_compiler() -> str:
    """Find the C compiler for DOLFINx, and return the command.

    If the variable CC is set, only this compiler counts; otherwise Python's compiler, gcc or clang.

    Raises
    ------
    InputError
        There is no compiler, or Python's headers are missing.
    """
    user_command = os.environ.get("CC")
    candidate_commands = (
        [user_command] if user_command else [sysconfig.get_config_var("CC") or "cc", "gcc", "clang"]
    )
    present_commands = [
        command for command in candidate_commands if program_on_path(shlex.split(command)[0])
    ]
    if not present_commands:
        requirement_text = (
            "an installed C compiler, which DOLFINx needs: install gcc or clang, or correct CC"
        )
        raise InputError("CC", candidate_commands[0], requirement_text)
    header_file = Path(sysconfig.get_path("include"), "Python.h")
    if not header_file.exists():
        requirement_text = (
            "an existing file: install python3-dev (Debian, Ubuntu) or python3-devel (Fedora)"
        )
        raise InputError("Python.h", str(header_file), requirement_text)
    return present_commands[0]


def read_version_line(command: str) -> str:
    """Return the first line that a program prints with ``--version``."""
    command_words = [*shlex.split(command), "--version"]
    finished_process = subprocess.run(
        command_words, capture_output=True, text=True, timeout=30, check=False
    )
    return finished_process.stdout.partition("\n")[0]


def check_launcher(
    n_ranks: int, mpi_library: str, variable_names: Sequence[str] = RANK_COUNT_VARIABLES
) -> None:
    """Raise InputError if mpirun belongs to another MPI library than this process.

    The ranks would then not know each other, and each would solve everything alone.

    Parameters
    ----------
    n_ranks : int
        Number of ranks according to the library. 0 before the library is started: then any mpirun
        that sets one of the variables is wrong.
    mpi_library : str
        Name of the library, for the error.
    variable_names : sequence of str
        Environment variables with the number of ranks according to mpirun.
    """
    n_launched_programs = max(
        int(os.environ.get(variable_name, n_ranks)) for variable_name in variable_names
    )
    if n_ranks <= 1 and n_ranks < n_launched_programs:
        raise foreign_launcher_error(
            f"{n_launched_programs} programs of one rank each", mpi_library
        )


def foreign_launcher_error(launcher_description: str, mpi_library: str) -> InputError:
    """Return the error for an mpirun of another MPI library.

    ``launcher_description`` says what mpirun started; ``mpi_library`` is this program's library.
    """
    mpirun_path = Path(sys.prefix, "bin", "mpirun")
    return InputError(
        "mpirun",
        launcher_description,
        f"the mpirun of {mpi_library}, this program's MPI library"
        f"{f': run {mpirun_path}' if mpirun_path.exists() else ''}",
    )
