"""The structure: mass, stiffness, damping, load, and the gaps between the faces of the crack.

    M u'' + C u' + K u + B lambda(g) = f(t),     g = B^T u - g0

``g > 0`` is penetration, ``g < 0`` an open crack. Column j of B is +1 on the normal displacement
of the lower face's node and -1 on the upper face's. Matrices are PETSc's and distributed by rows;
every array that stands for a displacement holds the rows that this rank owns ("n_local"), which on
one rank are all.

A structure never changes: what is computed from it stays true. Copies that differ in load,
clearance, or a factor of the damping share its matrices, and its modes once they are computed.

Modal damping and Rayleigh's follow from mass and stiffness. Both are diagonal in the natural modes,
K phi_j = omega_j^2 M phi_j with phi_i^T M phi_j = delta_ij:

    phi_i^T C phi_j = 2 xi_j omega_j delta_ij.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib import import_module
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.basics.errors import InputError, check_count, check_number, check_two_ratios
from fenics_crack.basics.suggestions import checked_call
from fenics_crack.basics.tables import counted
from fenics_crack.basics.threads import alone
from fenics_crack.model.body import DEFAULT_SETTING, MATRIX_INDEPENDENT_NAMES, Body, Setting
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.matrices import (
    AbsentMatrix,
    add_harmonics,
    add_springs,
    check_parts,
    expand_to_pairs,
    lump_mass,
    make_petsc_matrix,
    numbers,
    read_only_array,
)
from fenics_crack.model.nodes import Clamp, Coordinates, Nodes, Pairs, body_property


@dataclass(frozen=True)
class ModalDamping:
    """Damping C = M Phi diag(2 xi_j omega_j) Phi^T M over mass-normalised modes; never formed.

    Attributes
    ----------
    ratio : float or tuple of float
        xi_j, of critical damping: one for all modes, or one per mode.
    modes : int or None
        Number of the lowest modes that are damped; None: all.

    Raises
    ------
    InputError
        A ratio is negative or not finite, or ``modes`` is no whole number >= 1.
    """

    ratio: float | Sequence[float]
    modes: int | None = None

    def __post_init__(self) -> None:
        ratio = numbers(self.ratio)
        if ratio.ndim > 1 or not ratio.size or not np.all(np.isfinite(ratio)) or ratio.min() < 0.0:
            raise InputError("damping ratio", self.ratio, "finite and >= 0, one or one per mode")
        if self.modes is not None:
            check_count("damping modes", self.modes, 1)
        object.__setattr__(self, "ratio", tuple(ratio.tolist()) if ratio.ndim else float(ratio))

    def scaled(self, factor: float) -> ModalDamping:
        """The same with every ratio multiplied by a factor."""
        ratio: Any = (factor * np.asarray(self.ratio)).tolist()
        return replace(self, ratio=ratio)

    def for_modes(self, count: int) -> ModalDamping:
        """Damping of so many kept modes: those beyond the damped ones by the last ratio."""
        if isinstance(self.ratio, float):
            return ModalDamping(self.ratio)
        ratio = list(self.ratio)[:count]
        return ModalDamping(tuple(ratio + ratio[-1:] * (count - len(ratio))))

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """2 xi omega [1/s] of the damped modes, with omega^2 (n,) [rad^2/s^2]."""
        return np.asarray(2.0 * np.asarray(self.ratio) * np.sqrt(np.maximum(squares, 0.0)))

    def __str__(self) -> str:
        percent = 100.0 * np.asarray(self.ratio)
        low, high = f"{percent.min():.3g}", f"{percent.max():.3g}"
        modes = "" if self.modes is None else f" of {self.modes} modes"
        return f"modal damping {low if low == high else f'{low} to {high}'} %{modes}"


@dataclass(frozen=True)
class RayleighDamping:
    """Damping C = a M + b K, which damps every mode by the ratio

        xi(omega) = a / (2 omega) + b omega / 2.

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
        """The damping with given ratios at two frequencies.

        With w_1 < w_2 and s = w_1 (xi_2 - xi_1) / (w_2 - w_1),

            a = 2 w_1 w_2 (xi_1 - s) / (w_1 + w_2),      b = 2 (xi_2 + s) / (w_1 + w_2).

        Between both frequencies the ratio is at most the larger of the two.

        Parameters
        ----------
        ratios : (2,)
            xi_1 and xi_2, of critical damping.
        omegas : (2,) [rad/s]
            The frequencies at which they hold.

        Raises
        ------
        InputError
            The ratios are not two numbers >= 0, the frequencies not two different ones > 0, or a
            coefficient would be negative.

        Notes
        -----
        Source: Clough and Penzien, Dynamics of Structures, 2nd edition, McGraw-Hill, New York 1993.
        """
        xi, omega = numbers(ratios), numbers(omegas)
        if xi.shape != (2,) or not np.all(np.isfinite(xi)) or xi.min() < 0.0:
            raise InputError("damping ratios", ratios, "two finite numbers >= 0")
        known = omega.shape == (2,) and np.all(np.isfinite(omega))
        if not known or omega.min() <= 0.0 or omega[0] == omega[1]:
            raise InputError("damping omegas", omegas, "two different finite numbers > 0")
        ratio, place = [float(x) for x in xi], [float(w) for w in omega]
        check_two_ratios("damping ratios", ratio, place)
        (low, at_low), (high, at_high) = sorted(zip(place, ratio, strict=True))
        slope = low / (high - low) * (at_high - at_low)
        mean = 0.5 * (low + high)
        mass, stiffness = low / mean * high * (at_low - slope), (at_high + slope) / mean
        return cls(max(mass, 0.0), max(stiffness, 0.0))  # not below 0 by rounding

    def scaled(self, factor: float) -> RayleighDamping:
        """The same with both coefficients multiplied by a factor."""
        return RayleighDamping(factor * self.mass, factor * self.stiffness)

    def for_modes(self, count: int) -> RayleighDamping:
        """Damping of so many kept modes: its own."""
        return self

    def rate(self, squares: np.ndarray) -> np.ndarray:
        """2 xi omega = a + b omega^2 [1/s] of modes with omega^2 (n,) [rad^2/s^2]."""
        return self.mass + self.stiffness * squares

    def matrix(self, mass: Any, stiffness: Any) -> Any:
        """C of PETSc's M and K, as sparse as both (collective)."""
        part = mass.copy()
        part.scale(self.mass)
        total = weighted_sum(part, self.stiffness, stiffness)
        part.destroy()
        return total

    def __str__(self) -> str:
        return f"Rayleigh damping {self.mass:.3g}/s M + {self.stiffness:.3g} s K"


