"""Settings of the machine: Debian's modules, one thread at a time, some memory.

Its functions run one at a time, and with one thread of OpenBLAS and of OpenMP. gmsh, PETSc and
MUMPS keep their state in global variables: two threads of Python in them end the process. And their
dense algebra is small, as ours is: OpenBLAS's threads wait for each other longer than they work,
and do so by spinning. So do four threads of OpenMP, with which CHOLMOD assembles each of its many
small blocks, whatever OMP_NUM_THREADS says.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from fenics_crack.basics.errors import InputError

THREAD_COUNT_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS")
"""Variables that set the number of OpenBLAS's threads."""
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK")
"""Variables by which mpirun gives a process its rank, before MPI is started."""
DEBIAN_MODULES = ("numpy", "mpi4py")
"""Modules for whose compiled interfaces Debian's DOLFINx, PETSc and SciPy are built."""
ONE_PROCESS_VARIABLES = {
    "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self", "OMPI_MCA_ess_singleton_isolated": "1",
}  # fmt: skip
"""Settings of Open MPI for one process: it looks for no network, opens no port, and starts no
daemon, which would take as long as all else before the first command."""
_lock = threading.RLock()


@cache
def check_debian_modules() -> None:
    """Check, before they are imported, that Debian's NumPy and mpi4py are found and no others.

    The versions are those that ``install.sh`` has pinned in this virtual environment; one that it
    has not made is not checked.

    Raises
    ------
    InputError
        Another version stands before Debian's.
    """
    pins = Path(sys.prefix, "debian-pins.txt")
    wanted = dict(re.findall("(.+)==(.+)", pins.read_text())) if pins.exists() else {}
    for name in wanted.keys() & DEBIAN_MODULES:
        place = getattr(find_spec(name), "origin", None)
        if place is None or place.startswith("/usr/lib/python3/"):
            continue
        from importlib.metadata import version  # takes a while, and is hardly ever needed

        if version(name) != wanted[name]:
            remedy = f"run 'sh install.sh' again, or remove {Path(place).parent}"
            allowed = f"{wanted[name]}, for which Debian's DOLFINx is built: {remedy}"
            raise InputError(name, version(name), allowed)


def is_started_by_mpirun() -> bool:
    """Return True if mpirun has started this process."""
    return any(name in os.environ for name in RANK_VARIABLES)


@contextmanager
def run_single_threaded() -> Iterator[None]:
    """Keep other threads of Python out, and OpenBLAS and OpenMP to one; their numbers are restored.

    A number that the user has chosen stays: by one of :data:`SETTINGS`, or in the process (by
    threadpoolctl), where it differs from that with which OpenBLAS begins. OpenMP heeds the first of
    them alone.
    """
    with _lock:
        pools = (
            []
            if any(map(os.environ.get, THREAD_COUNT_VARIABLES))
            else _load_openblas_libraries(len(sys.modules))
        )
        limited = [(pool, begin) for pool, begin in pools if pool("get_num_threads") == begin > 1]
        for pool, _ in limited:
            pool("set_num_threads", 1)
        chosen = os.environ.get(THREAD_COUNT_VARIABLES[0], "1") != "1"
        openmp = [] if chosen else _load_openmp_libraries(len(sys.modules))
        levels = [library.omp_get_max_active_levels() for library in openmp]
        for library in openmp:
            library.omp_set_max_active_levels(0)
        try:
            yield
        finally:
            for library, level in zip(openmp, levels, strict=True):
                library.omp_set_max_active_levels(level)
            for pool, begin in limited:
                pool("set_num_threads", begin)


class _OpenBlas(NamedTuple):
    """A loaded OpenBLAS; the names of its functions differ between Debian's and those of wheels."""

    library: ctypes.CDLL
    form: tuple[str, str]

    def __call__(self, name: str, *values: int) -> int:
        return int(getattr(self.library, name.join(self.form))(*values) or 0)

    def begins_with(self) -> int:
        """Return the number of threads that it starts with by default."""
        config: Any = getattr(self.library, "get_config".join(self.form))
        config.restype = ctypes.c_char_p
        most = re.search(rb"MAX_THREADS=(\d+)", config())
        processors = self("get_num_procs")
        return min(processors, int(most[1])) if most else processors


@lru_cache(maxsize=1)
def _load_openblas_libraries(modules: int) -> list[tuple[_OpenBlas, int]]:
    """Each OpenBLAS of this process and the threads it begins with; found anew after imports."""
    found, forms = [], [*product(("openblas_", "scipy_openblas_"), ("", "64_", "_64"))]
    for library in map(ctypes.CDLL, list_loaded_libraries(r"[^/\s]*openblas")):
        known = [form for form in forms if hasattr(library, "set_num_threads".join(form))]
        found += [_OpenBlas(library, form) for form in known[:1]]
    return [(pool, pool.begins_with()) for pool in found]


@lru_cache(maxsize=1)
def _load_openmp_libraries(modules: int) -> list[ctypes.CDLL]:
    """Each OpenMP of this process, GCC's, LLVM's and Intel's; found anew after imports."""
    found = map(ctypes.CDLL, list_loaded_libraries(r"lib(?:g|i)?omp"))
    return [library for library in found if hasattr(library, "omp_set_max_active_levels")]


def list_loaded_libraries(name: str) -> list[str]:
    """Paths of the libraries of this process whose names begin as a pattern says."""
    try:
        files = Path("/proc/self/maps").read_text()
    except OSError:
        return []
    return sorted({*re.findall(rf"/\S*/{name}[^/\s]*\.so[.\d]*$", files, re.MULTILINE)})


def machine_memory() -> float:
    """Memory of this machine [byte]."""
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def process_memory(name: str) -> float:
    """Memory of this process by its name in Linux's ``/proc/self/status``, as "VmSize" [byte]."""
    status = Path("/proc/self/status").read_text()
    return 1024.0 * int(status.partition(f"{name}:")[2].split()[0])


def address_space_limit() -> float:
    """Memory that this process may ask for, by ``ulimit -v`` [byte]; inf without one."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else float(limit)


def remaining_address_space() -> float:
    """Memory that this process may still ask for [byte]."""
    return address_space_limit() - process_memory("VmSize")


@contextmanager
def set_one_process_variables() -> Iterator[None]:
    """Set :data:`ONE_PROCESS_SETTINGS` while MPI starts, unless mpirun has started this process."""
    settings = {} if is_started_by_mpirun() else ONE_PROCESS_VARIABLES
    new_settings = {name: value for name, value in settings.items() if name not in os.environ}
    os.environ |= new_settings
    try:
        yield
    finally:
        for name in new_settings:  # the user's own stay
            del os.environ[name]
