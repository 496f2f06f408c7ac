"""Key figures of a scene: frequencies, static responses and amplitudes without a full solution.

The figures follow from one factorization of the stiffness matrix K and few modes. With the crack
open, the displacement under the load f at the frequency w is

    u(w) = H(w) f = K^-1 f + sum_j phi_j (phi_j^T f) [d_j(w) - 1 / w_j^2],
    d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w),

with the shape phi_j, frequency w_j and damping ratio xi_j of mode j. The gaps are B^T u, with the
gap matrix B. The compliance of the crack faces is R(w) = B^T H(w) B. A static contact problem says
which pairs the mean load and the preload close. As long as these pairs stay closed and all others
open, the motion is linear. The closed pairs then carry the force R(w)^-1 B^T u(w) in addition to
the static force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import Factor
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    count_damped_modes,
    count_modes_below,
    find_bonded_mode_indices,
    multiply_columns,
    solve_bonded_modes,
    solve_modes_with_factor,
)
from fenics_crack.model.receptance import ResidualFlexibility, receptance
from fenics_crack.model.structure import ModalDamping, RayleighDamping, Structure
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.result_tables import Curve
from fenics_crack.scene.scene import Scene
from fenics_crack.study.prepare import Study, modal_reduction_or_none
from fenics_crack.study.resonance import (
    FACTOR_AND_UNIT_BY_CURVE_PARAMETER,
    N_RESONANCE_SEARCH_MODES,
    UNSOUGHT_RESONANCE,
    ResonanceUnderLoad,
    curve_parameter_at_crossing,
)

N_KEY_FIGURE_MODES = 4
"""Number of lowest modes among a scene's key figures."""


@dataclass(frozen=True)
class PreSolutionKeyFigures:
    """Key figures of a scene's structure, by which ``check`` finds unusual values.

    Attributes
    ----------
    mesh_extents : (d,) [m]
        Width, height and, for a solid, thickness of the mesh.
    n_elements_along_face : int or None
        Number of elements along a crack face, for the crack with the fewest; None without a crack.
    omega_open, omega_tied : (at most 4,) [rad/s]
        Lowest natural frequencies with open and with bonded crack. If the bonded structure has
        fewer modes, its missing frequencies are inf.
    omega_bilinear : (at most 4,) [rad/s]
        Bilinear frequencies of the open modes.
    damping_ratios : (at most 4,)
        Ratios of critical damping of the open modes.
    squared_omega_slopes : (at most 4,)
        S = d(w^2) / d(W^2) of the open modes with frequency w, over the rotor speed W; 0 without
        rotation.
    face_stiffness_at_pairs : (n_pairs,) [N/m]
        Static stiffness of the crack faces at each pair j, 1 / (B^T K^-1 B)_jj. B is the gap matrix
        and K the stiffness matrix.
    contact_stiffness_ratio : (n_pairs,) or None
        Contact stiffness over ``face_stiffness_at_pairs``; None without a law, or for rigid
        contact.
    opening_under_mean_load : float [m]
        Largest static opening of an open crack under the mean load.
    largest_static_gap_motion : float [m]
        Largest static amplitude of an open crack's gaps under the load's harmonics, added up.
    peak_open_crack_displacement, peak_open_crack_gap_motion : float [m]
        Largest amplitudes of the watched displacements and of the gaps. The crack is open, and the
        maximum is over the load frequencies that the scene requests.
    peak_open_rotation_about_clamp : float [rad]
        Largest amplitude of a watched displacement over its distance from the clamp.
    n_pairs_closed_by_mean_load : int
        Number of pairs that are closed under the mean load and the preload alone.
    breathes : bool
        True if a pair opens or closes at the requested frequencies.
    n_modes_below_highest_harmonic : int
        Number of natural frequencies below the frequency of the highest harmonic; 0 without pairs.
    n_kept_modes : int
        Number of modes after the reduction.
    load_resonance : ResonanceUnderLoad
        Resonance under the scene's load, if it has been sought.
    """

    mesh_extents: tuple[float, ...]
    n_elements_along_face: int | None
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_bilinear: np.ndarray
    damping_ratios: np.ndarray
    squared_omega_slopes: np.ndarray
    face_stiffness_at_pairs: np.ndarray
    contact_stiffness_ratio: np.ndarray | None
    opening_under_mean_load: float
    largest_static_gap_motion: float
    peak_open_crack_displacement: float
    peak_open_rotation_about_clamp: float
    peak_open_crack_gap_motion: float
    n_pairs_closed_by_mean_load: int
    breathes: bool
    n_modes_below_highest_harmonic: int
    n_kept_modes: int
    load_resonance: ResonanceUnderLoad = UNSOUGHT_RESONANCE


