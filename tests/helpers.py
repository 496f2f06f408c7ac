"""What several test files share: structures from matrices, their dense matrices, and measures."""

from __future__ import annotations

import csv
import pkgutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse as sparse
from surroundings import DEMOS as DEMOS
from surroundings import MPI_ENVIRONMENT as MPI_ENVIRONMENT
from surroundings import ROOT as ROOT
from surroundings import main

import fenics_crack as fc
from fenics_crack.balance.block_system import BlockSystem
from fenics_crack.files.store import (
    attribute_texts,
    content_digest,
    dataset_location_texts,
    locate_dataset_in_file,
)

Map = Callable[[np.ndarray], np.ndarray]
OMEGA_0 = 2.0 * np.sqrt(2.0) / (1.0 + np.sqrt(2.0))
"""Natural frequency of the bilinear oscillator with kc = 1."""
BILINEAR_ORBITS = {
    0.5 * OMEGA_0: (-0.278069424, (1.04226613, 0.98674532, 0.13692193), 1.41059367, -2.10198075),
    1.0: (-0.564083304, (2.55314357, 0.19177737, 0.02283921), 2.19791942, -2.94941155),
}
"""oscillator(), kc = 1: for each W the mean, |X1| to |X3|, and the extremes, event-driven."""
SOLID_TEXT = """
geometry = { kind = "solid", width = 0.03, height = 0.05, thickness = 0.01 }
crack = { edge = "left", height = 0.02, length = 0.01 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.01, modes = 10 }
excitation = { point = [0.0, 0.05, 0.005], force_cos = [100.0, 0.0, 10.0], frequency = 2000.0 }
contact = { law = "penalty", stiffness = 1e8 }
mesh = { layout = "graded", order = 2, size = 0.012, lip_elements = 2, error = false }
"""
SOLID = fc.Scene.from_text(SOLID_TEXT)
"""A cracked solid with contact of crack faces with mass."""
TITANIUM = fc.Scene.from_text("""
geometry = { kind = "solid", width = 0.04, height = 0.1, thickness = 0.004 }
crack = { edge = "left", height = 0.012, length = 0.004 }
material = { young = 1.14e11, poisson = 0.33, density = 4430.0 }
damping = { ratio = 0.001 }
rotation = { rpm = 6000.0, hub_radius = 0.25 }
excitation = { order = 4, point = [0.04, 0.1, 0.002], force_sin = [0.0, 0.0, 1.0] }
contact = { law = "unilateral" }
mesh = { layout = "graded", order = 2, size = 0.01, lip_elements = 6, grading = 4.0 }
reduction = { modes = 10 }
curve = { parameter = "rpm", start = 5780.0, stop = 5860.0 }
""")
"""A blade on a rotor, whose resonance the load moves by 20 rpm."""
DAMPINGS = ("modal", "rayleigh", "matrix", "few modes", "none")
"""Kinds of damping of a chain."""


def titanium_blade(force: float) -> fc.Scene:
    """That blade under a load of so many N."""
    return TITANIUM.replace({"excitation.force_sin": [0.0, 0.0, force]})


def csr(matrix: Any) -> sparse.csr_matrix:
    """A matrix of PETSc's on one rank."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, columns, starts), matrix.size)


def columns_of_curve(scene: fc.Scene, folder: Path) -> dict[str, np.ndarray]:
    """The columns of numbers that the command writes of a scene's curve, by their names."""
    (folder / "scene.toml").write_text(scene.as_toml())
    assert main(["curve", str(folder / "scene.toml"), "--output", str(folder), "--quiet"]) == 0
    with open(folder / "curve.csv", newline="") as file:
        header, *rows = csv.reader(file)
    columns = {}
    for name, column in zip(header, zip(*rows, strict=True), strict=True):
        with suppress(ValueError):
            columns[name.partition(" [")[0]] = np.array([float(word or "nan") for word in column])
    return columns


