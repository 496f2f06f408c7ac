"""Plausibility of a scene: key figures, and remarks on unusual values.

The figures follow from one factor of K and few modes, without a nonlinear solution. With the crack
open, K^-1 and the lowest modes give the displacement at a frequency w,

    u(w) = K^-1 f + sum_j phi_j (phi_j^T f) [d_j(w) - 1 / w_j^2],
    d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w),

and the gaps B^T u. With B instead of f it is the compliance of the crack faces R(w) = B^T H(w) B.
A static contact problem says which pairs the mean load and the preload close. As long as these
pairs stay closed and the others open, the motion is linear. The closed pairs then carry
R(w)^-1 B^T u(w) beside their static force.

Remarks follow from tables of rules: a key, a number, and the range in which the number is usual. A
remark forbids nothing; most often a unit or a number is mistyped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    RAD_PER_TURN,
    choose_frequency_factor_name_unit,
    format_in_unit,
)
from fenics_crack.fem.cracks import RELATIVE_POSITION_TOLERANCE
from fenics_crack.fem.setting import read_load_coefficients_and_residual
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
    solve_modes,
    solve_modes_with_factor,
)
from fenics_crack.model.nodes import format_point
from fenics_crack.model.receptance import ResidualFlexibility
from fenics_crack.model.rotation import relative_coriolis_shifts
from fenics_crack.model.structure import ModalDamping, RayleighDamping, Structure
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Curve
from fenics_crack.scene.words import word_for_crack_faces
from fenics_crack.study.prepare import Study, modal_reduction_or_none
from fenics_crack.study.resonance import (
    N_SEARCH_MODES,
    UNSOUGHT_RESONANCE,
    LoadResonance,
    order_crossing_speed,
)

N_KEY_FIGURE_MODES = 4
"""Number of lowest modes among a scene's key figures."""
MAX_SMALL_ROTATION = 0.1
"""Maximum rotation [rad], displacement over length, for small displacements. Linear theory neglects
terms of about its square, 1 %."""


@dataclass(frozen=True)
class KeyFigures:
    """Key figures of a scene's unreduced structure, by which ``check`` finds unusual values.

    Attributes
    ----------
    mesh_extents : (d,) [m]
        Width, height and, for a solid, thickness of the mesh.
    n_face_elements : int or None
        Number of elements along each face of the crack with the fewest; None without a crack.
    omega_open, omega_tied : (at most 4,) [rad/s]
        Lowest natural frequencies with open and with bonded crack; the latter are infinite if the
        bonded structure has fewer modes.
    omega_bilinear : (at most 4,) [rad/s]
        Bilinear frequencies of the open modes.
    damping_ratios : (at most 4,)
        Ratios of critical damping of the open modes.
    squared_omega_slopes : (at most 4,)
        S = d(w^2) / d(W^2) of the open modes with frequency w, over the rotor speed W; 0 without
        rotation.
    face_stiffness : (n_pairs,) [N/m]
        Static stiffness of the crack faces at each pair, 1 / (B^T K^-1 B)_jj.
    contact_stiffness_ratio : (n_pairs,) or None
        Contact stiffness over ``face_stiffness``; None without a law, or for rigid contact.
    opening_under_mean_load, largest_static_gap_motion : float [m]
        Largest static opening of an open crack under the mean load, and largest static motion of
        its gaps under the load's amplitude.
    peak_displacement, peak_gap_motion : float [m]
        Largest amplitudes of the watched displacements and of the gaps, with an open crack at the
        requested frequencies.
    peak_rotation : float [rad]
        Largest amplitude of a watched displacement over its distance from the clamp.
    n_closed_pairs : int
        Number of pairs that are closed under the mean load and the preload alone.
    breathes : bool
        True if one of these pairs opens, or another pair closes, at the requested frequencies.
    n_modes_below_highest_harmonic : int
        Number of natural frequencies below the frequency of the highest harmonic; 0 without pairs.
    n_kept_modes : int
        Number of modes after the reduction.
    load_resonance : LoadResonance
        Resonance at the scene's own load, if it has been sought.
    """

    mesh_extents: tuple[float, ...]
    n_face_elements: int | None
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_bilinear: np.ndarray
    damping_ratios: np.ndarray
    squared_omega_slopes: np.ndarray
    face_stiffness: np.ndarray
    contact_stiffness_ratio: np.ndarray | None
    opening_under_mean_load: float
    largest_static_gap_motion: float
    peak_displacement: float
    peak_rotation: float
    peak_gap_motion: float
    n_closed_pairs: int
    breathes: bool
    n_modes_below_highest_harmonic: int
    n_kept_modes: int
    load_resonance: LoadResonance = UNSOUGHT_RESONANCE


