"""Central differences."""

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import (
    chain,
    dense_matrices,
    heavy_mass,
    log_slope,
    random_stiffness,
    relative,
    sampled_harmonics,
    wrap,
)
from mpi4py import MPI
from scipy.linalg import expm

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)


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
    given = {
        "modal": fc.ModalDamping(0.05),
        "few modes": fc.ModalDamping(0.05, 2),
        "rayleigh": fc.RayleighDamping(0.3, 0.02),
        "matrix": 0.3 * mass + 0.02 * stiffness,
    }.get(damping)
    structure = fc.Structure.from_matrices(  # its pair never closes
        mass, stiffness, np.eye(n, 1), damping=given, clearance=1e3
    )
    full = dense_matrices(structure)[1]
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
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ full]])
    last = steps - 1
    exact = (expm(flow * history.time[last]) @ start.ravel())[:n]
    found = history.displacement(range(n))[last]
    assert np.linalg.norm(found - exact) < 1e-4 * np.linalg.norm(start[0])


@pytest.mark.verification
def test_settles_on_the_harmonic_balance(soft_plate: fc.Structure) -> None:
    """k = 1e9, xi = 0.01: from rest to the published orbit; both methods agree to 1 %."""
    corner = soft_plate.find_dof((0.1, 0.1), "x")
    history = fc.integrate_central_difference(
        soft_plate,
        2000.0,
        LAW,
        periods=200,
        steps_per_period=1024,
        settle=1e-6,
        record_periods=1,
        dofs=[corner],
    )
    assert history.settled < 1e-6 and history.periods < 200
    assert abs(history.created_energy) < 1e-3
    solution = fc.solve_harmonic_balance(soft_plate, 2000.0, LAW, harmonics=20)
    gap = solution.gap(history.time)
    assert relative(history.gap, gap) < 0.01
    mean, waves = sampled_harmonics(history.gap[:, 0])
    assert waves[0] == pytest.approx(7.418206e-7, rel=1e-3)
    assert mean == pytest.approx(-4.317675e-7, rel=1e-3)
    assert -history.gap.min() == pytest.approx(1.451955e-6, rel=2e-3)
    motion = history.displacement([corner])
    assert motion.max() == pytest.approx(1.156557e-6, rel=1e-3)


@pytest.mark.usefixtures("predicted_errors")
def test_paper_data_does_not_settle(paper_structure: fc.Structure) -> None:
    """k = 1e11, xi = 0.001: started on the orbit of the harmonic balance, the motion leaves it."""
    law = fc.UnilateralPenalty(1e11)
    orbit = fc.solve_harmonic_balance(paper_structure, 2000.0, law, harmonics=10)
    history = fc.integrate_central_difference(
        paper_structure,
        2000.0,
        law,
        periods=150,
        steps_per_period=2304,
        initial=orbit,
        settle=1e-6,
        dofs=[],
    )
    assert history.periods == 150
    assert history.settled > 1e-3
    folded = history.by_period(history.gap[:, 0])
    assert folded.shape == (150, 2304)
    drift = np.linalg.norm(folded - orbit.gap(history.time[:2304])[:, 0], axis=1)
    assert drift.max() > 3.0 * drift[0]
    opening = -folded.min(axis=1)
    assert 0.5e-6 < opening.min() and opening.max() < 5e-6  # bounded all the same


def test_step_beyond_the_stable_one_is_refused(soft_plate: fc.Structure) -> None:
    """dt <= 2 / omega_max with the pairs closed; the error names the least number of steps."""
    highest = fc.solve_modes(soft_plate.tied(1e9), soft_plate.n_dofs).omega[-1]
    least = fc.stable_steps_per_period(soft_plate, 2000.0, LAW)
    assert (2.0 * np.pi / 2000.0) / least < 2.0 / highest < (2.0 * np.pi / 2000.0) / (least - 1)
    with pytest.raises(fc.InputError, match=f"steps_per_period.*>= {least}"):
        fc.integrate_central_difference(
            soft_plate, 2000.0, LAW, periods=1, steps_per_period=least - 1
        )


