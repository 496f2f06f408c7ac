"""State the errors of an answer by an additional run per cause.

The errors are expected values, not bounds. docs/notebook/stated_errors.md compares the errors with
runs on a mesh four times finer. Let f be a number of the answer, e the error and w the load
frequency. The causes are:

- *modes*. The reduced structure's reference has more modes. Its number f_ref gives
  e = |f - f_ref| / s, with the reference's share s of the truncated modes' effect. If exact orbits
  are accepted, f_ref - f is the change between orbits: with few harmonics, all modes above the
  harmonics seem static. A change may be small by chance, if the remaining modes have a different
  phase. So e is at least the size of the motion's change (:mod:`numbers`) over s.
- *harmonics*. An accepted exact orbit gives e = |f - f_orbit|. Without an orbit, solve with twice
  the harmonics. If the report's truncation error is large, the difference may vanish by chance:
  solve with four times the harmonics, too, and take the larger error.
- *mesh*. A coarser mesh, with the ratio r of element lengths, gives f_r and e below.
- *friction*. See :mod:`case`.

A coarser mesh mainly shifts the resonances. Near a resonance a small shift raises or lowers a
number much, so differences may vanish by chance. Hence no number is extrapolated across a
resonance, and two signed parts are added:

- The shape error at equal distance from the resonance. The coarse mesh is solved at w w_r / w_b,
  with the resonance w_r on the coarse mesh and w_b on the answer's mesh.
- The shift error. The answer's mesh is solved at w w_b / w_e, with the extrapolated resonance w_e,
  each time from rest, as several motions may exist.

The resonance belongs to the mode with the largest effect on the watched points. At half a resonance
the second harmonic matters, and a different mode may be nearer to the load. Let f(x) be the number
at load frequency x. The order p lies between 1, the order at crack tips, and the elements' best
order:

    e = max over p of |(f - f_r) / (r^p - 1) + f(w w_b / w_e(p)) - f|.

Further parts are added as the root of the sum of squares:

- A tenth of the smaller part, as parts that cancel are uncertain.
- The change with a shifted clearance. Under a preload or mean load a crack closes pair by pair, and
  the closed part ends between two pairs. The shift is half the gap's step between pairs, times the
  part of the period with both open and closed pairs.
- The displacement added by half as long elements under a point force, which has no limit.
- For stress intensities K, the error of K_I computed while a solid's front is closed. In addition,
  e is at least the largest change of K along the front, extrapolated from both meshes.

All harmonics are kept on the coarser mesh: near half a resonance, half the harmonics may move the
answer as much as the mesh does.

The contact duty cycle is counted at equal instants in all runs. The exact orbit's switching
instants give the error; without an orbit the part of a single instant is added.

The total is the root of the sum of squares for independent causes, otherwise the sum.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import methodcaller

import numpy as np

from fenics_crack.balance.error_report import (
    LARGE_ERROR,
    MIN_HARMONICS_FOR_MODAL_CHANGE,
    ErrorReport,
)
from fenics_crack.balance.more_modes import more_modes_structure_of
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.causes import REDUCED_STRUCTURE_CAUSES
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import Place, observable_names
from fenics_crack.basics.tables import frequency_axis
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors.case import (
    CAUSE_WITHOUT_CONTACT,
    Case,
    reason_of_failure,
    solve_again,
    solve_in_steps,
    vary,
)
from fenics_crack.errors.convergence import (
    ROUNDING_SPREAD,
    TIP_ORDER,
    GridConvergence,
    Varied,
    part_of,
)
from fenics_crack.errors.numbers import (
    add_changes,
    bilinear_of,
    natural_name,
    numbers_of,
    sizes_of_change,
)
from fenics_crack.errors.verification import Verification, dent_by_force
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    bilinear_frequencies,
    solve_bonded_modes,
    solve_modes,
)
from fenics_crack.model.reduced import ReducedStructure
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.study.meshes import prepare_coarser_study_or_reason
from fenics_crack.study.observer import (
    estimate_closed_front_and_mesh_errors,
    make_requested_rows_and_readers,
)
from fenics_crack.study.prepare import REFUSAL_EXCEPTIONS, Study, prepare, reduce_study
from fenics_crack.study.resonance import UNSOUGHT_RESONANCE, LoadResonance, find_study_resonance

STATED_CAUSES = (*REDUCED_STRUCTURE_CAUSES, "friction")
"""Causes with a stated error."""
HARMONIC_FACTORS = 2, 4
"""Factors on the answer's harmonics; the second is for a large truncation error in the report."""
MIN_EXTRAPOLATED, MAX_EXTRAPOLATED = 3, 8
"""Minimum and maximum number of extrapolated resonances for a mesh's shift error."""
MESH_MODES = 50
"""Maximum number of modes to compute a mesh error. With 120 modes the breathing plate's orbits take
14 times as long; the mesh error changes by less than the modal error."""
CANCELLING_FRACTION = 0.1
"""Uncertain fraction of the smaller mesh part, as both parts may cancel."""
Motion = PeriodicOrbit | PeriodicSolution
"""Motion with numbers to compare."""


