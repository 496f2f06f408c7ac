"""Compute the numbers with which solutions and exact orbits are compared.

The numbers are observables at watched points, crack faces, crack tips and the clamp, and natural
frequencies.

Two motions may differ much although a number hardly changes. An extreme depends on a single
instant. A harmonic's amplitude hardly shows changes at a right angle to the harmonic's phase. In a
sum over pairs, increases and decreases cancel. So each number also has a size of change, with
changes at any phase and of either sign. Let a prime mark the second motion:

    amplitude, opening,     standard deviation over the period of the change in displacement, gap
    crack force             or force; the maximum over pairs, or over cracks
    harmonic ratio k/1      |c_k' - c_k|, with c_k = U_k exp(i (phase_k - k phase_1)) / U_1
    mean shift a0 / U_1     size for the ratio 2/1: a mean has no phase, and has the same origin as
                            U_2, the difference between opening and closing
    shares, friction loss   sum over pairs, |change of the pair|

A mere shift in time has a size, too, although no extreme changes. The reason: if more modes shift a
resonance, the dissipation by friction and impacts changes as well. Then the peak's height changes
as much as the phase.
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
from fenics_crack.basics.tables import choose_frequency_factor_name_unit
from fenics_crack.errors.convergence import MAX_RELATIVE_ROUNDING_SPREAD
from fenics_crack.model.modes import (
    FREQUENCY_KIND_NAMES,
    STIFFNESS_SOLUTION_ROUNDING,
    bilinear_frequencies,
)
from fenics_crack.model.structure import Structure
from fenics_crack.motion.motions import (
    CrackFaceGapsAndForces,
    DisplacementHarmonics,
    MotionRecord,
    ObservedMotion,
    dof_selection_rows,
)
from fenics_crack.motion.orbit import INSTANTS_PER_PERIOD, PeriodicOrbit
from fenics_crack.scene.scene import Scene
from fenics_crack.study.observer import observe_quantities
from fenics_crack.study.prepare import Study


def natural_frequency_name(scene: Scene, kind: str, mode_number: int) -> str:
    """Return a natural frequency's name, such as "frequency_open_1" or "omega_open_1".

    If the scene states frequencies in Hz, the name begins with "frequency", otherwise with "omega".
    ``kind`` is "open", "tied" (bonded crack) or "bilinear" (:func:`find_bilinear_omega`).
    ``mode_number`` counts from 1.
    """
    return f"{'frequency' if scene.is_frequency_in_hertz else 'omega'}_{kind}_{mode_number}"


def find_bilinear_omega(structure: Structure, mode_number: int) -> float:
    """Return the bilinear frequency [rad/s] of a mode, counted from 1 (collective).

    The bilinear frequency 2 w_o w_t / (w_o + w_t) approximates the resonance with a breathing
    crack. w_o is the mode's frequency with open crack, and w_t with bonded crack.
    """
    return float(bilinear_frequencies(structure).omega_bilinear[mode_number - 1])


@dataclass(frozen=True)
class MotionQuantities:
    """Hold a motion's quantities for comparison with further motions.

    Attributes
    ----------
    values_by_name, unit_by_name : dict of str to float, and to str
        Value and unit of each quantity and natural frequency, by name.
    resonance_name : str
        Name in ``values_by_name`` of the frequency at resonance. This is the bilinear frequency of
        the resonant mode, between the frequencies with open and with bonded crack. Without contact
        pairs, the frequency with open crack.
    mode_number : int
        Resonant mode, counted from 1.
    """

    values_by_name: dict[str, float]
    unit_by_name: dict[str, str]
    resonance_name: str
    mode_number: int


def compute_numbers(
    study: Study,
    motion: PeriodicSolution | OrbitTruncatedToHarmonics,
    mode_number: int | None = None,
) -> MotionQuantities:
    """Compute the requested quantities and natural frequencies of a motion (collective).

    Quantities equal to zero, except for rounding, are left out. The natural frequencies are the
    first three with open crack, then three for ``mode_number``: with open crack, with bonded crack,
    and bilinear (:func:`find_bilinear_omega`).

    Parameters
    ----------
    study : Study
        Study with the motion's structure. The quantities are the scene's ``output.quantities``; by
        default all quantities with an estimated error.
    motion : PeriodicSolution or OrbitTruncatedToHarmonics
        Motion with the quantities.
    mode_number : int, optional
        Resonant mode, counted from 1. Default: the mode with the resonance nearest to the load
        frequency.
    """
    quantity_names = study.scene.quantities or observable_names(required_flags=STATED_WITH_ERROR)
    values_by_name: dict[str, float] = {}
    unit_by_name: dict[str, str] = {}
    displacement_indicators = motion.indicators_of_dofs(
        [watched_point.dof for watched_point in study.watched]
    )
    rounding_size = STIFFNESS_SOLUTION_ROUNDING * min(  # of closed pairs
        indicators_of_dof.amplitude + abs(indicators_of_dof.mean)
        for indicators_of_dof in displacement_indicators
    )
    requested_observations = (
        observation
        for observation in observe_quantities(study, motion)
        if observation.name in quantity_names
    )
    for observation in sorted(
        requested_observations, key=lambda observation: quantity_names.index(observation.name)
    ):
        observable_place = OBSERVABLES_BY_NAME[observation.name].place
        value = float(observation.value)
        min_size = {
            "1": MAX_RELATIVE_ROUNDING_SPREAD,
            "m": rounding_size * (observable_place is Place.CRACK_FACES),
        }.get(observation.unit, 0.0)
        if abs(value) > min_size or (observable_place.is_made_on_request and value == 0.0):
            values_by_name[observation.column_name] = value
            unit_by_name[observation.column_name] = observation.unit.replace("1", "")
    resonance_name, mode_number = _add_natural_frequencies(
        study, motion.omega, mode_number, values_by_name, unit_by_name
    )
    return MotionQuantities(values_by_name, unit_by_name, resonance_name, mode_number)


def _add_natural_frequencies(
    study: Study,
    omega: float,
    mode_number: int | None,
    values_by_name: dict[str, float],
    unit_by_name: dict[str, str],
) -> tuple[str, int]:
    """Add natural frequencies to ``values_by_name`` and ``unit_by_name``, in place (collective).

    Parameters
    ----------
    study : Study
        Study with the structure.
    omega : float [rad/s]
        Load frequency.
    mode_number : int or None
        Resonant mode, counted from 1. If None, the mode with the resonance nearest to the
        load frequency.
    values_by_name, unit_by_name : dict of str to float, and to str
        Values and units by name, extended here.

    Returns
    -------
    str
        Name of the resonance: bilinear frequency, or open frequency without contact pairs.
    int
        Resonant mode, counted from 1.
    """
    scene, has_pairs = study.scene, study.structure.n_pairs > 0
    natural_frequencies = bilinear_frequencies(study.structure)
    mode_number = mode_number or int(natural_frequencies.nearest(omega)["mode"])
    unit_factor, _, unit = choose_frequency_factor_name_unit(scene.is_frequency_in_hertz)
    mode_numbers_by_kind = {"open": sorted({1, 2, 3, mode_number})}
    if has_pairs:
        mode_numbers_by_kind |= {"tied": [mode_number], "bilinear": [mode_number]}
    for kind in FREQUENCY_KIND_NAMES:
        for kind_mode_number in mode_numbers_by_kind.get(kind, []):
            if kind_mode_number <= len(natural_frequencies.omega_open):
                frequency_name = natural_frequency_name(scene, kind, kind_mode_number)
                omega_of_modes = getattr(natural_frequencies, f"omega_{kind}")
                values_by_name[frequency_name] = unit_factor * float(
                    omega_of_modes[kind_mode_number - 1]
                )
                unit_by_name[frequency_name] = unit
    return natural_frequency_name(
        scene, "bilinear" if has_pairs else "open", mode_number
    ), mode_number


# --- of orbits ------------------------------------------------------------------------------------


def find_accepted_orbit_or_none(solution: PeriodicSolution) -> PeriodicOrbit | None:
    """Return the exact orbit approximated by a harmonic-balance solution (collective).

    An exact orbit is a periodic motion in time, without truncated harmonics. The orbit is accepted
    if the orbit's gaps are close to the solution's gaps. The difference may be 10 % of the gaps'
    motion, or 50 % if crack faces have no mass. Return None if no orbit is accepted, or if the
    search would take too long.
    """
    assessment = solution.assessment
    return (
        assessment.nearest_orbit if assessment.can_search_orbit and assessment.is_accepted else None
    )


def find_largest_omitted_harmonic(solution: PeriodicSolution, dof: int) -> tuple[int, float] | None:
    """Find a dof's largest higher harmonic, if the solution omits this harmonic (collective).

    The harmonic amplitudes U_k come from the solution's exact orbit
    (:func:`find_accepted_orbit_or_none`). Only harmonics k >= 2 are compared, multiples of the load
    frequency.

    Parameters
    ----------
    solution : PeriodicSolution
        Harmonic-balance solution.
    dof : int
        The displacement's dof.

    Returns
    -------
    (int, float) or None
        The largest harmonic's order k, and the ratio U_k / U_1. None if the solution includes this
        harmonic, or no exact orbit is close enough.
    """
    orbit = find_accepted_orbit_or_none(solution)
    if orbit is None:
        return None
    displacement_coefficients = orbit.coefficients(choose_n_orbit_harmonics(solution)).displacement
    dof_coefficients = solution.structure.values_at(displacement_coefficients, [dof])[:, 0]
    harmonic_indicators_of_dof = DisplacementHarmonics(dof_coefficients, solution.subharmonic)
    if not harmonic_indicators_of_dof.largest_order * solution.subharmonic > solution.harmonics:
        return None
    return int(harmonic_indicators_of_dof.largest_order), float(
        harmonic_indicators_of_dof.ratio_largest
    )


def add_changes(
    values_by_name: Mapping[str, float],
    start_by_name: Mapping[str, float],
    end_by_name: Mapping[str, float],
) -> dict[str, float]:
    """Add the change from a start motion to an end motion to each value.

    Used to apply the change between two exact orbits to the answer's values.

    Parameters
    ----------
    values_by_name : mapping of str to float
        Values by quantity name.
    start_by_name, end_by_name : mapping of str to float
        The same quantities in the start and end motion. A missing quantity counts as 0.

    Returns
    -------
    dict of str to float
        Value + end - start by quantity name.
    """
    return {
        name: value + end_by_name.get(name, 0.0) - start_by_name.get(name, 0.0)
        for name, value in values_by_name.items()
    }


def choose_n_orbit_harmonics(solution: PeriodicSolution) -> int:
    """Choose how many harmonics of an exact orbit to evaluate at watched points.

    Return the larger value: 100, or four times the solution's harmonic count.
    """
    return max(4 * solution.harmonics, MAX_HARMONIC_ORDER)


@dataclass(frozen=True)
class OrbitTruncatedToHarmonics(ObservedMotion):
    """Observe an exact orbit through the first Fourier coefficients alone.

    Used to read the same quantities from an orbit as from a harmonic-balance solution.

    Attributes
    ----------
    orbit : PeriodicOrbit
        Periodic motion in time.
    harmonics : int
        Number of kept harmonics; higher harmonics are left out.
    """

    orbit: PeriodicOrbit
    harmonics: int

    @property
    def structure(self) -> Structure:  # type: ignore[override]
        """Structure of the orbit."""
        return self.orbit.structure

    @property
    def omega(self) -> float:  # type: ignore[override]
        """Load frequency [rad/s]."""
        return self.orbit.omega

    def yield_motion_records(self, rows: np.ndarray) -> Iterator[MotionRecord]:
        """Yield records of m signals over the orbit's period.

        Each record has the orbit's samples in time, and the Fourier coefficients up to the harmonic
        ``harmonics``.

        Parameters
        ----------
        rows : (m, n_dofs)
            Matrix R. The signals are R u with the displacement u. For example, a row with a single
            1 selects a watched dof.
        """
        coefficient_rows = self.orbit.product_coefficients(rows, self.harmonics)
        return (
            replace(record, coefficients=coefficient_rows)
            for record in self.orbit.yield_motion_records(rows)
        )


def compute_orbit_values_by_name(
    study: Study, solution: PeriodicSolution, orbit: PeriodicOrbit, mode_number: int
) -> dict[str, float]:
    """Compute the quantities of an exact orbit near a solution (collective).

    Parameters
    ----------
    study : Study
        Study with the orbit's structure.
    solution : PeriodicSolution
        Solution near the orbit, to choose how many harmonics are evaluated
        (:func:`choose_n_orbit_harmonics`).
    orbit : PeriodicOrbit
        Periodic motion in time.
    mode_number : int
        Resonant mode, counted from 1.

    Returns
    -------
    dict of str to float
        Value by quantity name.
    """
    return compute_numbers(
        study, OrbitTruncatedToHarmonics(orbit, choose_n_orbit_harmonics(solution)), mode_number
    ).values_by_name


# --- sizes of change ------------------------------------------------------------------------------


def measure_absolute_changes_by_name(
    study: Study, *motions: PeriodicOrbit | PeriodicSolution
) -> dict[str, float]:
    """Measure the size of change between two motions, for each quantity (collective).

    Used as a lower limit of a quantity's change: a quantity may stay equal by chance although the
    motion changes. So the size is measured on the motion, and changes in phase count, too. The size
    depends on the quantity:

    - amplitudes, opening, crack force: standard deviation over the period of the change in
      displacement, gap or force; the maximum over pairs or cracks;
    - harmonic ratios: absolute change in the complex ratio;
    - sums over pairs: sum over the absolute changes.

    Parameters
    ----------
    study : Study
        Study with the watched points.
    motions : PeriodicOrbit or PeriodicSolution
        Two motions with the same load and pairs.

    Returns
    -------
    dict of str to float
        Size by the quantity's column name, in the quantity's unit.
    """
    watched_dofs = [point.dof for point in study.watched]
    record, other_record = (
        next(
            motion.yield_motion_records(
                dof_selection_rows(motion.structure, watched_dofs),
                INSTANTS_PER_PERIOD * motion.subharmonic,
            )
        )
        for motion in motions
    )
    harmonic_ratios = _complex_harmonic_ratios(record)
    absolute_ratio_changes = np.abs(_complex_harmonic_ratios(other_record) - harmonic_ratios)
    largest_order_index = 2 + np.argmax(np.abs(harmonic_ratios[2:]), axis=0)
    change_by_indicator = {
        "amplitude": (other_record.row_products - record.row_products).std(axis=0),
        "ratio_2_1": absolute_ratio_changes[2],
        "ratio_3_1": absolute_ratio_changes[3],
        "ratio_largest": np.take_along_axis(
            absolute_ratio_changes, largest_order_index[None], axis=0
        )[0],
        "mean_shift": absolute_ratio_changes[2],
    }
    return _measure_absolute_face_changes(record, other_record) | {
        point.column_name(indicator_name): float(change_at_points[point_index])
        for indicator_name, change_at_points in change_by_indicator.items()
        for point_index, point in enumerate(study.watched)
    }


def _complex_harmonic_ratios(record: MotionRecord) -> np.ndarray:
    """Return complex ratios c_k of harmonics to the first harmonic: (n_harmonics, m).

    For harmonic k = 0, 1, ... of the load frequency, with the amplitudes U_k and phases phase_k:

        c_k = U_k exp(i (phase_k - k phase_1)) / U_1.

    The columns are the m signals in ``record``.
    """
    spectrum = np.fft.rfft(record.row_products, axis=0)[:: record.subharmonic]
    first_amplitudes = np.maximum(np.abs(spectrum[1]), np.finfo(float).tiny)
    harmonic_orders = np.arange(len(spectrum))[:, None]
    return np.asarray(
        spectrum / first_amplitudes * (spectrum[1].conj() / first_amplitudes) ** harmonic_orders
    )


def _measure_absolute_face_changes(
    record: MotionRecord, other_record: MotionRecord
) -> dict[str, float]:
    """Measure the size of change between two motions, for quantities at crack faces.

    For "opening" and "crack_force" the size is the change's standard deviation over the period, the
    largest among all pairs or cracks. For a sum over pairs, the size is the sum over the pairs'
    absolute changes.

    Parameters
    ----------
    record, other_record : Record
        Records for both motions.

    Returns
    -------
    dict of str to float
        Size by quantity name; empty without contact pairs.
    """
    if not record.n_pairs:
        return {}
    crack_faces, other_crack_faces = (
        CrackFaceGapsAndForces(record),
        CrackFaceGapsAndForces(other_record),
    )
    force_change = (other_crack_faces.force - crack_faces.force) @ record.is_pair_in_crack
    contributions_by_name = _pair_contributions_by_name(record, crack_faces)
    other_motion_contributions_by_name = _pair_contributions_by_name(record, other_crack_faces)
    return {
        "opening": float((other_crack_faces.gap - crack_faces.gap).std(axis=0).max()),
        "crack_force": float(force_change.std(axis=0).max()),
        **{
            name: float(np.abs(other_motion_contributions_by_name[name] - pair_contributions).sum())
            for name, pair_contributions in contributions_by_name.items()
        },
    }


def _pair_contributions_by_name(
    record: MotionRecord, crack_faces: CrackFaceGapsAndForces
) -> dict[str, np.ndarray]:
    """Return each pair's contribution (n_pairs,) to sums over contact pairs, by quantity name.

    ``record`` gives the number of pairs and the friction coefficient. ``crack_faces`` gives gaps
    and forces. The contributions are:

    - "closed_share": fraction of the period in which the pair is closed, divided by n_pairs,
    - "slip_share": fraction of the period in which the pair slips, divided by n_pairs,
    - "friction_loss": dissipated energy in the pair [J].

    Without friction, the result has "closed_share" alone.
    """
    contributions_by_name = {
        "closed_share": (crack_faces.force > 0.0).mean(axis=0) / record.n_pairs
    }
    if record.friction_coefficient is None:
        return contributions_by_name
    return contributions_by_name | {
        "slip_share": crack_faces.is_slipping_at_instants.mean(axis=0) / record.n_pairs,
        "friction_loss": crack_faces.losses,
    }