def test_stable_limit_is_sharp_without_contact_events() -> None:
    """A tied pair just inside the limit stays bounded; the bound of the step is not slack."""
    structure = fc.Structure.from_matrices(
        np.eye(1), np.eye(1), np.ones(1), clearance=-1e3, force_sin=np.ones(1)
    )
    law = fc.UnilateralPenalty(99.0)  # always closed: frequency 10
    least = fc.stable_steps_per_period(structure, 1.0, law)
    assert least == 32  # 10 pi = 31.4
    rest = -990.0  # x + 99 (x + 1000) = 0
    history = fc.integrate_central_difference(
        structure,
        1.0,
        law,
        periods=50,
        steps_per_period=least,
        initial=(np.full(1, rest + 1.0), np.zeros(1)),
    )
    assert np.abs(history.displacement([0]) - rest).max() < 2.0


def test_contact_that_creates_energy_is_an_error(paper_structure: fc.Structure) -> None:
    """Close to the stable limit stiff contact feeds the motion: an error, not a wave of 1e107 m."""
    law = fc.UnilateralPenalty(1e11)
    least = fc.stable_steps_per_period(paper_structure, 2000.0, law)
    with pytest.raises(fc.ConvergenceError, match="times the energy put in"):
        fc.integrate_central_difference(
            paper_structure, 2000.0, law, periods=400, steps_per_period=least + 40, dofs=[]
        )


def test_created_energy_vanishes_with_the_step() -> None:
    """A bounce conserves energy: what contact creates is what the motion gains."""
    created = []
    for steps in (400, 1600, 6400):
        history = release(steps)
        created.append(abs(history.created_energy))
        speed = np.diff(history.displacement([0])[:, 0])[-1] / (history.time[1])
        position = history.displacement([0])[-1, 0]
        energy = 0.5 * 100.0 * speed**2 + 0.5 * 1e4 * position**2
        assert energy / 50.0 - 1.0 == pytest.approx(history.created_energy, abs=30.0 / steps)
    assert created[-1] < 1e-4
    assert created[0] < 0.05


def test_created_energy_is_of_second_order() -> None:
    """Like dt^2, in the mean over steps that meet the contact at other phases."""
    chained, law = chain("none"), fc.UnilateralPenalty(4.0)
    counts: list[int] = [200, 400, 800, 1600, 3200]
    created = []
    for steps in counts:
        near = range(steps, steps + 56, 7)
        histories = [
            [release(count) for count in near],
            [
                fc.integrate_central_difference(
                    chained, 0.8, law, periods=2, steps_per_period=count, dofs=()
                )
                for count in near
            ],
        ]
        created.append([np.mean([h.created_energy**2 for h in row]) ** 0.5 for row in histories])
    for sizes in np.transpose(created):
        assert log_slope(counts, sizes) == pytest.approx(-2.0, abs=0.2)


def test_lumped_mass(soft_plate: fc.Structure) -> None:
    """The plate with its lumped mass moves as its own exact flow says; its steps may be longer."""
    lumped, options = soft_plate.lumped(), {"periods": 3, "steps_per_period": 1024}
    history = fc.integrate_central_difference(lumped, 2000.0, LAW, **options)
    exact = fc.integrate_events(lumped, 2000.0, LAW, **options)
    assert relative(history.gap, exact.gap) < 1e-3
    assert fc.solve_modes(lumped, 1).omega[0] < fc.solve_modes(soft_plate, 1).omega[0]
    steps, more = (
        fc.stable_steps_per_period(plate, 2000.0, fc.UnilateralConstraint())
        for plate in (lumped, soft_plate)
    )
    assert steps < more


def motion(scene: fc.Scene, comm: MPI.Comm) -> np.ndarray:
    """Gap and loaded corner over two periods (collective)."""
    plate = fc.build_structure(scene, comm)
    corner = plate.find_dof((0.1, 0.1), "x")
    history = fc.integrate_central_difference(
        plate, 2000.0, LAW, periods=2, steps_per_period=300, dofs=[corner]
    )
    return np.hstack([history.gap, history.displacement([corner])])


