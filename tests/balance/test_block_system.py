"""The block system: its solutions are those of the condensed form, and PETSc's options reach it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, SOLID, catch_error, chain, oscillator
from mpi4py import MPI
from surroundings import ROOT, main

import fenics_crack as fc
from fenics_crack.balance import block_system
from fenics_crack.cli.command_line import PETSC_OPTION_PREFIXES

PAPER = DEMOS / "paper_plate.toml"
AGREEING: dict[str, Any] = {"contact.stiffness": 1e9, "damping.ratio": 0.01}
LAWS = {
    "penalty": {"contact.law": "penalty"},
    "1e7": {"contact.law": "smoothed", "contact.sharpness": 1e7},
    "1e8": {"contact.law": "smoothed", "contact.sharpness": 1e8},
}
RAYLEIGH: dict[str, Any] = {
    "damping.ratio": None, "damping.ratios": [0.01, 0.01], "damping.omegas": [2300.0, 8000.0],
    "damping.modes": "all",
}  # fmt: skip


def differences(scene: fc.Scene, comm: MPI.Comm, samples: int = 1024) -> tuple[float, float]:
    """Of displacements and of gaps between both forms, relative, with the same samples."""
    structure = fc.build_structure(scene, comm)
    law, omega = fc.contact_law(scene.contact, structure), scene.excitation.omega
    condensed_solution, block_solution = (
        fc.solve_harmonic_balance(
            structure, omega, law, harmonics=5, samples=samples, form=form,
            residual_tolerance=1e-12,
        )
        for form in ("condensed", "block")
    )  # fmt: skip
    assert condensed_solution.breathes and block_solution.converged
    rounding = (
        1.01 * condensed_solution.report.residual
    )  # of 43,956 unknowns both are left with 1.4e-10
    assert block_solution.report.residual < max(1e-10, rounding)
    assert block_solution.report.total == pytest.approx(condensed_solution.report.total, rel=1e-4)
    displacements = (
        condensed_solution.displacement_coefficients,
        block_solution.displacement_coefficients,
    )
    squares = np.array(
        [np.sum((displacements[1] - displacements[0]) ** 2), np.sum(displacements[0] ** 2)]
    )
    change, size = np.sqrt(structure.sum_over_ranks(squares))
    gap = condensed_solution.gap_coefficients
    return change / size, float(
        np.linalg.norm(block_solution.gap_coefficients - gap) / np.linalg.norm(gap)
    )


@pytest.mark.parametrize("law", LAWS)
def test_block_is_condensed_on_the_papers_plate(law: str) -> None:
    """To 1e-10, in all displacements and in the gap."""
    assert max(differences(fc.Scene.load(PAPER, AGREEING | LAWS[law]), MPI.COMM_SELF)) < 1e-10


@pytest.mark.mpi
def test_block_is_condensed_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """A plate whose pairs have nodes on both."""
    changes = AGREEING | RAYLEIGH | {"mesh.columns": 4, "mesh.rows": 4}
    assert max(on_ranks(differences, fc.Scene.load(PAPER, changes))) < 1e-10


@pytest.mark.nightly
@pytest.mark.mpi
@pytest.mark.parametrize("law", LAWS)
def test_block_is_condensed_on_two_and_four_ranks(
    law: str, on_ranks: Callable[..., Any], mpirun: Callable[..., str]
) -> None:
    """The paper's plate with each law, and a solid with that of the penalty."""
    changes = AGREEING | LAWS[law]
    assert max(on_ranks(differences, fc.Scene.load(PAPER, changes))) < 1e-10
    program = f"""
        import fenics_crack as fc
        from mpi4py import MPI
        from helpers import SOLID
        from test_block_system import PAPER, differences
        for scene in (fc.Scene.load(PAPER, {changes!r}), SOLID):
            assert max(differences(scene, MPI.COMM_WORLD, 256)) < 1e-10
    """
    mpirun(textwrap.dedent(program), 4)


