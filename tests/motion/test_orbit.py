"""Periodic orbits of the exact flow, and the error predicted of a wave."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import ROOT, chain, oscillator, period_two_orbit, relative
from motion.reference import ReferenceFlow

import fenics_crack as fc
from fenics_crack import PeriodicOrbit
from fenics_crack.balance.orbits import FlowOrbits, orbit_next_to, predicted, wave_states
from fenics_crack.motion.flow import ContactFlow, flow_of
from fenics_crack.motion.orbit import Prediction, find_orbit
from fenics_crack.numerics.fourier import balanced, evaluate

RIGID = fc.UnilateralConstraint()


def next_to(solution: fc.PeriodicSolution) -> tuple[Prediction, PeriodicOrbit]:
    """What is predicted of a solution, and the orbit next to it."""
    assert solution.contact is not None
    flow = flow_of(solution.structure, solution.contact)
    assert flow is not None
    states = wave_states(flow, solution.displacement_coefficients, solution.base_omega)
    found = predicted(flow, solution.omega, states, solution.subharmonic)
    assert found is not None
    orbit = orbit_next_to(flow, solution.omega, states[0], solution.subharmonic)
    assert orbit is not None and orbit.residual < 1e-10
    return found, orbit


def distance(solution: fc.PeriodicSolution, orbit: PeriodicOrbit) -> float:
    """Of the gaps over the period, relative to that of B^T u."""
    time = np.arange(512) * solution.period / 512
    slow = evaluate(solution.slow_gap_coefficients, solution.base_omega, time)
    size = np.linalg.norm(slow + solution.structure.clearance)
    return float(np.linalg.norm(solution.gap(time) - orbit.gap_at(time)) / size)


def light_chain(seed: int) -> fc.Structure:
    """30 masses, 5 pairs without mass, 12 modes."""
    structure = chain("modal", 30, 5, seed).varied(load=0.5)
    return fc.reduce_structure(structure, modes=12, method="massless")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("light", [False, True])
def test_against_the_reference(seed: int, light: bool) -> None:
    """Gap and multipliers of the orbit by a flow that shares no code; the wave's error."""
    structure: fc.Structure = light_chain(seed) if light else chain(pairs=3, seed=seed)
    contact: object = RIGID if light else fc.UnilateralPenalty(20.0)
    solution = fc.solve_harmonic_balance(structure, 0.5, contact, harmonics=20)
    found, orbit = next_to(solution)
    reference = ReferenceFlow(orbit.flow, orbit.omega)
    instants = np.linspace(0.0, orbit.period, 100)
    end, states, tangent, events = reference.advance(orbit.state, orbit.period, instants)
    assert relative(end, orbit.state) < 1e-10
    count = orbit.flow.size // 2
    slow = orbit.samples(instants).states[:, :count] @ orbit.flow.modes.pairs
    assert np.abs(slow - states[:, :count] @ orbit.flow.modes.pairs).max() < 1e-11 * np.ptp(slow)
    largest = np.abs(np.linalg.eigvals(tangent)).max()
    assert abs(orbit.multipliers[0]) == pytest.approx(largest, rel=1e-9)
    assert orbit.events == events > 0
    assert 0.2 < distance(solution, orbit) / found.error < 2.0


def test_plate_of_a_wrong_verdict() -> None:
    """The plate that fixed steps take for stable. Another factor of its stiffness, as accurate,
    makes another structure of it by rounding: 1.4e-10 of the multiplier."""
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml").replace(
        {
            "crack.length": 0.03938896112631299,
            "mesh.lip_elements": 10,
            "damping.ratio": 0.0014945465368931062,
        }
    )
    structure = fc.reduce_structure(fc.build_structure(scene), modes=32, method="massless")
    solution = fc.solve_harmonic_balance(structure, 2479.0759527239284, RIGID, harmonics=20)
    found, orbit = next_to(solution)
    assert abs(orbit.multipliers[0]) == pytest.approx(1.0089331506, abs=1e-9)
    assert 0.3 < distance(solution, orbit) / found.error < 2.0


@pytest.mark.parametrize("omega", [1700.0, 2600.0, 5000.0])
def test_multipliers_of_the_paper_plate(paper_structure: fc.Structure, omega: float) -> None:
    """As shooting with an eigenbasis for each set has them."""
    structure = paper_structure.damped(fc.ModalDamping(0.01))
    contact = fc.UnilateralPenalty(1e9)
    solution = fc.solve_harmonic_balance(structure, omega, contact, harmonics=20)
    _, orbit = next_to(solution)
    other = fc.shoot(structure, solution)
    assert abs(orbit.multipliers[0]) == pytest.approx(abs(other.multipliers[0]), rel=1e-9)
    assert orbit.gap_at(np.arange(512) * orbit.period / 512) == pytest.approx(
        other.gap, abs=1e-9 * np.ptp(other.gap)
    )


