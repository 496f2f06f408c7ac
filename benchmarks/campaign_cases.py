"""What the campaign asks about: random systems, each from a seed and its number alone.

few         1 to 12 masses in a chain or with random mode shapes, or the paper's plate reduced to 6
            to 12 modes; 1 to 4 pairs; k times the static compliance 0.1 to 1e4; damping 1e-3 to
            5e-2; clearances of either sign; loads with phases, some with a mean
mass        the same with 6 to 18 masses and 5 to 10 pairs; "crowd": 11 to 16 pairs
plate       the plate of `new` and the blade of demos/, one edge crack, 8 to 60 pairs without mass,
            10 to 40 modes, rigid or penalty, preload or clearance or neither, 0.05 to 1 % of
            damping, around bilinear resonances, a half and a third of them
cracks      the same with two cracks
inner       the same with a crack inside
rotation    the same on a rotor, the load as large as the mean opening
ends        "few" once more, the ends of branches of twice the period
turning     "few" once more with gyroscopic forces: a damping matrix that is not symmetric

and three whose answers have no exact flow in the package:

smooth      1 to 8 masses, 1 to 4 pairs with a smoothed penalty, k up to 1000 times the
            static stiffness; the judge integrates
rigid       "few" without penetration, half of them the paper's plate, with 20 to 160 harmonics; the
            judge has a penalty 1e5 times as stiff as the structure
whole       all dofs of a coarse mesh of the plate of `new`, with a penalty; for the judge 100 modes
            move, and the others answer at once
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import common
import numpy as np
import scipy.linalg
from reference_flow import WHOLE, ReferenceFlow, SmoothFlow

import fenics_crack as fc

FEW_KINDS = {
    "solution": 0.6, "tolerance": 0.2, "curve": 0.12, "branch": 0.08, "parameter": 0.0,
}  # fmt: skip
TURNING_KINDS = {"solution": 0.6, "tolerance": 0.2, "curve": 0.15, "branch": 0.05}
MASS_KINDS = {"solution": 0.6, "tolerance": 0.3, "curve": 0.1}
PLATE_KINDS = {
    "solution": 0.5, "tolerance": 0.2, "whole": 0.05, "peak": 0.1, "curve": 0.1, "reduction": 0.05,
    "parameter": 0.0,
}  # fmt: skip
FAMILIES: dict[str, tuple[float, dict[str, float]]] = {
    "few": (0.10, FEW_KINDS),
    "mass": (0.15, MASS_KINDS),
    "crowd": (0.02, MASS_KINDS),
    "plate": (0.32, PLATE_KINDS),
    "cracks": (0.1, PLATE_KINDS),
    "inner": (0.1, PLATE_KINDS),
    "rotation": (0.1, PLATE_KINDS),
    "ends": (0.06, {"ends": 1.0}),
    "smooth": (0.03, {"solution": 0.8, "tolerance": 0.2}),
    "rigid": (0.01, {"solution": 1.0}),
    "whole": (0.01, {"solution": 1.0}),
    "turning": (0.0, TURNING_KINDS),
}
"""How often each is drawn, and what is asked of it; what came later is asked by itself, so that the
other numbers stay the cases that they were."""
RIGID = 1e6
"""k times the static compliance of the penalty that stands for a rigid stop."""
KINDS = list(dict.fromkeys(kind for _, kinds in FAMILIES.values() for kind in kinds))
SCENES = {"plate": Path(__file__).with_name("plate.toml"), "blade": common.DEMOS / "blade.toml"}


@dataclass(frozen=True)
class Case:
    """One random system, and what is asked of it."""

    number: int
    kind: str
    structure: fc.Structure
    law: Any
    omega: float
    harmonics: int
    tolerance: float
    product: float
    family: str = "few"
    known: list[dict] = field(default_factory=list)
    _flows: dict[tuple[int, int], tuple[Any, Any, ReferenceFlow]] = field(default_factory=dict)

    def flow(self, structure: fc.Structure, law: Any = None) -> ReferenceFlow:
        """The exact flow of a structure, its own or one with other modes, and of a law, its own or
        one along a curve; kept."""
        law = law or self.law
        key = id(structure), id(law)
        if key not in self._flows:
            flow, exact = ReferenceFlow, law
            if isinstance(law, fc.SmoothedPenalty):
                flow = SmoothFlow
            elif self.family == "rigid":
                exact = fc.UnilateralPenalty(self.product / _modes(structure)[1])
            self._flows[key] = structure, law, flow(structure, exact)
        return self._flows[key][-1]


def family_of(seed: int, number: int) -> str:
    """The family of a number where all are asked."""
    rng = np.random.default_rng([seed, number, 1])
    return str(rng.choice(list(FAMILIES), p=[share for share, _ in FAMILIES.values()]))


def draw(seed: int, number: int, only: str | None = None, family: str = "few") -> Case:
    """The case of a seed and a number in a family; ``only``: what is asked."""
    key = [seed, number] if family == "few" else [seed, number, 2 + list(FAMILIES).index(family)]
    rng = np.random.default_rng(key)
    shares = FAMILIES[family][1]
    kind = only or str(rng.choice(list(shares), p=list(shares.values())))
    if family in ("few", "mass", "crowd", "ends", "smooth", "rigid", "turning"):
        return _of_masses(rng, number, kind, family)
    if family == "whole":
        return _of_all_dofs(rng, number, kind, family)
    return _of_plates(rng, number, kind, family)


# --- masses ---------------------------------------------------------------------------------------


def _of_masses(rng: np.random.Generator, number: int, kind: str, family: str) -> Case:
    """Pairs with mass, one by one to the ground or to other masses."""
    pair_range = {"mass": (5, 10), "crowd": (11, 16)}.get(family)
    plates = {"few": 0.05, "ends": 0.05, "rigid": 0.5}.get(family, 0.0)
    if plates and rng.random() < plates:
        structure = _plate(rng)
    else:
        structure = _masses(rng, pair_range, family == "turning")
        while family == "smooth" and structure.n_dofs > 8:  # few enough for an integrator
            structure = _masses(rng)
    squares, static = _modes(structure)
    natural_omega = np.sqrt(np.maximum(squares[:3], 0.0))
    share = rng.choice([1 / 3, 1 / 2, 1.0, 2.0, 3.0, 10.0 ** rng.uniform(-0.5, 0.5)])
    omega = float(rng.choice(natural_omega) * share * (1.0 + 0.03 * rng.normal()))
    product = 10.0 ** rng.uniform(-1.0, 3.0 if family == "smooth" else 4.0)
    law: Any = fc.UnilateralPenalty(product / static)
    linear = fc.solve_linear(structure, omega).gap_coefficients
    size = np.sqrt(np.sum(linear[1:] ** 2, axis=0)).max() or 1.0
    pairs = structure.n_pairs
    clearance = rng.choice([-1.0, 1.0], pairs) * 10.0 ** rng.uniform(-2.0, 0.3, pairs) * size
    clearance = np.where(rng.random(pairs) < 0.4, 0.0, clearance)
    if rng.random() < 0.15:  # a pair just opens, or just closes
        pair = int(rng.integers(pairs))
        motion = structure if rng.random() < 0.5 else structure.tied(law.stiffness)
        waves = structure.apply_bt(fc.solve_linear(motion, omega).displacement_coefficients)
        clearance[pair] = _extremum(waves[:, pair], rng) * (1.0 - 10.0 ** rng.uniform(-4.0, -1.0))
    if family == "smooth":
        law = fc.SmoothedPenalty(law.stiffness, 10.0 ** rng.uniform(1.0, 3.0) / size)
    elif family == "rigid":
        law, product = fc.UnilateralConstraint(), RIGID
    counts = [20, 40, 80, 160] if family == "rigid" else [5, 10, 20, 40]
    tolerances = [1e-2, 1e-3] if pair_range is None else [1e-2, 1e-3, 1e-4]
    return Case(
        number, kind, structure.varied(clearance=clearance), law, omega,
        int(rng.choice(counts)), float(rng.choice(tolerances)), product, family,
    )  # fmt: skip


def _modes(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the natural frequencies, and the static compliance that each pair sees [m/N]."""
    stiffness, mass = (np.asarray(m[:, :]) for m in (structure.stiffness, structure.mass))
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    modal_gap = shapes.T @ structure.gap.toarray()
    return squares, np.einsum("mp,m,mp->p", modal_gap, 1.0 / squares, modal_gap)


