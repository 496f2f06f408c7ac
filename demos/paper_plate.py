"""The paper's cracked plate: from the mesh to the breathing crack.

A square plate, 0.1 m wide and clamped along its bottom, has an edge crack at mid-height; a
horizontal force 100 N sin(2000 t) acts at its top right corner, just below the first resonance.
The plate obeys

    M u'' + C u' + K u + B lambda(g) = f(t),      g = B^T u,

and the crack breathes: the contact force lambda acts while its two faces touch. This demo follows
the paper of V. Kharyton and others, "Harmonic balance method implementation for crack
breathing process simulation" (about 2007): natural frequencies, linear solution, contact laws,
harmonic balance, direct integration, and the comparison of the two. At the paper's own data
(k = 1e11 N/m, xi = 0.001) the motion never settles; with k = 1e9 N/m and xi = 0.01 it does, and
both methods agree. The harmonic balance is solved twice: condensed onto the gap of the crack faces,
and by PETSc's SNES on the block system of all displacements.

    python demos/paper_plate.py [folder for the results]
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import fenics_crack as fc

SCENE = Path(__file__).with_suffix(".toml")
CORNER = (0.1, 0.1)  # m, where the force acts
SHARPNESS = 1e11  # 1/m, of the smoothed law: an open crack is pulled by k/(pi s) = 0.3 N
STEPS = 512  # least of central differences in a load period
MARGIN = 2.2  # times the stable number of steps: contact then creates little energy
SAMPLES = 1024  # of a period, for the block system and the condensed form beside it
KEPT = 200  # load periods at the end of an integration over which waves are averaged
START = 5  # load periods from rest that are drawn


def main(output: Path = Path("output/paper_plate"), *, periods: int = 500) -> dict[str, Any]:
    """Run the whole comparison; pictures, ParaView files and summary.json go to ``output``."""
    scene = fc.Scene.load(SCENE)
    plate = fc.build_structure(scene)
    uncracked = fc.build_structure(scene.replace({"crack": None, "contact": None}))
    agreeing = fc.build_structure(scene.replace({"damping.ratio": 0.01}))
    assert scene.contact is not None

    summary = {
        "natural_frequencies_rad_per_s": frequencies(plate, uncracked, output),
        "paper": vibration(
            plate,
            uncracked,
            scene.contact.stiffness or 0.0,
            scene.harmonic_balance.harmonics,
            output / "paper",
            periods,
            from_orbit=True,
        ),
        "agreeing": vibration(
            agreeing, uncracked, 1e9, 20, output / "agreeing", periods, from_orbit=False
        ),
    }
    laws: dict[str, Any] = {"penalty, k = 1e11 N/m": fc.UnilateralPenalty(1e11)}
    for sharpness in (1e8, 1e9, SHARPNESS):
        laws[f"smoothed, s = {sharpness:.0e} 1/m"] = fc.SmoothedPenalty(1e11, sharpness)
    closing = np.linspace(-2e-8, 2e-8, 401)
    fc.draw_laws(laws, closing, path=output / "fig4_contact_laws.png", title="Contact laws")
    (output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    answer(summary, output)
    return summary


def frequencies(
    plate: fc.Structure, uncracked: fc.Structure, output: Path
) -> dict[str, list[float]]:
    """Natural frequencies with the crack open, tied by k = 1e11 N/m, and absent; mode shapes."""
    modes = fc.solve_modes(plate, 6)
    fc.write_modes(modes, output / "modes.vtu")
    fc.draw_modes(modes, path=output / "modes.png")
    found = {
        "open": modes.omega,
        "tied": fc.solve_modes(plate.tied(1e11), 6).omega,
        "uncracked": fc.solve_modes(uncracked, 6).omega,
    }
    for name, omega in found.items():
        say(f"{name:>10}: " + "  ".join(f"{value:9.1f}" for value in omega) + "  rad/s")
    return {name: [round(float(value), 4) for value in omega] for name, omega in found.items()}


def vibration(
    plate: fc.Structure,
    uncracked: fc.Structure,
    stiffness: float,
    harmonics: int,
    output: Path,
    periods: int,
    from_orbit: bool,
) -> dict[str, Any]:
    """Solve one case by every method, draw it, and compare the methods.

    Direct integration starts on the orbit of the harmonic balance, to see whether it stays there,
    or from rest.
    """
    omega = 2000.0  # rad/s
    corner = plate.find_dof(CORNER, "x")
    penalty = fc.UnilateralPenalty(stiffness)
    smoothed = fc.SmoothedPenalty(stiffness, SHARPNESS)

    linear, linear_time = timed(lambda: fc.solve_linear(plate, omega))
    whole = fc.solve_linear(uncracked, omega)
    balanced, balance_time = timed(
        lambda: fc.solve_harmonic_balance(plate, omega, penalty, harmonics=harmonics)
    )
    stability = fc.floquet(plate, balanced)
    sampled, block = (  # the block system takes samples of the contact force
        fc.solve_harmonic_balance(
            plate, omega, penalty, harmonics=harmonics, samples=SAMPLES, form=form
        )
        for form in ("condensed", "block")
    )
    smooth, smooth_time = timed(
        lambda: fc.solve_harmonic_balance(plate, omega, smoothed, harmonics=harmonics)
    )
    stable = fc.stable_steps_per_period(plate, omega, penalty)
    steps = max(STEPS, 64 * round(MARGIN * stable / 64))
    history = fc.integrate_central_difference(
        plate,
        omega,
        penalty,
        periods=periods,
        steps_per_period=steps,
        initial=balanced if from_orbit else None,
        settle=1e-6,
        record_periods=KEPT,
        dofs=[corner],
        progress=sys.stderr.isatty(),
    )
    t = np.linspace(0.0, balanced.period, steps + 1)
    settled = history.settled < 1e-5
    used = slice(-1 if settled else -KEPT, None)
    folded = {
        "gap": history.by_period(history.gap[:, 0])[used],
        "corner": history.by_period(history.displacement([corner])[:, 0])[used],
    }
    waves = {
        "gap": (linear.gap(t)[:, 0], balanced.gap(t)[:, 0], smooth.gap(t)[:, 0], None),
        "corner": (
            *(each.displacement(t, [corner])[:, 0] for each in (linear, balanced, smooth)),
            whole.displacement(t, [uncracked.find_dof(CORNER, "x")])[:, 0],
        ),
    }
    draw_case(output, t, waves, folded, history, stiffness, harmonics)
    magnification = fc.write_period(balanced, output / "breathing_crack.pvd")

    draw_spectrum(output, history, folded["corner"], stiffness)
    spectrum = np.fft.rfft(folded["gap"].mean(axis=0)) / steps
    difference = folded["gap"].mean(axis=0) - balanced.gap(t[:-1])[:, 0]
    spread = float(folded["gap"].std(axis=0).max())
    gap = balanced.gap_coefficients[:, 0]
    say(f"k = {stiffness:.0e} N/m, H = {harmonics}: {balanced.status}, {balance_time:.2f} s")
    outcome = "settled" if settled else f"does not settle: {history.settled:.0%} change a period"
    say(f"  direct integration: {history.periods} periods, {history.seconds:.1f} s, {outcome}")
    return {
        "stiffness_N_per_m": stiffness,
        "harmonics": harmonics,
        "harmonic_balance": {
            "status": balanced.status,
            "errors": asdict(balanced.report),
            "error": balanced.report.total,
            "verdict": stability.verdict,
            "amplitude_m": balanced.amplitude(corner),
            "seconds": balance_time,
            "gap_mean_m": float(gap[0]),
            "gap_harmonic_1_m": float(np.hypot(gap[1], gap[2])),
            "largest_opening_m": float(-balanced.gap(t).min()),
            "largest_penetration_m": float(balanced.gap(t).max()),
        },
        "block_system": {
            "status": block.status,
            "amplitude_m": block.amplitude(corner),
            "condensed_amplitude_m": sampled.amplitude(corner),
            "difference": float(
                np.linalg.norm(block.displacement_coefficients - sampled.displacement_coefficients)
                / np.linalg.norm(sampled.displacement_coefficients)
            ),
        },
        "smoothed": {
            "status": smooth.status,
            "seconds": smooth_time,
            "largest_opening_m": float(-smooth.gap(t).min()),
        },
        "linear_seconds": linear_time,
        "linear": {
            "gap_m": float(abs(waves["gap"][0]).max()),
            "corner_m": float(abs(waves["corner"][0]).max()),
            "correlation": float(np.corrcoef(waves["gap"][0], waves["corner"][0])[0, 1]),
        },
        "uncracked_corner_m": float(abs(waves["corner"][3]).max()),
        "corner_m": [float(waves["corner"][1].min()), float(waves["corner"][1].max())],
        "start_up": start_up(plate, omega, penalty, steps, output),
        "direct_integration": {
            "settled": settled,
            "relative_change_last_period": history.settled,
            "periods": history.periods,
            "steps_per_period": steps,
            "energy_created_by_contact": history.created_energy,
            "seconds": history.seconds,
            "averaged_over_periods": len(folded["gap"]),
            "gap_mean_m": float(spectrum[0].real),
            "gap_harmonic_1_m": float(2.0 * abs(spectrum[1])),
            "largest_opening_m": float(-folded["gap"].min()),
            "largest_standard_deviation_m": spread,
            "corner_lines": [] if settled else lines_of(folded["corner"]),
            "corner_crossings_per_period": crossings(folded["corner"]),
        },
        "difference_of_methods": float(
            np.linalg.norm(difference) / np.linalg.norm(balanced.gap(t[:-1])[:, 0])
        ),
        "paraview_magnification": magnification,
    }


def start_up(
    plate: fc.Structure, omega: float, law: fc.UnilateralPenalty, steps: int, output: Path
) -> dict[str, float]:
    """Draw the first periods from rest, figure 2 of the paper, by both kinds of integration."""
    history, exact = (
        integrate(plate, omega, law, periods=START, steps_per_period=steps)
        for integrate in (fc.integrate_central_difference, fc.integrate_events)
    )
    fc.draw_waves(
        [
            fc.Wave("exact flow", exact.time, exact.gap[:, 0], "grey"),
            fc.Wave("central differences", history.time, history.gap[:, 0], "green", "--"),
        ],
        path=output / "fig2_start_up.png",
        title=f"Crack from rest ({law.stiffness:.0e} N/m)",
        quantity="closing of the crack faces",
        zero="crack faces touch",
        period=2.0 * np.pi / omega,
    )
    size = float(abs(exact.gap).max())
    return {
        "largest_opening_m": float(-exact.gap.min()),
        "difference_of_central_differences": float(abs(history.gap - exact.gap).max()) / size,
    }


def amplitudes(by_period: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return orders of the load's frequency and amplitudes [m] of a motion of many periods, with
    Hann's window."""
    motion = by_period.ravel()
    window = np.hanning(len(motion))
    lines = 2.0 * np.abs(np.fft.rfft(motion * window)) / window.sum()
    return np.arange(len(lines)) / len(by_period), lines