def find_key_figures(study: Study) -> PreSolutionKeyFigures:
    """Compute natural frequencies, static responses and amplitudes for remarks (collective).

    The remarks warn of unusual values before a scene is solved
    (:mod:`fenics_crack.study.plausibility`). So the computation must be fast: it solves linear
    equations, and a single nonlinear problem, to find the pairs that the mean load closes. A
    reduced study is not expanded, since its static responses are exact.
    """
    scene, law = study.scene, study.contact
    structure = study.structure.structure_in_few_coordinates()
    reduction = modal_reduction_or_none(scene, structure)
    is_search_structure_reduced = (
        law is not None
        and reduction is not None
        and scene.disk is None
        and scene.excitation.order is None
    )
    search_modes, modes, bonded_modes, static_displacements, face_compliance = (
        _solve_modes_and_static_responses(structure, is_search_structure_reduced)
    )
    modal_damping_ratios = list_modal_damping_ratios(structure, modes.omega)
    bilinear_frequencies = BilinearFrequencies(
        modes.omega, bonded_modes.omega[find_bonded_mode_indices(modes, bonded_modes)]
    )
    static_gaps = structure.apply_bt(static_displacements)
    modal_gaps = structure.apply_bt(modes.shapes.T)
    modal_loads = structure.sum_over_ranks(structure.force @ modes.shapes)
    static_complex_amplitudes = [
        to_complex(fourier_rows)[1:]
        for fourier_rows in (static_displacements, static_gaps, modal_loads)
    ]
    mean_load_gaps = static_gaps[0] - structure.clearance  # of an open crack
    pressing_forces = (
        solve_complementarity(face_compliance, mean_load_gaps) if structure.n_pairs else np.zeros(0)
    )
    is_closed = pressing_forces > 0.0
    watched_dofs = [watched_displacement.dof for watched_displacement in study.watched]
    watched_distances_from_clamp = distances_from_clamp(structure.whole, watched_dofs)
    peak_displacement, peak_rotation, peak_gap_motion, breathes = 0.0, 0.0, 0.0, False
    for omega in _list_requested_omegas(scene, np.concatenate([modes.omega, bonded_modes.omega])):
        (
            watched_amplitudes, open_crack_gap_amplitudes, closed_pairs_gap_amplitudes,
            contact_force_amplitudes,
        ) = _amplitude_bounds(
            structure, modes, modal_damping_ratios, static_complex_amplitudes, face_compliance,
            modal_gaps, is_closed, watched_dofs, omega,
        )  # fmt: skip
        peak_displacement = max(peak_displacement, float(watched_amplitudes.max(initial=0.0)))
        rotation_amplitudes_about_clamp = watched_amplitudes / watched_distances_from_clamp
        peak_rotation = max(peak_rotation, float(rotation_amplitudes_about_clamp.max(initial=0.0)))
        peak_gap_motion = max(peak_gap_motion, float(open_crack_gap_amplitudes.max(initial=0.0)))
        can_open_pair_close = (
            mean_load_gaps - face_compliance @ pressing_forces + closed_pairs_gap_amplitudes >= 0.0
        )
        breathes |= bool(
            np.any(
                np.where(
                    is_closed, pressing_forces <= contact_force_amplitudes, can_open_pair_close
                )
            )
        )
    structural_stiffness_at_pairs = 1.0 / np.maximum(np.diagonal(face_compliance), 1e-300)
    contact_law_stiffness = (
        None if law is None or not np.all(np.isfinite(law.stiffness)) else law.stiffness
    )
    return PreSolutionKeyFigures(
        mesh_extents=mesh_extents(structure.whole),
        n_elements_along_face=_count_elements_along_face(scene, structure),
        omega_open=modes.omega, omega_tied=bonded_modes.omega,
        omega_bilinear=bilinear_frequencies.omega_bilinear,
        damping_ratios=modal_damping_ratios,
        squared_omega_slopes=_squared_omega_slopes_over_speed(modes),
        face_stiffness_at_pairs=structural_stiffness_at_pairs,
        contact_stiffness_ratio=None if contact_law_stiffness is None
        else contact_law_stiffness / structural_stiffness_at_pairs,
        opening_under_mean_load=float(np.max(-mean_load_gaps, initial=0.0)) + 0.0,
        largest_static_gap_motion=float(
            np.abs(static_complex_amplitudes[1]).sum(axis=0).max(initial=0.0)
        ),
        peak_open_crack_displacement=peak_displacement,
        peak_open_rotation_about_clamp=peak_rotation,
        peak_open_crack_gap_motion=peak_gap_motion,
        n_pairs_closed_by_mean_load=int(is_closed.sum()),
        breathes=breathes,
        n_modes_below_highest_harmonic=_count_modes_below(
            structure, search_modes, highest_harmonic_omega(scene)
        ) if structure.n_pairs else 0,
        n_kept_modes=structure.n_dofs if reduction is None else reduction.n_modes,
    )  # fmt: skip


