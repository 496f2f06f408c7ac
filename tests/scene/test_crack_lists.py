"""Scenes with several cracks: the list [[cracks]], its keys in settings and sweeps."""

from __future__ import annotations

import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error

from fenics_crack import Scene, prepare, run_sweep, solve_harmonic_balance

SECOND = {"cracks.1.center": 0.05, "cracks.1.height": 0.075, "cracks.1.length": 0.05}
GRID = {"mesh.columns": 8, "mesh.rows": 8}


def test_lists_are_changed_and_written(paper_scene: Scene) -> None:
    """The next table is made, one is changed, all are removed; a file reads back."""
    scene = paper_scene.replace(GRID | SECOND)
    assert list(scene.crack_by_name) == ["crack", "cracks.1"]
    assert scene.cracks[0].span(0.1) == pytest.approx((0.025, 0.075))
    longer_scene = scene.replace({"cracks.1.length": 0.025, "cracks.1.center": 0.0375})
    assert longer_scene.cracks[0].length == 0.025 and scene.cracks[0].length == 0.05
    three = {f"cracks.2.{key}": v for key, v in (("edge", "right"), ("height", 0.025))}
    assert len(scene.replace(three | {"cracks.2.length": 0.025}).cracks) == 2
    assert scene.replace({"cracks": None}) == paper_scene.replace(GRID)
    swept_scene = scene.replace({"sweep.over": {"cracks.1.clearance": [0.0, 1e-6]}})
    assert Scene.from_mapping(tomllib.loads(swept_scene.as_toml())) == swept_scene


def test_cracks_inside_alone(paper_scene: Scene) -> None:
    """[[cracks]] without [crack]; and what no list may be."""
    scene = paper_scene.replace(GRID | SECOND | {"crack": None})
    assert list(scene.crack_by_name) == ["cracks.1"]
    for key in ("cracks.0.length", "cracks.x.length", "cracks.1", "cracks.1.colour"):
        catch_error(partial(scene.replace, {key: 0.05}), key, 0.05)


def test_sweep_of_the_second_crack(paper_scene: Scene, tmp_path: Path) -> None:
    """Lengths and clearances of cracks.1: each case as it is solved by itself."""
    over = {"cracks.1.length": [0.05, 0.075], "cracks.1.clearance": [0.0, 1e-7]}
    more = {"contact.stiffness": 1e8, "damping.ratio": 0.01, "reduction.modes": 10}
    base = paper_scene.replace(SECOND | {"mesh.columns": 16, "mesh.rows": 16} | more)
    sweep = run_sweep(base.replace({"sweep.over": over}), tmp_path / "sweep.h5")
    assert (
        np.all(sweep.converged) and sweep.to_dict()["cracks.1.length"] == [0.05] * 2 + [0.075] * 2
    )
    assert sweep["opening"][0, 0] != sweep["opening"][1, 0]
    case = base.replace({"cracks.1.length": 0.075, "cracks.1.clearance": 1e-7})
    study = prepare(case)
    solution = solve_harmonic_balance(
        study.structure, case.excitation.omega, study.contact, harmonics=5
    )
    assert sweep["opening"][1, 1] == pytest.approx(solution.to_dict()["opening"], rel=1e-6)
    gap = sweep.solution((1, 1)).gap_coefficients
    np.testing.assert_allclose(gap, solution.gap_coefficients, atol=1e-6 * np.abs(gap).max())