def lines_of(by_period: np.ndarray) -> list[float]:
    """Return orders, from 1 to 2, of the lines above 1 % of the largest; each is the highest within
    .05 of its place."""
    orders, lines = amplitudes(by_period)
    reach = max(round(0.05 * len(by_period)), 2)
    return [
        round(float(orders[i]), 3)
        for i in np.flatnonzero((orders >= 1.0) & (orders <= 2.0))
        if lines[i] == lines[i - reach : i + reach + 1].max() and lines[i] > 0.01 * lines[1:].max()
    ]


def crossings(by_period: np.ndarray) -> float:
    """Return how often a motion crosses zero upwards in a load period."""
    motion = by_period.ravel()
    return np.count_nonzero((motion[:-1] < 0.0) & (motion[1:] >= 0.0)) / len(by_period)


def draw_spectrum(
    output: Path, history: fc.TimeHistory, by_period: np.ndarray, stiffness: float
) -> None:
    """Draw the amplitudes of the corner over orders of the load's frequency."""
    if len(by_period) < KEPT // 2:
        return  # a motion that settled: its lines are the orders
    orders, lines = amplitudes(by_period)
    shown = orders < 4.0
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.semilogy(orders[shown], 1e6 * lines[shown], lw=0.8)
    axes.set(
        xlabel="order of the load's frequency [-]",
        ylabel="corner [µm]",
        title=f"Spectrum over {len(by_period)} of {history.periods} periods ({stiffness:.0e} N/m)",
    )
    figure.savefig(output / "spectrum.png")


