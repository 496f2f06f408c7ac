"""Plates that rotate: stiffening, softening, the static state, and cracks that rotation opens."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import catch_error
from mpi4py import MPI
from numpy.polynomial import Polynomial
from rotating import DENSITY, HEIGHT, STRIP, UNIT, WIDTH, YOUNG, cracked, strip
from surroundings import main

import fenics_crack as fc
from fenics_crack import Scene

PUBLISHED = {
    (0, 0): (3.5160, 22.0345), (0, 1): (3.6816, 22.1810), (0, 2): (4.1373, 22.6149),
    (0, 3): (4.7973, 23.3203), (0, 4): (5.5850, 24.2733), (0, 5): (6.4495, 25.4461),
    (0, 6): (7.3604, 26.8091), (0, 10): (11.2023, 33.6404), (0, 12): (13.1702, 37.6031),
    (1, 1): (3.8888, 22.3750), (1, 2): (4.8337, 23.3660), (1, 3): (6.0818, 24.9277),
    (1, 4): (7.4750, 26.9573), (1, 5): (8.9403, 29.3528),
}  # fmt: skip
"""(R/L, W): the first two frequencies of a rotating cantilever, all over UNIT. Wright, Smith,
Thresher and Wang, Journal of Applied Mechanics 49 (1982) 197."""


def beam(ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rayleigh-Ritz of the rotating Euler-Bernoulli beam, E I = rho A = L = 1: bending stiffness,
    stiffness of the tension at W = 1, mass, and the functions' values at the tip.

    The tension is T(s) = int_s^1 (R + x) dx = R (1 - s) + (1 - s^2) / 2.
    """
    functions = [Polynomial([0.0, 0.0] + [0.0] * k + [1.0]) for k in range(9)]
    tension = Polynomial([ratio + 0.5, -ratio, -0.5])

    def integral(product: Polynomial) -> float:
        return float(product.integ()(1.0))

    def matrix(entry: Callable[[Polynomial, Polynomial], Polynomial]) -> np.ndarray:
        return np.array([[integral(entry(f, g)) for g in functions] for f in functions])

    return (
        matrix(lambda f, g: f.deriv(2) * g.deriv(2)),
        matrix(lambda f, g: tension * f.deriv() * g.deriv()),
        matrix(lambda f, g: f * g),
        np.array([f(1.0) for f in functions]),
    )


@pytest.fixture(scope="module")
def strips() -> dict[int, fc.Structure]:
    """The strip on both hubs, at W = 1 UNIT."""
    return {ratio: fc.build_structure(strip(ratio, 1.0)) for ratio in (0, 1)}


@pytest.mark.parametrize("ratio", [0, 1])
def test_frequencies_of_a_rotating_cantilever(strips: dict[int, fc.Structure], ratio: int) -> None:
    """Within 1 % of the published ones, and these are those of the beam to their last digit."""
    bending, tension, mass, _ = beam(ratio)
    rotation = strips[ratio].rotation
    for (case_ratio, speed), published_omegas in PUBLISHED.items():
        if case_ratio != ratio:
            continue
        squares = scipy.linalg.eigh(bending + speed**2 * tension, mass, eigvals_only=True)
        assert np.sqrt(squares[:2]) == pytest.approx(published_omegas, rel=1e-4)
        omegas = fc.solve_modes(rotation.structure_rotating_at_speed(speed * UNIT), 2).omega / UNIT
        assert omegas == pytest.approx(published_omegas, rel=0.01)


def test_southwell_coefficients(strips: dict[int, fc.Structure]) -> None:
    """w^2 = w_0^2 + S W^2 for small W: S = phi^T K_T phi, 1.193 for the first mode without a hub
    and 1.571 R / L more with one."""
    for ratio, structure in strips.items():
        rotation = structure.rotation
        speed = 0.1 * UNIT
        squares = fc.solve_modes(rotation.structure_rotating_at_speed(speed), 1).omega ** 2
        squares -= fc.solve_modes(rotation.structure_at_rest, 1).omega ** 2
        assert squares / speed**2 == pytest.approx([1.193 + 1.571 * ratio], rel=0.01)


