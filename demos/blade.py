"""A cracked blade from the rotor's speed to the signals of tip timing.

A tapered, curved steel blade has a crack at its leading edge (``meshes/blade.geo``). The mean flow
bends it so that the crack closes, rotation pulls the crack open, and engine order 10 excites it.
The demo draws

1. the Campbell diagram: where orders meet the breathing blade;
2. a run-up through the crossing of order 10 with the first mode, and the contact duty cycle of the
   crack on the way;
3. where the crack breathes and where rotation holds it open: duty cycle over speed and mean load,
   at each speed driven at its own first breathing frequency, as an order that meets it there would;
4. what probes in the casing see of the run-up, and the vibration fitted to their signals.

The plate lies in a plane that holds the axis, and vibrates along the axis, which probes do not see.
A real blade is staggered: its chord stands at an angle to the axis, here 20 degrees, and the
share sin(20) = 0.34 of the tip's motion is tangential. The spin softening by that share, sin^2 of
W^2 against w^2 = 100 W^2, is left out.

    python demos/blade.py [folder for the results]
"""

import sys
import time
from pathlib import Path

import numpy as np

import fenics_crack as fc

SCENE = Path(__file__).with_name("rotating_blade.toml")
RPM = 2.0 * np.pi / 60.0


def main(output: Path = Path("output/blade"), *, quick: bool = False) -> dict[str, float]:
    """Compute and draw all of it; return what a reader would quote. ``quick``: fewer points."""
    begun = time.perf_counter()
    scene = fc.Scene.load(SCENE)
    order = scene.excitation.order
    assert order is not None
    diagram = fc.campbell(scene, RPM * np.linspace(0.0, 9000.0, 4 if quick else 10), 1)
    fc.draw_campbell(diagram, range(4, 13), path=output / "campbell.png")
    meets = {
        kind: diagram.crossings(order, kind)[0, 1] / RPM for kind in ("open", "tied", "bilinear")
    }

    if quick:
        scene = scene.replace({"harmonic_balance.harmonics": 3, "curve.stability": False})
    run = fc.curve(scene)
    curve, tip = run.result, run.watched_dof
    print(curve)
    draw_run_up(run, order, output)
    seen = curve.indicators(tip)
    peak = int(np.argmax(seen.amplitude))

    shares = closing_map(scene, output, *((2, 2) if quick else (7, 8)))
    track = probes_see(run, order, output, 300 if quick else 1500)
    tangential = track.amplitudes[:, 0].max() / scene.tip_timing.tangential
    found = {
        "order meets open crack [rpm]": meets["open"],
        "order meets breathing crack [rpm]": meets["bilinear"],
        "order meets bonded crack [rpm]": meets["tied"],
        "largest amplitude [m]": float(seen.amplitude[peak]),
        "at [rpm]": float(curve.values[peak]) / RPM,
        "contact duty cycle there": float(seen.closed_share[peak]),
        "largest amplitude by tip timing [m]": float(tangential),
        "duty cycle, slow and pressed": float(shares[0, 0]),
        "duty cycle, fast and free": float(shares[-1, -1]),
        "seconds": time.perf_counter() - begun,
    }
    for name, value in found.items():
        print(f"{name:38s} {value:.5g}")
    return found


def draw_run_up(run: fc.Run, order: int, output: Path) -> None:
    """Draw the blade tip's amplitude and the contact duty cycle over the speed."""
    curve, tip = run.result, run.watched_dof
    title = f"Run-up, engine order {order}"
    fc.draw_curve(curve, tip, path=output / "run_up.png", title=title, in_hertz=True)
    share = 100.0 * curve.indicators(tip).closed_share
    fc.draw_response(
        curve.values / RPM,
        {"mean over the pairs": share},
        quantity="contact duty cycle",
        unit="%",
        over="rotor speed [rpm]",
        path=output / "closed.png",
        title="The crack along the run-up",
    )


def closing_map(scene: fc.Scene, output: Path, speeds: int, loads: int) -> np.ndarray:
    """Draw and return the contact duty cycle over mean load and speed: (speeds, loads)."""
    rpm, mean = np.linspace(1000.0, 9000.0, speeds), np.linspace(-1000.0, 0.0, loads)
    shares = np.full((speeds, loads), np.nan)
    for column, force in enumerate(mean):
        case = scene.replace({"excitation.force_mean": (float(force), 0.0)})
        whole = fc.build_structure(case)
        for row, speed in enumerate(RPM * rpm):
            there = fc.reduce_structure(
                whole.rotation.structure_rotating_at_speed(float(speed)), modes=6, method="massless"
            )
            omega = float(fc.bilinear_frequencies(there).omega_bilinear[0])
            found = fc.solve_harmonic_balance(
                there, omega, fc.UnilateralConstraint(), harmonics=5, throw=False
            )
            if found.converged:
                shares[row, column] = found.indicators(0).closed_share
    fc.draw_map(
        mean,
        rpm,
        100.0 * shares,
        x_label="mean flow load at the tip [N]",
        y_label="rotor speed [rpm]",
        value_label="contact duty cycle [%]",
        path=output / "map.png",
        title="Breathing, and held open by rotation",
    )
    return shares


def probes_see(run: fc.Run, order: int, output: Path, revolutions: int) -> fc.TipTrack:
    """Arrival times in the run-up, and the vibration found in them; tangential amplitudes [m]."""
    casing = run.scene.tip_timing
    assert casing is not None
    arrivals = fc.tip_timing(
        run.result,
        {run.watched_dof: casing.tangential},
        probes=np.radians(casing.probes),
        tip_radius=casing.tip_radius,
        order=order,
        revolutions=revolutions,
        noise=casing.noise,
    )
    fc.draw_arrivals(arrivals, path=output / "arrivals.png", in_rpm=True)
    track = fc.track_order(arrivals, order, harmonics=2, revolutions=casing.fitted_revolutions)
    fc.draw_tip_track(track, path=output / "probes.png", in_hertz=True)
    print(track)
    return track


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