def _extremum(wave: np.ndarray, rng: np.random.Generator) -> float:
    """The largest or smallest value of a mean and a first harmonic."""
    return float(wave[0] + rng.choice([-1.0, 1.0]) * np.hypot(wave[1], wave[2]))


def _masses(
    rng: np.random.Generator, pairs_from: tuple[int, int] | None = None, turning: bool = False
) -> fc.Structure:
    """A chain, or modes of random shapes with frequencies up to 30 times the first; ``turning``:
    with gyroscopic forces."""
    if pairs_from is None:
        count = int(rng.integers(1, 13))
    else:
        count = int(rng.integers(pairs_from[0] + 1, pairs_from[1] + 9))
    if rng.random() < 0.5:
        mass = np.diag(10.0 ** rng.uniform(-0.5, 0.5, count))
        springs = 10.0 ** rng.uniform(-1.0, 1.0, count + 1)
        off_diagonal = np.diag(springs[1:-1], 1)
        stiffness = np.diag(springs[:-1] + springs[1:]) - off_diagonal - off_diagonal.T
    else:
        mass = np.eye(count)
        rotation = np.linalg.qr(rng.normal(size=(count, count)))[0]
        squares = np.append(1.0, 30.0 ** (2.0 * rng.random(count - 1)))
        stiffness = (rotation * squares) @ rotation.T
        stiffness = 0.5 * (stiffness + stiffness.T)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    rates = 2.0 * 10.0 ** rng.uniform(-3.0, np.log10(0.05), count) * np.sqrt(squares)
    damping = mass @ (shapes * rates) @ shapes.T @ mass
    damping = 0.5 * (damping + damping.T)
    if turning:
        spins = 10.0 ** rng.uniform(-2.0, 0.3) * np.sqrt(squares[0]) * rng.normal(size=mass.shape)
        damping += mass @ (spins - spins.T) @ mass
    min_pairs, max_pairs = pairs_from or (1, 4)
    pairs = int(rng.integers(min_pairs, min(max_pairs, count) + 1))
    gap = np.zeros((count, pairs))
    for pair, place in enumerate(rng.choice(count, pairs, replace=False)):
        gap[place, pair] = rng.choice([-1.0, 1.0])
        if count > 1 and rng.random() < 0.4:
            gap[(place + rng.integers(1, count)) % count, pair] = -gap[place, pair]
    loads = rng.normal(size=(3, count)) * (rng.random((3, count)) < 0.5)
    loads[0, rng.integers(count)] = 1.0
    loads[2] *= 0.0 if rng.random() < 0.7 else 0.3
    return fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_cos=loads[0], force_sin=loads[1], force_mean=loads[2],
        damping=damping,
    )  # fmt: skip


