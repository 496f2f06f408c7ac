"""Numbers that compare answers: solutions and exact orbits next to them.

They are of watched points, crack faces, crack tips and the clamp, and natural frequencies.

A number may change by little where the motion changes by much. An extreme changes by the change of
the motion at one instant, a harmonic by the part of its change that is in phase with it. A sum over
pairs changes by gains less losses. A change of the same size at another phase changes the number by
more. The size of a change is

    amplitude, opening,     root mean square over the period of what vibrates of the change of the
    crack force             displacement, gap, force; the largest of all pairs, and of all cracks
    harmonic ratio k/1      |c_k' - c_k|, where c_k = U_k exp(i (phase_k - k phase_1)) / U_1
    mean shift a0 / U_1     that of the ratio 2/1: a mean has no phase, and is made as U_2 is, by
                            the difference between opening and closing
    shares, friction loss   sum over the pairs of |change of the pair|

A shift in time is a change as others are, though it moves no extreme. Next to a resonance that more
modes move, they also change the work that friction and impacts dissipate. So they change the height
of the peak by as much as its phase.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import MAX_HARMONIC_ORDER
from fenics_crack.basics.observables import (
    OBSERVABLES_BY_NAME,
    STATED_WITH_ERROR,
    Place,
    observable_names,
)
from fenics_crack.basics.tables import frequency_axis
from fenics_crack.errors.convergence import ROUNDING_SPREAD
from fenics_crack.model.modes import FREQUENCY_KIND_NAMES, NEGLIGIBLE, bilinear_frequencies
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import CrackFaces, Harmonics, ObservedMotion, Record, rows_of
from fenics_crack.motion.orbit import INSTANTS_PER_PERIOD, PeriodicOrbit
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import observe_quantities
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
    quantities = study.scene.quantities or observable_names(required_flags=STATED_WITH_ERROR)
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    displacements = motion.measure([point.dof for point in study.watched])
    rounding = NEGLIGIBLE * min(  # of closed pairs
        indicators.amplitude + abs(indicators.mean) for indicators in displacements
    )
    requested_numbers = (
        number for number in observe_quantities(study, motion) if number.name in quantities
    )
    for number in sorted(requested_numbers, key=lambda number: quantities.index(number.name)):
        place, value = OBSERVABLES_BY_NAME[number.name].place, float(number.value)
        min_size = {"1": ROUNDING_SPREAD, "m": rounding * (place is Place.FACES)}.get(
            number.unit, 0.0
        )
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
    for kind in FREQUENCY_KIND_NAMES:
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
    return (
        assessment.nearest_orbit if assessment.can_search_orbit and assessment.is_accepted else None
    )


def largest_left_out(solution: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """Find the largest harmonic of a dof if the solution lacks it (collective).

    Harmonics k above the load's are compared in the solution's own exact orbit. None: the solution
    has the largest one, or no orbit of its own.

    Returns
    -------
    int, float
        Order k in multiples of the load's frequency, and U_k / U_1 of the amplitudes.
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


def add_changes(
    values: Mapping[str, float], start: Mapping[str, float], end: Mapping[str, float]
) -> dict[str, float]:
    """Add the change from one motion to another; absent numbers are 0."""
    return {
        name: value + end.get(name, 0.0) - start.get(name, 0.0) for name, value in values.items()
    }


def many_harmonics(solution: PeriodicSolution) -> int:
    """Return the number of harmonics with which an orbit's motion of points is written.

    It is 100, or four times a solution's.
    """
    return max(4 * solution.harmonics, MAX_HARMONIC_ORDER)


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


# --- sizes of change ------------------------------------------------------------------------------


def sizes_of_change(study: Study, *motions: PeriodicOrbit | PeriodicSolution) -> dict[str, float]:
    """Return the size of the change between two motions for each number (collective).

    Parameters
    ----------
    study : Study
        Study that names the watched displacements.
    motions : PeriodicOrbit or PeriodicSolution
        Two motions with the same load and pairs.

    Returns
    -------
    dict of str to float
        Sizes by column, in the unit of each number.
    """
    dofs = [point.dof for point in study.watched]
    record, other_record = (
        next(
            motion.records(
                rows_of(motion.structure, dofs), INSTANTS_PER_PERIOD * motion.subharmonic
            )
        )
        for motion in motions
    )
    ratios = _ratios(record)
    changes = np.abs(_ratios(other_record) - ratios)
    order_index = 2 + np.argmax(np.abs(ratios[2:]), axis=0)
    sizes = {
        "amplitude": (other_record.row_products - record.row_products).std(axis=0),
        "ratio_2_1": changes[2],
        "ratio_3_1": changes[3],
        "ratio_largest": np.take_along_axis(changes, order_index[None], axis=0)[0],
        "mean_shift": changes[2],
    }
    return _sizes_of_face_changes(record, other_record) | {
        point.column(name): float(size[index])
        for name, size in sizes.items()
        for index, point in enumerate(study.watched)
    }


def _ratios(record: Record) -> np.ndarray:
    """Return c_k of the module's equation for m signals: (n_harmonics, m) complex."""
    spectrum = np.fft.rfft(record.row_products, axis=0)[:: record.subharmonic]
    size = np.maximum(np.abs(spectrum[1]), np.finfo(float).tiny)
    orders = np.arange(len(spectrum))[:, None]
    return np.asarray(spectrum / size * (spectrum[1].conj() / size) ** orders)


def _sizes_of_face_changes(record: Record, other_record: Record) -> dict[str, float]:
    """Return sizes of change: opening, crack force, shares, friction loss."""
    if not record.n_pairs:
        return {}
    faces, other_faces = CrackFaces(record), CrackFaces(other_record)
    force_change = (other_faces.force - faces.force) @ record.is_pair_in_crack
    parts, other_parts = _parts_of_pairs(record, faces), _parts_of_pairs(record, other_faces)
    return {
        "opening": float((other_faces.gap - faces.gap).std(axis=0).max()),
        "crack_force": float(force_change.std(axis=0).max()),
        **{name: float(np.abs(other_parts[name] - part).sum()) for name, part in parts.items()},
    }


def _parts_of_pairs(record: Record, faces: CrackFaces) -> dict[str, np.ndarray]:
    """Return each pair's part in sums over pairs: (n_pairs,) by name."""
    parts = {"closed_share": (faces.force > 0.0).mean(axis=0) / record.n_pairs}
    if record.friction_coefficient is None:
        return parts
    return parts | {
        "slip_share": faces.is_slipping_at_instants.mean(axis=0) / record.n_pairs,
        "friction_loss": faces.losses,
    }
