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
both methods agree. Beside both stands the exact periodic orbit, which says how far off the
harmonics are. At the paper's data the harmonic balance is solved twice: condensed onto the gap of
the crack faces, and by PETSc's SNES on the block system of all displacements.

    python demos/paper_plate.py [folder for the results]
"""

import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import fenics_crack as fc
from fenics_crack.draw.vtk import import_pyvista, off_screen_plotter

SCENE = Path(__file__).with_suffix(".toml")
OMEGA = 2000.0  # rad/s, of the load
STIFFNESS = 1e11  # N/m, of the paper
CORNER = (0.1, 0.1)  # m, where the force acts
SHARPNESS = 1e11  # 1/m, of the smoothed law: an open crack is pulled by k/(pi s) = 0.3 N
STEPS = 512  # least of central differences in a load period
MARGIN = 2.2  # times the stable number of steps: contact then creates little energy
SAMPLES = 1024  # of a period, for the block system and the condensed form beside it
START_HARMONICS = 40  # harmonics of the solution from which the exact orbit is sought
AVERAGED_PERIODS = 100  # load periods at the end of an integration over which waves are averaged
DRAWN_PERIODS = 5  # load periods from rest that are drawn
MODES = 3  # mode shapes that are drawn; the paper names the first three
PANEL_NAMES = "crack", "force point, horizontal"
QUANTITIES: dict[str, dict[str, Any]] = {
    "gap": {"quantity": "closing of the crack faces", "zero": "crack faces touch"},
    "corner": {"quantity": "displacement"},
}
LIGHT_BLUE = "#8fbbe8"  # of wide lines below thin ones


def main(output: Path = Path("output/paper_plate"), *, periods: int = 200) -> dict[str, Any]:
    """Run the whole comparison; pictures, ParaView files and summary.json go to ``output``."""
    scene = fc.Scene.load(SCENE)
    plate = fc.build_structure(scene)
    uncracked = fc.build_structure(scene.replace({"crack": None, "contact": None}))
    damped_plate = fc.build_structure(scene.replace({"damping.ratio": 0.01}))
    draw_plate(plate, output / "fig1_plate.png")
    summary: dict[str, Any] = {
        "dofs": plate.n_dofs,
        "duplicated_node_pairs": plate.n_pairs,
        "natural_frequencies_rad_per_s": frequencies(plate, uncracked, output),
    }
    for name, case, stiffness, harmonics in (
        ("paper", plate, STIFFNESS, scene.harmonic_balance.harmonics),
        ("agreeing", damped_plate, 1e9, 20),
    ):
        summary[name] = vibration(case, uncracked, stiffness, harmonics, output / name, periods)
    solution = fc.solve_harmonic_balance(plate, OMEGA, fc.UnilateralPenalty(STIFFNESS))
    summary["paper"] |= {
        "block_system": block_system(plate),
        "mesh": finer_mesh(scene, solution),
        "paraview_magnification": fc.write_period(
            solution, output / "paper/breathing_crack.pvd", material=scene.material
        ),
    }
    draw_crack(solution, output / "paper", summary["paper"]["paraview_magnification"])
    laws: dict[str, Any] = {"penalty, k = 1e11 N/m": fc.UnilateralPenalty(STIFFNESS)}
    for sharpness in (1e8, 1e9, SHARPNESS):
        laws[f"smoothed, s = {sharpness:.0e} 1/m"] = fc.SmoothedPenalty(STIFFNESS, sharpness)
    figure, [axes] = panels("Contact laws")
    fc.draw_laws(laws, np.linspace(-2e-8, 2e-8, 401), axes=axes)
    save(figure, output / "fig4_contact_laws.png")
    (output / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    answer(summary, output)
    return summary


def frequencies(
    plate: fc.Structure, uncracked: fc.Structure, output: Path
) -> dict[str, list[float]]:
    """Natural frequencies with the crack open, bonded by k = 1e11 N/m, and absent; mode shapes."""
    modes = fc.solve_modes(plate, 6)
    fc.write_modes(modes, output / "modes.vtu")
    figure = Figure(figsize=(8.0, 2.9), dpi=110)
    axes = figure.subplots(1, MODES, gridspec_kw={"left": 0.01, "right": 0.99, "bottom": 0.02})
    fc.draw_modes(modes, numbers=range(1, MODES + 1), axes=axes)
    save(figure, output / "modes.png")
    omegas = {
        "open": modes.omega,
        "bonded": fc.solve_modes(plate.tied(STIFFNESS), 6).omega,
        "uncracked": fc.solve_modes(uncracked, 6).omega,
    }
    for name, omega in omegas.items():
        say(f"{name:>10}: " + "  ".join(f"{value:9.1f}" for value in omega) + "  rad/s")
    return {name: [round(float(value), 4) for value in omega] for name, omega in omegas.items()}


def vibration(
    plate: fc.Structure,
    uncracked: fc.Structure,
    stiffness: float,
    harmonics: int,
    output: Path,
    periods: int,
) -> dict[str, Any]:
    """Solve one case by every method, draw it, and compare the methods.

    Where the orbit is unstable, direct integration starts on the harmonic balance, to see where the
    motion goes, else from rest.
    """
    corner = plate.find_dof(CORNER, "x")
    penalty = fc.UnilateralPenalty(stiffness)
    linear = fc.solve_linear(plate, OMEGA)
    solution, seconds = timed(
        lambda: fc.solve_harmonic_balance(plate, OMEGA, penalty, harmonics=harmonics)
    )
    smoothed_solution = fc.solve_harmonic_balance(
        plate, OMEGA, fc.SmoothedPenalty(stiffness, SHARPNESS), harmonics=harmonics
    )
    start_solution = fc.solve_harmonic_balance(plate, OMEGA, penalty, harmonics=START_HARMONICS)
    orbit = fc.shoot(plate, start_solution)
    growth = float(abs(orbit.multipliers[0]))
    steps = max(STEPS, 64 * round(MARGIN * fc.stable_steps_per_period(plate, OMEGA, penalty) / 64))
    history = fc.integrate_central_difference(
        plate,
        OMEGA,
        penalty,
        periods=periods,
        steps_per_period=steps,
        initial=solution if growth > 1.0 else None,
        settle=1e-6,
        record_periods=AVERAGED_PERIODS,
        dofs=[corner],
        progress=sys.stderr.isatty(),
    )
    t = np.linspace(0.0, solution.period, steps + 1)
    settled = history.settled < 1e-5
    averaged_periods = slice(-1 if settled else -AVERAGED_PERIODS, None)
    periods_of = {
        "gap": history.by_period(history.gap[:, 0])[averaged_periods],
        "corner": history.by_period(history.displacement([corner])[:, 0])[averaged_periods],
    }
    motions = linear, solution, smoothed_solution
    waves = {
        "gap": [motion.gap(t)[:, 0] for motion in motions],
        "corner": [motion.displacement(t, [corner])[:, 0] for motion in motions],
    }
    uncracked_solution = fc.solve_linear(uncracked, OMEGA)
    uncracked_corner = uncracked.find_dof(CORNER, "x")
    waves["corner"].append(uncracked_solution.displacement(t, [uncracked_corner])[:, 0])
    case = f"k = {stiffness:.0e} N/m, H = {harmonics}"
    if stiffness == STIFFNESS:
        draw_solution(output, case, t, waves)
    draw_comparison(output, case, t, waves, periods_of)
    if not settled:
        draw_spectrum(output, periods_of["corner"], case)
    say(f"{case}: {solution.status}")
    outcome = "settles" if settled else f"does not settle: {history.settled:.0%} change a period"
    say(f"  direct integration: {history.periods} periods, {history.seconds:.1f} s, {outcome}")

    wave, mean = waves["gap"][1], periods_of["gap"].mean(axis=0)
    exact, size = orbit.gap_at(t)[:, 0], float(np.linalg.norm(waves["gap"][1][:-1]))
    coefficients = solution.gap_coefficients[:, 0]
    ranges = 0.5 * np.ptp(periods_of["corner"], axis=1)
    return {
        "stiffness_N_per_m": stiffness,
        "harmonics": harmonics,
        "harmonic_balance": {
            "status": solution.status,
            "iterations": solution.iterations,
            "amplitude_m": solution.amplitude(corner),
            "seconds": seconds,
            "gap_mean_m": float(coefficients[0]),
            "gap_harmonic_1_m": float(np.hypot(*coefficients[1:3])),
            "largest_opening_m": float(-wave.min()),
            "largest_penetration_m": float(wave.max()),
            "error_of_amplitude": solution.amplitude(corner) / orbit.amplitude(corner) - 1.0,
            "error_of_opening": float(wave.min() / exact.min()) - 1.0,
            "error_of_gap": float(np.linalg.norm(wave - exact) / np.linalg.norm(exact)),
        },
        "exact_orbit": {
            "amplitude_m": orbit.amplitude(corner),
            "largest_opening_m": float(-exact.min()),
            "residual": orbit.residual,
            "contacts_in_a_period": orbit.n_events // 2,
            "growth_in_a_period": growth,
            "verdict": "stable" if growth < 1.0 else "unstable",
        },
        "smoothed": {
            "status": smoothed_solution.status,
            "largest_opening_m": float(-waves["gap"][2].min()),
        },
        "linear": {
            "gap_m": float(abs(waves["gap"][0]).max()),
            "corner_m": float(abs(waves["corner"][0]).max()),
            "correlation": float(np.corrcoef(waves["gap"][0], waves["corner"][0])[0, 1]),
        },
        "uncracked_corner_m": float(abs(waves["corner"][3]).max()),
        "corner_m": [float(waves["corner"][1].min()), float(waves["corner"][1].max())],
        "start_up": start_up(plate, penalty, steps, output),
        "direct_integration": {
            "settled": settled,
            "relative_change_last_period": history.settled,
            "periods": history.periods,
            "steps_per_period": steps,
            "energy_created_by_contact": history.created_energy,
            "seconds": history.seconds,
            "averaged_over_periods": len(periods_of["gap"]),
            "gap_mean_m": float(mean.mean()),
            "amplitudes_m": [float(ranges.min()), float(ranges.max())],
            "largest_opening_m": float(-periods_of["gap"].min()),
            "largest_standard_deviation_m": float(periods_of["gap"].std(axis=0).max()),
            "corner_lines": [] if settled else lines_of(periods_of["corner"]),
            "corner_crossings_per_period": crossings(periods_of["corner"]),
        },
        "difference_of_methods": float(np.linalg.norm(mean - wave[:-1])) / size,
    }


def block_system(plate: fc.Structure) -> dict[str, Any]:
    """Solve the paper's data by PETSc's SNES on the block system, and condensed by the same samples
    of the contact force, both from the solution with a contact a hundred times softer."""
    softer = fc.solve_harmonic_balance(plate, OMEGA, fc.UnilateralPenalty(STIFFNESS / 100.0))
    (block_solution, seconds), (condensed_solution, _) = (
        timed(
            lambda form=form: fc.solve_harmonic_balance(
                plate,
                OMEGA,
                fc.UnilateralPenalty(STIFFNESS),
                samples=SAMPLES,
                initial=softer,
                form=form,
            )
        )
        for form in ("block", "condensed")
    )
    reference = condensed_solution.displacement_coefficients
    change = block_solution.displacement_coefficients - reference
    n_modal = 2 * block_solution.harmonics * plate.n_dofs  # all modes are damped; no mean
    return {
        "status": block_solution.status,
        "iterations": block_solution.iterations,
        "unknowns": reference.size + n_modal,
        "seconds": seconds,
        "amplitude_m": block_solution.amplitude(plate.find_dof(CORNER, "x")),
        "difference": float(np.linalg.norm(change) / np.linalg.norm(reference)),
    }


def finer_mesh(scene: fc.Scene, coarse_solution: fc.PeriodicSolution) -> dict[str, float]:
    """Return by how much elements half as long enlarge the motion at the force, in all, and by what
    the force alone adds in the corner with each halving.

    A force F in a corner of the angle a moves it by F/(E t) (1/(a + sin a) + 1/(a - sin a))
    ln(1/h):
    Timoshenko, Goodier, Theory of Elasticity, sections 36 to 38.
    """
    fine_plate = fc.build_structure(scene.replace({"mesh.columns": 4, "mesh.rows": 16}))
    solution = fc.solve_harmonic_balance(fine_plate, OMEGA, fc.UnilateralPenalty(STIFFNESS))
    amplitude = coarse_solution.amplitude(coarse_solution.structure.find_dof(CORNER, "x"))
    angle = np.pi / 2.0
    wedge = 1.0 / (angle + np.sin(angle)) + 1.0 / (angle - np.sin(angle))
    added_by_force = 100.0 * wedge * np.log(2.0) / scene.material.young  # 1 m thick
    fine_amplitude = solution.amplitude(fine_plate.find_dof(CORNER, "x"))
    return {
        "amplitude_with_elements_half_as_long_m": fine_amplitude,
        "growth_with_elements_half_as_long": fine_amplitude / amplitude - 1.0,
        "growth_by_the_point_force": float(added_by_force / amplitude),
    }


def start_up(
    plate: fc.Structure, law: fc.UnilateralPenalty, steps: int, output: Path
) -> dict[str, float]:
    """Draw the first periods from rest, figure 2 of the paper, by both kinds of integration."""
    history, exact = (
        integrate(plate, OMEGA, law, periods=DRAWN_PERIODS, steps_per_period=steps)
        for integrate in (fc.integrate_central_difference, fc.integrate_events)
    )
    figure, [axes] = panels(f"Figure 2: crack from rest ({law.stiffness:.0e} N/m)")
    fc.draw_waves(
        [
            fc.Wave("exact flow", exact.time, exact.gap[:, 0], "#b0b0b0", width=4.0),
            fc.Wave("central differences", history.time, history.gap[:, 0], "green", "--"),
        ],
        axes=axes,
        quantity="closing of the crack faces",
        zero="crack faces touch",
        period=2.0 * np.pi / OMEGA,
    )
    save(figure, output / "fig2_from_rest.png")
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


# --- pictures -------------------------------------------------------------------------------------


def panels(title: str, *names: str) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with a panel for each name, one above the other; one without names."""
    count = max(len(names), 1)
    height = 0.6 + 3.2 * count  # in
    margins = {"left": 0.13, "right": 0.97, "bottom": 0.5 / height, "top": 1.0 - 0.6 / height}
    figure = Figure(figsize=(7.0, height), dpi=110)
    axes = figure.subplots(count, squeeze=False, gridspec_kw=margins | {"hspace": 0.25})[:, 0]
    figure.suptitle(title, fontsize=11)
    for panel, name in zip(axes, names, strict=False):
        panel.set_title(name, fontsize=9, loc="left", y=1.0)  # placed without a search
    return figure, axes


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(path, pil_kwargs={"compress_level": 1})


