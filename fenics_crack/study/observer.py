"""Observation of a study's motions: of its watched points and the crack faces, and of crack tips
and the clamp where its scene requests their quantities. One walk along a curve observes all.

What is at crack tips and at the clamp follows from rows that multiply the displacement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import (
    IN_FILES_ONLY,
    OBSERVABLES_BY_NAME,
    REQUIRES_GROWTH_LAW,
    REQUIRES_SOLID,
    Place,
    observable_names,
    read_observables,
)
from fenics_crack.model.nodes import Clamp
from fenics_crack.model.receptance import check_matrices
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.motion.motions import ExtraRows, ObservedMotion, Record
from fenics_crack.scene.scene import (
    Scene,
    quantities_on_request,
    reason_without_stress_intensity,
    refuse_for_reason,
)
from fenics_crack.scene.tables import Growth
from fenics_crack.study.prepare import Study

if TYPE_CHECKING:
    from fenics_crack.fem.fronts import Station
    from fenics_crack.fem.interaction_integral import Tip


MIN_STATIONS = 3
"""Stations of a front along which K may vary; that of two is its mean over the front."""
EXPANDED = 20_000_000
"""Values of the whole structure that are expanded at once, 160 MB: each time it is factored."""


def rows_requested(study: Study) -> list[ExtraRows]:
    """Places of rows of their own whose quantities a study's scene requests; the rows are made once
    for its structure (collective)."""
    requested = {OBSERVABLES_BY_NAME[name].place for name in quantities_on_request(study.scene)}
    return [make(study) for place, make in _ROWS.items() if place in requested]


class Quantity(NamedTuple):
    """A number of a motion, or along a curve an array.

    Attributes
    ----------
    column, name : str
        "tip.ux.ratio_2_1", and that of its observable, "ratio_2_1".
    words, unit : str
        With what is watched.
    value : float or (n,)
    """

    column: str
    words: str
    value: Any
    unit: str
    name: str


def observe(study: Study, motion: ObservedMotion) -> list[Quantity]:
    """The numbers of each watched displacement, of the crack faces, and at places of rows of their
    own those that a study's scene requests (collective)."""
    dofs = [watched.dof for watched in study.watched]
    displacements, others = motion.observe(dofs, rows_requested(study))
    quantities = []
    for watched, (indicators, _) in zip(study.watched, displacements, strict=True):
        for name in observable_names(Place.POINT):
            row = OBSERVABLES_BY_NAME[name]
            of_point = f", {watched.words}" if watched.name or name == "amplitude" else ""
            number = row.words + of_point, getattr(indicators, name), row.unit, name
            quantities.append(Quantity(watched.column(name), *number))
    values = motion.faces | {name: others[name] for name in quantities_on_request(study.scene)}
    for name, value in values.items():
        row = OBSERVABLES_BY_NAME[name]
        quantities.append(Quantity(name, row.words, value, row.unit, name))
    return quantities


# --- the clamp ------------------------------------------------------------------------------------


class Held(NamedTuple):
    """Forces (n, d) [N] and moments (n, n_rigid - d) [N m] of the clamp over time."""

    force: np.ndarray
    moment: np.ndarray


def held(record: Record) -> Held:
    """The clamp in a record of :func:`inertia_rows`."""
    whole, omega = record.structure.whole, record.omega
    clamp, drag = _clamp(whole)
    if record.instants_per_load_period:
        return Held(*clamp.reaction_of_record(record.time, record.row_products, omega, drag))
    base = omega / record.subharmonic
    parts = record.coefficients, base, record.subharmonic, drag, base * record.time
    return Held(*clamp.reaction_of_waves(*parts))


def _clamp(whole: Structure) -> tuple[Clamp, float]:
    """The clamp of a structure, and a [1/s] of Rayleigh's damping."""
    check_matrices(whole, "its clamp")
    assert whole.clamp is not None  # the scene has been checked
    return whole.clamp, whole.damping.mass if isinstance(whole.damping, RayleighDamping) else 0.0


def inertia_rows(structure: Structure) -> np.ndarray:
    """r^T M in the coordinates of a structure: (n_rigid, n_local). What has no mass has no inertia:
    truncated modes respond quasi-statically (collective)."""
    whole, inertia = structure.whole, _clamp(structure.whole)[0].inertia
    if structure is whole:
        return inertia
    # with mass, where not all coordinates have it
    known = structure.known_omega_and_shapes(is_bonded=False)
    shapes = np.eye(structure.n_dofs) if known is None else known[1]
    rows = whole.sum_over_ranks(structure.expand(shapes.T) @ inertia.T).T @ shapes.T
    mass = structure.mass.getValues(range(structure.n_dofs), range(structure.n_dofs))
    return np.asarray(rows @ mass)


# --- the tips -------------------------------------------------------------------------------------


