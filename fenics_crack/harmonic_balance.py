"""Harmonic balance of a structure with contact, as one block system in all dofs.

The Fourier coefficients u of the displacement, (2H+1, n) in the paper's order, solve (eqs 5 to 9)

    R(u) = A u + B b(B^T u - g0) - c = 0,

A block diagonal in the harmonics (Z_k of :mod:`dynamic_stiffness`), b the coefficients of the
contact force, c those of the load. Newton's method (eqs 13 to 15, the update with its minus sign)
by PETSc SNES, on the system multiplied by A^-1,

    F(u) = A^-1 R(u) = u - u_lin + A^-1 B b = 0,     u_lin = A^-1 c,

whose Newton steps are the same and whose residual is a displacement: no rounding error of the
elastic forces, huge beside the load near a resonance, hides it. The Jacobian I + A^-1 B T B^T,
T = db/dg coupling all harmonics of one pair (eq. 14), is never formed: with the compliance that
the pairs see, R = B^T A^-1 B,

    (I + A^-1 B T B^T)^-1 r = r - A^-1 B (I + T R)^-1 T B^T r,

one small dense system of (2H+1) n_pairs unknowns and one solution with the factors of each
harmonic.

The residual is piecewise linear where contact is, and full Newton steps can cycle: then the contact
stiffness is raised from where the problem is all but linear, each solution predicting the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_crack.contact import ContactLaw
from fenics_crack.dynamic_stiffness import DynamicStiffness
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.fourier import SampledContact, from_complex, resized, to_complex
from fenics_crack.solution import PeriodicSolution
from fenics_crack.structure import Structure

__all__ = ["HarmonicBalanceSystem", "solve_harmonic_balance", "solve_linear"]

OPTIONS_PREFIX = "crack_hb_"


def solve_linear(structure: Structure, omega: float, *, harmonics: int = 5) -> PeriodicSolution:
    """Steady vibration with lips that pass through each other, A u = c (eq. 10) (collective).

    Parameters
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    harmonics : int
        H; all beyond the first are zero.

    Raises
    ------
    InputError
        omega or harmonics cannot be used.
    """
    _check_omega(omega)
    _check_count("harmonics", harmonics, 1)
    load = _load_coefficients(structure, harmonics, 1)
    amplitude = _solve_blocks(structure, omega, load)
    return PeriodicSolution(
        structure, omega, None, amplitude, gap_coefficients(structure, amplitude)
    )


def solve_harmonic_balance(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    harmonics: int = 5,
    samples: int | None = None,
    initial: PeriodicSolution | None = None,
    subharmonic: int = 1,
    residual_tolerance: float = 1e-10,
    throw: bool = True,
) -> PeriodicSolution:
    """Steady periodic vibration with contact between the lips (collective).

    Parameters
    ----------
    structure : Structure
        What vibrates under its own load.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw
        Law of all pairs.
    harmonics : int
        H.
    samples : int, optional
        Instants per period of the response at which contact is evaluated; default: 1024 for each
        of the load's, or 32 H where that is more.
    initial : PeriodicSolution, optional
        Where Newton starts; default: the linear solution.
    subharmonic : int
        m: look for a response of m times the load's period.
    residual_tolerance : float
        Norm of the correction A^-1 R(u) relative to that of u.
    throw : bool
        Raise if nothing converged; else return the last iterate, ``converged`` being False.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No attempt met the tolerance; carries the residual history.

    Notes
    -----
    PETSc options with the prefix ``crack_hb_`` reach SNES, for example ``-crack_hb_snes_monitor``.

    Source: the paper, eqs 2 to 15, with the corrections listed in ``docs/theory.md``.
    """
    _check_omega(omega)
    _check_count("subharmonic", subharmonic, 1)
    _check_count("harmonics", harmonics, subharmonic)
    if samples is None:
        samples = max(1024 * subharmonic, 2 ** int(np.ceil(np.log2(32 * harmonics))))
    _check_count("samples", samples, 4 * harmonics + 1)
    if not (np.isfinite(residual_tolerance) and residual_tolerance > 0.0):
        raise InputError("residual_tolerance", residual_tolerance, "a finite number > 0")
    _check_contact(structure, contact)
    with HarmonicBalanceSystem(
        structure, omega, contact, harmonics, samples, subharmonic=subharmonic
    ) as system:
        start = system.linear
        if initial is not None:
            _check_initial(structure, initial, subharmonic)
            start = resized(initial.displacement_coefficients, harmonics)
        search = _Search(system, residual_tolerance)
        amplitude = search.run(start)
        residual = system.relative_residual(amplitude)
    converged = search.converged and residual <= residual_tolerance
    if throw and not converged:
        raise ConvergenceError(
            f"harmonic balance at {omega:g} rad/s, H = {harmonics}: {search.status}; "
            "try other harmonics, a softer contact, or a solution nearby as initial",
            search.history,
        )
    return PeriodicSolution(
        structure,
        omega,
        contact,
        amplitude,
        gap_coefficients(structure, amplitude),
        subharmonic=subharmonic,
        converged=converged,
        status=search.status,
        iterations=search.iterations,
        residual=residual,
    )


def gap_coefficients(structure: Structure, amplitude: np.ndarray) -> np.ndarray:
    """g = B^T u - g0 of coefficients (2H+1, n_local): (2H+1, n_pairs) (collective)."""
    gap = structure.closing(amplitude)
    gap[0] -= structure.clearance
    return gap


class HarmonicBalanceSystem:
    """Residual and Jacobian of the block system; the Jacobian inverted through its structure.

    Amplitudes are arrays (2H+1, n_local).

    Attributes
    ----------
    contact : ContactLaw
        May be replaced by a law of another stiffness.
    linear : (2H+1, n_local) [m]
        The solution without contact.
    compliance : (H+1, n_pairs, n_pairs) complex [m/N]
        B^T Z_k^-1 B.
    """

    def __init__(
        self,
        structure: Structure,
        omega: float,
        contact: ContactLaw,
        harmonics: int,
        samples: int,
        *,
        subharmonic: int = 1,
    ) -> None:
        self.structure = structure
        self.contact = contact
        self.harmonics = harmonics
        self.integrals = SampledContact(harmonics, samples)
        base = omega / subharmonic
        self.blocks = [DynamicStiffness(structure, k * base) for k in range(harmonics + 1)]
        self.load = _load_coefficients(structure, harmonics, subharmonic)
        self.linear = self.solve_blocks(self.load)
        self.compliance = np.array([block.compliance() for block in self.blocks])
        self._tangent: np.ndarray | None = None
        self._small: Any = None

    @property
    def shape(self) -> tuple[int, int]:
        """(2H+1, n_local)."""
        return 2 * self.harmonics + 1, self.structure.n_local

    # --- residual ---------------------------------------------------------------------------------

    def apply_blocks(self, amplitude: np.ndarray) -> np.ndarray:
        """A u."""
        harmonics = to_complex(amplitude)
        rows = [b.apply(row[None])[0] for b, row in zip(self.blocks, harmonics, strict=True)]
        return from_complex(np.array(rows))

    def solve_blocks(self, force: np.ndarray) -> np.ndarray:
        """A^-1 f."""
        harmonics = to_complex(force)
        rows = [harmonics[0] * 0.0] * len(harmonics)
        for k, block in enumerate(self.blocks):
            if np.any(self.structure.sum_over_ranks(np.array([np.any(harmonics[k])], float))):
                rows[k] = block.solve(harmonics[k].real[None] if k == 0 else harmonics[k][None])[0]
        return from_complex(np.array(rows))

    def contact_coefficients(self, amplitude: np.ndarray) -> np.ndarray:
        """b: coefficients (2H+1, n_pairs) of the contact force."""
        gap = self.integrals.sample(gap_coefficients(self.structure, amplitude))
        return self.integrals.balance(self.contact.force(gap))

    def residual(self, amplitude: np.ndarray) -> np.ndarray:
        """R(u) = A u + B b(B^T u - g0) - c [N]."""
        contact = self.structure.spread(self.contact_coefficients(amplitude))
        return self.apply_blocks(amplitude) + contact - self.load

    def correction(self, amplitude: np.ndarray) -> np.ndarray:
        """F(u) = A^-1 R(u) = u - u_lin + A^-1 B b [m]."""
        contact = self.structure.spread(self.contact_coefficients(amplitude))
        return amplitude - self.linear + self.solve_blocks(contact)

    def relative_residual(self, amplitude: np.ndarray) -> float:
        """Norm of F(u) relative to that of u (collective)."""
        residual, size = self.norm(self.correction(amplitude)), self.norm(amplitude)
        return residual / size if residual > 0.0 else 0.0

    def norm(self, values: np.ndarray) -> float:
        """Euclidean norm over all ranks (collective)."""
        return float(np.sqrt(self.structure.sum_over_ranks(np.sum(values**2, keepdims=True)).sum()))

    # --- Jacobian ---------------------------------------------------------------------------------

    def linearise(self, amplitude: np.ndarray) -> None:
        """Evaluate the tangent T of the contact force at an amplitude (eq. 14)."""
        gap = self.integrals.sample(gap_coefficients(self.structure, amplitude))
        self._tangent = self.integrals.tangent(self.contact.tangent(gap))
        self._small = None

    def apply_jacobian(self, change: np.ndarray) -> np.ndarray:
        """dF = (I + A^-1 B T B^T) du."""
        contact = self._contact_change(self.structure.closing(change))
        return change + self.solve_blocks(self.structure.spread(contact))

    def solve_jacobian(self, residual: np.ndarray) -> np.ndarray:
        """(I + A^-1 B T B^T)^-1 r."""
        pushed = self._contact_change(self.structure.closing(residual))
        if self._small is None:
            self._small = scipy.linalg.lu_factor(self._small_matrix())
        force = scipy.linalg.lu_solve(self._small, pushed.ravel()).reshape(pushed.shape)
        return residual - self.solve_blocks(self.structure.spread(force))

    def _contact_change(self, gap_change: np.ndarray) -> np.ndarray:
        """T dg: (2H+1, n_pairs)."""
        assert self._tangent is not None
        return np.einsum("prc,cp->rp", self._tangent, gap_change)

    def _small_matrix(self) -> np.ndarray:
        """I + T R for unknowns ordered (row, pair): square, (2H+1) n_pairs."""
        assert self._tangent is not None
        rows, pairs = self.shape[0], self.structure.n_pairs
        tangent = self._tangent.transpose(1, 2, 0)  # (row, column, pair)
        real, imaginary = self.compliance.real, self.compliance.imag
        product = np.empty((rows, pairs, rows, pairs))
        product[:, :, 0] = tangent[:, 0, :, None] * real[0]
        cosine, sine = tangent[:, 1::2, :, None], tangent[:, 2::2, :, None]
        # A force a - i b on harmonic k moves the gap by R_k (a - i b):
        # [[Re R, Im R], [-Im R, Re R]] on (a, b).
        product[:, :, 1::2] = (cosine * real[1:] - sine * imaginary[1:]).swapaxes(1, 2)
        product[:, :, 2::2] = (cosine * imaginary[1:] + sine * real[1:]).swapaxes(1, 2)
        return np.eye(rows * pairs) + product.reshape(rows * pairs, rows * pairs)

    # --- resources --------------------------------------------------------------------------------

    def destroy(self) -> None:
        """Free the factors (collective)."""
        for block in self.blocks:
            block.destroy()

    def __enter__(self) -> HarmonicBalanceSystem:
        return self

    def __exit__(self, *exception: object) -> None:
        self.destroy()


# --- Newton ---------------------------------------------------------------------------------------


class _Newton:
    """PETSc SNES on a :class:`HarmonicBalanceSystem`."""

    def __init__(self, system: HarmonicBalanceSystem, tolerance: float) -> None:
        self.system = system
        self.tolerance = tolerance
        comm = system.structure.comm
        rows, n_local = system.shape
        sizes = (rows * n_local, rows * system.structure.n_dofs)
        self.unknown = PETSc.Vec().createMPI(sizes, comm=comm)
        self.target = self.unknown.duplicate()
        self.history: list[float] = []
        matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=comm)
        matrix.setUp()
        self.matrix = matrix
        self.snes = PETSc.SNES().create(comm)
        self.snes.setOptionsPrefix(OPTIONS_PREFIX)
        self.snes.setFunction(self._residual, self.target)
        self.snes.setJacobian(self._jacobian, matrix)
        # Full steps: the kinks of the merit function make line searches stall (docs/theory.md).
        with _DefaultOptions({"snes_linesearch_type": "basic"}):
            self.snes.setFromOptions()
        self.snes.setConvergenceTest(self._converged)
        solver = self.snes.getKSP()
        if not PETSc.Options(OPTIONS_PREFIX).hasName("ksp_type"):
            solver.setType("preonly")
        solver.getPC().setType("python")
        solver.getPC().setPythonContext(self)

    def solve(self, start: np.ndarray, most_iterations: int) -> tuple[np.ndarray, bool, int]:
        """Return the last iterate, whether it converged, and the number of iterations."""
        self.unknown.array_w[:] = start.ravel()
        self.snes.setTolerances(max_it=most_iterations)
        self.snes.solve(None, self.unknown)
        amplitude = self.unknown.array_r.reshape(self.system.shape).copy()
        return amplitude, self.snes.getConvergedReason() > 0, self.snes.getIterationNumber()

    def _converged(self, snes: Any, count: int, norms: tuple[float, float, float]) -> int:
        """Judge the residual relative to the amplitude itself."""
        self.history.append(norms[2])
        if not np.isfinite(norms[2]):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if norms[2] <= self.tolerance * self.unknown.norm():
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if count >= snes.getTolerances()[3]:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    def _residual(self, snes: Any, unknown: Any, target: Any) -> None:
        correction = self.system.correction(unknown.array_r.reshape(self.system.shape))
        target.array_w[:] = correction.ravel()

    def _jacobian(self, snes: Any, unknown: Any, matrix: Any, preconditioner: Any) -> None:
        self.system.linearise(unknown.array_r.reshape(self.system.shape))

    def mult(self, matrix: Any, source: Any, target: Any) -> None:
        """Jacobian times a vector, called by PETSc."""
        product = self.system.apply_jacobian(source.array_r.reshape(self.system.shape))
        target.array_w[:] = product.ravel()

    def apply(self, preconditioner: Any, source: Any, target: Any) -> None:
        """Inverse of the Jacobian times a vector, called by PETSc."""
        found = self.system.solve_jacobian(source.array_r.reshape(self.system.shape))
        target.array_w[:] = found.ravel()

    def free(self) -> None:
        """Free PETSc's objects (collective); ``destroy`` is a name that PETSc calls itself."""
        for item in (self.snes, self.matrix, self.unknown, self.target):
            item.destroy()