def draw_plate(plate: fc.Structure, path: Path) -> None:
    """Draw figure 1 of the paper: mesh, clamp, crack, duplicated node pair and load."""
    figure, [axes] = panels("Figure 1: the paper's plate")
    figure.set_size_inches(6.0, 6.0)
    fc.draw_mesh(plate, axes=axes)
    assert plate.pair_points is not None
    [mouth] = plate.pair_points
    axes.annotate(
        "duplicated node pair:\none node of each face",
        mouth,
        (0.012, 0.068),
        arrowprops={"arrowstyle": "->"},
        fontsize=9,
    )
    axes.annotate("100 N sin(2000 t)", CORNER, (0.064, 0.094), fontsize=9)
    save(figure, path)


def draw_solution(
    output: Path, case: str, t: np.ndarray, waves: dict[str, list[np.ndarray]]
) -> None:
    """Draw figures 3, 5 and 6 of the paper."""
    period = float(t[-1])
    figure, [axes] = panels("Figure 3: linear solution, the crack faces pass through each other")
    curves = [
        fc.Wave("closing of the crack faces", t, waves["gap"][0], "orange"),
        fc.Wave("force point, horizontal", t, waves["corner"][0], "blue", "--"),
    ]
    fc.draw_waves(curves, axes=axes, quantity="displacement", period=period)
    save(figure, output / "fig3_linear.png")
    figure, axes = panels(f"Figures 5 and 6: nonlinear solution ({case})", *PANEL_NAMES)
    for (name, words), panel in zip(QUANTITIES.items(), axes, strict=True):
        linear_wave, penalty_wave, smoothed_wave, *uncracked_waves = waves[name]
        curves = [
            fc.Wave("harmonic balance, penalty", t, penalty_wave, LIGHT_BLUE, width=5.0),
            fc.Wave("harmonic balance, smoothed", t, smoothed_wave, "black", ":"),
            fc.Wave("linear, crack always open", t, linear_wave, "orange", "--"),
            *(fc.Wave("uncracked", t, wave, "pink", "-.") for wave in uncracked_waves),
        ]
        fc.draw_waves(curves, axes=panel, period=period, **words)
    save(figure, output / "fig5_fig6_nonlinear.png")


