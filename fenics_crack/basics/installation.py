"""What the program needs of a machine besides itself: libraries, a C compiler, one MPI.

Each function refuses, in one line that says what to do, what would end in the words of a library.
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
"""Variables by which Open MPI and MPICH tell a process how many ranks there are."""


@contextmanager
def report_missing_libraries() -> Iterator[None]:
    """Refuse a library that is not installed, or that lacks a library of the system.

    Raises
    ------
    InputError
        It names the library, and the ways to get it.
    """
    try:
        yield
    except (ImportError, OSError) as error:
        if isinstance(error, ModuleNotFoundError):
            raise InputError(
                error.name or "a library", None, f"installed: {INSTALLATION_ADVICE}"
            ) from error
        name, _, reason = str(error).partition(": ")
        if not reason.startswith("cannot open shared object file"):
            raise
        allowed = "installed by the system's packages (docs/install.md lists them)"
        raise InputError(name, None, allowed) from error


def find_c_compiler() -> str:
    """Return the command of the C compiler, by which DOLFINx compiles forms.

    Raises
    ------
    InputError
        There is none, or Python's headers are missing.
    """
    chosen = os.environ.get("CC")
    commands = [chosen] if chosen else [sysconfig.get_config_var("CC") or "cc", "gcc", "clang"]
    present = [command for command in commands if program_on_path(shlex.split(command)[0])]
    if not present:
        allowed = "a C compiler, by which DOLFINx compiles forms: install gcc or clang"
        raise InputError("CC", commands[0], allowed)
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.exists():
        allowed = "there: install python3-dev (Debian, Ubuntu) or python3-devel (Fedora)"
        raise InputError("Python.h", str(header), allowed)
    return present[0]


def read_version_line(command: str) -> str:
    """Return the first line that a program prints for ``--version``."""
    words = [*shlex.split(command), "--version"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
    return done.stdout.partition("\n")[0]


def check_launcher(size: int, library: str, names: Sequence[str] = RANK_COUNT_VARIABLES) -> None:
    """Check that mpirun belongs to the MPI library of this process.

    Parameters
    ----------
    size : int
        Ranks that the library knows; 0: it cannot be started by the mpirun of these names.
    library : str
        Its name.
    names : sequence of str
        Variables of an mpirun.

    Raises
    ------
    InputError
        The ranks do not know each other: each would solve everything alone.
    """
    launched = max(int(os.environ.get(name, size)) for name in names)
    if size <= 1 and size < launched:
        raise foreign_launcher_error(f"{launched} programs of one rank each", library)


def foreign_launcher_error(value: str, library: str) -> InputError:
    """Return the error of an mpirun that is not that of the MPI library of this process."""
    own = Path(sys.prefix, "bin", "mpirun")
    return InputError("mpirun", value, f"that of {library}{f', {own}' if own.exists() else ''}")