@cache
def _whole_plate(ratio: float) -> fc.Structure:
    return common.plate("paper_plate", {"damping.ratio": ratio})


def _plate(rng: np.random.Generator) -> fc.Structure:
    """The paper's plate with few of its modes."""
    plate = _whole_plate(float(rng.choice([0.002, 0.01, 0.03])))
    return fc.reduce_structure(plate, modes=int(rng.integers(6, 13)))


# --- plates and blades ----------------------------------------------------------------------------


def _of_plates(rng: np.random.Generator, number: int, kind: str, family: str) -> Case:
    """Lips without mass; of the whole structure where the modes are to be chosen."""
    table = _scene(rng, family)
    structure = _reduced(table)
    natural_omega = fc.bilinear_frequencies(structure).omega_bilinear
    mode = min(int(rng.choice(4, p=[0.5, 0.25, 0.15, 0.1])), len(natural_omega) - 1)
    share = 1.0 if kind == "peak" else float(rng.choice([1.0, 1 / 2, 1 / 3], p=[0.55, 0.25, 0.2]))
    relative_width = 2.0 * table["damping"]["ratio"] if rng.random() < 0.5 else 0.05
    omega = float(natural_omega[mode] * share * (1.0 + relative_width * rng.normal()))
    linear = fc.solve_linear(structure, omega).gap_coefficients
    size = float(np.sqrt(np.sum(linear[1:] ** 2, axis=0)).max())
    if family == "rotation":
        factor = 10.0 ** rng.uniform(-0.3, 0.7) * float(np.abs(linear[0]).max()) / size
        table["excitation"]["force_sin"] = [
            factor * value for value in table["excitation"]["force_sin"]
        ]
        structure, size = _reduced(table), factor * size
    compliance = _static(structure)
    if rng.random() < 0.6:
        law, product = fc.UnilateralConstraint(), np.inf
    else:
        product = 10.0 ** rng.uniform(0.0, 4.0)
        law = fc.UnilateralPenalty(product / compliance)
    sign = float(rng.choice([0.0, -1.0, 1.0], p=[0.5, 0.25, 0.25]))
    clearance = sign * size * 10.0 ** rng.uniform(-2.0, 0.0)
    harmonics = int(rng.choice([5, 10, 20, 40] if kind != "reduction" else [20, 40]))
    tolerance = float(rng.choice([1e-2, 1e-3, 1e-4]))
    if kind == "tolerance":  # of harmonics alone: one with more modes, whose reduction has no say
        assert isinstance(structure, fc.MasslessStructure) and structure.reference is not None
        structure = structure.reference
    if kind == "whole":
        structure = fc.prepare(fc.Scene.from_mapping(table), whole=True).structure
    return Case(
        number, kind, structure.varied(clearance=clearance), law, omega, harmonics, tolerance,
        product, family,
    )  # fmt: skip


