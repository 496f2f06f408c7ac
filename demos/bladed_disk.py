"""A bladed disk of 24 blades, one of them cracked: frequencies over the nodal diameter,
diameters.png, the response of every blade, blades.png and wheel.png, amplification by mistuning,
amplification.png, and the amplitude of every tip from arrival times.

    python demos/bladed_disk.py [folder for the results]
"""

import sys
from pathlib import Path

import numpy as np

import fenics_crack as fc

SCENE = Path(__file__).with_name("bladed_disk.toml")


def main(
    output: Path = Path("output/bladed_disk"), scene: fc.Scene | None = None, patterns: int = 1000
) -> dict[str, float]:
    """Compute and draw all of it; what is printed, by name."""
    scene = scene or fc.Scene.load(SCENE)
    diameters = fc.nodal_diameters(scene)
    title = f"Engine order {diameters.order} excites nodal diameter {diameters.excited}"
    fc.draw_nodal_diameters(diameters, path=output / "diameters.png", title=title)
    family = float(diameters.omega[diameters.excited, 0] / (2.0 * np.pi))

    curve = fc.curve(scene)
    fc.draw_blades(curve.result, path=output / "blades.png", title="The response of every blade")
    peaks = fc.blades(curve)
    print(peaks.table().format_as("text"))
    peak = curve.result.peak()
    resonance = peak.omega / (2.0 * np.pi)
    run = fc.solve(scene.replace({"excitation.frequency": resonance}))
    fc.draw_wheel(run.result, path=output / "wheel.png", title=f"{resonance:.1f} Hz")

    mistuned = scene.replace({"excitation.frequency": family})
    many = fc.amplification(mistuned, patterns, deviation=0.01)
    title = f"Mistuning of 1 %, {scene.given('disk').sectors} blades"
    fc.draw_amplification(many, path=output / "amplification.png", title=title)

    arrivals, timed = fc.arrivals_of_blades(mistuned)
    probes = np.radians(scene.given("tip_timing").probes)
    fc.write_record(arrivals, output / "arrivals.csv", probes)
    exact, worst = fc.blades(timed), 0.0
    for blade, seen in arrivals.items():
        fit = fc.fit_order(seen, [diameters.order], harmonics=2)
        size, error = fit.amplitudes[0], fit.amplitude_errors[0]
        known = abs(exact.first_harmonic[blade - 1])
        worst = max(worst, abs(size - known) / error)
        print(f"blade {blade:2d}: {1e6 * size:6.1f} ± {1e6 * error:.1f} µm by the probes, "
              f"{1e6 * known:6.1f} µm computed")  # fmt: skip
    found = {
        "excited frequency of the tuned wheel [Hz]": family,
        "resonance of the cracked blade [Hz]": resonance,
        "its amplitude [m]": peak.amplitude,
        "its second harmonic over the first": float(
            peaks.second_harmonic_ratio[peaks.cracked[0] - 1]
        ),
        "largest amplification by mistuning": float(many.factor.max()),
        "of 95 % of the patterns, at most": many.percentile(95.0),
        "Whitehead's bound": many.bound,
        "tip amplitudes off by at most so many standard errors": worst,
    }
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/bladed_disk"))
