"""The layered law: two rows for each pair inside, the pair itself in every number outside."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, chain, oscillator, relative
from motion.test_friction_on_solids import BLADE

import fenics_crack as fc
from fenics_crack.cli.command_line import main

LAW = fc.LayeredPenalty(5.0, layer_depth=0.15, layer_share=0.3)
OMEGA = 0.8
FACE_NUMBERS = ("opening", "penetration", "contact_force", "crack_force", "closed_share")


@dataclass(frozen=True)
class BilinearLaw:
    """The same force in one row for each pair, as a law of one's own: it is sampled."""

    stiffness: float
    depth: float
    share: float

    def force(self, gap: np.ndarray) -> np.ndarray:
        """a k max(0, g) + (1 - a) k max(0, g - p)."""
        layer_force = self.share * self.stiffness * np.maximum(gap, 0.0)
        deep_gap = np.maximum(gap - self.depth, 0.0)
        return layer_force + (1.0 - self.share) * self.stiffness * deep_gap

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """0, a k or k."""
        slope = self.share * (gap > 0.0) + (1.0 - self.share) * (gap > self.depth)
        return self.stiffness * slope

    def scaled(self, factor: float) -> "BilinearLaw":
        """The same law with a factor of its stiffness."""
        return replace(self, stiffness=factor * self.stiffness)


def chain_with_mass() -> fc.Structure:
    """Three pairs with clearance, none and preload, with mass: pairs are not coupled."""
    return chain("modal")


def chain_without_mass() -> fc.Structure:
    """The same with five of ten modes, and crack faces without mass: pairs are coupled."""
    return fc.reduce_structure(chain("modal"), modes=5, method="massless")


STRUCTURES = (chain_with_mass, chain_without_mass)


def solve_exactly(structure: fc.Structure, law: Any, tolerance: float = 1e-4) -> Any:
    """A solution with an exact orbit, whatever the error by modes."""
    return fc.solve_harmonic_balance(structure, OMEGA, law, tolerance=tolerance, throw=False)


@pytest.mark.parametrize("make_structure", STRUCTURES)
def test_orbit_against_sampled_forces(make_structure: Callable[[], fc.Structure]) -> None:
    """The exact orbit is the solution with many harmonics of forces that are sampled in time, with
    a single row for each pair; so are its multiplier and the numbers of its crack faces."""
    structure = make_structure()
    n_harmonics, n_samples = (60, 8192) if structure.has_massless_crack_faces else (90, 16384)
    sampled_solution = fc.solve_harmonic_balance(
        structure, OMEGA, BilinearLaw(5.0, 0.15, 0.3), harmonics=n_harmonics, samples=n_samples
    )
    solution = solve_exactly(structure, LAW)
    orbit = solution.orbit
    times = np.linspace(0.0, orbit.period, 200, endpoint=False)
    gaps, forces = orbit.gap_at(times), orbit.force_at(times)
    assert gaps.shape == forces.shape == (200, 3) and np.any(gaps > 0.15)
    assert np.allclose(forces, LAW.force(gaps), atol=1e-12)
    assert relative(sampled_solution.gap(times), gaps) < 1e-6
    assert relative(sampled_solution.contact_force(times), forces) < 2e-6
    displacement = orbit.displacement_at(times)
    assert relative(sampled_solution.displacement_of_local_dofs(times), displacement) < 1e-6
    multiplier = abs(fc.floquet(structure, solution).multipliers[0])
    sampled_stability = fc.floquet(structure, sampled_solution)
    assert sampled_stability.verdict == fc.floquet(structure, solution).verdict == "stable"
    assert abs(sampled_stability.multipliers[0]) == pytest.approx(multiplier, abs=1e-5)
    for name in FACE_NUMBERS:
        tolerance = 2e-3 if name == "closed_share" else 1e-5  # counted at instants
        exact_number = getattr(orbit.indicators(), name)
        assert getattr(sampled_solution.indicators(), name) == pytest.approx(
            exact_number, rel=tolerance
        )