DampingRule = ModalDamping | RayleighDamping
"""Damping that follows from mass and stiffness."""


UNCOPIED_NAMES = {"rotation", "cached_results", "matrix_results"}
"""Attributes of a body that one with other matrices has not."""
Result = TypeVar("Result")


def shared_property(compute: Callable[[Any], Any]) -> Any:
    """A property: what is computed from :attr:`Structure.original` once, for all varied copies."""
    return property(lambda structure: structure.cached_result(compute), doc=compute.__doc__)


AnyStructure = TypeVar("AnyStructure", bound="Structure")


class Structure(Coordinates):
    """A linear structure with contact pairs; none of its attributes can be set.

    Made by :func:`fenics_crack.build_structure` from a scene, by :meth:`from_matrices` or by
    :meth:`from_forms`. It is a body, which varied copies share, in a setting, which is theirs
    (``model/body.py``).

    Attributes
    ----------
    comm, gap, tangential, force, nodes, pairs, watched
        As of :class:`fenics_crack.model.nodes.Coordinates`.
    mass, stiffness : PETSc.Mat
        (n, n), symmetric; [kg], [N/m].
    clearance : (n_pairs,) [m]
        g0 of every pair; positive: an opening that closes first, negative: preload.
    damping_factor : float
        Factor of the damping relative to that of :attr:`original`; 1 unless varied.
    clamp : fenics_crack.model.nodes.Clamp or None
        Clamp of a mesh; None of matrices, and of a reduced structure, whose whole one has it.
    rotation : fenics_crack.model.rotation.Rotation or None
        Terms that rotation has added to the matrices and the mean load; None at rest.
    """

    body: Body
    setting: Setting
    stiffness: Any = body_property("stiffness")
    light_lips: ClassVar[bool] = False
    """True if crack faces have no mass: the residual flexibility of the modes gives the
    quasi-static response to forces on the pairs."""

    def __init__(self, body: Body) -> None:
        vars(self).update(body=body, setting=DEFAULT_SETTING)

    def __repr__(self) -> str:
        pairs, damping = counted(self.n_pairs, "pair"), self.body.damping
        words = "no damping" if damping is None else "damping matrix"
        if isinstance(damping, DampingRule):
            words = str(damping.scaled(self.damping_factor))
        return f"{type(self).__name__}({self._size_words}, {pairs}, {words})"

    @cached_property
    def force(self) -> np.ndarray:  # type: ignore[override]
        """Load, weighted."""
        given = self.body.force
        return (
            given
            if self.setting is DEFAULT_SETTING
            else read_only_array(np.dot(self.setting.weights, given))
        )

    @cached_property
    def clearance(self) -> np.ndarray:
        """g0 of every pair, with what is added; nothing to tangential ones."""
        found, added = self.body.clearance.copy(), self.setting.clearance
        found[: np.size(added) if np.ndim(added) else None] += added
        return read_only_array(found)

    @property
    def damping_factor(self) -> float:
        """Factor of the damping relative to that of :attr:`original`."""
        return self.setting.damping_factor

    @cached_property
    def damping(self) -> Any:
        """ModalDamping, RayleighDamping, the matrix C [N s/m], or None (collective).

        A varied copy computes it when it is first requested: many copies never are.
        """
        given = self.body.damping
        if given is None or self.damping_factor == 1.0:
            return given
        if isinstance(given, DampingRule):
            return given.scaled(self.damping_factor)
        matrix = given.copy()
        matrix.scale(self.damping_factor)
        return matrix

    @cached_property
    def clamp(self) -> Clamp | None:
        """Clamp of a mesh, under the weighted load."""
        return self.body.clamp and self.body.clamp.with_weights(self.setting.weights)

    @cached_property
    def rotation(self) -> Any:
        """Terms of rotation, about a structure at rest in the same setting."""
        return self.body.rotation and self.body.rotation.change_rest_structure(self._apply_setting)

    @property
    def original(self) -> Structure:
        """The structure of which this is a varied copy, or itself."""
        return self._in_setting(DEFAULT_SETTING)

    @property
    def has_matrices(self) -> bool:
        """False if it is that of a file of a prepared structure."""
        return not isinstance(self.stiffness, AbsentMatrix)

    def cached_result(
        self, compute: Callable[[Any], Result], *, from_matrices: bool = False
    ) -> Result:
        """A result computed from :attr:`original` once, for it and all of its varied copies; what
        follows from mass, stiffness and pairs alone, for all that share these."""
        cache = self.body.matrix_results if from_matrices else self.body.cached_results
        if compute not in cache:
            cache[compute] = compute(self.original)
        result: Result = cache[compute]
        return result

    def _in_setting(self, setting: Setting, **changes: Any) -> Self:
        """The same body in another setting; with changes another body, of which nothing is known
        yet but what follows from its matrices, where these stay."""
        if setting is self.setting and not changes:
            return self
        made, body = object.__new__(type(self)), self.body
        if changes:
            caches: dict[str, Any] = {"cached_results": {}}
            if not changes.keys() <= MATRIX_INDEPENDENT_NAMES:
                caches["matrix_results"] = {}
            body = replace(body, **caches | changes)
        Structure.__init__(made, body)
        vars(made)["setting"] = setting
        return made

    def _apply_setting(self, other: AnyStructure) -> AnyStructure:
        """Another structure, varied as this one is."""
        return (
            other
            if self.setting is DEFAULT_SETTING
            else other._in_setting(other.setting.combine_with(self.setting))
        )

    def gap_of(self, displacement: np.ndarray) -> np.ndarray:
        """Coefficients of g = B^T u - g0 from those of u (2H+1, n_local): (2H+1, n_pairs)
        (collective)."""
        gap: np.ndarray = self.apply_bt(displacement)
        gap[0] -= self.clearance
        return gap

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """omega (m,) [rad/s] and shapes (n_local, m) with the crack open or bonded where the
        coordinates are those of modes, else None."""
        return None

    @cached_property
    def damping_matrix(self) -> Any:
        """C where damping is a matrix or Rayleigh's, else None (collective).

        Rayleigh's is formed when it is first requested.
        """
        damping = self.damping
        if isinstance(damping, RayleighDamping):
            return damping.matrix(self.mass, self.stiffness)
        return None if isinstance(damping, DampingRule) else damping

    def lumped(self) -> Structure:
        """Return this structure with the diagonal mass of the row sums of M.

        Modal damping then follows the modes with that mass, and Rayleigh damping that mass.

        Raises
        ------
        InputError
            A row sum is not positive, as for six-node triangles.
        """
        return _change_with_rotation(self, lambda one: one._with_changes(mass=lump_mass(one.mass)))

    def tied(self, stiffness: float | np.ndarray) -> Structure:
        """Return this structure with every pair connected by a spring k [N/m].

        Its stiffness is K + B diag(k) B^T, and it has no pairs; modal damping follows the new
        modes, Rayleigh damping the new stiffness.
        InputError: the stiffness is not one finite number >= 0, or one for each pair.
        """
        springs = expand_to_pairs("stiffness", stiffness, self.n_pairs)
        if np.any(springs < 0.0):
            raise InputError("stiffness", stiffness, ">= 0: springs that hold the pairs together")
        gap = sparse.csr_matrix((self.n_local, 0))

        def held(one: Structure) -> Structure:
            matrix = add_springs(one.stiffness, one.gap, springs)
            return one._with_changes(
                stiffness=matrix, gap=gap, tangential=None, clearance=np.zeros(0), pairs=Pairs()
            )

        return _change_with_rotation(self, held)

    def with_harmonics(self, harmonics: Mapping[int, tuple[Any, Any]]) -> Structure:
        """Return this structure with further harmonics of its load.

        Parameters
        ----------
        harmonics : dict of int to (cosine, sine)
            By their orders k, multiples of the load's frequency: f_c and f_s of f_c cos(k w t) +
            f_s sin(k w t), (n,) [N] or None, whole on every rank; of the first it is added.

        Raises
        ------
        InputError
            An order or a shape does not fit; or the structure is reduced, whose load is that of
            the whole one.
        """
        if self.whole is not self:
            raise InputError("structure", repr(self), "one that is not reduced")
        force = add_harmonics(self.force, harmonics, self.mass)
        return self._in_setting(replace(self.setting, weights=1.0), force=force, clamp=None)

    def with_tangents(self) -> Structure:
        """This structure with the tangential gaps of a solid's pairs, B_t (n_local, 2 n_pairs):
        along the first directions of all pairs, then along the second ones; itself if it has
        tangents, or none are known.

        Raises
        ------
        InputError
            It is reduced, and was not with them.
        """
        if self.tangential is not None or self.pairs.tangents is None:
            return self
        if self is not self.whole:
            allowed = "a whole one: reduce structure.whole.with_tangents()"
            raise InputError("structure", repr(self), allowed)
        return self.cached_result(_add_tangents)._in_setting(self.setting)

    def with_tangential_pairs(self, direction: np.ndarray | None = None) -> Structure:
        """This structure with tangential gaps behind the normal ones as further pairs, B = [B_n,
        B_t] (n_local, 2 n_pairs), without a clearance: all gaps on which contact with friction
        acts.

        Parameters
        ----------
        direction : (n_pairs,) [rad] or None
            Of a solid's pairs: the angle phi of B_t = cos(phi) B_1 + sin(phi) B_2.

        Raises
        ------
        InputError
            It has no tangents, or two directions a pair, and none is given.
        """
        if self.tangential is None:
            allowed = "one with tangents; with_tangents() of a solid has them"
            raise InputError("structure", repr(self), allowed)
        if (self.tangential.shape[1] > self.n_pairs) != (direction is not None):
            allowed = "given on solids alone: fc.slide_along_lines(structure, omega, contact)"
            raise InputError("direction of friction", direction, allowed)
        held = self.cached_result(_tangential_pair_cache)
        if not held or not np.array_equal(held[0][0], direction):
            original = self.original
            held[:] = [(direction, _add_tangential_pairs(original, direction))]
        return held[0][1]._in_setting(self.setting)

    def with_places(self, nodes: Nodes | None, pairs: Pairs) -> Structure:
        """Return this structure with the places of its nodes and pairs."""
        return self._with_changes(nodes=nodes, pairs=pairs)

    def damped(self, damping: DampingRule | None) -> Self:
        """Return this structure with another modal or Rayleigh damping, or none.

        Of a reduced structure it is that of its own coordinates or modes.
        """
        if not isinstance(damping, DampingRule | None):
            raise InputError("damping", damping, "a ModalDamping, a RayleighDamping or None")
        kept = damping.for_modes(self.n_modes) if damping and self.light_lips else damping
        setting, rotation = self.setting, self.body.rotation
        if self.damping_factor != 1.0:
            setting = replace(setting, damping_factor=1.0)
        if rotation is not None:
            rotation = rotation.change_rest_structure(lambda one: one.damped(damping))
        return self._in_setting(setting, damping=kept, rotation=rotation)

    def watching(self, dof: int) -> Self:
        """Return this structure with another dof for results to be asked about."""
        checked_dof = int(self.whole.check_dofs([dof])[0])
        return self._in_setting(replace(self.setting, watched_dof=checked_dof))

    def varied(
        self,
        *,
        load: float | np.ndarray = 1.0,
        damping: float = 1.0,
        clearance: float | np.ndarray = 0.0,
    ) -> Self:
        """Return this structure with its load and damping multiplied, and a clearance added.

        The copy shares matrices, and modes once they are computed. Of a reduced structure the whole
        one and the reference are varied too.

        Parameters
        ----------
        load : float or (2K+1, 2K+1)
            Factor, or the matrix that maps its rows, mean, cosine and sine parts, to the new ones.
            Where the structure rotates the mean load stays, which holds the centrifugal one.
        damping : float
            Factor >= 0.
        clearance : float or (n_pairs,) [m]
            Terms that are added.

        Raises
        ------
        InputError
            A value cannot be used.
        """
        weights, rows = numbers(load), len(self.force)
        if weights.shape not in ((), (rows, rows)) or not np.all(np.isfinite(weights)):
            allowed = f"a finite number, or a finite matrix of shape ({rows}, {rows})"
            raise InputError("load", load, allowed)
        if self.whole.rotation is not None and not _is_mean_kept(weights):
            allowed = "1 for a structure that rotates: part of its mean load is centrifugal"
            raise InputError("load", load, allowed)
        check_number("damping", damping, 0.0)
        added = expand_to_pairs("clearance", clearance, self.n_pairs)
        return self._in_setting(self.setting.combine_with(Setting(weights, damping, added)))

    def _with_changes(self, **changes: Any) -> Structure:
        """A structure of its matrices and places, with some changed."""
        names = [item.name for item in fields(Body) if item.name not in UNCOPIED_NAMES]
        return Structure(Body(**({name: getattr(self, name) for name in names} | changes)))

    @classmethod
    @alone()
    @checked_call
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
        """Make a structure from its matrices.

        Parameters
        ----------
        mass, stiffness : (n, n)
            NumPy, SciPy sparse, PETSc, or the path of a Matrix Market file; symmetric, the mass
            positive definite, the stiffness semidefinite; [kg], [N/m].
        gap : (n, n_pairs) or (n,)
            B; None: no pairs.
        force_sin, force_cos, force_mean : (n,) [N] or None
            Load on the first harmonic, and its mean; of more columns (n, K) column k has k times
            the frequency.
        clearance : float or (n_pairs,) [m]
            g0; negative for preload.
        tangential : (n, n_pairs) or (n,)
            B_t, for friction; (n, 2 n_pairs) along two directions at right angles of all pairs.
        damping : ModalDamping, RayleighDamping, (n, n) matrix or None
            Modal or Rayleigh damping, or C [N s/m] in any of the forms above.
        comm : MPI.Comm
            Ranks that share matrices given whole on every rank; PETSc matrices keep their own.

        Raises
        ------
        InputError
            A shape does not fit, an entry is not finite or larger than 1e60, a matrix is not
            symmetric, the mass is not positive definite, or the stiffness not semidefinite.
        """
        forces = {"force_mean": force_mean, "force_cos": force_cos, "force_sin": force_sin}
        parts = check_parts(mass, stiffness, (gap, tangential), forces, clearance, comm)
        if not isinstance(damping, DampingRule | None):
            made = parts["mass"]
            damping = make_petsc_matrix("damping", damping, made.comm.tompi4py(), made.size[0])
        return cls(Body(**parts, damping=damping))

    @classmethod
    @alone()
    @checked_call
    def from_forms(
        cls,
        space: Any,
        stiffness: Any,
        mass: Any,
        *,
        bcs: Any = (),
        loads: Any = None,
        crack: Any = None,
        thickness: float = 1.0,
        clearance: Any = 0.0,
        damping: Any = None,
    ) -> Structure:
        """Make a structure from UFL forms on a mesh of DOLFINx (collective).

        Parameters
        ----------
        space : dolfinx.fem.FunctionSpace
            Displacements: vectors, Lagrange elements of order 1 or 2, on a mesh of a plane or of a
            solid.
        stiffness, mass : ufl.Form
            Symmetric bilinear forms on it, without the conditions; the mass positive definite, the
            stiffness semidefinite. In a plane they hold the thickness.
        bcs : list of dolfinx.fem.DirichletBC
            Conditions on the space or its components, all of value zero.
        loads : (mean, sin, cos) or None
            Linear forms, or None for a part that is zero: mean, and first harmonic.
        crack : (facet_tags, lower, upper) or None
            Tags of the mesh's facets, and those of the two faces of all cracks: exterior facets in
            the same places, with different nodes but for those of tips and fronts.
        thickness : float [m]
            In a plane, for the areas of the contact pairs.
        clearance : float or (n_pairs,) [m]
            g0; negative for preload.
        damping : ModalDamping, RayleighDamping, ufl.Form or None
            Modal or Rayleigh damping, or the bilinear form of C.

        Raises
        ------
        InputError
            The space, a condition, a form or the tags are not such, nodes of the two faces do not
            match, or a matrix is none for :meth:`from_matrices`.
        """
        bilinear = {"stiffness": stiffness, "mass": mass}
        if not isinstance(damping, DampingRule | None):
            bilinear["damping"] = damping
        # That file loads DOLFINx, which matrices do not need, and is above this folder.
        forms = import_module("fenics_crack.fem.forms")
        parts, *places = forms.parts_of_forms(space, bilinear, bcs, loads, crack, thickness)
        made = cls.from_matrices(**{"damping": damping} | parts, clearance=clearance)
        for key in bilinear:
            parts[key].destroy()
        return made.with_places(*places)


