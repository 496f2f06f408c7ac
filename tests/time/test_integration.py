"""Central differences."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import (
    DAMPINGS,
    Cubic,
    catch_error,
    chain,
    chain_stiffness,
    dense_matrices,
    heavy_mass,
    log_slope,
    random_stiffness,
    relative,
)
from mpi4py import MPI
from scipy.linalg import expm

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)
RIGID = fc.UnilateralConstraint()


def release(steps: int) -> fc.TimeHistory:
    """Mass 100, stiffness 1e4, moving into a stop of 1e6 at speed 1."""
    return fc.integrate_central_difference(
        heavy_mass(),
        2.0 * np.pi / 0.04,
        fc.UnilateralPenalty(1e6),
        periods=1,
        steps_per_period=steps,
        initial=(np.zeros(1), np.ones(1)),
    )


@pytest.mark.verification
def test_contact_release() -> None:
    """Contact time, peak force and impulse against the closed form, to 1e-3."""
    history = release(8000)
    force = 1e6 * np.maximum(history.gap[:, 0], 0.0)
    step = history.time[1] - history.time[0]
    frequency = np.sqrt(1.01e6 / 100.0)
    assert np.count_nonzero(force) * step == pytest.approx(np.pi / frequency, rel=1e-3)
    assert np.pi / frequency == pytest.approx(0.0312600, rel=1e-6)
    assert force.max() == pytest.approx(9950.372, rel=1e-3)
    assert force.sum() * step == pytest.approx(198.0198, rel=1e-3)


def test_second_order_on_a_smooth_motion(paper_structure: fc.Structure) -> None:
    """A linear motion with modal damping against the frequency response: slope 2."""
    law = fc.UnilateralPenalty(1e-3)  # as good as no contact
    orbit = fc.solve_linear(paper_structure, 2000.0)
    dof = paper_structure.find_dof((0.1, 0.1), "x")
    counts, errors = (320, 640, 1280), []
    for steps in counts:
        history = fc.integrate_central_difference(
            paper_structure, 2000.0, law, periods=2, steps_per_period=steps, initial=orbit
        )
        exact = orbit.displacement(history.time, [dof])
        errors.append(relative(history.displacement([dof]), exact))
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.15)
    assert errors[-1] < 1e-4


@pytest.mark.parametrize("damping", ["none", "modal", "few modes", "rayleigh", "matrix"])
def test_damping_forms_against_matrix_exponential(damping: str) -> None:
    """Free vibration of a small system, every way of damping, against SciPy's expm."""
    rng = np.random.default_rng(4)
    n = 5
    mass = np.diag(rng.uniform(1.0, 2.0, n))
    stiffness = random_stiffness(rng, n)
    damping_form = {
        "modal": fc.ModalDamping(0.05),
        "few modes": fc.ModalDamping(0.05, 2),
        "rayleigh": fc.RayleighDamping(0.3, 0.02),
        "matrix": 0.3 * mass + 0.02 * stiffness,
    }.get(damping)
    structure = fc.Structure.from_matrices(  # its pair never closes
        mass, stiffness, gap=np.eye(n, 1), damping=damping_form, clearance=1e3
    )
    damping_matrix = dense_matrices(structure)[1]
    start = rng.normal(size=(2, n))
    period, steps = 5.0, 4000
    history = fc.integrate_central_difference(
        structure,
        2.0 * np.pi / period,
        fc.UnilateralPenalty(1.0),
        periods=1,
        steps_per_period=steps,
        initial=(start[0], start[1]),
    )
    inverse = np.linalg.inv(mass)
    flow = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping_matrix]]
    )
    last_step = steps - 1
    exact = (expm(flow * history.time[last_step]) @ start.ravel())[:n]
    displacement = history.displacement(range(n))[last_step]
    assert np.linalg.norm(displacement - exact) < 1e-4 * np.linalg.norm(start[0])


