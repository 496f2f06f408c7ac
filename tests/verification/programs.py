"""Examples of other programs."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case, label
from scipy.integrate import solve_ivp

import fenics_crack as fc

# --- pyHarm: one mass with a gap ------------------------------------------------------------------

GAP = fc.UnilateralPenalty(1000.0)
UPPER = {
    5.997877222763311: 1.0337499229169902,
    7.0004088437954355: 1.2074992077980804,
    8.002482184837223: 1.5750085436232641,
    8.302509061608356: 1.733795311595365,
}
LOWER = {
    8.447071014207589: 1.6332910946164505,
    8.054601346158618: 1.3394879187779893,
    7.504437763686067: 1.1187026303456469,
}
"""Points with contact on either side of the peak: frequency [rad/s] and size."""
FREE = {2.0: 0.2776064686170019, 15.074923127313287: 0.053334507243507454}


def size(solution: fc.PeriodicSolution) -> float:
    """As pyHarm's test has it: norm of all coefficients over the length of 10."""
    return 0.1 * float(np.linalg.norm(solution.coefficients_at([0])))


@cache
def gap_curve() -> tuple[fc.ResponseCurve, np.ndarray]:
    """The mass from 2 to 15 rad/s, H = 7 and 1024 samples, and its sizes."""
    unit = np.ones((1, 1))
    mass = fc.Structure.from_matrices(
        unit,
        40.0 * unit,
        gap=unit,
        force_cos=[100.0],
        clearance=10.0,
        damping=0.1 * np.sqrt(40.0) * unit,
    )
    curve = fc.continue_frequency(mass, 2.0, 15.0, GAP, harmonics=7, samples=1024)
    return curve, np.array([size(curve.solution(i)) for i in range(len(curve.omega))])


def draw_gap(axes: Any) -> None:
    """The response, and the published points."""
    curve, sizes = gap_curve()
    axes.semilogy(curve.omega, sizes, label="fenics_crack, H = 7")
    points = FREE | UPPER | LOWER
    axes.plot(list(points), list(points.values()), "kx", label="pyHarm's table")
    axes.axhline(1.0, color="0.7", lw=1, ls="--", label="gap")
    label(axes, xlabel="frequency of the load [rad/s]", ylabel="norm of the coefficients / 10")


@case(draw=draw_gap)
def mass_with_a_gap() -> list[Row]:
    """pyHarm's example onedofgap.

    A mass on a spring and a damper, a load 100 cos(W t) and a spring of 1000 beyond a gap of 10, H
    = 7, 1024 samples, from 2 to 15 rad/s.

    Reference: `tests/nonregression/NonRegressionData/onedofgap` of pyHarm (Safran, Apache 2.0), a
    table of frequencies and sizes, the norms of all coefficients over 10. Its matrices could not be
    had: m = 1, k = 40 and c = 0.1 sqrt(40) give both ends of the table to all digits (first rows).
    Linear interpolation between its points costs some 1e-4, and more at the foot of the contact
    branch (last row, not judged).
    """
    curve, sizes = gap_curve()
    structure, top = curve.solution(0).structure, int(np.argmax(sizes))
    rows = []
    for omega, value in FREE.items():
        solution = fc.solve_harmonic_balance(structure, omega, GAP, harmonics=7, samples=1024)
        rows += [Row(f"no contact, W = {omega:.6g}", size(solution), value, 1e-10)]
    contact_indices = np.arange(len(sizes))[sizes > 1.0]
    for name, points, side in (
        ("up to the peak", UPPER, contact_indices[contact_indices <= top]),
        ("beyond the peak", LOWER, contact_indices[contact_indices > top]),
    ):
        for omega, value in points.items():
            start = int(side[np.argmin(np.abs(curve.omega[side] - omega))])
            solution = fc.solve_harmonic_balance(
                structure, omega, GAP, harmonics=7, samples=1024, initial=curve.solution(start)
            )
            rows += [Row(f"contact, {name}, W = {omega:.6g}", size(solution), value, 5e-4)]
    folds = [point.omega for point in curve.bifurcations if point.kind == "fold"]
    max_contact_omega = float(curve.omega[sizes > 1.0].max())  # of the points, as pyHarm's
    return [
        *rows,
        Row("largest size", float(sizes[top]), 1.8409751402563967, 1e-3),
        Row("largest frequency with contact [rad/s]", max_contact_omega, 8.565621132183313, 1e-4),
        Row("smallest frequency of the way down [rad/s]", min(folds), 7.0225443436662625, None),
    ]


# --- ROSS: a rotor with a crack -------------------------------------------------------------------

INTERNAL, SOFTER, ECCENTRICITY, ANGLE = 0.08, 0.2, 0.05, 0.7
"""Damping in the shaft, loss of stiffness, and the unbalance's size and angle to the crack; mass,
stiffness and weight are 1."""


