"""The command ``doctor``: what an installation consists of, and whether it computes known numbers.

It takes nothing for granted: each check imports what it needs, and what goes wrong is its fault.
"""

from __future__ import annotations

import logging
import os
import platform
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

from fenics_crack.basics.caches import replace_unusable_caches
from fenics_crack.basics.errors import Exit, InputError
from fenics_crack.basics.installation import (
    find_c_compiler,
    foreign_launcher_error,
    program_on_path,
    read_version_line,
    report_missing_libraries,
)
from fenics_crack.basics.progress import LOGGER
from fenics_crack.basics.threads import (
    check_debian_modules,
    list_loaded_libraries,
    set_one_process_variables,
)
from fenics_crack.version import VERSION

OLDEST_NUMPY = (1, 24)
"""Debian 12's."""
LARGEST_DISPLACEMENTS = (2.19791942, -2.94941155)
"""Maximum and minimum of x'' + 0.1 x' + x + max(x, 0) = cos t in one period, integrated from one
switching instant to the next by another program (docs/verification, bilinear oscillator)."""
PLATE = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.0, "density": 7800.0},
    "damping": {"ratio": 0.01, "modes": "all"},
    "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
    "contact": {"stiffness": 1e9},
    "mesh": {"layout": "grid", "cells": "quadrilateral", "columns": 2, "rows": 8, "order": 2},
}
"""A plate of 0.1 m whose Poisson's ratio is zero: without its crack it has the longitudinal modes
of a bar, sin((2 n - 1) pi y / (2 L))."""


def doctor(given: Namespace, *_: object) -> Exit:
    """Print a table of the checks; return whether all is well."""
    with report_missing_libraries():
        from fenics_crack.basics.tables import Table  # NumPy
    rows = [
        (name, "FAULT" if is_fault else "ok", finding)
        for name, finding, is_fault in examine(CHECKS)
    ]
    print(Table(("check", "verdict", "finding"), rows).formatted(given.format), end="", flush=True)
    return Exit.FAULT if any(verdict == "FAULT" for _, verdict, _ in rows) else Exit.DONE


def examine(checks: dict[str, Callable[[], str]]) -> Iterator[tuple[str, str, bool]]:
    """Yield the name of each check, its finding in one line, and whether that is a fault.

    Warnings of the program are faults, too. A fault that an earlier check has met is not repeated.
    """
    warnings: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: warnings.append(record.getMessage())  # type: ignore[method-assign]
    LOGGER.addHandler(handler)
    try:
        for name, check in checks.items():
            earlier_warnings = [*warnings]
            try:
                finding = check()
            except Exception as error:
                finding = " ".join(f"{error}".split()) or type(error).__name__
                warnings.append(finding)
            is_fault = len(warnings) > len(earlier_warnings)
            if is_fault:
                finding = "as above" if warnings[-1] in earlier_warnings else warnings[-1]
            yield name, finding, is_fault
    finally:
        LOGGER.removeHandler(handler)


def _program() -> str:
    place = Path(__file__).parents[1]
    return f"fenics_crack {VERSION}, {place}; Python {platform.python_version()}, {sys.prefix}"


def _numpy() -> str:
    check_debian_modules()
    with report_missing_libraries():
        import numpy
        import scipy
    if tuple(map(int, numpy.__version__.split(".")[:2])) < OLDEST_NUMPY:
        raise InputError("NumPy", numpy.__version__, "1.24 or newer")
    return f"NumPy {numpy.__version__}, SciPy {scipy.__version__}"


def _mpi() -> str:
    with set_one_process_variables():
        from fenics_crack.basics.ranks import MPI
    vendor, version = MPI.get_vendor()
    if len(libraries := list_loaded_libraries(r"libmpi\.")) > 1:
        raise InputError("MPI", ", ".join(libraries), "one library: each knows other ranks")
    launcher = program_on_path("mpirun")
    if launcher and ("Open MPI" in read_version_line(launcher)) != (vendor == "Open MPI"):
        raise foreign_launcher_error(launcher, vendor)
    place = launcher or "no mpirun on PATH"
    return f"{vendor} {'.'.join(map(str, version))}, ranks: {MPI.COMM_WORLD.size}; {place}"


