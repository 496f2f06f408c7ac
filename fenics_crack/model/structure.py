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

from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property
from typing import Any, ClassVar, NoReturn, Self, TypeVar

import numpy as np
import scipy.sparse as sparse
from mpi4py import MPI

from fenics_crack.errors import InputError, check_number
from fenics_crack.model.damping import DampingRule, RayleighDamping
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.matrices import (
    check_positive_definite,
    check_semidefinite,
    check_symmetric,
    distributed,
    numbers,
    per_pair,
    petsc_matrix,
    read_only,
    whole_rows,
)
from fenics_crack.model.nodes import Nodes, Pairs
from fenics_crack.one_thread import alone
from fenics_crack.parallel import gather_rows

__all__ = ["Structure"]

Found = TypeVar("Found")


class Structure:
    """A linear structure with contact pairs; none of its attributes can be set.

    Made by :func:`fenics_crack.build_structure` from a scene or by :meth:`from_matrices`.

    Attributes
    ----------
    comm : MPI.Comm
        The ranks that share the structure.
    mass, stiffness : PETSc.Mat
        (n, n), symmetric; [kg], [N/m].
    gap : scipy.sparse.csr_matrix
        B, the rows owned by this rank: (n_local, n_pairs).
    force : (3, n_local) [N]
        Mean, cosine and sine part of the load on the first harmonic.
    clearance : (n_pairs,) [m]
        g0 of every pair; positive: an opening that closes first, negative: preload.
    nodes : Nodes or None
        Positions of the dofs where there is a mesh.
    pairs : Pairs
        Positions, areas and cracks of the contact pairs where there is a mesh.
    watched : (n_local,) or None
        What a displacement is multiplied by for the motion that is watched [m]; None: the dof that
        carries most of the load.
    damping_factor : float
        Factor of the damping relative to that of :attr:`original`; 1 unless varied.
    rotation : fenics_crack.model.rotation.Rotation or None
        What rotation has added to the matrices and the mean load; None at rest.
    """

    comm: MPI.Comm
    mass: Any
    stiffness: Any
    gap: sparse.csr_matrix
    force: np.ndarray
    clearance: np.ndarray
    nodes: Nodes | None
    pairs: Pairs
    watched: np.ndarray | None
    damping_factor: float
    rotation: Any = None

    _gap_transposed: sparse.csr_matrix
    _original: Structure | None
    """None: itself. A reference to itself would keep it alive."""
    _known: dict[Callable[[Structure], Any], Any]
    _VARIED_TOO: ClassVar[tuple[str, ...]] = ()
    """Attributes that are structures, varied with this one."""
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
    ) -> None:
        self._hold(
            comm=mass.comm.tompi4py(),
            mass=mass,
            stiffness=stiffness,
            gap=_read_only_rows(gap),
            force=force,
            clearance=clearance,
            damping=damping,
            nodes=nodes,
            pairs=pairs or Pairs(),
            watched=watched,
            damping_factor=1.0,
            _gap_transposed=_read_only_rows(gap.T),
            _original=None,
            _known={},
        )

    def _hold(self, **values: Any) -> None:
        """Set attributes of a structure that is being made; arrays become read-only."""
        for name, value in values.items():
            vars(self)[name] = read_only(value) if isinstance(value, np.ndarray) else value

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"{name}: a structure cannot be changed; varied() and damped() make another one"
        )

    def __repr__(self) -> str:
        pairs = f"{self.n_pairs} pair{'' if self.n_pairs == 1 else 's'}"
        damping = self.original.damping
        if isinstance(damping, DampingRule):
            words = str(damping.scaled(self.damping_factor))
        else:
            words = "no damping" if damping is None else "damping matrix"
        return f"{type(self).__name__}({self._size_words}, {pairs}, {words})"

    @property
    def _size_words(self) -> str:
        return f"{self.n_dofs} dofs"

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

    @property
    def pair_points(self) -> np.ndarray | None:
        """Positions of the contact pairs where there is a mesh: (n_pairs, 2) [m]."""
        return self.pairs.points

    @property
    def pair_areas(self) -> np.ndarray | None:
        """Area of the lip that belongs to each pair, where there is a mesh: (n_pairs,) [m^2]."""
        return self.pairs.areas

    @property
    def watched_pairs(self) -> dict[str, int]:
        """A pair of each crack by its place: "the mouth"; without a mesh the first, "pair 1"."""
        return self.pairs.places or ({"pair 1": 0} if self.n_pairs else {})

    @property
    def first_watched(self) -> int:
        """The pair at the mouth of the first crack, or in the middle of one inside the plate."""
        return next(iter(self.watched_pairs.values()))

    def most_loaded(self) -> int:
        """The dof that carries most of the load, of all ranks' (collective)."""
        return int(np.argmax(gather_rows(self.comm, np.abs(self.force).max(axis=0))))

    def where(self, pair: int) -> str:
        """A pair in words: "at the mouth", "at the middle of crack 2", "of pair 3"."""
        names = {number: name for name, number in self.pairs.places.items()}
        return f"at {names[pair]}" if pair in names else f"of pair {pair + 1}"

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, without clamped ones."""
        return int(self.mass.size[0])

    @property
    def n_modes(self) -> int:
        """Number of natural modes: of coordinates with mass."""
        return self.n_dofs

    def known_modes(self, *, tied: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """omega (m,) [rad/s] and shapes (n_local, m) with lips open or tied where the coordinates
        are those of modes, else None."""
        return None

    @property
    def n_local(self) -> int:
        """Number of degrees of freedom that this rank owns."""
        return int(self.mass.local_size[0])

    @property
    def first_dof(self) -> int:
        """Number of the first degree of freedom that this rank owns."""
        return int(self.mass.owner_range[0])

    @property
    def n_pairs(self) -> int:
        """Number of contact pairs."""
        return int(self.gap.shape[1])

    @cached_property
    def damping_matrix(self) -> Any:
        """C where damping is a matrix or Rayleigh's, else None (collective).

        Rayleigh's is formed when it is first asked for.
        """
        damping = self.damping
        if isinstance(damping, RayleighDamping):
            return damping.matrix(self.mass, self.stiffness)
        return None if isinstance(damping, DampingRule) else damping

    @property
    def whole(self) -> Structure:
        """The structure to which dof numbers and nodes refer: itself, unless it is reduced."""
        return self

    def expand(self, displacement: np.ndarray) -> np.ndarray:
        """Displacements (m, n_local) as those of the whole structure."""
        return displacement

    # --- displacement and gap ---------------------------------------------------------------------

    def apply_bt(self, displacement: np.ndarray) -> np.ndarray:
        """B^T u of displacements (m, n_local): (m, n_pairs) on every rank (collective)."""
        return self.sum_over_ranks((self._gap_transposed @ displacement.T).T)

    def apply_b(self, pair_force: np.ndarray) -> np.ndarray:
        """B lambda of forces on the pairs (m, n_pairs): (m, n_local)."""
        return (self.gap @ pair_force.T).T

    def sum_over_ranks(self, values: np.ndarray) -> np.ndarray:
        """Add up the arrays of all ranks (collective); the same array on one rank."""
        if self.comm.size == 1:
            return values
        values = np.ascontiguousarray(values)
        total = np.empty_like(values)
        self.comm.Allreduce(values, total)
        return total

    def values_at(self, displacement: np.ndarray, dofs: Sequence[int]) -> np.ndarray:
        """Pick dofs from displacements (m, n_local): (m, len(dofs)) on every rank (collective).

        Raises as :meth:`check_dofs`.
        """
        wanted = self.check_dofs(dofs)
        mine = (wanted >= self.first_dof) & (wanted < self.first_dof + self.n_local)
        picked = np.zeros((len(displacement), len(wanted)), dtype=displacement.dtype)
        picked[:, mine] = displacement[:, wanted[mine] - self.first_dof]
        return self.sum_over_ranks(picked)

    def check_dofs(self, dofs: Sequence[int]) -> np.ndarray:
        """Dofs as an array of whole numbers.

        Raises
        ------
        InputError
            A dof is not a whole number between 0 and n_dofs - 1.
        """
        wanted = np.atleast_1d(numbers(dofs)).ravel()
        if not np.all((wanted >= 0) & (wanted < self.n_dofs) & (wanted == np.round(wanted))):
            raise InputError("dofs", dofs, f"whole numbers between 0 and {self.n_dofs - 1}")
        return wanted.astype(int)

    def find_dof(self, point: Sequence[float], component: int | str) -> int:
        """Return the dof of a displacement component at the node at a point (collective).

        Parameters
        ----------
        point : (2,) [m]
            Position of the node, to 1e-6 of the structure's size.
        component : 0, 1, "x" or "y"
            Direction.

        Raises
        ------
        InputError
            There is no node there, or two (on the lips), the dof is clamped, or the structure was
            made from matrices and has no positions.
        """
        if self.nodes is None:
            raise InputError("point", point, "given only for a structure made from a mesh")
        return self.nodes.find_dof(self.whole.comm, point, component)

    def dof_name(self, dof: int) -> str:
        """A dof in words: "x displacement at (0.1, 0.1) m" (collective)."""
        if self.nodes is None:
            return f"displacement of dof {dof}"
        return self.nodes.dof_name(self.whole.comm, dof)

    # --- related structures -----------------------------------------------------------------------

    def lumped(self) -> Structure:
        """Return this structure with the diagonal mass of the row sums of M.

        Modal damping then follows the modes with that mass, and Rayleigh damping that mass.

        Raises
        ------
        InputError
            A row sum is not positive, as for six-node triangles.
        """
        ones, sums = self.mass.createVecs()
        ones.set(1.0)
        self.mass.mult(ones, sums)
        smallest = sums.min()[1]
        if smallest <= 1e-10 * sums.max()[1]:  # zero but for rounding at a triangle's corners
            allowed = "lumped only where every row sum is positive"
            raise InputError("mass", f"row sum {smallest:.3g}", allowed)
        rows = sparse.diags(sums.array_r, self.first_dof, shape=(self.n_local, self.n_dofs))
        return self._changed(mass=distributed(rows, self.comm))

    def tied(self, stiffness: float | np.ndarray) -> Structure:
        """Return this structure with every pair tied by a spring k [N/m] that pulls and pushes.

        Its stiffness is K + B diag(k) B^T, and it has no pairs; modal damping follows the tied
        modes, Rayleigh damping the tied stiffness.
        """
        whole = sparse.vstack(self.comm.allgather(self.gap), format="csr")
        diagonal = sparse.diags(per_pair("stiffness", stiffness, self.n_pairs))
        springs = distributed(self.gap @ diagonal @ whole.T, self.comm)
        matrix = weighted_sum(self.stiffness, 1.0, springs)
        springs.destroy()
        return self._changed(
            stiffness=matrix,
            gap=sparse.csr_matrix((self.n_local, 0)),
            clearance=np.zeros(0),
            pairs=Pairs(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)),
        )

    def damped(self, damping: DampingRule | None) -> Structure:
        """Return this structure with another modal or Rayleigh damping, or none."""
        if damping is not None and not isinstance(damping, DampingRule):
            raise InputError("damping", damping, "a ModalDamping, a RayleighDamping or None")
        found = self._changed(damping=damping)
        if self.rotation is not None:
            found._hold(rotation=self.rotation.damped(damping))
        return found

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
        weights = numbers(load)
        if weights.shape not in ((), (3, 3)) or not np.all(np.isfinite(weights)):
            raise InputError("load", load, "a finite number, or a finite matrix of shape (3, 3)")
        if self.whole.rotation is not None and not (weights.ndim == 0 and weights == 1.0):
            allowed = "1 for a structure that rotates: part of its mean load is centrifugal"
            raise InputError("load", load, allowed)
        check_number("damping", damping, 0.0)
        other = copy(self)
        for computed in ("damping", "damping_matrix"):
            vars(other).pop(computed, None)
        other._hold(
            force=weights @ self.force if weights.ndim else weights * self.force,
            clearance=self.clearance + per_pair("clearance", clearance, self.n_pairs),
            damping_factor=damping * self.damping_factor,
            _original=self.original,
        )
        for name in self._VARIED_TOO:
            if (part := getattr(self, name)) is not None:
                vars(other)[name] = part.varied(load=load, damping=damping, clearance=clearance)
        return other

    def _changed(self, **changes: Any) -> Structure:
        kept = "mass stiffness gap force clearance damping nodes pairs watched".split()
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
        mass = petsc_matrix("mass", mass, comm)
        comm, n, own = mass.comm.tompi4py(), mass.size[0], slice(*mass.owner_range)
        stiffness = petsc_matrix("stiffness", stiffness, comm, n)
        if damping is not None and not isinstance(damping, DampingRule):
            damping = petsc_matrix("damping", damping, comm, n)
        check_symmetric("mass", mass)
        check_symmetric("stiffness", stiffness)
        check_positive_definite("mass", mass)
        check_semidefinite("stiffness", stiffness, mass)

        gap = sparse.csr_matrix((n, 0)) if gap is None else whole_rows("gap", gap, n)
        force = np.zeros((3, n))
        parts = {"force_mean": force_mean, "force_cos": force_cos, "force_sin": force_sin}
        for row, (name, part) in zip(force, parts.items(), strict=True):
            if part is not None:
                column = whole_rows(name, part, n)
                if column.shape != (n, 1):
                    raise InputError(name, column.shape, f"of shape ({n},)")
                row[:] = column.toarray().ravel()
        return cls(
            mass,
            stiffness,
            gap[own],
            force=force[:, own],
            clearance=per_pair("clearance", clearance, gap.shape[1]),
            damping=damping,
        )


def _read_only_rows(matrix: Any) -> sparse.csr_matrix:
    """A sparse matrix by rows, read-only."""
    rows = sparse.csr_matrix(matrix, copy=True)
    rows.sum_duplicates()
    for part in (rows.data, rows.indices, rows.indptr):
        part.flags.writeable = False
    return rows
