"""Numbers by which answers are compared, of solutions and of exact orbits next to them.

They are of watched points, crack faces, crack tips and the clamp, and natural frequencies.
"""

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
    """Return the name of a natural frequency: "frequency_open_1"."""
    return f"{'frequency' if scene.in_hertz else 'omega'}_{kind}_{mode}"


def bilinear_of(structure: Structure, mode: int) -> float:
    """Return the bilinear frequency of a mode [rad/s] (collective)."""
    return float(bilinear_frequencies(structure).omega_bilinear[mode - 1])


@dataclass(frozen=True)
class Numbers:
    """Numbers of an answer.

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


def numbers_of(
    study: Study, motion: PeriodicSolution | TruncatedOrbit, mode: int | None = None
) -> Numbers:
    """Return the requested numbers of a motion, and natural frequencies (collective).

    The frequencies are the lowest ones, and those of a mode. By default it is the mode with the
    nearest resonance.
    """
    quantities = study.scene.quantities or names_of(where=STATED)
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    displacements = motion.measure([watched.dof for watched in study.watched])
    rounding = NEGLIGIBLE * min(  # of closed pairs
        indicators.amplitude + abs(indicators.mean) for indicators in displacements
    )
    requested = (number for number in observe(study, motion) if number.name in quantities)
    for number in sorted(requested, key=lambda number: quantities.index(number.name)):
        place, value = QUANTITIES[number.name].of, float(number.value)
        min_size = {"1": UNCHANGED, "m": rounding * (place is Place.FACES)}.get(number.unit, 0.0)
        if abs(value) > min_size or (place.on_request and value == 0.0):
            values[number.column] = value
            units[number.column] = number.unit.replace("1", "")
    resonance, mode = _add_frequencies(study, motion.omega, mode, values, units)
    return Numbers(values, units, resonance, mode)


def _add_frequencies(
    study: Study, omega: float, mode: int | None, values: dict[str, float], units: dict[str, str]
) -> tuple[str, int]:
    """Add natural frequencies to numbers and units; return the resonance's name and mode."""
    scene, has_pairs = study.scene, study.structure.n_pairs > 0
    frequencies = bilinear_frequencies(study.structure)
    mode = mode or int(frequencies.nearest(omega)["mode"])
    factor, _, unit = frequency_axis(scene.in_hertz)
    modes_by_kind = {"open": sorted({1, 2, 3, mode})}
    if has_pairs:
        modes_by_kind |= {"tied": [mode], "bilinear": [mode]}
    for kind in FREQUENCY_KINDS:
        for number in modes_by_kind.get(kind, []):
            if number <= len(frequencies.omega_open):
                name = natural_name(scene, kind, number)
                omegas = getattr(frequencies, f"omega_{kind}")
                values[name], units[name] = factor * float(omegas[number - 1]), unit
    return natural_name(scene, "bilinear" if has_pairs else "open", mode), mode


# --- of orbits ------------------------------------------------------------------------------------


def accepted_orbit(solution: PeriodicSolution) -> PeriodicOrbit | None:
    """Return the exact orbit that is a solution's own, or None (collective).

    None also if the search would take long.
    """
    assessment = solution.assessment
    return assessment.orbit if assessment.affordable and assessment.is_accepted else None


def largest_left_out(solution: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """Return order k and U_k / U_1 of the largest harmonic above the load's, if it is truncated.

    The harmonic is that of a dof in the solution's own exact orbit. None: the solution has it, or
    there is no such orbit (collective).
    """
    orbit = accepted_orbit(solution)
    if orbit is None:
        return None
    displacement = orbit.coefficients(many_harmonics(solution)).displacement
    rows = solution.structure.values_at(displacement, [dof])[:, 0]
    harmonics = Harmonics(rows, solution.subharmonic)
    if not harmonics.largest_order * solution.subharmonic > solution.harmonics:
        return None
    return int(harmonics.largest_order), float(harmonics.ratio_largest)


def as_changed(
    values: Mapping[str, float], start: Mapping[str, float], end: Mapping[str, float]
) -> dict[str, float]:
    """Return numbers, changed as they differ between two motions; 0 if a motion has none."""
    return {
        name: value + end.get(name, 0.0) - start.get(name, 0.0) for name, value in values.items()
    }


def many_harmonics(solution: PeriodicSolution) -> int:
    """Return the number of harmonics with which an orbit's motion of points is written.

    It is 100, or four times a solution's.
    """
    return max(4 * solution.harmonics, MOST_HARMONICS)


@dataclass(frozen=True)
class TruncatedOrbit(ObservedMotion):
    """Orbit, observed with some of its Fourier coefficients."""

    orbit: PeriodicOrbit
    harmonics: int

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """Return the orbit's structure."""
        return self.orbit.structure

    @property
    def omega(self) -> float:  # type: ignore[override]
        """Return the load frequency [rad/s]."""
        return self.orbit.omega

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        """Return the orbit's records, with the coefficients."""
        waves = self.orbit.product_coefficients(rows, self.harmonics)
        return (replace(record, coefficients=waves) for record in self.orbit.records(rows))


def of_orbit(
    study: Study, solution: PeriodicSolution, orbit: PeriodicOrbit, mode: int
) -> dict[str, float]:
    """Return the numbers of an orbit next to a solution (collective).

    The study has the orbit's structure. Numbers of points have many harmonics.
    """
    return numbers_of(study, TruncatedOrbit(orbit, many_harmonics(solution)), mode).values