class _DefaultOptions:
    """PETSc options that hold inside the block unless the user has set them."""

    def __init__(self, values: dict[str, str]) -> None:
        self._options = PETSc.Options(OPTIONS_PREFIX)
        self._values = {k: v for k, v in values.items() if not self._options.hasName(k)}

    def __enter__(self) -> None:
        for key, value in self._values.items():
            self._options[key] = value

    def __exit__(self, *exception: object) -> None:
        for key in self._values:
            self._options.delValue(key)


@dataclass
class _Search:
    """Attempts to converge, the cheapest first, and the record of them."""

    system: HarmonicBalanceSystem
    tolerance: float
    converged: bool = False
    iterations: int = 0
    history: list[float] = field(default_factory=list)
    attempts: list[str] = field(default_factory=list)

    @property
    def status(self) -> str:
        """The attempts in words."""
        return "; then ".join(self.attempts)

    def run(self, start: np.ndarray) -> np.ndarray:
        """Full Newton steps from ``start``; if they fail, a ramp of the contact stiffness."""
        newton = _Newton(self.system, self.tolerance)
        try:
            amplitude, self.converged, count = newton.solve(start, 25)
            self.iterations += count
            self._note("full Newton steps", f"{count} iterations")
            if not self.converged:
                amplitude = self._ramp(newton)
        finally:
            self.history = newton.history
            newton.free()
        return amplitude

    def _note(self, attempt: str, details: str) -> None:
        outcome = "converged" if self.converged else "failed"
        self.attempts.append(f"{attempt}: {outcome} ({details})")

    def _ramp(self, newton: _Newton) -> np.ndarray:
        """Raise the stiffness to its full value in steps that adapt, with a secant predictor.

        It starts where k R = 0.1, that is where contact hardly changes the linear solution.
        """
        law = self.system.contact
        largest = np.abs(self.system.compliance).sum(axis=2).max() * np.max(law.stiffness)
        reached, step = min(0.0, np.log(0.1 / largest)), np.log(3.0)
        amplitude, before, done = self.system.linear, None, None
        level, solves = reached, 0
        try:
            while True:
                self.system.contact = law.scaled(float(np.exp(level)))
                guess = amplitude
                if before is not None and done is not None:
                    guess = amplitude + (level - done) / (done - before[0]) * (
                        amplitude - before[1]
                    )
                found, success, count = newton.solve(guess, 12)
                self.iterations += count
                solves += 1
                if success:
                    if level == 0.0:
                        self.converged = True
                        self._note("ramp of the contact stiffness", f"{solves} solutions")
                        return found
                    before = None if done is None else (done, amplitude)
                    amplitude, done = found, level
                    step *= 1.5 if count <= 6 else 1.0
                elif done is None:
                    break
                else:
                    step *= 0.4
                    if step < 1e-4:
                        break
                level = min(0.0, done + step)
        finally:
            self.system.contact = law
        self._note("ramp of the contact stiffness", f"stuck at {np.exp(level):.3g} of it")
        return amplitude


