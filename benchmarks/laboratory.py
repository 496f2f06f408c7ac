"""Other forms of harmonic balance, for comparison with that of the package.

*Full* (``form="full"``): the unknowns are all displacements, see :class:`BlockSystem`; the same
solutions as the condensed form, at a far higher cost.

*Collocation* (``balance="collocation"``): the equations hold at 2H+1 instants of the period, the
high-dimensional form (Hall, Thomas, Clark, AIAA Journal 40, 2002, 879-886). With E the square
matrix of the functions' values at the instants theta_n = 2 pi n / (2H+1),

    w^2 M D^2 U + w C D U + K U + B lambda(B^T U - g0) = f,      D = E (d/dtheta) E^-1,   U = E u,

and E^-1 times that is A u + B b - c = 0 with b = E^-1 lambda(E g): harmonic balance whose contact
force is sampled only 2H+1 times. It is cheap for any law, but harmonics of the force beyond H are
folded back onto those kept and can create spurious solutions, which a large ``report.sampling``
reveals (Liu, Thomas, Dowell, Attar, Hall, Journal of Computational Physics 215, 2006,
298-320).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg

import fenics_crack as fc
from fenics_crack.balance.compliance import Compliance, FactoredCompliance
from fenics_crack.balance.contact_integrals import PairIntegrals, apply_to_pairs, respond_to_columns
from fenics_crack.balance.contact_system import SOFT, ContactPoint, ContactSystem
from fenics_crack.balance.harmonic_balance import check_initial
from fenics_crack.balance.problem import Search
from fenics_crack.balance.solution import Solver
from fenics_crack.basics.errors import check_number
from fenics_crack.model.contact import is_rigid
from fenics_crack.numerics.equations import Linearisation, determinant_sign
from fenics_crack.numerics.fourier import resized, stretched

__all__ = ["BlockSystem", "solve_form"]


def solve_form(
    problem: fc.Problem,
    *,
    form: str = "condensed",
    balance: str = "galerkin",
    initial: fc.PeriodicSolution | None = None,
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> fc.PeriodicSolution:
    """Solve a problem by another form of harmonic balance, on one rank.

    Parameters
    ----------
    problem : Problem
        What is solved; without samples for collocation, whose 2H+1 instants follow from H.
    form : "condensed" or "full"
        Unknowns on the gaps, or in all degrees of freedom.
    balance : "galerkin" or "collocation"
        By integrals over the period, or at 2H+1 instants.
    initial, residual_tolerance, throw
        As in :func:`solve_harmonic_balance`.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        Nothing converged.
    """
    if not isinstance(form, str) or form not in ("condensed", "full"):
        raise fc.InputError("form", form, "'condensed' or 'full'")
    if not isinstance(balance, str) or balance not in ("galerkin", "collocation"):
        raise fc.InputError("balance", balance, "'galerkin' or 'collocation'")
    check_number("residual_tolerance", residual_tolerance, 0.0, above=True)
    if form == "full" and is_rigid(problem.contact):
        raise fc.InputError("form", form, "'condensed' with UnilateralConstraint")
    if balance == "collocation":
        if is_rigid(problem.contact):
            raise fc.InputError("balance", balance, "'galerkin' with UnilateralConstraint")
        if problem.samples is not None:
            allowed = "left out with balance='collocation', whose 2H+1 instants follow from H"
            raise fc.InputError("samples", problem.samples, allowed)
        problem = replace(problem, samples=2 * problem.harmonics + 1)
    if initial is not None:
        check_initial(problem, initial)
    solver = _FullSolver if form == "full" else Solver
    return solver(problem, residual_tolerance, throw).solve(initial)


class _FullSolver(Solver):
    """All degrees of freedom."""

    def compliance(self) -> FactoredCompliance:
        """From factorisations, which the full form needs."""
        problem = self.problem
        return FactoredCompliance(problem.structure, problem.base_omega, problem.load)

    def find(
        self, compliance: Compliance, initial: fc.PeriodicSolution | None, share: float = 1.0
    ) -> tuple[Search, ContactPoint]:
        """A search, and the equations where it arrives."""
        assert isinstance(compliance, FactoredCompliance)
        integrals = self.problem.integrals()
        assert not integrals.coupled
        block = BlockSystem(compliance, integrals)
        start = block.linear
        if initial is not None:
            times = self.problem.subharmonic // initial.subharmonic
            force = stretched(initial.force_coefficients, times)
            start = compliance.displacement(resized(force, self.problem.harmonics))
        search = Search(block, None, self.residual_tolerance, share)
        gap = block.gap(search.solve(start).unknown)
        return search, ContactSystem(compliance, integrals).linearise(gap)


class BlockSystem:
    """F(u), inverted through its structure; amplitudes are (2H+1, n_local).

    The Fourier coefficients u of the displacement, (2H+1, n) in the paper's order, solve (eqs 5 to
    9)

        R(u) = A u + B b(B^T u - g0) - c = 0,

    A block diagonal in the harmonics (Z_k of :mod:`dynamic_stiffness`), b the coefficients of the
    contact force, c those of the load. Newton's method (eqs 13 to 15, the update with its minus
    sign) runs on the system multiplied by A^-1,

        F(u) = A^-1 R(u) = u - u_lin + A^-1 B b = 0,     u_lin = A^-1 c,

    whose steps are the same and whose residual is a displacement: no rounding error of the elastic
    forces, huge beside the load near a resonance, hides it. The Jacobian I + A^-1 B T B^T,
    T = db/dg coupling all harmonics of one pair (eq. 14), is never formed: with the compliance
    R = B^T A^-1 B,

        (I + A^-1 B T B^T)^-1 r = r - A^-1 B T (I + R T)^-1 B^T r,

    one small dense system of (2H+1) n_pairs unknowns and one solution with the factors of each
    harmonic.

    Its parameter p leads from soft contact to the law itself, at p = 1, as that of
    :class:`ContactSystem`.

    Attributes
    ----------
    linear : (2H+1, n_local) [m]
        The solution without contact.
    """

    residual = None

    def __init__(
        self, compliance: FactoredCompliance, integrals: PairIntegrals, softness: float = 0.0
    ) -> None:
        self.compliance, self.integrals, self._softness = compliance, integrals, softness
        self.structure = compliance.structure
        assert self.structure.comm.size == 1, "search and paths know no unknowns of other ranks"
        self.matrix_free = False
        rows = 2 * integrals.harmonics + 1
        self.shape: tuple[int, ...] = (rows, self.structure.n_local)
        self.size = rows * self.structure.n_dofs
        self.linear = compliance.solve_blocks(compliance.load)

    def gap(self, amplitude: np.ndarray) -> np.ndarray:
        """g = B^T u - g0: (2H+1, n_pairs)."""
        gap = self.structure.apply_bt(amplitude)
        gap[0] -= self.structure.clearance
        return gap

    def softened(self) -> BlockSystem:
        """The same equations, whose parameter starts where pairs hardly touch each other."""
        largest = float(np.abs(self.compliance.matrices).sum(axis=2).max())
        return BlockSystem(self.compliance, self.integrals, largest / (SOFT * self.integrals.unit))

    def linearise(self, amplitude: np.ndarray, parameter: float = 1.0) -> BlockPoint:
        """The equations at an amplitude and a softness."""
        left = 1.0 - parameter
        integrals = self.integrals.with_softness(self._softness * abs(left) ** 3)
        return BlockPoint(self, amplitude, integrals, -3.0 * self._softness * left * abs(left))


@contextmanager
def block_system(problem: fc.Problem) -> Iterator[BlockSystem]:
    """The full block system of a problem."""
    compliance = FactoredCompliance(problem.structure, problem.base_omega, problem.load)
    yield BlockSystem(compliance, problem.integrals())
    compliance.destroy()


class BlockPoint(Linearisation):
    """:class:`BlockSystem` at an amplitude."""

    def __init__(
        self, system: BlockSystem, amplitude: np.ndarray, integrals: PairIntegrals, rate: float
    ) -> None:
        self._system, self.unknown, self._rate = system, amplitude, rate
        found = self._forces = integrals.linearise(system.gap(amplitude))
        self._tangent = found.tangent
        self._moved = self._through_structure(found.force)
        self.residual = amplitude - system.linear + self._moved

    def _through_structure(self, force: np.ndarray) -> np.ndarray:
        """A^-1 B of forces on the pairs."""
        system = self._system
        return system.compliance.solve_blocks(system.structure.apply_b(force))

    def apply(self, change: np.ndarray) -> np.ndarray:
        """dF = (I + A^-1 B T B^T) du."""
        closing = self._system.structure.apply_bt(change)
        return change + self._through_structure(apply_to_pairs(self._tangent, closing))

    @cached_property
    def _factors(self) -> Any:
        small = respond_to_columns(self._system.compliance.matrices, self._tangent)
        small.flat[:: len(small) + 1] += 1.0
        return scipy.linalg.lu_factor(small)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """(I + A^-1 B T B^T)^-1 r = r - A^-1 B T (I + R T)^-1 B^T r."""
        closing = self._system.structure.apply_bt(right)
        gap = scipy.linalg.lu_solve(self._factors, closing.ravel()).reshape(closing.shape)
        return right - self._through_structure(apply_to_pairs(self._tangent, gap))

    @property
    def by_parameter(self) -> np.ndarray:
        """dF / dp = A^-1 B db/dp."""
        return self._through_structure(self._rate * self._forces.by_softness())

    @property
    def sign(self) -> float:
        """Sign of det(I + R T), which is that of the Jacobian."""
        return determinant_sign(self._factors)
