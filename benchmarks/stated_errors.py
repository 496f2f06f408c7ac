"""True errors over stated ones.

``answers``: what every command states of its headline numbers (``run.errors``), on eighteen scenes
by which the estimate was made, and on three that were written down before any of them was run,
``held out``. The true error is the change on a mesh four times finer with twice the modes and 40
harmonics. At most 1.5 is meant for frequencies and amplitude, 3 for opening and 2/1, and at least a
fifth of each.

``plates``, ``solids``: the same of random scenes, watched at the tip's other corner than where the
force is: edge cracks and inner ones, of solids also part through, three metals, gaps, preloads and
mean loads, 60 % of them within a tenth of a resonance. Of solids the reference is a mesh twice as
fine.

``new_solids``: the same of four solids, three elements along the crack, at half and 0.9 of the
resonance at which their crack breathes, against meshes twice and three times as fine; and by how
much the last refinement moves a number, over its true error.

``half``: twenty random plates like that of ``fenics-crack new``, with elements of 20 mm, at half
the resonance: the mesh's part alone, against a mesh three times as fine with as many modes. At most
1.6 is meant.

``chosen``: random plates, solids and rotors whose modes the tolerance has chosen, on one mesh: the
truth is the orbit with four times the modes, sought from the answer. At most 1.3 is meant for
amplitude and opening, and tolerances met, or said not to be.

``wheels``: ten random wheels of 6 to 14 blades with one to three cracks, with one family and 0, 4
and 12 more modes, two and three families: the part of the error that is due to modes, of every
number. The true one is the change of a solution with 20 harmonics when it has six families and four
modes a blade more; of two wheels also nine, which shows how well it is known. At most 1.3 is meant
for amplitude and opening, 1.6 for the others.

``friction_modes``, ``plate_modes``: the part due to modes of every number that has an error, of ten
random scenes with friction (two meshes of one plate with an inclined crack, or a plate of the
benchmarks) and of ten random plates, with 5 to 20 modes. The true one is the change of the exact
orbit when it has four times as many, sought from the answer's. At most 1.6 is meant, and a median
from 0.4 to 1. ``--seed`` draws others, and other wheels.

The others: does the truth lie within the uncertainties of ``fc.verify``?

``mesh``: scenes of many kinds (the demos' plates, both orders, triangles, a grid, a crack inside,
none, loads at points and on edges). The true error is the change on a mesh four times finer.

``boxes``: the same of five boxes, on a mesh three times finer.

``harmonics``: variants of one plate with four pairs, lips with mass, a penalty law; some chosen,
others drawn (frequency, length, stiffness, damping, clearance, 3 to 19 harmonics). The true error
is the distance from the motion in time from event to event, which has no harmonics; variants whose
motion does not repeat within 400 periods are told and left out.

``modes``: the same plate with 5 to 20 modes, against the whole structure.

Printed: for each scene and quantity the value, the true and the stated relative error, their ratio,
the observed order and the behaviour; then how many ratios are above 1, and their quantiles.

    OMP_NUM_THREADS=1 python benchmarks/stated_errors.py [--quick] [--only PART] [--seed N] [folder]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import common
import numpy as np

import fenics_crack as fc
from fenics_crack.balance.error_report import report_by_more_modes
from fenics_crack.balance.more_modes import MoreModesComparison
from fenics_crack.basics.causes import MESH_ERROR_CAUSES
from fenics_crack.errors.convergence import MAX_RELATIVE_ROUNDING_SPREAD
from fenics_crack.errors.numbers import compute_numbers, compute_orbit_values_by_name
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.motion.flow import exact_flow_or_none
from fenics_crack.study.meshes import refine_scene_or_none
from fenics_crack.study.prepare import Study
from fenics_crack.study.solve import solve_study

Numbers = dict[str, float]
Vector = tuple[float, float, float]
Span = tuple[float, float]
COLUMNS = ("scene", "quantity", "value", "true", "stated", "true / stated", "order", "behaviour")
GRID = {
    "mesh.layout": "grid", "mesh.size": None, "mesh.lip_elements": None, "mesh.columns": 8,
    "mesh.rows": 8, "contact.stiffness_per_area": 5e9,
}  # fmt: skip
PULLED = {
    "excitation.point": None, "excitation.force_sin": (0.0, 0.0), "loads.1.edge": "top",
    "loads.1.traction_sin": (1000.0, 0.0),
}  # fmt: skip
OFTEN = 16
"""Times as many instants as of a solution, for a share closed that is known to 1e-6."""
MANY_MODES = 40
"""Those of the reference by which the modes' part of an error is judged."""
VARIANTS: list[dict[str, Any]] = [
    {},
    *({"harmonic_balance.harmonics": count} for count in (4, 10, 15)),
    *({"contact.stiffness_per_area": stiffness} for stiffness in (1e9, 1e10)),
    *({"excitation.omega": omega} for omega in (1500.0, 2600.0)),
    {"crack.length": 0.03},
    {"damping.ratio": 0.03},
    {"damping.ratio": 0.03, "contact.stiffness_per_area": 2e11},
    {"damping.ratio": 0.03, "excitation.omega": 3000.0},
    *({"damping.ratio": 0.03, "crack.clearance": clearance} for clearance in (2e-7, -2e-7)),
]


