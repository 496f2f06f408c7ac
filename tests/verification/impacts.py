"""Impacts and stops."""

from functools import cache
from typing import Any

import numpy as np
from book import Row, case, label
from free_motions import free_frequency
from helpers import dense_matrices, free_bar, heavy_mass
from scipy.integrate import simpson, solve_ivp

import fenics_crack as fc

STIFF = fc.UnilateralPenalty(1e6)


def exactly(
    structure: fc.Structure,
    law: fc.UnilateralPenalty,
    start: tuple[np.ndarray, np.ndarray],
    duration: float,
    steps: int = 16,
) -> fc.TimeHistory:
    """The free motion for a time [s] from one switching instant to the next."""
    return fc.integrate_events(
        structure, 2.0 * np.pi / duration, law, periods=1, steps_per_period=steps, initial=start
    )


@cache
def release() -> fc.TimeHistory:
    """0.04 s from the first touch, by steps of 5 microseconds."""
    return fc.integrate_exponential(
        heavy_mass(), 2.0 * np.pi / 0.04, STIFF, periods=1, steps_per_period=8000,
        initial=(np.zeros(1), np.ones(1)),
    )  # fmt: skip


def draw_release(axes: Any) -> None:
    """Force over time."""
    frequency = np.sqrt(1.01e6 / 100.0)
    force = 1e6 / frequency * np.sin(frequency * release().time)
    exact = np.where(release().time < np.pi / frequency, force, 0.0)
    axes.plot(1e3 * release().time, exact / 1e3, label="closed form")
    axes.plot(
        1e3 * release().time[::200], release().contact_force[::200, 0] / 1e3, "kx",
        label="exponential steps",
    )  # fmt: skip
    label(axes, xlabel="t [ms]", ylabel="contact force [kN]", xlim=(0.0, 40.0))


@case(draw=draw_release)
def contact_release() -> list[Row]:
    """A mass released by a stop.

    A mass of 100 kg on a spring of 1e4 N/m flies at 1 m/s into a stop of 1e6 N/m without clearance.
    With w^2 = (1e4 + 1e6) / 100 it stays for pi / w, with a largest force of 1e6 / w and an impulse
    of 2e6 / w^2.

    Reference: closed form, as in code_aster's test SDND101 (0.03126 s, 9950 N, 198.02 N s); beside
    the exact flow, and exponential steps of 5 microseconds.
    """
    frequency = np.sqrt(1.01e6 / 100.0)
    contact = np.pi / frequency
    start = (np.zeros(1), np.ones(1))
    lower_time, upper_time = 0.9 * contact, 1.1 * contact
    for _ in range(45):  # the instant of release
        middle = 0.5 * (lower_time + upper_time)
        in_contact = exactly(heavy_mass(), STIFF, start, middle).final_state[0][0] > 0.0
        lower_time, upper_time = (middle, upper_time) if in_contact else (lower_time, middle)
    time = np.linspace(0.0, (1.0 - 1e-10) * contact, 2001)
    flown = exactly(heavy_mass(), STIFF, start, time[-1] + time[1], steps=len(time))
    force = flown.contact_force[:, 0]
    steps, step = release().contact_force[:, 0], release().time[1]
    rebound_speed = exactly(heavy_mass(), STIFF, start, 1.01 * contact).final_state[1][0]
    exact_speed = -np.cos(10.0 * 0.01 * contact)
    return [
        Row("contact lasts [s], exact flow", 0.5 * (lower_time + upper_time), contact, 1e-9),
        Row("largest force [N], exact flow", force.max(), 1e6 / frequency, 1e-9),
        Row("impulse [N s], exact flow", simpson(force, x=time), 2e6 / frequency**2, 1e-9),
        Row("speed afterwards, share of the first", rebound_speed, exact_speed, 1e-9),
        Row("contact lasts [s], steps", np.count_nonzero(steps) * step, contact, 1e-3),
        Row("largest force [N], steps", steps.max(), 1e6 / frequency, 1e-4),
        Row("impulse [N s], steps", steps.sum() * step, 2e6 / frequency**2, 1e-4),
    ]