def errors_of(study: Study, result: object) -> Verification | None:
    """Return the stated errors of a result, or None (collective).

    The result may be natural modes, a converged solution with estimated errors, or a curve over
    frequency or speed; otherwise return None. A curve has the errors of the largest response.
    Inside the curve this peak moves with the resonance, at an end not.
    """
    if isinstance(result, Modes):
        return errors_of_natural(study, {"open": result.omega})
    if isinstance(result, ResponseCurve) and result.parameter in ("omega", "speed"):
        top = result.top(study.watched[0].dof)
        solution = result.solution(top.index)
        if not isinstance(solution.structure, RunUpStructure):
            return stated_errors(study, solution, of_peak=not top.at_end)
        return _errors_at_speed(study, solution, solution.structure, of_peak=not top.at_end)
    if isinstance(result, PeriodicSolution) and result.converged and result.report.estimated:
        return stated_errors(study, result)
    return None


def _errors_at_speed(
    study: Study, solution: PeriodicSolution, structure: RunUpStructure, *, of_peak: bool
) -> Verification:
    """Return the errors of a solution in a run-up (collective).

    Solve the scene at the solution's speed W [rad/s], with as many modes. Let s = d ln w / d ln W
    for a resonance w. A relative error e of the resonance gives the error e / (1 - s) of the speed
    at resonance.
    """
    speed, rate = structure.speed, 1.0 - structure.stiffening(solution.omega)
    changes = {"rotation.speed": speed, "excitation.omega": solution.omega, "curve": None}
    fixed_study = prepare(study.scene.replace(changes), structure.whole.comm, like=study)
    answer = solve_again(fixed_study, solution.omega, solution.harmonics, solution)
    errors = stated_errors(fixed_study, answer, of_peak=of_peak)
    if (resonance := errors.resonance) not in errors.values:
        return errors
    resonance_value = errors.values[resonance]

    def speed_of(frequency: float) -> float:
        return speed * (1.0 + (frequency / resonance_value - 1.0) / rate)

    def part_of_speed(part: GridConvergence) -> GridConvergence:
        limit = speed_of(part.extrapolated)
        return replace(part, values=tuple(map(speed_of, part.values)), extrapolated=limit)

    return replace(
        errors,
        values=errors.values | {"speed": speed},
        units=errors.units | {"speed": "rad/s"},
        parts={
            cause: parts | {"speed": part_of_speed(parts[resonance])}
            for cause, parts in errors.parts.items()
        },
    )