@contextmanager
def changed(path: Path) -> Iterator[h5py.File]:
    """A result's file to be changed by hand; its digest is made anew, as a forger would."""
    with h5py.File(path, "r+") as file:
        yield file
        datasets = file.items() if file.attrs["kind"] == "sweep" else ()
        parts = dataset_location_texts(
            {name: locate_dataset_in_file(item) for name, item in datasets}
        )
        for name, item in file.items() if not parts else ():
            words = h5py.check_string_dtype(item.dtype) is not None
            parts[name] = item.asstr()[()] if words else item[()]
        file.attrs["digest"] = content_digest(attribute_texts(file), parts)


def catch_error(
    call: Callable[[], object],
    key: str | None = None,
    value: object = ...,
    *,
    names: str | None = None,
    kind: type[BaseException] = fc.InputError,
) -> Any:
    """Return the error of a call after checks of its kind, key and value.

    ``names`` is a pattern of numbers, names and commands in its text, whose sentences are free.
    """
    with pytest.raises(kind, match=names) as caught:
        call()
    error = caught.value
    np.testing.assert_equal([type(error), getattr(error, "key", None)], [kind, key])
    if value is not ...:
        np.testing.assert_equal(getattr(error, "value", None), value)
    return error


def wrap(patch: pytest.MonkeyPatch, name: str, around: Callable[..., Any]) -> None:
    """Let calls of a function of the package, by its dotted name, be ``around(function, ...)``."""
    function = pkgutil.resolve_name(name)
    patch.setattr(name, lambda *given, **options: around(function, *given, **options))


def scene_of_matrices(folder: Path, parts: dict[str, Any], tables: dict[str, Any]) -> fc.Scene:
    """Write matrices to files of their names; return the scene of these and of other tables."""
    for name, matrix in parts.items():
        array = matrix if sparse.issparse(matrix) else np.atleast_2d(matrix)
        scipy.io.mmwrite(folder / f"{name}.mtx", array, precision=17)
    files = {name: f"{name}.mtx" for name in parts}
    structure = {"structure": files | tables.get("structure", {})}
    return fc.Scene.from_mapping(tables | structure, folder)


# --- structures -----------------------------------------------------------------------------------


def oscillator(
    damping: float | None = 0.1, force: float = 1.0, clearance: float = 0.0
) -> fc.Structure:
    """x'' + c x' + x (+ contact beyond the clearance) = f cos(W t)."""
    one = np.ones((1, 1))
    matrix = None if damping is None else damping * one
    return fc.Structure.from_matrices(
        one, one, gap=one, force_cos=[force], damping=matrix, clearance=clearance
    )


def two_masses(force: float = 0.1) -> fc.Structure:
    """Two masses and a stop: the stop at mass 1 beyond a clearance of 1, the load on mass 2."""
    stiffness = chain_stiffness(np.array([0.0, 1.0, 1.0]))
    return fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[1.0, 0.0], force_cos=[0.0, force], clearance=1.0,
        damping=0.03 * stiffness,
    )  # fmt: skip


def heavy_mass() -> fc.Structure:
    """The mass that a stop releases: mass 100, stiffness 1e4, a pair, no load."""
    mass = np.array([[100.0]])
    return fc.Structure.from_matrices(mass, 100.0 * mass, gap=np.ones(1))


def free_bar(elements: int) -> fc.Structure:
    """0.2 m of steel-like bar, 1 m^2, with linear elements and a wall 2 mm off its end."""
    size, young, density = 0.2 / elements, 2e11, 8000.0
    stiffness, mass = np.zeros((elements + 1,) * 2), np.zeros((elements + 1,) * 2)
    for element_index in range(elements):
        block = np.s_[element_index : element_index + 2, element_index : element_index + 2]
        stiffness[block] += young / size * np.array([[1.0, -1.0], [-1.0, 1.0]])
        mass[block] += density * size / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
    return fc.Structure.from_matrices(mass, stiffness, gap=np.eye(elements + 1)[-1], clearance=2e-3)


