"""Blades of a rotor whose stiffness has drifted since before, with a crack and without.

    python benchmarks/rotor_drift.py [folder]

A steel blade of 25 x 250 x 4 mm at a hub of 0.2 m: five resonances of modes 1 and 2 between 5,316
and 8,835 rpm, with relative standard deviations of 1e-5 to 4e-5, before there was a crack and
since. Between the records Young's modulus has changed by -2, -1, -0.5, -0.2 or +1 %; nothing says
so. What is measured comes from finite elements of this file (plates of eight nodes, centrifugal
stress, geometric stiffness), none of the package's, of blades whose modulus differs by 1 % from
that of the scene. Cracks of 5 mm at 60 mm stay open at all resonances, or breathe half of the time.
Prints how often a crack is claimed, and is in the stated region; and how wide regions are where
temperatures are measured, too. ``--draws 1`` takes fewer, ``--seed 1`` others.
"""

from __future__ import annotations

import argparse
from functools import cache
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh, splu

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


# --- finite elements of a blade, plates of eight nodes --------------------------------------------

CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0]], float)
GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 9.0


def shapes(r: float, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions (8,) of a serendipity element, and their derivatives (2, 8)."""
    a, b = CORNERS.T
    corner, across = np.arange(8) < 4, a == 0.0
    value = np.where(
        corner,
        0.25 * (1 + a * r) * (1 + b * s) * (a * r + b * s - 1),
        np.where(across, 0.5 * (1 - r**2) * (1 + b * s), 0.5 * (1 + a * r) * (1 - s**2)),
    )
    by_r = np.where(
        corner,
        0.25 * a * (1 + b * s) * (2 * a * r + b * s),
        np.where(across, -r * (1 + b * s), 0.5 * a * (1 - s**2)),
    )
    by_s = np.where(
        corner,
        0.25 * b * (1 + a * r) * (a * r + 2 * b * s),
        np.where(across, 0.5 * b * (1 - r**2), -s * (1 + a * r)),
    )
    return value, np.stack([by_r, by_s])


def graded(start: float, stop: float, fine: float, ratio: float, *, at_end: bool) -> np.ndarray:
    """Lines from a start to a stop, whose distances grow from a fine one at one end."""
    count = int(np.ceil(np.log(1.0 + (stop - start) * (ratio - 1.0) / fine) / np.log(ratio)))
    steps = ratio ** np.arange(count)
    places = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    if at_end:
        places = 1.0 - places[::-1]
    return start + (stop - start) * places


def mesh(length: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 2) and elements (m, 8) of a blade with an edge crack, fine at its tip."""
    fine = length / 16.0
    x = np.unique(
        [
            *graded(0.0, length, fine, 1.3, at_end=True),
            *graded(length, WIDTH, fine, 1.3, at_end=False),
        ]
    )
    y = np.unique(
        [
            *graded(0.0, height, fine, 1.25, at_end=True),
            *graded(height, HEIGHT, fine, 1.25, at_end=False),
        ]
    )
    y = np.sort(np.concatenate([y, *_halved(y, 0.006)]))
    numbers: dict[tuple[float, float, int], int] = {}
    nodes: list[tuple[float, float]] = []

    def number(px: float, py: float, upper: bool) -> int:
        lip = int(upper and abs(py - height) < 1e-9 and px < length - 1e-9)
        key = (round(px, 10), round(py, 10), lip)
        if key not in numbers:
            numbers[key] = len(nodes)
            nodes.append((px, py))
        return numbers[key]

    elements = []
    for low, high in pairwise(y):
        upper = low >= height - 1e-9
        for left, right in pairwise(x):
            middle, half = 0.5 * (left + right), 0.5 * (right - left)
            up, tall = 0.5 * (low + high), 0.5 * (high - low)
            elements.append([number(middle + a * half, up + b * tall, upper) for a, b in CORNERS])
    return np.array(nodes), np.array(elements)


def _halved(lines: np.ndarray, longest: float) -> list[np.ndarray]:
    """Lines that divide what is longer."""
    return [
        np.linspace(a, b, int(np.ceil((b - a) / longest)) + 1)[1:-1] for a, b in pairwise(lines)
    ]


class Blade:
    """Matrices of a blade at E = 1: elastic, by the square of the speed, and mass."""

    def __init__(self, crack: tuple[float, float] | None) -> None:
        nodes, elements = mesh(*(crack or (CRACK["crack.length"], CRACK["crack.height"])))
        if crack is None:  # both lips are one
            same = {tuple(np.round(one, 10)): k for k, one in reversed([*enumerate(nodes)])}
            elements = np.array([same[tuple(np.round(one, 10))] for one in nodes])[elements]
        law = np.array([[1.0, POISSON, 0.0], [POISSON, 1.0, 0.0], [0.0, 0.0, 0.5 * (1 - POISSON)]])
        law /= 1.0 - POISSON**2
        used = np.unique(elements)
        free = np.zeros((len(nodes), 2), dtype=bool)
        free[used] = True
        free[nodes[:, 1] < 1e-12] = False
        self.free = free.ravel()
        points = []
        for (r, wr), (s, ws) in product(zip(GAUSS, WEIGHTS, strict=True), repeat=2):
            value, by = shapes(r, s)
            half = 0.5 * np.ptp(nodes[elements], axis=1)  # rectangles
            slopes = by / half[:, :, None]  # (m, 2, 8)
            points.append((value, slopes, wr * ws * half.prod(axis=1) * THICKNESS))
        strains = [self._strain(slopes) for _, slopes, _ in points]
        stiffness = sum(
            (w[:, None, None] * b.transpose(0, 2, 1) @ law @ b)
            for b, (_, _, w) in zip(strains, points, strict=True)
        )
        mass = sum(w[:, None, None] * np.outer(v, v) for v, _, w in points) * DENSITY
        dofs = (2 * elements[..., None] + np.arange(2)).reshape(len(elements), -1)
        self.elastic = self._put(stiffness, dofs)
        self.mass = self._put(np.kron(mass, np.eye(2)), dofs)
        softening = self._put(np.kron(mass, np.diag([0.0, 1.0])), dofs)
        pull = np.zeros(2 * len(nodes))
        for value, _, w in points:
            radius = HUB + nodes[elements][..., 1] @ value
            np.add.at(pull, dofs[:, 1::2], DENSITY * (w * radius)[:, None] * value)
        moved = np.zeros(2 * len(nodes))
        moved[self.free] = splu(self.elastic.tocsc()).solve(pull[self.free])
        stresses = [(law @ (b @ moved[dofs][..., None]))[..., 0] for b in strains]
        geometric = 0.0
        for stress, (_, slopes, w) in zip(stresses, points, strict=True):
            xx, yy, xy = stress.T
            tensor = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
            geometric = geometric + w[:, None, None] * (slopes.transpose(0, 2, 1) @ tensor @ slopes)
        self.rotating = self._put(np.kron(geometric, np.eye(2)), dofs) - softening

    @staticmethod
    def _strain(slopes: np.ndarray) -> np.ndarray:
        found = np.zeros((len(slopes), 3, 16))
        found[:, 0, ::2] = found[:, 2, 1::2] = slopes[:, 0]
        found[:, 1, 1::2] = found[:, 2, ::2] = slopes[:, 1]
        return found

    def _put(self, parts: np.ndarray, dofs: np.ndarray) -> Any:
        rows = np.repeat(dofs, dofs.shape[1], axis=1).ravel()
        columns = np.tile(dofs, (1, dofs.shape[1])).ravel()
        shape = (len(self.free),) * 2
        whole = sparse.coo_matrix((parts.ravel(), (rows, columns)), shape).tocsr()
        return whole[self.free][:, self.free]

    def frequencies(self, young: float, rpm: float) -> np.ndarray:
        """The first two natural frequencies [Hz]."""
        speed = rpm * np.pi / 30.0
        stiffness = (young * self.elastic + speed**2 * self.rotating).tocsc()
        squares = eigsh(stiffness, 2, self.mass.tocsc(), sigma=0.0, v0=np.ones(stiffness.shape[0]))
        return np.sqrt(np.sort(squares[0])) / (2.0 * np.pi)


@cache
def blade(*, cracked: bool) -> Blade:
    """The blade, with its crack open or without it."""
    return Blade((CRACK["crack.length"], CRACK["crack.height"]) if cracked else None)


@cache
def exact(young: float, *, cracked: bool, lips: str = "open") -> np.ndarray:
    """Resonances of the five, without noise [Hz]."""
    found = []
    for mode, rpm in SPEEDS:
        own = blade(cracked=cracked).frequencies(young, rpm)[mode - 1]
        if cracked and lips == "breathing":
            tied = blade(cracked=False).frequencies(young, rpm)[mode - 1]
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