@pytest.mark.parametrize("make_structure", STRUCTURES)
def test_harmonic_balance_against_the_orbit(make_structure: Callable[[], fc.Structure]) -> None:
    """With given harmonics, exact or sampled integrals or the block form have the same solution (of
    several that 12 harmonics have), and its distance to the orbit is the error of the report. Next
    to singular, the block system of the chain without mass keeps five digits."""
    structure = make_structure()
    solutions = [fc.solve_harmonic_balance(structure, OMEGA, LAW, harmonics=12)]
    solutions += [
        fc.solve_harmonic_balance(
            structure, OMEGA, LAW, harmonics=12, initial=solutions[0], **options
        )  # type: ignore[arg-type]
        for options in ({"samples": 8192}, {"form": "block"})
    ]
    orbit = solve_exactly(structure, LAW).orbit
    times = np.linspace(0.0, orbit.period, 200, endpoint=False)
    for solution, tolerance in zip(solutions, (1e-6, 1e-6, 1e-5), strict=True):
        assert relative(solution.gap(times), solutions[0].gap(times)) < tolerance
        assert solution.gap_coefficients.shape == solution.force_coefficients.shape == (25, 3)
        motion_size = np.linalg.norm(orbit.gap_at(times) + structure.clearance)
        gap_error = np.linalg.norm(solution.gap(times) - orbit.gap_at(times)) / motion_size
        assert solution.report.truncation == pytest.approx(gap_error, rel=0.5)
        assert np.allclose(solution.contact_force(times), LAW.force(solution.gap(times)))
    next_solution = fc.solve_harmonic_balance(
        structure, OMEGA, LAW, harmonics=12, initial=solutions[0]
    )
    assert "full Newton steps: converged" in next_solution.status


@pytest.mark.parametrize("make_structure", STRUCTURES)
@pytest.mark.parametrize(
    ("law", "limit"),
    [
        (fc.LayeredPenalty(5.0, 0.15, 1.0 - 1e-9), fc.UnilateralPenalty(5.0)),
        (fc.LayeredPenalty(5.0, 1e3, 0.3), fc.UnilateralPenalty(1.5)),
        (fc.LayeredPenalty(5.0, 1e-9, 0.3), fc.UnilateralPenalty(5.0)),
    ],
    ids=["share to 1", "depth large", "depth to 0"],
)
def test_limits_are_penalty_laws(
    make_structure: Callable[[], fc.Structure], law: Any, limit: Any
) -> None:
    """All of the stiffness in the layer, a layer that is never compressed, and none: k, a k, k."""
    structure = make_structure()
    motions = [
        fc.solve_harmonic_balance(structure, OMEGA, contact, harmonics=12)
        for contact in (law, limit)
    ]
    assert relative(motions[0].gap_coefficients, motions[1].gap_coefficients) < 1e-7
    assert relative(motions[0].force_coefficients, motions[1].force_coefficients) < 1e-7
    assert motions[0].report.total == pytest.approx(motions[1].report.total, rel=1e-4)
    assert motions[0].report.penetration == pytest.approx(motions[1].report.penetration, rel=1e-4)
    assert motions[0].face_indicators == pytest.approx(motions[1].face_indicators, rel=1e-6)


@pytest.mark.parametrize(
    ("integrate", "steps", "make_structure"),
    [
        (fc.integrate_events, 128, chain_without_mass),
        (fc.integrate_exponential, 1024, chain_without_mass),
        (fc.integrate_central_difference, 1024, chain_with_mass),
    ],
)
def test_motion_in_time_settles_on_the_orbit(
    integrate: Any, steps: int, make_structure: Callable[[], fc.Structure]
) -> None:
    """Every scheme, from rest, with gaps and forces of the pairs, and its balance of energy."""
    structure = make_structure()
    history = integrate(
        structure, OMEGA, LAW, periods=100, steps_per_period=steps, settle=1e-5, progress=False
    )
    orbit = solve_exactly(structure, LAW).orbit
    gaps, forces = history.gap[-steps:], history.contact_force[-steps:]
    assert gaps.shape == forces.shape == (steps, 3)
    assert relative(gaps, orbit.gap_at(history.time[-steps:])) < 1e-3
    assert np.allclose(forces, LAW.force(gaps), atol=1e-12)
    assert abs(history.created_energy) < 1e-4


