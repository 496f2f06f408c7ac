"""Know and set up the machine: libraries, C compiler, MPI launcher, threads, memory.

What the program needs is checked before a library fails with an unclear message: an error of one
line says what to do.

The package's functions run one at a time, each with one thread of OpenBLAS and OpenMP. gmsh, PETSc
and MUMPS keep their state in global variables: with two Python threads in them, the process ends.

Dense matrices are small here, also within these libraries. OpenBLAS's threads would wait for each
other longer than they work, and spin meanwhile. So would four threads of OpenMP, in which CHOLMOD
assembles each small block, whatever OMP_NUM_THREADS says.

OpenBLAS up to 0.3.24, as in Debian 12, does not know Intel's processors since 2022, and runs slow
code for a processor from 2004 (github.com/OpenMathLib/OpenBLAS, issue 4267).
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache, lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from shutil import which as program_on_path
from typing import Any, NamedTuple

from fenics_crack.basics.errors import DISK_FULL_ERROR_NUMBERS, InputError

THREAD_COUNT_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS")
"""Environment variables that set the number of OpenBLAS's threads."""
OPENBLAS_CORE_TYPE_AND_CPU_FLAGS = (
    ("SkylakeX", {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}),
    ("Haswell", {"avx2", "fma"}),
)
"""OpenBLAS's names for Intel processors, and needed flags in Linux's file ``/proc/cpuinfo``.

The faster code comes first.
"""
MPIRUN_ENVIRONMENT_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")
"""Environment variables that mpirun sets for each process before MPI is started."""
MODULES_REQUIRING_DEBIAN_VERSION = ("numpy", "mpi4py")
"""Modules that must have Debian's version for Debian's DOLFINx, PETSc and SciPy."""
ONE_PROCESS_MPI_SETTINGS = {
    "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self", "OMPI_MCA_ess_singleton_isolated": "1",
}  # fmt: skip
"""Settings of Open MPI for one process: no search for a network, no open port, no daemon.

A daemon would take as long as all other work before the first command.
"""
INSTALLATION_ADVICE = (
    "pip install 'fenics-crack[dolfinx]' (Linux on x86-64, Python 3.12 or newer), "
    "conda env create -f environment.yml, or sh install.sh on Debian 12 or 13 (docs/install.md)"
)
"""The three ways to get DOLFINx and the libraries around it."""
OUT_OF_MEMORY_ERROR_TEXTS = ("PetscMalloc", "failed to map segment")
"""Texts in errors of PETSc and the library loader if memory is short."""
RANK_COUNT_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
"""Environment variables with the number of ranks, set by Open MPI and MPICH."""
_lock = threading.RLock()


@cache
def check_debian_module_versions() -> None:
    """Check that NumPy and mpi4py have the versions of Debian.

    ``install.sh`` has written these versions into the virtual environment; another environment is
    not checked. Neither module is imported.

    Raises
    ------
    InputError
        Another version comes first in Python's path.
    """
    pin_file = Path(sys.prefix, "debian-pins.txt")
    version_by_module = (
        dict(re.findall("(.+)==(.+)", pin_file.read_text())) if pin_file.exists() else {}
    )
    for module_name in version_by_module.keys() & MODULES_REQUIRING_DEBIAN_VERSION:
        module_path = getattr(find_spec(module_name), "origin", None)
        if module_path is None or module_path.startswith("/usr/lib/python3/"):
            continue
        from importlib.metadata import version  # takes a while, and is hardly ever needed

        if version(module_name) != version_by_module[module_name]:
            remedy_text = f"run 'sh install.sh' again, or remove {Path(module_path).parent}"
            requirement_text = (
                f"{version_by_module[module_name]}, the version for which Debian's DOLFINx is "
                f"built: {remedy_text}"
            )
            raise InputError(module_name, version(module_name), requirement_text)


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

    If the variable CC is set, only this compiler is tried. Otherwise Python's compiler is tried,
    then gcc, then clang.

    Raises
    ------
    InputError
        There is no compiler, or Python's headers are missing.
    """
    import shlex
    import sysconfig  # takes a while: not for the program's start

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
    import shlex
    import subprocess  # takes a while: not for the program's start

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
        Number of ranks that the MPI library reports. 0 if the library has not been started: any
        mpirun that sets one of the variables is then wrong.
    mpi_library : str
        Name of the library, for the error.
    variable_names : sequence of str
        Environment variables in which an mpirun gives the number of ranks.
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


def is_started_by_mpirun() -> bool:
    """Return True if mpirun has started this process."""
    return any(name in os.environ for name in MPIRUN_ENVIRONMENT_VARIABLES)


def load_openblas(cpu_info_file: Path = Path("/proc/cpuinfo")) -> None:
    """Load NumPy, and name Intel's processors for OpenBLAS.

    OpenBLAS reads OPENBLAS_CORETYPE when loaded; older versions do not know newer processors.
    The variable is set for that time alone, as child processes may run on other machines, and not
    if the user has set it, or if ``cpu_info_file``, Linux's file on processors, has none of
    :data:`OPENBLAS_CORE_TYPE_AND_CPU_FLAGS`.
    """
    core_type = None if "OPENBLAS_CORETYPE" in os.environ else _find_core_type(cpu_info_file)
    if core_type is None or "numpy" in sys.modules:
        return
    os.environ["OPENBLAS_CORETYPE"] = core_type
    try:
        import numpy  # noqa: F401
    finally:
        del os.environ["OPENBLAS_CORETYPE"]


def _find_core_type(cpu_info_file: Path) -> str | None:
    """Return OpenBLAS's name of an Intel processor by the flags; None for other processors."""
    try:
        with cpu_info_file.open() as file:
            cpu_info_text = file.read(2**13)  # more than the first processor's lines
    except OSError:
        return None
    flags_match = re.search(r"^flags\s*: (.*)$", cpu_info_text, re.MULTILINE)
    if "GenuineIntel" not in cpu_info_text or not flags_match:
        return None
    for core_type, needed_flags in OPENBLAS_CORE_TYPE_AND_CPU_FLAGS:
        if needed_flags <= {*flags_match[1].split()}:
            return core_type
    return None