class AtTip(NamedTuple):
    """Stress intensity at a crack tip, or a place of a crack front, over time.

    Attributes
    ----------
    one, two, three : (n,) [Pa m^1/2]
        K_I, K_II, and of a solid K_III; of a plate None.
    closed : float [Pa m^1/2]
        Largest size of what is computed for K_I of a solid where it is zero by contact: its error.
    periods : float
        Periods of the load that it lasts, or after which it repeats itself.
    law : Growth or None
        Law of growth of the scene.
    """

    one: np.ndarray
    two: np.ndarray
    periods: float
    law: Growth | None
    three: np.ndarray | None = None
    closed: float = 0.0

    @property
    def equivalent(self) -> float:
        """The range from K_I = 0 that, once a period, makes a crack grow as much as K_I (n,) does,

            (sum_i (delta K_i / (1 - R_i)^(1 - gamma))^m / periods)^(1 / m) [Pa m^1/2],

        over the cycles i that are counted, delta K_i being the range while the tip is open; those
        below the threshold are left out where another is above it."""
        assert self.law is not None
        high, low = counted_cycles(np.maximum(self.one, 0.0)).T
        ranges = high - low
        if not ranges.size:
            return 0.0
        ratio = np.minimum(low / high, 1.0 - 1e-9)
        drive = ranges / (1.0 - ratio) ** (1.0 - self.law.ratio_exponent)
        grows = ranges >= min(self.law.threshold, ranges.max())
        parts = np.where(grows, drive / drive.max(), 0.0) ** self.law.exponent
        return float(drive.max() * (parts.sum() / self.periods) ** (1.0 / self.law.exponent))

    def numbers(self) -> dict[str, float]:
        """Quantities of the tip by their names; the equivalent range where there is a law of
        growth."""
        without = IN_FILES_ONLY if self.law is not None else REQUIRES_GROWTH_LAW
        return read_observables(
            Place.TIPS, self, without | (REQUIRES_SOLID if self.three is None else IN_FILES_ONLY)
        )


def at_tips(
    record: Record, tips: Sequence[Tip | Station], of_forces: np.ndarray, law: Growth | None
) -> list[AtTip]:
    """Stress intensity at each tip in a record of the rows of :func:`tip_rows`. At the front of a
    solid's crack without clearance K_I is zero while all pairs that touch it are closed, and never
    negative."""
    rows = (record.row_products + record.forces[:, : record.n_pairs] @ of_forces.T).T
    exact = not np.any(record.structure.clearance)
    found = []
    for tip, (one, two, *three) in zip(
        tips, rows.reshape(len(tips), -1, rows.shape[1]), strict=True
    ):
        stated, touching = one, tip.adjacent_pairs
        if exact and len(touching):
            shut = np.all(record.forces[:, touching] > 0.0, axis=1)
            stated = np.where(shut, 0.0, one.clip(0.0))
        left_out = float(np.abs(one - stated).max())
        found.append(AtTip(stated, two, record.periods, law, three[0] if three else None, left_out))
    return found


class AtEllipse(NamedTuple):
    """Stress intensity at the deepest place of a half-ellipse, and at its ends on the face."""

    deepest: AtTip
    ends: list[AtTip]


def errors_along_fronts(
    study: Study, motion: ObservedMotion, coarse: Study, other: ObservedMotion
) -> tuple[dict[str, float], dict[str, float]]:
    """What is computed for K_I of a solid's fronts while they are closed, an error of all requested
    numbers of them; and how far each number is away on a coarser mesh, where on the fronts it is
    the most: at one place it may be none by chance [Pa m^1/2]. Infinite for all numbers where the
    coarser mesh has none, or a front with so few stations that K is its mean (collective)."""
    asked = set(quantities_on_request(study.scene))
    names = sorted(asked.intersection(observable_names(Place.TIPS, Place.ELLIPSE)))
    if study.scene.dimension == 2 or not names:
        return {}, {}
    if not asked.intersection(quantities_on_request(coarse.scene)):
        return {}, dict.fromkeys(names, math.inf)
    fine, rough = _along_fronts(study, motion), _along_fronts(coarse, other)
    if min(len(positions) for positions, *_ in rough.values()) < MIN_STATIONS:
        return {}, dict.fromkeys(names, math.inf)
    apart = {}
    for name in names:
        kind = name.removesuffix("_deepest").removesuffix("_surface")
        apart[name] = max(
            float(np.abs(np.interp(at, rough[front][0], rough[front][1][kind]) - own[kind]).max())
            for front, (at, own, _) in fine.items()
        )
    closed = max(size for _, _, size in fine.values())
    return dict.fromkeys(names, closed), apart


