"""A blade in flap with a crack in its face: how it vibrates, what the crack bears, how it grows.

A titanium blade, 30 x 100 x 4 mm, has a crack, half of an ellipse, 10 mm above its root. At its
resonance, where the crack opens and closes in every period, the demo finds

1. how far it moves, and how far the crack opens, with their errors;
2. the stress intensities along the crack's front, and over the period;
3. what friction between the faces would change;
4. how the crack grows, in depth and along the face, and how many cycles that takes.

    python demos/flapping_blade.py [folder for the results]
"""

import sys
from pathlib import Path

import numpy as np

import fenics_crack as fc

SCENE = Path(__file__).with_suffix(".toml")


def main(
    output: Path = Path("output/flapping_blade"), scene: fc.Scene | None = None
) -> dict[str, float]:
    """Compute and draw all of it; return what is printed, by name."""
    scene = scene or fc.Scene.load(SCENE)
    run = fc.curve(scene)
    print(run)
    fc.draw_curve(run.result, path=output / "curve.png", in_hertz=True)
    top, errors = run.result.top(run.watched_dof), run.errors
    peak = fc.solve(scene.replace({"excitation.frequency": top.value / (2.0 * np.pi)}))

    intensity = fc.stress_intensity(peak)
    print(intensity)
    fc.draw_stress_intensity(intensity, path=output / "intensity.png")
    fc.draw_contact_map(peak.result, path=output / "contact.png")

    growth = fc.grow(scene.replace({"mesh.lip_elements": 3}), output / "growth")
    print(growth)
    fc.draw_growth(growth, path=output / "growth.png", in_hertz=True)

    worst, deepest = int(intensity.max_K_I_by_tip.argmax()), len(intensity.tip_names) // 2
    friction = errors.contributions("amplitude").get("friction", np.nan)
    found = {
        "resonance [Hz]": top.value / (2.0 * np.pi),
        "its error": errors.stated(errors.resonance)[0],
        "amplitude there [m]": top.amplitude,
        "error of the amplitude": errors.stated("amplitude")[0],
        "opening there [m]": peak.result.face_indicators["opening"],
        "friction would change the amplitude by": errors.relative("amplitude", friction),
        "largest K_I [Pa m^0.5]": intensity.max_K_I_by_tip[worst],
        "it is along the front at [m]": intensity.distances_along_crack[worst],
        "largest K_I where the crack is deepest [Pa m^0.5]": intensity.max_K_I_by_tip[deepest],
        "cycles of growth": growth.life,
        "known within a factor of": growth.factor,
        "last depth [m]": growth.depth[-1],
        "last length [m]": growth.length[-1],
    }
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