def _solve_modes_and_static_responses(
    structure: Structure, is_search_structure_reduced: bool
) -> tuple[Modes, Modes, Modes, np.ndarray, np.ndarray]:
    """Find modes and static responses with one factor of the stiffness (collective).

    If ``is_search_structure_reduced``, the same factor serves to compute the structure's
    receptance, with which the search of the resonance under the load begins.

    Returns
    -------
    search_modes : Modes
        Lowest 10 modes with open crack (:data:`N_RESONANCE_SEARCH_MODES`), or all if there are
        fewer.
    modes, bonded_modes : Modes
        At most 4 modes with open and with bonded crack, for the key figures.
    static_displacements : (2N+1, n_local) [m]
        Static responses to the load's mean, and to the cosine and sine parts of N load harmonics,
        in the n_local coordinates on this rank.
    face_compliance : (n_pairs, n_pairs) [m/N]
        Static gap at each pair under a unit force on each pair, with open crack: B^T K^-1 B, with
        the gap matrix B and the stiffness matrix K.
    """
    known_omega_and_shapes = structure.known_omega_and_shapes(is_bonded=False)
    n_available_modes = (
        structure.n_dofs if known_omega_and_shapes is None else len(known_omega_and_shapes[0])
    )
    n_modes = min(N_KEY_FIGURE_MODES, n_available_modes)
    n_search_modes = min(N_RESONANCE_SEARCH_MODES, n_available_modes)
    with Factor(structure.stiffness, definite=True) as stiffness_factor:
        search_modes = solve_modes_with_factor(stiffness_factor, structure, n_search_modes)
        if is_search_structure_reduced and structure.whole is structure:
            receptance(structure, n_search_modes, stiffness_factor)
        modes = Modes(search_modes.omega[:n_modes], search_modes.shapes[:, :n_modes], structure)
        static_displacements = _static_displacements(stiffness_factor, modes, structure.force)
        face_compliance = structure.apply_bt(
            _static_displacements(stiffness_factor, modes, structure.gap.T.toarray())
        )
        bonded_modes = (
            solve_bonded_modes(structure, n_modes, stiffness_factor) if structure.n_pairs else modes
        )
    return search_modes, modes, bonded_modes, static_displacements, face_compliance


