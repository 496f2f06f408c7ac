"""Friction between faces in contact."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case, label
from motion.cone import march_cone
from motion.test_friction import jenkins, nlstep_beam
from motion.test_friction_on_solids import solved

import fenics_crack as fc
from fenics_crack.time.march import make_initial_state_parts


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
        orbit_solution = jenkins_solution(harmonics)
        time = np.linspace(0.0, orbit_solution.period, 1000)
        columns = (
            quantity(time)[:, 0]
            for quantity in (orbit_solution.tangential_gap, orbit_solution.tangential_force)
        )
        axes.plot(*columns, "-" if harmonics is None else "--", label=name)
    axes.set(xlabel="x", ylabel="friction force")
    axes.legend(loc="lower right")


@case(draw=draw_jenkins)
def jenkins_oscillator() -> list[Row]:
    """Oscillator with a Jenkins element.

    x'' + 2 xi x' + x + lambda = cos(w t), xi = 0.02, w = 0.9, with a spring k_t = 0.5 behind a
    slider that holds abs(lambda) <= 0.3 (Jenkins, J. Appl. Mech. 29, 1962, 355-361).

    Reference: event-driven integration and harmonic balance with one harmonic by another program;
    the loss of a slide between -A and A, 4 F (A - F / k_t).
    """
    exact, first_order_solution = jenkins_solution(), jenkins_solution(1)
    time = np.linspace(0.0, exact.period, 200001)
    size = float(np.ptp(exact.orbit.tangential_gap_at(time))) / 2.0
    loss = float(exact.orbit.energy_budget.friction[0])
    first_amplitude = float(np.hypot(*first_order_solution.displacement_coefficients[1:3, 0]))
    return [
        Row("half peak-to-peak, exact orbit", size, 3.69236, 5e-6, absolute=True),
        Row("loss in a period, exact orbit", loss, 3.71084, 5e-6, absolute=True),
        Row("the same, of a slide so wide", loss, 4.0 * 0.3 * (size - 0.6), 1e-8),
        Row("amplitude with H = 1", first_amplitude, 3.6668244, 5e-7, absolute=True),
    ]


SIZES = {302.574: 0.067693, 254.682: 0.073542, 225.0: 0.080962}


def draw_cantilever(axes: Any) -> None:
    """Response curve by exact orbits, and the published points."""
    structure, law, tip = nlstep_beam()
    curve = fc.continue_frequency(structure, 180.0, 340.0, law, tolerance=2e-2, throw=False)
    axes.plot(curve.omega, curve.indicators(tip).harmonic_1, label="fenics_crack")
    axes.plot([*SIZES], [*SIZES.values()], "kx", label="reference")
    label(axes, xlabel="w [rad/s]", ylabel="abs(U1) of the tip [mm]")


@case(draw=draw_cantilever)
def cantilever_that_rubs() -> list[Row]:
    """Cantilever that rubs at a node.

    Example 02 of NLstep: an Euler-Bernoulli beam, 2000 x 100 x 300 mm, E = 185e3 MPa, rho = 7.83e-9
    t/mm^3, in 8 elements; dry friction of at most 1500 N holds its fourth node, 200 N shake the
    tip. Damping is 0.1 w_s M, w_s the first frequency of the beam that sticks. Five modes of the
    free beam and their residual flexibility.

    Reference: the amplitude of the tip's first harmonic as that program prints it.
    """
    structure, law, tip = nlstep_beam()
    rows = []
    for omega, size in SIZES.items():
        solution = fc.solve_harmonic_balance(structure, omega, law, tolerance=2e-2, throw=False)
        first_amplitude = float(solution.indicators(tip).harmonic_1)
        rows.append(Row(f"abs(U1) at {omega:g} rad/s [mm]", first_amplitude, size, 5e-3))
    return rows


RUBBED = ((3474.1, 0.3), (2818.1, 0.3), (3700.0, 0.6))
"""Frequencies [Hz] and coefficients of friction."""
STEPS = (96, 192)
"""Of the cone in a period; their error is of second order."""


@cache
def beside_the_cone(frequency: float, mu: float) -> tuple[fc.Run, float, list[np.ndarray]]:
    """The solution, its amplitude without friction, and displacements by steps with the cone."""
    run = solved(excitation__frequency=frequency, contact__friction=mu)
    frictionless_run = solved(excitation__frequency=frequency, contact__friction=0.0)
    contact, structure = run.result.contact, run.structure
    assert isinstance(contact, fc.CoulombFriction) and isinstance(structure, fc.MasslessStructure)
    start = np.array(make_initial_state_parts(structure, contact, run.result)[:2])[
        :, : structure.n_modes
    ]
    marched_motions = [
        march_cone(structure, run.result.omega, mu, start, count, 15) for count in STEPS
    ]
    tip_motions = [np.ravel(structure.values_at(x, [run.watched_dof])) for x in marched_motions]
    return run, float(frictionless_run.result.amplitude(frictionless_run.watched_dof)), tip_motions


def draw_cone(axes: Any) -> None:
    """Displacement over the last period of the last case."""
    run, _, tip_motions = beside_the_cone(*RUBBED[-1])
    time = np.linspace(0.0, run.result.period, 1000)
    axes.plot(time * 1e3, run.result.displacement(time, run.watched_dof) * 1e6, label="lines")
    time = np.arange(1, STEPS[1] + 1) / STEPS[1] * run.result.period
    axes.plot(time[::4] * 1e3, tip_motions[1][::4] * 1e6, "k.", label="cone, by steps")
    label(axes, xlabel="time [ms]", ylabel="displacement [um]")


@case(draw=draw_cone)
def friction_on_a_solid() -> list[Row]:
    """Friction on a solid along one line a pair.

    The blade that `new --solid` writes, 30 x 90 x 6 mm with half an ellipse as crack, on a coarser
    mesh: damping 2 %, eight modes, 0.1 N across it at a corner of its tip, near its torsion, near
    its motion in its plane, and between two modes. The program lets each pair slide along one line,
    that of its motion without friction; its error grows with the sliding across the lines, here
    below 0.1.

    Reference: Coulomb's cone, two directions a pair, by time steps that share no code: exponential
    steps, forces by projected Gauss-Seidel, 15 periods from the state of the orbit, 96 and 192
    steps a period, extrapolated. What friction changes is the amplitude over that without it, less
    1.
    """
    rows = []
    for frequency, mu in RUBBED:
        run, no_friction, tip_motions = beside_the_cone(frequency, mu)
        coarse_amplitude, fine_amplitude = (
            0.5 * float(np.ptp(tip_motion)) for tip_motion in tip_motions
        )
        limit, amplitude = (
            fine_amplitude + (fine_amplitude - coarse_amplitude) / 3.0,
            float(run.result.amplitude(run.watched_dof)),
        )
        name = f"at {frequency:g} Hz, mu = {mu:g}"
        contact = run.result.contact
        assert isinstance(contact, fc.CoulombFriction) and contact.turning
        rows += [
            Row(f"half peak-to-peak {name} [um]", amplitude * 1e6, limit * 1e6, 5e-4),
            Row(
                f"change by friction {name}",
                amplitude / no_friction - 1.0,
                limit / no_friction - 1.0,
                5e-4,
                True,
            ),
            Row(f"sliding across the lines {name}", contact.turning, 0.0, 0.1, True),
        ]
    return rows