@cache
def shocks() -> fc.TimeHistory:
    """1.3 s of the mass between its shocks, every 0.0325 ms."""
    return fc.integrate_events(
        heavy_mass(), 2.0 * np.pi / 1.3, STIFF, periods=1, steps_per_period=40000,
        initial=(np.zeros(1), np.ones(1)),
    )  # fmt: skip


def draw_shocks(axes: Any) -> None:
    """Force over time."""
    axes.plot(shocks().time, shocks().contact_force[:, 0] / 1e3)
    axes.set(xlabel="t [s]", ylabel="contact force [kN]", xlim=(0.0, 1.3))


@case(draw=draw_shocks)
def several_shocks() -> list[Row]:
    """A mass that meets a stop again and again.

    The same mass and stop, without losses: shocks repeat after pi / 100.4988 + pi / 10 s.

    Reference: closed form; code_aster's test SDND101 gives 0.01563 s for the first largest force
    and 0.361 s for the second one. `fc.integrate_events`, 1.3 s.
    """
    force, time = shocks().contact_force[:, 0], shocks().time
    contact, flight = np.pi / np.sqrt(1.01e4), np.pi / 10.0
    rows = []
    for shock in range(4):
        middle = shock * (contact + flight) + 0.5 * contact
        near_steps = np.flatnonzero(np.abs(time - middle) < 0.6 * contact)
        top = near_steps[np.argmax(force[near_steps])]
        parabola = np.polyfit(time[top - 9 : top + 10] - middle, force[top - 9 : top + 10], 2)
        instant = middle - 0.5 * parabola[1] / parabola[0]
        impulse = simpson(force[near_steps], x=time[near_steps])
        rows += [
            Row(f"shock {shock + 1}: instant of the largest force [s]", instant, middle, 1e-6),
            Row(f"shock {shock + 1}: largest force [N]", force[top], 9950.371902, 1e-5),
            Row(f"shock {shock + 1}: impulse [N s]", impulse, 198.0198020, 1e-5),
        ]
    rows += [Row("instant of the second, as published [s]", rows[3].ours, 0.361, 1e-3)]
    return rows


def free_motion(energy: float) -> float:
    """Frequency [Hz] of m = 1 on k = 10 that meets a stop of 50 beyond 0.01 [J]: closed form.

    Free for 2 (pi - arccos(d / A)) / w1 of a period, A = sqrt(2 E / k). In contact x oscillates
    about d kc / (k + kc) with w2^2 = k + kc, begins at d and turns where its speed is zero.
    """
    stiffness, stop, clearance = 10.0, 50.0, 0.01
    free_phase = np.pi - np.arccos(clearance / np.sqrt(2.0 * energy / stiffness))
    omega_in_contact = np.sqrt(stiffness + stop)
    speed = np.sqrt(2.0 * energy - stiffness * clearance**2)
    rest = clearance * stop / (stiffness + stop)
    contact_phase = np.arctan2(speed / omega_in_contact, clearance - rest)
    return float(
        1.0 / (2.0 * free_phase / np.sqrt(stiffness) + 2.0 * contact_phase / omega_in_contact)
    )


def balanced(energy: float) -> float:
    """The same by 60 harmonics."""
    structure, law = clearance_oscillator(), fc.UnilateralPenalty(50.0)
    return free_frequency(structure, law, energy, harmonics=60) / (2.0 * np.pi)


ENERGIES = (0.00650108331626, 0.00658129654238)


def clearance_oscillator() -> fc.Structure:
    """m = 1, k = 10 and a clearance of 0.01."""
    unit = np.ones((1, 1))
    return fc.Structure.from_matrices(unit, 10.0 * unit, gap=unit, clearance=0.01)


