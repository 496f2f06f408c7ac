"""Fourier coefficients of contact forces with friction, by alternating between frequency and time.

The gaps s (2 n_pairs: normals, then tangents) of N instants are marched period after period: at
each instant the forces follow from s and from the places h where pairs stuck until then,

    lambda = L (s - [0; h]),        h = g_t of pairs that do not stick,

(:mod:`fenics_crack.model.contact`, ``kernel/friction_waves.c``). The march ends where h repeats,
when it has forgotten where it began, but for pairs that stick all the time: these are tied where
the gaps were at first, or where they slipped last. The derivative goes through its last two
periods, h with it.

Source: Cameron and Griffin, Journal of Applied Mechanics 56 (1989) 149-154.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from fenics_crack.balance.contact_integrals import ContactIntegrals, CoupledForces, CoupledIntegrals
from fenics_crack.kernel import kernel, pointer
from fenics_crack.model.contact import ContactLaw, FrictionSets, friction_of, springs_of
from fenics_crack.numerics.fourier import (
    evaluate,
    fourier_basis,
    fourier_coefficients,
    sample_period,
)


def coupled_integrals(
    law: ContactLaw, harmonics: int, residual: np.ndarray, samples: int | None = None
) -> ContactIntegrals:
    """The integrals of pairs that R_inf couples; with friction of normals and tangents."""
    kind = CoupledIntegrals if friction_of(law) is None else FrictionIntegrals
    return kind(law, harmonics, residual=residual, samples=samples)


SAMPLES_PER_HARMONIC, MIN_SAMPLES = 32, 128
"""Instants for each harmonic, and at least."""
TURNS = 20
"""Maximum periods of a march. Pairs that never all slip or open at once keep a ninth of where it
began from period to period (an edge crack in flap): rounding is left of it after twelve."""


@dataclass(frozen=True)
class FrictionIntegrals(ContactIntegrals):
    """Forces of normals and tangents that R_inf (2 n_pairs, 2 n_pairs) couples.

    Attributes
    ----------
    samples : int or None
        N; None: 32 H, or 128 where that is more.
    share : float
        Of the coefficient of friction, that of the law times this.
    """

    samples: int | None = field(default=None, kw_only=True)
    share: float = field(default=1.0, kw_only=True)
    sets: FrictionSets = field(init=False, repr=False, compare=False)
    has_coupled_pairs: ClassVar[bool] = True

    def __post_init__(self) -> None:
        friction = friction_of(self.law)
        assert self.residual is not None and friction is not None
        share = np.multiply(self.share, friction.coefficient)
        object.__setattr__(self, "sets", FrictionSets(self.compliance, share))

    @cached_property
    def compliance(self) -> np.ndarray:
        """D = R_inf + I/k, and the softness in series: (2 n_pairs, 2 n_pairs) [m/N]."""
        assert self.residual is not None
        softness = self.springs + self.softness * self.unit
        return np.ascontiguousarray(self.residual + np.diag(softness))

    @cached_property
    def springs(self) -> np.ndarray:
        """1/k of the normals, then of the tangents: (2 n_pairs,) [m/N]."""
        assert self.residual is not None
        return springs_of(self.law, len(self.residual) // 2)

    @property
    def instants(self) -> int:
        """N."""
        return self.samples or max(MIN_SAMPLES, SAMPLES_PER_HARMONIC * self.harmonics)

    def march(self, gap: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return forces, states, places and origins for values (n, 2 n_pairs) of a period's gaps.

        Raises as :meth:`FrictionSets.solve`.
        """
        return self.sets.solve(gap, gap[0, gap.shape[1] // 2 :], turns=TURNS)

    def forces(self, gap: np.ndarray) -> np.ndarray:
        return self.march(gap)[0]

    def at(self, gap: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n, 2 n_pairs) [N] and places h (n, n_pairs) [m] at phases (n,) of a wave of gaps,
        (2H+1, 2 n_pairs)."""
        count, turn = self.instants, 2.0 * np.pi
        every = np.concatenate([turn / count * np.arange(count), np.mod(phase, turn)])
        values = np.concatenate([sample_period(gap, count), evaluate(gap, 1.0, phase)])
        _, first, place = np.unique(every, return_index=True, return_inverse=True)
        forces, _, places, _ = self.march(values[first])
        asked = place[count:]
        return forces[asked], places[asked]

    def linearise(self, gap: np.ndarray) -> FrictionForces:
        return FrictionForces(self, gap)

    def refine(self) -> Self:
        return replace(self, samples=4 * self.instants)

    def with_harmonics(self, harmonics: int) -> Self:
        return replace(self, harmonics=harmonics, samples=None)


class FrictionForces(CoupledForces):
    """At a wave of gaps."""

    def __init__(self, integrals: FrictionIntegrals, gap: np.ndarray) -> None:
        self._integrals, self._rows = integrals, gap.shape
        values = sample_period(gap, integrals.instants)
        self._forces, self.states, self.places, self._origins = integrals.march(values)
        self.force = fourier_coefficients(self._forces, integrals.harmonics)

    def apply(self, change: np.ndarray) -> np.ndarray:
        return self._of_values(sample_period(change, self._integrals.instants))

    def _of_values(self, values: np.ndarray) -> np.ndarray:
        values, found = np.ascontiguousarray(values), np.empty_like(self._forces)
        arrays = map(pointer, (self.states, self._origins, values, found))
        if kernel.friction_changes(self._integrals.sets.handle, len(values), *arrays):
            raise MemoryError("friction")
        return fourier_coefficients(found, self._integrals.harmonics)

    def tangent(self, basis: np.ndarray | None = None) -> np.ndarray:
        rows, pairs = self._rows
        seen = np.eye(pairs) if basis is None else np.ascontiguousarray(basis)
        count, n = self._integrals.instants, seen.shape[1]
        phase = 2.0 * np.pi / count * np.arange(count)
        values = fourier_basis(phase, np.arange(1, rows // 2 + 1))
        means = 2.0 / count * values
        means[:, 0] *= 0.5
        found = np.empty((rows, n, rows * n))
        if kernel.friction_tangent(
            self._integrals.sets.handle, count, pointer(self.states), pointer(self._origins), rows,
            pointer(values), pointer(means), n, pointer(seen), pointer(found),
        ):  # fmt: skip
            raise MemoryError("friction")
        return found

    def by_softness(self) -> np.ndarray:
        return self._of_values(-self._integrals.unit * self._forces)

    def by_stiffness(self) -> np.ndarray:
        return self._of_values(self._forces * self._integrals.springs)

    def by_share(self) -> np.ndarray:
        """Derivative of the coefficients by the share of the coefficient of friction.

        With lambda = E x, f = E' x of pairs that slip, and D E x = s - h there, it is f and what
        changes - D f of the gaps make of the forces.
        """
        integrals, pairs = self._integrals, self._rows[1] // 2
        friction = friction_of(integrals.law)
        assert friction is not None
        signs = 1.0 * (self.states == kernel.SLIP_UP) - (self.states == kernel.SLIP_DOWN)
        found = np.zeros_like(self._forces)
        found[:, pairs:] = signs * friction.coefficient * self._forces[:, :pairs]
        compliance = integrals.compliance
        return fourier_coefficients(found, integrals.harmonics) + self._of_values(
            -found @ compliance
        )