def draw_comparison(
    output: Path,
    case: str,
    t: np.ndarray,
    waves: dict[str, list[np.ndarray]],
    periods_of: dict[str, np.ndarray],
) -> None:
    """Draw figures 7 and 8 of the paper: both methods."""
    figure, axes = panels(f"Figures 7 and 8: both methods ({case})", *PANEL_NAMES)
    for (name, words), panel in zip(QUANTITIES.items(), axes, strict=True):
        mean, deviation = (
            np.append(row, row[0])
            for row in (periods_of[name].mean(axis=0), periods_of[name].std(axis=0))
        )
        label, count = "central differences", len(periods_of[name])
        if count > 1:
            label += f": mean of {count} periods, band: ± standard deviation"
        curves = [
            fc.Wave("harmonic balance", t, waves[name][1], LIGHT_BLUE, width=5.0),
            fc.Wave(label, t, mean, "green", "--", deviation),
        ]
        fc.draw_waves(curves, axes=panel, period=float(t[-1]), **words)
    save(figure, output / "fig7_fig8_both_methods.png")


def draw_spectrum(output: Path, by_period: np.ndarray, case: str) -> None:
    """Draw the amplitudes of the corner over orders of the load's frequency."""
    figure, [axes] = panels(f"Force point: spectrum of {len(by_period)} periods ({case})")
    orders, lines = amplitudes(by_period)
    shown = (orders > 0.0) & (orders < 4.0)
    axes.plot(orders[shown], np.log10(1e6 * lines[shown]), lw=0.8)
    powers = range(-6, 1)
    axes.set_yticks(powers, [f"{10.0**power:g}" for power in powers])
    axes.set(xlabel="order of the load's frequency [-]", ylabel="amplitude [µm]")
    save(figure, output / "spectrum.png")