DRAWN, SEED = 24, 7
PLATE = Path(__file__).with_name("plate.toml")
OWN = {
    "geometry.width": 0.09, "geometry.height": 0.18, "crack.length": 0.027, "crack.height": 0.09,
    "damping.ratio": 0.003, "excitation.point": [0.09, 0.18],
}  # fmt: skip
SCENES: dict[str, dict[str, Any]] = {
    "plate, 800 Hz": {},
    "plate, at its resonance": {"excitation.frequency": 832.0},
    "plate, at half of it": {"excitation.frequency": 416.0},
    "own plate, 1832 Hz": OWN | {"excitation.frequency": 1832.0},
    "own plate, 1800 Hz": OWN | {"excitation.frequency": 1800.0},
    "long crack": {"crack.length": 0.045, "excitation.frequency": 700.0},
    "short crack": {"crack.length": 0.012, "excitation.frequency": 860.0},
    "fine mesh": {"mesh.lip_elements": 8, "mesh.size": 0.012},
    "low crack": {"crack.height": 0.05, "excitation.frequency": 300.0},
}
PULL = {
    "geometry.width": 0.12, "geometry.height": 0.24, "crack.edge": None, "crack.center": 0.06,
    "crack.height": 0.1, "crack.length": 0.05, "damping.ratio": 0.004, "mesh.size": 0.015,
    "mesh.lip_elements": 6, "excitation.point": None, "excitation.force_sin": [0.0, 0.0],
    "loads.1.edge": "top", "loads.1.traction_sin": [1000.0, 1000.0],
}  # fmt: skip
TWO = {
    "cracks.1.edge": "right", "cracks.1.height": 0.08, "cracks.1.length": 0.02,
    "contact.law": "penalty", "contact.stiffness_per_area": 1e13, "damping.ratio": 0.01,
}  # fmt: skip
LINEAR = {"mesh.order": 1, "mesh.size": 0.008, "mesh.lip_elements": 10}
WIDE = {
    "geometry.width": 0.16, "geometry.height": 0.2, "crack.edge": "right", "crack.height": 0.06,
    "crack.length": 0.05, "damping.ratio": 0.008, "excitation.point": [0.0, 0.2],
    "excitation.force_mean": [5.0, 0.0],
}  # fmt: skip
TRIANGLES = {"mesh.cells": "triangle", "mesh.size": 0.015, "mesh.lip_elements": 5}
SLENDER = {
    "geometry.width": 0.05, "geometry.height": 0.25, "crack.height": 0.04, "crack.length": 0.015,
    "damping.ratio": 0.003, "mesh.size": 0.0125, "excitation.point": [0.05, 0.25],
}  # fmt: skip
ON_LINES = {
    "mesh.layout": "grid", "mesh.size": None, "mesh.lip_elements": None, "mesh.columns": 10,
    "mesh.rows": 20, "crack.length": 0.04,
}  # fmt: skip
PRESSED = {"crack.clearance": -2e-7, "damping.ratio": 0.02, "crack.height": 0.2}
MORE: dict[str, tuple[dict[str, Any], int, float]] = {
    "crack inside, pulled": (PULL, 1, 0.95),
    "two cracks, penalty": (TWO, 1, 1.05),
    "linear elements, second mode": (LINEAR, 2, 0.98),
    "wide plate, mean load": (WIDE, 1, 0.92),
    "triangles, at a third": (TRIANGLES, 1, 0.34),
    "slender, second mode": (SLENDER, 2, 1.03),
    "grid": (ON_LINES, 1, 0.97),
    "preload, above its resonance": (PRESSED, 1, 1.2),
}
DISTANT = {
    "crack.clearance": 1.5e-7, "crack.length": 0.035, "crack.height": 0.1, "damping.ratio": 0.01,
}  # fmt: skip
SHUT = {
    "excitation.force_mean": [-4.0, 0.0], "crack.length": 0.05, "crack.height": 0.09,
    "damping.ratio": 0.01,
}  # fmt: skip
PRESSED_PAIR = TRIANGLES | {
    "cracks.1.edge": "right", "cracks.1.height": 0.2, "cracks.1.length": 0.025,
    "crack.clearance": -1e-7, "cracks.1.clearance": -1e-7, "damping.ratio": 0.015,
}  # fmt: skip
HELD_OUT: dict[str, tuple[dict[str, Any], int, float]] = {
    "a gap that closes": (DISTANT, 1, 1.04),
    "shut by a mean load, second mode": (SHUT, 2, 1.02),
    "two preloaded cracks, triangles": (PRESSED_PAIR, 1, 0.93),
}
"""Changes, a mode, and the load's frequency over its bilinear one."""
STEEL, TITANIUM, ALUMINIUM = (
    {"material.young": young, "material.poisson": poisson, "material.density": density}
    for young, poisson, density in (
        (2.1e11, 0.3, 7850.0),
        (1.14e11, 0.33, 4430.0),
        (7e10, 0.33, 2700.0),
    )
)
THROUGH = {
    "crack.center": None,
    "crack.edge": "left",
    "crack.height": 0.025,
    "crack.length": 0.0096,
}
FACE = {
    "crack.center": 0.015, "crack.height": 0.02, "crack.length": 0.016, "crack.depth": 0.005,
    "crack.front": "elliptical",
}  # fmt: skip
CORNER = {
    "crack.center": None, "crack.edge": "left", "crack.height": 0.025, "crack.length": 0.01,
    "crack.depth": 0.005, "crack.front": "elliptical",
}  # fmt: skip
IN_BAR = {"crack.center": None, "crack.edge": "left", "crack.height": 0.03, "crack.length": 0.008}
ALONG, ACROSS = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
NEW_SOLIDS: dict[str, tuple[Vector, dict[str, Any], int, Vector]] = {
    "aluminium plate, through": (
        (0.024, 0.09, 0.008), THROUGH | ALUMINIUM | {"damping.ratio": 0.01}, 2, ALONG,
    ),
    "steel plate, half an ellipse": (
        (0.03, 0.06, 0.01), FACE | STEEL | {"damping.ratio": 0.005}, 1, ACROSS,
    ),
    "titanium strip, quarter of an ellipse": (
        (0.02, 0.08, 0.008), CORNER | TITANIUM | {"damping.ratio": 0.01}, 1, ACROSS,
    ),
    "steel bar, through": ((0.02, 0.1, 0.02), IN_BAR | STEEL | {"damping.ratio": 0.008}, 1, ALONG),
}  # fmt: skip
"""Sides [m], crack, metal and damping, the mode in which the crack breathes, and the force [N]."""
SHARES, TWICE_AND_THRICE = (0.5, 0.9), (2.0, 3.0)
HEADLINES = ("amplitude", "opening", "ratio_2_1")
OF_HALF = (*HEADLINES, "crack_force")
ANSWERED = (
    "scene", "quantity", "value", "true", "stated", "true / stated", "most by", "within 2 %",
)  # fmt: skip
LOW, BAND = 0.2, np.linspace(0.98, 1.02, 9)
"""True over stated error below which frequencies nearby are looked at, and these."""
CHOSEN = {"plate": 10, "solid": 8, "rotor": 6}
"""Random scenes of each kind whose modes the tolerance chooses."""
MODES_ALONE = {"mesh.error": False, "contact.friction_error": False}
"""Keys that leave the errors by modes and harmonics."""
SIX_DIGITS = 5e-7
"""Relative error of a number that tables with six digits do not show."""
DECADE, MOST = 10, 1.6
"""Random scenes whose errors by modes are compared, and the largest ratio that is meant for all."""
MEANT = 1.3
"""Largest ratio of true to stated error that is meant for these."""
WHEELS, BASES = 10, ((1, 0), (1, 4), (1, 12), (2, 0), (3, 0))
"""Random wheels, and families and further modes that each is solved with."""
KNOWN_BY, AGAIN_BY, AGAIN = 6, 9, (0, 5)
"""Families of the reference of a wheel, of a second one, and the wheels that have it, too."""
RANDOM, RANDOM_SEED = 40, 4
"""Random plates, twice as many as solids, and where the random numbers begin."""
HALF, HALF_MEANT = 20, 1.6
"""Plates at half the resonance, and the largest ratio that is meant for them."""
METALS = ((2.1e11, 0.3, 7850.0), (1.14e11, 0.33, 4430.0), (7e10, 0.33, 2700.0))
"""Steel, titanium and aluminium: Young's modulus [Pa], Poisson's ratio, density [kg/m^3]."""
SIDES = ("width", "height", "thickness")