def _is_mean_kept(weights: np.ndarray) -> bool:
    """True if weights of a load leave its mean as it is."""
    if weights.ndim == 0:
        return bool(weights == 1.0)
    return bool(weights[0, 0] == 1.0 and not weights[0, 1:].any() and not weights[1:, 0].any())


def _add_tangents(structure: Structure) -> Structure:
    return _change_with_rotation(
        structure, lambda one: one._in_setting(one.setting, tangential=one.pairs.tangents)
    )


def _tangential_pair_cache(structure: Structure) -> list[tuple[np.ndarray | None, Structure]]:
    """The structure with tangential gaps as pairs, and their directions, requested last."""
    return []


def _add_tangential_pairs(structure: Structure, direction: np.ndarray | None) -> Structure:
    tangents: Any = structure.tangential
    if direction is not None:
        turn = (sparse.diags(part) for part in (np.cos(direction), np.sin(direction)))
        tangents = tangents @ sparse.vstack([*turn])
    both = sparse.hstack([structure.gap, tangents])
    clearance = np.concatenate([structure.clearance, np.zeros(structure.n_pairs)])
    return structure._in_setting(structure.setting, gap=both, tangential=None, clearance=clearance)


def _change_with_rotation(
    structure: Structure, change: Callable[[Structure], Structure]
) -> Structure:
    """A structure changed, and so what it is at rest where it rotates."""
    rotation = structure.rotation and structure.rotation.change_rest_structure(change)
    return change(structure)._in_setting(DEFAULT_SETTING, rotation=rotation)
