"""A crack that grows through a resonance, and one that is driven at the resonance as it falls.

A plate is driven at 800 Hz, 3 % below the resonance of its crack. The longer the crack, the lower
its natural frequency: it comes down to the load's, its stress intensity grows fivefold, and once it
is below, growth slows. A load that follows the largest response has no such end.

    python demos/growth.py [folder for the results]
"""

import sys
from pathlib import Path

import fenics_crack as fc

SCENE = Path(__file__).with_name("growth.toml")


def main(output: Path = Path("output/growth"), scene: fc.Scene | None = None) -> dict[str, float]:
    """Let the crack grow in both ways; draw them and say how long it takes."""
    scene = scene or fc.Scene.load(SCENE)
    lives = {}
    for drive in ("frequency", "resonance"):
        found = fc.grow(scene.replace({"growth.drive": drive}), output / drive)
        found.to_csv(output / f"{drive}.csv")
        title = "Driven at 800 Hz" if drive == "frequency" else "Driven at its resonance"
        fc.draw_growth(found, path=output / f"{drive}.png", title=title, in_hertz=True)
        lives[drive] = found.life
        print(f"{title}: {found}")
    return lives


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("output/growth"))
