"""Friction on random plates: that orbits are found, their errors and cost."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest
from helpers import ROOT
from motion.test_friction import RIGID

import fenics_crack as fc
from fenics_crack.balance.assessment import relative_gap_distance

pytestmark = pytest.mark.nightly


@cache
def built(name: str, **changes: float) -> fc.Structure:
    """A demonstration's plate."""
    scene = fc.Scene.load(ROOT / f"demos/{name}.toml")
    return fc.build_structure(scene.replace({f"crack.{key}": v for key, v in changes.items()}))


def pushed(full_plate: fc.Structure, angle: float, ratio: float) -> fc.Structure:
    """A plate with 10 modes, loaded at its own point from another direction."""
    turn = np.zeros((2, full_plate.n_dofs))
    dof = int(np.argmax(np.abs(full_plate.force).sum(axis=0))) // 2 * 2
    turn[1, dof : dof + 2] = np.abs(full_plate.force).max() * np.array(
        [np.cos(angle), np.sin(angle)]
    )
    unloaded_plate = full_plate.damped(fc.ModalDamping(ratio, 10)).varied(load=0.0)
    return fc.reduce_structure(
        unloaded_plate.with_added_load_harmonics({1: tuple(turn)}), modes=10, method="massless"
    )


@pytest.mark.parametrize("part", range(4))
def test_random_plates(part: int) -> None:
    """Ten of forty: a wave with ten harmonics and an orbit of each, the true error of the wave at
    most twice the stated one; slipping orbits take at most twelve times as long as those without
    friction."""
    random, error_ratios, ratios = np.random.default_rng(70 + part), [], []
    for number in range(10):
        name = ("inclined_crack", "breathing_plate")[number % 2]
        mu = float(np.exp(random.uniform(np.log(0.05), np.log(0.8))))
        ratio = float(np.exp(random.uniform(np.log(0.005), np.log(0.02))))
        structure = pushed(built(name), random.uniform(0.0, 2.0 * np.pi), ratio)
        bilinear_omega = fc.bilinear_frequencies(structure).omega_bilinear[random.integers(0, 2)]
        omega, law = (
            float(bilinear_omega * random.uniform(0.85, 1.15)),
            fc.CoulombFriction(RIGID, mu),
        )
        wave = fc.solve_harmonic_balance(structure, omega, law, harmonics=10)
        start_time = time.process_time()
        fc.solve_harmonic_balance(structure, omega, RIGID, tolerance=0.02, throw=False)
        frictionless_time = time.process_time() - start_time
        solution = fc.solve_harmonic_balance(structure, omega, law, tolerance=0.02, throw=False)
        assert solution.orbit is not None
        if solution.indicators().slip_share > 0.01:
            ratios.append(
                (time.process_time() - start_time - frictionless_time) / frictionless_time
            )
        if not wave.report.unknown:
            parts = wave.report.truncation, wave.report.sampling, wave.report.residual
            error_ratios.append(relative_gap_distance(wave, solution.orbit) / sum(parts))
    assert max(error_ratios) <= 2.0 and len(error_ratios) >= 5
    assert np.median(ratios) <= 12.0
