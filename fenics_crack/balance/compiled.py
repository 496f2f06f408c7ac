"""Contact equations whose paths are followed by the compiled kernel.

    F(s, p) = s - g_lin(p) + (R(p) - R_inf) b(lambda(s), p) = 0

of :mod:`contact_system`, with exact integrals of the contact forces. Along p the contact stiffness
grows like e^(growth p), g_lin linearly, a softness in series with the pairs falls, or the base
frequency and the damping of modes change, R and g_lin following from them
(``kernel/compliance.h``, ``contact.h``). From 100 unknowns on solutions with J are found by
products with it (``kernel/krylov.h``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.kernel import Struct, doubles, kernel, owned, shaped
from fenics_crack.numerics.equations import Equations
from fenics_crack.numerics.linearisation import Linearisation

__all__ = ["SHARPLY", "CompiledEquations", "ModalPart"]


SHARPLY = 1e-9
"""Relative residual of a solution with J that takes products."""


@dataclass(frozen=True)
class ModalPart:
    """Modes that answer along a path: R_k = P^T h_k P + at_once and what the load adds to g_lin,
    P^T h_k l_k, with h_kj = 1 / (s_j - (k w)^2 + i k w d c_j)."""

    squares: np.ndarray
    """s: (n_modes,) [rad^2/s^2]."""
    rates: np.ndarray
    """c: (n_modes,) [1/s]."""
    shapes: np.ndarray
    """P: (n_modes, n_pairs)."""
    load: np.ndarray
    """l: (H+1, n_modes), complex."""
    omega: tuple[float, float]
    """w at p = 0, and dw/dp [rad/s]."""
    damping: tuple[float, float]
    """d at p = 0, and dd/dp."""
    at_once: np.ndarray | None = None
    """What is added to each R_k: (n_pairs, n_pairs)."""


def seen_structure(
    linear: np.ndarray, compliance: np.ndarray | ModalPart, linear_rate: np.ndarray | None = None
) -> Struct:
    """What the kernel's equations share: g_lin and R along a parameter, of the arguments of
    :class:`CompiledEquations`."""
    rows, pairs = linear.shape
    rate = np.zeros_like(linear) if linear_rate is None else linear_rate
    known: dict[str, Any] = {"harmonics": rows // 2, "pairs": pairs}
    if isinstance(compliance, ModalPart):
        modes, of_each = len(compliance.squares), rows // 2 + 1
        known["modes"] = modes
        known["omega"], known["omega_rate"] = compliance.omega
        known["damping"], known["damping_rate"] = compliance.damping
        known["squares"] = shaped(compliance.squares, modes)
        known["rates"] = shaped(compliance.rates, modes)
        known["shapes"] = shaped(compliance.shapes, modes, pairs)
        known["load"] = shaped(compliance.load, of_each, modes, kind=complex)
        at_once = compliance.at_once
        known["at_once"] = None if at_once is None else shaped(at_once, pairs, pairs)
    else:
        of_each = rows // 2 + 1
        known["compliance"] = shaped(compliance, of_each, pairs, pairs, kind=complex)
    return Struct(
        "seen_structure", linear=shaped(linear, rows, pairs),
        linear_rate=shaped(rate, rows, pairs), **known,
    )  # fmt: skip


class CompiledEquations(Equations):
    """F(s, p) = 0 of contact pairs.

    Parameters
    ----------
    residual : (n_pairs, n_pairs) [m/N] or None
        R_inf.
    springs : (n_pairs,) [m/N]
        1 / k at p = 0.
    linear : (2H+1, n_pairs) [m]
        g_lin at p = 0, without the part of modes.
    compliance : (H+1, n_pairs, n_pairs) complex or ModalPart
        R_k - R_inf, or what it follows from.
    coupled : bool
        Whether R_inf has more than a diagonal.
    basis : (n_pairs, n), optional
        U where modes are fewer than coupled pairs.
    formed : bool
        Whether J is formed; else solutions take products with it, and its sign is nan.
    linear_rate : (2H+1, n_pairs) [m], optional
        d g_lin / dp, without the part of modes.
    growth : float
        d ln k / dp.
    softness : float [m/N]
        That in series with each pair is ``softness`` |1 - p|^3.
    """

    def __init__(
        self,
        residual: np.ndarray | None,
        springs: np.ndarray,
        linear: np.ndarray,
        compliance: np.ndarray | ModalPart,
        *,
        coupled: bool = False,
        basis: np.ndarray | None = None,
        formed: bool = True,
        linear_rate: np.ndarray | None = None,
        growth: float = 0.0,
        softness: float = 0.0,
    ) -> None:
        self.shape = linear.shape
        pairs = self.shape[1]
        gaps = pairs if basis is None else basis.shape[1]
        at_once = np.zeros((pairs, pairs)) if residual is None else residual
        self._given = Struct(
            "contact_pairs", seen=seen_structure(linear, compliance, linear_rate), growth=growth,
            softness=softness, coupled=coupled, residual=shaped(at_once, pairs, pairs),
            springs=shaped(springs, pairs), seen_gaps=gaps, formed=formed,
            basis=None if basis is None else shaped(basis, pairs, gaps),
        )  # fmt: skip
        self._point = owned(kernel.new_contact_point(self._given.at), kernel.free_contact_point)
        self.table = kernel.equations_of_contact(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        """The equations at a point."""
        return CompiledPoint(self, shaped(unknown, *self.shape), parameter)

    def evaluated(self, at: CompiledPoint) -> Any:
        """The kernel's equations, evaluated at a point."""
        if self._last is not at:
            self.check(self.run(self.table.evaluate, doubles(at.unknown), at.parameter))
            self._last = at
        return self.table

    def found(self, unknown: np.ndarray, parameter: float) -> CompiledPoint:
        self._last = found = CompiledPoint(self, unknown, parameter)
        return found

    def largest_compliance(self, parameter: float) -> float:
        """Largest sum of abs(R_k - R_inf) over a row of it at a parameter [m/N]."""
        self._last = None
        found = float(kernel.largest_moving(self._point, parameter))
        if not math.isfinite(found):
            self.check(kernel.SINGULAR_STRUCTURE)
        return found


class CompiledPoint(Linearisation):
    """:class:`CompiledEquations` at a point; evaluated again where the kernel has left it."""

    def __init__(self, system: CompiledEquations, unknown: np.ndarray, parameter: float) -> None:
        self.system, self.unknown, self.parameter = system, unknown, parameter

    @property
    def residual(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.residual(at, doubles(found))
        return found

    def solve(self, right: np.ndarray) -> np.ndarray:
        found = np.array(right, dtype=float, order="C")
        if found.size != self.unknown.size:
            raise ValueError(f"{found.size} numbers instead of {self.unknown.size}")
        at = self.system.evaluated(self)
        at.sharp = SHARPLY
        at.solve(at, doubles(found))
        return found

    @property
    def by_parameter(self) -> np.ndarray:
        found = np.empty_like(self.unknown)
        at = self.system.evaluated(self)
        at.by_parameter(at, doubles(found))
        return found

    @property
    def sign(self) -> float:
        at = self.system.evaluated(self)
        return float(at.sign(at))