@pytest.mark.mpi
def test_same_motion_on_one_and_two_ranks(
    paper_scene: fc.Scene, on_ranks: Callable[..., Any]
) -> None:
    """A mesh shared by two ranks marches as on one."""
    scene = paper_scene.replace({"damping.ratio": 0.01})
    assert relative(on_ranks(motion, scene), motion(scene, MPI.COMM_SELF)) < 1e-8


def test_reduced_structure_speaks_of_the_dofs_of_the_whole(soft_plate: fc.Structure) -> None:
    """Recorded displacement is that of the whole structure, by every way of recording."""
    reduced = fc.reduce_structure(soft_plate, modes=50)
    corner = soft_plate.find_dof((0.1, 0.1), "x")
    options = {"periods": 2, "steps_per_period": 512}
    whole = fc.integrate_central_difference(soft_plate, 2000.0, LAW, **options)  # type: ignore[arg-type]
    for dofs in (None, [corner]):
        history = fc.integrate_central_difference(reduced, 2000.0, LAW, dofs=dofs, **options)  # type: ignore[arg-type]
        difference = history.displacement([corner]) - whole.displacement([corner])
        assert np.abs(difference).max() < 1e-6 * np.abs(whole.displacement([corner])).max()


@pytest.mark.parametrize("method", ["free_interface", "craig_bampton"])
def test_reduced_structure_moves_as_the_whole(wide_plate: fc.Structure, method: str) -> None:
    """Few coordinates against all dofs of a plate with four pairs, step by step."""
    reduced = fc.reduce_structure(wide_plate, modes=60, method=method)
    assert reduced.n_dofs < 0.6 * wide_plate.n_dofs
    corner = wide_plate.find_dof((0.1, 0.1), "x")
    whole, small = (
        fc.integrate_central_difference(
            structure, 2000.0, LAW, periods=2, steps_per_period=1024, dofs=[corner]
        )
        for structure in (wide_plate, reduced)
    )
    assert np.any(whole.gap > 0.0, axis=0).all()
    assert relative(small.displacement([corner]), whole.displacement([corner])) < 4e-3
    assert relative(small.gap, whole.gap) < 8e-3