def find_key_figures(study: Study) -> KeyFigures:
    """Compute natural frequencies, static responses and amplitudes for remarks (collective).

    No nonlinear equations are solved. A reduced study is evaluated in its own coordinates, in which
    static responses are exact.
    """
    scene, law = study.scene, study.contact
    structure = study.structure.structure_in_few_coordinates()
    search_modes, modes, bonded_modes, static_displacements, face_compliance = (
        _solve_modes_and_static_responses(structure)
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
    clamp_distances = distances_from_clamp(structure.whole, watched_dofs)
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
        rotation_amplitudes = watched_amplitudes / clamp_distances
        peak_rotation = max(peak_rotation, float(rotation_amplitudes.max(initial=0.0)))
        if structure.n_pairs:
            peak_gap_motion = max(peak_gap_motion, float(open_crack_gap_amplitudes.max()))
            is_closing = (
                mean_load_gaps - face_compliance @ pressing_forces + closed_pairs_gap_amplitudes
                >= 0.0
            )
            breathes = breathes or bool(
                np.any(np.where(is_closed, pressing_forces <= contact_force_amplitudes, is_closing))
            )
    face_stiffness = 1.0 / np.maximum(np.diagonal(face_compliance), 1e-300)
    pair_stiffness = (
        None if law is None or not np.all(np.isfinite(law.stiffness)) else law.stiffness
    )
    reduction = modal_reduction_or_none(scene, structure)
    return KeyFigures(
        mesh_extents=mesh_extents(structure.whole),
        n_face_elements=_count_elements_along_face(scene, structure),
        omega_open=modes.omega, omega_tied=bonded_modes.omega,
        omega_bilinear=bilinear_frequencies.omega_bilinear,
        damping_ratios=modal_damping_ratios, squared_omega_slopes=_slopes_of_squared_omegas(modes),
        face_stiffness=face_stiffness,
        contact_stiffness_ratio=None if pair_stiffness is None else pair_stiffness / face_stiffness,
        opening_under_mean_load=float(np.max(-mean_load_gaps, initial=0.0)) + 0.0,
        largest_static_gap_motion=float(
            np.abs(static_complex_amplitudes[1]).sum(axis=0).max(initial=0.0)
        ),
        peak_displacement=peak_displacement, peak_rotation=peak_rotation,
        peak_gap_motion=peak_gap_motion, n_closed_pairs=int(is_closed.sum()), breathes=breathes,
        n_modes_below_highest_harmonic=_count_modes_below(
            structure, search_modes, highest_harmonic_omega(scene)
        ) if structure.n_pairs else 0,
        n_kept_modes=structure.n_dofs if reduction is None else reduction.n_modes,
    )  # fmt: skip


def _solve_modes_and_static_responses(
    structure: Structure,
) -> tuple[Modes, Modes, Modes, np.ndarray, np.ndarray]:
    """Find modes and static responses with one factor of the stiffness (collective).

    Returns
    -------
    search_modes : Modes
        Lowest modes with open crack: 10 (N_SEARCH_MODES), or all if there are fewer.
    modes, bonded_modes : Modes
        At most 4 modes with open and with bonded crack, for the key figures.
    static_displacements : (2K+1, n_local) [m]
        Static responses to the load's mean, cosine and sine parts.
    face_compliance : (n_pairs, n_pairs) [m/N]
        B^T K^-1 B with the gap matrix B and the stiffness K.
    """
    known_omega_and_shapes = structure.known_omega_and_shapes(is_bonded=False)
    n_available_modes = (
        structure.n_dofs if known_omega_and_shapes is None else len(known_omega_and_shapes[0])
    )
    n_modes = min(N_KEY_FIGURE_MODES, n_available_modes)
    n_search_modes = min(N_SEARCH_MODES, n_available_modes)
    with Factor(structure.stiffness, definite=True) as stiffness_factor:
        search_modes = solve_modes_with_factor(stiffness_factor, structure, n_search_modes)
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
    """Return upper bounds of amplitudes at a load frequency, summed over harmonics (collective).

    Parameters
    ----------
    structure, modes : Structure, Modes
        Structure, and its modes with open crack.
    modal_damping_ratios : (n_modes,)
        Ratios of critical damping.
    static_complex_amplitudes : three arrays of complex
        Static displacements (K, n_local) [m], static gaps (K, n_pairs) [m] and modal loads (K,
        n_modes) of the harmonics 1 to K.
    face_compliance, modal_gaps : (n_pairs, n_pairs) [m/N], (n_modes, n_pairs)
        B^T K^-1 B, and gaps of the mode shapes.
    is_closed : (n_pairs,) of bool
        Pairs that stay closed.
    watched_dofs : sequence of int
        Dofs of the watched displacements.
    load_omega : float [rad/s]
        Load frequency.

    Returns
    -------
    watched_amplitudes : (n_watched,) [m]
        Watched displacements with open crack.
    open_crack_gap_amplitudes : (n_pairs,) [m]
        Gaps with all pairs open. Without pairs (1,), zero, as the arrays below.
    closed_pairs_gap_amplitudes, contact_force_amplitudes : (n_pairs,) [m], [N]
        Gaps and contact forces while the pairs in ``is_closed`` stay closed.
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
        modal_receptance_increase = _modal_receptance_increase(
            modes.omega, modal_damping_ratios, harmonic * load_omega
        )
        modal_amplitudes = modal_receptance_increase * modal_load
        displacement_amplitude = static_displacement + modal_amplitudes @ modes.shapes.T
        real_and_imaginary_parts = structure.values_at(
            np.stack([displacement_amplitude.real, displacement_amplitude.imag]), watched_dofs
        )
        watched_amplitudes = watched_amplitudes + np.hypot(*real_and_imaginary_parts)
        if structure.n_pairs:
            gaps = static_gap + modal_amplitudes @ modal_gaps
            dynamic_compliance = (
                face_compliance + (modal_gaps.T * modal_receptance_increase) @ modal_gaps
            )
            contact_forces = np.zeros(structure.n_pairs, dtype=complex)
            closed_compliance = dynamic_compliance[np.ix_(is_closed, is_closed)]
            contact_forces[is_closed] = np.linalg.lstsq(
                closed_compliance, gaps[is_closed], rcond=None
            )[0]
            open_crack_gap_amplitudes = open_crack_gap_amplitudes + np.abs(gaps)
            contact_force_amplitudes = contact_force_amplitudes + np.abs(contact_forces)
            closed_pairs_gap_amplitudes = closed_pairs_gap_amplitudes + np.abs(
                gaps - dynamic_compliance @ contact_forces
            )
    return (
        watched_amplitudes,
        open_crack_gap_amplitudes,
        closed_pairs_gap_amplitudes,
        contact_force_amplitudes,
    )


def _count_modes_below(structure: Structure, modes: Modes, omega: float) -> int:
    """Return the number of natural frequencies below ``omega`` [rad/s] (collective).

    ``modes`` are the lowest modes. If all of them lie below, a further factor counts all
    frequencies.
    """
    if omega < modes.omega[-1]:
        return int(np.sum(modes.omega < omega))
    return count_modes_below(structure, omega**2)


def _static_displacements(stiffness_factor: Factor, modes: Modes, forces: np.ndarray) -> np.ndarray:
    """Return static displacements under forces: (m, n_local) [m] (collective).

    For a structure with rigid-body motions it is the deformation alone, while the structure
    accelerates.

    Parameters
    ----------
    stiffness_factor : Factor
        Factor of the stiffness.
    modes : Modes
        Modes with open crack, rigid-body motions first.
    forces : (m, n_local) [N]
        m load cases.
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


def _slopes_of_squared_omegas(modes: Modes) -> np.ndarray:
    """Return slopes of squared natural frequencies over the squared rotor speed: (n_modes,).

    S = d(w^2) / d(W^2) = phi^T (K_1 + K_2 + 2 W^2 K_3) phi for the mass-normalised shape phi; 0
    without rotation. The K_i are terms of the stiffness due to rotation.
    """
    structure, slopes = modes.structure, np.zeros(len(modes.omega))
    rotation = structure.rotation if structure.n_sectors == 1 else structure.whole.rotation
    if rotation is None:
        return slopes
    K_2, K_3 = rotation.displaced_shape_stiffness_terms
    for mode_index, mode_shape in enumerate(modes.shapes.T):
        sector_shapes = np.vstack(list(structure.iterate_sector_displacements(mode_shape[None]))).T
        stiffness_products = multiply_columns(
            rotation.rotation_stiffness, sector_shapes
        ) + multiply_columns(K_2, sector_shapes)
        stiffness_products += 2.0 * rotation.speed**2 * multiply_columns(K_3, sector_shapes)
        slopes[mode_index] = structure.sum_over_ranks((sector_shapes * stiffness_products).sum())
    return slopes


def _count_elements_along_face(scene: Scene, structure: Structure) -> int | None:
    """Return the number of elements along the crack with the fewest.

    It is the number of contact pairs over the order of the elements, rounded up because tips are no
    pairs. Patches count as elements. None without pairs.
    """
    if not structure.n_pairs:
        return None
    crack_indices = structure.pairs.cracks
    n_pairs_of_smallest_crack = (
        structure.n_pairs if crack_indices is None else int(np.bincount(crack_indices).min())
    )
    return math.ceil(
        n_pairs_of_smallest_crack
        / (1 if scene.mesh is None or scene.mesh.patches else scene.mesh.order)
    )


def mesh_extents(whole_structure: Structure) -> tuple[float, ...]:
    """Return the lengths of a mesh along x, y (and z) [m] (collective).

    Without nodes (given matrices) it is (nan, nan).
    """
    if whole_structure.nodes is None:
        return np.nan, np.nan
    return tuple(
        np.ptp(gather_rows(whole_structure.comm, whole_structure.nodes.points), axis=0).tolist()
    )


def distances_from_clamp(whole_structure: Structure, dofs: Sequence[int]) -> np.ndarray:
    """Return distances from dofs' nodes to the clamp: (n_dofs,) [m] (collective).

    They are at most the mesh's longest side, and infinite without nodes (given matrices).
    """
    if whole_structure.nodes is None:
        return np.full(len(dofs), np.inf)
    points, node_dofs = (
        gather_rows(whole_structure.comm, local_rows)
        for local_rows in (whole_structure.nodes.points, whole_structure.nodes.dofs)
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
    natural_omegas : (n,) [rad/s]
        Frequencies of the lowest modes.
    """
    damping_rule = whole_structure.damping
    if isinstance(damping_rule, RayleighDamping):
        doubled_omegas = 2.0 * natural_omegas
        return np.divide(
            damping_rule.rate(natural_omegas**2),
            doubled_omegas,
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
    return modal_damping_ratios


def _modal_receptance_increase(
    natural_omegas: np.ndarray, modal_damping_ratios: np.ndarray, omega: float
) -> np.ndarray:
    """Return d_j(w) - 1 / w_j^2 of modes j: complex (n,) [s^2].

        d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w)

    is the receptance of a mode with frequency w_j and damping ratio xi_j, at the load frequency w
    (``omega``). For rigid-body modes d_j(w) is returned, since static responses do not contain
    them.
    """
    squared_omegas = natural_omegas**2
    denominators = squared_omegas - omega**2 + 2j * modal_damping_ratios * natural_omegas * omega
    static_receptance = np.divide(
        1.0, squared_omegas, out=np.zeros_like(squared_omegas), where=squared_omegas > 0.0
    )
    return (
        1.0 / np.where(denominators == 0.0, 1e-12 * squared_omegas, denominators)
        - static_receptance
    )


# --- the frequencies that a scene requests --------------------------------------------------------


def _list_requested_omegas(scene: Scene, natural_omegas: np.ndarray) -> list[float]:
    """Return the load frequencies that a scene asks for [rad/s], ascending.

    They are the excitation's frequency, the ends of the curve's and the sweep's range, and those of
    the ``natural_omegas`` in these ranges.
    """
    omegas = {scene.excitation.omega}
    for lowest_omega, highest_omega in (
        lowest_and_highest_load_omega(scene, "curve"),
        lowest_and_highest_load_omega(scene, "sweep"),
    ):
        omegas |= {
            lowest_omega,
            highest_omega,
            *(float(omega) for omega in natural_omegas if lowest_omega <= omega <= highest_omega),
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
    """Return H w, the frequency of a command's highest harmonic [rad/s].

    ``command`` is "solve", "curve" or "sweep"; by default the highest frequency of all three is
    returned.
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


# --- resonances and curves ------------------------------------------------------------------------

FACTOR_AND_UNIT_BY_CURVE_PARAMETER = {
    "omega": (1.0, "rad/s"), "frequency": (RAD_PER_TURN, "Hz"), "speed": (1.0, "rad/s"),
    "rpm": (RAD_PER_S_PER_RPM, "rpm"),
}  # fmt: skip
"""Factor from a curve's parameter to [rad/s], and the parameter's unit, by parameter."""


def propose_curve_or_none(scene: Scene, key_figures: KeyFigures) -> Curve | None:
    """Propose a table ``[curve]`` through the resonance, or return None.

    None is returned if the scene's curve meets the resonance or is not over frequency or rotor
    speed, or if the mode is not damped.

    The curve extends three half-power widths beyond the resonance under the load and under a small
    load. If the resonance is not known, it extends so far beyond the open and bonded frequencies of
    the mode nearest to the load. Ends are rounded outwards to three digits.
    """
    excitation = scene.excitation
    scene_curve_table = scene.curve
    load_resonance = key_figures.load_resonance
    is_speed_curve = excitation.order is not None and scene.disk is None
    parameter = "frequency" if scene.is_frequency_in_hertz else "omega"
    if is_speed_curve:
        parameter = "rpm" if scene.is_speed_in_rpm else "speed"
    if scene_curve_table is not None:
        parameter = scene_curve_table.parameter
    if parameter not in FACTOR_AND_UNIT_BY_CURVE_PARAMETER:
        return None
    mode_index = int(np.argmin(np.abs(key_figures.omega_bilinear - excitation.omega)))
    open_omega = float(key_figures.omega_open[mode_index])
    bilinear_omega = float(key_figures.omega_bilinear[mode_index])
    # Three half-power bandwidths from the resonance the response is a sixth of the peak.
    bandwidth_factor = 1.0 + 3.0 * 2.0 * float(key_figures.damping_ratios[mode_index])
    if not (open_omega > 0.0 and bilinear_omega < 2.0 * open_omega and bandwidth_factor > 1.0):
        return None
    bonded_omega = 1.0 / (2.0 / bilinear_omega - 1.0 / open_omega)  # of the same mode
    find_crossing_parameter = partial(
        _curve_parameter_at_crossing,
        scene,
        parameter,
        slope=key_figures.squared_omega_slopes[mode_index],
    )
    lowest_resonance_parameter, highest_resonance_parameter, start, stop = map(
        find_crossing_parameter,
        (open_omega, bonded_omega, open_omega / bandwidth_factor, bonded_omega * bandwidth_factor),
    )
    if not load_resonance.unknown and is_speed_curve == (parameter in ("speed", "rpm")):
        lowest_resonance_parameter = highest_resonance_parameter = load_resonance.value
        start = min(lowest_resonance_parameter, load_resonance.rest)
        stop = max(highest_resonance_parameter, load_resonance.rest)
        start, stop = start - 3.0 * load_resonance.width, stop + 3.0 * load_resonance.width
    if (
        scene_curve_table is not None
        and min(scene_curve_table.parameter_and_range[1:]) <= highest_resonance_parameter
        and max(scene_curve_table.parameter_and_range[1:]) >= lowest_resonance_parameter
    ):
        return None
    if not 0.0 < start < stop < math.inf:
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


def _curve_parameter_at_crossing(
    scene: Scene, parameter: str, omega: float, slope: float, harmonic: float = 1.0
) -> float:
    """Return a curve's parameter at which a harmonic meets a natural frequency.

    Parameters
    ----------
    parameter : "omega", "frequency", "speed" or "rpm"
        Parameter of the curve.
    omega : float [rad/s]
        Natural frequency.
    slope : float
        S = d(omega^2) / d(W^2) over the rotor speed W.
    harmonic : float
        Multiple of the load frequency.

    Returns
    -------
    float [rad/s]
        Load frequency or rotor speed; nan if an engine order never meets the frequency.
    """
    engine_order = scene.excitation.order
    if parameter in ("speed", "rpm") and engine_order is not None:
        return order_crossing_speed(harmonic * engine_order, scene.speed, omega, slope)
    return omega / harmonic


def is_response_proportional_to_load(scene: Scene) -> bool:
    """Return True if the response is proportional to the load.

    This requires contact that begins at g = 0 without smoothing or a layer, no clearance and no
    rotation. A positive factor of all forces and gaps then is a factor of the whole equations. The
    centrifugal load does not scale.
    """
    contact_table = scene.contact
    if contact_table is not None and (
        not contact_table.is_unilateral or contact_table.layer_depth is not None
    ):
        return False
    if scene.speed > 0.0:
        return False
    tables_with_clearance = (
        scene.crack_by_name.values() if scene.structure is None else (scene.structure,)
    )
    return all(table.clearance == 0.0 for table in tables_with_clearance)


# --- remarks --------------------------------------------------------------------------------------

MAX_PLAUSIBLE_SIDE = 20.0
"""Maximum plausible side of a plate, radius or extent [m]; larger values get a remark."""
MAX_PLAUSIBLE_TIP_SPEED = 1000.0
"""Maximum plausible speed of a blade tip [m/s]; the longest blades have 700."""
TIP_SPEED_TEXT_TEMPLATE = "the blade tip moves at {:.3g} m/s; the fastest blades reach 700 m/s"
MAX_PLAUSIBLE_DAMPING = 0.05
"""Maximum plausible ratio of critical damping; larger values get a remark."""
MIN_REPORTED_CORIOLIS_CHANGE = 0.01
"""Minimum relative change of a frequency by the Coriolis force that gets a remark. Errors of usual
meshes are as large."""
CORIOLIS_TEXT_TEMPLATE = (
    "the Coriolis force, left out, would change one of the first natural frequencies by {:.2%}"
)
SCENE_KEY_PREFIXES_OF_KEY_FIGURES = (
    "material.",
    "geometry.",
    "rotation.",
    "mesh.file",
    "structure.model",
)
"""Beginnings of scene keys on which the key figures depend. After a remark on such a key, no
remarks are based on the figures."""


@dataclass(frozen=True)
class Remark:
    """Remark on an unusual value: ``key = value: text``."""

    key: str
    value: object
    text: str

    def __str__(self) -> str:
        value = f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
        return f"{self.key} = {value}: {self.text}"


class RemarkRule(NamedTuple):
    """Rule for remarks on a scene: a number's plausible range.

    Attributes
    ----------
    keys_text : str
        Keys, separated by blanks. The remark names the first key with a value other than 0; "crack"
        stands for every crack.
    lower_limit, upper_limit : float
        Plausible range; a number outside gets a remark.
    text_template : str
        Text with fields for the number, further values, {kind} and {faces}.
    number_function : callable, optional
        Function of the value, the scene, and in some tables the structure or the key figures. It
        returns the number, or a tuple of the number and further values; None if the rule does not
        apply. Default: the largest value of the key.
    factor_by_unit : mapping of str to float
        Units in which values are mistyped, and the factor from the unit to the key's unit.
    """

    keys_text: str
    lower_limit: float
    upper_limit: float
    text_template: str
    number_function: Callable[..., Any] = lambda value, *_: float(np.max(value))
    factor_by_unit: Mapping[str, float] = MappingProxyType({})


def remarks_on_scene(
    scene: Scene, structure: Structure | None = None, key_figures: KeyFigures | None = None
) -> list[Remark]:
    """Return remarks on unusual values in a scene (collective).

    The unreduced ``structure`` and the ``key_figures`` add further remarks, if they are given.
    """
    remarks = [*_iterate_remarks(SCENE_REMARK_RULES, scene)]
    if structure is not None:
        remarks += _iterate_remarks(STRUCTURE_REMARK_RULES, scene, structure)
    if key_figures is not None and not any(
        remark.key.startswith(SCENE_KEY_PREFIXES_OF_KEY_FIGURES) for remark in remarks
    ):
        remarks += _iterate_remarks(KEY_FIGURE_REMARK_RULES, scene, key_figures)
    if structure is not None:
        remarks += _iterate_remarks(METHOD_REMARK_RULES, scene, structure)
    return remarks


def _iterate_remarks(
    rules: Iterable[RemarkRule], scene: Scene, *rule_arguments: object
) -> Iterator[Remark]:
    """Yield the remarks of some rules on a scene.

    A remark proposes the first unit in ``factor_by_unit`` in which the value would be plausible.

    Parameters
    ----------
    rule_arguments
        Further arguments of the rules' functions: the structure or the key figures.
    """
    geometry_table = scene.geometry
    body_kind = "structure" if geometry_table is None else geometry_table.kind
    for rule in rules:
        for key, value in _list_first_given_key_and_value(scene, rule.keys_text):
            number_and_values = rule.number_function(value, scene, *rule_arguments)
            checked_number, *further_values = (
                number_and_values if isinstance(number_and_values, tuple) else (number_and_values,)
            )
            if checked_number is None or rule.lower_limit <= checked_number <= rule.upper_limit:
                continue
            remark_text = rule.text_template.format(
                checked_number, *further_values, kind=body_kind, faces=word_for_crack_faces(scene)
            )
            for unit, unit_factor in rule.factor_by_unit.items():
                if rule.lower_limit <= unit_factor * checked_number <= rule.upper_limit:
                    remark_text += (
                        f"; is it in {unit}? then give {unit_factor * float(np.max(value)):g}"  # type: ignore[call-overload]
                    )
                    break
            yield Remark(key, list(value) if isinstance(value, tuple) else value, remark_text)


def _list_first_given_key_and_value(scene: Scene, keys: str) -> list[tuple[str, object]]:
    """Return the first key with a nonzero value, and the value.

    If all values are zero, it is the first given key. A key of the table "crack" yields an entry
    for each crack that has it. The list is empty if no key is given.
    """
    keys_and_values_by_key: list[list[tuple[str, object]]] = []
    for dotted_key in keys.split():
        table_name, field_name = dotted_key.split(".")
        table_by_name = (
            scene.crack_by_name
            if table_name == "crack"
            else {table_name: getattr(scene, table_name)}
        )
        value_by_key = {
            f"{path}.{field_name}": getattr(table, field_name, None)
            for path, table in table_by_name.items()
        }
        keys_and_values_by_key.append(
            [(path, value) for path, value in value_by_key.items() if value is not None]
        )
    given_keys_and_values = [
        keys_and_values for keys_and_values in keys_and_values_by_key if keys_and_values
    ]
    nonzero_keys_and_values = [
        keys_and_values
        for keys_and_values in given_keys_and_values
        if any(np.any(np.asarray(value) != 0) for _, value in keys_and_values)
    ]
    return (nonzero_keys_and_values or given_keys_and_values or [[]])[0]


# --- numbers of rules -----------------------------------------------------------------------------


def _longest_side_or_none(side_length: float, scene: Scene) -> float | None:
    """Return a plate's side [m] if none is longer, else None."""
    geometry_table = scene.geometry
    return (
        side_length
        if side_length == max(geometry_table.width or 0.0, geometry_table.height or 0.0)
        else None
    )


def _length_over_side(length: float, side: float | None) -> float | None:
    """Return a crack's length or depth over a side.

    None if the scene gives no such side.
    """
    return None if side is None else length / side


def _shorter_side(scene: Scene) -> float:
    """Return the shorter side of a plate [m]; inf without sides."""
    sides = scene.geometry.width, scene.geometry.height
    return min((side for side in sides if side is not None), default=math.inf)


def _thickness_over_shorter_side(thickness: float, scene: Scene) -> float | None:
    """Return a thickness over the shorter side in the plane.

    None for a plate of 1 m, the usual thickness of plane problems, and for disks.
    """
    is_thickness_irrelevant = scene.geometry.kind == "plate" and (
        thickness == 1.0 or scene.disk is not None
    )
    return None if is_thickness_irrelevant else thickness / _shorter_side(scene)


def _relative_distance_and_node_text(
    load_point: object, scene: Scene, structure: Structure
) -> tuple[float, str] | None:
    """Return distance and position of the node nearest to the load's point (collective).

    Returns
    -------
    (float, str) or None
        Distance over the mesh's longest extent, and the node's position as text. None if the load
        acts inside a cell, and for scenes without a part file (``geometry.file``) or given
        matrices.
    """
    if structure.nodes is None or (scene.structure is None and scene.geometry.file is None):
        return None
    if scene.structure is None:
        from fenics_crack.fem.loads import nodal_force_fractions  # DOLFINx

        force_fractions = nodal_force_fractions(
            scene,
            structure.nodes.mesh_dofs,
            "excitation.point",
            load_point,  # type: ignore[arg-type]
        )
        if structure.comm.allreduce(np.count_nonzero(force_fractions)) > 1:  # nodes of a cell
            return None
    points = gather_rows(structure.comm, structure.nodes.points)
    distances = np.linalg.norm(points - load_point, axis=1)
    nearest_index = int(np.argmin(distances))
    longest_mesh_extent, nearest_point = np.ptp(points, axis=0).max(), points[nearest_index]
    return distances[nearest_index] / longest_mesh_extent, format_point(nearest_point)


def _blade_tip_speed(speed_value: float, scene: Scene, structure: Structure) -> float | None:
    """Return the speed of the node farthest from the rotor's axis [m/s] (collective).

    None without rotation or nodes, for a hub radius above 20 m, or if ``speed_value`` is not from
    the key that sets the rotor's speed.
    """
    rotation_table = scene.rotation
    if (
        rotation_table is None
        or structure.nodes is None
        or speed_value != (rotation_table.rpm or rotation_table.speed)
    ):
        return None
    if (rotation_table.hub_radius or 0.0) > MAX_PLAUSIBLE_SIDE:
        return None
    axis_point, axis_direction = (
        vector[: structure.nodes.points.shape[1]] for vector in scene.axis_point_and_direction
    )
    offsets = gather_rows(structure.comm, structure.nodes.points) - axis_point
    radial_offsets = offsets - np.outer(offsets @ axis_direction, axis_direction)
    return scene.speed * float(np.linalg.norm(radial_offsets, axis=1).max())


def _clamp_height_ratio_and_height(
    _: float, scene: Scene, structure: Structure
) -> tuple[float, float] | None:
    """Return a clamp's height, relative and in m (collective).

    The height y is divided by the mesh's longest extent. None unless the mesh is from a file. y is
    the clamped node's coordinate farthest from 0.
    """
    nodes = structure.nodes
    if scene.mesh is None or scene.mesh.layout != "file" or nodes is None:
        return None
    points, node_dofs = (
        gather_rows(structure.comm, local_rows) for local_rows in (nodes.points, nodes.dofs)
    )
    clamp_heights = points[np.all(node_dofs < 0, axis=1), 1]
    clamp_height = (
        float(clamp_heights[np.abs(clamp_heights).argmax()]) if len(clamp_heights) else 0.0
    )
    return abs(clamp_height) / float(np.ptp(points, axis=0).max()), clamp_height


def _clamp_bending_ratio_and_stress(
    _: object, scene: Scene, structure: Structure
) -> tuple[float, float] | None:
    """Return the bending stress in a solid's clamp by an eccentric axis (collective).

    The centrifugal force bends a blade whose rotor axis passes beside the clamp's centre.

    Returns
    -------
    (float, float) or None
        Bending stress over the direct stress of the centrifugal force, and in MPa. The clamp counts
        as a rectangle. None for plates, disks, and without rotation or clamp.
    """
    nodes, rotation, clamp = structure.nodes, structure.rotation, structure.clamp
    if nodes is None or rotation is None or clamp is None or scene.dimension == 2 or scene.disk:
        return None
    is_clamped, (axis_point, axis_direction) = (
        np.all(nodes.dofs < 0, axis=1),
        scene.axis_point_and_direction,
    )
    clamp_sides = np.ptp(gather_rows(structure.comm, nodes.points[is_clamped]), axis=0)
    normal_axis_index = int(clamp_sides.argmin())
    free_dofs = nodes.dofs[~is_clamped] - structure.first_dof
    clamp_offset_from_axis = (np.eye(3) - np.outer(axis_direction, axis_direction)) @ (
        clamp.center - axis_point
    )
    in_plane_offset = np.where(np.arange(3) == normal_axis_index, 0.0, clamp_offset_from_axis)
    local_force_and_moment = [
        rotation.force[free_dofs].sum(axis=0),
        (clamp.inertia[3:, free_dofs] @ in_plane_offset).sum(axis=1),
    ]
    clamp_force, clamp_moment = rotation.speed**2 * structure.sum_over_ranks(
        np.stack(local_force_and_moment)
    )
    first_side, second_side = np.delete(clamp_sides, normal_axis_index)
    bending_force = 6.0 * (
        np.abs(np.delete(clamp_moment, normal_axis_index)) @ [1.0 / second_side, 1.0 / first_side]
    )
    return bending_force / float(np.linalg.norm(clamp_force)), 1e-6 * bending_force / (
        first_side * second_side
    )


def _largest_coriolis_change(_: float, scene: Scene, structure: Structure) -> float | None:
    """Return the largest frequency change by the Coriolis force.

    The change is relative, for a solid. The lowest 4 modes are examined. None for plates, disks and
    without rotation.
    """
    if scene.rotation is None or structure.rotation is None or scene.dimension == 2 or scene.disk:
        return None
    angular_velocity = structure.rotation.speed * scene.axis_point_and_direction[1]
    modes = solve_modes(structure, min(N_KEY_FIGURE_MODES, structure.n_modes))
    return float(np.abs(relative_coriolis_shifts(modes, angular_velocity)).max())


def describe_coriolis(relative_changes: np.ndarray) -> str:
    """Describe the Coriolis force's effect in words; "" if at most 1 %.

    ``relative_changes`` (m,) are those of the lowest natural frequencies; the largest one counts.
    """
    largest_change = np.abs(relative_changes).max()
    return (
        ""
        if largest_change <= MIN_REPORTED_CORIOLIS_CHANGE
        else CORIOLIS_TEXT_TEMPLATE.format(largest_change)
    )


def _count_rigid_pairs_with_mass(_: str, scene: Scene, structure: Structure) -> float | None:
    """Return the number of rigid contact pairs between crack faces with mass.

    None for other contact laws, and for crack faces without mass.
    """
    reduction, contact_table = modal_reduction_or_none(scene, structure), scene.contact
    has_massless_faces = reduction is not None and reduction.method == "massless"
    return (
        None
        if has_massless_faces or contact_table is None or contact_table.law != "unilateral"
        else structure.n_pairs
    )


def _make_frequency_unit_check(other_unit_factor: float) -> Callable[..., tuple[float, ...] | None]:
    """Return a function that detects a load frequency in another unit.

    The unit is doubtful if the load frequency is not within 10 % of a natural frequency, but
    ``other_unit_factor`` times the load frequency is near the first one. The function then returns
    the load frequency over the first natural frequency, and the latter in Hz and rad/s; else None.
    """

    def compare_in_other_unit(
        _: float, scene: Scene, key_figures: KeyFigures
    ) -> tuple[float, ...] | None:
        first_omega, omega = float(key_figures.omega_open[0]), scene.excitation.omega
        natural_omegas = np.concatenate([key_figures.omega_open, key_figures.omega_tied])
        first_omegas = natural_omegas[[0, len(key_figures.omega_open)]]
        is_other_unit = not _is_near_natural_frequency(
            omega, natural_omegas
        ) and _is_near_natural_frequency(other_unit_factor * omega, first_omegas)
        return (
            (omega / first_omega, first_omega / RAD_PER_TURN, first_omega)
            if is_other_unit and first_omega > 0.0
            else None
        )

    return compare_in_other_unit


def _is_near_natural_frequency(omega: float, natural_omegas: np.ndarray) -> bool:
    """Return True if any natural frequency is within 10 %."""
    return bool(np.any(np.abs(natural_omegas - omega) < 0.1 * natural_omegas))


def _missed_first_omega_and_text(
    _: float, scene: Scene, key_figures: KeyFigures
) -> tuple[float, str] | None:
    """Return the first natural frequency if a curve meets no resonance.

    Resonances are sought between the open and bonded frequencies of the first modes, with the
    harmonics 1/2, 1, 2 and 3.

    Returns
    -------
    (float, str) or None
        Frequency [rad/s], and a text with the curve's end and a proposed range. None if the curve
        meets a resonance or ends above the modes computed, or is not over frequency or rotor speed.
    """
    curve_table = scene.curve
    if curve_table is None or curve_table.parameter not in FACTOR_AND_UNIT_BY_CURVE_PARAMETER:
        return None
    find_crossing_parameters = np.vectorize(
        partial(
            _curve_parameter_at_crossing,
            scene,
            curve_table.parameter,
            slope=key_figures.squared_omega_slopes[0],
        )
    )
    curve_start, curve_end = sorted(curve_table.parameter_and_range[1:])
    open_and_bonded_omegas = key_figures.omega_open, key_figures.omega_tied
    for harmonic in (0.5, 1.0, 2.0, 3.0):
        open_parameters, bonded_parameters = (
            find_crossing_parameters(omega, harmonic=harmonic) for omega in open_and_bonded_omegas
        )
        if np.any((curve_start <= bonded_parameters) & (curve_end >= open_parameters)):
            return None
    # Modes above the last one are not computed.
    if curve_end >= find_crossing_parameters(key_figures.omega_tied[-1], harmonic=1.0):
        return None
    proposed_curve_table = propose_curve_or_none(scene, key_figures)
    unit = FACTOR_AND_UNIT_BY_CURVE_PARAMETER[curve_table.parameter][1]
    first_omega_range = key_figures.omega_open[0], key_figures.omega_tied[0]
    range_text = format_in_unit(choose_frequency_factor_name_unit(True), *first_omega_range)
    end_and_range_text = f"{curve_table.stop:g} {unit}: the first resonance is between {range_text}"
    if proposed_curve_table is not None:
        end_and_range_text += (
            f"; give curve.start = {proposed_curve_table.start:g} and "
            f"curve.stop = {proposed_curve_table.stop:g}"
        )
    return float(first_omega_range[0]), end_and_range_text


def _peak_rotation_and_displacement(
    _: object, scene: Scene, key_figures: KeyFigures
) -> tuple[float, float] | None:
    """Return peak rotation [rad] and displacement [m] under the excitation's force.

    The crack is open; the peak is over the load frequencies that the scene asks for. None with
    other loads, or without damping.
    """
    has_other_loads_or_no_damping = scene.has_other_loads or key_figures.damping_ratios.min() == 0.0
    return (
        None
        if has_other_loads_or_no_damping
        else (key_figures.peak_rotation, key_figures.peak_displacement)
    )


def _n_face_elements_or_none(_: object, scene: Scene, key_figures: KeyFigures) -> int | None:
    """Return the number of elements along each crack face, or None.

    None for a grid without patches, whose columns and rows set the number. None, too, for contact
    at the mouth alone.
    """
    has_mouth_contact_only = scene.contact is not None and scene.contact.pairs == "mouth"
    is_grid_without_patches = scene.mesh.layout == "grid" and scene.mesh.patches is None
    return (
        None if has_mouth_contact_only or is_grid_without_patches else key_figures.n_face_elements
    )


def _linear_gap_motion_and_verb(
    _: object, scene: Scene, key_figures: KeyFigures
) -> tuple[float, str] | None:
    """Return the gaps' largest motion [m] if no pair breathes.

    The second output is the verb for the remark "the crack never ...": "opens" or "closes". None if
    a pair opens and closes, without contact, and for given matrices.
    """
    if scene.contact is None or scene.structure is not None or key_figures.breathes:
        return None
    return key_figures.peak_gap_motion, "opens" if key_figures.n_closed_pairs else "closes"


# --- tables of remarks ----------------------------------------------------------------------------

FACTOR_BY_MILLIMETRE_UNIT = MappingProxyType({"mm": 1e-3})
ROTOR_SIZE_TEXT = "in m, this is larger than any rotor"
METAL_DAMPING_TEXT = "metals have 0.0001 to 0.01 of critical damping"
FORCE_KEYS_TEXT = "excitation.force_sin excitation.force_cos"
STIFFNESS_KEYS_TEXT = "contact.stiffness contact.stiffness_per_area"
FIRST_FREQUENCY_TEXT_TEMPLATE = (
    "{:.2g} times the first natural frequency, {:.4g} Hz = {:.4g} rad/s; is it in "
)
SCENE_REMARK_RULES = (
    RemarkRule(
        "material.young",
        1e7,
        1.5e12,
        "in Pa, steel has 2.1e11, and most solids have 1e7 to 1.5e12",
        factor_by_unit={"GPa": 1e9, "MPa": 1e6},
    ),
    RemarkRule(
        "material.density",
        50.0,
        25000.0,
        "in kg/m^3, steel has 7850, and most solids have 50 to 25000",
        factor_by_unit={"g/cm^3": 1e3, "t/mm^3": 1e12, "kg/mm^3": 1e9},
    ),
    RemarkRule("material.poisson", 0.0, 0.49, "most solids have 0 to 0.49, steel 0.3"),
    *(
        RemarkRule(
            f"geometry.{side}",
            0.0,
            MAX_PLAUSIBLE_SIDE,
            "the longest side of the {kind} is {:g} m",
            _longest_side_or_none,
            FACTOR_BY_MILLIMETRE_UNIT,
        )
        for side in ("width", "height")
    ),
    RemarkRule(
        "geometry.thickness",
        0.0,
        1.0,
        "thicker than the {kind} is wide or high",
        _thickness_over_shorter_side,
        FACTOR_BY_MILLIMETRE_UNIT,
    ),
    RemarkRule(
        "crack.length",
        0.01,
        0.9,
        "{:.3g} of the {kind}'s width; 0.01 to 0.9 are usual",
        lambda length, scene: _length_over_side(length, scene.geometry.width),
    ),
    RemarkRule(
        "crack.depth",
        0.01,
        0.9,
        "{:.3g} of the {kind}'s thickness; 0.01 to 0.9 are usual",
        lambda depth, scene: _length_over_side(depth, scene.geometry.thickness),
    ),
    RemarkRule(
        "mesh.size",
        0.0,
        1.0,
        "elements are longer than the {kind}'s shorter side",
        lambda size, scene: size / _shorter_side(scene),
        FACTOR_BY_MILLIMETRE_UNIT,
    ),
    RemarkRule(
        "rotation.hub_radius",
        0.0,
        MAX_PLAUSIBLE_SIDE,
        ROTOR_SIZE_TEXT,
        factor_by_unit=FACTOR_BY_MILLIMETRE_UNIT,
    ),
    RemarkRule(
        "tip_timing.tip_radius",
        0.0,
        MAX_PLAUSIBLE_SIDE,
        ROTOR_SIZE_TEXT,
        factor_by_unit=FACTOR_BY_MILLIMETRE_UNIT,
    ),
    RemarkRule(
        "tip_timing.probes",
        RAD_PER_TURN,
        math.inf,
        "all probes lie within {:.3g} degrees; are they in rad? then give degrees",
        lambda angles, _: np.ptp(angles) or None,
    ),
    RemarkRule(
        "damping.ratio damping.ratios",
        0.0,
        MAX_PLAUSIBLE_DAMPING,
        METAL_DAMPING_TEXT,
        factor_by_unit={"%": 1e-2},
    ),
    RemarkRule(
        "growth.rate",
        1e-20,
        1e-9,
        "in m per cycle at 1 MPa m^0.5, steels have 5e-12 to 1.4e-10",
        factor_by_unit={"mm per cycle": 1e-3},
    ),
    RemarkRule(
        "excitation.wave",
        0.0,
        0.0,
        "{1} harmonics leave out {0:.2%} of the time-varying load (root mean square); "
        "raise excitation.wave_harmonics",
        lambda _, scene: (
            read_load_coefficients_and_residual(scene.excitation, scene.dimension)[1],
            scene.excitation.wave_harmonics,
        ),
    ),
    RemarkRule(
        FORCE_KEYS_TEXT,
        1.0,
        1.0,
        "no force acts: excitation.force_sin, force_cos and force_mean are zero; give one of them",
        lambda _, scene: scene.has_other_loads or bool(scene.excitation.first_force_key),
    ),
)
STRUCTURE_REMARK_RULES = (
    RemarkRule(
        "structure.model mesh.file",
        0.0,
        MAX_PLAUSIBLE_SIDE,
        "the structure measures {1:.3g} m x {0:.3g} m; is the mesh in mm? lengths are in m",
        lambda _, __, structure: (max(e := mesh_extents(structure)), min(e)),
    ),
    RemarkRule(
        "excitation.point",
        0.0,
        RELATIVE_POSITION_TOLERANCE,
        "no node is at this point: the force acts on the nearest node, at {1}",
        _relative_distance_and_node_text,
    ),
    RemarkRule(
        "rotation.speed",
        0.0,
        MAX_PLAUSIBLE_TIP_SPEED,
        TIP_SPEED_TEXT_TEMPLATE,
        _blade_tip_speed,
        {"rpm": RAD_PER_S_PER_RPM},
    ),
    RemarkRule(
        "rotation.rpm", 0.0, MAX_PLAUSIBLE_TIP_SPEED, TIP_SPEED_TEXT_TEMPLATE, _blade_tip_speed
    ),
    RemarkRule(
        "rotation.hub_radius",
        0.0,
        0.01,
        "the hub radius is measured to a clamp at y = 0; the mesh has its clamp at "
        "y = {1:.4g} m: move the mesh",
        _clamp_height_ratio_and_height,
    ),
    RemarkRule(
        "rotation.hub_radius rotation.center",
        0.0,
        0.2,
        "the rotor axis is not below the middle of the clamp: the centrifugal force bends the "
        "blade, by about {1:.3g} MPa at the clamp, {0:.2g} times its tensile stress there",
        _clamp_bending_ratio_and_stress,
    ),
)
KEY_FIGURE_REMARK_RULES = (
    RemarkRule(
        "excitation.omega",
        1.0,
        0.0,
        FIRST_FREQUENCY_TEXT_TEMPLATE + "Hz? then use excitation.frequency",
        _make_frequency_unit_check(RAD_PER_TURN),
    ),
    RemarkRule(
        "excitation.frequency",
        1.0,
        0.0,
        FIRST_FREQUENCY_TEXT_TEMPLATE + "rad/s? then use excitation.omega",
        _make_frequency_unit_check(1.0 / RAD_PER_TURN),
    ),
    RemarkRule(
        "curve.start",
        1.0,
        0.0,
        "the curve has no resonance between this start and {1}",
        _missed_first_omega_and_text,
    ),
    RemarkRule(
        FORCE_KEYS_TEXT,
        0.0,
        MAX_SMALL_ROTATION,
        "with an open crack this force moves the {kind} by {1:.2g} m, or {0:.2g} "
        "rad about the clamp: beyond small displacements; is the force in N?",
        _peak_rotation_and_displacement,
    ),
    RemarkRule(
        "mesh.patches mesh.lip_elements mesh.file",
        4,
        math.inf,
        "elements or patches are longer than a quarter of the crack; use 4 to 20 along each face",
        _n_face_elements_or_none,
    ),
    RemarkRule(
        STIFFNESS_KEYS_TEXT,
        1.0,
        math.inf,
        "at most {:.2g} times the {faces}' static stiffness, so that they penetrate each other; "
        "100 to 10000 times is usual; or use contact.law = 'unilateral'",
        lambda _, __, figures: np.max(figures.contact_stiffness_ratio),
    ),
    RemarkRule(
        STIFFNESS_KEYS_TEXT,
        0.0,
        1e6,
        "at least {:.2g} times the {faces}' static stiffness: numerically "
        "rigid, and hard to solve; use contact.law = 'unilateral' for rigid contact",
        lambda _, __, figures: np.min(figures.contact_stiffness_ratio),
    ),
    RemarkRule(
        "contact.sharpness",
        10.0,
        math.inf,
        "the law is rounded over {1:.2g} m, and the {faces} "
        "move by {2:.2g} m: contact acts on open {faces}; raise contact.sharpness",
        lambda k, _, figures: (k * figures.peak_gap_motion, 1.0 / k, figures.peak_gap_motion),
    ),
    RemarkRule(
        "crack.clearance excitation.force_mean rotation.rpm rotation.speed",
        0.0,
        0.0,
        "the crack never {1}: the load moves open crack faces by {0:.2g} m at most; the response "
        "is linear",
        _linear_gap_motion_and_verb,
    ),
    RemarkRule(
        "damping.mass damping.stiffness",
        0.0,
        MAX_PLAUSIBLE_DAMPING,
        "the damping ratio at the first natural frequency is {:.3g}; " + METAL_DAMPING_TEXT,
        lambda _, __, figures: float(figures.damping_ratios[0]),
    ),
    RemarkRule(
        "harmonic_balance.harmonics",
        0,
        0,
        "the harmonics reach the frequencies of {1} modes, but {2} modes are kept: raise {3}",
        lambda _, scene, figures: (
            max(figures.n_modes_below_highest_harmonic - figures.n_kept_modes, 0),
            figures.n_modes_below_highest_harmonic,
            figures.n_kept_modes,
            scene.modes_key,
        ),
    ),
)
METHOD_REMARK_RULES = (
    RemarkRule(
        "rotation.rpm rotation.speed",
        0.0,
        MIN_REPORTED_CORIOLIS_CHANGE,
        CORIOLIS_TEXT_TEMPLATE,
        _largest_coriolis_change,
    ),
    RemarkRule(
        "contact.law",
        0.0,
        0.0,
        "rigid contact of crack faces with mass: solve gives no verdict on stability, "
        "and curve is refused; use 'penalty', 'smoothed', or reduction.method = 'massless'",
        _count_rigid_pairs_with_mass,
    ),
)