@pytest.mark.parametrize("make_structure", STRUCTURES)
@pytest.mark.parametrize("options", [{"harmonics": 20}, {"tolerance": 1e-3}])
def test_curves_end_at_solutions(
    make_structure: Callable[[], fc.Structure], options: dict[str, Any]
) -> None:
    """Over stiffness and clearance; a clearance is added to both rows."""
    structure = make_structure()
    for parameter, end, structure_at_end, law in (
        ("stiffness", 1.5, structure, LAW.scaled(1.5)),
        ("clearance", 0.1, structure.varied(clearance=0.1), LAW),
    ):
        start = 1.0 if parameter == "stiffness" else 0.0
        curve = fc.continue_parameter(structure, OMEGA, LAW, parameter, start, end, **options)
        orbit = solve_exactly(structure_at_end, law).orbit
        for name in ("amplitude", "opening", "contact_force", "crack_force"):
            exact_number = getattr(orbit.indicators(), name)
            assert getattr(curve.indicators(), name)[-1] == pytest.approx(exact_number, rel=2e-4)
        assert curve.gap_coefficients.shape[-1] == 3


def test_resonance_moves_with_the_load() -> None:
    """A small load compresses no layer: the resonance is that of a k alone; a large one of k."""
    structure, law = oscillator(0.05), fc.LayeredPenalty(3.0, 2.0, 0.2)

    def resonance(contact: Any, load: float) -> float:
        problem = fc.Problem(structure.varied(load=load), 1.2, contact, harmonics=15)
        return fc.resonance_at(problem).omega

    assert resonance(law, 0.02) == pytest.approx(resonance(fc.UnilateralPenalty(0.6), 1.0))
    stiff_resonance = resonance(fc.UnilateralPenalty(3.0), 1.0)
    assert resonance(law, 0.02) < resonance(law, 1.0) < resonance(law, 1e4)
    assert resonance(law, 1e4) == pytest.approx(stiff_resonance, rel=1e-3)


def test_many_cases_and_files(tmp_path: Path) -> None:
    """solve_many counts pairs; a file keeps depth and share, and refuses another law."""
    structure = chain_without_mass()
    solution = solve_exactly(structure, LAW)
    table = fc.solve_many(structure, np.array([OMEGA, 0.79]), LAW)
    indicators = solution.orbit.indicators()
    assert table.closed_share[0] == pytest.approx(indicators.closed_share, rel=1e-9)
    assert table.opening[0] == pytest.approx(indicators.opening, rel=1e-4)
    fc.save(solution, tmp_path / "solution.h5")
    loaded_solution: Any = fc.load(tmp_path / "solution.h5", structure, LAW)
    times = np.linspace(0.0, solution.period, 50)
    assert np.allclose(loaded_solution.gap(times), solution.gap(times), atol=1e-12)
    assert np.allclose(
        structure.expand(loaded_solution.displacement_coefficients),
        structure.expand(solution.displacement_coefficients),
        atol=1e-9,
    )
    load: Any = fc.load
    for law in (replace(LAW, layer_depth=0.16), replace(LAW, layer_share=0.31)):
        catch_error(lambda law=law: load(tmp_path / "solution.h5", structure, law), "contact")


# --- friction -------------------------------------------------------------------------------------

RUBBING_LAW = fc.CoulombFriction(LAW, np.array([0.4, 0.7]), np.array([2.0, 4.0]))
SPRINGS = np.array([1.2, 1.5, 2.6, 2.2, 1.2, 1.9, 1.0])
"""Of a chain of six masses between two walls."""
MASSES = np.diag([1.2, 1.7, 1.5, 1.9, 1.3, 1.1])
STIFFNESS = (
    np.diag(SPRINGS[1:] + SPRINGS[:-1]) - np.diag(SPRINGS[1:-1], 1) - np.diag(SPRINGS[1:-1], -1)
)
DAMPING = 0.1 * MASSES + 0.05 * STIFFNESS
GAP = np.array([[-1.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0, 1.0, 0.0]]).T
TANGENTIAL = np.array([[0.0, -0.5, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.3, 0.0, 1.0]]).T
CLEARANCE = np.array([0.05, -0.2])
FORCE_MEAN, FORCE_COS, FORCE_SIN = (
    np.array([0.2, -0.4, 0.1, 0.3, -0.1, 0.2]),
    np.array([1.3, -0.2, 0.9, -1.1, 0.4, 0.8]),
    np.array([-0.5, 1.4, 0.2, -0.6, -1.2, 0.3]),
)