def test_a_mean_load_bends_less_under_rotation() -> None:
    """The tip under a constant lateral force: as the beam of Rayleigh-Ritz, less than half of that
    at rest."""
    bending, tension, _, tip = beam(0)
    exact_deflections = [tip @ np.linalg.solve(bending + w**2 * tension, tip) for w in (0.0, 5.0)]
    mean = {"omega": 100.0, "point": [WIDTH, HEIGHT], "force_mean": [1.0, 0.0]}
    deflections = []
    for speed in (0.0, 5.0):
        structure = fc.build_structure(strip(0, speed, excitation=mean))
        displacement = fc.solve_linear(structure, 100.0, harmonics=1).displacement_coefficients[0]
        deflections.append(displacement[structure.find_dof((WIDTH, HEIGHT), "x")])
    assert deflections[1] / deflections[0] == pytest.approx(
        exact_deflections[1] / exact_deflections[0], rel=0.01
    )
    assert deflections[1] < 0.5 * deflections[0]


def test_stiffness_of_linear_motions(strips: dict[int, fc.Structure]) -> None:
    """u = y e: u K_g u = int T dy = rho A (R L^2 / 2 + L^3 / 3) in both directions, without
    Poisson's ratio, and u M_y u = rho A L^3 / 3 along the radius alone. Also the stretch of a bar,
    rho W^2 (R L^2 / 2 + L^3 / 3) / E, but for strains of 1e-6."""
    area, length = WIDTH * 0.02, HEIGHT
    for ratio, structure in strips.items():
        rotation, nodes = structure.rotation, structure.nodes
        pull_integral, softening_integral = (
            ratio * length**3 / 2.0 + length**3 / 3.0,
            length**3 / 3.0,
        )
        for component, exact_energy in (
            (0, pull_integral),
            (1, pull_integral - softening_integral),
        ):
            displacement = np.zeros((structure.n_dofs, 1))
            is_free = nodes.dofs[:, component] >= 0
            displacement[nodes.dofs[is_free, component], 0] = nodes.points[is_free, 1]
            vector, product = rotation.rotation_stiffness.createVecs()
            vector.array[:] = displacement[:, 0]
            rotation.rotation_stiffness.mult(vector, product)
            energy = displacement[:, 0] @ product.array_r
            assert energy == pytest.approx(DENSITY * area * exact_energy, rel=1e-6, abs=1e-9)
        displacement = fc.solve_linear(structure, 100.0, harmonics=1).displacement_coefficients[0]
        tip = displacement[structure.find_dof((WIDTH, HEIGHT), "y")]
        assert tip == pytest.approx(DENSITY * UNIT**2 * pull_integral / YOUNG, rel=1e-3)


def test_at_rest_nothing_changes() -> None:
    """Without the table and at speed 0: the same matrices and loads, bit by bit."""
    plain_strip = fc.build_structure(Scene.from_mapping(STRIP))
    resting_strip = fc.build_structure(strip(1, 0.0))
    assert resting_strip.rotation is None and plain_strip.rotation is None
    for name in ("mass", "stiffness"):
        plain_matrix, resting_matrix = (
            getattr(structure, name).getValuesCSR() for structure in (plain_strip, resting_strip)
        )
        assert all(np.array_equal(a, b) for a, b in zip(plain_matrix, resting_matrix, strict=True))
    assert np.array_equal(plain_strip.force, resting_strip.force)
    rotation = fc.build_structure(strip(1, 1.0)).rotation
    assert (
        rotation is not None
        and rotation.structure_rotating_at_speed(0.0) is rotation.structure_at_rest
    )


# --- cracks ---------------------------------------------------------------------------------------


def test_crack_mouth_opening_is_that_of_fracture_mechanics() -> None:
    """Edge crack in a strip in tension: 4 s a V1(a/W) / E, with s the centrifugal stress over the
    crack (Tada, Paris and Irwin, The Stress Analysis of Cracks Handbook, 2.10)."""
    width, height, crack, level, hub, speed = 0.01, 0.06, 0.003, 0.03, 5.0, 20.0
    scene = cracked(
        speed,
        geometry={"width": width, "height": height, "thickness": 0.001},
        crack={"edge": "left", "height": level, "length": crack},
        excitation={"omega": 1.0, "point": [width, height], "force_sin": [1.0, 0.0]},
        rotation={"speed": speed, "hub_radius": hub},
        mesh={"layout": "graded", "order": 2, "size": 0.0015, "lip_elements": 8, "grading": 6.0},
    )
    gap = fc.solve_linear(fc.prepare(scene).structure, 100.0, harmonics=1).gap_coefficients[0]
    stress = DENSITY * speed**2 * (hub + (level + height) / 2.0) * (height - level)
    cosine = math.cos(math.pi * crack / (2.0 * width))
    shape = (1.46 + 3.42 * (1.0 - cosine)) / cosine**2
    assert -gap[0] == pytest.approx(4.0 * stress * crack * shape / YOUNG, rel=0.03)


