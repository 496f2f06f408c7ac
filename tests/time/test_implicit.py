"""Generalised-alpha integration, contact without penetration in time, and a step's contact."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import (
    DAMPINGS,
    chain,
    chain_stiffness,
    dense_matrices,
    heavy_mass,
    log_slope,
    oscillator,
    relative,
    sampled_harmonics,
)
from mpi4py import MPI

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)
RIGID = fc.UnilateralConstraint()
SCHEMES = (fc.integrate_central_difference, fc.integrate_implicit)
both_schemes = pytest.mark.parametrize("scheme", SCHEMES, ids=["central", "implicit"])
radii = pytest.mark.parametrize("radius", [1.0, 0.8, 0.0])


# --- order and accuracy ---------------------------------------------------------------------------


@radii
def test_second_order_on_a_linear_oscillator(radius: float) -> None:
    """Forced and damped, contact out of reach: the closed form."""
    structure = oscillator(damping=0.1, clearance=1e3)
    omega = 0.8
    response = 1.0 / (1.0 - omega**2 + 0.1j * omega)
    initial = (np.full(1, response.real), np.full(1, -omega * response.imag))
    counts, errors = (64, 128, 256, 512), []
    for steps in counts:
        history = fc.integrate_implicit(
            structure, omega, fc.UnilateralPenalty(1.0), periods=3, steps_per_period=steps,
            spectral_radius=radius, initial=initial,
        )  # fmt: skip
        exact = (response * np.exp(1j * omega * history.time)).real
        errors.append(relative(history.displacement([0])[:, 0], exact))
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)


@pytest.mark.parametrize("damping", DAMPINGS)
def test_second_order_with_contact_that_begins_within_steps(damping: str) -> None:
    """A chain with three pairs against the exact flow, every kind of damping."""
    structure, law = chain(damping), fc.UnilateralPenalty(4.0)
    exact = fc.integrate_events(structure, 0.8, law, periods=2, steps_per_period=64)
    counts = (64, 128, 256)
    for radius in (1.0, 0.8):
        errors = []
        for steps in counts:
            history = fc.integrate_implicit(
                structure, 0.8, law, periods=2, steps_per_period=steps, spectral_radius=radius
            )
            errors.append(relative(history.gap[:: steps // 64], exact.gap))
        assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)
        assert errors[-1] < 1.6e-2


@pytest.mark.verification
def test_contact_release() -> None:
    """Contact time, peak force and impulse against the closed form, to 1e-3."""
    history = fc.integrate_implicit(
        heavy_mass(), 2.0 * np.pi / 0.04, fc.UnilateralPenalty(1e6), periods=1,
        steps_per_period=4000, initial=(np.zeros(1), np.ones(1)),
    )  # fmt: skip
    force, step = history.contact_force[:, 0], history.time[1]
    assert np.allclose(force, 1e6 * np.maximum(history.gap[:, 0], 0.0), rtol=1e-12)
    assert np.count_nonzero(force) * step == pytest.approx(0.0312600, rel=1e-3)
    assert force.max() == pytest.approx(9950.372, rel=1e-6)
    assert force.sum() * step == pytest.approx(198.0198, rel=1e-6)


@pytest.mark.verification
def test_paper_plate_with_soft_contact(soft_plate: fc.Structure) -> None:
    """k = 1e9, xi = 0.01: settles from rest on the exact values with 256 steps a period."""
    history = fc.integrate_implicit(
        soft_plate, 2000.0, LAW, periods=200, steps_per_period=256, settle=1e-4, record_periods=1,
    )  # fmt: skip
    assert history.settled < 1e-4 and history.periods < 200
    mean, waves = sampled_harmonics(history.gap[:, 0])
    assert mean == pytest.approx(-4.317675e-7, rel=0.01)
    assert waves[0] == pytest.approx(7.418206e-7, rel=2e-3)
    assert -history.gap.min() == pytest.approx(1.451955e-6, rel=0.01)


def test_smoothed_law_is_that_of_central_differences(soft_plate: fc.Structure) -> None:
    """A law whose force is not linear in contact, with its kink rounded at 1e-8 m."""
    law = fc.SmoothedPenalty(1e9, 1e8)
    options = {"periods": 3, "record_periods": 1, "initial": None}
    errors = []
    for steps in (256, 512):
        one, two = (
            scheme(soft_plate, 2000.0, law, steps_per_period=steps, **options)  # type: ignore[operator]
            for scheme in SCHEMES
        )
        errors.append(relative(two.gap, one.gap))
        assert np.array_equal(two.contact_force, law.force(two.gap))
    assert errors[-1] < 0.03 and log_slope([256, 512], errors) < -1.5


# --- stability and energy -------------------------------------------------------------------------


@pytest.mark.drawn(4)
@radii
@pytest.mark.parametrize(
    "law",
    [fc.UnilateralPenalty(1e11), fc.SmoothedPenalty(1e11, 1e11), RIGID],
    ids=["penalty", "smoothed", "constraint"],
)
def test_long_steps_are_stable(paper_structure: fc.Structure, law: Any, radius: float) -> None:
    """The paper's own data, steps 50 times longer than explicit ones may be, 30 periods."""
    least = fc.stable_steps_per_period(paper_structure, 2000.0, law)
    history = fc.integrate_implicit(
        paper_structure, 2000.0, law, periods=30, steps_per_period=least // 50,
        spectral_radius=radius,
    )  # fmt: skip
    assert np.abs(history.gap).max() < 1e-5
    assert history.created_energy < 1e-6


