"""What cracks are mistaken for, and what is mistaken for cracks.

    python benchmarks/identification_limits.py [folder]

clamps
    Plates three times as tall as wide, from finite elements that share nothing with the package's
    (own_plates.py): bilinear frequencies 1 to 3, 4, 5 or 6 and those before. Without a crack
    Young's modulus, width, height or clamp have changed since, which takes 0.1 to 1 % from the
    first frequency; or have cracks of 5, 10 and 20 to 40 % of the width.
constant
    The same plates without a crack, which differ from the scene's by the same before and since.
beams
    Slender beams of Timoshenko's with springs for cracks, one or two of 15 to 45 % of the width:
    frequencies 1 to 3, 4 or 5, and those before.
softer
    Natural frequencies 1 to 4, 5 or 6 of plates of five shapes, from the same finite elements, that
    are clamped deeper, on an elastic bed, or let go over 2 or 4 % of the width at an end of the
    clamp: what turning, moving and a common factor leave of how they change.
peaks
    Response curves of plates with breathing cracks: where the first harmonic of the tip has its
    peaks, less the bilinear frequencies, over the difference of those with the crack bonded and
    open.
others
    Five frequencies, open and bilinear, and those before, of plates with two cracks, with one above
    the heights where it is looked for, and with one inside the plate, from a finer mesh of the
    package's own.
blades
    A blade of a rotor with a crack that its pull holds open or lets breathe, by the arrivals of its
    tip under a load of a random size alone, and with a natural frequency beside them.

Prints how often a crack is claimed, and how often it is in the stated region. ``--only`` chooses a
part, ``--seed 1`` takes other plates, and ``--share 0.2`` a fifth of them.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from identification import BEFORE, FINER, NO_CRACK, SIZES, Rows, Score, before, natural
from identification import HEIGHT as TALL
from identification import SCENE as PLATE
from identification import WIDTH as WIDE
from mpi4py import MPI
from own_plates import Plate
from scipy.integrate import quad
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment, root_scalar
from scipy.sparse.linalg import eigsh

import fenics_crack as fc
from fenics_crack.monitoring.identification.identify import infer, solve_forward
from fenics_crack.monitoring.identification.nuisance import Whole

SEED = 671
"""Written down before it was run."""
YOUNG, POISSON, DENSITY, THICKNESS = 2.1e11, 0.3, 7800.0, 0.01
PLATES = 0.01
"""Standard deviation of Young's modulus of plates and beams."""
COUNTS = ((3, 1e-5), (4, 1e-5), (5, 1e-5), (6, 1e-5), (3, 1e-4), (3, 1e-3), (5, 1e-4), (5, 1e-3))
"""How many modes, and the noise of their frequencies."""
LOWER = (0.001, 0.003, 0.01)
"""What a change takes from the first frequency."""
CHANGES = ("modulus", "width", "height", "clamp")
SLENDERNESS = (15, 5, 3, 2, 1)
"""Heights of plates over their widths."""
SHALLOW = ((0.05, 0.05, 3), (0.1, 0.1, 3), (0.2, 0.4, 5))
"""Lengths of cracks over the width, from and to, and how many."""


def noisy(
    quantity: str, hertz: np.ndarray, noise: float, rng: np.random.Generator
) -> list[fc.Measurement]:
    """The first natural frequencies, with noise."""
    values = hertz * (1.0 + noise * rng.standard_normal(len(hertz)))
    pairs = enumerate(zip(values, hertz, strict=True), 1)
    return [fc.Measurement(quantity, value, noise * one, mode) for mode, (value, one) in pairs]


def both(
    quantity: str, now: np.ndarray, then: np.ndarray, noise: float, rng: np.random.Generator
) -> fc.Measurements:
    """Natural frequencies now, and before."""
    rows = noisy(quantity, now, noise, rng) + noisy(BEFORE, then, noise, rng)
    return fc.Measurements(tuple(rows))


def conditional(found: fc.Identification) -> bool:
    """True if a crack is claimed on the condition that the clamp holds as before."""
    return found.verdict == "crack" and "IF ITS CLAMP HOLDS AS BEFORE" in repr(found)


# --- plates whose clamp, or whatever else, has changed --------------------------------------------