def answer(summary: dict[str, Any], output: Path) -> None:
    """Print the answer: what was found for both settings, by which method, in which files."""
    cases = [summary[name] for name in ("paper", "agreeing")]
    balances, blocks, marches = (
        [case[name] for case in cases]
        for name in ("harmonic_balance", "block_system", "direct_integration")
    )
    unknown = [one["error"] >= 1.0 for one in balances]
    moved = [
        f"settled, gap within {case['difference_of_methods']:.1%}"
        if march["settled"]
        else f"irregular motion: {march['relative_change_last_period']:.0%} change a period"
        for case, march in zip(cases, marches, strict=True)
    ]
    open_crack = summary["natural_frequencies_rad_per_s"]["open"][0]
    rows = {
        "": ["the paper's: 1e11 N/m, 0.1 %", "agreeing: 1e9 N/m, 1 %"],
        "displacement at the force [um]": [f"{1e6 * one['amplitude_m']:.4f}" for one in balances],
        "largest opening [um]": [f"{1e6 * one['largest_opening_m']:.4f}" for one in balances],
        "estimated error of the gap": [
            "unknown" if lost else f"{one['error']:.2%}"
            for lost, one in zip(unknown, balances, strict=True)
        ],
        "verdict": [one["verdict"] for one in balances],
        "block system, condensed [um]": [
            f"{1e6 * one['amplitude_m']:.6f}, {1e6 * one['condensed_amplitude_m']:.6f}"
            for one in blocks
        ],
        "their relative difference": [f"{one['difference']:.1e}" for one in blocks],
        "direct integration": moved,
    }
    say(f"first natural frequency, crack open: {open_crack:.1f} rad/s; the paper has 2300 rad/s")
    for name, (first, second) in rows.items():
        say(f"{name:<31} {first:<37} {second}")
    names = sorted({path.name for path in output.glob("*/fig*.png")})
    say(f"{output}/: modes.png, fig4_contact_laws.png; paper/, agreeing/: {', '.join(names)}")


