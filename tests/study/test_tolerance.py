"""A tolerance chooses the harmonics, and the modes that the scene leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import relative
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.study.run import solve

LAW = {"contact.stiffness": 1e9, "damping.ratio": 0.03}
SMALL = {"mesh.columns": 6, "mesh.rows": 12, "mesh.order": 1}
LARGE = {"mesh.columns": 8, "mesh.rows": 16, "mesh.order": 2}


@pytest.mark.parametrize(
    ("mesh", "reduction", "tolerance"),
    [
        (SMALL, {"damping.modes": 2}, 0.03),
        (SMALL, {"damping.modes": 2, "reduction.method": "free_interface"}, 0.03),
        (LARGE, {}, 0.05),
    ],
    ids=["small", "with mass", "large"],
)
def test_modes_are_chosen(
    paper_scene: fc.Scene,
    tmp_path: Path,
    mesh: dict[str, Any],
    reduction: dict[str, Any],
    tolerance: float,
) -> None:
    """The error against far more modes and harmonics is below the tolerance; the file knows what
    was chosen."""
    scene = paper_scene.replace(LAW | mesh | reduction)
    run = solve(scene.replace({"harmonic_balance.tolerance": tolerance}), MPI.COMM_SELF)
    found, settled = run.result, run.scene.reduction
    assert found.converged and found.report.total < tolerance
    assert settled is not None and found.structure is run.structure
    if "damping.modes" in reduction:
        assert settled.modes is not None and settled.modes > 2
    fine = {"reduction.modes": 80, "harmonic_balance.harmonics": 60, "damping.modes": "all"}
    if "reduction.method" in reduction:
        fine.pop("damping.modes")
    exact = solve(scene.replace(fine), MPI.COMM_SELF).result
    time = np.linspace(0.0, found.period, 400)
    assert relative(found.gap(time), exact.gap(time)) < 2.0 * tolerance
    fc.save(found, tmp_path / "solution.h5", run.scene)
    again = fc.load_run(tmp_path / "solution.h5", MPI.COMM_SELF).result
    assert isinstance(again, fc.PeriodicSolution)
    assert relative(again.gap(time), found.gap(time)) < 1e-9


def test_modes_of_the_scene_stay(paper_scene: fc.Scene) -> None:
    """Where they are too few, the solution says so and has not converged."""
    scene = paper_scene.replace(LAW | SMALL | {"reduction.modes": 2, "contact.pairs": "all"})
    run = solve(scene.replace({"harmonic_balance.tolerance": 1e-3}), MPI.COMM_SELF)
    assert run.scene.reduction is not None and run.scene.reduction.modes == 2
    assert not run.result.converged and "reduced structure" in run.result.status


def test_reduction_by_a_word(paper_scene: fc.Scene) -> None:
    """``reduction = "off"`` is the method, in a file and as a change; other words are refused."""
    scene = paper_scene.replace({"reduction": "off"})
    assert scene.reduction is not None and scene.reduction.method == "off"
    text = paper_scene.as_toml()
    assert fc.Scene.from_text(f'reduction = "off"\n{text}') == scene
    assert scene.replace({"reduction": "massless"}).reduction.method == "massless"  # type: ignore[union-attr]
    structure = fc.prepare(scene.replace(SMALL), MPI.COMM_SELF).structure
    assert structure.n_dofs > 100 and structure.whole is structure
    for change in (
        lambda: paper_scene.replace({"reduction": "of"}),
        lambda: fc.Scene.from_text(f'reduction = "of"\n{text}'),
    ):
        with pytest.raises(fc.InputError, match=r"reduction\.method = 'of'.*mean 'off'\?"):
            change()
    with pytest.raises(fc.InputError, match=r"reduction = 1: must be changed key by key"):
        paper_scene.replace({"reduction": 1})


def test_lips_that_the_load_presses_together(paper_scene: fc.Scene) -> None:
    """They do not move but by rounding, which is no error of their motion: the tolerance is met at
    once, by the vibration of the plate whose lips are tied."""
    pressed = {"contact.law": "unilateral", "contact.stiffness": None, "damping.ratio": 0.01}
    pressed |= {"excitation.force_mean": [-1e4, 0.0], "harmonic_balance.tolerance": 0.01}
    run = solve(paper_scene.replace(SMALL | pressed), MPI.COMM_SELF)
    assert run.result.converged and run.result.harmonics < 10
    assert run.result.report.total == 0.0 < run.result.contact_force(np.zeros(1)).min()
