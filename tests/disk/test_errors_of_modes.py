"""Errors of a bladed disk due to its modes, beside more families and beside damped statics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from reference_flow import size_of_motion
from wheels import COARSE, RING, ring

import fenics_crack as fc
from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import HarmonicBalanceSolver
from fenics_crack.errors.stated import estimate_solution_errors
from fenics_crack.model.contact import UnilateralConstraint

RIGID = UnilateralConstraint()


def resonance(scene: fc.Scene) -> float:
    """Lowest bilinear frequency of the wheel [rad/s]."""
    return float(fc.bilinear_frequencies(fc.prepare(scene).structure).omega_bilinear[0])


@pytest.mark.parametrize(
    ("families", "factor", "mesh"),
    [
        (3, 1.0, COARSE),
        pytest.param(3, 1.0, {"mesh.size": 0.006}, marks=pytest.mark.nightly),
        pytest.param(6, 1.0, {"mesh.size": 0.006}, marks=pytest.mark.nightly),
        pytest.param(8, 0.5, {"mesh.size": 0.006}, marks=pytest.mark.nightly),
        pytest.param(12, 1.0, {"mesh.size": 0.006}, marks=pytest.mark.nightly),
    ],
)
def test_true_errors_over_stated_ones(families: int, factor: float, mesh: dict[str, Any]) -> None:
    """Beside twice the families: of the tip a fifth of what is stated to 1.3 times it, and of the
    gap over the period, which the report has, a tenth to 1.3 times, with as many harmonics as make
    modes count."""
    scene = fc.Scene.from_mapping(RING).replace(
        mesh | {"disk.deviation": 0.01, "disk.seed": 3, "disk.families": families,
                "harmonic_balance.tolerance": 5e-3}
    )  # fmt: skip
    scene = scene.replace({"excitation.omega": factor * resonance(scene)})
    run = fc.solve(scene, MPI.COMM_SELF)
    finer_settings = {"disk.families": 2 * families, "harmonic_balance.tolerance": 1e-4}
    exact = fc.solve(scene.replace(finer_settings), MPI.COMM_SELF)
    assert run.errors is not None and not run.errors.absent
    own_amplitude, true_amplitude = (
        compared_run.result.indicators(compared_run.watched_dof).amplitude
        for compared_run in (run, exact)
    )
    assert 0.2 < abs(true_amplitude / own_amplitude - 1.0) / run.errors.stated("amplitude")[0] < 1.3
    time = np.linspace(0.0, run.result.period, 2000, endpoint=False)
    gap, exact_gap = (compared_run.result.gap(time) for compared_run in (run, exact))
    gap_error = np.linalg.norm(gap - exact_gap) / size_of_motion(
        exact_gap + run.structure.clearance
    )
    assert 0.1 < gap_error / run.result.report.total < 1.3


@pytest.mark.nightly
@pytest.mark.parametrize("length", [0.004, 0.006])
def test_rayleigh_damping(monkeypatch: pytest.MonkeyPatch, length: float) -> None:
    """What the modes leave out has the stiffness S, and by b K the damping b S: R / (1 + i b k w)
    in closed form. At the largest response the tip moves less then, by at most 1.5 times what is
    stated, and the change does not vanish with more families."""
    rate = 2.0 * 0.002 / (2.0 * np.pi * 1290.0)
    scene = ring(
        damping__ratio=None, damping__stiffness=rate, crack__length=length,
        disk__deviation=0.01, disk__seed=3,
    )  # fmt: skip
    pair_compliance, omega = ModalCompliance._pair_compliance, resonance(scene)

    def damped(self: ModalCompliance, receptance: np.ndarray) -> np.ndarray:
        undamped_compliance = pair_compliance(self, 0.0 * receptance)
        order = np.arange(len(receptance))[:, None, None]
        return (
            pair_compliance(self, receptance)
            + undamped_compliance / (1.0 + 1j * rate * self._base_omega * order)
            - undamped_compliance
        )

    for families in (3, 6):
        study = fc.prepare(scene.replace({"disk.families": families}))
        tip = study.watched[0].dof
        solutions = [
            fc.solve_harmonic_balance(study.structure, float(w), RIGID, harmonics=20)
            for w in omega * np.linspace(0.998, 1.002, 9)
        ]
        peak = max(solutions, key=lambda solution: float(solution.amplitude(tip)))
        report = estimate_solution_errors(study, peak)
        with monkeypatch.context() as patch:
            patch.setattr(ModalCompliance, "_pair_compliance", damped)
            problem = Problem(study.structure, peak.omega, RIGID, 20)
            true_solution = HarmonicBalanceSolver(problem).solve(peak)
        peak_amplitude = peak.amplitude(tip)
        amplitude_error = float(peak_amplitude / true_solution.amplitude(tip) - 1.0)
        part = report.contributions("amplitude")["modes"] / peak_amplitude
        assert amplitude_error > 0.02 and 0.25 < amplitude_error / part < 1.5
        assert amplitude_error < 1.5 * peak.report.displacement