def test_twice_the_period() -> None:
    """The bilinear oscillator's orbit of two periods of the load."""
    solution = period_two_orbit(40)
    _, orbit = next_to(solution)
    assert orbit.period == pytest.approx(solution.period)
    assert distance(solution, orbit) < 1e-4
    once, later = orbit.gap_at(np.array([0.3, 0.3 + 0.5 * orbit.period]))
    assert abs(once[0] - later[0]) > 0.1
    assert orbit.gap_at(np.array([0.3 + orbit.period]))[0] == pytest.approx(once)


@pytest.mark.parametrize("seed", range(3))
def test_by_products_as_by_factors(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same orbit and the same prediction where M is not formed; its products are M's."""
    solution = fc.solve_harmonic_balance(light_chain(seed), 0.5, RIGID, harmonics=10)
    expected, orbit = next_to(solution)
    change = np.random.default_rng(seed).normal(size=orbit.flow.size)
    assert relative(orbit.motion.track @ change, orbit.monodromy @ change) < 1e-12
    monkeypatch.setattr("fenics_crack.motion.orbit.FORMED", 0)
    found = predicted(orbit.flow, orbit.omega, solution.judged.states)
    again = find_orbit(orbit.flow, orbit.omega, solution.judged.states[0])
    assert found is not None and found.error == pytest.approx(expected.error, rel=0.05)
    assert relative(found.monodromy, expected.monodromy) < 1e-10
    assert again is not None and relative(again.state, orbit.state) < 1e-7


def test_by_omega() -> None:
    """The orbit moves with the frequency as its derivative says."""
    flow, omega, step = flow_of(light_chain(1), RIGID), 0.5, 1e-5
    assert flow is not None
    orbits = [find_orbit(flow, omega + h, np.zeros(flow.size)) for h in (0.0, step, -step)]
    here, after, before = (one for one in orbits if one is not None)
    system = FlowOrbits(flow, omega, here.state)
    at = system.linearise(system.start, 1.0)
    slope = -at.solve(at.by_parameter) / (system.scale * omega)
    assert relative(slope, (after.state - before.state) / (2.0 * step)) < 1e-5


@pytest.mark.parametrize("light", [False, True])
def test_coefficients(light: bool) -> None:
    """Gauss's rule between events against very many samples; without contact they are exact."""
    structure: fc.Structure = light_chain(2) if light else chain(pairs=3, seed=2)
    flow = flow_of(structure, RIGID if light else fc.UnilateralPenalty(20.0))
    assert flow is not None
    settled = flow.advance(np.zeros(flow.size), 0.6, 30 * 2.0 * np.pi / 0.6).state
    orbit = find_orbit(flow, 0.6, settled)
    assert orbit is not None and orbit.events > 0
    found, time = orbit.coefficients(6), np.arange(2**15) * orbit.period / 2**15
    assert relative(found.gap, balanced(orbit.gap_at(time), 6)) < 1e-6
    assert relative(found.force, balanced(orbit.force_at(time), 6)) < 1e-6
    assert relative(found.displacement, balanced(orbit.displacement_at(time), 6)) < 1e-6
    many = orbit.coefficients(400)
    assert relative(found.displacement, many.displacement[:13]) < 1e-12
    assert relative(orbit.gap_at(time[::64]), evaluate(many.gap, 0.6, time[::64])) < 1e-3


def test_open_crack() -> None:
    """Without contact the orbit is the linear response, whatever the start."""
    structure = oscillator(clearance=100.0)
    flow: ContactFlow | None = flow_of(structure, fc.UnilateralPenalty(1.0))
    assert flow is not None
    orbit = find_orbit(flow, 2.0, np.array([3.0, -1.0]))
    assert orbit is not None and orbit.events == 0
    linear = fc.solve_linear(structure, 2.0)
    expected = np.vstack([linear.displacement_coefficients, np.zeros((0, 1))])
    assert orbit.coefficients(5).displacement == pytest.approx(expected, abs=1e-11)
    decay = np.exp(-0.05 * orbit.period)
    assert np.abs(orbit.multipliers) == pytest.approx([decay, decay])


def test_no_orbit_is_cheap() -> None:
    """An undamped resonance has none: given up after few periods."""
    flow = flow_of(oscillator(None, clearance=1e6), fc.UnilateralPenalty(1.0))
    assert flow is not None
    assert find_orbit(flow, 1.0, np.zeros(2)) is None