def errors_of_natural(
    study: Study,
    natural_frequencies: Mapping[str, np.ndarray],
    at_load: LoadResonance = UNSOUGHT_RESONANCE,
    slopes: np.ndarray | None = None,
) -> Verification:
    """Return mesh errors of natural frequencies and the load's resonance (collective).

    Parameters
    ----------
    study : Study
        Study of the whole structure.
    natural_frequencies : dict of str to (m,) [rad/s]
        Frequencies with "open" and "tied" (bonded) crack faces.
    at_load : LoadResonance
        Resonance at the load on the same structure; the result includes the ``numbers``.
    slopes : (m,), optional
        Slope S of each mode (:func:`find_study_resonance`).
    """
    scene = study.scene
    factor, _, unit = frequency_axis(scene.in_hertz)

    def by_name(frequencies: Mapping[str, np.ndarray]) -> dict[str, float]:
        return {
            natural_name(scene, kind, number): factor * float(omega)
            for kind, omegas in frequencies.items()
            for number, omega in enumerate(omegas, 1)
            if 0.0 < omega < np.inf
        }

    def mesh_error() -> Varied:
        coarse_mesh = prepare_coarser_study_or_reason(study)
        if isinstance(coarse_mesh, str):
            return coarse_mesh
        twin, counts, ratio = coarse_mesh
        n_modes = max(map(len, natural_frequencies.values()))
        coarse_frequencies = {"open": solve_modes(twin.structure, n_modes).omega}
        if "tied" in natural_frequencies:
            coarse_frequencies["tied"] = solve_bonded_modes(twin.structure, n_modes).omega
        coarse_mesh_numbers = by_name(coarse_frequencies)
        if at_load.numbers and slopes is not None:
            estimates = BilinearFrequencies(coarse_frequencies["open"], coarse_frequencies["tied"])
            coarse_mesh_numbers |= find_study_resonance(
                twin, estimates.omega_bilinear, slopes
            ).numbers
        levels = zip(counts, (values, coarse_mesh_numbers), strict=True)
        return part_of("mesh", [*levels], scene, ratio=ratio)

    values = by_name(natural_frequencies) | at_load.numbers
    errors = Verification(scene, values, dict.fromkeys(values, unit))
    return vary(errors, {"mesh": mesh_error})


def stated_errors(
    study: Study,
    answer: PeriodicSolution,
    *,
    of_peak: bool = False,
    causes: Sequence[str] = STATED_CAUSES,
) -> Verification:
    """Return the expected errors of a solution's numbers by cause (collective).

    Parameters
    ----------
    study : Study
        Study of the solution, with the solution's structure.
    answer : PeriodicSolution
        Solution to judge.
    of_peak : bool
        True if the answer is a curve's peak over frequency, which moves with the resonance.
    causes : sequence of str
        Causes to vary.

    Returns
    -------
    Verification
        ``absent`` or ``unknown`` has the reason for each cause without a part. A cause that does
        not apply is left out.
    """
    numbers = numbers_of(study, answer)
    errors = Verification(study.scene, numbers.values, numbers.units)
    if not is_small(study.structure):  # three more solutions take three times as long
        reasons = dict.fromkeys(REDUCED_STRUCTURE_CAUSES, "the structure is not reduced")
        return replace(errors, unknown=reasons)
    if answer.report.unknown:  # other runs may agree by chance
        return errors.with_unknown("harmonics", not_estimated(answer.report))
    try:
        wave = solve_again(study, answer.omega, answer.harmonics, answer)
    except REFUSAL_EXCEPTIONS as error:
        if answer.orbit is None:
            reason = reason_of_failure("harmonic balance from it", error)
            return errors.with_unknown("harmonics", reason)
        wave = answer  # has the coefficients of an exact orbit
    wave_numbers = numbers_of(study, wave, numbers.mode)
    case = StatedCase(study, answer, numbers.values, wave, wave_numbers, of_peak)
    return vary(errors, {cause: getattr(case, cause) for cause in causes})


def error_by_modes(study: Study, solution: PeriodicSolution) -> float:
    """Return the largest expected modal truncation error (collective).

    The error is relative, the maximum over watched amplitudes and the crack opening; inf if
    unknown.
    """
    errors = stated_errors(study, solution, causes=["modes"])
    names = [*(point.column_name("amplitude") for point in study.watched), "opening"]
    if errors.unknown:
        return math.inf
    stated_names = [name for name in names if errors.parts and errors.values.get(name)]
    return max((errors.stated(name)[0] for name in stated_names), default=0.0)


def not_estimated(report: ErrorReport) -> str:
    """Describe the part of an unknown error that could not be estimated."""
    part = report.largest_part
    words = {"truncation": "truncated harmonics", "reduction": "truncated modes"}
    return f"the error due to the {words.get(part, part)} could not be estimated"


