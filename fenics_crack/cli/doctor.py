"""The command ``doctor``: versions in an installation, and checks against known numbers.

Each check imports all libraries that it needs, so a missing library is a fault of the check.
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
from fenics_crack.basics.machine import (
    check_debian_module_versions,
    find_c_compiler,
    foreign_launcher_error,
    list_loaded_libraries,
    program_on_path,
    read_version_line,
    report_missing_libraries,
    set_one_process_mpi_variables,
)
from fenics_crack.basics.progress import USER_MESSAGE_LOGGER
from fenics_crack.version import VERSION

MIN_NUMPY_VERSION = (1, 24)
"""Oldest supported NumPy, the version in Debian 12."""
OSCILLATOR_REFERENCE_MAX_AND_MIN = (2.19791942, -2.94941155)
"""Maximum and minimum of x in a period of x'' + 0.1 x' + x + max(x, 0) = cos t.

Another program integrated from one switching instant to the next (docs/verification, bilinear
oscillator).
"""
CHECKED_PLATE_SCENE_TABLES = {
    "geometry": {"width": 0.1, "height": 0.1, "thickness": 1.0},
    "crack": {"edge": "left", "height": 0.05, "length": 0.05},
    "material": {"young": 2e9, "poisson": 0.0, "density": 7800.0},
    "damping": {"ratio": 0.01, "modes": "all"},
    "excitation": {"omega": 2000.0, "point": [0.1, 0.1], "force_sin": [100.0, 0.0]},
    "contact": {"stiffness": 1e9},
    "mesh": {"layout": "grid", "cells": "quadrilateral", "columns": 2, "rows": 8, "order": 2},
}
"""Scene tables for a plate, 0.1 m wide and high, with Poisson's ratio zero.