def rotor_orbit(speed: float, switched: bool) -> tuple[np.ndarray, np.ndarray]:
    """A period of x + i y seen from outside, by SciPy's DOP853 and Newton's method, 2048 samples.

    The crack opens with the shaft's deflection, or by the angle alone.
    """
    orders = np.arange(18)
    period = 2.0 * np.pi / speed

    def rate(t: float, flat: np.ndarray) -> np.ndarray:
        place, rate = flat.reshape(-1, 2).T
        turn = np.exp(1j * speed * t)
        component_across = (place / turn).real
        if switched:  # as in ROSS: the square wave's first 18 terms
            waves = (-1.0) ** orders * np.cos((2 * orders + 1) * speed * t) / (2 * orders + 1)
            opening = component_across * (0.5 + 2.0 / np.pi * waves.sum())
        else:
            opening = np.maximum(component_across, 0.0)
        force = 1.0 + ECCENTRICITY * speed**2 * turn * np.exp(1j * ANGLE) + SOFTER * opening * turn
        force = force - place - INTERNAL * (rate - 1j * speed * place)
        return np.stack([rate, force], axis=1).ravel()

    def flow(states: np.ndarray, instants: np.ndarray | None = None) -> np.ndarray:
        integration = solve_ivp(
            rate, (0.0, period), states.ravel(), "DOP853", instants, rtol=1e-10, atol=1e-12,
            max_step=0.3,
        )  # fmt: skip
        return np.asarray(integration.y).reshape(-1, 2, integration.y.shape[1])

    state, units = np.array([1.0 + 0j, 0j]), np.eye(4).view(complex)
    for _ in range(8):
        ends = flow(np.vstack([state, state + 1e-6 * units]))[:, :, -1]
        columns = ((ends[1:] - ends[0]) / 1e-6).view(float).T
        change = np.linalg.solve(columns - np.eye(4), (state - ends[0]).view(float))
        state = state + change.view(complex)
        if np.abs(change).max() < 1e-10:
            break
    time = np.arange(2048) * period / 2048
    return time, flow(state[None], time)[0, 0]


def balanced_rotor(speed: float) -> fc.PeriodicSolution:
    """The rotor in the frame that turns with it."""
    coriolis = 2.0 * speed * np.array([[0.0, -1.0], [1.0, 0.0]])
    unbalance = ECCENTRICITY * speed**2 * np.array([np.cos(ANGLE), np.sin(ANGLE)])
    rotor = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0 - SOFTER, 1.0]) - speed**2 * np.eye(2), gap=[-1.0, 0.0],
        force_cos=[1.0, 0.0], force_sin=[0.0, -1.0], force_mean=unbalance,
        damping=INTERNAL * np.eye(2) + coriolis,
    )  # fmt: skip
    return fc.solve_harmonic_balance(rotor, speed, fc.UnilateralPenalty(SOFTER), harmonics=60)


@cache
def rotor_motions(speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x + i y over a period: ours, by the same law, and with ROSS's switching."""
    time, law = rotor_orbit(speed, switched=False)
    rotating_motion = balanced_rotor(speed).displacement(time, [0, 1]) @ [1.0, 1j]
    return rotating_motion * np.exp(1j * speed * time), law, rotor_orbit(speed, switched=True)[1]


def draw_rotor(axes: Any) -> None:
    """Orbits, seen from outside."""
    for colour, speed in (("C0", 0.45), ("C1", 0.5)):
        ours, law, square_wave = rotor_motions(speed)
        axes.plot(ours.real, ours.imag, colour, label=f"W = {speed:g}, harmonic balance")
        axes.plot(law.real[::64], law.imag[::64], "k.", ms=4,
                  label="DOP853" if speed == 0.45 else None)  # fmt: skip
        axes.plot(square_wave.real, square_wave.imag, colour, ls=":", label="switched by the angle")
    axes.set(xlabel="x, along the weight", ylabel="y", aspect="equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")


@case(draw=draw_rotor)
def rotor_with_a_crack() -> list[Row]:
    """A Jeffcott rotor with a breathing crack, and ROSS's model of it.

    A disk on a shaft of stiffness k turns at W under its weight and an unbalance. With xi across
    the crack and eta along it, in the frame of the shaft, and damping in the shaft,

    m (xi'' - 2 W eta' - W^2 xi) + c xi' + k xi - dk max(xi, 0) = m g cos(W t) + m e W^2 cos(b),

    m (eta'' + 2 W xi' - W^2 eta) + c eta' + k eta = -m g sin(W t) + m e W^2 sin(b)

    (Gasch's hinge, J. Sound Vib. 160, 1993, 313-332, without the small loss along the crack) as
    matrices for `fc.Structure.from_matrices`. m = k = g = 1, dk = 0.2, c = 0.08, e = 0.05, b = 0.7.
    Damping by the surroundings is refused: its stiffness is not symmetric.

    Reference: m z'' + c (z' - i W z) + k z - dk max(xi, 0) e^(iWt) = m g + m e W^2 e^(i (W t + b)),
    z = (xi + i eta) e^(iWt), by SciPy's DOP853 and Newton's method; abs(z1) turns with the shaft,
    abs(z2) with twice its speed. Harmonic balance has H = 60.

    ROSS (Petrobras, `ross/faults/crack.py`) has a stiffness that depends on the shaft's angle
    alone, without contact: Gasch's square wave as 18 terms, K = (k0 + kc) / 2 + 2 / pi (k0 - kc)
    (cos W t - cos(3 W t) / 3 + ...). Both open at the same instants where the weight's deflection
    is larger than the vibration (W = 0.1), not near W = 0.5 (last rows, not judged).
    """
    rows = []
    for speed in (0.3, 0.45):
        ours, law, _ = rotor_motions(speed)
        our_spectrum, their_spectrum = (np.abs(np.fft.fft(motion)) / 2048 for motion in (ours, law))
        rows += [
            Row(f"W = {speed:g}: abs(z{k})", our_spectrum[k], their_spectrum[k], 1e-5)
            for k in range(4)
        ]
        rows += [Row(f"W = {speed:g}: abs(z-1)", our_spectrum[-1], their_spectrum[-1], 1e-5)]
    for speed, tolerance in ((0.1, 1e-3), (0.3, 0.01), (0.45, None), (0.5, None)):
        ours, _, switched_motion = rotor_motions(speed)
        relative_difference = float(np.abs(ours - switched_motion).max() / np.abs(ours).max())
        name = f"W = {speed:g}: difference to Gasch's switching"
        rows += [Row(name, relative_difference, 0.0, tolerance, absolute=True)]
    return rows