def rubbing_chain() -> fc.Structure:
    """Six masses and two pairs, with clearance and preload, and with tangential gaps."""
    return fc.Structure.from_matrices(
        MASSES, STIFFNESS, gap=GAP, tangential=TANGENTIAL, clearance=CLEARANCE, damping=DAMPING,
        force_mean=FORCE_MEAN, force_cos=FORCE_COS, force_sin=FORCE_SIN,
    )  # fmt: skip


def rubbing_chain_without_mass() -> fc.Structure:
    """The same with four modes, and crack faces without mass."""
    return fc.reduce_structure(rubbing_chain(), modes=4, method="massless")


RUBBING_STRUCTURES = (rubbing_chain, rubbing_chain_without_mass)


def march_two_sliders(n_periods: int, n_steps: int) -> list[np.ndarray]:
    """Normal gaps, tangential gaps, normal and friction forces of the last period, by central
    differences with two springs and two sliders in parallel for each pair; of second order."""
    step_size = 2.0 * np.pi / OMEGA / n_steps
    inverse = np.linalg.inv(MASSES + 0.5 * step_size * DAMPING)
    shares, depths = np.array([[0.3], [0.7]]), np.array([[0.0], [0.15]])
    normal_stiffness, tangential_stiffness = 5.0 * shares, [2.0, 4.0] * shares
    phases = 2.0 * np.pi / n_steps * np.arange(n_steps)[:, None]
    loads = FORCE_MEAN + np.cos(phases) * FORCE_COS + np.sin(phases) * FORCE_SIN
    before = displacement = np.zeros(6)
    gaps, tangential_gaps, places = np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2))
    rows = []
    for step in range(n_periods * n_steps):
        gaps_before, tangential_gaps_before = gaps, tangential_gaps
        gaps = displacement @ GAP - CLEARANCE - depths
        tangential_gaps = displacement @ TANGENTIAL
        has_closed = (gaps_before <= 0.0) & (gaps > 0.0)
        if np.any(has_closed):  # between both steps
            part = gaps_before / np.where(has_closed, gaps_before - gaps, 1.0)
            change = tangential_gaps - tangential_gaps_before
            places = np.where(has_closed, tangential_gaps_before + part * change, places)
        normal = normal_stiffness * np.maximum(gaps, 0.0)
        limits = [0.4, 0.7] * normal
        friction = np.clip(tangential_stiffness * (tangential_gaps - places), -limits, limits)
        places = tangential_gaps - friction / tangential_stiffness
        forces = normal.sum(axis=0), friction.sum(axis=0)
        rows.append(np.concatenate([gaps[0], tangential_gaps, *forces]))
        net_force = loads[step % n_steps] - STIFFNESS @ displacement
        net_force -= GAP @ forces[0] + TANGENTIAL @ forces[1]
        last_increment = MASSES @ (displacement - before)
        damping_force = 0.5 * step_size * DAMPING @ before
        before, displacement = (
            displacement,
            inverse
            @ (step_size**2 * net_force + MASSES @ displacement + last_increment + damping_force),
        )
    return np.hsplit(np.array(rows[-n_steps:]), 4)


def gaps_and_forces_of(orbit: Any, times: np.ndarray) -> list[np.ndarray]:
    """Normal gaps, tangential gaps, normal and friction forces of an orbit."""
    names = "gap_at", "tangential_gap_at", "force_at", "tangential_force_at"
    return [getattr(orbit, name)(times) for name in names]


def test_orbit_with_friction_against_steps() -> None:
    """A pair rubs as two springs in parallel, each with a slider of its own."""
    orbit = solve_exactly(rubbing_chain(), RUBBING_LAW).orbit
    motions = gaps_and_forces_of(orbit, np.linspace(0.0, orbit.period, 1500, endpoint=False))
    for motion, marched_motion in zip(motions, march_two_sliders(20, 1500), strict=True):
        assert motion.shape == (1500, 2) and relative(marched_motion, motion) < 1e-4
    friction, limit = np.abs(motions[3]), RUBBING_LAW.coefficient * motions[2]
    assert np.all(friction <= limit + 1e-9) and np.any(motions[0] > 0.15)
    is_slipping = (friction >= (1.0 - 1e-6) * limit) & (limit > 0.0)
    indicators = orbit.friction_number_by_name
    assert indicators["slip_share"] == pytest.approx(is_slipping.mean(), abs=2e-3)
    closed_share = (limit > 0.0).mean() - is_slipping.mean()
    assert indicators["stick_share"] == pytest.approx(closed_share, abs=2e-3)
    disturbances = 1e-6 * np.eye(len(orbit.state))
    changes = [
        orbit.flow.advance(orbit.state + change, OMEGA, orbit.period).state
        - orbit.flow.advance(orbit.state - change, OMEGA, orbit.period).state
        for change in disturbances
    ]
    multipliers = np.abs(np.linalg.eigvals(np.array(changes) / 2e-6))
    assert abs(orbit.multipliers[0]) == pytest.approx(multipliers.max(), rel=1e-5)


