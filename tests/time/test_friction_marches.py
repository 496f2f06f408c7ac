"""Integrators with friction: order, energy, memory from run to run; without friction as before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error
from motion.test_friction import HERTZ, RIGID, jenkins, plate
from mpi4py import MPI

import fenics_crack as fc

Method = Callable[..., fc.TimeHistory]
BOTH = pytest.mark.parametrize(
    "method", [fc.integrate_central_difference, fc.integrate_exponential]
)
SOFT = fc.UnilateralPenalty(8.0)
RUBBING = fc.CoulombFriction(SOFT, 0.4, 5.0)


def rubbing(unmoved: int = 0, pressed: float = 1.0) -> fc.Structure:
    """Four masses on springs: a mean load presses the first on its stop; the third rubs there with
    the fourth. Others are not moved by anything."""
    n = 4 + unmoved
    stiffness = np.eye(n)
    stiffness[:4, :4] = np.diag([3.0, 4.0, 5.0, 3.0]) - np.diag([1.0, 2.0, 1.0], 1)
    stiffness[:4, :4] -= np.diag([1.0, 2.0, 1.0], -1)
    gap, tangent, force = np.zeros((n, 1)), np.zeros((n, 1)), np.zeros((3, n))
    gap[0], tangent[2], tangent[3] = 1.0, 1.0, -1.0
    force[:, :4] = [[2.0 * pressed, 0, 0, 0], [0.4, 0, 3.0, 0], [0, 0.3, 0, -2.0]]
    return fc.Structure.from_matrices(
        np.eye(n), stiffness, gap=gap, tangential=tangent, damping=fc.RayleighDamping(0.1, 0.0),
        force_mean=force[0], force_cos=force[1], force_sin=force[2],
    )  # fmt: skip


def last_period(method: Method, structure: fc.Structure, law: Any, steps: int) -> fc.TimeHistory:
    """The settled motion at w = 0.9."""
    return method(
        structure, 0.9, law, periods=400, steps_per_period=steps, settle=1e-11, record_periods=1
    )


@BOTH
def test_order(method: Method) -> None:
    """The slide of the Jenkins oscillator against its exact orbit: order 2, fitted."""
    structure, law = jenkins()
    orbit = fc.solve_harmonic_balance(structure, 0.9, law, tolerance=1e-4).orbit
    counts, errors = 2 ** np.arange(7, 12), []
    for steps in counts.tolist():
        history = last_period(method, structure, law, steps)
        exact = orbit.tangential_gap_at(history.time)
        errors.append(np.abs(history.tangential_gap - exact).max())
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.25)


def test_energy_of_pairs_with_mass() -> None:
    """Over a settled period the load's work is what damping and friction take: to rounding while
    the pair is closed; where it opens, too, but for what closing between steps creates."""
    for pressed, max_missing in ((1.0, 1e-9), (0.3, 1e-4)):
        structure, missing_shares = rubbing(pressed=pressed), []
        for steps in (128, 512):
            history = last_period(fc.integrate_central_difference, structure, RUBBING, steps)
            assert np.any(history.gap < 0.0) == (pressed < 1.0)
            motion, phase, force = history.recorded, 0.9 * history.time[:, None], structure.force
            load = force[0] + np.cos(phase) * force[1] + np.sin(phase) * force[2]
            twice = np.roll(motion, -1, axis=0) - np.roll(motion, 1, axis=0)
            work = 0.5 * np.sum(load * twice)
            damping = 0.1 * np.sum(twice**2) / 4.0 * steps * 0.9 / (2.0 * np.pi)
            friction = history.indicators().friction_loss
            assert 0.02 * work < friction < work
            missing_shares.append(abs(work - damping - friction) / work)
        assert missing_shares[1] < max_missing and missing_shares[1] < max(
            1e-9, 0.25 * missing_shares[0]
        )


@pytest.mark.parametrize("unmoved", [0, 700])
def test_without_friction_central_differences(unmoved: int) -> None:
    structure = rubbing(unmoved)
    no_mu, small_mu = (
        fc.integrate_central_difference(structure, 0.9, law, periods=3, steps_per_period=64)
        for law in (SOFT, fc.CoulombFriction(SOFT, 1e-300, 5.0))
    )
    np.testing.assert_allclose(small_mu.gap, no_mu.gap, atol=1e-12 * np.ptp(no_mu.gap))
    np.testing.assert_allclose(
        small_mu.recorded, no_mu.recorded, atol=1e-12 * np.ptp(no_mu.recorded)
    )


def test_without_friction_exponential_steps() -> None:
    structure, _ = plate("inclined_crack", 0.005)
    no_mu, small_mu = (
        fc.integrate_exponential(structure, 3183.0 * HERTZ, law, periods=5, steps_per_period=256)
        for law in (RIGID, fc.CoulombFriction(RIGID, 1e-300))
    )
    np.testing.assert_allclose(small_mu.gap, no_mu.gap, atol=1e-12 * np.ptp(no_mu.gap))
    force = no_mu.contact_force
    np.testing.assert_allclose(small_mu.contact_force, force, atol=1e-12 * np.ptp(force))


@pytest.mark.parametrize(
    ("method", "unmoved", "close"),
    [
        (fc.integrate_central_difference, 0, 1e-3),  # the first step of a run has half its order
        (fc.integrate_central_difference, 700, 1e-3),
        (fc.integrate_exponential, 0, 1e-11),
        (fc.integrate_events, 0, 1e-9),
    ],
)
def test_run_that_goes_on(tmp_path: Path, method: Method, unmoved: int, close: float) -> None:
    """Pairs remember where they stick, in files too; what forgets it goes elsewhere."""
    structure, options = rubbing(unmoved), {"steps_per_period": 256}
    whole_run = method(structure, 0.9, RUBBING, periods=5, **options)
    first_run = method(structure, 0.9, RUBBING, periods=3, **options)
    fc.save(first_run, tmp_path / "first.h5")
    loaded_run = fc.load(tmp_path / "first.h5", structure)
    assert all(map(np.array_equal, loaded_run.final_state, first_run.final_state))
    size = np.ptp(whole_run.tangential_force)
    errors = []
    for state in (loaded_run.final_state, loaded_run.final_state[:2]):
        rest = method(structure, 0.9, RUBBING, periods=2, initial=state, **options)
        errors.append(
            np.abs(rest.tangential_force - whole_run.tangential_force[-512:]).max() / size
        )
    assert errors[0] < close < 0.02 < errors[1]
    catch_error(
        lambda: method(
            structure,
            0.9,
            RUBBING,
            periods=1,
            initial=(*first_run.final_state[:2], np.zeros(3)),
            **options,
        ),
        "initial",
        names=r"\(3,\)\]",
    )
    catch_error(
        lambda: method(structure, 0.9, SOFT, periods=1, initial=first_run.final_state, **options),
        "initial",
        names=r"\(1,\)\]",
    )


@BOTH
def test_start_on_the_orbit(method: Method) -> None:
    """A solution hands over where its pairs stick: the first period is the orbit already, as near
    as the harmonics are; its displacement and velocity alone begin another motion."""
    structure = rubbing()
    solution = fc.solve_harmonic_balance(structure, 0.9, RUBBING, tolerance=1e-3, throw=False)
    orbit, coefficients = solution.orbit, solution.displacement_coefficients
    orders = np.arange(1, len(coefficients) // 2 + 1)
    velocity = 0.9 * orders @ coefficients[2::2]
    displacement = coefficients[0] + coefficients[1::2].sum(axis=0)
    errors = []
    for start in (solution, (displacement, velocity)):
        history = method(structure, 0.9, RUBBING, periods=1, steps_per_period=1024, initial=start)
        exact = orbit.tangential_force_at(history.time)
        errors.append(np.abs(history.tangential_force - exact).max() / np.ptp(exact))
    assert errors[0] < 2e-3 and errors[0] < 0.1 * errors[1], errors


@pytest.mark.nightly
def test_scene_that_goes_on(tmp_path: Path) -> None:
    """An integration or a solution in a file is gone on with where its pairs stick."""
    scene = fc.Scene.load(ROOT / "demos/inclined_crack.toml", {"contact.friction": 0.3}).replace(
        {"reduction.modes": 10, "reduction.method": "massless", "integration.method": "events"}
    )
    runs = []
    for periods, initial in ((3, None), (2, None), (1, "integration")):
        path = str(tmp_path / f"{initial}.h5") if initial else None
        changes = {"integration.periods": periods, "integration.initial": path}
        run = fc.integrate(scene.replace(changes), MPI.COMM_SELF)
        run.save(tmp_path / "integration.h5")
        runs.append(run.result)
    whole_run, first_run, rest = runs
    count, size = len(rest.time), np.ptp(whole_run.tangential_force)
    difference = rest.tangential_force - whole_run.tangential_force[-count:]
    assert np.abs(difference).max() < 1e-6 * size and len(first_run.final_state) == 3
    fc.solve(scene, MPI.COMM_SELF).save(tmp_path / "solution.h5")
    changes = {"integration.periods": 1, "integration.initial": str(tmp_path / "solution.h5")}
    assert fc.integrate(scene.replace(changes), MPI.COMM_SELF).result.friction == 0.3
    frictionless_scene = scene.replace(changes | {"contact.friction": 0.0})
    assert fc.integrate(frictionless_scene, MPI.COMM_SELF).result.friction is None