def choose_single_openblas_thread() -> None:
    """Set the variable OPENBLAS_NUM_THREADS to 1, unless the user has chosen a number of threads.

    OpenBLAS then starts no further threads. If NumPy is imported, OpenBLAS has read the variable
    already: no variable is set, and :func:`run_single_threaded` limits the threads.
    """
    if "numpy" not in sys.modules and not any(map(os.environ.get, THREAD_COUNT_VARIABLES)):
        os.environ[THREAD_COUNT_VARIABLES[1]] = "1"


@contextmanager
def run_single_threaded() -> Iterator[None]:
    """Run a block in which OpenBLAS and OpenMP use a single thread.

    The earlier settings return after the block. A number of threads chosen by the user stays:

    - OpenBLAS: a variable in :data:`THREAD_COUNT_VARIABLES` is set, or threadpoolctl has set a
      number other than the default.
    - OpenMP: the first variable of this list is set to a number above 1.
    """
    with _lock, ExitStack() as restored_settings:
        if not any(map(os.environ.get, THREAD_COUNT_VARIABLES)):
            for openblas, n_default_threads in _load_openblas_with_thread_counts(len(sys.modules)):
                if openblas("get_num_threads") == n_default_threads > 1:
                    restored_settings.callback(
                        openblas.__call__, "set_num_threads", n_default_threads
                    )
                    openblas("set_num_threads", 1)
        if os.environ.get(THREAD_COUNT_VARIABLES[0], "1") == "1":
            for openmp_library in _load_openmp_libraries(len(sys.modules)):
                previous_max_active_levels = openmp_library.omp_get_max_active_levels()
                restored_settings.callback(
                    openmp_library.omp_set_max_active_levels, previous_max_active_levels
                )
                openmp_library.omp_set_max_active_levels(0)
        yield


class _OpenBlas(NamedTuple):
    """Hold a loaded OpenBLAS library; the function names depend on the build.

    ``function_name_affixes`` are prefix and suffix of each function name. "openblas_" and "64_"
    give "openblas_get_config64_".
    """

    library: ctypes.CDLL
    function_name_affixes: tuple[str, str]

    def __call__(self, function_name: str, *arguments: int) -> int:
        """Call a function by the name without prefix and suffix, and return an integer.

        A function without a result returns 0.
        """
        return int(
            getattr(self.library, function_name.join(self.function_name_affixes))(*arguments) or 0
        )

    def default_thread_count(self) -> int:
        """Return the number of threads that OpenBLAS starts by default.

        The number of processors, or the maximum of this build if smaller.
        """
        get_config: Any = getattr(self.library, "get_config".join(self.function_name_affixes))
        get_config.restype = ctypes.c_char_p
        max_threads_match = re.search(rb"MAX_THREADS=(\d+)", get_config())
        n_processors = self("get_num_procs")
        return min(n_processors, int(max_threads_match[1])) if max_threads_match else n_processors