@pytest.mark.parametrize("modes", [20, 40])
@pytest.mark.parametrize("method", ["free_interface", "craig_bampton"])
def test_reduced_structure_against_the_exact_flow(method: str, modes: int) -> None:
    """Order 2 against its own exact flow; with all modes, against that of the whole chain."""
    whole, law = chain("modal", n=40), fc.UnilateralPenalty(4.0)
    reduced = fc.reduce_structure(whole, modes=modes, method=method)
    exact = fc.integrate_events(
        whole if modes == whole.n_dofs else reduced, 0.8, law, periods=2, steps_per_period=64
    )
    counts, errors = (128, 256, 512, 1024), []
    for steps in counts:
        history = fc.integrate_central_difference(
            reduced, 0.8, law, periods=2, steps_per_period=steps
        )
        errors.append(relative(history.gap[:: steps // 64], exact.gap))
    assert log_slope(counts, errors) == pytest.approx(-2.0, abs=0.1)
    assert errors[-1] < 1e-4


def test_the_stable_step_without_penetration(soft_plate: fc.Structure) -> None:
    """It is that with open pairs, longer than with any spring; what is no law is refused."""
    least = fc.stable_steps_per_period(soft_plate, 2000.0, fc.UnilateralConstraint())
    assert least <= fc.stable_steps_per_period(soft_plate, 2000.0, fc.UnilateralPenalty(1e6))
    with pytest.raises(fc.InputError, match="contact"):
        fc.stable_steps_per_period(soft_plate, 2000.0, "rigid")  # type: ignore[arg-type]


@pytest.mark.parametrize("damping", ["modal", "matrix", "none"])
def test_a_run_goes_on_from_another(damping: str) -> None:
    """Twice five periods are ten: exactly with events, to the scheme's order by differences."""
    structure, law = chain(damping), fc.UnilateralPenalty(4.0)
    ten = fc.integrate_events(structure, 0.8, law, periods=10, record_periods=1)
    five = fc.integrate_events(structure, 0.8, law, periods=5)
    more = fc.integrate_events(
        structure, 0.8, law, periods=5, initial=five.final_state, record_periods=1
    )
    assert np.allclose(more.gap, ten.gap, atol=1e-9 * np.abs(ten.gap).max())
    errors, counts = [], (200, 400, 800)
    for steps in counts:
        whole, first = (
            fc.integrate_central_difference(
                structure, 0.8, law, periods=periods, steps_per_period=steps, record_periods=1
            )
            for periods in (10, 5)
        )
        second = fc.integrate_central_difference(
            structure, 0.8, law, periods=5, steps_per_period=steps, initial=first.final_state,
            record_periods=1,
        )  # fmt: skip
        errors.append(np.abs(second.gap - whole.gap).max() / np.abs(whole.gap).max())
    if damping == "none":  # the acceleration does not depend on the velocity
        assert max(errors) < 1e-12
    else:
        assert errors[-1] < 1e-3 and log_slope(counts, errors) < -1.8


@pytest.mark.parametrize("integrate", ["central", "implicit", "events"])
def test_a_stopped_run_loses_nothing(
    integrate: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in the fourth period ends the run there; written, read and resumed it is the whole."""
    structure, law = chain("matrix"), fc.UnilateralPenalty(4.0)
    march = {
        "central": fc.integrate_central_difference,
        "implicit": fc.integrate_implicit,
        "events": fc.integrate_events,
    }[integrate]
    steps = 400 if integrate != "events" else 64

    def run(periods: int, **options: Any) -> fc.TimeHistory:
        return march(structure, 0.8, law, periods=periods, steps_per_period=steps, **options)

    whole, handler = run(8), signal.getsignal(signal.SIGINT)
    owner = {
        "central": "central_differences._ModalDifferences",
        "implicit": "implicit._ModalAlpha",
        "events": "flows._ByEvents",
    }[integrate]
    count = 0

    def interrupted(fill: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count == 4:
            signal.raise_signal(signal.SIGINT)
        return fill(*arguments, **options)

    wrap(monkeypatch, f"fenics_crack.time.{owner}.fill", interrupted)
    part = run(8)
    assert part.periods == 4 and signal.getsignal(signal.SIGINT) == handler
    assert np.array_equal(part.gap, whole.gap[: 4 * steps])
    fc.save(part, tmp_path / "part.h5")
    again = fc.load(tmp_path / "part.h5", structure)
    assert np.array_equal(again.gap, part.gap) and again.periods == 4
    rest = run(4, initial=again.final_state)
    size = np.abs(whole.gap).max()
    assert (
        np.abs(rest.gap - whole.gap[4 * steps :]).max()
        < (1e-9 if integrate == "events" else 2e-3) * size
    )
    with pytest.raises(fc.InputError, match="structure"):
        fc.load(tmp_path / "part.h5", chain(n=12, pairs=3))
    (tmp_path / "other.h5").write_text("no history")
    with pytest.raises(fc.InputError, match="path"):
        fc.load(tmp_path / "other.h5", structure)


@pytest.mark.nightly
def test_created_energy_of_a_smoothed_law() -> None:
    """It stores another energy than half of force times gap, by which 3e-3 of the energy put in was
    told to be created whatever the step: like dt^2, too."""
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], [1.0], force_sin=[1.0], clearance=0.1, damping=[[0.1]]
    )
    counts: list[int] = [400, 800, 1600]
    created = []
    for steps in counts:
        histories = [
            fc.integrate_central_difference(
                structure, 1.1, fc.SmoothedPenalty(4.0, 30.0), periods=4, steps_per_period=count
            )
            for count in range(steps, steps + 7)
        ]
        created.append(np.mean([one.created_energy**2 for one in histories]) ** 0.5)
    assert log_slope(counts, created) == pytest.approx(-2.0, abs=0.2)