@pytest.mark.parametrize("make_structure", RUBBING_STRUCTURES)
def test_harmonic_balance_with_friction(
    make_structure: Callable[[], fc.Structure], tmp_path: Path
) -> None:
    """Many harmonics give the orbit and its stability, and fewer the error that is stated; files
    have the law, and initial solutions and curves fit."""
    structure = make_structure()
    orbit = solve_exactly(structure, RUBBING_LAW).orbit
    times = np.linspace(0.0, orbit.period, 200, endpoint=False)
    exact_motions = gaps_and_forces_of(orbit, times)
    solution = fc.solve_harmonic_balance(structure, OMEGA, RUBBING_LAW, harmonics=60, samples=16384)
    motions = [
        getattr(solution, name)(times)
        for name in ("gap", "tangential_gap", "contact_force", "tangential_force")
    ]
    tolerances = 1e-4, 1e-4, 1e-4, 3e-3
    for motion, exact_motion, tolerance in zip(motions, exact_motions, tolerances, strict=True):
        assert relative(motion, exact_motion) < tolerance
    displacement = orbit.displacement_at(times)
    assert relative(solution.displacement_of_local_dofs(times), displacement) < 1e-4
    stability = fc.floquet(structure, solution)
    assert stability.verdict == "stable"
    assert abs(stability.multipliers[0]) == pytest.approx(abs(orbit.multipliers[0]), abs=1e-6)
    coarse_solution = fc.solve_harmonic_balance(structure, OMEGA, RUBBING_LAW, harmonics=12)
    motion_size = np.linalg.norm(exact_motions[0] + structure.clearance)
    gap_error = np.linalg.norm(coarse_solution.gap(times) - exact_motions[0]) / motion_size
    report = coarse_solution.report
    assert 0.5 * gap_error < report.truncation + report.sampling < 2.0 * gap_error
    next_solution = fc.solve_harmonic_balance(
        structure, OMEGA, RUBBING_LAW, harmonics=12, initial=coarse_solution
    )
    assert "full Newton steps: converged" in next_solution.status
    fc.save(solution, tmp_path / "solution.h5")
    loaded_solution: Any = fc.load(tmp_path / "solution.h5", structure, RUBBING_LAW)
    assert np.allclose(loaded_solution.tangential_force(times), motions[3], atol=1e-12)
    load: Any = fc.load
    for normal_law in (replace(LAW, layer_depth=0.16), fc.UnilateralPenalty(5.0)):
        law = replace(RUBBING_LAW, law=normal_law)
        catch_error(lambda law=law: load(tmp_path / "solution.h5", structure, law), "contact")
    curve = fc.continue_parameter(
        structure, OMEGA, RUBBING_LAW, "friction", 1.0, 1.2, tolerance=1e-3
    )
    end_law = replace(RUBBING_LAW, coefficient=1.2 * RUBBING_LAW.coefficient)
    end_indicators = solve_exactly(structure, end_law).orbit.indicators()
    curve_indicators: Any = curve.indicators()
    assert curve_indicators.opening[-1] == pytest.approx(end_indicators.opening, rel=1e-6)
    assert curve_indicators.friction_loss[-1] == pytest.approx(
        end_indicators.friction_loss, rel=1e-3
    )
    fc.save(curve, tmp_path / "curve.h5")
    loaded_curve: Any = fc.load(tmp_path / "curve.h5", structure, RUBBING_LAW)
    assert np.allclose(loaded_curve.points, curve.points, atol=1e-9)