def draw_crack(solution: fc.PeriodicSolution, folder: Path, magnification: float) -> None:
    """Draw the frame for ParaView in which the crack is widest by pyvista, magnified."""
    frames = sorted((folder / "breathing_crack").glob("*.vtu"))
    time = np.arange(len(frames)) * solution.period / len(frames)
    grid = import_pyvista().read(frames[int(solution.gap(time)[:, 0].argmin())])
    stress = grid["von Mises stress"] / 1e3  # kPa
    plotter = off_screen_plotter((700, 700))
    plotter.add_mesh(grid, style="wireframe", color="#b0b0b0")
    warped_grid = grid.warp_by_vector("displacement", factor=magnification)
    look = {"cmap": "viridis", "show_edges": True, "lighting": False, "show_scalar_bar": False}
    plotter.add_mesh(warped_grid, scalars="von Mises stress", **look)
    plotter.view_xy()
    plotter.camera.zoom(1.3)
    picture = plotter.screenshot(None, return_img=True)
    plotter.close()
    figure, [axes] = panels(f"The crack at its widest, displacement x {magnification:.0f}")
    axes.imshow(picture)
    axes.axis("off")
    colours = ScalarMappable(Normalize(stress.min(), stress.max()), "viridis")
    figure.colorbar(colours, ax=axes, label="von Mises stress [kPa]")
    figure.set_size_inches(6.0, 5.0)
    save(figure, folder / "breathing_crack.png")


