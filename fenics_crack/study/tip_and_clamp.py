"""Quantities of a scene's ``[output] quantities`` beside points, crack faces and frequencies: those
of crack tips and of the clamp, which cost something and are computed on request.

Stress intensities are found by rows that motions are multiplied by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.tables import OF_CLAMP, OF_GROWTH, OF_TIPS, TURN
from fenics_crack.curves.curve import PARTS, ResponseCurve
from fenics_crack.fem.interaction_integral import Tip, tip_functionals
from fenics_crack.model.factor import AT_A_TIME
from fenics_crack.model.nodes import Clamp
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.numerics.fourier import evaluate
from fenics_crack.scene.scene import Scene, asked_quantities, check_known, without_tips
from fenics_crack.scene.tables import Growth
from fenics_crack.study.prepare import Study
from fenics_crack.time.march import TimeHistory


def prepare_quantities(study: Study) -> None:
    """Make what the quantities of a study are found with, once for its structure (collective)."""
    names = asked_quantities(study.scene)
    if _AT_TIPS & set(names):
        tip_rows(study)
    if OF_CLAMP.keys() & names:
        study.structure.once(_inertia_rows)


def quantities_of_motion(study: Study, motion: PeriodicSolution | TimeHistory) -> dict[str, float]:
    """The quantities of a solution or a time integration that its scene requests (collective)."""
    names = asked_quantities(study.scene)
    found: dict[str, float] = {}
    if _AT_TIPS & set(names):
        seen = tip_rows(study).of_motion(motion)[1]
        found |= _of_leading(seen, study.scene.growth, periods_of(motion))
    if OF_CLAMP.keys() & names:
        found |= numbers_at_clamp(*clamp_of_motion(motion)[1:])
    return {name: found[name] for name in names}


def quantities_along_curve(study: Study, curve: ResponseCurve) -> dict[str, np.ndarray]:
    """The quantities that its scene requests at every point of a curve, each (n,) (collective)."""
    names = asked_quantities(study.scene)
    found: list[dict[str, float]] = [{} for _ in range(len(curve))]
    if _AT_TIPS & set(names):
        tips, law = tip_rows(study), study.scene.growth
        for index, (_, at) in enumerate(curve.seen_through(tips.of_coordinates)):
            seen, _, force = at(PARTS)
            found[index] |= _of_leading(tips.in_time(seen, force), law, curve.subharmonic)
    if OF_CLAMP.keys() & names:
        rows = curve.structure.once(_inertia_rows)
        for index, (waves, *_) in enumerate(curve.seen_through(rows)):
            whole = curve.problem_of(index).structure.whole
            omega = float(curve.omega[index]) / curve.subharmonic
            clamp, drag = _clamp(whole)
            held = clamp.of_waves(waves, omega, curve.subharmonic, drag, TURN * PARTS)
            found[index] |= numbers_at_clamp(*held)
    return {name: np.array([one[name] for one in found]) for name in names}


# --- the clamp ------------------------------------------------------------------------------------


def clamp_of_motion(
    motion: PeriodicSolution | TimeHistory,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Instants (n,) [s], and forces (n, d) [N] and moments (n, n_rigid - d) [N m] of the clamp then
    (collective)."""
    structure = motion.structure
    rows, whole = structure.once(_inertia_rows), structure.whole
    clamp, drag = _clamp(whole)
    if isinstance(motion, TimeHistory):
        omega = TURN * (len(motion.time) - 1) / motion.steps_per_period / float(np.ptp(motion.time))
        return motion.time, *clamp.of_record(motion.time, motion.seen_through(rows), omega, drag)
    waves = structure.sum_over_ranks(motion.displacement_coefficients @ rows.T)
    time, omega = motion.instants(), motion.base_omega
    return time, *clamp.of_waves(waves, omega, motion.subharmonic, drag, omega * time)


