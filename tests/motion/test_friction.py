"""Friction between crack faces: published figures, closed forms, laws kept by solutions."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from helpers import ROOT, catch_error
from scipy.optimize import minimize_scalar

import fenics_crack as fc

RIGID = fc.UnilateralConstraint()
HERTZ = 2.0 * np.pi


@cache
def plate(name: str, ratio: float) -> tuple[fc.Structure, fc.Structure]:
    """A demonstration's plate with 10 modes and faces without mass, and its whole."""
    full_plate = fc.build_structure(fc.Scene.load(ROOT / f"demos/{name}.toml"))
    full_plate = full_plate.damped(fc.ModalDamping(ratio, 10))
    return fc.reduce_structure(full_plate, modes=10, method="massless"), full_plate


@cache
def solved(name: str, ratio: float, omega: float, mu: float) -> fc.PeriodicSolution:
    """Its exact orbit."""
    structure, _ = plate(name, ratio)
    law = fc.CoulombFriction(RIGID, mu)
    solution = fc.solve_harmonic_balance(structure, omega, law, tolerance=0.05, throw=False)
    assert solution.orbit is not None
    return solution


# --- one oscillator -------------------------------------------------------------------------------


def jenkins() -> tuple[fc.Structure, fc.CoulombFriction]:
    """m = k = 1, xi = 0.02, k_t = 0.5, load cos(w t), under a constant pressure of 0.3, mu = 1."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.eye(2), gap=[0.0, 1.0], tangential=[1.0, 0.0],
        force_cos=[1.0, 0.0], force_mean=[0.0, 0.6], damping=fc.ModalDamping(0.02),
    )  # fmt: skip
    return structure, fc.CoulombFriction(fc.UnilateralPenalty(1.0), 1.0, 0.5)


def test_loss_of_a_slide() -> None:
    """4 F (A - F / k_t) of a slide between -A and A."""
    structure, law = jenkins()
    for omega in (0.7, 0.9, 1.1):
        orbit = fc.solve_harmonic_balance(structure, omega, law, tolerance=1e-3).orbit
        ends = []
        for sign in (1.0, -1.0):
            time = np.linspace(0.0, orbit.period, 400)
            sampled_turn = time[np.argmax(sign * orbit.tangential_gap_at(time)[:, 0])]
            turning_point = minimize_scalar(
                lambda t, s=sign, o=orbit: -s * o.tangential_gap_at(np.array([t]))[0, 0],
                bounds=(sampled_turn - time[1], sampled_turn + time[1]), method="bounded",
                options={"xatol": 1e-10},
            )  # fmt: skip
            ends.append(-turning_point.fun)
        size = 0.5 * sum(ends)
        assert orbit.energy_budget.friction[0] == pytest.approx(4.0 * 0.3 * (size - 0.6), rel=1e-9)


# --- plates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "ratio", "omega", "mu", "tip", "share", "largest"),
    [
        pytest.param(
            "breathing_plate", 0.01, 2000.0, 0.1, 1.17736, 0.204, 0.774081,
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "breathing_plate", 0.01, 2000.0, 0.5, 1.16578, 0.599, 0.842048,
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "inclined_crack", 0.005, 3560 * HERTZ, 0.3, 37.19496, 0.814, 0.935906,
            marks=pytest.mark.nightly,
        ),
        ("inclined_crack", 0.005, 3183 * HERTZ, 0.3, 3.98644, 0.319, 0.959036),
    ],
)  # fmt: skip
def test_orbits(
    name: str, ratio: float, omega: float, mu: float, tip: float, share: float, largest: float
) -> None:
    """Half peak-to-peak of the modes' part of the watched motion [um], loss by friction over that
    by damping, largest multiplier: of a prototype that shares no code with the program. The work of
    the load is that of both losses."""
    solution = solved(name, ratio, omega, mu)
    orbit, (structure, full_plate) = solution.orbit, plate(name, ratio)
    tip_motion = (
        orbit.period_samples.states[:, : orbit.flow.n_modes]
        @ structure.basis[full_plate.watched_dof]
    )
    assert np.ptp(tip_motion) / 2e-6 == pytest.approx(tip, rel=3e-4)
    work = orbit.energy_budget
    assert work.friction.sum() / work.damping.sum() == pytest.approx(share, abs=6e-4)
    assert abs(orbit.multipliers[0]) == pytest.approx(largest, abs=2e-4)
    assert work.load == pytest.approx(work.damping.sum() + work.friction.sum(), rel=1e-9)
    assert solution.report.truncation < 0.025


def test_laws_kept_by_harmonic_balance() -> None:
    """The forces of a wave keep Signorini's conditions and Coulomb's; the losses are stated."""
    structure, _ = plate("inclined_crack", 0.005)
    law = fc.CoulombFriction(RIGID, 0.3)
    solution = fc.solve_harmonic_balance(structure, 3183.0 * HERTZ, law, harmonics=20)
    time = np.linspace(0.0, solution.period, 500)
    normal, drag = solution.contact_force(time), solution.tangential_force(time)
    gap = solution.gap(time)
    assert normal.min() >= 0.0 and gap.max() <= 1e-12 * np.abs(gap).max() + 1e-18
    assert np.all(np.abs(drag) <= 0.3 * normal * (1.0 + 1e-9) + 1e-12)
    exact = solved("inclined_crack", 0.005, 3183.0 * HERTZ, 0.3)
    exact_sliding, indicators = exact.orbit.friction_number_by_name, solution.indicators()
    assert indicators.friction_loss == pytest.approx(exact_sliding["friction_loss"], rel=0.01)
    assert indicators.slip_share == pytest.approx(exact_sliding["slip_share"], abs=0.01)
    assert indicators.stick_share + indicators.slip_share == pytest.approx(
        indicators.closed_share, abs=1e-12
    )
    slide = solution.tangential_gap(time) - exact.orbit.tangential_gap_at(time)
    assert np.abs(slide).max() < 0.02 * np.ptp(exact.orbit.tangential_gap_at(time))


def test_resonance_that_friction_halves() -> None:
    """Full Newton steps do not arrive: the coefficient grows along a path."""
    structure, _ = plate("inclined_crack", 0.005)
    law = fc.CoulombFriction(RIGID, 0.3)
    solution = fc.solve_harmonic_balance(structure, 3560.0 * HERTZ, law, harmonics=20)
    exact = solved("inclined_crack", 0.005, 3560.0 * HERTZ, 0.3)
    frictionless_solution = fc.solve_harmonic_balance(
        structure, 3560.0 * HERTZ, RIGID, harmonics=20
    )
    assert solution.amplitude() == pytest.approx(exact.amplitude(), rel=0.02)
    assert exact.amplitude() < 0.52 * frictionless_solution.amplitude()
    assert fc.floquet(structure, solution).verdict == "stable"


# --- a published example --------------------------------------------------------------------------


def beam() -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of NLstep's example 02 [t, mm, s]: a clamped Euler-Bernoulli beam 2000 x
    100 x 300 of 8 elements, dofs w and w' of the nodes 2 to 9."""
    n, length, young, density = 8, 250.0, 185e3, 7.83e-9
    height, width = 100.0, 300.0
    bending, line = young * width * height**3 / 12.0, density * width * height
    l = length
    k = bending / l**3 * np.array(
        [[12, 6 * l, -12, 6 * l], [6 * l, 4 * l * l, -6 * l, 2 * l * l],
         [-12, -6 * l, 12, -6 * l], [6 * l, 2 * l * l, -6 * l, 4 * l * l]]
    )  # fmt: skip
    m = line * l / 420.0 * np.array(
        [[156, 22 * l, 54, -13 * l], [22 * l, 4 * l * l, 13 * l, -3 * l * l],
         [54, 13 * l, 156, -22 * l], [-13 * l, -3 * l * l, -22 * l, 4 * l * l]]
    )  # fmt: skip
    stiffness, mass = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for element in range(n):
        element_dofs = slice(2 * element, 2 * element + 4)
        stiffness[element_dofs, element_dofs] += k
        mass[element_dofs, element_dofs] += m
    return stiffness[2:, 2:], mass[2:, 2:]