def _of_all_dofs(rng: np.random.Generator, number: int, kind: str, family: str) -> Case:
    """A plate that is not reduced."""
    table = tomllib.loads(SCENES["plate"].read_text())
    table["crack"]["length"] = table["geometry"]["width"] * rng.uniform(0.2, 0.5)
    table["damping"]["ratio"] = 10.0 ** rng.uniform(-2.5, -1.5)
    table["mesh"] |= {"order": 1, "lip_elements": int(rng.integers(4, 9)), "size": 0.02}
    structure = fc.prepare(fc.Scene.from_mapping(table), whole=True).structure
    while structure.n_dofs <= WHOLE:
        table["mesh"]["lip_elements"] += 2
        structure = fc.prepare(fc.Scene.from_mapping(table), whole=True).structure
    squares, static = _modes(structure)
    share = rng.choice([1 / 3, 1 / 2, 1.0])
    omega = float(np.sqrt(squares[0]) * share * (1.0 + 0.1 * rng.normal()))
    product = 10.0 ** rng.uniform(-1.0, 1.5)
    law = fc.UnilateralPenalty(product / static)
    harmonics = int(rng.choice([3, 5, 10]))
    return Case(number, kind, structure, law, omega, harmonics, 1e-2, product, family)


def _scene(rng: np.random.Generator, family: str) -> dict[str, Any]:
    """The table of a scene."""
    name = "plate" if rng.random() < 0.7 else "blade"
    table = tomllib.loads(SCENES[name].read_text())
    for unused in ("curve", "sweep"):
        table.pop(unused)
    width, height = table["geometry"]["width"], table["geometry"]["height"]
    length, place = width * rng.uniform(0.1, 0.5), height * rng.uniform(0.12, 0.5)
    pairs = 10.0 ** rng.uniform(np.log10(8.0), np.log10(60.0))
    table["crack"] = {"edge": "left", "height": place, "length": length}
    if family == "inner":
        middle = width * rng.uniform(0.35, 0.65)
        table["crack"] = {"center": middle, "height": place, "length": min(length, 0.5 * width)}
    if family == "cracks":
        pairs *= 0.5
        other_crack = {
            "edge": str(rng.choice(["left", "right"])),
            "length": width * rng.uniform(0.1, 0.4),
        }
        table["cracks"] = [other_crack | {"height": place + height * rng.uniform(0.15, 0.4)}]
    if family == "rotation":
        table["rotation"] = {"rpm": rng.uniform(300.0, 3000.0), "hub_radius": 0.2}
    table["damping"]["ratio"] = 10.0 ** rng.uniform(np.log10(5e-4), -2.0)
    table["mesh"]["lip_elements"] = max(4, round(pairs / table["mesh"]["order"]))
    table["reduction"]["modes"] = int(rng.integers(10, 41))
    return table


def _reduced(table: dict[str, Any]) -> fc.Structure:
    return fc.prepare(fc.Scene.from_mapping(table)).structure


def _static(structure: fc.Structure) -> np.ndarray:
    """The static compliance that each pair sees [m/N]."""
    assert isinstance(structure, fc.MasslessStructure)
    modal_gap = structure.gap[: structure.n_modes].toarray()
    compliance: np.ndarray = np.diag(structure.residual_compliance) + np.sum(
        modal_gap**2 / structure.omega[:, None] ** 2, axis=0
    )
    return compliance