@pytest.mark.parametrize("damping", ["none", "matrix"])
@pytest.mark.parametrize(
    "law", [fc.UnilateralPenalty(4.0), fc.SmoothedPenalty(4.0, 10.0)], ids=["penalty", "smoothed"]
)
def test_energy_balance_is_exact_without_numerical_damping(damping: str, law: Any) -> None:
    """rho = 1: what is put in is kept or lost in C, contact that begins and ends included."""
    history = fc.integrate_implicit(
        chain(damping), 0.8, law, periods=20, steps_per_period=40, spectral_radius=1.0
    )
    assert np.any(history.gap > 0.0) and np.any(history.gap < 0.0)
    # The smoothed law's potential is integrated by Gauss's rule.
    allowed = 1e-12 if isinstance(law, fc.UnilateralPenalty) else 1e-6
    assert abs(history.created_energy) < allowed


def test_free_vibration_keeps_its_energy() -> None:
    """rho = 1, no load, no damping, no contact: to rounding, after 2000 steps."""
    structure = oscillator(damping=None, force=0.0, clearance=1e3)
    history = fc.integrate_implicit(
        structure, 1.0, fc.UnilateralPenalty(1.0), periods=100, steps_per_period=20,
        spectral_radius=1.0, initial=(np.ones(1), np.zeros(1)),
    )  # fmt: skip
    displacement, velocity = history.final_state
    assert displacement[0] ** 2 + velocity[0] ** 2 == pytest.approx(1.0, rel=1e-12)
    assert abs(history.created_energy) < 1e-12
    assert np.abs(history.gap + 1e3).max() < 1.0 + 1e-12


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8])
def test_fast_vibrations_die_by_the_spectral_radius(radius: float) -> None:
    """A million times faster than the steps: rho = 0 wipes them out, else rho^n (double root)."""
    structure = oscillator(damping=None, force=0.0, clearance=1e3)
    history = fc.integrate_implicit(
        structure, 1e-6, fc.UnilateralPenalty(1.0), periods=1, steps_per_period=60,
        spectral_radius=radius, initial=(np.ones(1), np.zeros(1)),
    )  # fmt: skip
    size = np.abs(history.displacement([0])[:, 0])
    if radius == 0.0:
        assert size[5:].max() < 1e-6
    else:
        # |u| ~ (a + b n) rho^n
        rate = (size[50] / size[40]) ** 0.1
        assert radius * 0.98 < rate < radius * 1.05
    assert history.created_energy == pytest.approx(-1.0, abs=0.02)


def test_lost_energy_vanishes_like_the_step_squared() -> None:
    """rho = 0.8: the balance closes with the order of the scheme or better, and never creates."""
    counts, lost = (64, 128, 256, 512), []
    for steps in counts:
        history = fc.integrate_implicit(
            chain("matrix"), 0.8, fc.UnilateralPenalty(4.0), periods=2, steps_per_period=steps
        )
        lost.append(-history.created_energy)
    assert min(lost) > 0.0 and log_slope(counts, lost) < -1.9


@both_schemes
@pytest.mark.parametrize("damping", ["none", "modal", "matrix"])
def test_energy_balance_closes_to_second_order(
    scheme: Callable[..., fc.TimeHistory], damping: str
) -> None:
    """Energy of masses, springs and contact less work and losses, from the motion alone."""
    structure, law, omega = chain(damping), fc.UnilateralPenalty(4.0), 0.8
    mass, dashpots, stiffness = dense_matrices(structure)
    counts, errors = (128, 256, 512), []
    for steps in counts:
        history = scheme(structure, omega, law, periods=2, steps_per_period=steps)
        u, time, step = history.displacement(range(structure.n_dofs)), history.time, history.time[1]
        v, u, time, gap = (u[2:] - u[:-2]) / (2.0 * step), u[1:-1], time[1:-1], history.gap[1:-1]
        waves = np.column_stack([np.ones_like(time), np.cos(omega * time), np.sin(omega * time)])
        power = np.sum(v * (waves @ structure.force - v @ dashpots), axis=1)
        energy = 0.5 * np.sum(u * (u @ stiffness) + v * (v @ mass), axis=1)
        energy += 2.0 * np.sum(np.maximum(gap, 0.0) ** 2, axis=1)
        work = np.concatenate([[0.0], np.cumsum(0.5 * step * (power[1:] + power[:-1]))])
        errors.append(np.abs(energy - energy[0] - work).max() / energy.max())
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)
    assert errors[-1] < 1.6e-4  # 4e-5 with twice the steps, by the slope