def _amplitude_bounds(
    structure: Structure,
    modes: Modes,
    modal_damping_ratios: np.ndarray,
    static_complex_amplitudes: Sequence[np.ndarray],
    face_compliance: np.ndarray,
    modal_gaps: np.ndarray,
    is_closed: np.ndarray,
    watched_dofs: Sequence[int],
    load_omega: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return upper bounds of amplitudes at a load frequency (collective).

    A bound is the sum of the amplitudes of all N load harmonics. The response is linear: pairs stay
    open or closed.

    Parameters
    ----------
    structure, modes : Structure, Modes
        Structure, and its modes with open crack.
    modal_damping_ratios : (n_modes,)
        Ratios of critical damping.
    static_complex_amplitudes : three arrays of complex
        Static responses to the load harmonics 1 to N: displacements (N, n_local) [m] in the n_local
        coordinates on this rank; gaps (N, n_pairs) [m]; and modal loads (N, n_modes).
    face_compliance : (n_pairs, n_pairs) [m/N]
        Static gaps under unit forces at the pairs, with open crack.
    modal_gaps : (n_modes, n_pairs)
        Gaps of the mode shapes.
    is_closed : (n_pairs,) of bool
        True for pairs that the mean load closes.
    watched_dofs : sequence of int
        Dofs of the watched displacements.
    load_omega : float [rad/s]
        Load frequency.

    Returns
    -------
    watched_amplitudes : (n_watched,) [m]
        Watched displacements with open crack.
    open_crack_gap_amplitudes : (n_pairs,) [m]
        Gaps with all pairs open.
    closed_pairs_gap_amplitudes : (n_pairs,) [m]
        Gaps while the pairs in ``is_closed`` stay closed.
    contact_force_amplitudes : (n_pairs,) [N]
        Contact forces while the pairs in ``is_closed`` stay closed.

    Under a steady load (N = 0) each output is a single zero, (1,).
    """
    (
        watched_amplitudes,
        open_crack_gap_amplitudes,
        closed_pairs_gap_amplitudes,
        contact_force_amplitudes,
    ) = np.zeros((4, 1))
    for harmonic, (static_displacement, static_gap, modal_load) in enumerate(
        zip(*static_complex_amplitudes, strict=True), 1
    ):
        modal_receptances_minus_static = _modal_receptances_minus_static(
            modes.omega, modal_damping_ratios, harmonic * load_omega
        )
        modal_amplitudes_minus_static = modal_receptances_minus_static * modal_load
        displacement_amplitude = (
            static_displacement + modal_amplitudes_minus_static @ modes.shapes.T
        )
        real_and_imaginary_parts = structure.values_at(
            np.stack([displacement_amplitude.real, displacement_amplitude.imag]), watched_dofs
        )
        watched_amplitudes = watched_amplitudes + np.hypot(*real_and_imaginary_parts)
        complex_gap_amplitudes = static_gap + modal_amplitudes_minus_static @ modal_gaps
        dynamic_face_compliance = (
            face_compliance + (modal_gaps.T * modal_receptances_minus_static) @ modal_gaps
        )
        complex_contact_force_amplitudes = np.zeros(structure.n_pairs, dtype=complex)
        compliance_between_closed_pairs = dynamic_face_compliance[np.ix_(is_closed, is_closed)]
        complex_contact_force_amplitudes[is_closed] = np.linalg.lstsq(
            compliance_between_closed_pairs, complex_gap_amplitudes[is_closed], rcond=None
        )[0]
        open_crack_gap_amplitudes = open_crack_gap_amplitudes + np.abs(complex_gap_amplitudes)
        contact_force_amplitudes = contact_force_amplitudes + np.abs(
            complex_contact_force_amplitudes
        )
        closed_pairs_gap_amplitudes = closed_pairs_gap_amplitudes + np.abs(
            complex_gap_amplitudes - dynamic_face_compliance @ complex_contact_force_amplitudes
        )
    return (
        watched_amplitudes,
        open_crack_gap_amplitudes,
        closed_pairs_gap_amplitudes,
        contact_force_amplitudes,
    )


def _count_modes_below(structure: Structure, modes: Modes, omega: float) -> int:
    """Return the number of natural frequencies below ``omega`` [rad/s] (collective).

    ``modes`` are the lowest modes. If all lie below ``omega``, there may be more. Then a
    factorization of K - omega^2 M counts them, with stiffness K and mass M.
    """
    if omega < modes.omega[-1]:
        return int(np.sum(modes.omega < omega))
    return count_modes_below(structure, omega**2)


def _static_displacements(stiffness_factor: Factor, modes: Modes, forces: np.ndarray) -> np.ndarray:
    """Return static displacements under forces: (m, n_local) [m] (collective).

    If the structure has rigid-body motions, it accelerates under the forces. Then the deformation
    alone is returned, without the rigid-body motion.

    Parameters
    ----------
    stiffness_factor : Factor
        Factor of the stiffness.
    modes : Modes
        Modes with open crack, rigid-body motions first.
    forces : (m, n_local) [N]
        Forces of m load cases, on the n_local coordinates of this rank.
    """
    structure, rigid_body_shapes = modes.structure, modes.shapes[:, modes.omega == 0.0]
    residual_flexibility = ResidualFlexibility(
        structure, rigid_body_shapes, np.zeros(rigid_body_shapes.shape[1]), structure.gap
    )
    return (
        residual_flexibility.solve(stiffness_factor, forces)
        if rigid_body_shapes.size
        else stiffness_factor.solve(forces)
    )


def _squared_omega_slopes_over_speed(modes: Modes) -> np.ndarray:
    """Return slopes of squared natural frequencies over the squared rotor speed: (n_modes,).

    S = d(w^2) / d(W^2) for the natural frequency w and the rotor speed W; 0 without rotation.
    S = phi^T (K_1 + K_2 + 2 W^2 K_3) phi with the mass-normalised shape phi. The matrices K_i are
    terms of the stiffness due to rotation.
    """
    structure, slopes = modes.structure, np.zeros(len(modes.omega))
    rotation = structure.rotation if structure.n_sectors == 1 else structure.whole.rotation
    if rotation is None:
        return slopes
    second_rotation_stiffness, third_rotation_stiffness = rotation.displaced_shape_stiffness_terms
    for mode_index, mode_shape in enumerate(modes.shapes.T):
        sector_shapes = np.vstack(list(structure.iterate_sector_displacements(mode_shape[None]))).T
        stiffness_products = (
            multiply_columns(rotation.rotation_stiffness, sector_shapes)
            + multiply_columns(second_rotation_stiffness, sector_shapes)
            + 2.0 * rotation.speed**2 * multiply_columns(third_rotation_stiffness, sector_shapes)
        )
        slopes[mode_index] = structure.sum_over_ranks((sector_shapes * stiffness_products).sum())
    return slopes


def _count_elements_along_face(scene: Scene, structure: Structure) -> int | None:
    """Return the number of elements along the crack with fewest contact pairs.

    The number of pairs is divided by the order of the elements. The result is rounded up, because
    the node at a tip is no pair. Contact patches count as elements. None without pairs.
    """
    if not structure.n_pairs:
        return None
    crack_index_of_pairs = structure.pairs.cracks
    n_pairs_of_smallest_crack = (
        structure.n_pairs
        if crack_index_of_pairs is None
        else int(np.bincount(crack_index_of_pairs).min())
    )
    return math.ceil(
        n_pairs_of_smallest_crack
        / (1 if scene.mesh is None or scene.mesh.patches else scene.mesh.order)
    )


def mesh_extents(whole_structure: Structure) -> tuple[float, ...]:
    """Return the lengths of a mesh along x, y (and z) [m] (collective).

    Given matrices have no nodes: then (nan, nan) is returned.
    """
    if whole_structure.nodes is None:
        return np.nan, np.nan
    return tuple(
        np.ptp(gather_rows(whole_structure.comm, whole_structure.nodes.points), axis=0).tolist()
    )


def distances_from_clamp(whole_structure: Structure, dofs: Sequence[int]) -> np.ndarray:
    """Return distances from dofs' nodes to the clamp: (n_dofs,) [m] (collective).

    A distance is at most the mesh's longest side. Given matrices have no nodes: then all are inf.
    """
    if whole_structure.nodes is None:
        return np.full(len(dofs), np.inf)
    points, node_dofs = (
        gather_rows(whole_structure.comm, local_points_or_dofs)
        for local_points_or_dofs in (whole_structure.nodes.points, whole_structure.nodes.dofs)
    )
    clamp_points, longest_side = points[np.all(node_dofs < 0, axis=1)], np.ptp(points, axis=0).max()
    offsets_of_dofs = [
        clamp_points[:, None] - points[np.any(node_dofs == dof, axis=1)] for dof in dofs
    ]
    return np.array(
        [np.linalg.norm(offsets, axis=2).min(initial=longest_side) for offsets in offsets_of_dofs]
    )


def list_modal_damping_ratios(whole_structure: Structure, natural_omegas: np.ndarray) -> np.ndarray:
    """Return the modes' ratios of critical damping: (n,).

    Modes without damping, and all modes of a structure with a damping matrix, have 0.

    Parameters
    ----------
    whole_structure : Structure
        Whole structure with the damping rule.
    natural_omegas : (n,) [rad/s]
        Frequencies of the n lowest modes.
    """
    damping_rule = whole_structure.damping
    if isinstance(damping_rule, RayleighDamping):
        return np.divide(
            damping_rule.rate(natural_omegas**2),
            2.0 * natural_omegas,
            out=np.zeros_like(natural_omegas),
            where=natural_omegas > 0.0,
        )
    modal_damping_ratios = np.zeros(len(natural_omegas))
    if isinstance(damping_rule, ModalDamping):
        n_damped_modes = min(count_damped_modes(whole_structure), len(natural_omegas))
        given_ratio = np.asarray(damping_rule.ratio)
        modal_damping_ratios[:n_damped_modes] = (
            given_ratio if given_ratio.ndim == 0 else given_ratio[:n_damped_modes]
        )
        modal_damping_ratios[:n_damped_modes] += (
            0.5 * damping_rule.stiffness * natural_omegas[:n_damped_modes]
        )
    return modal_damping_ratios


def _modal_receptances_minus_static(
    natural_omegas: np.ndarray, modal_damping_ratios: np.ndarray, omega: float
) -> np.ndarray:
    """Return d_j(w) - 1 / w_j^2 of modes j: complex (n,) [s^2].

        d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w)

    is the receptance of a mode with frequency w_j and damping ratio xi_j, at the load frequency w
    (``omega``). 1 / w_j^2 is its static value. The difference is added to static responses, in
    which the static part of all modes is contained already. Rigid-body modes are not contained: for
    them d_j(w) is returned.
    """
    squared_omegas = natural_omegas**2
    denominators = squared_omegas - omega**2 + 2j * modal_damping_ratios * natural_omegas * omega
    static_receptances_of_modes = np.divide(
        1.0, squared_omegas, out=np.zeros_like(squared_omegas), where=squared_omegas > 0.0
    )
    return (
        1.0 / np.where(denominators == 0.0, 1e-12 * squared_omegas, denominators)
        - static_receptances_of_modes
    )


# --- the frequencies that a scene requests --------------------------------------------------------


def _list_requested_omegas(scene: Scene, natural_omegas: np.ndarray) -> list[float]:
    """Return the load frequencies that a scene asks for [rad/s], ascending.

    These are the frequency in ``[excitation]`` and the ends of the range of curve and sweep. All
    ``natural_omegas`` within a range are added.
    """
    omegas = {scene.excitation.omega}
    for lowest_load_omega, highest_load_omega in (
        lowest_and_highest_load_omega(scene, "curve"),
        lowest_and_highest_load_omega(scene, "sweep"),
    ):
        omegas |= {
            lowest_load_omega,
            highest_load_omega,
            *(
                float(omega)
                for omega in natural_omegas
                if lowest_load_omega <= omega <= highest_load_omega
            ),
        }
    return sorted(omegas)


def lowest_and_highest_load_omega(scene: Scene, command: str) -> tuple[float, float]:
    """Return lowest and highest load frequency in a command [rad/s].

    ``command`` is "solve", "curve" or "sweep".
    """
    omegas = [scene.excitation.omega]
    curve_table = scene.curve if command == "curve" else None
    if curve_table is not None and curve_table.parameter_and_range[0] == "omega":
        omegas = [*curve_table.parameter_and_range[1:]]
    elif curve_table is not None and curve_table.parameter_and_range[0] == "speed":
        omegas = [
            (scene.excitation.order or 1) * speed for speed in curve_table.parameter_and_range[1:]
        ]
    if command == "sweep":
        omegas = [*scene.swept_omegas]
    return min(omegas), max(omegas)


def highest_harmonic_omega(scene: Scene, command: str = "") -> float:
    """Return the frequency of a command's highest harmonic [rad/s].

    This is the highest load frequency times the number of harmonics. ``command`` is "solve",
    "curve" or "sweep"; by default the highest frequency of all three is returned.
    """
    if not command:
        return max(
            highest_harmonic_omega(scene, command_name)
            for command_name in ("solve", "curve", "sweep")
        )
    harmonic_counts = [scene.harmonic_balance.harmonics]
    if command == "sweep":
        harmonic_counts = [
            *scene.swept_values_by_key.get("harmonic_balance.harmonics", harmonic_counts)
        ]
    return lowest_and_highest_load_omega(scene, command)[1] * max(harmonic_counts)


# --- the curve through the resonance --------------------------------------------------------------


def propose_curve_or_none(scene: Scene, key_figures: PreSolutionKeyFigures) -> Curve | None:
    """Propose a table ``[curve]`` through the resonance, or return None.

    The proposed curve extends three half-power widths beyond the resonance under the load, and
    beyond the resonance under a small load. If the resonance is not known, the open and bonded
    frequencies of the mode nearest to the load replace it. Ends are rounded outwards to three
    digits.

    None is returned

    - if the scene's curve already meets the resonance;
    - if its parameter is neither frequency nor rotor speed;
    - if the mode has no damping or no bonded frequency.
    """
    curve_table, load_resonance = scene.curve, key_figures.load_resonance
    is_speed_curve = scene.excitation.order is not None and scene.disk is None
    parameter = "frequency" if scene.is_frequency_in_hertz else "omega"
    if is_speed_curve:
        parameter = "rpm" if scene.is_speed_in_rpm else "speed"
    if curve_table is not None:
        parameter = curve_table.parameter
    if parameter not in FACTOR_AND_UNIT_BY_CURVE_PARAMETER:
        return None
    mode_index = int(np.argmin(np.abs(key_figures.omega_bilinear - scene.excitation.omega)))
    open_omega = float(key_figures.omega_open[mode_index])
    bilinear_omega = float(key_figures.omega_bilinear[mode_index])
    # Three half-power bandwidths from the resonance the response is a sixth of the peak.
    bandwidth_factor = 1.0 + 3.0 * 2.0 * float(key_figures.damping_ratios[mode_index])
    if not (open_omega > 0.0 and bilinear_omega < 2.0 * open_omega and bandwidth_factor > 1.0):
        return None
    bonded_omega = 1.0 / (2.0 / bilinear_omega - 1.0 / open_omega)  # of the same mode
    squared_omega_slope_over_speed = key_figures.squared_omega_slopes[mode_index]
    parameter_at_lowest_resonance, parameter_at_highest_resonance, start, stop = (
        curve_parameter_at_crossing(scene, parameter, omega, squared_omega_slope_over_speed)
        for omega in (
            open_omega,
            bonded_omega,
            open_omega / bandwidth_factor,
            bonded_omega * bandwidth_factor,
        )
    )
    if not load_resonance.unknown and is_speed_curve == (parameter in ("speed", "rpm")):
        parameter_at_lowest_resonance = parameter_at_highest_resonance = load_resonance.value
        start = (
            min(parameter_at_lowest_resonance, load_resonance.omega_or_speed_under_small_load)
            - 3.0 * load_resonance.width
        )
        stop = (
            max(parameter_at_highest_resonance, load_resonance.omega_or_speed_under_small_load)
            + 3.0 * load_resonance.width
        )
    has_resonance_in_scene_curve = (
        curve_table is not None
        and min(curve_table.parameter_and_range[1:]) <= parameter_at_highest_resonance
        and max(curve_table.parameter_and_range[1:]) >= parameter_at_lowest_resonance
    )
    if has_resonance_in_scene_curve or not 0.0 < start < stop < math.inf:
        return None
    unit_factor = FACTOR_AND_UNIT_BY_CURVE_PARAMETER[parameter][0]
    return Curve(
        _round_to_three_digits(start / unit_factor, math.floor),
        _round_to_three_digits(stop / unit_factor, math.ceil),
        parameter,
    )


def _round_to_three_digits(value: float, round_function: Callable[[float], int]) -> float:
    """Round a positive value to three significant digits, by ``math.floor`` or ``math.ceil``."""
    digit_factor = 10.0 ** (2 - math.floor(math.log10(value)))
    return round_function(value * digit_factor) / digit_factor


def is_response_proportional_to_load(scene: Scene) -> bool:
    """Return True if the response is proportional to the load.

    This is so if the equations still hold after all forces and displacements are multiplied by a
    positive number. Contact must begin at the gap g = 0, without smoothing or a soft layer, and
    without clearance. Nothing may rotate, since the centrifugal load stays unchanged.
    """
    contact_table = scene.contact
    if contact_table is not None and (
        not contact_table.has_force_only_when_closed or contact_table.layer_depth is not None
    ):
        return False
    if scene.speed > 0.0:
        return False
    tables_with_clearance = (
        scene.crack_by_name.values() if scene.structure is None else (scene.structure,)
    )
    return all(table.clearance == 0.0 for table in tables_with_clearance)