def main() -> None:
    """Run it."""
    answers = {"answers": run_answers, "plates": run_plates, "solids": run_solids}
    answers |= {"new_solids": run_new_solids, "chosen": run_chosen}
    answers |= {"wheels": run_wheels, "friction_modes": run_friction_modes}
    answers |= {"plate_modes": run_plate_modes, "half": run_half}
    parts = {"mesh": run_mesh, "boxes": run_boxes, "harmonics": run_harmonics, "modes": run_modes}
    seed_help = "of wheels, friction_modes, plate_modes, half"
    seed = {"type": int, "default": RANDOM_SEED, "help": seed_help}
    common.run(__doc__, answers | parts, seed=seed)


def pulled_plate() -> fc.Scene:
    """The plate of demos/sweep.toml pulled at its upper edge: four pairs, ten modes, lips with
    mass."""
    kept = {"reduction.method": "free_interface", "reduction.modes": 10}
    return load("sweep", PULLED | kept)


def load(demo: str, changes: Mapping[str, Any] | None = None) -> fc.Scene:
    """A demo's scene for one solution, some keys changed."""
    scene = fc.Scene.load(common.DEMOS / f"{demo}.toml")
    return scene.replace({"sweep": None, "curve": None, **(changes or {})})


def new(name: str) -> fc.Scene:
    """What ``fenics-crack new`` writes, the "scene" of a plate, a "solid" or a "disk", for one
    solution."""
    text = resources.files("fenics_crack.cli").joinpath(f"new_{name}.toml").read_text("utf-8")
    return fc.Scene.from_text(text).replace({"sweep": None, "curve": None})


# --- references -----------------------------------------------------------------------------------


def solved(scene: fc.Scene) -> Numbers:
    """Indicators and natural frequencies of a scene's solution, without its verdict."""
    study, table = fc.prepare(scene), scene.harmonic_balance
    if study.contact is None or table.tolerance is not None:
        run = fc.solve(scene)
    else:
        solution = fc.solve_harmonic_balance(
            study.structure, scene.excitation.omega, study.contact, harmonics=table.harmonics,
            samples=table.samples, throw=False,
        )  # fmt: skip
        run = fc.Run(**vars(study), result=solution)
    omega = fc.solve_modes(run.structure.whole, 3).omega
    found = run.result.indicators(run.watched_dof).to_dict()
    found |= {f"omega_open_{mode}": value for mode, value in enumerate(omega, 1)}
    hertz = {f"frequency_open_{mode}": w / (2.0 * np.pi) for mode, w in enumerate(omega, 1)}
    return found | hertz


def on_finer_mesh(scene: fc.Scene) -> Numbers:
    """The same with elements four times as short; three times of a solid."""
    finer = refine_scene_or_none(scene, 4.0 if scene.dimension == 2 else 3.0)
    assert finer is not None
    return solved(finer)


def exact(scene: fc.Scene) -> Numbers:
    """Indicators of the motion from event to event, once it repeats; none where it does not."""
    run = fc.solve(scene)
    motion = fc.integrate_events(
        run.structure, run.result.omega, run.contact, periods=400, settle=1e-8,
        record_periods=1, initial=run.result,
        steps_per_period=1024 * OFTEN,
    )  # fmt: skip
    if not motion.settled <= 1e-7:
        return {}
    return _seen(motion.displacement([run.watched_dof])[:, 0], motion.gap)


def of_orbit(scene: fc.Scene) -> Numbers:
    """The same of the exact orbit next to a scene's solution, whether the motion settles there or
    not; none without one."""
    run = fc.solve(scene)
    try:
        orbit = fc.shoot(run.structure, run.result)
    except fc.ConvergenceError:
        return {}
    samples = orbit.samples(run.result.instants())
    return _seen(
        run.structure.values_at(samples.displacement, [run.watched_dof])[:, 0], samples.gap
    )


def _seen(wave: np.ndarray, gap: np.ndarray) -> Numbers:
    """Indicators of a period in time: of a displacement (n,) and of the gaps (n, n_pairs) [m],
    straight in between for the share closed."""
    low, high = np.sort([gap, np.roll(gap, 1, axis=0)], axis=0)
    closed = np.clip(high / np.maximum(high - low, np.finfo(float).tiny), 0.0, 1.0)
    size = 2.0 * np.abs(np.fft.rfft(wave)) / len(wave)
    return {
        "amplitude": float(np.ptp(wave)) / 2.0,
        "ratio_2_1": size[2] / size[1],
        "ratio_3_1": size[3] / size[1],
        "mean_shift": float(wave.mean()) / size[1],
        "opening": -float(gap.min()),
        "closed_share": float(np.mean(closed)),
    }


def with_more_modes(found: fc.Verification) -> Numbers:
    """What the numbers become as the exact orbit changes with :data:`MANY_MODES` modes; none where
    there is none."""
    few, many = (
        of_orbit(scene)
        for scene in (found.scene, found.scene.replace({"reduction.modes": MANY_MODES}))
    )
    return {name: found.values[name] + many[name] - few[name] for name in few if name in many}


# --- parts ----------------------------------------------------------------------------------------


def answers() -> Iterator[tuple[str, fc.Scene]]:
    """Scenes by their names."""
    plate = fc.Scene.load(PLATE).replace({"curve": None, "sweep": None})
    for name, changes in SCENES.items():
        yield name, plate.replace(changes)
    yield "blade", load("blade")
    for name, (changes, mode, factor) in (MORE | HELD_OUT).items():
        scene = plate.replace(changes)
        natural = fc.bilinear_frequencies(fc.prepare(scene).structure).omega_bilinear
        omega = float(factor * natural[mode - 1])
        name += ", held out" if name in HELD_OUT else ""
        yield name, scene.replace({"excitation.omega": omega})


def run_answers(arguments: common.Arguments) -> None:
    """Against a mesh four times finer, twice the modes and 40 harmonics."""
    rows: list[common.Row] = []
    for name, scene in list(answers())[: 2 if arguments.quick else None]:
        rows += answered(name, scene, fc.solve(scene))
    common.save_table(arguments.folder / "stated_errors_answers.csv", "answers", ANSWERED, rows)
    tell(rows)


def tell(rows: list[common.Row]) -> None:
    """How far true errors are from stated ones, of each kind of number."""
    for kind in ("frequency", "omega", "amplitude", "opening", "ratio_2_1"):
        shares = [row[5] for row in rows if kind in row[1]]
        if shares:
            low, high = min(shares), max(shares)
            middle = np.median(shares)
            print(f"{kind}: true / stated {low:.2f} to {high:.2f}, median {middle:.2f}")