@lru_cache(maxsize=1)
def _load_openblas_with_thread_counts(n_imported_modules: int) -> list[tuple[_OpenBlas, int]]:
    """Return each OpenBLAS library in this process, with the default number of threads.

    The result is cached, and found again when more modules have been imported: these may have
    loaded a library. ``n_imported_modules`` is the number of modules, and serves for this alone.
    """
    openblas_libraries: list[_OpenBlas] = []
    all_affixes = [*product(("openblas_", "scipy_openblas_"), ("", "64_", "_64"))]
    for shared_library in map(ctypes.CDLL, list_loaded_libraries(r"[^/\s]*openblas")):
        matching_affixes = [
            affixes
            for affixes in all_affixes
            if hasattr(shared_library, "set_num_threads".join(affixes))
        ]
        openblas_libraries += [
            _OpenBlas(shared_library, affixes) for affixes in matching_affixes[:1]
        ]
    return [(openblas, openblas.default_thread_count()) for openblas in openblas_libraries]


@lru_cache(maxsize=1)
def _load_openmp_libraries(n_imported_modules: int) -> list[ctypes.CDLL]:
    """Return the OpenMP libraries in this process: GCC's, LLVM's and Intel's.

    The result is cached, and found again when more modules have been imported: these may have
    loaded a library. ``n_imported_modules`` is the number of modules, and serves for this alone.
    """
    openmp_libraries = map(ctypes.CDLL, list_loaded_libraries(r"lib(?:g|i)?omp"))
    return [
        shared_library
        for shared_library in openmp_libraries
        if hasattr(shared_library, "omp_set_max_active_levels")
    ]


def list_loaded_libraries(name_pattern: str) -> list[str]:
    """Return paths of this process's shared libraries with a given name.

    ``name_pattern`` is a regular expression for the beginning of the file name.
    """
    try:
        memory_map_text = Path("/proc/self/maps").read_text()
    except OSError:
        return []
    return sorted(
        {*re.findall(rf"/\S*/{name_pattern}[^/\s]*\.so[.\d]*$", memory_map_text, re.MULTILINE)}
    )


def machine_memory() -> float:
    """Return the physical memory of this machine [byte]."""
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def process_memory(entry_name: str) -> float:
    """Return a memory size of this process [byte].

    ``entry_name`` is the entry in the Linux file ``/proc/self/status``: "VmSize" is the present
    address space, "VmPeak" the largest so far.
    """
    status_text = Path("/proc/self/status").read_text()
    return 1024.0 * int(status_text.partition(f"{entry_name}:")[2].split()[0])


def address_space_limit() -> float:
    """Return this process's address space limit (``ulimit -v``) [byte]; inf if unlimited."""
    byte_limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if byte_limit == resource.RLIM_INFINITY else float(byte_limit)


def remaining_address_space() -> float:
    """Return the address space that this process may still use [byte]; inf without a limit."""
    return address_space_limit() - process_memory("VmSize")


def describe_resource_shortage(error: Exception) -> str:
    """Describe the lack of memory or disk space behind an error; "" for any other error.

    Many libraries do not report a lack of memory. Any error therefore counts as one if the process
    has used over 90 % of its address space limit at any time.
    """
    is_reported = any(
        out_of_memory_error_text in str(error)
        for out_of_memory_error_text in OUT_OF_MEMORY_ERROR_TEXTS
    )
    # Few libraries name their need.
    is_near_limit = process_memory("VmPeak") > 0.9 * address_space_limit()
    if isinstance(error, MemoryError) or is_reported or is_near_limit:
        return "not enough memory; use a coarser mesh, fewer modes or a machine with more memory"
    if isinstance(error, OSError) and error.errno in DISK_FULL_ERROR_NUMBERS:
        return (
            f"{error.filename or 'standard output'} cannot be written ({error.strerror}); free "
            "disk space"
        )
    return ""


@contextmanager
def set_one_process_mpi_variables() -> Iterator[None]:
    """Set environment variables during a block, so that Open MPI can start without mpirun.

    The block starts MPI. The variables are :data:`ONE_PROCESS_MPI_SETTINGS`; one that the user has
    set stays. If mpirun has started this process, none is set.
    """
    value_by_variable = {} if is_started_by_mpirun() else ONE_PROCESS_MPI_SETTINGS
    added_value_by_variable = {
        name: value for name, value in value_by_variable.items() if name not in os.environ
    }
    os.environ |= added_value_by_variable
    try:
        yield
    finally:
        for name in added_value_by_variable:  # the user's own stay
            del os.environ[name]