@dataclass(frozen=True)
class StatedCase(Case):
    """Judge each cause of an answer's error by an additional run.

    Attributes
    ----------
    of_peak : bool
        True if the answer is a peak, which moves with the resonance.
    """

    of_peak: bool

    def modes(self) -> Varied:
        """Judge modes by the motion with the reference's modes (collective).

        If the motions are truncated to harmonics, the error is at least the part of harmonics: with
        few harmonics, modes above all harmonics are static in both motions.
        """
        structure, reference = self.study.structure, more_modes_structure_of(self.wave)
        if reference is None:
            return "all are kept"
        assert isinstance(structure, ReducedStructure)
        larger_study = replace(self.study, structure=reference)
        base_motion, motion = self._motions_with(larger_study)
        is_truncated = isinstance(motion, PeriodicSolution)
        base_values = None if is_truncated else self.orbit_values
        numbers_with_more_modes = add_changes(
            self.numbers.values,
            base_values or self.compute_values(base_motion),
            self.compute_values(motion, larger_study),
        )
        min_sizes = sizes_of_change(self.study, base_motion, motion)
        if is_truncated and self._has_massless_flow and not isinstance(self.truncation, str):
            for name, part in self.truncation[1].items():
                size = structure.share * part.uncertainty(-1)
                min_sizes[name] = max(min_sizes.get(name, 0.0), size)
        counts, ratio = (len(structure.omega), len(reference.omega)), 1.0 - structure.share
        levels = zip(counts, (self.numbers.values, numbers_with_more_modes), strict=True)
        _, parts = part_of("modes", [*levels], self.study.scene, ratio=max(ratio, ROUNDING_SPREAD))
        for name, size in min_sizes.items():
            error = parts[name].uncertainty(-1) if name in parts else 0.0
            if 0.0 < error < size / structure.share:
                parts[name] = replace(parts[name], factor=size / structure.share / error)
        return counts, parts

    def _motions_with(self, larger_study: Study) -> tuple[Motion, Motion]:
        """Return the motions with the answer's modes and a larger study's modes (collective).

        Both are the nearest exact orbits, if known; with few harmonics the second may be a
        corrected motion. Otherwise both are solutions, with as many harmonics. If orbits are
        affordable and crack faces have no mass, there are at least
        :data:`MIN_HARMONICS_FOR_MODAL_CHANGE` harmonics per load period.
        """
        wave, assessment = self.wave, self.answer.assessment
        min_harmonics = MIN_HARMONICS_FOR_MODAL_CHANGE * wave.subharmonic
        if assessment.can_search_orbit and (more_modes := assessment.more_modes):
            is_short = self.answer.orbit is None and wave.harmonics < min_harmonics
            if motion := more_modes.orbit_or_corrected_motion if is_short else more_modes.orbit:
                return more_modes.nearest_orbit, motion
        if self._has_massless_flow and wave.harmonics < min_harmonics:
            wave = solve_again(self.study, wave.omega, min_harmonics, wave)
        start = wave if self.study.structure.light_lips else None  # else it has other coordinates
        return wave, solve_again(larger_study, wave.omega, wave.harmonics, start)

    @property
    def _has_massless_flow(self) -> bool:
        """True if exact orbits are affordable and crack faces have no mass."""
        return self.answer.assessment.can_search_orbit and self.study.structure.light_lips

    def harmonics(self) -> Varied:
        """Judge harmonics by the exact orbit, or by more harmonics (collective)."""
        return self.truncation

    @cached_property
    def truncation(self) -> Varied:
        """Part of the cause harmonics (collective)."""
        if self.study.contact is None:
            return CAUSE_WITHOUT_CONTACT
        if self.orbit_values is not None:
            return self.distance_to_orbit(self.orbit_values)
        count, solution, parts_by_factor = self.wave.harmonics, self.wave, []
        n_runs = 2 if self.answer.report.truncation > LARGE_ERROR else 1
        for factor in HARMONIC_FACTORS[:n_runs]:
            solution = solve_again(self.study, self.wave.omega, factor * count, solution)
            levels = (count, self.numbers.values), (factor * count, self.compute_values(solution))
            _, parts = part_of("harmonics", levels, self.study.scene, ratio=1.0 / factor)
            parts_by_factor.append(parts)
        select_largest = partial(max, key=methodcaller("uncertainty"))
        parts = {
            name: select_largest(parts[name] for parts in parts_by_factor)
            for name in self.numbers.values
        }
        if "closed_share" in parts:
            part = parts["closed_share"]  # counted at instants, it is not known to one
            error = math.hypot(part.uncertainty(-1), 1.0 / len(self.wave.instants()))
            parts["closed_share"] = replace(part, extrapolated=part.values[-1] + error)
        return (count, 2 * count), parts

    def mesh(self) -> Varied:
        """Judge the mesh by a coarser mesh, with few modes (collective).

        A reduced plate or solid has at most :data:`MESH_MODES` modes in both runs.
        """
        few_modes = self._with_few_modes()
        mesh_part = few_modes._judge_by_coarser_mesh()
        if few_modes is self or isinstance(mesh_part, str):
            return mesh_part
        counts, few_mode_parts = mesh_part
        parts = {}
        for name, value in self.numbers.values.items():
            if (part := few_mode_parts.get(name)) is None:
                continue
            change = value - few_modes.numbers.values[name]
            values = part.values[0] + change, part.values[1] + change
            parts[name] = replace(part, values=values, extrapolated=part.extrapolated + change)
        return counts, parts

    def _with_few_modes(self) -> StatedCase:
        """Return the answer's case with at most :data:`MESH_MODES` modes (collective).

        Disks and structures without reduction stay unchanged.
        """
        study, scene = self.study, self.study.scene
        structure = study.structure
        if not isinstance(structure, ReducedStructure) or scene.disk is not None:
            return self
        if len(structure.omega) <= MESH_MODES:
            return self
        scene = scene.replace({scene.modes_key: MESH_MODES})
        study = reduce_study(
            replace(study, scene=scene, structure=structure.whole), with_reference=False
        )
        start = self.wave if structure.light_lips else None  # else it has other coordinates
        wave = solve_again(study, self.wave.omega, self.wave.harmonics, start)
        numbers = numbers_of(study, wave, self.numbers.mode)
        return replace(self, study=study, wave=wave, numbers=numbers)

    def _judge_by_coarser_mesh(self) -> Varied:
        """Judge the mesh by a coarser mesh with equally many modes (collective).

        The part is the maximum over the mesh's orders. Besides the shape error, the part includes
        the shift of the resonance unless the answer is a peak. Further parts are the shifted
        clearance, closed crack fronts and the dent under a force (see the module).
        """
        study, wave = self.study, self.wave
        coarse_mesh = prepare_coarser_study_or_reason(study)
        if isinstance(coarse_mesh, str):
            return coarse_mesh
        coarse_study, counts, ratio = coarse_mesh
        coarse_study, mode = _with_known_numbers(coarse_study), self._mode_of_shift()
        frequency_ratio = bilinear_of(coarse_study.structure, mode)
        frequency_ratio /= bilinear_of(study.structure, mode)
        coarse_wave = solve_in_steps(coarse_study, wave.omega * frequency_ratio, wave.harmonics)
        coarse_mesh_numbers = self.compute_values(coarse_wave, coarse_study)
        levels = zip(counts, (self.numbers.values, coarse_mesh_numbers), strict=True)
        _, parts = part_of("mesh", [*levels], study.scene, ratio=ratio)
        orders = 2.0 * study.scene.mesh.order, TIP_ORDER
        ends = tuple(1.0 / (ratio**order - 1.0) for order in orders)
        shift_range = abs(1.0 - frequency_ratio) * (ends[1] - ends[0])
        factors = np.linspace(*ends, self._n_extrapolated(shift_range, mode))
        numbers_by_shift = self._values_at_shifts(factors * (1.0 - frequency_ratio))
        numbers_with_clearance_shift = self._values_with_shifted_clearance()
        dents = dict.fromkeys(observable_names(Place.POINT), self._relative_dent)
        closed_errors, front_changes = estimate_closed_front_and_mesh_errors(
            study, wave, coarse_study, coarse_wave
        )
        for name, part in parts.items():
            value, coarse_mesh_number = part.values
            shape_errors = factors * (value - coarse_mesh_number)
            shift_errors = np.array([values.get(name, 0.0) for values in numbers_by_shift]) - value
            cancelling_size = np.minimum(np.abs(shape_errors), np.abs(shift_errors)).max()
            error = math.hypot(
                np.abs(shape_errors + shift_errors).max(),
                CANCELLING_FRACTION * cancelling_size,
                numbers_with_clearance_shift.get(name, value) - value,
                closed_errors.get(name, 0.0),
                dents.get(name, 0.0) * value,
            )
            error = max(error, front_changes.get(name, 0.0) * factors.max())
            parts[name] = replace(part, extrapolated=value + error)
        return counts, parts

    def _values_at_shifts(self, shifts: np.ndarray) -> list[dict[str, float]]:
        """Return the numbers at relative shifts of the resonance (collective).

        Peaks have unchanged numbers. Each solution starts from rest, as on a finer mesh, and may
        reach a different motion.
        """
        if self.of_peak:
            return [self.numbers.values] * len(shifts)
        frequencies = self.wave.omega / (1.0 + shifts)
        solutions = (
            solve_in_steps(self.study, float(omega), self.wave.harmonics) for omega in frequencies
        )
        return [self.compute_values(solution) for solution in solutions]

    def _n_extrapolated(self, shift_range: float, mode: int) -> int:
        """Return the number of extrapolated resonances in a range of relative shifts.

        A peak's half-power width has four, within the limits :data:`MIN_EXTRAPOLATED` and
        :data:`MAX_EXTRAPOLATED`.
        """
        modes = all_modes(self.study.structure)
        rates = modes.damping if modes.damping.ndim == 1 else np.diag(modes.damping)
        omega = math.sqrt(max(modes.squares[mode - 1], sys.float_info.min))
        n_steps = math.ceil(
            4.0 * shift_range * omega / max(rates[mode - 1], ROUNDING_SPREAD * omega)
        )
        return min(max(1 + n_steps, MIN_EXTRAPOLATED), MAX_EXTRAPOLATED)

    def _mode_of_shift(self) -> int:
        """Return the mode with the strongest shift effect on watched points (collective).

        Let w be the load frequency, w_j the bilinear frequency of mode j and U_k the amplitude of
        harmonic k. The harmonic changes by about 2 U_k / |1 - (k w / w_j)^2| times the relative
        shift of w_j.
        """
        wave = self.wave
        rows = wave.coefficients_at([point.dof for point in self.study.watched])
        sizes = np.hypot(rows[1::2], rows[2::2]).max(axis=1)
        harmonics = np.arange(1, wave.harmonics + 1)
        omega = bilinear_frequencies(self.study.structure).omega_bilinear
        distances = np.abs(1.0 - (harmonics * wave.omega / omega[:, None]) ** 2)
        return int(np.argmax((sizes / np.maximum(distances, ROUNDING_SPREAD)).max(axis=1))) + 1

    @property
    def _relative_dent(self) -> float:
        """Relative amplitude added by half as long elements under a point force."""
        if self.study.scene.points:
            return 0.0
        amplitude = self.wave.amplitude(self.study.watched[0].dof)
        return dent_by_force(self.study.scene) / amplitude

    def _values_with_shifted_clearance(self) -> dict[str, float]:
        """Return the numbers with each crack's clearance shifted (collective).

        The shift [m] is half the step of the extreme gap between neighbouring pairs, times the
        range of the pairs' closed shares of the period. Without cracks, return no numbers.
        """
        study, wave, instants = self.study, self.wave, self.wave.instants()
        cracks = study.structure.pairs.cracks
        if cracks is None or not len(cracks):
            return {}
        gap, touches = wave.gap(instants), wave.contact_force(instants) > 0.0
        shifts = np.zeros(len(cracks))
        for crack in np.unique(cracks):
            is_of_crack = cracks == crack
            closed_shares, crack_gap = touches[:, is_of_crack].mean(axis=0), gap[:, is_of_crack]
            extreme_gaps = crack_gap.min(axis=0) if closed_shares.all() else crack_gap.max(axis=0)
            n_along = is_of_crack.sum() ** (1.0 / (study.scene.dimension - 1))
            shifts[is_of_crack] = 0.5 * np.ptp(extreme_gaps) / n_along * np.ptp(closed_shares)
        shifted_study = replace(study, structure=study.structure.varied(clearance=shifts))
        solution = solve_in_steps(shifted_study, wave.omega, wave.harmonics, wave)
        return self.compute_values(solution, shifted_study)


def _with_known_numbers(study: Study) -> Study:
    """Drop stress intensities from a study with elements that are too long."""
    try:
        make_requested_rows_and_readers(study)
    except InputError:
        refused_names = observable_names(Place.TIPS, Place.ELLIPSE)
        names = [name for name in study.scene.quantities or () if name not in refused_names]
        return replace(study, scene=study.scene.replace({"output.quantities": names or None}))
    return study