# --- without penetration --------------------------------------------------------------------------


@both_schemes
def test_impulse_of_a_rigid_stop(scheme: Callable[..., fc.TimeHistory]) -> None:
    """The mass stops dead: impulse m v, v the speed at the stop, and all its energy lost."""
    distance = 0.001234
    speed = np.sqrt(1.0 - 100.0 * distance**2)
    errors = []
    for steps in (100, 1000):
        history = scheme(
            heavy_mass(), 2.0 * np.pi / 0.04, RIGID, periods=1, steps_per_period=steps,
            initial=(np.full(1, -distance), np.array([speed])),
        )  # fmt: skip
        impulse = history.contact_force.sum() * history.time[1]
        errors.append(abs(impulse / 100.0 - 1.0))
        assert history.gap.max() <= 1e-18
        # The implicit impulse differs from that of M by what a step does not resolve.
        assert np.abs(history.gap[-steps // 2 :]).max() < 1e-7
        assert np.abs(history.final_state[1]).max() < 1e-4
    assert errors[0] < 1e-3 and errors[1] < 1e-5
    assert history.created_energy == pytest.approx(-1.0, abs=1e-6)


@both_schemes
@pytest.mark.parametrize("damping", DAMPINGS)
def test_no_penetration_and_no_pull(scheme: Callable[..., fc.TimeHistory], damping: str) -> None:
    """At every instant, from a start that penetrates; a force leads to a gap that is closed."""
    structure = chain(damping)
    history = scheme(structure, 0.8, RIGID, periods=5, steps_per_period=200)
    size = np.abs(history.gap).max()
    gap, force = history.gap, history.contact_force
    assert gap.max() < 1e-13 * size and force.min() >= 0.0
    assert np.any(force > 0.0) and np.any(gap < -0.1 * size)
    assert np.abs(gap[1:][force[:-1] > 0.0]).max() < 1e-13 * size
    displacement = history.displacement(range(structure.n_dofs))
    assert np.allclose(
        structure.apply_bt(displacement) - structure.clearance, gap, atol=1e-13 * size
    )


@pytest.mark.parametrize("damping", ["none", "modal", "matrix"])
def test_order_without_penetration(damping: str) -> None:
    """Impacts and lasting contact, against fine central differences: about second order."""
    structure, counts, errors = chain(damping), (64, 128, 256, 512), []
    fine = fc.integrate_central_difference(
        structure, 0.8, RIGID, periods=1, steps_per_period=8192
    ).gap
    for steps in counts:
        history = fc.integrate_implicit(structure, 0.8, RIGID, periods=1, steps_per_period=steps)
        errors.append(relative(history.gap, fine[:: 8192 // steps]))
    assert log_slope(counts, errors) < -1.8 and errors[-1] < 5e-4


@pytest.mark.parametrize(("scheme", "start"), [(SCHEMES[0], None), (SCHEMES[1], 5)])
def test_paper_plate_without_penetration(
    scheme: Callable[..., fc.TimeHistory], start: int | None, soft_plate: fc.Structure
) -> None:
    """Settles, from rest or from few harmonics, on the harmonic balance of the same constraint; the
    mean force is its."""
    solution = fc.solve_harmonic_balance(soft_plate, 2000.0, RIGID, harmonics=40)
    few = start and fc.solve_harmonic_balance(soft_plate, 2000.0, RIGID, harmonics=start)
    history = scheme(
        soft_plate, 2000.0, RIGID, periods=200, steps_per_period=512, settle=1e-4,
        record_periods=1, initial=few,
    )  # fmt: skip
    assert history.settled < 1e-4 and history.periods > 5
    assert relative(history.gap, solution.gap(history.time)) < 5e-3
    force = solution.contact_force(history.time).mean()
    assert history.contact_force.mean() == pytest.approx(force, rel=1e-3)
    assert -0.03 < history.created_energy < 0.0  # lost in impacts


@both_schemes
def test_limit_of_stiff_penalty_in_lasting_contact(scheme: Callable[..., fc.TimeHistory]) -> None:
    """Two masses, the first pressed on a stop: the motion without penetration, like 1/k."""
    stiffness = chain_stiffness(np.array([1.0, 1.0, 1.0]))
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, [1.0, 0.0], force_mean=[3.0, 0.0], force_sin=[0.0, 0.5],
        damping=0.2 * stiffness,
    )  # fmt: skip
    steps, stiffnesses = 250, (1e2, 3e2, 1e3)
    rigid = scheme(structure, 0.6, RIGID, periods=4, steps_per_period=steps)
    assert np.abs(rigid.gap).max() < 1e-12
    errors, forces = [], []
    for k in stiffnesses:
        soft = scheme(structure, 0.6, fc.UnilateralPenalty(k), periods=4, steps_per_period=steps)
        last = slice(3 * steps, None)
        errors.append(relative(soft.displacement([1])[last], rigid.displacement([1])[last]))
        forces.append(relative(soft.contact_force[last], rigid.contact_force[last]))
    assert log_slope(stiffnesses, errors) == pytest.approx(-1.0, abs=0.1)
    assert errors[-1] < 1e-2 and forces[-1] < 2e-2


# --- reduced structures, runs that go on, ranks, arguments ----------------------------------------


@pytest.mark.parametrize("law", [LAW, RIGID], ids=["penalty", "constraint"])
@pytest.mark.parametrize("method", ["free_interface", "craig_bampton"])
def test_reduced_structure(wide_plate: fc.Structure, method: str, law: Any) -> None:
    """Few coordinates move as the whole plate, and speak of its dofs."""
    reduced = fc.reduce_structure(wide_plate, modes=60, method=method)
    corner = wide_plate.find_dof((0.1, 0.1), "x")
    whole, small = (
        fc.integrate_implicit(
            structure, 2000.0, law, periods=2, steps_per_period=128, dofs=[corner]
        )
        for structure in (wide_plate, reduced)
    )
    assert relative(small.displacement([corner]), whole.displacement([corner])) < 4e-3
    assert relative(small.gap, whole.gap) < 8e-3


@pytest.mark.parametrize("law", [fc.UnilateralPenalty(4.0), RIGID], ids=["penalty", "constraint"])
def test_a_run_goes_on_from_another(law: Any) -> None:
    """Two periods and two more are four, to the scheme's order."""
    structure, errors, counts = chain("modal"), [], (50, 100, 200)
    for steps in counts:
        options = {"steps_per_period": steps, "record_periods": 1}
        whole = fc.integrate_implicit(structure, 0.8, law, periods=4, **options)  # type: ignore[arg-type]
        first = fc.integrate_implicit(structure, 0.8, law, periods=2, **options)  # type: ignore[arg-type]
        second = fc.integrate_implicit(
            structure,
            0.8,
            law,
            periods=2,
            initial=first.final_state,
            **options,  # type: ignore[arg-type]
        )
        errors.append(relative(second.gap, whole.gap))
    order = 1.8 if law is not RIGID else 0.8
    assert errors[-1] < 1e-2 and log_slope(counts, errors) < -order


def test_no_pairs() -> None:
    """A structure without pairs moves as one whose pairs are out of reach."""
    whole = oscillator(clearance=1e3)
    bare = fc.Structure.from_matrices(
        np.ones((1, 1)), np.ones((1, 1)), None, force_cos=[1.0], damping=0.1 * np.ones((1, 1))
    )
    for law in (fc.UnilateralPenalty(1.0), RIGID):
        one, two = (
            fc.integrate_implicit(structure, 0.7, law, periods=2, steps_per_period=50)
            for structure in (bare, whole)
        )
        assert np.array_equal(one.displacement([0]), two.displacement([0]))
        assert one.gap.shape == one.contact_force.shape == (100, 0)


def motion(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Gaps with both laws, and without penetration by central differences (collective)."""
    plate = fc.build_structure(scene, comm)
    histories = [
        fc.integrate_implicit(plate, 2000.0, LAW, periods=1, steps_per_period=60),
        fc.integrate_implicit(plate, 2000.0, RIGID, periods=1, steps_per_period=60),
        fc.integrate_central_difference(plate, 2000.0, RIGID, periods=1, steps_per_period=240),
    ]
    return np.vstack([history.gap for history in histories])


@pytest.mark.mpi
def test_same_motion_on_one_and_two_ranks(
    paper_scene: fc.Scene, on_ranks: Callable[..., Any]
) -> None:
    """A mesh shared by two ranks marches as on one."""
    scene = paper_scene.replace({"damping.ratio": 0.01})
    assert relative(on_ranks(motion, scene), motion(scene, MPI.COMM_SELF)) < 1e-7


@pytest.mark.parametrize("radius", [-0.1, 1.1, np.nan, "none"])
def test_a_spectral_radius_beyond_0_to_1_is_refused(soft_plate: fc.Structure, radius: Any) -> None:
    """One error that names it; what all schemes refuse is in test_march.py."""
    with pytest.raises(fc.InputError, match=r"^spectral_radius"):
        fc.integrate_implicit(
            soft_plate, 2000.0, LAW, periods=1, steps_per_period=64, spectral_radius=radius
        )