def test_rotation_holds_a_crack_open() -> None:
    """At rest the crack breathes; at speed it never closes, and the response is the linear one."""
    resting_solution, spinning_solution = (
        fc.solve(cracked(w), MPI.COMM_SELF).result for w in (0.0, 600.0)
    )
    assert 0.2 < resting_solution.indicators(0).closed_share < 0.8
    assert spinning_solution.converged and spinning_solution.indicators(0).closed_share == 0.0
    linear = fc.solve_linear(
        spinning_solution.structure, spinning_solution.omega, harmonics=spinning_solution.harmonics
    )
    assert spinning_solution.gap_coefficients == pytest.approx(linear.gap_coefficients, rel=1e-9)


def test_speeds_too_high_and_loads_are_refused() -> None:
    """Where softening outweighs all stiffness nothing holds the plate; factors of a load would
    multiply the centrifugal one too."""
    rotation = fc.build_structure(strip(0, 1.0)).rotation
    softening_matrix = rotation.structure_at_rest.mass.copy()
    softening_matrix.scale(-1.0)
    catch_error(
        lambda: replace(rotation, rotation_stiffness=softening_matrix).structure_rotating_at_speed(
            4.0 * UNIT
        ),
        "rotation.speed",
    )
    plate = fc.prepare(cracked(100.0))
    for structure in (plate.structure, plate.structure.whole):
        catch_error(partial(structure.varied, load=2.0), "load", 2.0)
        assert np.array_equal(structure.varied(damping=2.0).force, structure.force)
        varied_structure = structure.varied(damping=2.0, clearance=1e-6).whole
        for speed in (0.0, 100.0):
            turning_structure = varied_structure.rotation.structure_rotating_at_speed(speed)
            assert np.array_equal(turning_structure.clearance, varied_structure.clearance)
            assert turning_structure.damping == varied_structure.damping != structure.whole.damping
    catch_error(
        lambda: fc.continue_parameter(plate.structure, 3000.0, plate.contact, "load", 0.5, 1.0),
        "parameter",
        "load",
    )


def test_check_tells_speed_and_opening(capsys: pytest.CaptureFixture[str], tmp_path: Any) -> None:
    """`check` prints the speed, the crack's static opening and where the order meets the mode."""
    path = tmp_path / "blade.toml"
    scene = cracked(200.0).replace({"excitation.order": 6, "rotation.rpm": 1200.0})
    assert scene.excitation.omega == 6 * scene.rotation.speed  # type: ignore[union-attr]
    path.write_text(scene.as_toml())
    assert main(["check", str(path)]) == 0
    output = capsys.readouterr().out
    assert "rotor speed [rpm]" in output and "opening by rotation" in output
    words = r"rotor speed at which order 6 meets the resonance at the load \[rpm\]"
    [printed_speed] = re.findall(rf"{words} +([\d.]+)\n", output)
    speed = math.pi / 30.0 * float(printed_speed)
    [(mode, crossing)] = fc.campbell(scene, [0.9 * speed, 1.1 * speed], 1).met
    assert mode == 1 and speed == pytest.approx(crossing.value, rel=2e-4)
    assert speed > 3.0 * scene.rotation.speed  # type: ignore[union-attr]


def test_the_length_found_from_a_frequency_is_that_at_rest() -> None:
    """A crack given by its first natural frequency keeps its length whatever the speed."""
    mesh = {"layout": "graded", "size": 0.01, "lip_elements": 2}
    first_omega = float(fc.solve_modes(fc.build_structure(cracked(0.0, mesh=mesh)), 1).omega[0])
    crack = {"edge": "left", "height": 0.05, "first_omega": first_omega}
    length = fc.find_crack_length(cracked(500.0, crack=crack, mesh=mesh))
    assert length == pytest.approx(0.006, rel=2e-3)


def test_lumped_and_tied_blades_rotate_still() -> None:
    """Part of their mean load is centrifugal, which is not multiplied; their run-ups are theirs."""
    full_structure = fc.build_structure(cracked(600.0), MPI.COMM_SELF)
    for make_variant in (full_structure.lumped, lambda: full_structure.tied(1e12)):
        variant = make_variant()
        catch_error(partial(variant.varied, load=2.0), "load", 2.0)
        rotor = fc.run_up_structure(variant, 500.0, 700.0, 3)
        omegas = fc.solve_modes(variant.rotation.structure_rotating_at_speed(650.0), 3).omega
        assert rotor.at_speed(650.0).omega == pytest.approx(omegas, rel=1e-7)
