"""Blades of a rotor whose stiffness has drifted since before, with a crack and without.

    python benchmarks/rotor_drift.py [folder]

A steel blade of 25 x 250 x 4 mm at a hub of 0.2 m: five resonances of modes 1 and 2 between 5,316
and 8,835 rpm, with relative standard deviations of 1e-5 to 4e-5, before there was a crack and
since. Between the records Young's modulus has changed by -2, -1, -0.5, -0.2 or +1 %; nothing says
so. What is measured comes from finite elements that share nothing with the package's
(own_plates.py), of blades whose modulus differs by 1 % from
that of the scene. Cracks of 5 mm at 60 mm stay open at all resonances, or breathe half of the time.
Prints how often a crack is claimed, and is in the stated region; and how wide regions are where
temperatures are measured, too. ``--draws 1`` takes fewer, ``--seed 1`` others.
"""

from __future__ import annotations

import argparse
from functools import cache
from pathlib import Path

import numpy as np
from own_plates import Plate

import fenics_crack as fc

SEED = 67
"""Written down before it was run."""
WIDTH, HEIGHT, THICKNESS, HUB = 0.025, 0.25, 0.004, 0.2
YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0
SPEEDS = ((1, 5316.0), (1, 7643.0), (2, 8835.0), (2, 7193.0), (2, 6073.0))
"""Modes, and where they are measured [rpm]."""
NOISE = np.array([1e-5, 2e-5, 4e-5, 3e-5, 1e-5])
DRIFTS = (-0.02, -0.01, -0.005, -0.002, 0.01)
"""Of Young's modulus, since before."""
BLADES = 0.01
"""Standard deviation of Young's modulus of blades."""
PER_KELVIN = -4e-4
CRACK = {"crack.length": 0.005, "crack.height": 0.06}
SCENE = f"""
geometry = {{ width = {WIDTH}, height = {HEIGHT}, thickness = {THICKNESS} }}
crack = {{ edge = "left", height = 0.06, length = 0.005 }}
material = {{ young = {YOUNG}, poisson = {POISSON}, density = {DENSITY} }}
damping = {{ ratio = 0.002 }}
rotation = {{ rpm = 7000.0, hub_radius = {HUB} }}
excitation = {{ point = [{WIDTH}, {HEIGHT}], force_sin = [1.0, 0.0], order = 5 }}
contact = {{ law = "unilateral" }}
harmonic_balance = {{ harmonics = 5 }}
mesh = {{ layout = "graded", order = 2, size = 0.006, lip_elements = 4 }}
reduction = {{ modes = 8 }}
[identify.unknown]
"crack.length" = {{ start = 0.0015, stop = 0.01, count = 6 }}
"crack.height" = {{ start = 0.015, stop = 0.2, count = 9 }}
"""


@cache
def blade(*, cracked: bool) -> Plate:
    """The blade, with its crack open or without it."""
    length, place = CRACK.values()
    size = (WIDTH, HEIGHT, THICKNESS)
    return Plate(size, YOUNG, POISSON, DENSITY, length, place, cracked=cracked, hub=HUB)


@cache
def exact(young: float, *, cracked: bool, lips: str = "open") -> np.ndarray:
    """Resonances of the five, without noise [Hz]."""
    found = []
    for mode, rpm in SPEEDS:
        own = blade(cracked=cracked).frequencies(2, rpm, young / YOUNG)[mode - 1]
        if cracked and lips == "breathing":
            tied = blade(cracked=False).frequencies(2, rpm, young / YOUNG)[mode - 1]
            own = 2.0 * own * tied / (own + tied)
        found.append(own)
    return np.array(found)


# --- what is measured, and found ------------------------------------------------------------------


def measured(
    young: float, drift: float, lips: str, rng: np.random.Generator, *, known: bool = False
) -> fc.Measurements:
    """Both records of a blade; with their temperatures if they are known."""
    rows = []
    records = (
        ("frequency_uncracked", young, False, 20.0),
        ("frequency_resonance", young * (1.0 + drift), bool(lips), 20.0 + drift / PER_KELVIN),
    )
    for quantity, own, cracked, temperature in records:
        hertz = exact(own, cracked=cracked, lips=lips)
        values = hertz * (1.0 + NOISE * rng.standard_normal(len(hertz)))
        for (mode, rpm), value, noise in zip(SPEEDS, values, NOISE, strict=True):
            more = {"temperature": temperature} if known else {}
            rows.append(fc.Measurement(quantity, value, noise * value, mode, rpm=rpm, **more))
    return fc.Measurements(tuple(rows))


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("output/rotor_drift"))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--draws", type=int, default=8, help="healthy ones of each drift")
    given = parser.parse_args()
    scene = fc.Scene.from_text(SCENE)
    for lips in ("", "open", "breathing"):
        rng = np.random.default_rng([given.seed, len(lips)])
        draws = given.draws if not lips else -(-given.draws // 2)
        claimed = held = called = total = narrower = 0
        for drift in DRIFTS:
            for draw in range(draws):
                young = YOUNG * (1.0 + BLADES * rng.standard_normal())
                seed = int(rng.integers(2**32))
                found = {
                    known: fc.identify(
                        scene,
                        measured(young, drift, lips, np.random.default_rng(seed), known=known),
                        folder=given.folder,
                    )
                    for known in ((False, True) if lips else (False,))
                }
                one = found[False]
                claimed += one.verdict == "crack"
                held += one.contains(CRACK)
                called += one.verdict == "crack" and one.contains(CRACK)
                total += 1
                if lips:
                    spreads = [found[known].posterior.spread(0) for known in (True, False)]
                    narrower += spreads[0] < spreads[1]
                if draw == 0:
                    print(f"{drift:+.1%} {lips}: {one}; {one.reason}", flush=True)
        print(f"{lips or 'without a crack'}: claimed {claimed} of {total}", flush=True)
        if lips:
            print(
                f"  held {held}, both {called}; with temperatures narrower in {narrower}",
                flush=True,
            )


if __name__ == "__main__":
    main()