def answered(
    name: str,
    scene: fc.Scene,
    run: fc.Run[fc.PeriodicSolution],
    times: float = 4.0,
    *,
    by_mesh: bool = False,
) -> Iterator[common.Row]:
    """A row for each headline number, or its part by the mesh; with the ratio of the root mean
    squares within 2 % of the frequency where that at the frequency is below a fifth."""
    finer = refine_scene_or_none(scene, times)
    assert finer is not None and run.scene.reduction is not None
    exact = {"harmonic_balance.tolerance": None, "harmonic_balance.harmonics": 40}
    more = {"reduction.modes": (1 if by_mesh else 2) * int(run.scene.reduction.modes or 0)}
    reference = fc.prepare(finer.replace(exact | more))
    compare = by_mesh_alone if by_mesh else stated_and_true
    found = compare(run, reference)
    low = [quantity for quantity, (_, true, stated, _) in found.items() if true < LOW * stated]
    key, nearby = "frequency" if scene.is_frequency_in_hertz else "omega", []
    for factor in BAND if low else ():
        at = {f"excitation.{key}": float(factor) * getattr(scene.excitation, key)}
        nearby.append(compare(fc.solve(scene.replace(at)), reference))
    for quantity, (value, true, stated, cause) in found.items():
        both = np.array(
            [one[quantity][1:3] for one in nearby if quantity in one and quantity in low]
        )
        share = np.divide(*np.sqrt(np.mean(both**2, axis=0))) if len(both) else np.nan
        yield name, quantity, value, true, stated, true / stated, cause, float(share)


def stated_and_true(
    run: fc.Run[fc.PeriodicSolution], reference: Study
) -> dict[str, tuple[float, float, float, str]]:
    """Of each headline number its value, true and stated error, and what most of that is by; the
    reference leaves friction out, too."""
    if run.scene.contact is not None:
        run = replace(run, scene=run.scene.replace({"contact.friction_error": False}))
    found, own = run.errors, compute_numbers(run, run.result)
    assert found is not None
    other = solve_study(reference, omega=run.result.omega)
    true = compute_numbers(other, other.result, own.mode_number).values_by_name
    rows = {}
    for quantity, value in found.values.items():
        natural = quantity.startswith(("frequency", "omega"))
        if quantity.endswith(HEADLINES) or (natural and quantity.endswith(f"_{own.mode_number}")):
            stated, cause = found.stated(quantity)
            rows[quantity] = value, abs(true[quantity] / value - 1.0), stated, cause
    return rows