# --- input ----------------------------------------------------------------------------------------


def _load_coefficients(structure: Structure, harmonics: int, subharmonic: int) -> np.ndarray:
    load = np.zeros((2 * harmonics + 1, structure.n_local))
    load[0] = structure.force[0]
    load[2 * subharmonic - 1 : 2 * subharmonic + 1] = structure.force[1:]
    return load


def _solve_blocks(structure: Structure, omega: float, load: np.ndarray) -> np.ndarray:
    """A^-1 c for a load with a mean and a first harmonic only."""
    amplitude = to_complex(np.zeros_like(load))
    for k in (0, 1):
        part = to_complex(load)[k]
        if k == 0 and not np.any(structure.sum_over_ranks(np.array([np.any(part)], float))):
            continue
        with DynamicStiffness(structure, k * omega) as block:
            amplitude[k] = block.solve(part.real[None] if k == 0 else part[None])[0]
    return from_complex(amplitude)


def _check_omega(omega: float) -> None:
    if isinstance(omega, bool) or not isinstance(omega, int | float | np.number):
        raise InputError("omega", omega, "a finite number > 0")
    if not (np.isfinite(omega) and omega > 0.0):
        raise InputError("omega", omega, "a finite number > 0")


def _check_count(key: str, value: int, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InputError(key, value, f"a whole number >= {least}")


def _check_contact(structure: Structure, contact: ContactLaw) -> None:
    stiffness = np.asarray(getattr(contact, "stiffness", np.nan))
    if stiffness.ndim > 0 and stiffness.shape != (structure.n_pairs,):
        raise InputError(
            "contact stiffness", stiffness.shape, f"one number or {structure.n_pairs}, one per pair"
        )


def _check_initial(structure: Structure, initial: PeriodicSolution, subharmonic: int) -> None:
    width = initial.displacement_coefficients.shape[1]
    if width != structure.n_local:
        raise InputError("initial", f"{width} dofs", f"a solution with {structure.n_local} dofs")
    if initial.subharmonic != subharmonic:
        raise InputError(
            "initial", f"subharmonic {initial.subharmonic}", f"of subharmonic {subharmonic}"
        )