def _petsc() -> str:
    from fenics_crack.basics.ranks import check_scalar_type, import_slepc

    check_scalar_type()
    from petsc4py import PETSc

    if not PETSc.Sys.hasExternalPackage("mumps"):
        raise InputError("PETSc", "without MUMPS", "built with MUMPS")
    versions = [".".join(map(str, one.Sys.getVersion())) for one in (PETSc, import_slepc())]
    return "PETSc {}, SLEPc {}, real numbers, MUMPS".format(*versions)


def _gmsh() -> str:
    from fenics_crack.basics import gmsh_process  # noqa: F401

    with report_missing_libraries():
        import gmsh
    return f"gmsh {gmsh.__version__}"


def _dolfinx() -> str:
    from fenics_crack.fem import compat  # noqa: F401

    with report_missing_libraries():
        import dolfinx
    return f"DOLFINx {dolfinx.__version__}"


def _compiler() -> str:
    compiler = find_c_compiler()
    return f"{compiler}: {read_version_line(compiler)}"


def _caches() -> str:
    replace_unusable_caches()
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return f"{home}/fenics takes compiled forms"


def _pictures() -> str:
    with report_missing_libraries():
        matplotlib, pyvista = map(import_module, ("matplotlib", "pyvista"))
    return f"Matplotlib {matplotlib.__version__}, pyvista {pyvista.__version__}"


def _two_masses() -> str:
    import numpy as np

    fc = import_module("fenics_crack")
    stiffness = np.array([[2.0, -1.0], [-1.0, 2.0]])  # in phase they are two single oscillators
    masses = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=np.eye(2), force_cos=[1.0, 1.0], damping=0.1 * np.eye(2)
    )
    orbit = fc.solve_harmonic_balance(masses, 1.0, fc.UnilateralPenalty(1.0), harmonics=40)
    gaps = orbit.gap(np.linspace(0.0, orbit.period, 4096))
    error = np.max(np.abs(np.array([gaps.max(), gaps.min()]) / LARGEST_DISPLACEMENTS - 1.0))
    return _known("two masses at their stops", error, 1e-3)


def _plate() -> str:
    import numpy as np

    fc = import_module("fenics_crack")
    scene = fc.Scene.from_mapping(PLATE)
    whole = fc.build_structure(scene.replace({"crack": None, "contact": None}))
    bar = 0.5 * np.pi / 0.1 * np.sqrt(2e9 / 7800.0)
    error = np.min(np.abs(fc.solve_modes(whole, 4).omega / bar - 1.0))
    plate, law = fc.build_structure(scene), fc.UnilateralPenalty(1e9)
    condensed, block = (
        fc.solve_harmonic_balance(plate, 2000.0, law, harmonics=5, form=form).gap_coefficients
        for form in ("condensed", "block")
    )
    difference = np.max(np.abs(condensed - block)) / np.max(np.abs(block))
    return (
        f"{_known('natural frequency of a bar', error, 1e-5)}; "
        f"{_known('vibration by two solvers', difference, 1e-8)}"
    )


def _known(quantity: str, error: float, allowed: float) -> str:
    """Say how far a quantity is from its known value; ArithmeticError if too far."""
    text = f"{quantity}: {error:.0e} from the known value"
    if not error <= allowed:
        raise ArithmeticError(f"{text}, at most {allowed:g} is allowed")
    return text


CHECKS = {
    "program": _program,
    "NumPy": _numpy,
    "compiler": _compiler,
    "caches": _caches,
    "gmsh": _gmsh,
    "MPI": _mpi,
    "PETSc": _petsc,
    "DOLFINx": _dolfinx,
    "pictures": _pictures,
    "two masses": _two_masses,
    "plate": _plate,
}
"""By their names, in an order in which each needs those before it at most."""