@pytest.mark.parametrize("make_structure", RUBBING_STRUCTURES)
@pytest.mark.parametrize(
    ("layer", "factor"),
    [((0.15, 1.0 - 1e-9), 1.0), ((1e3, 0.3), 0.3), ((1e-9, 0.3), 1.0)],
    ids=["share to 1", "depth large", "depth to 0"],
)
def test_limits_with_friction(
    make_structure: Callable[[], fc.Structure], layer: tuple[float, float], factor: float
) -> None:
    """Those of the layered law, with the tangential stiffness in the same ratio."""
    structure = make_structure()
    laws = (
        replace(RUBBING_LAW, law=fc.LayeredPenalty(5.0, *layer)),
        replace(RUBBING_LAW, law=fc.UnilateralPenalty(5.0)).scaled(factor),
    )
    solutions = [fc.solve_harmonic_balance(structure, OMEGA, law, harmonics=12) for law in laws]
    for name in ("gap_coefficients", "tangential_force_coefficients"):
        assert relative(*(getattr(solution, name) for solution in solutions)) < 1e-7
    assert solutions[0].report.total == pytest.approx(solutions[1].report.total, rel=1e-4)
    assert solutions[0].face_indicators == pytest.approx(solutions[1].face_indicators, rel=1e-6)
    orbits = [solve_exactly(structure, law).orbit for law in laws]
    assert orbits[0].friction_number_by_name == pytest.approx(
        orbits[1].friction_number_by_name, rel=1e-6
    )
    assert abs(orbits[0].multipliers[0]) == pytest.approx(abs(orbits[1].multipliers[0]), rel=1e-6)


@pytest.mark.parametrize(
    ("integrate", "steps", "make_structure"),
    [
        (fc.integrate_events, 128, rubbing_chain_without_mass),
        (fc.integrate_exponential, 1024, rubbing_chain_without_mass),
        (fc.integrate_central_difference, 1024, rubbing_chain),
    ],
)
def test_motion_with_friction_settles_on_the_orbit(
    integrate: Any, steps: int, make_structure: Callable[[], fc.Structure], tmp_path: Path
) -> None:
    """From rest, and on from the positions of all sliders, also those of a file."""
    structure = make_structure()
    options = {"steps_per_period": steps, "progress": False}
    history = integrate(structure, OMEGA, RUBBING_LAW, periods=30, **options)
    orbit = solve_exactly(structure, RUBBING_LAW).orbit
    exact_motions = gaps_and_forces_of(orbit, history.time[-steps:])
    assert relative(history.gap[-steps:], exact_motions[0]) < 1e-3
    assert relative(history.tangential_force[-steps:], exact_motions[3]) < 3e-3
    assert abs(history.created_energy) < 1e-4 and history.final_state[2].shape == (4,)
    fc.save(history, tmp_path / "history.h5")
    loaded_history: Any = fc.load(tmp_path / "history.h5", structure)
    later_history = integrate(
        structure, OMEGA, RUBBING_LAW, periods=1, initial=loaded_history.final_state, **options
    )
    assert relative(later_history.gap, exact_motions[0]) < 1e-3


def test_friction_needs_a_tangential_stiffness() -> None:
    """Two rigid sliders in parallel would share the force in any ratio."""
    catch_error(lambda: fc.CoulombFriction(LAW, 0.3), "tangential stiffness")


# --- scenes ---------------------------------------------------------------------------------------

LAYER = {"contact.layer_depth": 2e-9, "contact.layer_share": 0.25}
FRICTION_KEYS = {"contact.friction": 0.3, "contact.tangential_stiffness_per_area": 4e12}
SCENE_KEYS = {
    "contact.law": "penalty",
    "contact.stiffness": None,
    "contact.stiffness_per_area": 5e12,
    "mesh.size": 0.03,
    "mesh.lip_elements": 3,
    "damping.ratio": 0.01,
    "damping.modes": "all",
    "mesh.error": False,
    "reduction.modes": 10,
    "harmonic_balance.tolerance": 0.2,
}


def small_scene(**changes: Any) -> fc.Scene:
    """The breathing plate with few pairs and a layer."""
    scene = fc.Scene.load(DEMOS / "breathing_plate.toml").replace(SCENE_KEYS)
    return scene.replace(LAYER | changes)


