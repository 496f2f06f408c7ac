"""Numbers by which answers are compared: of watched points, crack faces, crack tips and the clamp,
and natural frequencies; of solutions and of the exact orbits next to them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import MOST_HARMONICS
from fenics_crack.basics.observables import QUANTITIES, STATED, Place, names_of
from fenics_crack.basics.tables import frequency_axis
from fenics_crack.errors.convergence import UNCHANGED
from fenics_crack.model.modes import FREQUENCY_KINDS, NEGLIGIBLE, bilinear_frequencies
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import Harmonics, ObservedMotion, Record
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import observe
from fenics_crack.study.prepare import Study


def natural_name(scene: Scene, kind: str, mode: int) -> str:
    """The name of a natural frequency: "frequency_open_1"."""
    return f"{'frequency' if scene.in_hertz else 'omega'}_{kind}_{mode}"


def bilinear_of(structure: Structure, mode: int) -> float:
    """Bilinear frequency of a mode [rad/s] (collective)."""
    return float(bilinear_frequencies(structure).omega_bilinear[mode - 1])


@dataclass(frozen=True)
class Numbers:
    """The numbers of an answer.

    Attributes
    ----------
    values, units : dict of str to float, and to str
        As :class:`Verification` has them.
    resonance : str
        Name of the natural frequency nearest to the load's.
    mode : int
        Its mode.
    """

    values: dict[str, float]
    units: dict[str, str]
    resonance: str
    mode: int


def numbers_of(study: Study, found: PeriodicSolution | _Exact, mode: int | None = None) -> Numbers:
    """Return the requested numbers of the watched points and the crack faces, and natural
    frequencies: the lowest ones, and those of a mode, by default of the one with the nearest
    resonance (collective)."""
    scene, structure = study.scene, study.structure
    chosen = scene.quantities or names_of(where=STATED)
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    seen = found.measure([watched.dof for watched in study.watched])
    rounding = NEGLIGIBLE * min(one.amplitude + abs(one.mean) for one in seen)  # of closed pairs
    numbers = (one for one in observe(study, found) if one.name in chosen)
    for one in sorted(numbers, key=lambda one: chosen.index(one.name)):
        of, value = QUANTITIES[one.name].of, float(one.value)
        least = {"1": UNCHANGED, "m": rounding * (of is Place.FACES)}.get(one.unit, 0.0)
        if abs(value) > least or (of.on_request and value == 0.0):
            values[one.column], units[one.column] = value, one.unit.replace("1", "")
    natural = bilinear_frequencies(structure)
    mode = mode or int(natural.nearest(found.omega)["mode"])
    factor, _, unit = frequency_axis(scene.in_hertz)
    wanted = {("open", number) for number in (1, 2, 3, mode)}
    if structure.n_pairs:
        wanted |= {("tied", mode), ("bilinear", mode)}
    for kind, number in sorted(wanted, key=lambda one: (FREQUENCY_KINDS.index(one[0]), one[1])):
        if number <= len(natural.omega_open):
            name, omega = natural_name(scene, kind, number), getattr(natural, f"omega_{kind}")
            values[name], units[name] = factor * float(omega[number - 1]), unit
    resonance = natural_name(scene, "bilinear" if structure.n_pairs else "open", mode)
    return Numbers(values, units, resonance, mode)


# --- of orbits ------------------------------------------------------------------------------------


def accepted_orbit(found: PeriodicSolution) -> PeriodicOrbit | None:
    """The exact orbit that is a solution's own, unless it would be sought for long (collective)."""
    known = found.assessment
    return known.orbit if known.affordable and known.is_accepted else None


def largest_left_out(found: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """The order k and U_k / U_1 of the largest harmonic of a dof above the load's, where that is
    one which a solution leaves out of its own exact orbit; None elsewhere (collective)."""
    orbit = accepted_orbit(found)
    if orbit is None:
        return None
    moved = orbit.coefficients(many_harmonics(found)).displacement
    rows = found.structure.values_at(moved, [dof])[:, 0]
    seen = Harmonics(rows, found.subharmonic)
    if not seen.largest_order * found.subharmonic > found.harmonics:
        return None
    return int(seen.largest_order), float(seen.ratio_largest)


def as_changed(
    values: Mapping[str, float], one: Mapping[str, float], other: Mapping[str, float]
) -> dict[str, float]:
    """Numbers, changed as they differ between two orbits; 0 where one is none there."""
    return {name: v + other.get(name, 0.0) - one.get(name, 0.0) for name, v in values.items()}


def many_harmonics(found: PeriodicSolution) -> int:
    """Harmonics with which an orbit's motion of points is written: 100, or four times a
    solution's."""
    return max(4 * found.harmonics, MOST_HARMONICS)


@dataclass(frozen=True)
class _Exact(ObservedMotion):
    """An orbit, seen with some of its own Fourier coefficients."""

    orbit: PeriodicOrbit
    harmonics: int

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        return self.orbit.structure

    @property
    def omega(self) -> float:
        return self.orbit.omega

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        waves = self.orbit.product_coefficients(rows, self.harmonics)
        return (replace(record, coefficients=waves) for record in self.orbit.records(rows))


def of_orbit(
    study: Study, found: PeriodicSolution, orbit: PeriodicOrbit, mode: int
) -> dict[str, float]:
    """The numbers of an orbit next to a solution, of a study's structure; those of points have many
    harmonics (collective)."""
    return numbers_of(study, _Exact(orbit, many_harmonics(found)), mode).values