def test_step_beyond_the_stable_one_is_refused(soft_plate: fc.Structure) -> None:
    """dt <= 2 / omega_max with the pairs closed; the error names the least number of steps."""
    highest_omega = fc.solve_modes(soft_plate.tied(1e9), soft_plate.n_dofs).omega[-1]
    min_steps = fc.stable_steps_per_period(soft_plate, 2000.0, LAW)
    assert (
        (2.0 * np.pi / 2000.0) / min_steps
        < 2.0 / highest_omega
        < (2.0 * np.pi / 2000.0) / (min_steps - 1)
    )
    catch_error(
        lambda: fc.integrate_central_difference(
            soft_plate, 2000.0, LAW, periods=1, steps_per_period=min_steps - 1
        ),
        "steps_per_period",
        min_steps - 1,
        names=f">= {min_steps},",
    )


def test_stable_limit_is_sharp_without_contact_events() -> None:
    """A tied pair just inside the limit stays bounded; the bound of the step is not slack."""
    structure = fc.Structure.from_matrices(
        np.eye(1), np.eye(1), gap=np.ones(1), clearance=-1e3, force_sin=np.ones(1)
    )
    law = fc.UnilateralPenalty(99.0)  # always closed: frequency 10
    min_steps = fc.stable_steps_per_period(structure, 1.0, law)
    assert min_steps == 32  # 10 pi = 31.4
    rest = -990.0  # x + 99 (x + 1000) = 0
    history = fc.integrate_central_difference(
        structure,
        1.0,
        law,
        periods=50,
        steps_per_period=min_steps,
        initial=(np.full(1, rest + 1.0), np.zeros(1)),
    )
    assert np.abs(history.displacement([0]) - rest).max() < 2.0


def test_contact_that_creates_energy_is_an_error(paper_structure: fc.Structure) -> None:
    """Close to the stable limit stiff contact feeds the motion: an error, not a wave of 1e107 m."""
    law = fc.UnilateralPenalty(1e11)
    min_steps = fc.stable_steps_per_period(paper_structure, 2000.0, law)
    catch_error(
        lambda: fc.integrate_central_difference(
            paper_structure, 2000.0, law, periods=400, steps_per_period=min_steps + 40, dofs=[]
        ),
        names="energy",
        kind=fc.ConvergenceError,
    )


def test_created_energy_is_of_second_order() -> None:
    """Like dt^2, in the mean over steps that meet the contact at other phases."""
    chain_structure, law = chain("none"), fc.UnilateralPenalty(4.0)
    counts: list[int] = [200, 400, 800, 1600, 3200]
    created_energies = []
    for steps in counts:
        step_counts = range(steps, steps + 56, 7)
        histories = [
            [release(count) for count in step_counts],
            [
                fc.integrate_central_difference(
                    chain_structure, 0.8, law, periods=2, steps_per_period=count, dofs=()
                )
                for count in step_counts
            ],
        ]
        created_energies.append(
            [np.mean([h.created_energy**2 for h in row]) ** 0.5 for row in histories]
        )
    for sizes in np.transpose(created_energies):
        assert log_slope(counts, sizes) == pytest.approx(-2.0, abs=0.2)


def test_lumped_mass(soft_plate: fc.Structure) -> None:
    """The plate with its lumped mass moves as its own exact flow says; its steps may be longer."""
    lumped_plate, options = soft_plate.lumped(), {"periods": 3, "steps_per_period": 1024}
    history = fc.integrate_central_difference(lumped_plate, 2000.0, LAW, **options)
    exact = fc.integrate_events(lumped_plate, 2000.0, LAW, **options)
    assert relative(history.gap, exact.gap) < 1e-3
    assert fc.solve_modes(lumped_plate, 1).omega[0] < fc.solve_modes(soft_plate, 1).omega[0]
    steps, consistent_steps = (
        fc.stable_steps_per_period(plate, 2000.0, fc.UnilateralConstraint())
        for plate in (lumped_plate, soft_plate)
    )
    assert steps < consistent_steps