def plate_of(kind: str, amount: float, young: float = YOUNG) -> Plate:
    """A plate without a crack, changed by an amount."""
    size = [WIDE, TALL, THICKNESS]
    if kind in ("width", "height"):
        size[CHANGES.index(kind) - 1] *= 1.0 + amount
    elif kind == "modulus":
        young *= 1.0 + amount
    whole = (size[0], size[1], size[2])
    plate = Plate(whole, young, POISSON, DENSITY, 0.02, size[1] / 3.0, cracked=False)
    return replace(plate, clamp=amount * TALL) if kind == "clamp" else plate


@cache
def changed(kind: str, lower: float) -> np.ndarray:
    """Natural frequencies of a plate whose first one a change has lowered [Hz]."""
    [first] = plate_of("", 0.0).frequencies(1)

    def left(amount: float) -> float:
        return float(plate_of(kind, amount).frequencies(1)[0] / first - 1.0 + lower)

    guess = {"modulus": -2.0, "width": -1.0, "height": 0.5, "clamp": 0.5}[kind] * lower
    amount = root_scalar(left, x0=guess, x1=1.1 * guess, xtol=1e-3 * abs(guess)).root
    return plate_of(kind, amount).frequencies(6)


def bilinear(length: float, place: float) -> np.ndarray:
    """Bilinear frequencies of a plate with a crack [Hz]: bonded faces slide, and each mode of the
    open crack is paired with the bonded one of the same shape."""
    plate = Plate((WIDE, TALL, THICKNESS), YOUNG, POISSON, DENSITY, length, place)
    stiffness, _, mass = plate.matrices
    rounded = np.round(plate.nodes, 9)
    upper = {tuple(one): k for k, one in enumerate(rounded)}  # the last of two
    dofs = np.arange(len(plate.free))
    for k, one in enumerate(rounded):
        dofs[2 * upper[tuple(one)] + 1] = min(2 * k + 1, dofs[2 * upper[tuple(one)] + 1])
    columns = np.unique(dofs[plate.free], return_inverse=True)[1]
    tie = sparse.coo_matrix((np.ones(len(columns)), (np.arange(len(columns)), columns))).tocsr()
    open_squares, open_modes = _modes(stiffness, mass, 6)
    tied_squares, tied_modes = _modes(tie.T @ stiffness @ tie, tie.T @ mass @ tie, 8)
    similar = (open_modes.T @ (mass @ (tie @ tied_modes))) ** 2
    tied_squares = tied_squares[linear_sum_assignment(-similar)[1]]
    first, second = np.sqrt(open_squares), np.sqrt(tied_squares)
    return first * second / (first + second) / np.pi