@contextmanager
def block_system(problem: fc.Problem) -> Iterator[tuple[BlockSystem, Map, Map]]:
    """The block system of a problem with samples on one rank; its residual, and its Jacobian
    without the coordinates of damped modes, of all displacements (2H+1, n) [N], [N/m]."""
    compliance = problem.compliance_model()
    linear = compliance.displacement(np.zeros(compliance.gap_shape))
    compliance.destroy()
    with BlockSystem(problem, linear) as block:
        input_vector, value = block.matrix.createVecs()
        size, stiffness = linear.size, block.force_unit / block.length_unit

        def residual(displacement: np.ndarray) -> np.ndarray:
            input_vector.array_w[:] = block.scaled_unknowns_of(displacement)
            block.write_residual(input_vector, value)
            assert not np.any(np.abs(value.array_r[size:]) > 1e-12 * input_vector.norm())
            return block.force_unit * value.array_r[:size].reshape(linear.shape)

        def jacobian(displacement: np.ndarray) -> np.ndarray:
            input_vector.array_w[:] = block.scaled_unknowns_of(displacement)
            block.update_jacobian(input_vector)
            block_matrix = csr(block.matrix).toarray()
            modal_response = np.linalg.solve(block_matrix[size:, size:], block_matrix[size:, :size])
            return stiffness * (
                block_matrix[:size, :size] - block_matrix[:size, size:] @ modal_response
            )

        yield block, residual, jacobian


def chain_stiffness(springs: np.ndarray) -> np.ndarray:
    """K of n masses between n + 1 springs, the first and the last of them fixed to walls."""
    inner_springs = springs[1:-1]
    return (
        np.diag(springs[:-1] + springs[1:]) - np.diag(inner_springs, 1) - np.diag(inner_springs, -1)
    )


def chain(
    damping: str = "modal",
    n: int = 10,
    pairs: int = 3,
    seed: int = 1,
    *,
    unconstrained: bool = False,
) -> fc.Structure:
    """A random chain with loads in both phases and clearances of both signs.

    It has a mean load too, unless it is unconstrained: not fixed at its ends.
    """
    rng = np.random.default_rng(seed)
    springs = rng.uniform(1.0, 3.0, n + 1)
    if unconstrained:
        springs[[0, -1]] = 0.0
    stiffness = chain_stiffness(springs)
    gap = np.zeros((n, pairs))
    for pair in range(pairs):
        gap[3 * pair + 1, pair], gap[3 * pair, pair] = 1.0, -1.0
    dashpots = rng.uniform(0.0, 0.2, n)
    kinds = {
        "modal": fc.ModalDamping(rng.uniform(0.02, 0.08, n)),
        "rayleigh": fc.RayleighDamping(0.05, 0.03),
        "matrix": np.diag(dashpots) + 0.02 * stiffness,  # does not commute: couples the modes
        "gyroscopic": np.diag(dashpots) + 0.3 * (np.eye(n, k=1) - np.eye(n, k=-1)),
        "few modes": fc.ModalDamping([0.05, 0.02, 0.08], modes=3),
        "none": None,
    }
    return fc.Structure.from_matrices(
        np.diag(rng.uniform(1.0, 2.0, n)),
        stiffness,
        gap=gap,
        force_sin=rng.normal(size=n),
        force_cos=rng.normal(size=n),
        force_mean=None if unconstrained else 0.3 * rng.normal(size=n),
        clearance=np.linspace(-0.3, 0.3, pairs),
        damping=kinds[damping],
    )


def random_stiffness(rng: np.random.Generator, n: int) -> np.ndarray:
    """A full matrix, symmetric and positive definite."""
    root = rng.normal(size=(n, n))
    return root @ root.T + n * np.eye(n)


class Cubic:
    """lambda = c g^3: a smooth law, whose coefficients samples give exactly."""

    def __init__(self, stiffness: float) -> None:
        self.stiffness = stiffness

    def force(self, gap: np.ndarray) -> np.ndarray:
        """c g^3."""
        return self.stiffness * gap**3

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """3 c g^2."""
        return 3.0 * self.stiffness * gap**2

    def scaled(self, factor: float) -> Cubic:
        """The same with another c."""
        return Cubic(factor * self.stiffness)