def numbers_at_clamp(force: np.ndarray, moment: np.ndarray) -> dict[str, float]:
    """The quantities of the clamp from its forces and its moments over time, a row each instant."""
    sizes = (np.linalg.norm(part, axis=1).max() for part in (force, moment))
    return dict(zip(OF_CLAMP, map(float, sizes), strict=True))


def _clamp(whole: Structure) -> tuple[Clamp, float]:
    """The clamp of a structure, and a [1/s] of Rayleigh's damping."""
    assert whole.clamp is not None  # the scene has been checked
    return whole.clamp, whole.damping.mass if isinstance(whole.damping, RayleighDamping) else 0.0


def _inertia_rows(structure: Structure) -> np.ndarray:
    """r^T M in the coordinates of a structure: (n_rigid, n_local). What has no mass has no inertia:
    truncated modes respond quasi-statically (collective)."""
    whole, inertia = structure.whole, _clamp(structure.whole)[0].inertia
    if structure is whole:
        return inertia
    known = structure.known_modes(tied=False)  # with mass, where not all coordinates have it
    shapes = np.eye(structure.n_dofs) if known is None else known[1]
    rows = whole.sum_over_ranks(structure.expand(shapes.T) @ inertia.T).T @ shapes.T
    mass = structure.mass.getValues(range(structure.n_dofs), range(structure.n_dofs))
    return np.asarray(rows @ mass)


# --- the tips -------------------------------------------------------------------------------------

_AT_TIPS = {*OF_TIPS, *OF_GROWTH}


@dataclass(frozen=True)
class TipRows:
    """Rows that multiply the coordinates of a structure and its contact forces to give K_I and K_II
    of one crack tip after the other.

    Of a reduced structure the rows are those of all that its coordinates expand to, static
    responses to load and contact among them: K converges as the load's and the pairs' statics do
    and not as a sum over modes.

    Attributes
    ----------
    tips : tuple of Tip
    of_coordinates : (2 n_tips, n_local) [Pa m^1/2 / m]
    of_forces : (2 n_tips, n_pairs) [Pa m^1/2 / N]
    """

    tips: tuple[Tip, ...]
    of_coordinates: np.ndarray
    of_forces: np.ndarray

    def in_time(self, seen: np.ndarray, force: np.ndarray) -> np.ndarray:
        """K_I and K_II (n, n_tips, 2) [Pa m^1/2] from the products of ``of_coordinates`` with a
        motion (n, 2 n_tips), and its contact forces (n, n_pairs)."""
        return np.asarray(seen + force @ self.of_forces.T).reshape(len(seen), -1, 2)

    def of_motion(self, motion: PeriodicSolution | TimeHistory) -> tuple[np.ndarray, np.ndarray]:
        """Instants (n,) [s], and K_I and K_II then (n, n_tips, 2) (collective)."""
        structure, rows = motion.structure, self.of_coordinates
        if isinstance(motion, TimeHistory):
            return motion.time, self.in_time(motion.seen_through(rows), motion.contact_force)
        time = motion.instants()
        if motion.residual is None:
            waves = structure.sum_over_ranks(motion.displacement_coefficients @ rows.T)
            seen = evaluate(waves, motion.base_omega, time)
        else:
            seen = structure.sum_over_ranks(motion.coordinates(time) @ rows.T)
        return time, self.in_time(seen, motion.contact_force(time))


def tip_rows(study: Study) -> TipRows:
    """The rows of a study's structure; made once for it and all that share its matrices
    (collective).

    Raises
    ------
    InputError
        The scene is no plate, or has no crack with tips.
    """
    scene = study.scene
    check_known(without_tips(scene), "output.quantities")
    pairs = None if scene.contact is None else scene.contact.pairs
    plate = scene.geometry, scene.crack, scene.cracks, scene.material, scene.mesh, pairs
    return study.structure.once(_OfScene(plate, scene))


