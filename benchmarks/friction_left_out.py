"""What friction would change: stated beside solutions without it, and true.

``random``: 33 random scenes, plates, blades under a rotor's load whose crack is pressed together,
and plates whose crack faces keep their mass, with seeds that were fixed before. The true effect on
half the peak-to-peak displacement, opening and ratio 2/1 is that between the scene solved with a
coefficient of 0.3 and without, both as exact orbits of 60 modes; of faces with mass without it, and
with a tangential stiffness as the normal one. An effect below a tenth of the tolerance counts as
right if twice as much is stated at most.

``modes``: the plate of ``new`` with 10 to 80 modes: the stated effect, and the processor time that
it takes.

``fresh``: 30 further scenes of these kinds; true effects, with 80 modes, over stated errors.
``--seed`` draws them.

    OMP_NUM_THREADS=1 python benchmarks/friction_left_out.py [--quick] [--only PART] [--seed N]
        [folder]
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.basics.errors import DEFAULT_ERROR_TOLERANCE

NAMES = ("amplitude", "opening", "ratio_2_1")
COEFFICIENT = 0.3
KINDS = ("plate", "blade", "mass")
SEEDS = range(300, 311)
HOLDS = 0.5, 2.0
"""Stated over true effect within which it counts as right."""


def new_plate() -> fc.Scene:
    """The scene that ``fenics-crack new`` writes."""
    return fc.Scene.load(Path(__file__).with_name("plate.toml"))


def random_scene(kind: str, seed: int | list[int]) -> fc.Scene:
    """One of a kind, near or between the first two resonances."""
    rng = np.random.default_rng(seed)
    slender = (3.0, 6.0) if kind == "blade" else (1.5, 4.0)
    width = float(10.0 ** rng.uniform(-1.5, -0.9))
    height, angle = width * rng.uniform(*slender), rng.uniform(0.0, 2.0 * np.pi)
    changes: dict[str, Any] = {
        "geometry.width": width, "geometry.height": height, "geometry.thickness": 0.1 * width,
        "crack.height": height * rng.uniform(0.1, 0.7),
        "crack.length": width * rng.uniform(0.15, 0.5), "excitation.point": [width, height],
        "damping.ratio": float(10.0 ** rng.uniform(-2.5, -1.8)),
        "excitation.force_sin": [10.0 * np.cos(angle), 10.0 * np.sin(angle)],
        "mesh.size": width / 8.0, "mesh.lip_elements": int(rng.integers(4, 8)), "mesh.grading": 4.0,
        "mesh.error": False, "reduction.modes": 20, "curve": None, "sweep": None,
    }  # fmt: skip
    mode, factor = int(rng.integers(0, 2)), float(rng.uniform(0.6, 1.1))
    if kind == "blade":
        changes |= {"rotation.rpm": float(rng.uniform(500.0, 3000.0)), "rotation.hub_radius": 0.2}
    if kind == "mass":
        stiffness = float(10.0 ** rng.uniform(12.5, 13.5))
        changes |= {"contact.law": "penalty", "contact.stiffness_per_area": stiffness}
        changes |= {"reduction.method": "free_interface", "mesh.lip_elements": 3}
    scene = new_plate().replace(changes)
    study = fc.prepare(scene)
    omega = factor * fc.bilinear_frequencies(study.structure).omega_bilinear[mode]
    at = {"excitation.frequency": float(omega / (2.0 * np.pi))}
    if kind == "blade":  # the mean load takes back what the rotor opens
        open_gap, pressed_gap = (
            fc.solve_linear(fc.prepare(scene.replace(force)).structure, 1.0).gap_coefficients[0]
            for force in ({}, {"excitation.force_mean": [-1.0, 0.0]})
        )
        widest = int(np.argmin(open_gap))
        force = -open_gap[widest] / (pressed_gap[widest] - open_gap[widest])
        at |= {"excitation.force_mean": [-float(force * rng.uniform(0.9, 1.1)), 0.0]}
    return scene.replace(at)


def with_and_without(scene: fc.Scene, modes: int = 60) -> dict[str, float]:
    """True relative effects of friction."""
    keys: dict[str, Any] = {"contact.friction": COEFFICIENT, "reduction.modes": modes}
    contact = scene.given("contact")
    if contact.stiffness_per_area is not None:
        keys["contact.tangential_stiffness_per_area"] = contact.stiffness_per_area
        keys["reduction.method"] = "massless"  # others have no statics of the tangents
    numbers = []
    stiffness = "contact.tangential_stiffness_per_area"
    for changes in (keys, keys | {"contact.friction": None, stiffness: None}):
        study = fc.prepare(scene.replace(changes), judged=False)
        assert study.contact is not None
        solution = fc.solve_harmonic_balance(
            study.structure, scene.excitation.omega, study.contact, tolerance=1e-3, throw=False
        )
        numbers.append(solution.indicators(study.watched[0].dof))
    return {n: float(getattr(numbers[0], n) / getattr(numbers[1], n)) - 1.0 for n in NAMES}


def effects(scene: fc.Scene) -> dict[str, tuple[float, float]] | str:
    """Stated and true effects by the name of a number; or why nothing is stated."""
    run = fc.solve(scene)
    assert run.errors is not None
    if (part := run.errors.parts.get("friction")) is None:
        return run.errors.unknown.get("friction", "the error is unknown")
    stated_changes = {n: part[n].values[1] / part[n].values[0] - 1.0 for n in NAMES if n in part}
    true_changes = with_and_without(run.scene)
    return {name: (value, true_changes[name]) for name, value in stated_changes.items()}


def is_right(stated: float, true: float) -> bool:
    """True if an effect is stated within a factor, or is too small to matter."""
    smallest_change = 0.1 * DEFAULT_ERROR_TOLERANCE
    is_small = abs(true) < smallest_change and abs(stated) < 2.0 * smallest_change
    return bool(is_small or (true and HOLDS[0] <= stated / true <= HOLDS[1]))


def rows_of_random(quick: bool) -> Iterator[common.Row]:
    """A row for each number of each scene."""
    for kind in KINDS:
        for seed in list(SEEDS)[:: 4 if quick else 1]:
            effect_by_name = effects(random_scene(kind, seed))
            if isinstance(effect_by_name, str):
                yield kind, seed, effect_by_name, np.nan, np.nan, "no"
                continue
            for name, (stated_change, true_change) in effect_by_name.items():
                yield (
                    kind,
                    seed,
                    name,
                    stated_change,
                    true_change,
                    "yes" if is_right(stated_change, true_change) else "no",
                )


def random(arguments: common.Arguments) -> None:
    """The random scenes."""
    rows = list(rows_of_random(arguments.quick))
    columns = ("kind", "seed", "number", "stated", "true", "right")
    path = arguments.folder / "friction_left_out.csv"
    common.save_table(path, "effects of friction", columns, rows)
    scenes = {row[:2] for row in rows}
    wrong_scenes = {row[:2] for row in rows if row[-1] == "no"}
    print(f"{len(scenes - wrong_scenes)} of {len(scenes)} scenes right in all of their numbers")


def fresh(arguments: common.Arguments) -> None:
    """True effects over stated errors of scenes that had no part in the choice of the rule."""
    rows: list[common.Row] = []
    for number in range(6 if arguments.quick else 30):
        kind = KINDS[number % 3]
        run = fc.solve(random_scene(kind, [arguments.seed, number]))
        assert run.errors is not None
        part = run.errors.parts.get("friction")
        if part is None:
            print(number, kind, run.errors.unknown)
            continue
        true_changes = with_and_without(run.scene, 80)
        for name in set(NAMES) & set(part):
            stated_error = part[name].uncertainty(-1) / abs(run.errors.values[name])
            true_change = abs(true_changes[name])
            rows.append((kind, number, name, stated_error, true_change, true_change / stated_error))
    columns = ("kind", "scene", "number", "stated", "true", "true / stated")
    common.save_table(arguments.folder / "friction_fresh.csv", "fresh scenes", columns, rows)
    ratios = np.array([row[-1] for row in rows])
    median, largest = np.nanmedian(ratios), np.nanmax(ratios)
    n_large = np.sum(ratios > 2.0)
    print(f"{len(ratios)} numbers: median {median:.2f}, largest {largest:.2f}, above 2: {n_large}")


def modes(arguments: common.Arguments) -> None:
    """The plate of ``new``."""
    rows = []
    for count in (10, 20, 40, 80):
        run = fc.solve(new_plate().replace({"mesh.error": False, "reduction.modes": count}))
        assert run.errors is not None
        part = run.errors.parts["friction"]
        rows.append((count, *(part[n].values[1] / part[n].values[0] - 1.0 for n in NAMES)))
    columns = ("modes", *NAMES)
    path = arguments.folder / "friction_by_modes.csv"
    common.save_table(path, "effects of friction by the number of modes", columns, rows)


if __name__ == "__main__":
    seed = {"type": int, "default": 1, "help": "of the fresh scenes"}
    common.run(__doc__, {"random": random, "modes": modes, "fresh": fresh}, seed=seed)