def test_a_scene_with_errors_and_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """solve states errors and a verdict; its file has the law; a prepared structure serves any
    layer."""
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(small_scene().as_toml())
    assert main(["reduce", "scene.toml", "--quiet"]) == 0
    assert main(["solve", "scene.toml", "--quiet"]) == 0
    assert "stable" in capsys.readouterr().out
    run: Any = fc.load_run("output/scene/solution.h5")
    assert run.contact.layer_depth == 2e-9 and run.contact.layer_share == 0.25
    forces = run.contact_force(run.instants())
    assert forces.shape[1] == run.structure.n_pairs and run.gap(run.instants()).max() > 2e-9
    errors = run.errors
    assert errors.stated("amplitude")[0] > 0.0
    assert "layer_depth" in errors.omitted_causes_and_reasons_text


def test_sweep_over_the_depth(tmp_path: Path) -> None:
    """Cases of a sweep are those solved alone; a deeper layer is softer."""
    depths = (1e-10, 2e-9, 1e-7)
    scene = small_scene(**{"sweep.over": {"contact.layer_depth": list(depths)}})
    sweep = fc.run_sweep(scene, tmp_path / "sweep.h5", progress=False)
    penetrations = np.asarray(sweep["penetration"])
    assert np.all(np.diff(penetrations) > 0.0) and set(sweep["verdict"]) == {"stable"}
    single_run = fc.solve(small_scene())
    assert penetrations[1] == pytest.approx(single_run.indicators().penetration, rel=1e-6)
    assert np.allclose(sweep.gap(1), single_run.gap_coefficients, rtol=1e-6, atol=1e-15)
    times = np.linspace(0.0, single_run.period, 20)
    case_solution = sweep.solution(1)
    assert np.allclose(
        case_solution.contact_force(times), single_run.contact_force(times), rtol=1e-6
    )


@pytest.mark.parametrize("friction_keys", [{}, FRICTION_KEYS])
def test_verify(friction_keys: dict[str, Any]) -> None:
    """The convergence study says the errors of the same numbers."""
    verification = fc.verify(small_scene(**friction_keys))
    assert verification.stated("amplitude")[0] > 0.0


def test_scenes_with_friction(tmp_path: Path) -> None:
    """A run has errors and a verdict, a sweep the same numbers, and the motion in time."""
    scene = small_scene(**FRICTION_KEYS)
    run = fc.solve(scene)
    assert run.result.stability.verdict == "stable" and run.contact.law.layer_depth == 2e-9
    assert run.errors.stated("friction_loss")[0] > 0.0
    sweep_scene = scene.replace({"sweep.over": {"contact.layer_depth": [1e-16, 2e-9]}})
    sweep = fc.run_sweep(sweep_scene, tmp_path / "sweep.h5", progress=False)
    losses = np.asarray(sweep["friction_loss"])
    assert losses[1] == pytest.approx(run.indicators().friction_loss, rel=1e-6)
    no_layer = {"contact.layer_depth": None, "contact.layer_share": None}
    assert losses[0] == pytest.approx(
        fc.solve(scene.replace(no_layer)).indicators().friction_loss, rel=1e-4
    )
    times = np.linspace(0.0, run.period, 20)
    case_solution = sweep.solution(1)
    assert np.allclose(
        case_solution.tangential_force(times), run.tangential_force(times), rtol=1e-6, atol=1e-6
    )
    history = fc.integrate(scene).result
    amplitude = history.amplitude(run.watched_dof)
    assert amplitude == pytest.approx(run.result.amplitude(run.watched_dof), rel=2e-3)


@pytest.mark.nightly
def test_solid_with_friction() -> None:
    """Along lines on a solid: a layer without depth is none, and a deep one rubs less."""
    contact_keys = {
        "contact.law": "penalty",
        "contact.stiffness_per_area": 1e14,
        "contact.tangential_stiffness_per_area": 5e13,
    }
    plain_scene = BLADE.replace(contact_keys)
    plain_run = fc.solve(plain_scene)
    depths = 1e-15, 0.3 * float(plain_run.indicators().penetration)
    no_layer_run, layered_run = (
        fc.solve(plain_scene.replace({"contact.layer_depth": depth, "contact.layer_share": 0.3}))
        for depth in depths
    )
    assert no_layer_run.result.contact.direction.shape == (plain_run.structure.n_pairs,)
    loss = plain_run.indicators().friction_loss
    assert no_layer_run.indicators().friction_loss == pytest.approx(loss, rel=1e-4)
    assert layered_run.indicators().friction_loss < 0.99 * loss
