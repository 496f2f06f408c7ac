"""The campaign's own judge against what is known without it."""

import numpy as np
import pytest
import scipy.integrate
from helpers import DEMOS, OMEGA_0, catch_error, chain, oscillator, relative
from reference_flow import NoOrbit, ReferenceFlow, predicted

import fenics_crack as fc

PLATE = DEMOS.with_name("benchmarks") / "plate.toml"


@pytest.fixture(scope="module")
def plate() -> fc.Study:
    """That of `new` with a longer crack, 20 pairs and 0.15 %."""
    return fc.prepare(
        fc.Scene.load(PLATE).replace(
            {
                "crack.length": 0.03938896112631299,
                "mesh.lip_elements": 10,
                "damping.ratio": 0.0014945465368931062,
                "reduction.modes": 32,
                "excitation.omega": 2479.0759527239284,
                "excitation.frequency": None,
            }
        )
    )


@pytest.mark.drawn(3)
@pytest.mark.parametrize("damping", ["modal", "rayleigh", "matrix", "few modes", "none"])
def test_motion_is_that_of_a_general_integrator(damping: str) -> None:
    """Three pairs of a random chain with mass: all dampings, a mean load, preload and clearance."""
    structure, law, omega = chain(damping), fc.UnilateralPenalty([3.0, 10.0, 30.0]), 1.3
    mass, stiffness = (np.array(m[:, :]) for m in (structure.mass, structure.stiffness))
    flow, gap = ReferenceFlow(structure, law), structure.gap.toarray()
    system = flow.system
    shapes = np.linalg.inv(system.rows)
    assert np.abs(shapes.T @ stiffness @ shapes - np.diag(system.squares)).max() < 1e-12

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        u, v = np.split(state, 2)
        contact = np.maximum(law.stiffness * (gap.T @ u - structure.clearance), 0.0)
        wave = np.array([1.0, np.cos(omega * time), np.sin(omega * time)])
        damping_force = system.rows.T @ (system.damping @ (system.rows @ v))
        force = wave @ structure.force - gap @ contact - stiffness @ u - damping_force
        return np.concatenate([v, np.linalg.solve(mass, force)])

    rest = np.zeros(2 * structure.n_dofs)
    integration = scipy.integrate.solve_ivp(
        rate, (0.0, 6.0), rest, "DOP853", rtol=1e-11, atol=1e-12
    )
    u, v = np.split(integration.y[:, -1], 2)
    passage = flow.advance(rest, omega, 0.0, 6.0)
    assert len(passage.pieces) > 2
    assert relative(passage.state, flow.state(u, v)) < 1e-8


@pytest.mark.nightly
def test_energy_of_free_motion_is_kept(plate: fc.Study) -> None:
    """Rigid lips without mass, no load and no damping: 1/2 q'^2 + 1/2 q Lambda q + 1/2 s lambda
    over a period, to 1e-11."""
    free_structure = plate.structure.varied(load=0.0, damping=0.0)
    flow = ReferenceFlow(free_structure, plate.contact)
    state = np.zeros(2 * len(flow.system.squares))
    state[:4] = np.random.default_rng(3).normal(size=4)

    def energy(state: np.ndarray) -> float:
        q, v = np.split(state, 2)
        slow = q / flow.scale @ flow.system.pairs
        is_closed = flow.contact(slow)
        elastic_energy = flow.system.squares @ (q / flow.scale) ** 2
        return float(v @ v + elastic_energy + slow @ flow.closed_set(is_closed).forces @ slow)

    period = 2.0 * np.pi / np.sqrt(flow.system.squares[0])
    passage = flow.advance(state, 1.0, 0.0, period)
    assert len(passage.pieces) > 60
    assert energy(passage.state) == pytest.approx(energy(state), rel=1e-11)


def test_tangent_is_that_of_the_motion(plate: fc.Study) -> None:
    """Against central differences, over a third of a period with many events."""
    flow, omega = ReferenceFlow(plate.structure, plate.contact), plate.scene.excitation.omega
    linear = fc.solve_linear(plate.structure, omega)
    state, length = flow.states_of(linear, np.zeros(1))[0], 2.0 * np.pi / omega / 3.0
    size = np.linalg.norm(state)
    towards = np.random.default_rng(1).normal(size=len(state))
    ends = [
        flow.advance(state + sign * 1e-7 * size * towards, omega, 0.0, length).state
        for sign in (1.0, -1.0)
    ]
    passage = flow.advance(state, omega, 0.0, length)
    assert len(passage.pieces) > 20
    difference = (ends[0] - ends[1]) / (2e-7 * size)
    assert relative(passage.tangent() @ towards, difference) < 1e-5


@pytest.mark.nightly
def test_plate_that_only_looked_stable(plate: fc.Study) -> None:
    """The gap does not enter, complementarity holds, and the multiplier is 1.0089331506."""
    omega = plate.scene.excitation.omega
    solution = fc.solve_harmonic_balance(plate.structure, omega, plate.contact, harmonics=20)
    flow = ReferenceFlow(plate.structure, plate.contact)
    orbit = flow.orbit(flow.states_of(solution, np.zeros(1))[0], omega, solution.period)
    assert abs(orbit.multipliers[0]) == pytest.approx(1.0089331506, rel=1e-9)
    assert orbit.gap.max() < 1e-13 * np.abs(orbit.gap).max()
    times = np.arange(512) * solution.period / 512
    off = relative(solution.gap(times), orbit.gap)
    assert off < 3.0 * predicted(flow, solution)


def test_one_mass() -> None:
    """Undamped and at its bilinear frequency the free motion returns after 2 pi / OMEGA_0; rigid
    contact of a pair with mass has no such flow."""
    flow = ReferenceFlow(oscillator(damping=None, force=0.0), fc.UnilateralPenalty(1.0))
    state = np.array([1.0, 0.0])
    passage = flow.advance(state, 1.0, 0.0, 2.0 * np.pi / OMEGA_0)
    assert relative(passage.state, state) < 1e-12 and len(passage.pieces) == 3
    catch_error(lambda: ReferenceFlow(oscillator(), fc.UnilateralConstraint()), kind=NoOrbit)