def draw_free_motion(axes: Any) -> None:
    """Frequency over the energy, and the published points."""
    energies = np.geomspace(5e-4, ENERGIES[1], 200)
    exact = [free_motion(e) for e in energies]
    axes.semilogx([4e-4, *energies], [exact[0], *exact], label="closed form")
    energies = np.geomspace(4e-4, ENERGIES[1], 30)
    axes.semilogx(energies, [balanced(e) for e in energies], "o", ms=3, label="balanced, H = 60")
    axes.plot(ENERGIES[0], 0.64621695, "rx", ms=8, label='published as "analytic"')
    label(axes, xlabel="energy [J]", ylabel="frequency [Hz]")


@case(draw=draw_free_motion)
def free_motion_with_a_clearance() -> list[Row]:
    """Free motion with a clearance: a published value is wrong.

    A mass of 1 on a spring of 10 meets one of 50 beyond a clearance of 0.01; its frequency depends
    on its energy E (code_aster's test SDND122).

    Reference: closed form. The mass is free for 2 (pi - arccos(d / A)) / w1 of a period, A = sqrt(2
    E / k), and in contact for 2 arctan2(v / w2, d - d kc / (k + kc)) / w2, v = sqrt(2 E - k d^2).
    Beside it: the motion balanced with 60 harmonics (`tests/verification/free_motions.py`), and the
    exact flow, which has to come back after one such period.

    For E = 0.00650108331626 a value of 0.64621695 Hz is published as analytic, 6e-4 away. It takes
    sqrt(2 E / (k + kc)) for the contact's amplitude and drops a term under the root, which is (2 E
    - k kc d^2 / (k + kc)) / (k + kc). The mass has not come back after such a period.
    """
    law, structure = fc.UnilateralPenalty(50.0), clearance_oscillator()
    rows = []
    for energy, value in zip(ENERGIES, (0.64663104, 0.64701472), strict=True):
        rows += [Row(f"E = {energy:.6g} J: balanced, H = 60 [Hz]", balanced(energy), value, 1e-6)]
        rows += [Row(f"E = {energy:.6g} J: closed form [Hz]", free_motion(energy), value, 1e-8)]
    energy, published_hertz = ENERGIES[0], 0.64621695
    start = np.array([np.sqrt(2.0 * energy / 10.0)])
    for name, frequency, tolerance in (
        ("of the closed form", free_motion(energy), 1e-12),
        ("published as analytic", published_hertz, None),
    ):  # fmt: skip
        end_velocity = exactly(structure, law, (-start, np.zeros(1)), 1.0 / frequency).final_state[
            1
        ][0]
        speed = float(end_velocity / np.sqrt(2.0 * energy))
        name = f"speed after a period {name}, of the largest"
        rows += [Row(name, speed, 0.0, tolerance, absolute=True)]
    rest, omega_in_contact = 0.01 * 50.0 / 60.0, np.sqrt(60.0)
    free_phase = np.pi - np.arccos(0.01 / np.sqrt(2.0 * energy / 10.0))
    contact_phase = np.arccos((0.01 - rest) / np.sqrt(2.0 * energy / 60.0))
    shortened_hertz = float(0.5 / (free_phase / np.sqrt(10.0) + contact_phase / omega_in_contact))
    rows += [Row("without the term, as published [Hz]", shortened_hertz, published_hertz, 1e-8)]
    rows += [Row("closed form, as published [Hz]", free_motion(energy), published_hertz, None)]
    return rows


@cache
def flying_bar() -> fc.TimeHistory:
    """200 linear elements reduced to 100 modes, 100 exponential steps in 1.4e-4 s."""
    bar, modes = free_bar(200), 100
    structure = fc.reduce_structure(bar, modes=modes, method="massless")
    speed = np.zeros(structure.n_dofs)
    speed[:modes] = structure.basis.T @ dense_matrices(bar)[0] @ np.full(201, 100.0)
    return fc.integrate_exponential(
        structure, 2.0 * np.pi / 1.4e-4, fc.UnilateralConstraint(), periods=1,
        steps_per_period=100, initial=(np.zeros(structure.n_dofs), speed),
    )  # fmt: skip