def _modes(stiffness: Any, mass: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    start = np.ones(stiffness.shape[0])
    squares, modes = eigsh(stiffness.tocsc(), count, mass.tocsc(), sigma=0.0, v0=start)
    order = np.argsort(squares)
    return squares[order], modes[:, order]


def clamps(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print how often a crack is claimed where something has changed, or there is one."""
    forward = solve_forward(fc.Scene.from_text(PLATE), (), folder)
    counts = COUNTS[: max(1, round(share * len(COUNTS)))]
    claimed = held_back = 0
    whole = plate_of("", 0.0).frequencies(6)
    for kind, lower, (modes, noise) in product(CHANGES, LOWER, counts):
        stiffer = np.sqrt(1.0 + PLATES * rng.standard_normal())
        now, then = stiffer * changed(kind, lower)[:modes], stiffer * whole[:modes]
        found = infer(forward, both("frequency_bilinear", now, then, noise, rng))
        claimed += found.verdict == "crack"
        held_back += conditional(found)
        if found.verdict == "crack":
            print(f"  {kind} {lower:.1%}, {modes} modes, {noise}: {found}", flush=True)
    total = len(CHANGES) * len(LOWER) * len(counts)
    print(
        f"without a crack, changed since: {total}, claimed {claimed} ({held_back} on condition)",
        flush=True,
    )
    for low, high, many in SHALLOW:
        score, held_back = Score(SIZES), 0
        for _ in range(many):
            crack = np.array([rng.uniform(low, high) * WIDE, rng.uniform(0.1, 0.8) * TALL])
            hertz = bilinear(*crack)
            bare = replace(plate_of("", 0.0), length=crack[0], place=crack[1]).frequencies(6)
            for modes, noise in counts:
                stiffer = np.sqrt(1.0 + PLATES * rng.standard_normal())
                now, then = stiffer * hertz[:modes], stiffer * bare[:modes]
                found = infer(forward, both("frequency_bilinear", now, then, noise, rng))
                score.add(found, crack)
                held_back += conditional(found)
        print(
            f"cracks of {low:.0%} to {high:.0%}: {score} ({held_back} on condition)"
            f" of {many * len(counts)}",
            flush=True,
        )


def constant(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print how often a crack is claimed where a plate differs from the scene's, before and
    since."""
    forward = solve_forward(fc.Scene.from_text(PLATE), (), folder)
    counts = ((3, 1e-5), (5, 1e-5), (5, 1e-3))[: max(1, round(3 * share))]
    for known in (True, False):
        claimed = 0
        for kind, lower, (modes, noise) in product(CHANGES, LOWER, counts):
            hertz = changed(kind, lower)[:modes]
            measured = both("frequency_bilinear", hertz, hertz, noise, rng)
            if not known:
                measured = fc.Measurements(measured.rows[:modes])
            claimed += infer(forward, measured).verdict == "crack"
        total = len(CHANGES) * len(LOWER) * len(counts)
        print(f"constant{', and before' if known else ''}: {total}, claimed {claimed}", flush=True)


@dataclass(frozen=True)
class LetGo(Plate):
    """A plate that its clamp does not hold over a length at its left end [m]."""

    gone: float = 0.0

    @cached_property
    def free(self) -> np.ndarray:
        """True for the dofs that move: (2n,)."""
        found = Plate.free.func(self).reshape(-1, 2)
        found[np.isin(np.arange(len(found)), self._mesh[1]) & (self.nodes[:, 0] < self.gone)] = True
        return np.asarray(found.ravel())


def softer(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print what the directions of a clamp's softness leave of its changes."""
    scene = fc.Scene.from_text(PLATE)
    for ratio in SLENDERNESS:
        size = (TALL / ratio, TALL, THICKNESS)
        shape = {"geometry.width": size[0], "excitation.point": size[:2], "output": None}
        own = scene.replace(NO_CRACK | shape | {"identify": None})
        directions = Whole(own, scene.given("identify")).by_clamp(1.0)
        directions = np.column_stack([directions, np.ones(len(directions))])
        tip = 0.02 * size[0]  # lines of the mesh, where the clamp may end
        rigid = LetGo(size, YOUNG, POISSON, DENSITY, tip, TALL / 3.0, cracked=False)
        others = [replace(rigid, gone=part * size[0] + 1e-9) for part in (0.02, 0.04)]
        others.append(replace(rigid, clamp=0.01 * size[0]))
        others.append(replace(rigid, size=(size[0], 1.002 * TALL, THICKNESS)))
        plain, left = rigid.frequencies(6), 0.0
        for plate in others:
            changes = plate.frequencies(6) / plain - 1.0
            for modes in (4, 5, 6):
                few, known = changes[:modes], directions[:modes]
                rest = few - known @ np.linalg.lstsq(known, few, rcond=None)[0]
                left = max(left, np.abs(rest).max() / np.abs(few).max())
        print(f"softer, {ratio} times as tall as wide: {left:.2f} is left", flush=True)


# --- resonances -----------------------------------------------------------------------------------

BREATHING = ((0.01, 0.06), (0.02, 0.1), (0.03, 0.15), (0.04, 0.06), (0.03, 0.22))
"""Lengths and heights of cracks [m]."""
RATIOS = (0.005, 0.02)
"""Of damping."""


def peaks(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print where resonances are."""
    scene = fc.Scene.from_text(PLATE).replace({"identify": None})
    for mode, ratio in product((1, 2, 3), RATIOS):
        found = []
        for length, height in BREATHING:
            own = {"crack.length": length, "crack.height": height, "damping.ratio": ratio}
            study = fc.prepare(scene.replace(own), MPI.COMM_SELF)
            assert study.contact is not None
            pair = fc.bilinear_frequencies(study.structure)
            low, high = pair.omega_open[mode - 1], pair.omega_tied[mode - 1]
            beyond = high - low + 2.0 * ratio * low
            curve = fc.continue_frequency(
                study.structure, low - beyond, high + beyond, study.contact, harmonics=5
            )
            size = curve.indicators(study.watched[0].dof).harmonic_1
            most = int(np.argmax(size))
            if not 0 < most < len(size) - 1:
                found.append("none")
                continue
            three = slice(most - 1, most + 2)
            bent, slope, _ = np.polyfit(curve.omega[three] - low, size[three], 2)
            off = (low - 0.5 * slope / bent - pair.omega_bilinear[mode - 1]) / (high - low)
            found.append(f"{off:+.3f} ({(high - low) / low:.2%})")
        print(f"peaks, mode {mode}, damping {ratio:.1%}: {', '.join(found)}", flush=True)


# --- slender beams --------------------------------------------------------------------------------

DEEP, LONG = 0.01, 0.4
SLENDER = f"""
geometry = {{ width = {DEEP}, height = {LONG}, thickness = 0.01 }}
crack = {{ edge = "left", height = 0.1, length = 0.002 }}
material = {{ young = {YOUNG}, poisson = {POISSON}, density = {DENSITY} }}
damping = {{ ratio = 0.005, modes = 8 }}
excitation = {{ point = [{DEEP}, {LONG}], force_sin = [1.0, 0.0], frequency = 20.0 }}
contact = {{ law = "unilateral" }}
mesh = {{ layout = "graded", order = 2, size = 0.005, lip_elements = 2 }}
[identify]
finer = 1.5
[identify.unknown]
"crack.length" = {{ start = 0.0005, stop = 0.0055, count = 8 }}
"crack.height" = {{ start = 0.01, stop = 0.39, count = 20 }}
"""
BEAMS, OF_BEAMS = 30, 1e-3
"""How many with one crack and with two, and the noise of their frequencies."""
PARTS = 200
"""Elements of a beam."""


def compliance(share: float) -> float:
    """Rotation by a moment of an edge crack in bending, times E b h^2, by its length over h: the
    energy released by the stress intensity of Tada, Paris and Irwin's handbook."""

    def shape(a: float) -> float:
        turn = 0.5 * np.pi * a
        factor = (0.923 + 0.199 * (1.0 - np.sin(turn)) ** 4) / np.cos(turn)
        return float(np.sqrt(np.tan(turn) / turn) * factor)

    return 72.0 * np.pi * quad(lambda a: a * shape(a) ** 2, 0.0, share)[0]


def beam(cracks: np.ndarray, young: float) -> np.ndarray:
    """The first five natural frequencies of a clamped beam of Timoshenko's with cracks (n, 2) that
    stay open, lengths and places [m], each in the element where it is [Hz]."""
    step, area = LONG / PARTS, 0.01 * DEEP
    bending = young * area * DEEP**2 / 12.0
    shear = 5.0 / 6.0 * young / (2.0 * (1.0 + POISSON)) * area
    stiffness, mass = (np.zeros((2 * PARTS + 2,) * 2) for _ in range(2))
    for part in range(PARTS):
        # Flexibility of a cantilever's end by force and moment; a crack adds to it where it is.
        own = [
            [step**3 / (3.0 * bending) + step / shear, step**2 / (2.0 * bending)],
            [step**2 / (2.0 * bending), step / bending],
        ]
        flexible = np.array(own)
        for length, place in cracks:
            if part == min(int(place / step), PARTS - 1):
                arm = np.array([(part + 1) * step - place, 1.0])
                turn = compliance(length / DEEP) / (young * area * DEEP)
                flexible += turn * np.outer(arm, arm)
        end = np.linalg.inv(flexible)
        rigid = np.array([[-1.0, -step, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
        at = slice(2 * part, 2 * part + 4)
        stiffness[at, at] += rigid.T @ end @ rigid
        # Mass, and rotary inertia, of Hermite's cubics.
        translation = np.array(
            [
                [156.0, 22.0 * step, 54.0, -13.0 * step],
                [22.0 * step, 4.0 * step**2, 13.0 * step, -3.0 * step**2],
                [54.0, 13.0 * step, 156.0, -22.0 * step],
                [-13.0 * step, -3.0 * step**2, -22.0 * step, 4.0 * step**2],
            ]
        )
        rotation = np.array(
            [
                [36.0, 3.0 * step, -36.0, 3.0 * step],
                [3.0 * step, 4.0 * step**2, -3.0 * step, -(step**2)],
                [-36.0, -3.0 * step, 36.0, -3.0 * step],
                [3.0 * step, -(step**2), -3.0 * step, 4.0 * step**2],
            ]
        )
        each = DENSITY * area * step
        mass[at, at] += each / 420.0 * translation
        mass[at, at] += each * DEEP**2 / 12.0 / (30.0 * step**2) * rotation
    squares = eigh(stiffness[2:, 2:], mass[2:, 2:], eigvals_only=True, subset_by_index=[0, 4])
    return np.asarray(np.sqrt(squares) / (2.0 * np.pi))


def beams(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print how one crack, or two, are found in slender beams."""
    forward = solve_forward(fc.Scene.from_text(SLENDER), (), folder)
    many = max(1, round(share * BEAMS))
    for count in (2, 1):
        counts: Counter[str] = Counter()
        for _ in range(many):
            young = YOUNG * (1.0 + PLATES * rng.standard_normal())
            lengths = rng.uniform(0.15, 0.45, count) * DEEP
            places = rng.uniform(0.1, 0.8, count) * LONG
            cracks = np.column_stack([lengths, places])
            measured = both(
                "frequency_open", beam(cracks, young), beam(cracks[:0], young), OF_BEAMS, rng
            )
            for modes in (3, 4, 5):
                few = [row for row in measured.rows if row.mode <= modes]
                found = infer(forward, fc.Measurements(tuple(few)))
                claimed = found.verdict == "crack"
                length, height = (found.intervals[key] for key in SIZES)
                inside = [height[0] <= place <= height[1] for place in places]
                counts[f"{modes} modes, claimed"] += claimed
                counts[f"{modes} modes, claimed at no crack"] += claimed and not any(inside)
                counts[f"{modes} modes, interval of the place holds one"] += any(inside)
                if count == 1:
                    holds = length[0] <= lengths[0] <= length[1]
                    counts[f"{modes} modes, interval of the length holds"] += holds
        print(f"beams of {count} crack(s), of {many}: {dict(sorted(counts.items()))}", flush=True)


# --- other cracks than are looked for -------------------------------------------------------------

TWO, ABOVE, INSIDE = 20, 24, 16


def faults(rng: np.random.Generator, kind: str, count: int) -> Iterator[dict[str, Any]]:
    """Changes of a scene for cracks of a kind."""
    for _ in range(count):
        lengths = rng.uniform(0.1, 0.4, 2) * WIDE
        low, high = np.sort(rng.uniform(0.1, 0.8, 2)) * TALL
        if kind == "two cracks":
            high = max(high, low + 0.1 * TALL)
            yield {"crack": None} | {
                f"cracks.{number}.{key}": value
                for number, (length, height) in enumerate(zip(lengths, (low, high), strict=True), 1)
                for key, value in (("edge", "left"), ("height", height), ("length", length))
            }
        elif kind == "above":
            yield {"crack.length": lengths[0], "crack.height": rng.uniform(0.55, 0.9) * TALL}
        else:
            center = rng.uniform(0.3, 0.7) * WIDE
            room = 2.0 * (min(center, WIDE - center) - 0.05 * WIDE)
            inside = {"crack.edge": None, "crack.center": center, "crack.height": low}
            yield inside | {"crack.length": min(lengths[0], room)}


def others(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print what is said of cracks that are not looked for."""
    scene = fc.Scene.from_text(PLATE)
    lower = fc.Scene.from_text(PLATE.replace("stop = 0.28, count = 13", "stop = 0.15, count = 7"))
    bare = before(natural(scene.replace(FINER | NO_CRACK)))
    for kind, count in (("two cracks", TWO), ("above", ABOVE), ("inside", INSIDE)):
        forward = solve_forward(lower if kind == "above" else scene, (), folder)
        counts: Counter[str] = Counter()
        for changes in faults(rng, kind, max(1, round(share * count))):
            rows = natural(scene.replace(FINER | changes))
            measured = tuple(
                replace(row, value=row.value + row.deviation * rng.standard_normal())
                for row in (*rows, *bare)
            )
            found = infer(forward, fc.Measurements(measured))
            counts[found.verdict] += 1
            alone = any("explains all but" in warning for warning in found.warnings)
            counts["crack, by one measurement alone"] += found.verdict == "crack" and alone
            if found.verdict == "crack":
                print(f"  {changes}: {found}", flush=True)
        print(f"{kind}: {dict(counts)}", flush=True)


# --- blades whose pull holds a crack open ---------------------------------------------------------

BLADE = """
geometry = { width = 0.02, height = 0.25, thickness = 0.004 }
crack = { edge = "left", height = 0.03, length = 0.008 }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.005 }
rotation = { rpm = 3000.0, hub_radius = 0.25 }
excitation = { point = [0.02, 0.25], force_mean = [-40, 0], force_sin = [40, 0], order = 5 }
contact = { law = "unilateral" }
harmonic_balance = { harmonics = 6 }
mesh = { layout = "graded", order = 2, size = 0.01, lip_elements = 4 }
reduction = { modes = 8 }
[output.points]
tip = [0.02, 0.25]
[identify]
finer = 1.5
[identify.unknown]
"crack.length" = { start = 0.004, stop = 0.012, count = 5 }
"""
BLADES = {"identify": None, "mesh.size": 0.006, "mesh.lip_elements": 6, "reduction.modes": 12,
          "harmonic_balance.harmonics": 12}  # fmt: skip
"""Of the blades that are measured."""
LOADED, CRACKED, WHOLE = 20, 4, 2
"""Loads, each of a speed and a size, and blades with a crack and without one at each."""
BESIDE = 4
"""Loads beside which a natural frequency is measured, too."""
SLOWEST, FASTEST = 2500.0, 3100.0
"""[rpm]"""
SMALLEST, LARGEST = 2.0, 60.0
"""Of loads that vary [N]."""
PROBES = np.radians([12.0, 47.0, 93.0, 131.0, 178.0, 224.0, 262.0, 307.0])
JITTER, OF_BLADES = 2e-8, 1e-3
"""Noise of an arrival [s], and of a natural frequency over its value."""


def arrivals(scene: fc.Scene, seed: int) -> Rows:
    """Displacements of a blade's tip at the probes."""
    run = fc.solve(scene)
    seen = fc.tip_timing(
        run.result, run.watched_dof, probes=PROBES, tip_radius=0.5, order=5, revolutions=60,
        noise=JITTER, seed=seed,
    )  # fmt: skip
    return list(fc.Measurements.from_arrivals(seen, 5, "tip.ux").rows)


def at_rest(scene: fc.Scene, quantity: str, rng: np.random.Generator) -> Rows:
    """The first natural frequency at rest."""
    still = scene.replace({"rotation": None, "excitation.order": None, "excitation.frequency": 1.0})
    hertz = fc.solve_modes(fc.build_structure(still), 1).omega / (2.0 * np.pi)
    [row] = noisy(quantity, hertz, OF_BLADES, rng)
    return [replace(row, rpm=0.0)]


def blades(folder: Path, rng: np.random.Generator, share: float) -> None:
    """Print how cracks are found from arrivals under a load, and with a frequency beside them."""
    counts = {known: Counter[str]() for known in (False, True)}
    beside = max(1, round(share * BESIDE))
    for number in range(max(1, round(share * LOADED))):
        force = SMALLEST * (LARGEST / SMALLEST) ** rng.random()
        load = {"rotation.rpm": rng.uniform(SLOWEST, FASTEST), "excitation.force_sin": (force, 0.0)}
        scene = fc.Scene.from_text(BLADE).replace(load)
        true = scene.replace(BLADES)
        healthy = true.replace(NO_CRACK)
        for length in [*rng.uniform(0.004, 0.012, CRACKED), *[0.0] * WHOLE]:
            one = true.replace({"crack.length": length}) if length else healthy
            alone = arrivals(one, int(rng.integers(10**9)))
            frequency = at_rest(one, "frequency_open", rng) + at_rest(healthy, BEFORE, rng)
            for known in (False, True)[: 1 + (number < beside)]:
                rows = alone + (frequency if known else [])
                found = fc.identify(scene, fc.Measurements(tuple(rows)), folder=folder)
                kind = "cracked" if length else "healthy"
                counts[known][f"{kind}: {found.verdict}"] += 1
                if not length:
                    continue
                held = found.contains({"crack.length": length})
                counts[known]["held"] += held
                counts[known]["claimed and held"] += held and found.verdict == "crack"
    for known, some in counts.items():
        name = "arrivals and the first frequency" if known else "arrivals alone"
        print(f"blades, {name}: {dict(sorted(some.items()))}", flush=True)


PARTS_OF = {
    "clamps": clamps,
    "constant": constant,
    "softer": softer,
    "peaks": peaks,
    "beams": beams,
    "others": others,
    "blades": blades,
}


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "folder", nargs="?", type=Path, default=Path("output/identification_limits")
    )
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--only", choices=PARTS_OF, action="append")
    parser.add_argument("--share", type=float, default=1.0)
    given = parser.parse_args()
    for number, (name, part) in enumerate(PARTS_OF.items()):
        if name in (given.only or PARTS_OF):
            part(given.folder, np.random.default_rng([given.seed, number]), given.share)


if __name__ == "__main__":
    main()
