"""Friction between faces in contact."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case
from motion.test_friction import jenkins, nlstep_beam

import fenics_crack as fc


@cache
def jenkins_solution(harmonics: int | None = None) -> fc.PeriodicSolution:
    """Of the oscillator at w = 0.9: its exact orbit, or harmonic balance."""
    structure, law = jenkins()
    if harmonics is None:
        return fc.solve_harmonic_balance(structure, 0.9, law, tolerance=1e-3)
    return fc.solve_harmonic_balance(structure, 0.9, law, harmonics=harmonics, samples=8192)


def draw_jenkins(axes: Any) -> None:
    """Loops of the orbit and of harmonic balance with one harmonic and with eleven."""
    for harmonics, name in ((None, "exact orbit"), (1, "H = 1"), (11, "H = 11")):
        found = jenkins_solution(harmonics)
        time = np.linspace(0.0, found.period, 1000)
        columns = (one(time)[:, 0] for one in (found.tangential_gap, found.tangential_force))
        axes.plot(*columns, "-" if harmonics is None else "--", label=name)
    axes.set(xlabel="x", ylabel="friction force")
    axes.legend(loc="lower right")


@case(draw=draw_jenkins)
def jenkins_oscillator() -> list[Row]:
    """Oscillator with a Jenkins element.

    x'' + 2 xi x' + x + lambda = cos(w t), xi = 0.02, w = 0.9, with a spring k_t = 0.5 behind a
    slider that holds abs(lambda) <= 0.3 (Jenkins, J. Appl. Mech. 29, 1962, 355-361).

    Reference: event-driven integration by another program, and by it harmonic balance with one
    harmonic. The loss of a slide between -A and A is 4 F (A - F / k_t), here of the half
    peak-to-peak that was found.
    """
    exact, one = jenkins_solution(), jenkins_solution(1)
    assert exact.orbit is not None
    time = np.linspace(0.0, exact.period, 200001)
    size = float(np.ptp(exact.orbit.tangential_gap_at(time))) / 2.0
    loss = float(exact.orbit.work.friction[0])
    first = float(np.hypot(*one.displacement_coefficients[1:3, 0]))
    return [
        Row("half peak-to-peak, exact orbit", size, 3.69236, 5e-6, absolute=True),
        Row("loss in a period, exact orbit", loss, 3.71084, 5e-6, absolute=True),
        Row("the same, of a slide so wide", loss, 4.0 * 0.3 * (size - 0.6), 1e-8),
        Row("amplitude with H = 1", first, 3.6668244, 5e-7, absolute=True),
    ]


SIZES = {302.574: 0.067693, 254.682: 0.073542, 225.0: 0.080962}


def draw_cantilever(axes: Any) -> None:
    """Response curve by exact orbits, and the published points."""
    structure, law, tip = nlstep_beam()
    curve = fc.continue_frequency(structure, 180.0, 340.0, law, tolerance=2e-2, throw=False)
    size = curve.indicators(tip).harmonic_1
    axes.plot(curve.omega, size, label="fenics_crack")
    axes.plot([*SIZES], [*SIZES.values()], "kx", label="reference")
    axes.set(xlabel="w [rad/s]", ylabel="abs(U1) of the tip [mm]")
    axes.legend()


@case(draw=draw_cantilever)
def cantilever_that_rubs() -> list[Row]:
    """Cantilever that rubs at a node.

    Example 02 of NLstep: an Euler-Bernoulli beam, 2000 x 100 x 300 mm, E = 185e3 MPa, rho = 7.83e-9
    t/mm^3, in 8 elements; dry friction without elastic slip holds its fourth node, the clamp being
    the first, with at most 1500 N; a force of 200 N shakes the tip. Damping is 0.1 w_s M, w_s the
    first frequency of the beam that sticks. Five modes of the free beam and their residual
    flexibility.

    Reference: the amplitude of the tip's first harmonic as that program prints it.
    """
    structure, law, tip = nlstep_beam()
    rows = []
    for omega, size in SIZES.items():
        found = fc.solve_harmonic_balance(structure, omega, law, tolerance=2e-2, throw=False)
        first = float(found.indicators(tip).harmonic_1)
        rows.append(Row(f"abs(U1) at {omega:g} rad/s [mm]", first, size, 5e-3))
    return rows
