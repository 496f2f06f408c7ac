"""Result files as other programs see them: units, meaning, and the motion of watched dofs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catch_error, chain, evaluate, oscillator
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import Run

COUNTS = {
    "branch", "complete", "converged", "harmonics", "iterations", "periods", "recorded_dofs",
    "refined", "steps_per_period", "subharmonic", "undecided",
}  # fmt: skip
"""Datasets without a unit, beside words."""
RATIOS = {"created_energy", "distance", "settled", "uncertainty"}


@pytest.fixture(scope="module")
def scene() -> fc.Scene:
    """The paper's plate, its corner watched in x and y."""
    plate = fc.Scene.load(Path(__file__).parents[2] / "demos" / "paper_plate.toml")
    return plate.replace(
        {
            "contact.stiffness": 1e9, "damping.ratio": 0.02, "integration.method": "events",
            "curve.start": 1500.0, "curve.stop": 1520.0, "curve.stability": False,
            "output.points": {"corner": (0.1, 0.1)},
        }
    )  # fmt: skip


def saved(run: Run, path: Path) -> None:
    """As the program writes it."""
    fc.save(run.result, path, run.scene, watched=run.motion())


def test_wave_of_a_point_by_h5py_alone(scene: fc.Scene, tmp_path: Path) -> None:
    """From the coefficients in the order that the file states."""
    run, path = fc.solve(scene, MPI.COMM_SELF), tmp_path / "solution.h5"
    saved(run, path)
    with h5py.File(path) as file:
        assert list(file["watched"].asstr()) == [f"{a} displacement of corner" for a in "xy"]
        rows, attributes = (
            file["watched_coefficients"][()],
            dict(file["watched_coefficients"].attrs),
        )
        omega = float(file["omega"][()])
    assert attributes["unit"] == "m" and "a0, a1, b1, ..., aH, bH" in attributes["about"]
    time = np.linspace(0.0, run.result.period, 50)
    order = np.outer(time, omega * np.arange(1, len(rows) // 2 + 1))
    wave = rows[0] + np.cos(order) @ rows[1::2] + np.sin(order) @ rows[2::2]
    exact = run.result.displacement(time, [watched.dof for watched in run.watched])
    np.testing.assert_allclose(wave, exact, atol=1e-12 * np.abs(exact).max())
    stored_run = fc.load_run(path, MPI.COMM_SELF)
    np.testing.assert_array_equal(stored_run.result.gap(time), run.result.gap(time))


def test_units_of_all_numbers(scene: fc.Scene, tmp_path: Path) -> None:
    """Every dataset is a word, a count, a ratio, or has a unit and says what it is."""
    runs: dict[str, Run] = {
        "solution": fc.solve(scene, MPI.COMM_SELF),
        "curve": fc.curve(scene, MPI.COMM_SELF),
        "integration": fc.integrate(scene, MPI.COMM_SELF),
    }
    for name, run in runs.items():
        path = tmp_path / f"{name}.h5"
        saved(run, path)
        with h5py.File(path) as file:
            for key, item in file.items():
                words = h5py.check_string_dtype(item.dtype) is not None
                is_plain = words or not item.size or key in COUNTS | RATIOS
                assert is_plain or item.attrs.get("unit"), (name, key)
    with h5py.File(tmp_path / "curve.h5") as file:
        assert file["values"].attrs["unit"] == "rad/s"
        points, rows, watched = file["watched_coefficients"].shape
        assert (points, rows, watched) == (len(runs["curve"].result), 11, 2)
        curve = runs["curve"].result
        first_motion = evaluate(
            file["watched_coefficients"][0], 1.0, np.linspace(0.0, 2 * np.pi, 9)
        )
    dofs = [watched.dof for watched in runs["curve"].watched]
    exact = curve.solution(0).displacement(np.linspace(0.0, curve.solution(0).period, 9), dofs)
    np.testing.assert_allclose(first_motion, exact, atol=1e-9 * np.abs(exact).max())
    with h5py.File(tmp_path / "integration.h5") as file:
        motion = file["watched_displacement"][()]
    np.testing.assert_array_equal(motion, runs["integration"].result.displacement(dofs))


def test_without_watched_dofs(tmp_path: Path) -> None:
    """A structure of matrices: the same file without the motion of dofs."""
    structure, path = chain(), tmp_path / "linear.h5"
    solution = fc.solve_linear(structure, 1.3)
    fc.save(solution, path)
    with h5py.File(path) as file:
        assert "watched" not in file and file["gap_coefficients"].attrs["unit"] == "m"
    result_of_file = fc.load(path, structure)
    assert isinstance(result_of_file, fc.PeriodicSolution) and result_of_file.omega == 1.3


@dataclass(frozen=True)
class Hardening:
    """lambda = k g (1 + g / depth) in contact."""

    depth: float
    stiffness: float = 3.0

    def force(self, gap: np.ndarray) -> np.ndarray:
        """lambda(g)."""
        penetration = np.maximum(gap, 0.0)
        return self.stiffness * penetration * (1.0 + penetration / self.depth)

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Its slope."""
        return np.where(gap > 0.0, self.stiffness * (1.0 + 2.0 * gap / self.depth), 0.0)

    def scaled(self, factor: float) -> Hardening:
        """With another stiffness."""
        return replace(self, stiffness=factor * self.stiffness)


def test_a_law_of_ones_own_is_known_by_its_forces(tmp_path: Path) -> None:
    """One of the same name and stiffness, but other forces, is not that of the file."""
    structure, law = oscillator(0.05, 0.3, 0.4), Hardening(1.0)
    solution = fc.solve_harmonic_balance(structure, 0.8, law, harmonics=5)
    curve = fc.continue_frequency(structure, 0.2, 0.5, law, harmonics=5)  # begins without contact
    for name, result in (("solution", solution), ("curve", curve)):
        path = tmp_path / f"{name}.h5"
        fc.save(result, path)
        result_of_file: Any = fc.load(path, structure, Hardening(1.0))
        assert np.array_equal(result_of_file.gap_coefficients, result.gap_coefficients)
        catch_error(partial(fc.load, path, structure, Hardening(0.5)), "contact")


def test_small_parameters_of_a_law_are_compared_relatively(tmp_path: Path) -> None:
    """A stiffness of 1e-9 N/m is not one of 1.5e-9 N/m."""
    structure = oscillator(0.05, 0.3, 0.4)
    path = tmp_path / "solution.h5"
    fc.save(
        fc.solve_harmonic_balance(structure, 0.8, fc.UnilateralPenalty(1e-9), harmonics=5), path
    )
    assert fc.load(path, structure, fc.UnilateralPenalty(1e-9)).contact.stiffness == 1e-9
    catch_error(partial(fc.load, path, structure, fc.UnilateralPenalty(1.5e-9)), "contact")
