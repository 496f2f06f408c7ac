"""Stability of periodic solutions: Floquet multipliers, and a verdict.

The multipliers mu belong to the exact orbit next to a solution. The orbit is stable if all lie
within the unit circle (:mod:`fenics_crack.motion.orbit`). The function :func:`shoot` finds the
orbit alone, and :mod:`fenics_crack.balance.assessment` decides whether it is accepted for the
solution.

If no orbit is found, the exact motion that begins with the solution is followed. The verdict is
"irregular" if a small disturbance grows
(:func:`fenics_crack.motion.attractors.find_irregular_motion`).

Smooth laws, not piecewise linear, have no exact flow. Their multipliers come from the linear flow
along the solution. They decide the stability if the solution's error is small. The uncertainty is
the difference from the multipliers with twice the harmonics.

Linear flow
-----------
Small disturbances z = (q, q') of a solution with gap s(t) follow, in modal coordinates,

    q'' + C q' + (W^2 + P kappa(t) P^T) q = 0,      kappa = d lambda / ds along s(t).

C is the modal damping, W holds the natural frequencies, and P^T takes modal amplitudes q to gaps. A
step with length h has three parts: half a kick, q' -= h/2 P kappa P^T q, an exact drift without
contact, and half a kick with the stiffness at the end. The product M_N of N steps per period
has an error with even powers of h alone. The error of (4 M_2N - M_N) / 3 is thus of fourth order. N
is doubled until this matrix hardly changes, up to 8192.

References
----------
Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7.
Strang, SIAM Journal on Numerical Analysis 5, 1968, 506.
Hairer, Lubich and Wanner, Geometric Numerical Integration, 2006, section II.4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.assessment import Assessment, wave_with_twice_the_harmonics
from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.more_modes import ERROR_IF_UNKNOWN
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import ConvergenceError, InputError, check_count
from fenics_crack.basics.tables import format_percent
from fenics_crack.model.contact import (
    ContactLaw,
    check_law,
    check_slope,
    forces_and_slopes_of_smooth_law,
    is_unilateral,
)
from fenics_crack.model.modal import N_MODAL_COORDINATES_IN_CPU_CACHE, AllModes, all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.motion.attractors import Attractor, find_attractor
from fenics_crack.motion.flow import exact_flow_or_error
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    MULTIPLIER_TOLERANCE,
    NEUTRAL_MULTIPLIER_TEXT,
    PeriodicOrbit,
    eigenvalues,
    find_orbit,
    is_same_orbit_in_phase,
)
from fenics_crack.motion.search import ORBIT_START_STRATEGY_BY_NAME, SearchOptions, search_orbit
from fenics_crack.motion.shooting import FlowOrbitEquations
from fenics_crack.numerics.fourier import sample_period
from fenics_crack.numerics.newton import root_sum_of_squares_with_limited_mean


def monodromy_of_linear_flow(
    structure: Structure,
    contact: ContactLaw,
    gap_coefficients: np.ndarray,
    base_omega: float,
    static_cutoff: float | None = None,
) -> np.ndarray:
    """Return the monodromy matrix for small disturbances of a solution.

    The matrix (2 n_modes, 2 n_modes) maps a disturbance (q, q') of modal displacements and
    velocities at phase zero to the disturbance a period later. The equation of motion is linearised
    along the solution, with the contact stiffness at its gaps.

    Parameters
    ----------
    structure : Structure
        Small structure.
    contact : ContactLaw
        Law for all pairs.
    gap_coefficients : (2H+1, n_pairs) [m]
        Fourier coefficients of the gaps; with ``static_cutoff``, of the slow gaps: gap plus
        residual flexibility times contact force.
    base_omega : float [rad/s]
        Frequency of the response.
    static_cutoff : float, optional [rad/s]
        Frequency above which modes are quasi-static.

    Raises
    ------
    ConvergenceError
        The matrix is not finite, even with 8192 steps per period.
    InputError
        The law's tangent is not the slope of its force along the solution.
    """
    modes = all_modes(structure).with_fast_modes_quasi_static(static_cutoff)
    gap_samples = sample_period(gap_coefficients, 4 * len(gap_coefficients))
    if modes.residual_compliance is not None:
        force_samples = forces_and_slopes_of_smooth_law(
            contact, modes.residual_compliance, gap_samples
        )[0]
        gap_samples = gap_samples - force_samples @ modes.residual_compliance
    check_slope(contact, gap_samples)
    state_scales = np.repeat([np.sqrt(np.abs(modes.squares).max()) or 1.0, 1.0], len(modes.squares))
    n_steps_per_period = 1 << (4 * len(gap_coefficients)).bit_length()
    coarser_product = extrapolated_matrix = _monodromy_matrix_by_equal_steps(
        modes, contact, gap_coefficients, base_omega, n_steps_per_period
    )
    monodromy_change_norm = monodromy_norm = np.inf
    while (
        n_steps_per_period < 2**13
        and not monodromy_change_norm <= MULTIPLIER_TOLERANCE * monodromy_norm < np.inf
    ):
        n_steps_per_period *= 2
        finer_product = _monodromy_matrix_by_equal_steps(
            modes, contact, gap_coefficients, base_omega, n_steps_per_period
        )
        coarser_matrix = extrapolated_matrix
        extrapolated_matrix = finer_product + (finer_product - coarser_product) / 3.0
        coarser_product = finer_product
        scaled_monodromy_change_and_matrix = (
            state_scales[:, None] * monodromy_change_or_matrix / state_scales
            for monodromy_change_or_matrix in (
                extrapolated_matrix - coarser_matrix,
                extrapolated_matrix,
            )
        )
        monodromy_change_norm, monodromy_norm = (
            float(np.linalg.norm(scaled_monodromy_or_change))
            for scaled_monodromy_or_change in scaled_monodromy_change_and_matrix
        )
    if not np.all(np.isfinite(extrapolated_matrix)):
        raise ConvergenceError(
            "linear flow: disturbances grow too fast for the time steps, so the stability is "
            "unknown; try fewer modes, or a softer contact"
        )
    return extrapolated_matrix


def _monodromy_matrix_by_equal_steps(
    modes: AllModes, contact: ContactLaw, gap_coefficients: np.ndarray, base_omega: float,
    n_steps: int,
) -> np.ndarray:  # fmt: skip
    """Return the monodromy matrix of the linear flow by equal steps.

    The linear flow describes small disturbances of a solution. The matrix (2 n_modes, 2 n_modes)
    maps a disturbance at phase zero to the disturbance a period later. The error is of second order
    in the step length; with too few steps the matrix is not finite. Matrices for several parts of
    the period are computed together, then multiplied in sequence.

    Parameters
    ----------
    modes : AllModes
        The structure's modes.
    contact : ContactLaw
        Law for all pairs.
    gap_coefficients : (2H+1, n_pairs) [m]
        The solution's Fourier coefficients for gaps; with a residual flexibility, for slow gaps:
        gap plus residual flexibility times contact force.
    base_omega : float [rad/s]
        The response's frequency.
    n_steps : int
        Steps per period, a power of two.
    """
    step_size = 2.0 * np.pi / base_omega / n_steps
    n_modes = len(modes.squares)
    gap_samples = sample_period(gap_coefficients, n_steps)
    if modes.residual_compliance is None:
        steps_times_stiffness = step_size * contact.tangent(gap_samples)[:, :, None]
    else:
        steps_times_stiffness = (
            step_size
            * forces_and_slopes_of_smooth_law(contact, modes.residual_compliance, gap_samples)[1]
        )
    n_period_parts = 1
    while (
        n_period_parts**2 < n_steps
        and n_period_parts * (2 * n_modes) ** 2 < N_MODAL_COORDINATES_IN_CPU_CACHE
    ):
        n_period_parts *= 2
    steps_times_stiffness_of_parts = steps_times_stiffness.reshape(
        n_period_parts, n_steps // n_period_parts, *steps_times_stiffness.shape[1:]
    )
    one_step_transition = modes.transition_and_force_response(step_size)[0]
    period_part_matrices = np.tile(np.eye(2 * n_modes), (n_period_parts, 1, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # with too few steps
        for step_times_stiffness in steps_times_stiffness_of_parts.swapaxes(0, 1):
            period_part_matrices[:, n_modes:] -= _velocity_change_by_contact(
                modes, step_times_stiffness, period_part_matrices[:, :n_modes]
            )
            period_part_matrices = _states_after_step_without_contact(
                modes, one_step_transition, period_part_matrices
            )
        monodromy_matrix = period_part_matrices[0]
        for period_part_matrix in period_part_matrices[1:]:
            monodromy_matrix = period_part_matrix @ monodromy_matrix
        half_kick_matrix = np.zeros_like(monodromy_matrix)
        half_kick_matrix[n_modes:, :n_modes] = 0.5 * _velocity_change_by_contact(
            modes, steps_times_stiffness[0], np.eye(n_modes)
        )
        monodromy_matrix = monodromy_matrix + monodromy_matrix @ half_kick_matrix
        return monodromy_matrix - half_kick_matrix @ monodromy_matrix


def _velocity_change_by_contact(
    modes: AllModes, step_times_stiffness: np.ndarray, modal_displacement: np.ndarray
) -> np.ndarray:
    """Return the modal velocity change by contact over a step: h P kappa P^T q.

    The matrix P^T takes modal displacements q to the pairs' gaps. P takes contact forces to modal
    forces.

    Parameters
    ----------
    modes : AllModes
        The structure's modes, with P.
    step_times_stiffness : (..., n_pairs, 1), or (..., n_pairs, n_pairs) if pairs are coupled
        Step length h times contact stiffness kappa.
    modal_displacement : (..., n_modes, k)
        k modal displacements q.

    Returns
    -------
    (..., n_modes, k)
        Change to subtract from the velocities.
    """
    pair_gaps = modes.gaps_by_mode.T @ modal_displacement
    has_uncoupled_pairs = modes.residual_compliance is None
    pair_impulse = (
        step_times_stiffness * pair_gaps
        if has_uncoupled_pairs
        else step_times_stiffness @ pair_gaps
    )
    return np.asarray(modes.gaps_by_mode @ pair_impulse)


def _states_after_step_without_contact(
    modes: AllModes, one_step_transition: np.ndarray, states: np.ndarray
) -> np.ndarray:
    """Return states after an exact step without contact forces: (m, 2 n_modes, k).

    Parameters
    ----------
    modes : AllModes
        The structure's modes.
    one_step_transition : (2 n_modes, 2 n_modes) or (4, n_modes)
        Matrix exp(A h) for z' = A z without contact, over a step of length h. If damping does not
        couple modes: the diagonals of its four blocks, row by row.
    states : (m, 2 n_modes, k)
        k states z for each of m parts of the period. The second index has modal displacements, then
        modal velocities.
    """
    if modes.damping.ndim == 2:
        return np.asarray(one_step_transition @ states)
    n_modes, transition_blocks = one_step_transition.shape[1], one_step_transition[:, :, None]
    displacements_before_step, velocities_before_step = states[:, :n_modes], states[:, n_modes:]
    new_displacement = (
        transition_blocks[0] * displacements_before_step
        + transition_blocks[1] * velocities_before_step
    )
    new_velocity = (
        transition_blocks[2] * displacements_before_step
        + transition_blocks[3] * velocities_before_step
    )
    return np.concatenate([new_displacement, new_velocity], axis=1)


def _assess_solution_with_law(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw | None
) -> Assessment:
    """Return the assessment of a solution by the exact flow.

    ``contact`` replaces the solution's law; None: keep the law. Raises InputError if the number of
    dofs is not the structure's.
    """
    law = solution.contact if contact is None else contact
    check_law(structure, law, allows_rigid=True)
    if solution.structure.n_dofs != structure.n_dofs:
        requirement = f"a solution with {structure.n_dofs} dofs, as the structure has"
        raise InputError("solution", f"{solution.structure.n_dofs} dofs", requirement)
    return replace(solution, structure=structure, contact=law).assessment


def shoot(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    settle: int = 0,
    tolerance: float = 1e-10,
) -> PeriodicOrbit:
    """Refine a harmonic-balance solution to a periodic orbit in time.

    The orbit's state z, displacements and velocities, returns after a period T: z(T) = z(0).
    Newton's method on the exact flow finds the orbit at the solution's frequency. Steps are damped
    if the residual would grow.

    Parameters
    ----------
    structure : Structure
        The solution's structure.
    solution : PeriodicSolution
        First guess for the orbit.
    contact : ContactLaw, optional
        Law; default: the solution's own.
    settle : int
        Number of response periods for which the motion is integrated before Newton's method,
        towards an attractor.
    tolerance : float
        Maximum ``|z(T) - z(0)| / |z(0)|``.

    Returns
    -------
    PeriodicOrbit
        Orbit with multipliers, gap and contact force.

    Raises
    ------
    InputError
        The structure is too large, the law is smooth or rigid with mass at the crack faces, or an
        argument cannot be used.
    ConvergenceError
        No orbit nearby was found.

    Examples
    --------
    >>> orbit = fc.shoot(structure, solution)
    >>> multipliers = orbit.multipliers
    """
    check_count("settle", settle, 0)
    assessment, subharmonic = (
        _assess_solution_with_law(structure, solution, contact),
        solution.subharmonic,
    )
    assert assessment.wave.contact is not None
    flow = exact_flow_or_error(structure, assessment.wave.contact)
    orbit = None if settle else assessment.nearest_orbit
    if orbit is None:
        orbit_equations = FlowOrbitEquations(
            flow, solution.omega, assessment.states_at_period_parts[0], subharmonic
        )
        settled_unknown = orbit_equations.start_unknown
        for _ in range(settle):
            settled_unknown = orbit_equations.unknown_after_period(settled_unknown, 1.0)
        start_state = orbit_equations.state(settled_unknown)
        orbit = search_orbit(
            flow, solution.omega, [start_state[None]], subharmonic, prefer_stable=False,
            start_strategies=(
                ORBIT_START_STRATEGY_BY_NAME["guesses"], ORBIT_START_STRATEGY_BY_NAME["path"],
            ),
        ).orbit  # fmt: skip
    if orbit is not None and orbit.residual > tolerance:  # short last step, but large M
        reconverged_orbit = find_orbit(
            orbit.flow, orbit.omega, orbit.state, subharmonic=orbit.subharmonic
        )
        orbit = reconverged_orbit or orbit
    if orbit is None or not orbit.residual <= tolerance:
        remedy_text = (
            "begin at a solution with more harmonics, or give settle, a number of periods"
            if orbit is None
            else f"the smallest residual is {orbit.residual:.1e}; raise tolerance above it"
        )
        raise ConvergenceError(
            f"shooting: no periodic orbit was found near the solution; {remedy_text}"
        )
    return orbit


def floquet(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw | None = None
) -> Stability:
    """Return the Floquet multipliers of a solution, and its stability.

    The multipliers mu are the eigenvalues of the monodromy matrix dz(T)/dz(0). z is displacement
    and velocity, T the response's period. In each period a small disturbance is multiplied by mu.
    The solution is stable if ``|mu| < 1`` for all.

    Parameters
    ----------
    structure : Structure
        The solution's; at most 600 dofs, else reduce it before solving.
    solution : PeriodicSolution
        Solution to assess.
    contact : ContactLaw, optional
        Law; default: the solution's own.

    Returns
    -------
    Stability
        Multipliers in descending order of modulus, and the verdict: "stable", "unstable",
        "irregular" or "undecided". If no exact orbit decides, the reason, with distance and
        stability of the nearest orbit if one was found.

    Raises
    ------
    InputError
        The structure is too large, or the law is a constraint of crack faces with mass.

    Notes
    -----
    Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
    chapter 7.

    Examples
    --------
    >>> stability = fc.floquet(structure, solution)
    >>> verdict, reason = stability.verdict, stability.reason
    """
    assessment = _assess_solution_with_law(structure, solution, contact)
    law = assessment.wave.contact
    if assessment.flow is None:
        assert law is not None
        if is_unilateral(law) or not is_small(structure):
            exact_flow_or_error(structure, law)  # raises InputError with the reason
        return _stability_by_linear_flow(structure, solution, law)
    return stability_of(assessment)


def attractors(structure: Structure, solution: PeriodicSolution) -> tuple[Attractor, ...]:
    """Find the motions that a disturbed unstable solution reaches in the long run.

    A motion begins next to the unstable orbit, at a distance of 1 % of the motion, and the exact
    flow follows it. Small disturbances grow in the direction v, an eigenvector M v = mu v of the
    monodromy matrix M. If mu > 1, disturbances along v and -v may lead to two orbits: above and
    below the unstable orbit of a leaning resonance, for example. For an irregular solution the
    result is the exact motion that begins with the solution.

    Parameters
    ----------
    structure : Structure
        The solution's.
    solution : PeriodicSolution
        Solution with the verdict "unstable" or "irregular" (:func:`floquet`).

    Returns
    -------
    tuple of Attractor
        One attractor, or two different ones.

    Raises
    ------
    InputError
        The verdict is another one, or there is no exact flow, or more than 120 modes.

    Notes
    -----
    Source: Nayfeh and Balachandran, Applied Nonlinear Dynamics, 1995, chapters 3 and 6.

    Examples
    --------
    >>> if fc.floquet(structure, solution).verdict == "unstable":
    ...     seen = [one.amplitudes().max() for one in fc.attractors(structure, solution)]
    """
    assessment = replace(solution, structure=structure).assessment
    if assessment.irregular_attractor is not None:
        return (assessment.irregular_attractor,)
    can_form_monodromy = (
        assessment.flow is not None and assessment.flow.n_modes <= MAX_MODES_FOR_MONODROMY
    )
    solution_verdict = stability_of(assessment).verdict if can_form_monodromy else "no exact flow"
    orbit_nearest_to_solution = assessment.nearest_orbit if can_form_monodromy else None
    if solution_verdict != "unstable" or orbit_nearest_to_solution is None:
        requirement = f"unstable, with an exact orbit of at most {MAX_MODES_FOR_MONODROMY} modes"
        raise InputError("solution", solution_verdict, requirement)
    orbit_equations = FlowOrbitEquations(
        orbit_nearest_to_solution.flow,
        orbit_nearest_to_solution.omega,
        orbit_nearest_to_solution.state,
        orbit_nearest_to_solution.subharmonic,
    )
    unstable_orbit_multipliers, eigenvectors = np.linalg.eig(
        orbit_equations.state_factors[:, None]
        * orbit_nearest_to_solution.monodromy
        / orbit_equations.state_factors
    )
    largest_multiplier_index = int(np.abs(unstable_orbit_multipliers).argmax())
    largest_multiplier = unstable_orbit_multipliers[largest_multiplier_index]
    start_unknown_change = eigenvectors[:, largest_multiplier_index].real
    unstable_orbit_states = orbit_nearest_to_solution.period_samples.whole_states
    unstable_orbit_rms_motion = root_sum_of_squares_with_limited_mean(
        orbit_equations.state_factors * unstable_orbit_states
    ) / np.sqrt(len(unstable_orbit_states))
    start_unknown_change *= 0.01 * unstable_orbit_rms_motion / np.linalg.norm(start_unknown_change)
    distinct_attractors: list[Attractor] = []
    start_unknowns = (
        orbit_equations.start_unknown + start_unknown_change,
        orbit_equations.start_unknown - start_unknown_change,
    )
    for start_unknown in (
        start_unknowns if largest_multiplier == abs(largest_multiplier) else start_unknowns[:1]
    ):
        attractor = find_attractor(orbit_equations, start_unknown)
        if not any(
            attractor.orbit
            and earlier_attractor.orbit
            and is_same_orbit_in_phase(attractor.orbit, earlier_attractor.orbit)
            for earlier_attractor in distinct_attractors
        ):
            distinct_attractors.append(attractor)
    return tuple(distinct_attractors)


def attractor_from_rest(solution: PeriodicSolution) -> Attractor | None:
    """Follow the exact motion from rest under the solution's load (collective).

    The result shows where the motion settles: perhaps to the solution, perhaps to another orbit.
    The motion is followed until it settles. The limit is the number of periods for a quarter of an
    orbit search's work (:class:`SearchOptions`), but at least 60 periods. Without an exact flow, or
    with more than 120 modes, the result is None.
    """
    flow = solution.assessment.flow
    if flow is None or flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return None
    orbit_equations = FlowOrbitEquations(
        flow, solution.omega, solution.assessment.states_at_period_parts[0]
    )
    return find_attractor(
        orbit_equations, np.zeros(flow.state_size), SearchOptions.max_periods(flow)
    )


def stability_of(assessment: Assessment) -> Stability:
    """Return the stability of a solution by its nearest exact orbit.

    ``assessment`` compares the solution with exact motions. The verdict is "undecided", with a
    reason, in two cases: no orbit is accepted for the solution, or the largest modulus of the
    orbit's Floquet multipliers differs from 1 by at most 1e-6. If no orbit is found, the verdict is
    "irregular" if a small disturbance of the exact motion grows.
    """
    orbit, irregular_attractor = assessment.nearest_orbit, assessment.irregular_attractor
    if orbit is None:
        assert assessment.flow is not None
        multipliers = np.full(assessment.flow.state_size, np.nan + 0j)
        if irregular_attractor is not None:
            multipliers[0] = irregular_attractor.growth
            return Stability(
                multipliers,
                "irregular",
                np.nan,
                reason="no orbit was found, and the exact motion "
                f"{irregular_attractor.description}",
            )
        if (
            assessment.orbit_prediction_by_newton_step is not None
            and assessment.flow.n_modes <= MAX_MODES_FOR_MONODROMY
        ):
            multipliers = eigenvalues(assessment.orbit_prediction_by_newton_step.monodromy)
        return Stability(multipliers, "undecided", np.nan, reason=assessment.rejection_reason)
    undecided_reason, largest_modulus = assessment.rejection_reason, abs(orbit.multipliers[0])
    if not undecided_reason and abs(largest_modulus - 1.0) <= MULTIPLIER_TOLERANCE:
        undecided_reason = NEUTRAL_MULTIPLIER_TEXT
    stability_verdict = (
        "undecided" if undecided_reason else "stable" if largest_modulus < 1.0 else "unstable"
    )
    return Stability(
        orbit.multipliers,
        stability_verdict,
        MULTIPLIER_TOLERANCE,
        True,
        assessment.relative_orbit_distance,
        undecided_reason,
    )


def _stability_by_linear_flow(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw
) -> Stability:
    """Return the stability of a solution by the multipliers of its linear flow.

    The linear flow describes small disturbances, with contact linearised along the solution. Used
    for smooth laws without an exact flow. The largest modulus of the multipliers decides; the
    uncertainty is the change with twice the harmonics. The verdict is "undecided" if the modulus is
    1 within this uncertainty, or if the solution's truncation error is unknown or above 0.05.

    Parameters
    ----------
    structure : Structure
        The solution's structure.
    solution : PeriodicSolution
        Harmonic-balance solution.
    contact : ContactLaw
        Law for all pairs.
    """
    gap_coefficients = solution.gap_series_without_static_part
    static_cutoff = solution.static_above
    multiplier_uncertainty = np.inf
    try:
        multipliers = eigenvalues(
            monodromy_of_linear_flow(
                structure, contact, gap_coefficients, solution.base_omega, static_cutoff
            )
        )
        assessed_solution = replace(solution, structure=structure, contact=contact)
        solution_with_twice_harmonics = (
            wave_with_twice_the_harmonics(assessed_solution) if gap_coefficients.size else solution
        )
        if solution_with_twice_harmonics is not None:
            finer_gap_coefficients = solution_with_twice_harmonics.gap_series_without_static_part
            monodromy_with_twice_harmonics = monodromy_of_linear_flow(
                structure, contact, finer_gap_coefficients, solution.base_omega, static_cutoff
            )
            multiplier_uncertainty = float(
                abs(abs(eigenvalues(monodromy_with_twice_harmonics)[0]) - abs(multipliers[0]))
            )
    except ConvergenceError as error:
        nan_multipliers = np.full(2 * len(all_modes(structure).squares), np.nan + 0j)
        return Stability(nan_multipliers, "undecided", np.nan, reason=str(error))
    largest_modulus, solution_error, undecided_reason = (
        abs(multipliers[0]),
        solution.report.truncation,
        "",
    )
    if solution_error >= ERROR_IF_UNKNOWN or not np.isfinite(multiplier_uncertainty):
        undecided_reason = "the error of the solution is unknown; use more harmonics"
    elif solution_error > LARGE_ERROR:
        undecided_reason = (
            f"the truncated harmonics change the solution by {format_percent(solution_error)}; "
            "use more harmonics"
        )
    elif abs(largest_modulus - 1.0) <= max(MULTIPLIER_TOLERANCE, multiplier_uncertainty):
        undecided_reason = NEUTRAL_MULTIPLIER_TEXT
    stability_verdict = (
        "undecided" if undecided_reason else "stable" if largest_modulus < 1.0 else "unstable"
    )
    return Stability(
        multipliers, stability_verdict, multiplier_uncertainty, reason=undecided_reason
    )