def _along_fronts(
    study: Study, motion: ObservedMotion
) -> dict[str, tuple[np.ndarray, dict[str, np.ndarray], float]]:
    """Of each front by its name the places, of its length, the numbers there, and the error while
    closed (collective)."""
    places, rows, of_forces = tip_rows(study)
    [record] = motion.records(rows)
    tips, found = at_tips(record, places, of_forces, study.scene.growth), {}
    for name, its in stations_of_fronts([place.name for place in places]).items():
        at = np.array([places[number].arc_length for number in its])
        numbers = [tips[number].numbers() for number in its]
        values = {kind: np.array([one[kind] for one in numbers]) for kind in numbers[0]}
        found[name] = at / (at[-1] or 1.0), values, max(tips[number].closed for number in its)
    return found


def stations_of_fronts(names: Sequence[str]) -> dict[str, list[int]]:
    """Which stations, by their names, are of each front."""
    found: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        found.setdefault(name.rpartition(" at ")[0], []).append(number)
    return found


def leading(tips: list[AtTip]) -> int:
    """The crack tip whose effective range is the largest."""
    return int(
        np.argmax([OBSERVABLES_BY_NAME["delta_K_effective"].read_number(tip) for tip in tips])
    )


def tip_rows(study: Study) -> tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]:
    """The tips, and rows that multiply the coordinates of a study's structure (2 n_tips, n_local)
    and its contact forces (2 n_tips, n_pairs) to give K_I and K_II of one tip after the other; of a
    solid the stations of its fronts, with K_III as a third; made once for the structure and all
    that share its matrices (collective).

    Of a reduced structure the rows are those of all that its coordinates expand to, static
    responses to load and contact among them: K converges as the load's and the pairs' statics do
    and not as a sum over modes.

    Raises
    ------
    InputError
        Stress intensities of the scene are not known, or it has no crack with tips.
    """
    scene = study.scene
    refuse_for_reason(reason_without_stress_intensity(scene), "output.quantities")
    pairs = None if scene.contact is None else scene.contact.pairs
    plate = scene.geometry, scene.crack, scene.cracks, scene.material, scene.mesh, pairs
    return study.structure.compute_once(_OfScene(plate, scene))


@dataclass(frozen=True)
class _OfScene:
    """The rows of a structure of a scene; equal for scenes of the same plate."""

    plate: tuple[object, ...]
    scene: Scene = field(compare=False)

    def __call__(
        self, structure: Structure
    ) -> tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]:
        if structure is structure.whole:
            found: tuple[list[Tip] | list[Station], np.ndarray, np.ndarray]
            if self.scene.dimension == 2:
                from fenics_crack.fem.interaction_integral import tip_functionals  # DOLFINx

                found = tip_functionals(self.scene, structure)
            else:
                from fenics_crack.fem.fronts import front_functionals

                found = front_functionals(self.scene, structure)
            if not found[0]:
                raise InputError("crack", "a crack without a tip", "one that ends in the structure")
            return found
        tips, rows, of_forces = structure.whole.compute_once(self)
        units, most = np.eye(structure.n_dofs), max(1, EXPANDED // structure.whole.n_dofs)
        blocks = [units[n : n + most] for n in range(0, len(units), most)]
        products = np.vstack([structure.expand(block) @ rows.T for block in blocks])
        return tips, structure.whole.sum_over_ranks(products).T, of_forces


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


def _at_tips(study: Study) -> ExtraRows:
    """The rows of the crack tips, and the numbers of the leading one; the largest K_I of all
    stations of a solid, by which it breaks."""
    places, rows, of_forces = tip_rows(study)

    def numbers(record: Record) -> dict[str, float]:
        tips = at_tips(record, places, of_forces, study.scene.growth)
        found = tips[leading(tips)].numbers()
        if study.scene.dimension == 3:  # under a mean load it may be largest at another station
            found["K_max"] = max(float(tip.one.max()) for tip in tips)
        return found

    return ExtraRows(rows, numbers)


def _at_ellipse(study: Study) -> ExtraRows:
    """The rows of the crack's front, and the numbers at its deepest place and its ends."""
    places, rows, of_forces = tip_rows(study)
    points, crack = np.array([place.point for place in places]), study.scene.given("crack")
    heights = points[:, 2]
    if crack.point is not None:
        heights = -np.abs((points - crack.point) @ crack.frame[1])
    middle = 0.5 * (heights.min() + heights.max())
    ends = [end for end in (0, len(places) - 1) if heights[end] > middle]

    def numbers(record: Record) -> dict[str, float]:
        tips = at_tips(record, places, of_forces, study.scene.growth)
        one = AtEllipse(tips[int(heights.argmin())], [tips[end] for end in ends])
        return read_observables(Place.ELLIPSE, one)

    return ExtraRows(rows, numbers)


def _at_clamp(study: Study) -> ExtraRows:
    rows = study.structure.compute_once(inertia_rows)
    return ExtraRows(rows, lambda record: read_observables(Place.CLAMP, held(record)))


_ROWS: dict[Place, Callable[[Study], ExtraRows]] = {
    Place.TIPS: _at_tips, Place.ELLIPSE: _at_ellipse, Place.CLAMP: _at_clamp
}  # fmt: skip
"""Places of rows of their own."""