@pytest.mark.nightly
@pytest.mark.parametrize("damping", [{"damping.ratio": 0.01}, RAYLEIGH], ids=["modal", "Rayleigh"])
@pytest.mark.parametrize("law", LAWS)
def test_block_is_condensed_on_the_breathing_plate(law: str, damping: dict[str, Any]) -> None:
    """18 pairs, 43,956 unknowns and more."""
    scene = fc.Scene.load(DEMOS / "breathing_plate.toml", damping | LAWS[law])
    assert max(differences(scene, MPI.COMM_SELF)) < 1e-10


@pytest.mark.nightly
def test_block_is_condensed_on_a_solid() -> None:
    """Six pairs, 1,458 dofs."""
    assert max(differences(SOLID, MPI.COMM_SELF, 256)) < 1e-10


def solved(tmp_path: Path, *options: str, **changes: Any) -> subprocess.CompletedProcess[str]:
    """The program on the paper's plate by the block system, with PETSc's options."""
    keys = (
        AGREEING | {"harmonic_balance.form": "block", "harmonic_balance.error": "false"} | changes
    )
    settings = [f"--set={key}={value}" for key, value in keys.items()]
    words = ["solve", str(PAPER), "--output", str(tmp_path), *settings, *options]
    return subprocess.run(
        [sys.executable, "-m", "fenics_crack", *words], capture_output=True, text=True, cwd=ROOT
    )


@pytest.mark.parametrize(
    ("harmonics", "modes"), [(2, 3), pytest.param(5, '"all"', marks=pytest.mark.nightly)]
)
def test_options_of_petsc_reach_the_program(
    tmp_path: Path, harmonics: int, modes: int | str
) -> None:
    """The Jacobian is right at every iterate, and other solvers lead to the same solution."""
    amplitudes = []
    keys = {"harmonic_balance.harmonics": harmonics, "damping.modes": modes}
    for words in (
        "-crack_hb_snes_test_jacobian -crack_hb_snes_monitor",
        "-crack_hb_ksp_type gmres -crack_hb_pc_type ilu -crack_hb_ksp_monitor",
    ):
        process = solved(tmp_path, *words.split(), **keys)
        assert process.returncode == 0, process.stderr
        result = json.loads((tmp_path / "solution.json").read_text())
        amplitudes += [row["value"] for row in result if row["name"] == "amplitude"]
        if "jacobian" in words:
            errors = re.findall(r"\|\|J - Jfd\|\|_F/\|\|J\|\|_F = (\S+),", process.stdout)
            assert len(errors) > 10 and max(map(float, errors)) < 1e-7
            assert process.stdout.count("SNES Function norm") > len(errors)
        else:
            assert "KSP Residual norm" in process.stdout
    assert amplitudes[0] == pytest.approx(amplitudes[1], rel=1e-8)


def test_option_that_no_solver_has(tmp_path: Path) -> None:
    """One line, before anything is computed."""
    process = solved(tmp_path, "-crack_hp_snes_monitor")
    assert process.returncode == 2 and not process.stdout
    (line,) = process.stderr.splitlines()
    assert line.startswith(
        "fenics-crack: PETSc option = '-crack_hp_snes_monitor': must be an option"
    )


def test_options_are_those_of_solvers() -> None:
    """The program accepts the prefixes that the package sets, and no others."""
    texts = [path.read_text() for path in (ROOT / "fenics_crack").rglob("*.py")]
    prefixes = {f"-{prefix}" for text in texts for prefix in re.findall(r'"(crack_\w+_)"', text)}
    assert prefixes == set(PETSC_OPTION_PREFIXES)


def test_no_convergence_is_one_line(tmp_path: Path) -> None:
    """It says up to which stiffness the steps led, why they ended, and what helps."""
    process = solved(tmp_path, "-crack_hb_ksp_type", "preonly", "-crack_hb_pc_type", "none")
    assert process.returncode == 3
    text = "up to 0 of the contact stiffness, then DIVERGED_"
    (line,) = (line for line in process.stderr.splitlines() if text in line)
    assert "try form = 'condensed'" in line


