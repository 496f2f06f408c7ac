"""The layered law: two rows for each pair inside, the pair itself in every number outside."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, chain, oscillator, relative

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
    """With given harmonics, exact or sampled integrals or the block form give the same solution,
    and its distance to the orbit is the error that the report states."""
    structure = make_structure()
    solutions = [
        fc.solve_harmonic_balance(structure, OMEGA, LAW, harmonics=12, **options)  # type: ignore[arg-type]
        for options in ({}, {"samples": 8192}, {"form": "block"})
    ]
    orbit = solve_exactly(structure, LAW).orbit
    times = np.linspace(0.0, orbit.period, 200, endpoint=False)
    for solution in solutions:
        assert relative(solution.gap(times), solutions[0].gap(times)) < 1e-6
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


def test_friction_is_refused() -> None:
    """The normal force of a pair is a sum of two rows, which friction does not know."""
    catch_error(lambda: fc.CoulombFriction(LAW, 0.3), "law")


# --- scenes ---------------------------------------------------------------------------------------

LAYER = {"contact.layer_depth": 2e-9, "contact.layer_share": 0.25}
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


def test_verify() -> None:
    """The convergence study says the errors of the same numbers."""
    verification = fc.verify(small_scene())
    assert verification.stated("amplitude")[0] > 0.0