def by_mesh_alone(
    run: fc.Run[fc.PeriodicSolution], reference: Study
) -> dict[str, tuple[float, float, float, str]]:
    """The same by the mesh alone: both solutions have the harmonics and the modes of the answer."""
    errors, mode, solutions = run.errors, compute_numbers(run, run.result).mode_number, []
    for study, solution in ((run, run.result), (reference, None)):
        assert study.contact is not None
        for harmonics in (run.result.harmonics // 2, run.result.harmonics)[solution is not None :]:
            solution = fc.solve_harmonic_balance(
                study.structure, run.result.omega, study.contact, harmonics=harmonics,
                initial=solution,
            )  # fmt: skip
        assert solution is not None
        solutions.append(compute_numbers(study, solution, mode).values_by_name)
    assert errors is not None
    if "mesh" in errors.unknown:
        raise fc.ConvergenceError(errors.omitted_causes_and_reasons_text)
    values, reference_values = solutions
    rows = {}
    for quantity, value in values.items():
        is_natural = quantity.startswith(("frequency", "omega"))
        if quantity.endswith(OF_HALF) or (is_natural and quantity.endswith(f"_{mode}")):
            stated_error = errors.contributions(quantity)["mesh"] / abs(value)
            true_error = abs(reference_values[quantity] / value - 1.0)
            rows[quantity] = value, true_error, stated_error, "mesh"
    return rows


def random_plate(rng: np.random.Generator) -> tuple[dict[str, Any], int, float, float, float]:
    """Changes, a mode, the load's frequency over its bilinear one, the clearance over the opening
    without it, and the mean load over the amplitude."""
    changes = random_body(rng, (-1.5, -0.85), (1.2, 5.0), (0.02, 0.1), 31, (0.1, 0.85))
    width, height = changes["geometry.width"], changes["geometry.height"]
    if rng.random() < 0.25:
        changes |= {"crack.edge": None, "crack.center": width * rng.uniform(0.4, 0.6)}
        changes["crack.length"] = width * rng.uniform(0.15, 0.5)
    else:
        changes["crack.edge"] = str(rng.choice(["left", "right"]))
        changes["crack.length"] = width * rng.uniform(0.08, 0.6)
    if rng.random() < 0.3:
        changes["mesh.cells"] = "triangle"
    order = 1 if rng.random() < 0.15 else 2
    across = rng.uniform(4.0, 12.0) * (3 - order)
    changes |= {"mesh.order": order, "mesh.size": width / across}
    changes["mesh.lip_elements"] = int(rng.integers(3, 11))
    changes["mesh.grading"] = rng.uniform(2.0, 8.0)
    pulled, side = rng.random() < 0.2, 0.0
    if pulled:
        traction = [1000.0 * x for x in rng.normal(size=2).tolist()]
        changes |= {"excitation.point": None, "excitation.force_sin": [0.0, 0.0]}
        changes |= {"loads.1.edge": "top", "loads.1.traction_sin": traction}
    else:
        side = width * rng.choice([0.0, 1.0])
        rng.random()  # was a place; scenes of docs/notebook/stated_errors.md have it
        changes |= {"excitation.point": [side, height]}
        changes["excitation.force_sin"] = [10.0 * rng.normal(), 0.0]
    changes["output.points"] = {"far": [width - side, height]}
    state = random_state(rng, (0.3, 1.4), (0.6, 0.8))
    mean = rng.normal() if rng.random() < 0.25 and not pulled else 0.0
    return changes, *state, float(mean)


def random_solid(rng: np.random.Generator) -> tuple[dict[str, Any], int, float, float, float]:
    """The same of a box."""
    changes = random_body(rng, (-1.8, -1.2), (1.5, 4.0), (0.1, 0.4), 25, (0.15, 0.6))
    width, height, thickness = (changes[f"geometry.{side}"] for side in SIDES)
    changes["crack.length"] = width * rng.uniform(0.2, 0.6)
    changes["mesh.size"] = width / rng.uniform(3.0, 6.0)
    changes |= {"mesh.lip_elements": int(rng.integers(2, 5)), "mesh.error": True}
    kind, through = rng.random(), {"crack.depth": None, "crack.front": None}
    if kind < 0.4:
        changes["crack.center"] = width * rng.uniform(0.4, 0.6)
    else:
        changes |= {"crack.center": None, "crack.edge": "left"}
    if 0.4 <= kind < 0.7:
        changes["crack.front"] = str(rng.choice(["straight", "elliptical"]))
    changes |= through if kind >= 0.7 else {"crack.depth": thickness * rng.uniform(0.25, 0.7)}
    side = width * rng.choice([0.0, 1.0])
    force = rng.normal(size=3) * ([1.0, 0.0, 0.0] if rng.random() < 0.4 else [0.0, 0.0, 1.0])
    changes |= {"excitation.point": [side, height, thickness / 2.0]}
    changes |= {"excitation.force_sin": force.tolist()}
    changes["output.points"] = {"far": [width - side, height, thickness / 2.0]}
    return changes, *random_state(rng, (0.4, 1.3), (0.7, 0.85)), 0.0


def random_body(
    rng: np.random.Generator, widths: Span, heights: Span, thicknesses: Span, modes: int, at: Span
) -> dict[str, Any]:
    """Sides, metal, damping, fewer modes than so many, and where the crack is: widths by their
    decimal logarithm, heights and thicknesses over these, the crack over the height."""
    width = float(10.0 ** rng.uniform(*widths))
    height, thickness = width * rng.uniform(*heights), width * rng.uniform(*thicknesses)
    shape = zip(SIDES, (width, height, thickness), strict=True)
    metal = zip(("young", "poisson", "density"), METALS[rng.integers(3)], strict=True)
    return {
        **{f"geometry.{key}": value for key, value in shape},
        **{f"material.{key}": value for key, value in metal},
        "damping.ratio": 10.0 ** rng.uniform(-2.7, -1.5),
        "reduction.modes": int(rng.integers(10, modes)),
        "crack.height": height * rng.uniform(*at),
    }


def random_state(rng: np.random.Generator, factors: Span, gaps: Span) -> tuple[int, float, float]:
    """A mode, the load's frequency over its bilinear one, and the clearance over the opening: none
    up to the first share, and a preload from the second on."""
    mode = int(rng.integers(1, 4))
    factor = rng.uniform(0.9, 1.1) if rng.random() < 0.6 else rng.uniform(*factors)
    gap = rng.random()
    clearance = rng.uniform(0.05, 0.7) * (1.0 if gap < gaps[1] else -1.0) if gap >= gaps[0] else 0.0
    return mode, float(factor), float(clearance)


def random_scene(base: fc.Scene, rng: np.random.Generator) -> fc.Scene:
    """A scene with the changes of a random plate or solid."""
    draw = random_solid if base.dimension == 3 else random_plate
    changes, mode, factor, clearance, mean = draw(rng)
    scene = base.replace({"curve": None, "sweep": None, **changes})
    study = fc.prepare(scene)
    omega = factor * float(fc.bilinear_frequencies(study.structure).omega_bilinear[mode - 1])
    more: dict[str, Any] = {"excitation.omega": omega}
    if clearance:
        assert study.contact is not None
        found = fc.solve_harmonic_balance(study.structure, omega, study.contact, harmonics=5)
        more["crack.clearance"] = clearance * float(found.indicators().opening)
    if mean:
        more["excitation.force_mean"] = [mean * x for x in changes["excitation.force_sin"]]
    return scene.replace(more)


def run_plates(arguments: common.Arguments) -> None:
    """Random plates."""
    run_random(arguments, "plates", fc.Scene.load(PLATE), 4.0)


def run_solids(arguments: common.Arguments) -> None:
    """Random solids."""
    run_random(arguments, "solids", new("solid"), 2.0)


def plate_at_half(rng: np.random.Generator) -> fc.Scene:
    """The plate of ``fenics-crack new`` with long elements and another crack, at half the lowest
    resonance."""
    scene = new("scene").replace({
        "mesh.size": 0.02, "mesh.lip_elements": int(rng.choice([4, 6])), "reduction.modes": 20,
        "contact.friction_error": False, "crack.length": rng.uniform(0.015, 0.055),
        "crack.height": rng.uniform(0.05, 0.25), "damping.ratio": 10.0 ** rng.uniform(-2.7, -1.7),
    })  # fmt: skip
    natural_frequencies = fc.bilinear_frequencies(fc.prepare(scene).structure).frequency_bilinear
    return scene.replace({"excitation.frequency": 0.5 * float(natural_frequencies[0])})


def run_half(arguments: common.Arguments) -> None:
    """Against a mesh three times finer."""
    rows: list[common.Row] = []
    for number in range(2 if arguments.quick else HALF):
        scene = plate_at_half(np.random.default_rng([arguments.seed, number]))
        name = f"half {number}"
        try:
            rows += answered(name, scene, fc.solve(scene), 3.0, by_mesh=True)
        except fc.ConvergenceError as error:
            print(f"{name}: {error}")
        common.save_table(arguments.folder / "stated_errors_half.csv", "half", ANSWERED, rows)
    for kind in (*OF_HALF, "frequency"):
        shares = np.array([row[5] for row in rows if kind in row[1]])
        overstated_rows = [
            row for row in rows if kind in row[1] and max(row[5], np.nan_to_num(row[7])) < LOW
        ]
        print(
            f"{kind}: above {HALF_MEANT}: {np.sum(shares > HALF_MEANT)} of {len(shares)}; median "
            f"{np.median(shares):.2f}, largest {shares.max():.2f}; below {LOW}, within 2 %, too: "
            f"{len(overstated_rows)}"
        )


def chosen() -> Iterator[tuple[str, fc.Scene]]:
    """Random scenes without a number of modes, and without what has other causes of errors."""
    left_out = {"reduction": None, "mesh.error": False, "contact.friction_error": False}
    plate, solid = fc.Scene.load(PLATE), new("solid")
    for kind, count in CHOSEN.items():
        for number in range(count):
            rng, name = np.random.default_rng([RANDOM_SEED, 83, number]), f"{kind} {number}"
            scene = random_scene(solid if kind == "solid" else plate, rng).replace(left_out)
            if kind == "rotor":
                omega = float(fc.solve_modes(fc.prepare(scene, whole=True).structure, 1).omega[0])
                spin = {"rotation.speed": omega * rng.uniform(0.05, 0.4)}
                spin["rotation.hub_radius"] = scene.geometry.given("height") * rng.uniform(0.0, 3.0)
                scene = scene.replace(spin | {"crack.clearance": 0.0})
                opened = fc.solve(scene).result.indicators().opening  # mostly by rotation
                scene = scene.replace({"crack.clearance": -opened * rng.uniform(0.8, 1.1)})
            yield name, scene


def run_chosen(arguments: common.Arguments) -> None:
    """Against four times the modes."""
    rows: list[common.Row] = []
    for number, (name, scene) in enumerate(chosen()):
        if arguments.quick and number % 8:
            continue
        try:
            run = fc.solve(scene)
            structure, law = run.structure, run.contact
            assert run.errors is not None and law is not None
            if run.result.stability is None or run.result.stability.verdict != "stable":
                print(f"{name}: not known to be stable, others may be found")
                continue
            many = {"reduction.modes": 4 * structure.n_modes}
            more = fc.prepare(scene.replace(many), judged=False).structure
            tight = 0.1 * scene.harmonic_balance.given("tolerance")
            exact = fc.solve_harmonic_balance(
                more, run.result.omega, law, tolerance=tight, initial=run.result, throw=False
            )
        except (fc.InputError, fc.ConvergenceError) as error:
            print(f"{name}: {error}")
            continue
        true, status = (exact.orbit or exact).indicators(run.watched_dof), run.result.status
        met = run.result.report.total <= scene.harmonic_balance.given("tolerance")
        for quantity in ("amplitude", "opening"):
            key = run.watched[0].column_name(quantity) if quantity == "amplitude" else quantity
            if key not in run.errors.values:  # a crack that never opens
                continue
            value, (stated, cause) = run.errors.values[key], run.errors.stated(key)
            off = abs(getattr(true, quantity) / value - 1.0)
            if off > MAX_RELATIVE_ROUNDING_SPREAD:
                said = f"{structure.n_modes} modes, {'met' if met else status.split(';')[0]}"
                rows.append((name, quantity, value, off, stated, off / stated, cause, said))
    columns = (*ANSWERED[:-1], "tolerance")
    common.save_table(arguments.folder / "stated_errors_chosen.csv", "chosen", columns, rows)
    tell(rows)
    above = [row[3] for row in rows if row[5] > MEANT]
    worst = f", the truth is up to {max(above):.1g} off" if above else ""
    print(f"above {MEANT}: {len(above)} of {len(rows)}{worst}")


def random_wheel(rng: np.random.Generator) -> fc.Scene:
    """A disk with one to three cracked blades, near one of its resonances or not."""
    count, scene = int(rng.integers(6, 15)), new("disk")
    cracked = rng.choice(count, int(rng.integers(1, 4)), replace=False) + 1
    scene = scene.replace({
        "mesh.error": False, "contact.friction_error": False, "harmonic_balance.tolerance": 0.005,
        "disk.sectors": count, "disk.cracked": sorted(cracked.tolist()),
        "disk.deviation": 0.01 * float(rng.random() < 2.0 / 3.0),
        "disk.seed": int(rng.integers(1, 99)),
        "excitation.order": int(rng.integers(1, count)),
        "damping.ratio": 10.0 ** rng.uniform(-2.7, -2.0),
        "crack.length": rng.uniform(0.002, 0.006), "crack.height": rng.uniform(0.006, 0.03),
        "mesh.lip_elements": 4, "mesh.size": 0.006,
    })  # fmt: skip
    if rng.random() < 0.4:
        stiffness = 10.0 ** rng.uniform(12.0, 14.0)
        scene = scene.replace({"contact.law": "penalty", "contact.stiffness_per_area": stiffness})
    widths = 4.0 * scene.damping.given("ratio")
    off = (rng.random() - 0.5) * (widths if rng.random() < 0.6 else 0.3)
    natural = fc.bilinear_frequencies(fc.prepare(scene).structure).omega_bilinear
    omega = (1.0 + off) * natural[rng.integers(len(natural))]
    return scene.replace({"excitation.frequency": float(omega) / (2.0 * np.pi)})


def run_wheels(arguments: common.Arguments) -> None:
    """Against six families and more."""
    rows: list[common.Row] = []
    for number in range(2 if arguments.quick else WHEELS):
        scene = random_wheel(np.random.default_rng([arguments.seed, 85, number]))
        whole, disk = fc.prepare(scene, whole=True).structure, scene.given("disk")
        assert isinstance(whole, fc.Wheel)
        known_by = (KNOWN_BY, AGAIN_BY) if number in AGAIN else (KNOWN_BY,)
        name = f"wheel {number}, {disk.sectors} blades, {len(disk.cracked)} cracked"
        references = [
            fc.reduce_wheel(whole, families, more=4 * disk.sectors, reference=False)
            for families in known_by
        ]
        for families, modes in BASES:
            run = fc.solve(scene.replace({"disk.families": families, "disk.modes": modes}))
            for kept, reference in zip(known_by, references, strict=True):
                said = f"{families} + {modes} modes, by {kept}"
                rows += [(name, *row, said) for row in by_modes(run, reference)]
        columns = (*ANSWERED[:-2], "modes")
        common.save_table(arguments.folder / "stated_errors_wheels.csv", "wheels", columns, rows)
    tell_modes([row for row in rows if row[-1].endswith(f" {KNOWN_BY}")])


def tell_modes(rows: list[common.Row]) -> None:
    """How far true errors due to modes are from stated ones, of each number and of all."""
    of_kinds: dict[str, list[common.Row]] = {"all": rows}
    for row in rows:
        of_kinds.setdefault(row[1].rpartition(".")[2].rstrip("_123456789"), []).append(row)
    for kind, kind_rows in of_kinds.items():
        shares = np.array([row[5] for row in kind_rows])
        print(
            f"{kind}: true / stated above {MOST}: {np.sum(shares > MOST)} of {len(shares)}, below "
            f"{LOW}: {np.sum(shares < LOW)}; median {np.median(shares):.2f}, largest "
            f"{shares.max():.2f}"
        )


def by_modes(
    run: fc.Run[fc.PeriodicSolution], reference: fc.Structure
) -> Iterator[tuple[str, float, float, float, float]]:
    """Quantities, their values, true and stated errors due to modes, and the ratios: of every
    number, and of the motions of the gaps and at the load, whose values are 1."""
    law, errors = run.contact, run.errors
    assert law is not None and errors is not None
    few, many = (
        fc.solve_harmonic_balance(
            one, run.result.omega, law, harmonics=20, initial=run.result, throw=False
        )
        for one in (run.structure, reference)
    )
    assert few.converged and many.converged
    more = replace(run, structure=reference)
    mode = compute_numbers(run, run.result).mode_number
    number_pairs = (
        compute_numbers(run, few, mode).values_by_name,
        compute_numbers(more, many, mode).values_by_name,
    )
    yield from compare_with_true(errors, *number_pairs)
    true_of, stated_of = report_by_more_modes(few, many), run.result.report
    share = (
        run.structure.error_share_removed_by_reference
        if isinstance(run.structure, ReducedStructure)
        else 1.0
    )
    for quantity, part in (("gap", "reduction"), ("at the load", "displacement")):
        true, stated = share * getattr(true_of, part), getattr(stated_of, part)
        yield quantity, 1.0, true, stated, true / stated


def compare_with_true(
    errors: fc.Verification, few_modes: Numbers, many_modes: Numbers
) -> Iterator[tuple[str, float, float, float, float]]:
    """Each number with an error due to modes: its value, the true error by numbers with few and
    many modes, the stated one, both over the value, and their ratio; infinite where none is stated
    of a number that modes change."""
    for quantity, value in errors.values.items():
        part = errors.parts["modes"].get(quantity)
        stated_error = 0.0 if part is None else part.uncertainty(-1)
        true_error = abs(many_modes.get(quantity, np.nan) - few_modes.get(quantity, np.nan))
        if max(stated_error, true_error) > SIX_DIGITS * abs(value):
            ratio = true_error / stated_error if stated_error else np.inf
            yield quantity, value, true_error / abs(value), stated_error / abs(value), ratio


def random_friction(rng: np.random.Generator, number: int) -> fc.Scene:
    """A scene with friction: every third one of a demo with an inclined crack, of another with
    penalty contact, and of the plate of the benchmarks, near one of two resonances or not."""
    base = ("friction", "inclined_crack", "")[number % 3]
    scene = load(base) if base else fc.Scene.load(PLATE).replace({"curve": None, "sweep": None})
    angle, force = rng.uniform(0.0, 2.0 * np.pi), 100.0 if base else 10.0
    changes = {
        "contact.friction": rng.uniform(0.1, 0.8), "damping.ratio": 10.0 ** rng.uniform(-2.7, -1.7),
        "damping.modes": "all", "reduction.modes": int(rng.integers(10, 21)),
    }  # fmt: skip
    if not base:
        changes |= {
            "crack.length": rng.uniform(0.02, 0.05),
            "crack.height": rng.uniform(0.05, 0.25),
        }
    if not base or rng.random() < 0.5:
        changes["excitation.force_sin"] = [force * np.cos(angle), force * np.sin(angle)]
    scene = scene.replace(MODES_ALONE | {"harmonic_balance.tolerance": 0.05} | changes)
    is_near_resonance, mode = rng.random() < 0.6, int(rng.integers(2))
    detuning = 3.0 * scene.damping.given("ratio") * rng.uniform(-1.0, 1.0)
    factor = 1.0 + detuning if is_near_resonance else rng.uniform(0.4, 1.3)
    natural_frequencies = fc.bilinear_frequencies(fc.prepare(scene).structure).omega_bilinear
    return scene.replace({"excitation.omega": float(factor * natural_frequencies[mode])})


def random_modes(rng: np.random.Generator, number: int) -> fc.Scene:
    """A random plate with few modes or many."""
    scene = random_scene(fc.Scene.load(PLATE), rng)
    return scene.replace(MODES_ALONE | {"reduction.modes": int(rng.integers(5, 21))})


def run_friction_modes(arguments: common.Arguments) -> None:
    """Scenes with friction."""
    run_modes_alone(arguments, "friction_modes", random_friction, 86)


def run_plate_modes(arguments: common.Arguments) -> None:
    """Random plates."""
    run_modes_alone(arguments, "plate_modes", random_modes, 87)


def run_modes_alone(
    arguments: common.Arguments,
    part: str,
    draw: Callable[[np.random.Generator, int], fc.Scene],
    stream: int,
) -> None:
    """Random scenes against the exact orbits with four times the modes, until there are ten; those
    without an error or a stable orbit are told."""
    rows: list[common.Row] = []
    n_missing, number = 2 if arguments.quick else DECADE, 0
    while n_missing:
        name = f"{part} {number}"
        try:
            run = fc.solve(draw(np.random.default_rng([arguments.seed, stream, number]), number))
            error_rows = with_four_times(run)
            if isinstance(error_rows, str):
                print(f"{name}: {error_rows}")
            else:
                rows += [(name, *row, f"{run.structure.n_modes} modes") for row in error_rows]
                n_missing -= 1
        except (fc.InputError, fc.ConvergenceError) as error:
            print(f"{name}: {error}")
        number += 1
    columns = (*ANSWERED[:-2], "modes")
    common.save_table(arguments.folder / f"stated_errors_{part}.csv", part, columns, rows)
    tell_modes(rows)


def with_four_times(
    run: fc.Run[fc.PeriodicSolution],
) -> list[tuple[str, float, float, float, float]] | str:
    """Return rows of :func:`compare_with_true` by exact orbits, or why there are none.

    The orbits have the answer's modes and four times as many.
    """
    solution, errors, structure = run.result, run.errors, run.structure
    if not solution.converged or errors is None or solution.stability is None:
        return f"no error is stated, {solution.status}"
    if solution.stability.verdict != "stable":
        return f"{solution.stability.verdict}, others may be found"
    if "modes" not in errors.parts:
        return f"no part by modes, {'; '.join(errors.unknown.values()) or solution.status}"
    assert isinstance(structure, ReducedStructure) and run.contact is not None
    orbit, mode = solution.assessment.nearest_orbit, compute_numbers(run, solution).mode_number
    assert orbit is not None
    orbits = [orbit]
    for times in (2, 4):
        larger_structure = fc.reduce_structure(
            structure.whole, modes=times * structure.n_modes, method="massless", reference=False
        )
        flow = exact_flow_or_none(larger_structure, run.contact)
        assert flow is not None
        larger_orbit = MoreModesComparison(flow, solution.assessment.wave, orbits[-1]).orbit
        orbits += [] if larger_orbit is None else [larger_orbit]
    if orbits[-1].structure.n_modes < 4 * structure.n_modes:
        return "no orbit with four times the modes"
    few_numbers, many_numbers = (
        compute_orbit_values_by_name(
            replace(run, structure=exact_orbit.structure), solution, exact_orbit, mode
        )
        for exact_orbit in (orbit, orbits[-1])
    )
    return list(compare_with_true(errors, few_numbers, many_numbers))


def new_solids() -> Iterator[tuple[str, fc.Scene]]:
    """Each at both frequencies, on a mesh of three elements along the crack, the others as long
    beside the thickness as those of ``new --solid``."""
    base = new("solid").replace({"mesh.lip_elements": 3})
    longest = base.mesh.given("size") / base.geometry.given("thickness")
    for name, (sides, changes, mode, force) in NEW_SOLIDS.items():
        shape = {f"geometry.{side}": value for side, value in zip(SIDES, sides, strict=True)}
        load = {"point": [0.0, sides[1], sides[2] / 2.0], "force_sin": force}
        own = {"mesh.size": longest * sides[2]} | {f"excitation.{k}": v for k, v in load.items()}
        box = base.replace(shape | own | {"crack.front": None, "crack.depth": None} | changes)
        natural = fc.bilinear_frequencies(fc.prepare(box).structure).omega_bilinear[mode - 1]
        for share in SHARES:
            yield f"{name}, {share:g}", box.replace({"excitation.omega": float(share * natural)})


def run_new_solids(arguments: common.Arguments) -> None:
    """Against two finer meshes, :data:`MANY_MODES` modes and 20 harmonics."""
    rows: list[common.Row] = []
    columns = (*ANSWERED[:-1], "moved / true")
    references: list[Study] = []
    for number, (name, scene) in enumerate(new_solids()):
        if arguments.quick and number >= len(SHARES):
            break
        if number % len(SHARES) == 0:  # frequencies of one solid share its references
            references = [finer_study(scene, factor) for factor in TWICE_AND_THRICE]
        run = fc.solve(scene)
        assert run.errors is not None
        less, more = (without_verdict(one, run.result.omega) for one in references)
        for quantity in ("amplitude", "opening"):
            value, (stated, cause) = run.errors.values[quantity], run.errors.stated(quantity)
            true = abs(more[quantity] / value - 1.0)
            moved = abs(more[quantity] - less[quantity]) / (true * value)
            rows.append((name, quantity, value, true, stated, true / stated, cause, moved))
        path = arguments.folder / "stated_errors_new_solids.csv"
        common.save_table(path, "solids", columns, rows)
    tell(rows)


def finer_study(scene: fc.Scene, factor: float) -> Study:
    """A scene on a finer mesh, with many modes."""
    finer = refine_scene_or_none(scene, factor)
    assert finer is not None
    return fc.prepare(finer.replace({"reduction.modes": MANY_MODES}), judged=False)


def without_verdict(study: Study, omega: float) -> Numbers:
    """Numbers of a study's solution at a frequency, with 20 harmonics."""
    assert study.contact is not None
    found = fc.solve_harmonic_balance(study.structure, omega, study.contact, harmonics=20)
    seen = found.indicators(study.watched[0].dof)
    return {name: float(getattr(seen, name)) for name in ("amplitude", "opening")}


def run_random(arguments: common.Arguments, part: str, base: fc.Scene, finer: float) -> None:
    """Random scenes against finer meshes, twice the modes and 40 harmonics; those without a
    solution are told."""
    rows: list[common.Row] = []
    count = RANDOM // 2 if base.dimension == 3 else RANDOM
    for number in range(2 if arguments.quick else count):
        seeds = [RANDOM_SEED, number, 7 if base.dimension == 3 else 0]
        try:
            scene = random_scene(base, np.random.default_rng(seeds))
            run = fc.solve(scene)
            if run.result.stability is None or run.result.stability.verdict != "stable":
                print(f"{part} {number}: not known to be stable, others may be found")
            else:
                rows += answered(f"{part} {number}", scene, run, finer)
        except (fc.InputError, fc.ConvergenceError) as error:
            print(f"{part} {number}: {error}")
    common.save_table(arguments.folder / f"stated_errors_{part}.csv", part, ANSWERED, rows)
    tell(rows)


def run_mesh(arguments: common.Arguments) -> None:
    """Against meshes four times finer."""
    bare = {"crack": None, "contact": None}
    inside = {"crack.edge": None, "crack.center": 0.05, "crack.length": 0.04}
    scenes = {
        "sweep": load("sweep"),
        "sweep, quadratic": load("sweep", {"mesh.order": 2}),
        "sweep, fine": load("sweep", {"mesh.size": 0.005, "mesh.lip_elements": 8}),
        "sweep, triangles": load("sweep", {"mesh.cells": "triangle"}),
        "sweep, grid": load("sweep", GRID),
        "sweep, pulled": load("sweep", PULLED),
        "sweep, crack inside": load("sweep", inside),
        "no crack": load("sweep", bare),
        "no crack, quadratic": load("sweep", bare | {"mesh.order": 2}),
        "fenics-crack new": new("scene"),
        "blade": load("blade"),
    }
    verified(arguments, "mesh", scenes)


def run_boxes(arguments: common.Arguments) -> None:
    """The box of ``new --solid``, and others, against meshes three times finer."""
    box = new("solid")
    changes: dict[str, dict[str, Any]] = {
        "as it is": {},
        "straight front": {"crack.front": "straight"},
        "through": {"crack.depth": None, "crack.front": None},
        "deep, four elements": {"crack.depth": 0.0045, "mesh.lip_elements": 4},
        "no crack": {"crack": None, "contact": None, "mesh.lip_elements": None},
    }
    verified(arguments, "boxes", {name: box.replace(change) for name, change in changes.items()})


def verified(arguments: common.Arguments, part: str, scenes: Mapping[str, fc.Scene]) -> None:
    """The mesh's part of scenes against finer meshes."""
    rows: list[common.Row] = []
    for name, scene in list(scenes.items())[: 2 if arguments.quick else None]:
        found = fc.verify(scene)
        rows += compared(name, found, "mesh", on_finer_mesh(found.scene))
    report(arguments, part, rows)


def run_harmonics(arguments: common.Arguments) -> None:
    """Against the exact motion."""
    rows: list[common.Row] = []
    for changes in (VARIANTS + drawn())[: 2 if arguments.quick else None]:
        found = fc.verify(pulled_plate().replace(changes))
        reference = exact(found.scene)
        name = ", ".join(f"{key.partition('.')[2]} {value:.4g}" for key, value in changes.items())
        if not reference:
            print(f"{name}: the motion does not repeat")
        rows += compared(name or "as it is", found, "harmonics", reference)
    report(arguments, "harmonics", rows)


def drawn() -> list[dict[str, Any]]:
    """Variants drawn at random."""
    rng = np.random.default_rng(SEED)
    return [
        {
            "excitation.omega": float(rng.uniform(700.0, 5000.0)),
            "crack.length": float(rng.choice([0.03, 0.04, 0.05, 0.06])),
            "contact.stiffness_per_area": float(10.0 ** rng.uniform(9.0, 11.5)),
            "damping.ratio": float(10.0 ** rng.uniform(-2.0, -1.2)),
            "harmonic_balance.harmonics": int(rng.integers(3, 20)),
            "crack.clearance": float(rng.choice([0.0, 0.0, 1e-7, -1e-7])),
        }
        for _ in range(DRAWN)
    ]


def run_modes(arguments: common.Arguments) -> None:
    """Against many modes."""
    rows: list[common.Row] = []
    for count in (5, 10, 20)[: 1 if arguments.quick else None]:
        found = fc.verify(pulled_plate().replace({"reduction.modes": count}))
        rows += compared(f"{count} modes", found, "modes", with_more_modes(found))
    report(arguments, "modes", rows)


def compared(
    name: str, found: fc.Verification, cause: str, reference: Numbers
) -> Iterator[common.Row]:
    """A row for each quantity that a cause changes and the reference has."""
    for quantity, part in found.parts[cause].items():
        value, parts = found.values[quantity], found.contributions(quantity)
        stated = sum(parts[one] for one in (MESH_ERROR_CAUSES if cause == "mesh" else (cause,)))
        if quantity in reference and stated > 1e-9 * abs(value):  # more than rounding
            true = abs(reference[quantity] - value)
            shares = (true / abs(value), stated / abs(value), true / stated)
            yield (name, quantity, value, *shares, part.order, part.behaviour)


def report(arguments: common.Arguments, part: str, rows: list[common.Row]) -> None:
    """The table, and what it comes to."""
    common.save_table(arguments.folder / f"stated_errors_{part}.csv", part, COLUMNS, rows)
    shares = np.array([row[5] for row in rows])
    asymptotic = np.array([row[5] for row in rows if row[7] == "asymptotic"])
    least, middle, most = np.quantile(shares, (0.05, 0.5, 0.95))
    print(
        f"{part}: {np.sum(shares > 1.0)} of {len(shares)} above 1; 5, 50, 95 %: {least:.2f}, "
        f"{middle:.2f}, {most:.2f}; largest {shares.max():.2f}; median of the {len(asymptotic)} "
        f"asymptotic ones {np.median(asymptotic) if len(asymptotic) else np.nan:.2f}"
    )


if __name__ == "__main__":
    main()