@dataclass(frozen=True)
class _OfScene:
    """The rows of a structure of a scene; equal for scenes of the same plate."""

    plate: tuple[object, ...]
    scene: Scene = field(compare=False)

    def __call__(self, structure: Structure) -> TipRows:
        if structure is not structure.whole:
            rows, units = structure.whole.once(self), np.eye(structure.n_dofs)
            blocks = [units[n : n + AT_A_TIME] for n in range(0, len(units), AT_A_TIME)]
            columns = rows.of_coordinates.T
            products = np.vstack([structure.expand(block) @ columns for block in blocks])
            return replace(rows, of_coordinates=structure.whole.sum_over_ranks(products).T)
        tips, of_coordinates, of_forces = tip_functionals(self.scene, structure)
        if not tips:
            raise InputError("crack", "a crack without a tip", "one that ends in the plate")
        return TipRows(tuple(tips), of_coordinates, of_forces)


def periods_of(motion: PeriodicSolution | TimeHistory) -> float:
    """Periods of the load that a motion lasts, or in which it repeats itself."""
    if isinstance(motion, TimeHistory):
        return (len(motion.time) - 1) / motion.steps_per_period
    return motion.subharmonic


def numbers_at_tips(
    found: np.ndarray, law: Growth | None, periods: float
) -> Mapping[str, np.ndarray]:
    """The quantities of each tip by their names, each (n_tips,), from K_I and K_II in time
    (n, n_tips, 2) over so many periods of the load; the equivalent range where there is a law of
    growth."""
    one, two = found[..., 0], found[..., 1]
    largest, smallest = one.max(axis=0), one.min(axis=0)
    numbers = {
        "K_max": largest,
        "K_min": smallest,
        "delta_K": largest - smallest,
        "delta_K_effective": np.maximum(largest, 0.0) - np.maximum(smallest, 0.0),
        "K_II_max": np.abs(two).max(axis=0),
    }
    if law is not None:
        ranges = [_equivalent_range(tip, law, periods) for tip in one.T]
        numbers["delta_K_equivalent"] = np.array(ranges)
    return numbers


def _equivalent_range(one: np.ndarray, law: Growth, periods: float) -> float:
    """The range from K_I = 0 that, once a period, makes a crack grow as much as K_I (n,) does,

        (sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m / periods)^(1 / m),

    over the cycles i that are counted, delta K_i being the range while the tip is open; those below
    the threshold are left out where another is above it."""
    high, low = counted_cycles(np.maximum(one, 0.0)).T
    ranges = high - low
    if not ranges.size:
        return 0.0
    ratio = np.minimum(low / high, 1.0 - 1e-9)
    drive = ranges / (1.0 - ratio) ** (1.0 - law.ratio_exponent)
    grows = ranges >= min(law.threshold, ranges.max())
    parts = np.where(grows, drive / drive.max(), 0.0) ** law.exponent
    return float(drive.max() * (parts.sum() / periods) ** (1.0 / law.exponent))


def counted_cycles(values: np.ndarray) -> np.ndarray:
    """Highest and lowest values of the cycles in a record (n,) that repeats itself: (k, 2).

    By rain flow, from the highest value on: a range is a cycle where the next one is as large
    (ASTM E1049, 5.4.5; Downing and Socie, International Journal of Fatigue 4, 1982, 31).
    """
    start = int(values.argmax())
    around = np.append(values[start:], values[: start + 1])
    around = around[np.append(True, np.diff(around) != 0.0)]
    turns = 1 + np.flatnonzero(np.diff(np.sign(np.diff(around))))
    path: list[float] = []
    found = []
    for value in around[[0, *turns, -1]].tolist():
        path.append(value)
        while len(path) > 2 and abs(path[-1] - path[-2]) >= abs(path[-2] - path[-3]):
            found.append((max(path[-3:-1]), min(path[-3:-1])))
            del path[-3:-1]
    return np.array(found).reshape(-1, 2)


def _of_leading(found: np.ndarray, law: Growth | None, periods: float) -> dict[str, float]:
    """Return the numbers of the crack tip whose effective range is the largest."""
    numbers = numbers_at_tips(found, law, periods)
    leading = int(np.argmax(numbers["delta_K_effective"]))
    return {name: float(values[leading]) for name, values in numbers.items()}
