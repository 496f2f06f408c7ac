"""The structure: mass, stiffness, damping, load, and the gaps between the lips of the crack.

    M u'' + C u' + K u + B lambda(g) = f(t),     g = B^T u - g0

``g > 0`` is penetration, ``g < 0`` an open crack. Column j of B is +1 on the normal displacement
of the lower lip's node and -1 on the upper lip's. Matrices are PETSc's and distributed by rows;
every array that stands for a displacement holds the rows that this rank owns ("n_local"), which on
one rank are all.

A structure never changes: what is computed from it stays true. Copies that differ in load,
clearance, or a factor of the damping share its matrices, and its modes once they are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.errors import InputError, check_number
from fenics_crack.model.damping import DampingRule, RayleighDamping
from fenics_crack.model.matrices import (
    checked,
    lumped_mass,
    numbers,
    per_pair,
    petsc_matrix,
    with_springs,
)
from fenics_crack.model.nodes import Clamp, Coordinates, Nodes, Pairs
from fenics_crack.one_thread import alone
from fenics_crack.table import counted

__all__ = ["Structure"]

Found = TypeVar("Found")


class Structure(Coordinates):
    """A linear structure with contact pairs; none of its attributes can be set.

    Made by :func:`fenics_crack.build_structure` from a scene or by :meth:`from_matrices`.

    Attributes
    ----------
    comm, gap, force, nodes, pairs, watched
        As of :class:`fenics_crack.model.nodes.Coordinates`.
    mass, stiffness : PETSc.Mat
        (n, n), symmetric; [kg], [N/m].
    clearance : (n_pairs,) [m]
        g0 of every pair; positive: an opening that closes first, negative: preload.
    damping_factor : float
        Factor of the damping relative to that of :attr:`original`; 1 unless varied.
    clamp : fenics_crack.model.nodes.Clamp or None
        What holds a mesh; None of matrices, and of a reduced structure, whose whole one has it.
    rotation : fenics_crack.model.rotation.Rotation or None
        What rotation has added to the matrices and the mean load; None at rest.
    """

    stiffness: Any
    clearance: np.ndarray
    damping_factor: float
    clamp: Clamp | None
    rotation: Any = None

    _original: Structure | None
    """None: itself. A reference to itself would keep it alive."""
    _known: dict[Callable[[Structure], Any], Any]
    _VARIED_TOO: ClassVar[tuple[str, ...]] = ()
    _DAMPED_TOO: ClassVar[tuple[str, ...]] = ("rotation",)
    """Attributes that are varied, or damped, with this one."""
    light_lips: ClassVar[bool] = False
    """Whether lips have no mass: what the modes leave out answers forces on the pairs at once."""

    def __init__(
        self,
        mass: Any,
        stiffness: Any,
        gap: sparse.spmatrix,
        *,
        force: np.ndarray,
        clearance: np.ndarray,
        damping: DampingRule | Any | None = None,
        nodes: Nodes | None = None,
        pairs: Pairs | None = None,
        watched: np.ndarray | None = None,
        clamp: Clamp | None = None,
    ) -> None:
        self._hold(
            mass=mass, stiffness=stiffness, force=force, clearance=clearance, damping=damping,
            nodes=nodes, pairs=pairs or Pairs(), watched=watched, clamp=clamp,
        )  # fmt: skip
        self._hold(gap=_read_only_rows(gap), _gap_transposed=_read_only_rows(gap.T))
        self._hold(comm=mass.comm.tompi4py(), damping_factor=1.0, _original=None, _known={})

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._size_words}, {_in_words(self)})"

    @cached_property
    def damping(self) -> Any:
        """ModalDamping, RayleighDamping, the matrix C [N s/m], or None (collective).

        A varied copy computes it when it is first asked for: many copies never are.
        """
        given = self.original.damping
        if given is None or self.damping_factor == 1.0:
            return given
        if isinstance(given, DampingRule):
            return given.scaled(self.damping_factor)
        matrix = given.copy()
        matrix.scale(self.damping_factor)
        return matrix

    @property
    def original(self) -> Structure:
        """The structure of which this is a varied copy, or itself."""
        return self._original or self

    def once(self, compute: Callable[[Structure], Found]) -> Found:
        """A result computed from :attr:`original` once, for it and all of its varied copies."""
        if compute not in self._known:
            self._known[compute] = compute(self.original)
        found: Found = self._known[compute]
        return found

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """omega (m,) [rad/s] and shapes (n_local, m) with lips open or tied where the coordinates
        are those of modes, else None."""
        return None

    @cached_property
    def damping_matrix(self) -> Any:
        """C where damping is a matrix or Rayleigh's, else None (collective).

        Rayleigh's is formed when it is first asked for.
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
        return self._changed(mass=lumped_mass(self.mass))

    def tied(self, stiffness: float | np.ndarray) -> Structure:
        """Return this structure with every pair tied by a spring k [N/m] that pulls and pushes.

        Its stiffness is K + B diag(k) B^T, and it has no pairs; modal damping follows the tied
        modes, Rayleigh damping the tied stiffness.
        """
        springs = per_pair("stiffness", stiffness, self.n_pairs)
        matrix = with_springs(self.stiffness, self.gap, springs)
        gap = sparse.csr_matrix((self.n_local, 0))
        return self._changed(stiffness=matrix, gap=gap, clearance=np.zeros(0), pairs=Pairs())

    def placed(self, nodes: Nodes, pairs: Pairs) -> Structure:
        """Return this structure with the places of its nodes and pairs."""
        return self._changed(nodes=nodes, pairs=pairs)

    def damped(self, damping: DampingRule | None) -> Self:
        """Return this structure with another modal or Rayleigh damping, or none.

        Of a reduced structure it is that of its own coordinates or modes.
        """
        if not isinstance(damping, DampingRule | None):
            raise InputError("damping", damping, "a ModalDamping, a RayleighDamping or None")
        kept = None if damping is None else self._of_kept(damping)
        parts = self._parts(self._DAMPED_TOO, lambda part: part.damped(damping))
        return self._copied(damping=kept, damping_factor=1.0, _original=None, _known={}, **parts)

    def _of_kept(self, damping: DampingRule) -> DampingRule:
        """The damping of what has mass."""
        return damping

    def watching(self, dof: int) -> Self:
        """Return this structure with another dof for results to be asked about."""
        found = int(self.whole.check_dofs([dof])[0])
        return self._copied(watched_dof=found, _original=self.original)

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
        load : float or (3, 3)
            Factor, or the matrix that maps mean, cosine and sine part to the new ones. Left out
            where the structure rotates, whose mean load holds the centrifugal one.
        damping : float
            Factor >= 0.
        clearance : float or (n_pairs,) [m]
            What is added.

        Raises
        ------
        InputError
            A value cannot be used.
        """
        weights = _weights(load)
        if self.whole.rotation is not None and not (weights.ndim == 0 and weights == 1.0):
            allowed = "1 for a structure that rotates: part of its mean load is centrifugal"
            raise InputError("load", load, allowed)
        check_number("damping", damping, 0.0)
        changes = {"load": load, "damping": damping, "clearance": clearance}
        return self._copied(
            force=np.dot(weights, self.force),
            clearance=self.clearance + per_pair("clearance", clearance, self.n_pairs),
            clamp=None if self.clamp is None else self.clamp.varied(weights),
            damping_factor=damping * self.damping_factor,
            _original=self.original,
            **self._parts(self._VARIED_TOO, lambda part: part.varied(**changes)),
        )

    def _parts(self, names: tuple[str, ...], change: Callable[[Any], Any]) -> dict[str, Any]:
        """Attributes that change with this structure, changed."""
        held = {name: getattr(self, name) for name in names}
        return {name: change(part) for name, part in held.items() if part is not None}

    def _changed(self, **changes: Any) -> Structure:
        kept = "mass stiffness gap force clearance damping nodes pairs watched clamp".split()
        return Structure(**({name: getattr(self, name) for name in kept} | changes))

    @classmethod
    @alone()
    def from_matrices(
        cls,
        mass: Any,
        stiffness: Any,
        gap: Any,
        *,
        force_sin: Any = None,
        force_cos: Any = None,
        force_mean: Any = None,
        clearance: Any = 0.0,
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
            Load on the first harmonic, and its mean.
        clearance : float or (n_pairs,) [m]
            g0; negative for preload.
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
        parts = checked(mass, stiffness, gap, forces, clearance, comm)
        if not isinstance(damping, DampingRule | None):
            made = parts["mass"]
            damping = petsc_matrix("damping", damping, made.comm.tompi4py(), made.size[0])
        return cls(**parts, damping=damping)


def _in_words(structure: Structure) -> str:
    """The pairs and the damping of a structure."""
    pairs, damping = counted(structure.n_pairs, "pair"), structure.original.damping
    if isinstance(damping, DampingRule):
        return f"{pairs}, {damping.scaled(structure.damping_factor)}"
    return f"{pairs}, {'no damping' if damping is None else 'damping matrix'}"


def _weights(load: Any) -> np.ndarray:
    """A factor of a load, or the matrix that maps its parts to others; checked."""
    weights = numbers(load)
    if weights.shape not in ((), (3, 3)) or not np.all(np.isfinite(weights)):
        raise InputError("load", load, "a finite number, or a finite matrix of shape (3, 3)")
    return weights


def _read_only_rows(matrix: Any) -> sparse.csr_matrix:
    """A sparse matrix by rows, read-only."""
    rows = sparse.csr_matrix(matrix, copy=True)
    rows.sum_duplicates()
    for part in (rows.data, rows.indices, rows.indptr):
        part.flags.writeable = False
    return rows