def draw_bar(axes: Any) -> None:
    """Pressure over time."""
    axes.plot([0.0, 20.0, 20.0, 100.0, 100.0, 140.0], [0.0, 0.0, 4.0, 4.0, 0.0, 0.0],
              label="wave equation")  # fmt: skip
    force = flying_bar().contact_force[:, 0]
    axes.plot(1e6 * flying_bar().time, force / 1e9, "k.", ms=4, label="200 elements, 100 modes")
    axes.set(xlabel="t [µs]", ylabel="pressure at the wall [GPa]", xlim=(0.0, 140.0))
    axes.legend(loc="lower center")


@case(draw=draw_bar)
def bar_against_a_wall() -> list[Row]:
    """A bar against a rigid wall.

    A bar of 0.2 m, E = 2e11 Pa, density 8000 kg/m^3 and without lateral contraction flies at 100
    m/s to a rigid wall 2 mm away (code_aster's test SDNV100).

    Reference: the wave equation. With c = 5000 m/s the end touches at 2e-5 s, presses with rho c v
    = 4e9 Pa, and leaves at 1e-4 s; the whole bar then flies back at 100 m/s. Here: 200 linear
    elements, 100 modes with crack faces without mass, no penetration, 100 exponential steps in
    1.4e-4 s.
    """
    history = flying_bar()
    force, step = history.contact_force[:, 0], history.time[1]
    closed_steps = np.flatnonzero(force > 0.0)
    momentum_row = history.structure.basis.T @ dense_matrices(free_bar(200))[0].sum(axis=0)
    rebound_speed = -float(momentum_row @ history.final_state[1][: len(momentum_row)]) / 1600.0
    return [
        Row("touches at [s]", closed_steps[0] * step, 2e-5, step, absolute=True),
        Row("leaves at [s]", (closed_steps[-1] + 1) * step, 1e-4, 0.015),
        Row("steps with a break of the contact",
            closed_steps[-1] - closed_steps[0] + 1 - len(closed_steps), 0, 0.0, absolute=True),
        Row("mean pressure [Pa]", force[closed_steps].mean(), 4e9, 0.02),
        Row("impulse [N s]", force.sum() * step, 3.2e5, 0.01),
        Row("speed back, mean of the bar [m/s]", rebound_speed, 100.0, 0.02),
        Row("largest penetration, share of the clearance", max(history.gap.max(), 0.0) / 2e-3, 0.0,
            1e-9, absolute=True),
    ]  # fmt: skip


BETWEEN = {
    "mass": np.diag([1.0, 2.0]),
    "stiffness": np.array([[2.0, -1.0], [-1.0, 3.0]]),
    "damping": np.array([[0.1, -0.03], [-0.03, 0.12]]),
    "load": np.array([0.7, 0.0]),
}
SIDES, CLEARANCE, STIFFNESS, OMEGA = (1.0, -1.0), (0.3, 0.4), 5.0, 0.8
"""Mass 1 has a stop of 5 on either side, mass 2 moves between none."""