def test_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    """By name."""
    chain_of_10, law = chain(n=10), fc.UnilateralPenalty(1.0)
    rubs = fc.Structure.from_matrices(
        np.eye(2), 2.0 * np.eye(2), gap=[1.0, 0.0], tangential=[0.0, 1.0], force_cos=[1.0, 1.0]
    )
    reduced_structure = fc.reduce_structure(rubs, modes=1, method="massless")
    cases: list[tuple[fc.Structure, Any, dict[str, Any]]] = [
        (chain_of_10, fc.UnilateralConstraint(1.0), {"form": "block"}),
        (reduced_structure, fc.CoulombFriction(law, 0.3), {"form": "block"}),
        (chain_of_10, law, {"tolerance": 0.1, "form": "block"}),
        (chain_of_10, law, {"form": "full"}),
    ]
    for structure, contact, options in cases:
        key, value = next(iter(options.items()))
        call = partial(fc.solve_harmonic_balance, structure, 0.7, contact, **options)
        catch_error(call, key, value, names="'condensed'|form = 'block'")
    monkeypatch.setattr(block_system, "machine_memory", lambda: 1e3)
    catch_error(
        lambda: fc.solve_harmonic_balance(oscillator(), 0.7, law, form="block"),
        "harmonics",
        5,
        names="form = 'condensed'",
    )


@pytest.mark.drawn(1)
@pytest.mark.parametrize("method", ["massless", "free_interface"])
def test_reduced_structures(method: str) -> None:
    """The equations of the condensed form, with its exact integrals: the same numbers to 1e-10 of a
    penalty so stiff that contact is seen through what harmonics leave out, and of rigid contact."""
    laws: list[Any] = [fc.UnilateralPenalty(1e9)]
    laws += [fc.UnilateralConstraint()] * (method == "massless")
    plate = fc.build_structure(fc.Scene.load(PAPER, AGREEING))
    for structure in (plate, fc.reduce_structure(plate, modes=5, method=method)):
        for law in laws[: 1 if structure is plate else None]:
            condensed_solution, block_solution = (
                fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=8, form=form)
                for form in ("condensed", "block")
            )
            assert (
                condensed_solution.breathes
                and block_solution.static_above == condensed_solution.static_above
            )
            for name in ("displacement", "gap", "force"):
                condensed_rows, block_rows = (
                    getattr(solution, f"{name}_coefficients")
                    for solution in (condensed_solution, block_solution)
                )
                assert np.linalg.norm(block_rows - condensed_rows) < 1e-10 * np.linalg.norm(
                    condensed_rows
                ), name
            assert block_solution.report.total == pytest.approx(
                condensed_solution.report.total, rel=1e-6
            )


def test_form_changes_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the scene that ``new`` writes, with its table [curve]: the structure, the numbers, their
    errors and the verdict."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "plate.toml", "--quiet"]) == 0
    keys = {
        "harmonic_balance.tolerance": "none", "harmonic_balance.harmonics": 4, "mesh.size": 0.05,
        "mesh.lip_elements": 2, "reduction.modes": 6,
    }  # fmt: skip
    runs = {}
    for form in ("condensed", "block"):
        changes = keys | {"harmonic_balance.form": form}
        words = [f"--set={key}={value}" for key, value in changes.items()]
        assert main(["solve", "plate.toml", *words, "--output", form, "--quiet"]) == 0
        rows = json.loads((tmp_path / form / "solution.json").read_text())
        names = [row["name"] for row in rows]
        runs[form] = {key: [row[key] for row in rows] for key in ("value", "error [%]", "most by")}
        runs[form] |= {"names": names}
    structures = [fc.load_run(tmp_path / form / "solution.h5").structure for form in runs]
    assert repr(structures[0]) == repr(structures[1]) and structures[0].has_massless_crack_faces
    condensed_run, block_run = runs["condensed"], runs["block"]
    assert (
        block_run["names"] == condensed_run["names"]
        and block_run["most by"] == condensed_run["most by"]
    )
    for key in ("value", "error [%]"):
        for name, entry, block_value in zip(
            condensed_run["names"], condensed_run[key], block_run[key], strict=True
        ):
            if name not in ("iterations", "residual_error", "status", "conclusion"):
                tolerances = {"rel": 1e-6, "abs": 1e-12}
                expected_entry = (
                    pytest.approx(entry, **tolerances) if isinstance(entry, float) else entry
                )
                assert block_value == expected_entry, (name, key)
    assert condensed_run["value"][condensed_run["names"].index("verdict")] in ("stable", "unstable")