def draw_case(
    output: Path,
    t: np.ndarray,
    waves: dict[str, Any],
    folded: dict[str, np.ndarray],
    history: fc.TimeHistory,
    stiffness: float,
    harmonics: int,
) -> None:
    """Figures 2, 3 and 5 to 8 of the paper for one case."""
    case = f"k = {stiffness:.0e} N/m, H = {harmonics}"
    period = float(t[-1])
    quantity = {"gap": "closing of the crack faces", "corner": "horizontal displacement"}
    zero = {"gap": "crack faces touch", "corner": None}
    shown = slice(-min(20, len(folded["gap"])) * history.steps_per_period, None)
    fc.draw_waves(
        [fc.Wave("central differences", history.time[shown], history.gap[shown, 0], "green")],
        path=output / "fig2_direct_integration.png",
        title=f"Crack, the last periods of the direct integration ({case})",
        quantity=quantity["gap"],
        zero=zero["gap"],
    )
    fc.draw_waves(
        [
            fc.Wave("closing of the crack faces", t, waves["gap"][0], "orange"),
            fc.Wave("force point: horizontal displacement", t, waves["corner"][0], "blue", "--"),
        ],
        path=output / "fig3_linear.png",
        title="Linear solution: the crack faces pass through each other",
        quantity="displacement",
        period=period,
    )
    for name, number, place in (("gap", 5, "Crack"), ("corner", 6, "Force point")):
        linear, balanced, smooth, whole = waves[name]
        curves = [
            fc.Wave("harmonic balance, penalty", t, balanced, "blue"),
            fc.Wave("harmonic balance, smoothed", t, smooth, "orange", ":"),
            fc.Wave("linear, crack always open", t, linear, "grey", "--"),
        ]
        if whole is not None:
            curves.append(fc.Wave("uncracked", t, whole, "pink", "-."))
        fc.draw_waves(
            curves,
            path=output / f"fig{number}_nonlinear_{name}.png",
            title=f"{place}: nonlinear solution ({case})",
            quantity=quantity[name],
            period=period,
            zero=zero[name],
        )
        mean = np.append(folded[name].mean(axis=0), folded[name][:, 0].mean())
        deviation = np.append(folded[name].std(axis=0), folded[name][:, 0].std())
        count = len(folded[name])
        label = "central differences"
        if count > 1:
            label += f": mean of {count} periods, band: ± standard deviation"
        fc.draw_waves(
            [
                fc.Wave("harmonic balance", t, balanced, "blue"),
                fc.Wave(label, t, mean, "green", "--", deviation),
            ],
            path=output / f"fig{number + 2}_comparison_{name}.png",
            title=f"{place}: both methods ({case})",
            quantity=quantity[name],
            period=period,
            zero=zero[name],
        )


def timed(task: Callable[[], Any]) -> tuple[Any, float]:
    """Result of a task and its wall-clock time [s]."""
    started = time.perf_counter()
    result = task()
    return result, time.perf_counter() - started


def say(text: str) -> None:
    """Print at once."""
    print(text, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/paper_plate"))