def motion(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Gap and loaded corner over two periods (collective)."""
    plate = fc.build_structure(scene, comm)
    corner = plate.find_dof((0.1, 0.1), "x")
    history = fc.integrate_central_difference(
        plate, 2000.0, LAW, periods=2, steps_per_period=300, dofs=[corner]
    )
    return np.hstack([history.gap, history.displacement([corner])])


@pytest.mark.nightly
@pytest.mark.mpi
def test_same_motion_on_one_and_two_ranks(
    paper_scene: fc.Scene, on_ranks: Callable[..., Any]
) -> None:
    """A mesh shared by two ranks marches as on one."""
    scene = paper_scene.replace({"damping.ratio": 0.01})
    assert relative(on_ranks(motion, scene), motion(scene, MPI.COMM_SELF)) < 1e-8


def test_reduced_structure_speaks_of_the_dofs_of_the_whole(soft_plate: fc.Structure) -> None:
    """Recorded displacement is that of the whole structure, by every way of recording."""
    reduced_plate = fc.reduce_structure(soft_plate, modes=50)
    corner = soft_plate.find_dof((0.1, 0.1), "x")
    options = {"periods": 2, "steps_per_period": 512}
    full_history = fc.integrate_central_difference(soft_plate, 2000.0, LAW, **options)  # type: ignore[arg-type]
    for dofs in (None, [corner]):
        history = fc.integrate_central_difference(reduced_plate, 2000.0, LAW, dofs=dofs, **options)  # type: ignore[arg-type]
        difference = history.displacement([corner]) - full_history.displacement([corner])
        assert np.abs(difference).max() < 1e-6 * np.abs(full_history.displacement([corner])).max()


@pytest.mark.parametrize("modes", [20, 40])
def test_reduced_structure_against_the_exact_flow(modes: int) -> None:
    """Order 2 against its own exact flow; with all modes, against that of the whole chain."""
    full_structure, law = chain("modal", n=40), fc.UnilateralPenalty(4.0)
    reduced_structure = fc.reduce_structure(full_structure, modes=modes)
    exact = fc.integrate_events(
        full_structure if modes == full_structure.n_dofs else reduced_structure,
        0.8,
        law,
        periods=2,
        steps_per_period=64,
    )
    counts, errors = (128, 256, 512, 1024), []
    for steps in counts:
        history = fc.integrate_central_difference(
            reduced_structure, 0.8, law, periods=2, steps_per_period=steps
        )
        errors.append(relative(history.gap[:: steps // 64], exact.gap))
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)
    assert errors[-1] < 1e-4


def test_the_stable_step_without_penetration(soft_plate: fc.Structure) -> None:
    """It is that with open pairs, longer than with any spring; what is no law is refused."""
    min_steps = fc.stable_steps_per_period(soft_plate, 2000.0, fc.UnilateralConstraint())
    assert min_steps <= fc.stable_steps_per_period(soft_plate, 2000.0, fc.UnilateralPenalty(1e6))
    catch_error(lambda: fc.stable_steps_per_period(soft_plate, 2000.0, "rigid"), "contact", "rigid")  # type: ignore[arg-type]


@pytest.mark.parametrize("damping", ["modal", "matrix", "none"])
def test_a_run_goes_on_from_another(damping: str) -> None:
    """Twice five periods are ten: exactly with events, to the scheme's order by differences."""
    structure, law = chain(damping), fc.UnilateralPenalty(4.0)
    ten = fc.integrate_events(structure, 0.8, law, periods=10, record_periods=1)
    five = fc.integrate_events(structure, 0.8, law, periods=5)
    continued_run = fc.integrate_events(
        structure, 0.8, law, periods=5, initial=five.final_state, record_periods=1
    )
    assert np.allclose(continued_run.gap, ten.gap, atol=1e-9 * np.abs(ten.gap).max())
    errors, counts = [], (200, 400, 800)
    for steps in counts:
        whole_run, first_run = (
            fc.integrate_central_difference(
                structure, 0.8, law, periods=periods, steps_per_period=steps, record_periods=1
            )
            for periods in (10, 5)
        )
        second_run = fc.integrate_central_difference(
            structure, 0.8, law, periods=5, steps_per_period=steps, initial=first_run.final_state,
            record_periods=1,
        )  # fmt: skip
        errors.append(np.abs(second_run.gap - whole_run.gap).max() / np.abs(whole_run.gap).max())
    if damping == "none":  # the acceleration does not depend on the velocity
        assert max(errors) < 1e-12
    else:
        assert errors[-1] < 1e-3 and log_slope(counts, errors) < -1.8


class Stopping(Cubic):
    """The law by which Ctrl-C comes when it is asked for the so many-th time."""

    left = -1

    def force(self, gap: np.ndarray) -> np.ndarray:
        """The same."""
        self.left -= 1
        if self.left == 0:
            signal.raise_signal(signal.SIGINT)
        return super().force(gap)

    def scaled(self, factor: float) -> Stopping:
        """The same with another c."""
        return Stopping(factor * self.stiffness)


def test_a_stopped_run_loses_nothing(tmp_path: Path) -> None:
    """Ctrl-C in the fourth period ends the run there; written, read and resumed it is the whole."""
    structure, law, steps = chain("matrix"), Stopping(1.0), 400

    def run(periods: int, **options: Any) -> fc.TimeHistory:
        return fc.integrate_central_difference(
            structure, 0.8, law, periods=periods, steps_per_period=steps, **options
        )

    whole_run, handler = run(8), signal.getsignal(signal.SIGINT)
    law.left = 7 * steps // 2
    part = run(8)
    assert part.periods == 4 and signal.getsignal(signal.SIGINT) == handler
    assert np.array_equal(part.gap, whole_run.gap[: 4 * steps])
    fc.save(part, tmp_path / "part.h5")
    loaded_run = fc.load(tmp_path / "part.h5", structure)
    assert np.array_equal(loaded_run.gap, part.gap) and loaded_run.periods == 4
    rest = run(4, initial=loaded_run.final_state)
    size = np.abs(whole_run.gap).max()
    assert np.abs(rest.gap - whole_run.gap[4 * steps :]).max() < 2e-3 * size
    catch_error(
        lambda: fc.load(tmp_path / "part.h5", chain(n=12, pairs=3)), "structure", "12 dofs, 3 pairs"
    )
    (tmp_path / "other.h5").write_text("no history")
    catch_error(
        lambda: fc.load(tmp_path / "other.h5", structure), "path", str(tmp_path / "other.h5")
    )


@pytest.mark.nightly
def test_created_energy_of_a_smoothed_law() -> None:
    """It stores another energy than half of force times gap, by which 3e-3 of the energy put in was
    told to be created whatever the step: like dt^2, too."""
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[1.0], force_sin=[1.0], clearance=0.1, damping=[[0.1]]
    )
    counts: list[int] = [400, 800, 1600]
    created_energies = []
    for steps in counts:
        histories = [
            fc.integrate_central_difference(
                structure, 1.1, fc.SmoothedPenalty(4.0, 30.0), periods=4, steps_per_period=count
            )
            for count in range(steps, steps + 7)
        ]
        created_energies.append(
            np.mean([history.created_energy**2 for history in histories]) ** 0.5
        )
    assert log_slope(counts, created_energies) == pytest.approx(-2.0, abs=0.2)


