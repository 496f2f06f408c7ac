"""What the commands compute from a scene whose lips lose their mass, and its files and pictures."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error, relative
from mpi4py import MPI

import fenics_crack as fc

RIGID = {"contact.law": "unilateral", "contact.stiffness": None}
PENALTY = {"contact.stiffness": 1e9}
FINE = {
    "mesh.columns": 8, "damping.ratio": 0.02, "reduction.modes": 10,
    "harmonic_balance.harmonics": 10,
}  # fmt: skip
laws = pytest.mark.parametrize("law", [RIGID, PENALTY], ids=["unilateral", "penalty"])


@pytest.fixture
def scene(paper_scene: fc.Scene) -> fc.Scene:
    """A plate with four pairs."""
    return paper_scene.replace(FINE)


@laws
def test_solution_and_motion_agree(scene: fc.Scene, law: dict[str, Any], tmp_path: Path) -> None:
    """Balanced with its stability, marched by exponential steps, and read again."""
    scene = scene.replace(law | {"integration.settle": 1e-5, "harmonic_balance.harmonics": 40})
    solved_run = fc.solve(scene, MPI.COMM_SELF)
    solution, plate = solved_run.result, solved_run.structure
    assert isinstance(plate, fc.MasslessStructure) and solution.stability is not None
    assert (
        solved_run.scene.reduction is not None and solved_run.scene.reduction.method == "massless"
    )
    history, dof = fc.integrate(scene, MPI.COMM_SELF).result, [solved_run.watched_dof]
    assert history.steps_per_period == 512 and history.settled < 1e-5
    time, motion = history.time[-512:], solution.displacement(history.time[-512:], dof)
    assert relative(history.gap[-512:], solution.gap(time)) < 5e-3
    assert relative(history.displacement(dof)[-512:], motion) < 2e-3
    fc.save(solution, tmp_path / "solution.h5", solved_run.scene)
    stored_run = fc.load_run(tmp_path / "solution.h5", MPI.COMM_SELF)
    stored_solution = stored_run.result
    assert stored_solution.static_above == solution.static_above
    assert stored_solution.contact == solution.contact == stored_run.contact == solved_run.contact
    np.testing.assert_allclose(
        stored_solution.gap(time), solution.gap(time), atol=1e-9 * np.ptp(motion)
    )
    # The whole displacement closes the gaps as they are, with their kinks.
    field = stored_solution.displacement_field(time[::64])
    gap = plate.whole.apply_bt(field) - plate.clearance
    np.testing.assert_allclose(gap, solution.gap(time[::64]), atol=1e-9 * np.ptp(motion))
    np.testing.assert_allclose(field[:, dof], motion[::64], atol=1e-9 * np.ptp(motion))


def test_pictures_of_lips_without_mass(scene: fc.Scene, tmp_path: Path) -> None:
    """Of a period and of the contact, and files for ParaView."""
    run = fc.solve(scene.replace(RIGID), MPI.COMM_SELF)
    found, material = run.result, run.scene.material
    fc.write_period(found, tmp_path / "period.pvd", frames=3, material=material)
    fc.animate_period(found, tmp_path / "period.gif", frames=3, material=material)
    fc.draw_contact_map(found, path=tmp_path / "map.png")
    fc.draw_orbits(found, run.watched_dof, path=tmp_path / "orbits.png")
    fc.draw_spectrum(found, run.watched_dof, path=tmp_path / "spectrum.png")
    assert len(list(tmp_path.rglob("*.*"))) >= 8
    modes = fc.solve_modes(run.structure, 3)
    fc.write_modes(modes, tmp_path / "modes.vtu")
    fc.save(modes, tmp_path / "modes.h5")
    modes_of_file = fc.load(tmp_path / "modes.h5", run.structure)
    np.testing.assert_allclose(modes_of_file.omega, fc.solve_modes(run.structure.whole, 3).omega)


@laws
def test_curves_are_followed(scene: fc.Scene, law: dict[str, Any]) -> None:
    """Also without penetration where lips have no mass; else that is refused."""
    keys = {"curve.start": 1500.0, "curve.stop": 1510.0, "curve.stability": False}
    scene = scene.replace(law | keys)
    run = fc.curve(scene, MPI.COMM_SELF)
    assert run.result.complete and run.result.omega[[0, -1]].tolist() == [1500.0, 1510.0]
    free_lip_scene = scene.replace({"reduction.method": "free_interface"})
    if law is RIGID:
        catch_error(
            lambda: fc.curve(free_lip_scene, MPI.COMM_SELF),
            "contact.law",
            "unilateral",
            names=r"reduction\.method = 'massless'",
        )
    else:
        assert fc.curve(free_lip_scene, MPI.COMM_SELF).result.complete


def test_no_verdict_without_penetration_where_lips_have_mass(scene: fc.Scene) -> None:
    """As for the paper's plate, which is not reduced."""
    free_lip_scene = scene.replace(RIGID | {"reduction.method": "free_interface"})
    run = fc.solve(free_lip_scene, MPI.COMM_SELF)
    assert run.result.converged and run.result.stability is None


@pytest.mark.parametrize("kind", [fc.Modes, fc.PeriodicSolution, fc.ResponseCurve, fc.TimeHistory])
def test_run_has_the_attributes_of_its_result(kind: type) -> None:
    """Each public attribute of a result is a property of a run."""
    names = {name for name in dir(kind) if not name.startswith("_")}
    names |= {entry.name for entry in fields(kind)}
    assert names <= {*dir(fc.Run), *(entry.name for entry in fields(fc.Run))}