Without the crack, the plate has a bar's longitudinal modes, sin((2 n - 1) pi y / (2 L)), n = 1, 2,
..., L = 0.1 m.
"""


def run_and_print_checks(arguments: Namespace, *_: object) -> Exit:
    """Run the command ``doctor``: print a table of all checks of the installation.

    Returns ``Exit.PROGRAM_OR_DISK_FAULT`` if any check fails, otherwise ``Exit.DONE``.
    """
    with report_missing_libraries():
        from fenics_crack.basics.tables import Table  # NumPy
    check_rows = [
        (check_name, "FAULT" if is_fault else "ok", finding_text)
        for check_name, finding_text, is_fault in run_and_yield_checks(CHECK_FUNCTION_BY_NAME)
    ]
    print(
        Table(("check", "verdict", "finding"), check_rows).format_as(arguments.format),
        end="",
        flush=True,
    )
    return (
        Exit.PROGRAM_OR_DISK_FAULT
        if any(verdict == "FAULT" for _, verdict, _ in check_rows)
        else Exit.DONE
    )


def run_and_yield_checks(
    checks_by_name: dict[str, Callable[[], str]],
) -> Iterator[tuple[str, str, bool]]:
    """Run checks in order, and yield the result of each.

    A check fails by an exception, or by a warning from the program. If an earlier check had the
    same fault, the text is "same fault as above".

    Parameters
    ----------
    checks_by_name : dict of str to callable
        Functions by name. Each checks a part of the installation, and returns a text with versions
        or numerical errors.

    Yields
    ------
    check_name, finding_text : str
        Name of the check, and the returned text or the fault.
    is_fault : bool
        True if the check has failed.
    """
    warning_texts: list[str] = []
    log_handler = logging.Handler(logging.WARNING)
    log_handler.emit = lambda record: warning_texts.append(record.getMessage())  # type: ignore[method-assign]
    USER_MESSAGE_LOGGER.addHandler(log_handler)
    try:
        for check_name, check_function in checks_by_name.items():
            earlier_warning_texts = [*warning_texts]
            try:
                finding_text = check_function()
            except Exception as error:
                finding_text = " ".join(f"{error}".split()) or type(error).__name__
                warning_texts.append(finding_text)
            is_fault = len(warning_texts) > len(earlier_warning_texts)
            if is_fault:
                finding_text = (
                    "same fault as above"
                    if warning_texts[-1] in earlier_warning_texts
                    else warning_texts[-1]
                )
            yield check_name, finding_text, is_fault
    finally:
        USER_MESSAGE_LOGGER.removeHandler(log_handler)


def _describe_program() -> str:
    """Return versions and folders of the program and of Python."""
    package_folder = Path(__file__).parents[1]
    return (
        f"fenics_crack {VERSION}, {package_folder}; Python {platform.python_version()}, "
        f"{sys.prefix}"
    )


def _check_numpy() -> str:
    """Return the versions of NumPy and SciPy; raise InputError if NumPy is too old."""
    check_debian_module_versions()
    with report_missing_libraries():
        import numpy
        import scipy
    if tuple(map(int, numpy.__version__.split(".")[:2])) < MIN_NUMPY_VERSION:
        raise InputError("NumPy", numpy.__version__, "version 1.24 or newer; update NumPy")
    return f"NumPy {numpy.__version__}, SciPy {scipy.__version__}"


def _check_mpi() -> str:
    """Return MPI library, number of ranks and launcher path.

    Raises InputError if several MPI libraries are loaded, or if mpirun belongs to another MPI.
    """
    with set_one_process_mpi_variables():
        from fenics_crack.basics.ranks import MPI
    mpi_vendor, mpi_version = MPI.get_vendor()
    if len(library_paths := list_loaded_libraries(r"libmpi\.")) > 1:
        raise InputError(
            "MPI",
            ", ".join(library_paths),
            "a single library; install mpi4py, PETSc and DOLFINx with the same MPI",
        )
    launcher_path = program_on_path("mpirun")
    if launcher_path and ("Open MPI" in read_version_line(launcher_path)) != (
        mpi_vendor == "Open MPI"
    ):
        raise foreign_launcher_error(launcher_path, mpi_vendor)
    launcher_path_text = launcher_path or "no mpirun on PATH"
    return (
        f"{mpi_vendor} {'.'.join(map(str, mpi_version))}, ranks: {MPI.COMM_WORLD.size}; "
        f"{launcher_path_text}"
    )


def _check_petsc() -> str:
    """Return the versions of PETSc and SLEPc; raise InputError without MUMPS or real numbers."""
    from fenics_crack.basics.ranks import check_scalar_type, import_slepc

    check_scalar_type()
    from petsc4py import PETSc

    if not PETSc.Sys.hasExternalPackage("mumps"):
        petsc_version = ".".join(map(str, PETSc.Sys.getVersion()))
        raise InputError("PETSc", petsc_version, "built with MUMPS; install a PETSc that has it")
    petsc_and_slepc_version_texts = [
        ".".join(map(str, petsc_or_slepc_package.Sys.getVersion()))
        for petsc_or_slepc_package in (PETSc, import_slepc())
    ]
    return "PETSc {}, SLEPc {}, real numbers, MUMPS".format(*petsc_and_slepc_version_texts)


def _check_gmsh() -> str:
    """Return the version of gmsh."""
    from fenics_crack.basics import gmsh_process  # noqa: F401

    with report_missing_libraries():
        import gmsh
    return f"gmsh {gmsh.__version__}"


def _check_dolfinx() -> str:
    """Return the version of DOLFINx."""
    from fenics_crack.fem import compat  # noqa: F401

    with report_missing_libraries():
        import dolfinx
    return f"DOLFINx {dolfinx.__version__}"


def _check_compiler() -> str:
    """Return path and version of the C compiler."""
    compiler_path = find_c_compiler()
    return f"{compiler_path}: {read_version_line(compiler_path)}"


def _settle_cache_folder() -> str:
    """Make the cache folder for compiled finite-element forms usable; return the path."""
    replace_unusable_caches()
    cache_folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return f"compiled forms are kept in {cache_folder}/fenics"


def _check_picture_libraries() -> str:
    """Return the versions of Matplotlib and pyvista."""
    with report_missing_libraries():
        matplotlib_module, pyvista_module = map(import_module, ("matplotlib", "pyvista"))
    return f"Matplotlib {matplotlib_module.__version__}, pyvista {pyvista_module.__version__}"


def _check_two_masses() -> str:
    """Compute two masses hitting stops, and compare the gaps' extrema with known values.

    Returns the relative error in words. Raises ArithmeticError for an error above 1e-3.
    """
    import numpy as np

    package_module = import_module("fenics_crack")
    stiffness_matrix = np.array(
        [[2.0, -1.0], [-1.0, 2.0]]
    )  # in phase they are two single oscillators
    structure = package_module.Structure.from_matrices(
        np.eye(2), stiffness_matrix, gap=np.eye(2), force_cos=[1.0, 1.0], damping=0.1 * np.eye(2)
    )
    solution = package_module.solve_harmonic_balance(
        structure, 1.0, package_module.UnilateralPenalty(1.0), harmonics=40
    )
    gaps = solution.gap(np.linspace(0.0, solution.period, 4096))
    relative_error = np.max(
        np.abs(np.array([gaps.max(), gaps.min()]) / OSCILLATOR_REFERENCE_MAX_AND_MIN - 1.0)
    )
    return _describe_error_or_raise("gaps of two masses at stops", relative_error, 1e-3)


def _check_plate() -> str:
    """Check a plate's natural frequency and a cracked plate's vibration.

    The natural frequency is compared with the exact frequency of a bar. The vibration is computed
    by two solvers. Returns both relative differences in words. Raises ArithmeticError if the first
    is above 1e-5, or the second above 1e-8.
    """
    import numpy as np

    package_module = import_module("fenics_crack")
    plate_scene = package_module.Scene.from_mapping(CHECKED_PLATE_SCENE_TABLES)
    uncracked_structure = package_module.build_structure(
        plate_scene.replace({"crack": None, "contact": None})
    )
    bar_omega = 0.5 * np.pi / 0.1 * np.sqrt(2e9 / 7800.0)
    frequency_error = np.min(
        np.abs(package_module.solve_modes(uncracked_structure, 4).omega / bar_omega - 1.0)
    )
    cracked_structure = package_module.build_structure(plate_scene)
    contact_law = package_module.UnilateralPenalty(1e9)
    condensed_form_gap_coefficients, block_form_gap_coefficients = (
        package_module.solve_harmonic_balance(
            cracked_structure, 2000.0, contact_law, harmonics=5, form=solver_form
        ).gap_coefficients
        for solver_form in ("condensed", "block")
    )
    relative_solver_difference = np.max(
        np.abs(condensed_form_gap_coefficients - block_form_gap_coefficients)
    ) / np.max(np.abs(block_form_gap_coefficients))
    return (
        f"{_describe_error_or_raise('natural frequency of a bar', frequency_error, 1e-5)}; "
        f"{_describe_error_or_raise('vibration by two solvers', relative_solver_difference, 1e-8)}"
    )


def _describe_error_or_raise(quantity_name: str, relative_error: float, tolerance: float) -> str:
    """Return a text with a quantity's relative error.

    ``quantity_name`` is the quantity in words. ArithmeticError is raised if ``relative_error`` is
    above ``tolerance``.
    """
    error_text = f"{quantity_name}: relative error {relative_error:.0e}"
    if not relative_error <= tolerance:
        raise ArithmeticError(
            f"{error_text}, at most {tolerance:g} is allowed; this installation computes wrong "
            "results: install the libraries again (docs/install.md)"
        )
    return error_text


CHECK_FUNCTION_BY_NAME = {
    "program": _describe_program,
    "NumPy": _check_numpy,
    "compiler": _check_compiler,
    "caches": _settle_cache_folder,
    "gmsh": _check_gmsh,
    "MPI": _check_mpi,
    "PETSc": _check_petsc,
    "DOLFINx": _check_dolfinx,
    "pictures": _check_picture_libraries,
    "two masses": _check_two_masses,
    "plate": _check_plate,
}
"""Functions of all checks by name, in order.

A check uses its own libraries and those of earlier checks.
"""