def nlstep_beam() -> tuple[fc.Structure, fc.CoulombFriction, int]:
    """The beam with 5 modes, rubbing at its fourth node, its law, and the dof of its tip."""
    stiffness, mass = beam()
    n, node, tip = len(mass), 4, 14  # w of the fourth node, and of the last one
    held_dofs = np.delete(np.arange(n), node)
    part = np.ix_(held_dofs, held_dofs)
    squares = np.linalg.eigvals(np.linalg.solve(mass[part], stiffness[part]))
    stuck = np.sort(np.sqrt(np.abs(squares)))
    assert stuck[:2] == pytest.approx([248.9733, 1660.4750], rel=1e-4)  # printed: of fewer modes
    # The pressure is that of a mass of its own on a spring, which the friction does not move.
    matrices = [np.zeros((n + 1, n + 1)) for _ in range(2)]
    for extended_matrix, beam_matrix, added_entry in zip(
        matrices, (mass, stiffness), (1.0, 1e4), strict=True
    ):
        extended_matrix[:n, :n], extended_matrix[n, n] = beam_matrix, added_entry
    gap, tangent, load, press = np.zeros((4, n + 1))
    gap[n], tangent[node], load[tip], press[n] = 1.0, 1.0, 200.0, 3000.0
    structure = fc.Structure.from_matrices(
        *matrices, gap=gap, tangential=tangent, force_cos=load, force_mean=press,
        damping=fc.RayleighDamping(2.0 * 0.05 * stuck[0], 0.0),
    )  # fmt: skip
    reduced_structure = fc.reduce_structure(structure, modes=6, method="massless")
    return reduced_structure, fc.CoulombFriction(fc.UnilateralPenalty(1e4), 1.0), tip


