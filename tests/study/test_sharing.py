"""Scenes of one mesh share its structure, and have the answers that they have alone."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.study.sharing import LAST_STRUCTURE_OR_EMPTY_LIST

COARSE: dict[str, object] = {
    "mesh.size": 0.04, "mesh.lip_elements": 3, "mesh.order": 2, "crack.first_omega": None,
    "crack.length": 0.03, "reduction": None, "harmonic_balance.harmonics": None,
    "harmonic_balance.tolerance": 0.05, "damping.modes": "all", "damping.ratio": 0.02,
    "contact.friction_error": False,
}  # fmt: skip


@pytest.fixture
def scene() -> fc.Scene:
    return fc.Scene.load(DEMOS / "breathing_plate.toml").replace(COARSE)


def numbers(scene: fc.Scene, comm: MPI.Comm = MPI.COMM_SELF) -> dict[str, Any]:
    """All that is stated of a solution, and the solution at its watched dof (collective)."""
    run = fc.solve(scene, comm)
    error_values: dict[str, Any] = dict(run.errors.values)
    for cause, parts in run.errors.parts.items():
        error_values |= {f"{cause} {name}": part.uncertainty(-1) for name, part in parts.items()}
    [(_, waves)] = run.motion().items()
    return error_values | {
        "waves": waves,
        "modes": run.structure.n_modes,
        "clamp": run.structure.whole.clamp.load,
    }


LOAD: dict[str, object] = {"excitation.force_sin": [0.0, 30.0], "excitation.force_mean": [2.0, 1.0]}
CHANGES: list[tuple[dict[str, object], int]] = [
    ({"crack.clearance": -1e-7, "damping.ratio": 0.01} | LOAD, 0),
    ({"crack.length": 0.04}, 2),
]
MORE: list[tuple[dict[str, object], int]] = [
    ({"excitation.omega": 2400.0}, 0),
    ({"excitation.point": [0.05, 0.1]}, 0),
    ({"harmonic_balance.tolerance": 0.02}, 0),
    ({"base.acceleration_sin": [3.0, 0.0], "excitation.omega": 2200.0}, 0),
    ({"damping.ratio": None, "damping.mass": 20.0, "damping.stiffness": 1e-6}, 0),
    ({"crack.clearance": 1e-7}, 0),
    ({"contact.friction": 0.2}, 0),
    ({"material.young": 2e11}, 2),
    ({"contact.pairs": "mouth"}, 2),
]
EVERY = CHANGES + [pytest.param(*one, marks=pytest.mark.nightly) for one in MORE]


@pytest.mark.parametrize(("changes", "made"), EVERY)
def test_as_alone(
    changes: dict[str, object], made: int, scene: fc.Scene, meshes: list[fc.Scene]
) -> None:
    """Whatever was solved before: the same to rounding; a mesh and a coarser one are made where
    the matrices change, else none."""
    changed_scene = scene.replace(changes)
    expected_numbers = numbers(changed_scene)
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    first_numbers = numbers(scene)
    meshes.clear()
    shared_numbers = numbers(changed_scene)
    assert len(meshes) == made
    assert shared_numbers.keys() == expected_numbers.keys()
    for name, value in expected_numbers.items():
        assert shared_numbers[name] == pytest.approx(
            value, rel=1e-6, abs=1e-9 * np.abs(value).max()
        ), name
    repeated_numbers = numbers(scene)
    assert all(
        repeated_numbers[name] == pytest.approx(first_numbers[name], rel=1e-6)
        for name in ("waves", "modes")
    )


def test_one_is_kept(scene: fc.Scene, meshes: list[fc.Scene]) -> None:
    """The last one, let go before another mesh is made; ranks that share another communicator do
    not share it."""
    body_reference = weakref.ref(fc.solve(scene, MPI.COMM_SELF).structure.whole.body)
    assert body_reference() is not None and len(LAST_STRUCTURE_OR_EMPTY_LIST) == 1
    fc.prepare(scene, MPI.COMM_SELF, whole=True)
    assert len(meshes) == 1
    fc.prepare(scene, MPI.COMM_WORLD, whole=True)
    assert len(meshes) == 2 and body_reference() is None


def test_a_changed_mesh_is_noticed(scene: fc.Scene, tmp_path: Path, meshes: list[fc.Scene]) -> None:
    """A file of the same name, size and time counts by its content."""
    path, other_path = tmp_path / "plate.msh", tmp_path / "other.msh"
    fc.write_msh(scene, path)
    fc.write_msh(scene.replace({"crack.length": 0.05}), other_path)
    keys = {"mesh.layout": "file", "mesh.file": str(path), "mesh.size": None}
    file = scene.replace(
        keys
        | {
            "mesh.lip_elements": None,
            "crack": None,
            "geometry.width": None,
            "geometry.height": None,
        }
    )
    first_amplitude = fc.solve(file).amplitude(None)
    assert fc.solve(file).amplitude(None) == first_amplitude and len(meshes) == 1
    when = path.stat()
    path.write_bytes(other_path.read_bytes())
    os.utime(path, ns=(when.st_atime_ns, when.st_mtime_ns))
    assert abs(fc.solve(file).amplitude(None) / first_amplitude - 1.0) > 0.01 and len(meshes) == 2


def test_a_changed_table_of_a_load_is_noticed(
    scene: fc.Scene, tmp_path: Path, meshes: list[fc.Scene]
) -> None:
    """Its path is the same."""
    table, amplitudes = tmp_path / "wave.csv", []
    for force in (5.0, 10.0):
        table.write_text(f"t,fx,fy\n0,{force},0\n0.5,{force},0\n0.5,-5,0\n1,-5,0\n")
        run = fc.solve(scene.replace({"excitation.wave": str(table)}), MPI.COMM_SELF)
        amplitudes.append(run.amplitude(None))
    assert abs(amplitudes[1] / amplitudes[0] - 1.0) > 0.02 and meshes


OTHER: dict[str, object] = {"excitation.omega": 2400.0, "damping.ratio": 0.03} | LOAD


def both_on(scene: fc.Scene, comm: MPI.Comm) -> tuple[int, list[dict[str, Any]]]:
    """After a structure that one rank has for itself: two scenes, the second shared."""
    LAST_STRUCTURE_OR_EMPTY_LIST.clear()
    if comm.rank == 0:
        fc.prepare(scene, MPI.COMM_SELF, whole=True)
    all_numbers = [numbers(changed_scene, comm) for changed_scene in (scene, scene.replace(OTHER))]
    return len(LAST_STRUCTURE_OR_EMPTY_LIST), all_numbers


@pytest.mark.nightly
def test_same_on_two_ranks(on_ranks: Callable[..., Any], scene: fc.Scene) -> None:
    """Ranks agree on what they share; which modes are enough may hang on rounding."""
    scene = scene.replace({"reduction.modes": 20})
    count, shared_numbers = on_ranks(both_on, scene)
    assert count == 1
    for rank_numbers, changes in zip(shared_numbers, ({}, OTHER), strict=True):
        LAST_STRUCTURE_OR_EMPTY_LIST.clear()
        expected_numbers = numbers(scene.replace(changes))
        assert rank_numbers["amplitude"] == pytest.approx(expected_numbers["amplitude"], rel=1e-6)
        assert rank_numbers["mesh amplitude"] == pytest.approx(
            expected_numbers["mesh amplitude"], rel=1e-3
        )


def test_memory_of_many_studies_of_one_mesh() -> None:
    """The matrices of earlier reductions are freed."""
    scene = fc.Scene.load(DEMOS / "blade.toml").replace({"sweep": None})

    def resident_bytes(first: int) -> int:
        for number in range(first, first + 30):
            fc.prepare(scene.replace({"excitation.frequency": 700.0 + number}))
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize()

    start_bytes = resident_bytes(0)
    assert resident_bytes(30) - start_bytes < 30 * 15_000  # 41,000 each before
