"""Exact orbits as equations of a path in the kernel."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import chain, relative

import fenics_crack as fc
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.motion.flow import Budget, flow_of
from fenics_crack.motion.orbit import find_orbit
from fenics_crack.numerics.bordered import point_on_path, solve_in_plane
from fenics_crack.numerics.path import Path, PathOptions

RIGID = fc.UnilateralConstraint()


@pytest.mark.parametrize("light", [False, True])
def test_equations_of_a_path(light: bool) -> None:
    """Residual, both derivatives, and a path in the kernel whose points are orbits."""
    structure, contact = chain(pairs=3, seed=2), fc.UnilateralPenalty(20.0)
    if light:
        structure, contact = fc.reduce_structure(structure, modes=6, method="massless"), RIGID
    flow = flow_of(structure, contact)
    assert flow is not None
    settled = flow.advance(np.zeros(flow.size), 0.6, 30 * 2.0 * np.pi / 0.6).state
    system, step = FlowOrbits(flow, 0.6, settled), 1e-6
    x = 1.05 * system.start
    at = system.linearise(x, 1.02)
    moved = flow.advance(x / system.scale, 0.612, 2.0 * np.pi / 0.612).state
    assert relative(at.residual, system.scale * moved - x) < 1e-12
    ends = [system.linearise(x, 1.02 + h).residual for h in (step, -step)]
    assert relative(at.by_parameter, (ends[0] - ends[1]) / (2.0 * step)) < 1e-6
    change = np.random.default_rng(0).normal(size=flow.size)
    ends = [system.linearise(x + h * change, 1.02).residual for h in (step, -step)]
    assert relative(at.jacobian @ change, (ends[0] - ends[1]) / (2.0 * step)) < 1e-6
    first = solve_in_plane(system, system.start, 1.0, None, tolerance=1e-11)
    assert first is not None
    options = PathOptions(0.01, max_step=0.05, max_steps=6, span=(0.9, 1.1))
    points = list(Path(system, point_on_path(system, first.unknown, 1.0), options).points())
    assert len(points) > 4
    for point in points:
        orbit = find_orbit(flow, point.parameter * 0.6, point.unknown / system.scale)
        assert orbit is not None
        assert relative(point.unknown, system.scale * orbit.state) < 1e-6


def test_budget() -> None:
    """Motions that take more end a path, and a search."""
    flow = flow_of(chain(pairs=3, seed=2), fc.UnilateralPenalty(20.0))
    assert flow is not None
    few = Budget(intervals=3)
    system = FlowOrbits(flow, 0.6, np.ones(flow.size), budget=few)
    with pytest.raises(fc.ConvergenceError, match="cannot be followed"):
        system.linearise(system.start, 1.0)
    settled = flow.advance(np.zeros(flow.size), 0.6, 30 * 2.0 * np.pi / 0.6).state
    assert find_orbit(flow, 0.6, settled) is not None
    assert find_orbit(flow, 0.6, settled, budget=few) is None
    assert find_orbit(flow, 0.6, settled, budget=Budget(pieces=60)) is None