# --- what cannot be used --------------------------------------------------------------------------


def test_refusals() -> None:
    structure, law = jenkins()
    for coefficient in (-0.1, 0.0, np.nan, "much"):
        catch_error(
            partial(fc.CoulombFriction, RIGID, coefficient), "friction coefficient", coefficient
        )
    catch_error(
        lambda: fc.CoulombFriction(fc.SmoothedPenalty(1.0, 1.0), 0.3),
        "law",
        names="UnilateralPenalty, LayeredPenalty or UnilateralConstraint",
    )
    penalty_friction = fc.CoulombFriction(fc.UnilateralPenalty(1.0), 0.3)
    catch_error(
        lambda: fc.solve_harmonic_balance(structure, 1.0, penalty_friction, harmonics=3),
        "contact",
        penalty_friction,
    )
    pair_without_tangent = fc.Structure.from_matrices(
        np.eye(2), np.eye(2), gap=[0.0, 1.0], force_cos=[1.0, 0.0], damping=0.1 * np.eye(2)
    )
    catch_error(
        lambda: fc.solve_harmonic_balance(pair_without_tangent, 1.0, law, harmonics=3),
        "structure",
        names="with_tangents",
    )
    solution = fc.solve_harmonic_balance(
        pair_without_tangent, 1.0, fc.UnilateralPenalty(1.0), harmonics=3
    )
    for ask in (solution.tangential_gap, solution.tangential_force):
        catch_error(partial(ask, np.zeros(1)), "contact", names="CoulombFriction")
    catch_error(lambda: fc.draw_friction_loops(solution), "solution", str(solution))


def test_more_than_one_answer() -> None:
    """Two pairs coupled so strongly that the forces of an instant need not be the only ones."""
    structure, _ = jenkins()
    flow = fc.solve_harmonic_balance(structure, 0.9, jenkins()[1], harmonics=3).assessment.flow
    assert (
        flow is not None and flow.critical_friction_coefficient == np.inf
    )  # pressure and slide are apart
    plates = solved("inclined_crack", 0.005, 3183.0 * HERTZ, 0.3).assessment.flow
    assert plates is not None and 4.0 < plates.critical_friction_coefficient < 8.0


@pytest.mark.parametrize("harmonics", [1, 5])
def test_a_damper_that_never_slips_is_a_spring(harmonics: int) -> None:
    """Newton's method needs few steps where a pair sticks all the time: its place goes with the
    gaps. F / |k + k_t - w^2 + 2 i xi w|."""
    structure, law = jenkins()
    structure = structure.varied(load=np.diag([1.0, 0.2, 0.2]))
    solution = fc.solve_harmonic_balance(structure, 0.6, law, harmonics=harmonics)
    exact_amplitude = 0.2 / abs(1.5 - 0.6**2 + 0.04j * 0.6)
    assert np.hypot(*solution.displacement_coefficients[1:3, 0]) == pytest.approx(exact_amplitude)
    assert solution.iterations < 10
