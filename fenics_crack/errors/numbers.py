"""Compute the numbers with which solutions and exact orbits are compared.

The numbers are observables at watched points, crack faces, crack tips and the clamp, and natural
frequencies.

A number may change little although the motion changes much. An extreme depends on the motion at a
single instant, a harmonic on the change in phase with the harmonic. In a sum over pairs, gains and
losses cancel. The same change at a different phase would change the number more. Let a prime mark
the second motion. Each number has a size of change:

    amplitude, opening,     standard deviation over the period of the change in displacement, gap
    crack force             or force; the maximum over pairs, or over cracks
    harmonic ratio k/1      |c_k' - c_k|, with c_k = U_k exp(i (phase_k - k phase_1)) / U_1
    mean shift a0 / U_1     size for the ratio 2/1: a mean has no phase, and has the same origin as
                            U_2, the difference between opening and closing
    shares, friction loss   sum over pairs, |change of the pair|

A shift in time has a size, too, although no extreme changes. If more modes shift a resonance, the
dissipation by friction and impacts changes as well. Then the peak's height changes as much as the
phase.
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
from fenics_crack.motion.motions import (
    CrackFaces,
    Harmonics,
    ObservedMotion,
    Record,
    dof_selection_rows,
)
from fenics_crack.motion.orbit import INSTANTS_PER_PERIOD, PeriodicOrbit
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import observe_quantities
from fenics_crack.study.prepare import Study


def natural_name(scene: Scene, kind: str, mode: int) -> str:
    """Return a natural frequency's name, such as "frequency_open_1" or "omega_open_1"."""
    return f"{'frequency' if scene.in_hertz else 'omega'}_{kind}_{mode}"


def bilinear_of(structure: Structure, mode: int) -> float:
    """Return the bilinear frequency [rad/s] of a mode, counted from 1 (collective)."""
    return float(bilinear_frequencies(structure).omega_bilinear[mode - 1])


@dataclass(frozen=True)
class Numbers:
    """Hold the numbers of an answer.

    Attributes
    ----------
    values, units : dict of str to float, and to str
        Value and unit by name, as in :class:`Verification`.
    resonance : str
        Name of the mode's bilinear frequency; without contact pairs, the open frequency.
    mode : int
        Mode of the resonance, counted from 1.
    """

    values: dict[str, float]
    units: dict[str, str]
    resonance: str
    mode: int


def numbers_of(
    study: Study, motion: PeriodicSolution | TruncatedOrbit, mode: int | None = None
) -> Numbers:
    """Return the requested numbers and natural frequencies of a motion (collective).

    The frequencies are open modes 1 to 3, and open, bonded and bilinear frequencies at ``mode``, by
    default the mode with the resonance nearest to the load. Numbers that vanish to rounding are
    left out.
    """
    quantities = study.scene.quantities or observable_names(required_flags=STATED_WITH_ERROR)
    values: dict[str, float] = {}
    units: dict[str, str] = {}
    displacements = motion.indicators_of_dofs([point.dof for point in study.watched])
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
    """Add natural frequencies to numbers and units, in place (collective).

    Returns
    -------
    str
        Name of the resonance.
    int
        Mode of the resonance, counted from 1; ``mode`` if given.
    """
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
    """Return a solution's accepted exact orbit, or None (collective).

    None also if the search would take too long.
    """
    assessment = solution.assessment
    return (
        assessment.nearest_orbit if assessment.can_search_orbit and assessment.is_accepted else None
    )


def largest_left_out(solution: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """Find a dof's largest harmonic if missing in the solution (collective).

    Harmonics k above the load's are compared in the solution's accepted exact orbit. Return None
    if the solution has the largest harmonic, or no accepted orbit.

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
    """Add the change from a start to an end (absent numbers: 0)."""
    return {
        name: value + end.get(name, 0.0) - start.get(name, 0.0) for name, value in values.items()
    }


def many_harmonics(solution: PeriodicSolution) -> int:
    """Return the number of harmonics for an orbit's motion at points.

    This is the larger of 100 and four times the solution's number.
    """
    return max(4 * solution.harmonics, MAX_HARMONIC_ORDER)


@dataclass(frozen=True)
class TruncatedOrbit(ObservedMotion):
    """Observe an orbit through a limited number of Fourier coefficients."""

    orbit: PeriodicOrbit
    harmonics: int

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """The orbit's structure."""
        return self.orbit.structure

    @property
    def omega(self) -> float:  # type: ignore[override]
        """Load frequency [rad/s]."""
        return self.orbit.omega

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        """Yield the orbit's records, with ``harmonics`` coefficients."""
        waves = self.orbit.product_coefficients(rows, self.harmonics)
        return (replace(record, coefficients=waves) for record in self.orbit.records(rows))


def of_orbit(
    study: Study, solution: PeriodicSolution, orbit: PeriodicOrbit, mode: int
) -> dict[str, float]:
    """Return the numbers of an orbit near a solution (collective).

    The study must have the orbit's structure. Numbers at points have :func:`many_harmonics`.
    """
    return numbers_of(study, TruncatedOrbit(orbit, many_harmonics(solution)), mode).values


# --- sizes of change ------------------------------------------------------------------------------


def sizes_of_change(study: Study, *motions: PeriodicOrbit | PeriodicSolution) -> dict[str, float]:
    """Return the size of each number's change between two motions (collective).

    Parameters
    ----------
    study : Study
        Study with the watched points.
    motions : PeriodicOrbit or PeriodicSolution
        Two motions with the same load and pairs.

    Returns
    -------
    dict of str to float
        Size by the number's column, in the number's unit.
    """
    dofs = [point.dof for point in study.watched]
    record, other_record = (
        next(
            motion.records(
                dof_selection_rows(motion.structure, dofs), INSTANTS_PER_PERIOD * motion.subharmonic
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
    """Return complex c_k (n_harmonics, m) for m signals, k from 0."""
    spectrum = np.fft.rfft(record.row_products, axis=0)[:: record.subharmonic]
    size = np.maximum(np.abs(spectrum[1]), np.finfo(float).tiny)
    orders = np.arange(len(spectrum))[:, None]
    return np.asarray(spectrum / size * (spectrum[1].conj() / size) ** orders)


def _sizes_of_face_changes(record: Record, other_record: Record) -> dict[str, float]:
    """Return sizes of change at crack faces, none without pairs."""
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
    """Return each pair's part (n_pairs,) in every sum over pairs, by name."""
    parts = {"closed_share": (faces.force > 0.0).mean(axis=0) / record.n_pairs}
    if record.friction_coefficient is None:
        return parts
    return parts | {
        "slip_share": faces.is_slipping_at_instants.mean(axis=0) / record.n_pairs,
        "friction_loss": faces.losses,
    }