def orbit_between_stops() -> tuple[np.ndarray, np.ndarray]:
    """4096 samples (time, mass) of the periodic motion, by SciPy's DOP853 and Newton's method."""
    inverse = np.linalg.inv(BETWEEN["mass"])
    period = 2.0 * np.pi / OMEGA

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        u, v = state[:2], state[2:]
        force = BETWEEN["load"] * np.cos(OMEGA * t)
        force = force - BETWEEN["stiffness"] @ u - BETWEEN["damping"] @ v
        for side, clearance in zip(SIDES, CLEARANCE, strict=True):
            force[0] -= side * STIFFNESS * max(side * u[0] - clearance, 0.0)
        return np.concatenate([v, inverse @ force])

    def flow(state: np.ndarray, instants: np.ndarray | None = None) -> np.ndarray:
        integration = solve_ivp(
            rate, (0.0, period), state, "DOP853", instants, rtol=1e-10, atol=1e-12, max_step=0.2
        )
        return integration.y

    state = np.zeros(4)
    for _ in range(3):
        state = flow(state)[:, -1]
    for _ in range(8):
        end = flow(state)[:, -1]
        columns = [(flow(state + 1e-6 * unit)[:, -1] - end) / 1e-6 for unit in np.eye(4)]
        change = np.linalg.solve(np.transpose(columns) - np.eye(4), state - end)
        state = state + change
        if np.abs(change).max() < 1e-10:
            break
    time = np.arange(4096) * period / 4096
    return time, flow(state, time)[:2].T


@cache
def between_stops() -> tuple[fc.PeriodicSolution, np.ndarray, np.ndarray]:
    """Ours with H = 60, and the other's time and motion."""
    gap = np.zeros((2, 2))
    gap[0] = SIDES
    structure = fc.Structure.from_matrices(
        BETWEEN["mass"], BETWEEN["stiffness"], gap=gap, force_cos=BETWEEN["load"],
        damping=BETWEEN["damping"], clearance=np.array(CLEARANCE),
    )  # fmt: skip
    law = fc.UnilateralPenalty(STIFFNESS)
    solution = fc.solve_harmonic_balance(structure, OMEGA, law, harmonics=60)
    return solution, *orbit_between_stops()


def draw_between_stops(axes: Any) -> None:
    """One period of both masses, with the stops."""
    solution, time, motion = between_stops()
    ours = solution.displacement(time, [0, 1])
    for mass in (0, 1):
        axes.plot(time, ours[:, mass], label=f"mass {mass + 1}, harmonic balance")
    axes.plot(time[::128], motion[::128], "k.", ms=4, label=["DOP853", None])
    for side, clearance in zip(SIDES, CLEARANCE, strict=True):
        axes.axhline(side * clearance, color="0.6", ls="--", lw=1)
    axes.set(xlabel="t", ylabel="displacement", xlim=(0.0, time[-1]))
    axes.legend(loc="upper center", fontsize="small")


@case(draw=draw_between_stops)
def stops_on_both_sides() -> list[Row]:
    """Two masses, one of them between two stops.

    M = diag(1, 2), K = [[2, -1], [-1, 3]], C = [[0.1, -0.03], [-0.03, 0.12]], a load 0.7 cos(0.8 t)
    on mass 1, which meets springs of 5 at 0.3 on one side and at 0.4 on the other.

    Reference: SciPy's DOP853 with tolerance 1e-10 and Newton's method on the state after a period.
    Harmonic balance has H = 60.
    """
    solution, time, motion = between_stops()
    ours = solution.displacement(time, [0, 1])
    rows = []
    for mass in (0, 1):
        name = f"mass {mass + 1}"
        spectrum = np.fft.rfft(motion[:, mass]) / len(time)
        our_spectrum = np.fft.rfft(ours[:, mass]) / len(time)
        rows += [Row(f"{name}: mean", our_spectrum[0].real, spectrum[0].real, 1e-4)]
        for k in (1, 2, 3):
            rows += [
                Row(f"{name}: abs(X{k})", 2 * abs(our_spectrum[k]), 2 * abs(spectrum[k]), 1e-4)
            ]
        for word, extreme in (("largest", np.max), ("smallest", np.min)):
            our_extreme, value = extreme(ours[:, mass]), extreme(motion[:, mass])
            rows += [Row(f"{name}: {word} displacement", float(our_extreme), float(value), 1e-4)]
    return rows
