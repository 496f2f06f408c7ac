"""Motions in time from given initial values: static deflections, and earlier results."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catch_error, relative, scene_of_matrices
from mpi4py import MPI
from surroundings import main

import fenics_crack as fc

OMEGA, RATIO = 20.0, 0.02
"""Natural frequency [rad/s] and damping of one mass."""
LAWS: list[dict[str, Any]] = [
    {"contact.stiffness": 1e9, "reduction.method": "free_interface"},
    {"contact.law": "unilateral", "contact.stiffness": None},
]
laws = pytest.mark.parametrize("law", LAWS, ids=["penalty", "lips without mass"])


@pytest.fixture
def mass(tmp_path: Path) -> Path:
    """The scene of one mass, 2 kg, far from its stop."""
    parts = {"mass": 2.0, "stiffness": 800.0, "gap": 1.0, "force_sin": 3.0}
    tables = {
        "structure": {"clearance": 1.0}, "excitation": {"omega": OMEGA},
        "damping": {"ratio": RATIO}, "contact": {"stiffness": 1e3},
        "integration": {"periods": 20, "deflection": 2.0, "free": True},
    }  # fmt: skip
    (tmp_path / "mass.toml").write_text(scene_of_matrices(tmp_path, parts, tables).as_toml())
    return tmp_path / "mass.toml"


@pytest.fixture
def scene(paper_scene: fc.Scene) -> fc.Scene:
    """A plate with four pairs."""
    return paper_scene.replace(
        {"mesh.columns": 8, "damping.ratio": 0.02, "reduction.modes": 10, "integration.periods": 20}
    )


def decay(time: np.ndarray) -> np.ndarray:
    """Of the mass, from the deflection 2 * 3 N / 800 N/m [m]."""
    root = np.sqrt(1.0 - RATIO**2)
    phase = root * OMEGA * time
    wave = np.cos(phase) + RATIO / root * np.sin(phase)
    return np.asarray(6.0 / 800.0 * np.exp(-RATIO * OMEGA * time) * wave)


@pytest.mark.parametrize(
    ("method", "accuracy"),
    [("events", 1e-12), ("exponential", 1e-12), ("central_difference", 1e-3)],
)
def test_free_decay_from_a_static_deflection(mass: Path, method: str, accuracy: float) -> None:
    """e^(-xi w t) (cos w_d t + ...), over all periods."""
    run = fc.integrate(fc.Scene.load(mass, {"integration.method": method}), MPI.COMM_SELF)
    assert len(run.result.by_period(run.result.time)) == 20
    assert relative(run.result.displacement()[:, 0], decay(run.result.time)) < accuracy


def test_free_decay_from_the_shell(mass: Path, tmp_path: Path) -> None:
    """It ends well, and is read, drawn and goes on where it ended."""
    out = ["--output", str(tmp_path), "--quiet"]
    assert main(["integrate", str(mass), *out]) == 0
    path = tmp_path / "integration.h5"
    stored_history: Any = fc.load_run(path, MPI.COMM_SELF).result
    assert relative(stored_history.displacement()[:, 0], decay(stored_history.time)) < 1e-3
    csv = np.loadtxt(tmp_path / "integration.csv", delimiter=",", skiprows=1)
    assert relative(csv[:, 1], decay(csv[:, 0])) < 1e-3
    rows = json.loads((tmp_path / "integration.json").read_text())
    assert {row["name"]: row["value"] for row in rows}["periods"] == 20
    assert main(["plot", str(path), "--quiet"]) == 0
    restart_settings = {"integration.deflection": None, "integration.initial": str(path)}
    second_history = fc.integrate(fc.Scene.load(mass, restart_settings), MPI.COMM_SELF).result
    assert (
        relative(
            second_history.displacement()[:, 0],
            decay(second_history.time + 20 * 2.0 * np.pi / OMEGA),
        )
        < 1e-3
    )


@laws
def test_static_deflection_stays(scene: fc.Scene, law: dict[str, Any]) -> None:
    """Under a steady load that shuts the crack, which is not at rest otherwise."""
    steady = {"excitation.force_sin": [0.0, 0.0], "excitation.force_mean": [-100.0, 0.0]}
    scene = scene.replace(law | steady | {"integration.periods": 2})
    kept_history, started_history = (
        fc.integrate(scene.replace({"integration.deflection": factor}), MPI.COMM_SELF).result
        for factor in (1.0, None)
    )
    assert kept_history.contact_force.max() > 1.0
    assert np.ptp(kept_history.displacement()) < 1e-9 * np.ptp(started_history.displacement())


@laws
def test_a_solution_goes_on(scene: fc.Scene, law: dict[str, Any], tmp_path: Path) -> None:
    """From its own state the motion stays on the orbit; with other modes and damping nearly."""
    scene = scene.replace(law | {"harmonic_balance.harmonics": 20})
    run = fc.solve(scene, MPI.COMM_SELF)
    run.save(tmp_path / "solution.h5")
    initial = {"integration.initial": str(tmp_path / "solution.h5"), "integration.periods": 2}
    dof = run.watched_dof
    for changes, accuracy in (({}, 2e-2), ({"reduction.modes": 8, "damping.ratio": 0.021}, 0.1)):
        history = fc.integrate(scene.replace(initial | changes), MPI.COMM_SELF).result
        motion = run.result.displacement(history.time, [dof])
        assert relative(history.displacement([dof]), motion) < accuracy
    rest = fc.integrate(scene.replace({"integration.periods": 2}), MPI.COMM_SELF).result
    assert relative(rest.displacement([dof]), motion) > 0.3


def from_solution(scene: fc.Scene, comm: MPI.Comm) -> list[float]:
    """The last displacements of a motion from a solution (collective)."""
    history = fc.integrate(scene, comm).result
    return [float(value) for value in history.displacement()[-3:, 0]]


@pytest.mark.mpi
def test_two_ranks(on_ranks: Callable[..., Any], scene: fc.Scene, tmp_path: Path) -> None:
    """They begin where one does."""
    fc.solve(scene, MPI.COMM_SELF).save(tmp_path / "solution.h5")
    initial = {"integration.initial": str(tmp_path / "solution.h5"), "integration.periods": 1}
    scene = scene.replace(initial)
    assert on_ranks(from_solution, scene) == pytest.approx(from_solution(scene, MPI.COMM_SELF))


def test_bad_input(scene: fc.Scene, tmp_path: Path) -> None:
    """One error names the key, of a file before anything is built."""
    fc.modes(scene, 1, MPI.COMM_SELF).save(tmp_path / "modes.h5")
    fc.solve(scene, MPI.COMM_SELF).save(tmp_path / "solution.h5")

    def integrate(changes: dict[str, Any]) -> fc.Run:
        return fc.integrate(scene.replace(changes), MPI.COMM_SELF)

    wrong_tables: list[tuple[str, dict[str, Any]]] = [
        ("initial", {"initial": str(tmp_path / "none.h5")}),
        ("initial", {"initial": str(tmp_path / "modes.h5")}),
        ("deflection", {"initial": "solution.h5", "deflection": 1.0}),
        ("deflection", {"deflection": 0.0}),
        ("free", {"free": 1}),
    ]
    for key, table in wrong_tables:
        changes = {f"integration.{name}": value for name, value in table.items()}
        catch_error(partial(integrate, changes), f"integration.{key}", table[key])
    catch_error(
        lambda: integrate(
            {"integration.free": True, "rotation.rpm": 60.0, "rotation.hub_radius": 0.1}
        ),
        "integration.free",
        True,
    )
    path = str(tmp_path / "solution.h5")
    catch_error(
        lambda: integrate({"mesh.columns": 4, "integration.initial": path}),
        "integration.initial",
        path,
    )