# --- dense matrices -------------------------------------------------------------------------------


def dense(matrix: Any) -> np.ndarray:
    """A sequential PETSc matrix as an array."""
    return csr(matrix).toarray()


def dense_matrices(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, C and K as arrays; damping by its definition, modal damping with LAPACK's modes."""
    mass, stiffness = dense(structure.mass), dense(structure.stiffness)
    damping = np.zeros_like(mass)
    if isinstance(structure.damping, fc.ModalDamping):
        squares, shapes = scipy.linalg.eigh(stiffness, mass)
        count = structure.damping.modes or len(mass)
        mass_shapes = mass @ shapes[:, :count]
        rate = 2.0 * np.asarray(structure.damping.ratio) * np.sqrt(squares[:count])
        damping = (mass_shapes * rate) @ mass_shapes.T
    elif isinstance(structure.damping, fc.RayleighDamping):
        damping = structure.damping.mass * mass + structure.damping.stiffness * stiffness
    elif structure.damping is not None:
        damping = dense(structure.damping)
    return mass, damping, stiffness


# --- orbits and measures --------------------------------------------------------------------------


def period_two_orbit(harmonics: int) -> fc.PeriodicSolution:
    """The bilinear oscillator's orbit of twice the load's period at W = 2 w0, kc = 1."""
    structure, law, omega = oscillator(), fc.UnilateralPenalty(1.0), 2.0 * OMEGA_0
    solution = fc.solve_harmonic_balance(structure, omega, law, harmonics=harmonics, subharmonic=2)
    start_gap = solution.gap_coefficients.copy()
    start_gap[1] += 0.3
    return fc.solve_harmonic_balance(
        structure, omega, law, harmonics=harmonics, subharmonic=2,
        initial=replace(solution, gap_coefficients=start_gap),
    )  # fmt: skip


def passing_angles(
    targets: np.ndarray, motion: Callable[[np.ndarray], Any], radius: float
) -> np.ndarray:
    """Return the angles a of the rotor at which a moving tip passes: a = target - u(a) / R."""
    angles = targets
    for _ in range(60):
        angles = targets - motion(angles) / radius
    return angles


def resized(rows: np.ndarray, harmonics: int) -> np.ndarray:
    """Coefficients a0, a1, b1, ... cut off or padded with zeros to a number of harmonics."""
    padded_rows = np.zeros((2 * harmonics + 1, *rows.shape[1:]))
    padded_rows[: len(rows)] = rows[: len(padded_rows)]
    return padded_rows


def mean_square(rows: np.ndarray) -> float:
    """Of the wave with coefficients a0, a1, b1, ... over its period (Parseval)."""
    return float(np.sum(rows[0] ** 2) + 0.5 * np.sum(rows[1:] ** 2))


def evaluate(rows: np.ndarray, omega: float, time: np.ndarray) -> np.ndarray:
    """a0 + a1 cos(W t) + b1 sin(W t) + ... at some times."""
    phase = omega * np.multiply.outer(time, np.arange(1, len(rows) // 2 + 1))
    return rows[0] + np.cos(phase) @ rows[1::2] + np.sin(phase) @ rows[2::2]


def to_complex(rows: np.ndarray) -> np.ndarray:
    """a0, a1 - i b1, ... of coefficients a0, a1, b1, ...."""
    return np.concatenate([rows[:1], rows[1::2] - 1j * rows[2::2]])


def amplitudes(rows: np.ndarray) -> np.ndarray:
    """|X_1|, |X_2|, ... of coefficients a0, a1, b1, ...."""
    return np.hypot(rows[1::2], rows[2::2])


def sampled_harmonics(values: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean and |X_1|, |X_2|, ... of samples of one period."""
    spectrum = np.fft.rfft(values) / len(values)
    return float(spectrum[0].real), 2.0 * np.abs(spectrum[1:])


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Norm of the difference relative to that of the second, which is not zero."""
    size = np.linalg.norm(expected)
    assert size > 0.0
    return float(np.linalg.norm(found - expected) / size)


def log_slope(sizes: Any, errors: Any) -> float:
    """Slope of the errors over the sizes, both logarithmic."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def true_error(found: fc.PeriodicSolution, exact: fc.PeriodicSolution) -> float:
    """Root mean square of the gaps' difference relative to what of B^T u moves, by coefficients."""
    harmonics = max(found.harmonics, exact.harmonics)
    gap_rows, two = (resized(s.gap_coefficients, harmonics) for s in (found, exact))
    means = float(np.sum((two[0] + exact.structure.clearance) ** 2))
    variance = mean_square(two) - float(np.sum(two[0] ** 2))
    return float(np.sqrt(mean_square(gap_rows - two) / (variance + min(variance, means))))


# --- a Duffing oscillator with one harmonic or more -----------------------------------------------


def duffing() -> fc.Structure:
    """x'' + 0.2 x' + x (+ x^3) = 1.25 sin 2 t."""
    one = np.ones((1, 1))
    return fc.Structure.from_matrices(one, one, gap=one, force_sin=[1.25], damping=0.2 * one)


def newton_roots(system: Any, starts: int = 400) -> list[np.ndarray]:
    """The distinct solutions that Newton's method finds from random starts of many sizes."""
    size = np.linalg.norm(system.linear_gap)
    rng, roots = np.random.default_rng(0), list[np.ndarray]()
    for _ in range(starts):
        gap = rng.normal(size=system.shape)
        gap *= size * 10.0 ** rng.uniform(-1.0, 1.0) / np.linalg.norm(gap)
        for _ in range(100):
            linearisation = system.linearise(gap)
            if np.linalg.norm(linearisation.residual) < 1e-11 * np.linalg.norm(gap):
                if all(np.linalg.norm(gap - known_root) > 1e-6 * size for known_root in roots):
                    roots.append(gap)
                break
            gap = gap - linearisation.solve(linearisation.residual)
    return roots


def duffing_system(harmonics: int, samples: int) -> Any:
    """The package's equations of the Duffing oscillator."""
    problem = fc.Problem(duffing(), 2.0, Cubic(1.0), harmonics, samples)
    return problem.system(problem.compliance_model())


def classical_amplitudes() -> np.ndarray:
    """H = 1: ((1 - W^2 + 3/4 y)^2 + (0.2 W)^2) y = 1.25^2 in y = |X1|^2."""
    squares = np.roots([9.0 / 16.0, -4.5, 9.0 + 0.16, -(1.25**2)])
    assert np.all(np.abs(squares.imag) < 1e-12)
    return np.sort(np.sqrt(squares.real))


# --- meshes ---------------------------------------------------------------------------------------


@contextmanager
def gmsh_model() -> Iterator[Any]:
    """gmsh's model, silent, and gmsh ended afterwards."""
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh.model
    finally:
        gmsh.finalize()


# --- pictures -------------------------------------------------------------------------------------


@contextmanager
def few_frames() -> Iterator[pytest.MonkeyPatch]:
    """Periods that are drawn or written have four frames instead of 36; and a monkeypatch."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("animation.animate_period", "vtk.write_period"):
            function = getattr(fc, name.partition(".")[2])
            patch.setattr(f"fenics_crack.draw.{name}", partial(function, frames=4))
        yield patch


def rows_of_the_paper() -> dict[str, list[str]]:
    """Rows of docs/the_paper.md by their first cell: what the paper says, what is found here,
    whether it holds, and the test that checks it."""
    text, _, _ = (ROOT / "docs" / "the_paper.md").read_text().partition("\n## The yardstick")
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return {row_name: rest for row_name, *rest in cells if row_name}


def assert_found(name: str, *numbers: str) -> None:
    """In a row of docs/the_paper.md these numbers stand in this order, as they are found here."""
    text, place = rows_of_the_paper()[name][1], 0
    for number in numbers:
        assert number in text[place:], f"{name}: {number} is not in {text[place:]}"
        place = text.index(number, place) + len(number)
