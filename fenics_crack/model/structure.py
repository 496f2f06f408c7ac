"""The structure: mass, stiffness, damping, load, and the gaps of the cracks.

    M u'' + C u' + K u + B lambda(g) = f(t),     g = B^T u - g0

``g > 0`` is penetration, ``g < 0`` an open crack. Column j of B is +1 on the normal displacement of
the lower face's node and -1 on that of the upper face's node. PETSc's matrices are distributed by
rows. Every displacement array holds the ``n_local`` rows of its rank; one rank holds all of them.

A structure never changes, so its results stay true. Copies with another load, clearance or damping
factor share the matrices, and the modes once they are computed.

Modal and Rayleigh damping follow from mass and stiffness. Both are diagonal in the natural modes, K
phi_j = omega_j^2 M phi_j with phi_i^T M phi_j = delta_ij:

    phi_i^T C phi_j = 2 xi_j omega_j delta_ij
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import (
    InputError,
    check_count,
    check_number,
    check_rayleigh_damping_ratios,
)
from fenics_crack.basics.machine import run_single_threaded
from fenics_crack.basics.suggestions import check_calls, keep_old_attribute_names
from fenics_crack.basics.tables import format_count
from fenics_crack.model.body import (
    FIELD_NAMES_THAT_KEEP_MATRIX_CACHE,
    SETTING_WITHOUT_CHANGES,
    Body,
    LoadDampingClearanceSetting,
)
from fenics_crack.model.factor import matrix_plus_weighted_matrix
from fenics_crack.model.matrices import (
    AbsentMatrix,
    add_harmonics_to_load,
    add_springs,
    check_and_distribute_parts,
    expand_to_pairs,
    floats_or_single_nan,
    lump_mass,
    make_petsc_matrix,
    read_only_array,
)
from fenics_crack.model.nodes import (
    ClampReactionData,
    DofsAndContactPairs,
    Nodes,
    Pairs,
    body_property,
)


@keep_old_attribute_names(for_modes="rule_for_n_modes")
@dataclass(frozen=True)
class ModalDamping:
    """Damping C = M Phi diag(2 xi_j omega_j + b omega_j^2) Phi^T M, never formed.

    Phi holds mass-normalised modes with the frequencies omega_j. M is the mass.

    Attributes
    ----------
    ratio : float or tuple of float
        xi_j, relative to critical damping: one for all modes, or one per mode.
    modes : int or None
        Number of damped modes, the lowest ones. None: all.
    stiffness : float
        b [s]: adds b omega_j / 2 to each ratio, as C = b K does. Damping of materials and joints
        rises with the frequency.

    Raises
    ------
    InputError
        A ratio or ``stiffness`` is negative or not finite, or ``modes`` is no whole number >= 1.
    """

    ratio: float | Sequence[float]
    modes: int | None = None
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        ratio = floats_or_single_nan(self.ratio)
        if ratio.ndim > 1 or not ratio.size or not np.all(np.isfinite(ratio)) or ratio.min() < 0.0:
            raise InputError("damping ratio", self.ratio, "one finite number >= 0, or one per mode")
        if self.modes is not None:
            check_count("damping modes", self.modes, 1)
        check_number("damping stiffness", self.stiffness, 0.0)
        object.__setattr__(self, "ratio", tuple(ratio.tolist()) if ratio.ndim else float(ratio))

    def scaled(self, factor: float) -> ModalDamping:
        """Return this damping multiplied by a factor."""
        ratio: Any = (factor * np.asarray(self.ratio)).tolist()
        return replace(self, ratio=ratio, stiffness=factor * self.stiffness)

    def rule_for_n_modes(self, n_modes: int) -> ModalDamping:
        """Return the damping of a reduced structure with ``n_modes`` modes.

        Modes beyond the damped ones get the last ratio.
        """
        if isinstance(self.ratio, float):
            return replace(self, modes=None)
        ratio = list(self.ratio)[:n_modes]
        ratio += ratio[-1:] * (n_modes - len(ratio))
        return ModalDamping(tuple(ratio), stiffness=self.stiffness)

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """Return the modal damping rates 2 xi omega + b omega^2 of damped modes: (n,) [1/s].

        Parameters
        ----------
        squares : (n,) [rad^2/s^2]
            omega^2 of these modes. With one ratio for each mode, n must be the number of ratios.
        """
        squares = np.maximum(squares, 0.0)
        return 2.0 * np.asarray(self.ratio) * np.sqrt(squares) + self.stiffness * squares

    def __str__(self) -> str:
        ratio_percents = 100.0 * np.asarray(self.ratio)
        min_ratio_text, max_ratio_text = (
            f"{ratio_percents.min():.3g}",
            f"{ratio_percents.max():.3g}",
        )
        ratio_range_text = (
            min_ratio_text
            if min_ratio_text == max_ratio_text
            else f"{min_ratio_text} to {max_ratio_text}"
        )
        modes_text = "" if self.modes is None else f" of {self.modes} modes"
        stiffness_text = f" + {self.stiffness:.3g} s K" if self.stiffness else ""
        return f"modal damping {ratio_range_text} %{modes_text}{stiffness_text}"


@keep_old_attribute_names(for_modes="rule_for_n_modes")
@dataclass(frozen=True)
class RayleighDamping:
    """Damping C = a M + b K.

    M is the mass and K the stiffness. A mode of frequency omega has the damping ratio

        xi(omega) = a / (2 omega) + b omega / 2

    Attributes
    ----------
    mass : float
        a [1/s]: damps the low modes.
    stiffness : float
        b [s]: damps the high modes.

    Raises
    ------
    InputError
        A coefficient is negative or not finite.
    """

    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness"):
            check_number(f"damping {name}", getattr(self, name), 0.0)
            object.__setattr__(self, name, float(getattr(self, name)))

    @classmethod
    def from_ratios(cls, ratios: Sequence[float], omegas: Sequence[float]) -> RayleighDamping:
        """Return C = a M + b K with given ratios at two frequencies.

        With w_1 < w_2 and s = w_1 (xi_2 - xi_1) / (w_2 - w_1),

            a = 2 w_1 w_2 (xi_1 - s) / (w_1 + w_2),      b = 2 (xi_2 + s) / (w_1 + w_2)

        Between the two frequencies, the ratio is at most the larger one.

        Parameters
        ----------
        ratios : (2,)
            xi_1 and xi_2, relative to critical damping.
        omegas : (2,) [rad/s]
            w_1 and w_2, in any order.

        Raises
        ------
        InputError
            The ratios are not two numbers >= 0, the frequencies not two different ones > 0, or a
            coefficient would be negative.

        Notes
        -----
        Source: Clough and Penzien, Dynamics of Structures, 2nd edition, McGraw-Hill, New York 1993.
        """
        ratio_array, omega_array = floats_or_single_nan(ratios), floats_or_single_nan(omegas)
        if (
            ratio_array.shape != (2,)
            or not np.all(np.isfinite(ratio_array))
            or ratio_array.min() < 0.0
        ):
            raise InputError("damping ratios", ratios, "two finite numbers >= 0")
        is_valid = omega_array.shape == (2,) and np.all(np.isfinite(omega_array))
        if not is_valid or omega_array.min() <= 0.0 or omega_array[0] == omega_array[1]:
            raise InputError("damping omegas", omegas, "two different finite numbers > 0")
        xi_list = [float(ratio) for ratio in ratio_array]
        omega_list = [float(omega) for omega in omega_array]
        check_rayleigh_damping_ratios("damping ratios", xi_list, omega_list)
        (w_1, xi_1), (w_2, xi_2) = sorted(zip(omega_list, xi_list, strict=True))
        ratio_shift = w_1 / (w_2 - w_1) * (xi_2 - xi_1)
        mean_omega = 0.5 * (w_1 + w_2)
        mass_coefficient = w_1 / mean_omega * w_2 * (xi_1 - ratio_shift)
        stiffness_coefficient = (xi_2 + ratio_shift) / mean_omega
        # Rounding may make them negative.
        return cls(max(mass_coefficient, 0.0), max(stiffness_coefficient, 0.0))

    def scaled(self, factor: float) -> RayleighDamping:
        """Return this damping with both coefficients multiplied by a factor."""
        return RayleighDamping(factor * self.mass, factor * self.stiffness)

    def rule_for_n_modes(self, n_modes: int) -> RayleighDamping:
        """Return the damping of a reduced structure: the same coefficients."""
        return self

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """Return the modal damping rates 2 xi omega = a + b omega^2: (n,) [1/s].

        xi is the damping ratio, and a and b are the coefficients of C = a M + b K.

        Parameters
        ----------
        squares : (n,) [rad^2/s^2]
            omega^2, the squares of the modes' frequencies.
        """
        return self.mass + self.stiffness * squares

    def matrix(self, mass: Any, stiffness: Any) -> Any:
        """Return the damping matrix C = a M + b K as a PETSc matrix (collective)."""
        mass_term = mass.copy()
        mass_term.scale(self.mass)
        total = matrix_plus_weighted_matrix(mass_term, self.stiffness, stiffness)
        mass_term.destroy()
        return total

    def __str__(self) -> str:
        return f"Rayleigh damping {self.mass:.3g}/s M + {self.stiffness:.3g} s K"


DampingRule = ModalDamping | RayleighDamping
"""Damping that follows from mass and stiffness, without a damping matrix of its own."""


UNCOPIED_FIELD_NAMES = {"rotation", "result_cache", "cache_of_matrix_results"}
"""Attributes of a body that are not copied to a body with other matrices."""
Result = TypeVar("Result")


def shared_property(compute: Callable[[Any], Any]) -> Any:
    """Make a property that is computed once for a structure and all varied copies.

    ``compute`` takes the structure before variation (:attr:`Structure.unvaried_structure`) and
    returns the property's value.
    """
    return property(lambda structure: structure.compute_once(compute), doc=compute.__doc__)


AnyStructure = TypeVar("AnyStructure", bound="Structure")


@keep_old_attribute_names(
    blade_of="blade_and_sector_dof_of",
    damping_factor="damping_multiplier",
    light_lips="has_massless_crack_faces",
    original="unvaried_structure",
    setting="load_damping_clearance_changes",
    with_doubled_pairs="with_parallel_copy_of_pairs",
    check_dofs="as_dof_numbers",
    drawable_nodes="local_nodes_with_cells_or_none",
    watched_sector="watched_sector_index",
    watched_sector_load="watched_sector_load_rows",
    with_harmonics="with_added_load_harmonics",
)
class Structure(DofsAndContactPairs):
    """A linear structure with contact pairs; read-only.

    Made by :func:`fenics_crack.build_structure` from a scene, by :meth:`from_matrices` or by
    :func:`fenics_crack.structure_from_forms`. Varied copies (:meth:`varied`) share the constant
    data, called the body. Copies differ in the setting: factors of load and damping, and an added
    clearance.

    Attributes
    ----------
    comm, gap, tangential, force, nodes, pairs, watched
        Ranks, matrix B of the normal gaps, matrix B_t of the tangential gaps, load, node positions,
        contact pairs, and watched displacement
        (:class:`fenics_crack.model.nodes.DofsAndContactPairs`).
    mass, stiffness : PETSc.Mat
        (n, n), symmetric; [kg], [N/m].
    clearance : (n_pairs,) [m]
        Clearance g0 of every pair. Positive: the faces are apart at rest. Negative: they are
        pressed together at rest (preload).
    damping_multiplier : float
        Factor of the damping relative to :attr:`unvaried_structure`; 1 unless varied.
    clamp : fenics_crack.model.nodes.ClampReactionData or None
        Data for the reaction at a mesh's clamp. None without a mesh. A reduced structure has None;
        the whole structure has the data.
    rotation : fenics_crack.model.rotation.Rotation or None
        Terms that rotation has added to the matrices and the mean load. None at rest.
    """

    body: Body
    load_damping_clearance_changes: LoadDampingClearanceSetting
    stiffness: Any = body_property("stiffness")
    has_massless_crack_faces: ClassVar[bool] = False
    """True if crack faces have no mass.

    The residual flexibility of the modes then gives the quasi-static response to forces on the
    pairs.
    """

    def __init__(self, body: Body) -> None:
        vars(self).update(body=body, load_damping_clearance_changes=SETTING_WITHOUT_CHANGES)

    def __repr__(self) -> str:
        pairs_text, body_damping = format_count(self.n_pairs, "pair"), self.body.damping
        damping_text = "no damping" if body_damping is None else "damping matrix"
        if isinstance(body_damping, DampingRule):
            damping_text = str(body_damping.scaled(self.damping_multiplier))
        return f"{type(self).__name__}({self._size_description}, {pairs_text}, {damping_text})"

    @cached_property
    def force(self) -> np.ndarray:  # type: ignore[override]
        """Load's Fourier coefficients, mean, cosine, sine to harmonic K: (2K+1, n_local) [N].

        Factors by which the load was varied are included.
        """
        unvaried_load_coefficients = self.body.force
        return (
            unvaried_load_coefficients
            if self.load_damping_clearance_changes is SETTING_WITHOUT_CHANGES
            else read_only_array(
                np.dot(
                    self.load_damping_clearance_changes.load_factor_or_harmonic_matrix,
                    unvaried_load_coefficients,
                )
            )
        )

    @cached_property
    def clearance(self) -> np.ndarray:
        """Clearance g0 of every pair: (n_pairs,) [m].

        Clearance added by :meth:`varied` is included. A single number is added to all pairs. An
        array has a number for each normal pair, so tangential pairs (:meth:`with_tangential_pairs`)
        keep their clearance.
        """
        clearance, added_clearance = (
            self.body.clearance.copy(),
            self.load_damping_clearance_changes.added_clearance,
        )
        clearance[: np.size(added_clearance) if np.ndim(added_clearance) else None] += (
            added_clearance
        )
        return read_only_array(clearance)

    @property
    def damping_multiplier(self) -> float:
        """Factor of the damping relative to that of :attr:`unvaried_structure`."""
        return self.load_damping_clearance_changes.damping_multiplier

    @cached_property
    def damping(self) -> Any:
        """ModalDamping, RayleighDamping, the matrix C [N s/m], or None (collective).

        The damping factor is included. A varied copy scales the matrix at the first request, since
        many copies never need it.
        """
        body_damping = self.body.damping
        if body_damping is None or self.damping_multiplier == 1.0:
            return body_damping
        if isinstance(body_damping, DampingRule):
            return body_damping.scaled(self.damping_multiplier)
        matrix = body_damping.copy()
        matrix.scale(self.damping_multiplier)
        return matrix

    @cached_property
    def clamp(self) -> ClampReactionData | None:
        """Inertia and load of the mesh, for the reaction at the clamp.

        None without a mesh, and after :meth:`with_added_load_harmonics`.
        """
        return self.body.clamp and self.body.clamp.with_weights(
            self.load_damping_clearance_changes.load_factor_or_harmonic_matrix
        )

    @cached_property
    def rotation(self) -> Any:
        """Terms that rotation adds to stiffness and load; None at rest.

        The terms include the structure at rest, varied like this structure: load factors, added
        clearance, damping factor.
        """
        return self.body.rotation and self.body.rotation.with_changed_rest_structure(
            self._apply_setting
        )

    @property
    def unvaried_structure(self) -> Structure:
        """Structure with the load, clearance and damping with which it was made."""
        return self._in_setting(SETTING_WITHOUT_CHANGES)

    @property
    def has_matrices(self) -> bool:
        """True unless the structure comes from a file of a prepared structure.

        Such a file has modes and static responses, but no mass and stiffness.
        """
        return not isinstance(self.stiffness, AbsentMatrix)

    def compute_once(
        self, compute: Callable[[Any], Result], *, from_matrices: bool = False
    ) -> Result:
        """Return ``compute(original)``, computed once for all varied copies.

        Parameters
        ----------
        compute : callable
            Function of a structure.
        from_matrices : bool
            True if the result depends on mass, stiffness and pairs alone. Structures that share
            these three but have another load then share the result, too.
        """
        cache = self.body.cache_of_matrix_results if from_matrices else self.body.result_cache
        if compute not in cache:
            cache[compute] = compute(self.unvaried_structure)
        result: Result = cache[compute]
        return result

    def _in_setting(self, setting: LoadDampingClearanceSetting, **changes: Any) -> Self:
        """Return a copy with other factors of load and damping, and another added clearance.

        Parameters
        ----------
        setting : LoadDampingClearanceSetting
            Factors and added clearance.
        **changes
            New values for fields of the body (:class:`Body`). Any change drops cached results.
            Results that depend on matrices and pairs alone are dropped only if a change concerns
            matrices or pairs.
        """
        if setting is self.load_damping_clearance_changes and not changes:
            return self
        new_structure, body = object.__new__(type(self)), self.body
        if changes:
            new_caches: dict[str, Any] = {"result_cache": {}}
            if not changes.keys() <= FIELD_NAMES_THAT_KEEP_MATRIX_CACHE:
                new_caches["cache_of_matrix_results"] = {}
            body = replace(body, **new_caches | changes)
        Structure.__init__(new_structure, body)
        vars(new_structure)["load_damping_clearance_changes"] = setting
        return new_structure

    def _apply_setting(self, structure: AnyStructure) -> AnyStructure:
        """Return another structure, also varied by this structure's setting.

        Factors of load and damping multiply, clearances add.
        """
        return (
            structure
            if self.load_damping_clearance_changes is SETTING_WITHOUT_CHANGES
            else structure._in_setting(
                structure.load_damping_clearance_changes.combine_with(
                    self.load_damping_clearance_changes
                )
            )
        )

    def gap_of(self, displacement: np.ndarray) -> np.ndarray:
        """Return the Fourier coefficients of the pairs' gaps on every rank (collective).

        The gaps are g = B^T u - g0, with the gap matrix B and the clearance g0.

        Parameters
        ----------
        displacement : (2H+1, n_local) [m]
            Fourier coefficients of u.

        Returns
        -------
        (2H+1, n_pairs) [m]
        """
        gap: np.ndarray = self.apply_bt(displacement)
        gap[0] -= self.clearance
        return gap

    def known_omega_and_shapes(self, *, is_bonded: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the modes that a reduced structure knows without a solver, else None.

        A structure that is not reduced knows none. The results are frequencies and mode shapes.

        Parameters
        ----------
        is_bonded : bool
            True for a bonded crack, False for an open one.

        Returns
        -------
        omega : (m,) [rad/s]
        shapes : (n_local, m)
        """
        return None

    # --- sectors of a bladed disk; any other structure is its only sector -------------------------

    @property
    def n_sectors(self) -> int:
        """Number of sectors of a bladed disk that is not reduced; 1 of other structures."""
        return 1

    @property
    def sector_structure(self) -> Structure:
        """One sector of a bladed disk, or the structure itself."""
        return self

    @property
    def watched_sector_index(self) -> int:
        """Index of the sector with the watched dof, from 0; always 0 without sectors."""
        return 0

    def dof_of(self, blade: int, dof: int) -> int:
        """Return the structure's dof for a dof of the sector ``blade``, numbered from 1.

        Any structure but a bladed disk is its only sector, so the dof itself is returned.
        """
        return dof

    def blade_and_sector_dof_of(self, dof: int) -> tuple[int, int]:
        """Return the sector of a dof of the structure, and the dof's number in this sector.

        Sectors are numbered from 1.

        Any structure but a bladed disk is its only sector, number 1.
        """
        return 1, dof

    def structure_in_few_coordinates(self) -> Structure:
        """Return a bladed disk reduced to modes and crack openings (collective).

        The coordinates are described in ``disk/wheel.py``. Any other structure is
        returned itself.
        """
        return self

    def iterate_sector_displacements(self, displacement: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the displacement (m, n) of each sector, from coordinates (m, n_local).

        Any structure but a bladed disk is its only sector.
        """
        yield displacement

    def watched_sector_load_rows(self, structure: Structure, rows: slice) -> np.ndarray:
        """Return the load's Fourier coefficients on the sector with the watched dof.

        A structure without sectors returns the whole load.

        Parameters
        ----------
        structure : Structure
            This structure, or a reduction of it, whose coordinates are loaded.
        rows : slice
            Selects m rows of :attr:`force`: 0 for the mean load, 2k-1 and 2k for the cosine and
            sine of harmonic k.

        Returns
        -------
        (m, structure.n_local) [N]
        """
        return structure.force[rows]

    @cached_property
    def damping_matrix(self) -> Any:
        """Damping matrix C [N s/m] of a given matrix or of Rayleigh damping (collective).

        None for modal damping, and without damping. Rayleigh's matrix is formed at the first
        request.
        """
        damping = self.damping
        if isinstance(damping, RayleighDamping):
            return damping.matrix(self.mass, self.stiffness)
        return None if isinstance(damping, DampingRule) else damping

    def lumped(self) -> Structure:
        """Return this structure with the row sums of the mass as a diagonal mass.

        Modal damping then acts on the modes with the diagonal mass, and Rayleigh damping is a times
        the diagonal mass plus b times the stiffness.

        Raises
        ------
        InputError
            A row sum is not positive, as for six-node triangles.
        """
        return _change_with_rotation(
            self,
            lambda structure: structure._plain_structure_with_changes(
                mass=lump_mass(structure.mass)
            ),
        )

    def tied(self, stiffness: float | np.ndarray) -> Structure:
        """Return this structure with every pair connected by a spring k [N/m].

        The stiffness K becomes K + B diag(k) B^T, with the gap matrix B; no contact pairs are left.
        Modal damping follows the new modes, Rayleigh damping the new stiffness.

        Parameters
        ----------
        stiffness : float or (n_pairs,) [N/m]
            k.

        Raises
        ------
        InputError
            The stiffness is not one finite number >= 0, or one for each pair.
        """
        spring_stiffnesses = expand_to_pairs("stiffness", stiffness, self.n_pairs)
        if np.any(spring_stiffnesses < 0.0):
            raise InputError("stiffness", stiffness, ">= 0, as springs hold the pairs together")
        empty_gap_matrix = sparse.csr_matrix((self.n_local, 0))

        def bond_pairs(structure: Structure) -> Structure:
            """Return a structure with the springs, and without contact pairs."""
            bonded_stiffness = add_springs(structure.stiffness, structure.gap, spring_stiffnesses)
            return structure._plain_structure_with_changes(
                stiffness=bonded_stiffness,
                gap=empty_gap_matrix,
                tangential=None,
                clearance=np.zeros(0),
                pairs=Pairs(),
            )

        return _change_with_rotation(self, bond_pairs)

    def with_added_load_harmonics(self, harmonics: Mapping[int, tuple[Any, Any]]) -> Structure:
        """Return this structure with further harmonics of its load.

        Parameters
        ----------
        harmonics : dict of int to (cosine, sine)
            Amplitudes f_c and f_s of f_c cos(k w t) + f_s sin(k w t) by the order k, with the
            load's frequency w: (n,) [N] or None, whole on every rank. The load's own harmonics
            stay, and add up with equal orders. The result has no :attr:`clamp`.

        Raises
        ------
        InputError
            An order or a shape does not fit. Or the structure is reduced: its load follows from the
            whole one.
        """
        if self.whole is not self:
            raise InputError(
                "structure", repr(self), "a structure that is not reduced, as structure.whole"
            )
        load_coefficients = add_harmonics_to_load(self.force, harmonics, self.mass)
        return self._in_setting(
            replace(self.load_damping_clearance_changes, load_factor_or_harmonic_matrix=1.0),
            force=load_coefficients,
            clamp=None,
        )

    def with_tangents(self) -> Structure:
        """Return this structure with the tangential gaps of a solid's pairs.

        The matrix ``tangential`` is then (n_local, 2 n_pairs): all pairs along their first
        directions, then along their second. The structure itself is returned if it has tangential
        gaps already, or if its mesh gives none.

        Raises
        ------
        InputError
            The structure was reduced without tangential gaps.
        """
        if self.tangential is not None or self.pairs.tangential_gap_matrix is None:
            return self
        if self is not self.whole:
            requirement = "a structure that is not reduced; reduce structure.whole.with_tangents()"
            raise InputError("structure", repr(self), requirement)
        return self.compute_once(_add_tangents)._in_setting(self.load_damping_clearance_changes)

    def with_tangential_pairs(self, direction: np.ndarray | None = None) -> Structure:
        """Return this structure with tangential gaps as further pairs.

        The new gap matrix is [B, B_t], (n_local, 2 n_pairs). B has the normal gaps, and B_t one
        tangential gap for each pair. Tangential gaps have no clearance.

        Parameters
        ----------
        direction : (n_pairs,) [rad] or None
            In a solid: angle phi of each pair's sliding line, from the pair's first tangential
            direction to its second. B_t is then cos(phi) B_1 + sin(phi) B_2, with the matrices B_1
            and B_2 of both directions. None for a plate.

        Raises
        ------
        InputError
            The structure has no tangential gaps. Or ``direction`` is missing for a solid, or given
            for a plate.
        """
        if self.tangential is None:
            requirement = "a structure with tangents, as structure.with_tangents() of a solid"
            raise InputError("structure", repr(self), requirement)
        if (self.tangential.shape[1] > self.n_pairs) != (direction is not None):
            requirement = (
                "given for a solid, as fc.slide_along_lines(structure, omega, contact) finds it; "
                "None for a plate"
            )
            raise InputError("direction of friction", direction, requirement)
        direction_and_structure_cache = self.compute_once(_make_empty_tangential_pairs_cache)
        if not direction_and_structure_cache or not np.array_equal(
            direction_and_structure_cache[0][0], direction
        ):
            original = self.unvaried_structure
            direction_and_structure_cache[:] = [
                (direction, _add_tangential_pairs(original, direction))
            ]
        return direction_and_structure_cache[0][1]._in_setting(self.load_damping_clearance_changes)

    def with_parallel_copy_of_pairs(self, clearance: float) -> Structure:
        """Return this structure with every pair twice, for a law with two springs per pair.

        The gap matrix B becomes [B, B], (n_local, 2 n_pairs). The second copy of each pair has
        ``clearance`` [m] in addition.
        """
        added_clearances_of_both_copies = np.add.outer(
            (0.0, clearance),
            expand_to_pairs(
                "clearance", self.load_damping_clearance_changes.added_clearance, self.n_pairs
            ),
        )
        return self.compute_once(_add_parallel_copy_of_pairs)._in_setting(
            replace(
                self.load_damping_clearance_changes,
                added_clearance=added_clearances_of_both_copies.ravel(),
            )
        )

    def with_places(self, nodes: Nodes | None, pairs: Pairs) -> Structure:
        """Return this structure with other data on the mesh: ``nodes`` and ``pairs``."""
        return self._plain_structure_with_changes(nodes=nodes, pairs=pairs)

    def damped(self, damping: DampingRule | None) -> Self:
        """Return this structure with another modal or Rayleigh damping, or none (None).

        A factor by which the old damping was multiplied (``damping_multiplier``) does not apply to
        the new damping. In a reduced structure, the damping holds for the modes of the reduction.
        """
        if not isinstance(damping, DampingRule | None):
            raise InputError("damping", damping, "a ModalDamping, a RayleighDamping or None")
        new_damping = (
            damping.rule_for_n_modes(self.n_modes)
            if damping and self.has_massless_crack_faces
            else damping
        )
        setting, rotation = self.load_damping_clearance_changes, self.body.rotation
        if self.damping_multiplier != 1.0:
            setting = replace(setting, damping_multiplier=1.0)
        if rotation is not None:
            rotation = rotation.with_changed_rest_structure(
                lambda structure: structure.damped(damping)
            )
        return self._in_setting(setting, damping=new_damping, rotation=rotation)

    def watching(self, dof: int) -> Self:
        """Return this structure with another watched dof, for results without a named dof.

        ``dof`` is a number in the whole structure; InputError if there is no such dof.
        """
        checked_dof = int(self.whole.as_dof_numbers([dof])[0])
        return self._in_setting(
            replace(self.load_damping_clearance_changes, watched_dof=checked_dof)
        )

    def varied(
        self,
        *,
        load: float | np.ndarray = 1.0,
        damping: float = 1.0,
        clearance: float | np.ndarray = 0.0,
    ) -> Self:
        """Return this structure with its load and damping multiplied, and a clearance added.

        The copy shares matrices, and modes once they are computed. In a reduced structure, the
        whole one and the reference are varied too.

        Parameters
        ----------
        load : float or (2K+1, 2K+1)
            Factor, or matrix that maps the rows (mean, cosine and sine parts) to new ones. A
            structure that rotates keeps its mean load, which holds the centrifugal one.
        damping : float
            Factor >= 0.
        clearance : float or (n_pairs,) [m]
            Added to the clearance.

        Raises
        ------
        InputError
            A value cannot be used.
        """
        load_weights, n_load_rows = floats_or_single_nan(load), len(self.force)
        if load_weights.shape not in ((), (n_load_rows, n_load_rows)) or not np.all(
            np.isfinite(load_weights)
        ):
            requirement = (
                f"a finite number, or a finite matrix of shape ({n_load_rows}, {n_load_rows})"
            )
            raise InputError("load", load, requirement)
        if self.whole.rotation is not None and not _is_mean_kept(load_weights):
            requirement = (
                "1 for a rotating structure, whose mean load includes the centrifugal force"
            )
            raise InputError("load", load, requirement)
        check_number("damping", damping, 0.0)
        added_clearance = expand_to_pairs("clearance", clearance, self.n_pairs)
        return self._in_setting(
            self.load_damping_clearance_changes.combine_with(
                LoadDampingClearanceSetting(load_weights, damping, added_clearance)
            )
        )

    def _plain_structure_with_changes(self, **changes: Any) -> Structure:
        """Return a plain Structure with changed fields of the body.

        Load, clearance and damping are the present ones. Rotation and cached results are dropped.
        """
        copied_names = [
            body_field.name
            for body_field in fields(Body)
            if body_field.name not in UNCOPIED_FIELD_NAMES
        ]
        return Structure(Body(**({name: getattr(self, name) for name in copied_names} | changes)))

    @classmethod
    @run_single_threaded()
    @check_calls
    def from_matrices(
        cls,
        mass: Any,
        stiffness: Any,
        *,
        gap: Any,
        force_sin: Any = None,
        force_cos: Any = None,
        force_mean: Any = None,
        clearance: Any = 0.0,
        tangential: Any = None,
        damping: Any = None,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> Structure:
        """Make a structure from its matrices and load.

            M u'' + C u' + K u + B lambda(g) = f,        g = B^T u - g0

        u is the displacement, f the load, g the gap of each pair, and lambda the contact force.
        Crack faces touch where g > 0. So a column of B has 1 at the dof of the face that closes the
        pair by moving in the dof's direction. It has -1 at the other face's dof.

        Parameters
        ----------
        mass, stiffness : (n, n)
            NumPy, SciPy sparse, PETSc, or the path of a Matrix Market file; symmetric, the mass
            positive definite, the stiffness semidefinite; [kg], [N/m].
        gap : (n, n_pairs) or (n,)
            Gap matrix B; None: no pairs.
        force_sin, force_cos, force_mean : (n,) [N] or None
            Sine part, cosine part and mean of the load f. Sine and cosine part may have K columns,
            (n, K): column k is harmonic k.
        clearance : float or (n_pairs,) [m]
            g0; negative for preload.
        tangential : (n, n_pairs) or (n,)
            Matrix B_t of the tangential gaps B_t^T u, for friction. In space (n, 2 n_pairs): the
            first tangential direction of all pairs, then the second, at right angles to the first.
        damping : ModalDamping, RayleighDamping, (n, n) matrix or None
            Modal or Rayleigh damping, or the matrix C [N s/m] in the forms allowed for the mass.
        comm : MPI.Comm
            Ranks that share matrices given whole on every rank; PETSc matrices keep their own.

        Raises
        ------
        InputError
            A shape does not fit, an entry is not finite or larger than 1e60, a matrix is not
            symmetric, the mass is not positive definite, or the stiffness not semidefinite.
        """
        load_part_by_key = {
            "force_mean": force_mean,
            "force_cos": force_cos,
            "force_sin": force_sin,
        }
        part_by_name = check_and_distribute_parts(
            mass, stiffness, (gap, tangential), load_part_by_key, clearance, comm
        )
        if not isinstance(damping, DampingRule | None):
            mass_matrix = part_by_name["mass"]
            damping = make_petsc_matrix(
                "damping", damping, mass_matrix.comm.tompi4py(), mass_matrix.size[0]
            )
        return cls(Body(**part_by_name, damping=damping))


def _is_mean_kept(load_weights: np.ndarray) -> bool:
    """Return True if load weights keep the mean load.

    ``load_factor_or_harmonic_matrix`` is a factor of the load, or a matrix (2K+1, 2K+1) that maps
    the load's rows. The mean is kept if the factor is 1, or the matrix has the first row and column
    of I.
    """
    if load_weights.ndim == 0:
        return bool(load_weights == 1.0)
    return bool(
        load_weights[0, 0] == 1.0
        and not load_weights[0, 1:].any()
        and not load_weights[1:, 0].any()
    )


def _add_tangents(structure: Structure) -> Structure:
    """Return a structure with the tangential gaps that the mesh gives.

    In a rotating structure, the structure at rest (:attr:`Structure.rotation`) gets the gaps, too.
    """
    return _change_with_rotation(
        structure,
        lambda source: source._in_setting(
            source.load_damping_clearance_changes, tangential=source.pairs.tangential_gap_matrix
        ),
    )


def _make_empty_tangential_pairs_cache(
    structure: Structure,
) -> list[tuple[np.ndarray | None, Structure]]:
    """Return an empty list, in which a structure caches a copy with tangential pairs.

    :meth:`Structure.with_tangential_pairs` stores the last copy there, with the ``direction`` for
    which the copy was made.
    """
    return []


def _add_tangential_pairs(structure: Structure, direction: np.ndarray | None) -> Structure:
    """Return a structure with tangential gaps as further pairs, after the normal ones.

    ``direction`` (n_pairs,) [rad] is the angle of each pair's sliding line in a solid, else None.
    """
    tangential_gap_matrix: Any = structure.tangential
    if direction is not None:
        direction_cosine_matrices = (
            sparse.diags(direction_cosines)
            for direction_cosines in (np.cos(direction), np.sin(direction))
        )
        tangential_gap_matrix = tangential_gap_matrix @ sparse.vstack([*direction_cosine_matrices])
    joint_gap_matrix = sparse.hstack([structure.gap, tangential_gap_matrix])
    clearances_of_all_pairs = np.concatenate([structure.clearance, np.zeros(structure.n_pairs)])
    return structure._in_setting(
        structure.load_damping_clearance_changes,
        gap=joint_gap_matrix,
        tangential=None,
        clearance=clearances_of_all_pairs,
    )


def _add_parallel_copy_of_pairs(structure: Structure) -> Structure:
    """Return a structure with every pair twice: all pairs, then all copies.

    A copy has the clearance of the original pair. Tangential gaps are doubled, too: all pairs twice
    along the first direction, and in a solid then twice along the second.
    """
    tangential_gap_matrix: Any = structure.tangential
    if tangential_gap_matrix is not None:
        pair_columns = np.arange(tangential_gap_matrix.shape[1]).reshape(-1, structure.n_pairs)
        tangential_gap_matrix = tangential_gap_matrix[:, np.tile(pair_columns, 2).ravel()]
    return structure._in_setting(
        structure.load_damping_clearance_changes,
        gap=sparse.hstack([structure.gap, structure.gap]),
        tangential=tangential_gap_matrix,
        clearance=np.tile(structure.clearance, 2),
    )


def _change_with_rotation(
    structure: Structure, change: Callable[[Structure], Structure]
) -> Structure:
    """Return a structure after ``change``, which maps a structure to a structure.

    In a rotating structure, ``change`` is also applied to the structure at rest
    (:attr:`Structure.rotation`).
    """
    rotation = structure.rotation and structure.rotation.with_changed_rest_structure(change)
    return change(structure)._in_setting(SETTING_WITHOUT_CHANGES, rotation=rotation)