# --- the answer -----------------------------------------------------------------------------------


def answer(summary: dict[str, Any], output: Path) -> None:
    """Print the answer: what was found, how far off it is, by which method, in which files."""
    paper, soft_case = summary["paper"], summary["agreeing"]
    five, block, mesh = (paper[name] for name in ("harmonic_balance", "block_system", "mesh"))
    balance, march = soft_case["harmonic_balance"], soft_case["direct_integration"]
    exact, orbit = paper["exact_orbit"], soft_case["exact_orbit"]
    least_amplitude, largest_amplitude = (
        1e6 * size for size in paper["direct_integration"]["amplitudes_m"]
    )
    omega = summary["natural_frequencies_rad_per_s"]
    rows = {
        "plate": f"{summary['dofs']} dofs, crack of one element with "
        f"{summary['duplicated_node_pairs']} duplicated node pair, modal damping by SLEPc's modes",
        "first natural frequency": f"{omega['open'][0]:.1f} rad/s with the crack open, "
        f"{omega['bonded'][0]:.1f} bonded; the paper has 2300",
        "five harmonics, condensed": f"{1e6 * five['amplitude_m']:.4f} um at the force, opening "
        f"{1e6 * five['largest_opening_m']:.4f} um    {five['seconds']:.2f} s",
        "the same, block system by PETSc SNES": f"equal to {block['difference']:.0e}    "
        f"{block['iterations']} iterations, {block['unknowns']:,} unknowns, "
        f"{block['seconds']:.1f} s",
        "exact orbit": f"{1e6 * exact['amplitude_m']:.4f} um: five harmonics are "
        f"{abs(five['error_of_amplitude']):.1%} off (opening {abs(five['error_of_opening']):.1%}, "
        f"gap over the period {five['error_of_gap']:.1%})",
        "stability": f"{exact['verdict']}: a disturbance grows "
        f"{exact['growth_in_a_period']:.0f}-fold in a period; the motion wanders between "
        f"{least_amplitude:.2f} and {largest_amplitude:.2f} um",
        "mesh": f"+ {mesh['growth_with_elements_half_as_long']:.0%} with elements half as long; a "
        f"point force has no limit: + {mesh['growth_by_the_point_force']:.0%} by it with each "
        "halving",
        "softer: 1e9 N/m, 1 % damping": f"{1e6 * balance['amplitude_m']:.4f} um with "
        f"{soft_case['harmonics']} harmonics, {abs(balance['error_of_amplitude']):.2%} off the "
        f"exact orbit (gap {balance['error_of_gap']:.2%}), {orbit['verdict']}; direct integration "
        + ("settles on it" if march["settled"] else "does not settle")
        + f", gaps {soft_case['difference_of_methods']:.1%} apart",
    }
    say("\nThe paper's plate, 1e11 N/m, 0.1 % damping, 100 N at 2000 rad/s:")
    for name, words in rows.items():
        say(f"{name:<37} {words}")
    names = sorted({path.name for path in output.rglob("*.png")})
    say(f"{output}/, paper/ and agreeing/ in it: {', '.join(names)}")


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
