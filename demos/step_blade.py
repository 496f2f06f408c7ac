"""A crack in a blade from a STEP file: how the blade vibrates, what the crack bears, how it grows.

The demo makes the file of a twisted blade with a fillet, in which there is no crack
(`meshes/step_blade.geo`). The scene puts one there, half of an ellipse in the convex face. It finds

1. how far the blade moves, with its errors;
2. the stress intensities along the crack's front;
3. how the crack grows, and how many cycles that takes.

    python demos/step_blade.py [folder for the results]
"""

import sys
from pathlib import Path

import gmsh

import fenics_crack as fc

SCENE = Path(__file__).with_suffix(".toml")
SOURCE = SCENE.parents[1] / "meshes" / "step_blade.geo"


def write_part(path: Path) -> None:
    """Write the blade to a STEP file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(SOURCE))
    gmsh.write(str(path))
    gmsh.finalize()


def main(
    output: Path = Path("output/step_blade"), changes: dict[str, object] | None = None
) -> dict[str, float]:
    """Compute and draw all of it; return what is printed, by name."""
    part = output / "step_blade.step"
    write_part(part)
    scene = fc.Scene.load(SCENE).replace({"geometry.file": str(part)} | (changes or {}))
    run = fc.solve(scene)
    print(run)
    fc.draw_mesh(run.structure.whole, path=output / "part.png")
    fc.draw_contact_map(run.result, path=output / "contact.png")

    intensity = fc.stress_intensity(run)
    print(intensity)
    fc.draw_stress_intensity(intensity, path=output / "intensity.png")

    growth = fc.grow(scene, output / "growth")
    print(growth)
    fc.draw_growth(growth, path=output / "growth.png", in_hertz=True)
    found = {
        "amplitude [m]": run.result.indicators().amplitude,
        "its error": run.errors.stated("amplitude")[0],
        "largest K_I [Pa m^0.5]": float(intensity.max_K_I_by_tip.max()),
        "cycles of growth": growth.life,
        "known within a factor of": growth.factor,
        "last depth [m]": float(growth.depth[-1]),
        "last length [m]": float(growth.length[-1]),
    }
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