# --- energy, and contact without penetration ---------------------------------------------------


@pytest.mark.parametrize("damping", ["none", "modal", "matrix"])
def test_energy_balance_closes_to_second_order(damping: str) -> None:
    """Energy of masses, springs and contact less work and losses, from the motion alone."""
    structure, law, omega = chain(damping), fc.UnilateralPenalty(4.0), 0.8
    mass, dashpots, stiffness = dense_matrices(structure)
    counts, errors = (128, 256, 512), []
    for steps in counts:
        history = fc.integrate_central_difference(
            structure, omega, law, periods=2, steps_per_period=steps
        )
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


def test_impulse_of_a_rigid_stop() -> None:
    """The mass stops dead: impulse m v, v the speed at the stop, and all its energy lost."""
    distance = 0.001234
    speed = np.sqrt(1.0 - 100.0 * distance**2)
    errors = []
    for steps in (100, 1000):
        history = fc.integrate_central_difference(
            heavy_mass(), 2.0 * np.pi / 0.04, RIGID, periods=1, steps_per_period=steps,
            initial=(np.full(1, -distance), np.array([speed])),
        )  # fmt: skip
        impulse = history.contact_force.sum() * history.time[1]
        errors.append(abs(impulse / 100.0 - 1.0))
        assert history.gap.max() <= 1e-18
        assert np.abs(history.gap[-steps // 2 :]).max() < 1e-7
        assert np.abs(history.final_state[1]).max() < 1e-4
    assert errors[0] < 1e-3 and errors[1] < 1e-5
    assert history.created_energy == pytest.approx(-1.0, abs=1e-6)


@pytest.mark.parametrize("damping", DAMPINGS)
def test_no_penetration_and_no_pull(damping: str) -> None:
    """At every instant, from a start that penetrates; a force leads to a gap that is closed."""
    structure = chain(damping)
    history = fc.integrate_central_difference(
        structure, 0.8, RIGID, periods=5, steps_per_period=200
    )
    size = np.abs(history.gap).max()
    gap, force = history.gap, history.contact_force
    assert gap.max() < 1e-13 * size and force.min() >= 0.0
    assert np.any(force > 0.0) and np.any(gap < -0.1 * size)
    assert np.abs(gap[1:][force[:-1] > 0.0]).max() < 1e-13 * size
    displacement = history.displacement(range(structure.n_dofs))
    assert np.allclose(
        structure.apply_bt(displacement) - structure.clearance, gap, atol=1e-13 * size
    )


@pytest.mark.parametrize("start", [None, 5])
def test_paper_plate_without_penetration(start: int | None, soft_plate: fc.Structure) -> None:
    """Settles, from rest or from few harmonics, on the harmonic balance of the same constraint; the
    mean force is its."""
    solution = fc.solve_harmonic_balance(soft_plate, 2000.0, RIGID, harmonics=40)
    start_solution = start and fc.solve_harmonic_balance(soft_plate, 2000.0, RIGID, harmonics=start)
    history = fc.integrate_central_difference(
        soft_plate, 2000.0, RIGID, periods=200, steps_per_period=512, settle=1e-4,
        record_periods=1, initial=start_solution,
    )  # fmt: skip
    assert history.settled < 1e-4 and history.periods > 5
    assert relative(history.gap, solution.gap(history.time)) < 5e-3
    force = solution.contact_force(history.time).mean()
    assert history.contact_force.mean() == pytest.approx(force, rel=1e-3)
    assert -0.03 < history.created_energy < 0.0  # lost in impacts


def test_limit_of_stiff_penalty_in_lasting_contact() -> None:
    """Two masses, the first pressed on a stop: the motion without penetration, like 1/k."""
    stiffness = chain_stiffness(np.array([1.0, 1.0, 1.0]))
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[1.0, 0.0], force_mean=[3.0, 0.0], force_sin=[0.0, 0.5],
        damping=0.2 * stiffness,
    )  # fmt: skip
    steps, stiffnesses = 250, (1e2, 3e2, 1e3)
    rigid = fc.integrate_central_difference(
        structure, 0.6, RIGID, periods=4, steps_per_period=steps
    )
    assert np.abs(rigid.gap).max() < 1e-12
    errors, forces = [], []
    for k in stiffnesses:
        soft_history = fc.integrate_central_difference(
            structure, 0.6, fc.UnilateralPenalty(k), periods=4, steps_per_period=steps
        )
        last_period = slice(3 * steps, None)
        errors.append(
            relative(
                soft_history.displacement([1])[last_period], rigid.displacement([1])[last_period]
            )
        )
        forces.append(
            relative(soft_history.contact_force[last_period], rigid.contact_force[last_period])
        )
    assert log_slope(stiffnesses, errors) == pytest.approx(-1.0, abs=0.1)
    assert errors[-1] < 1e-2 and forces[-1] < 2e-2
