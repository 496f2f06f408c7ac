"""Switching instants as the contact integrals find them: every sign change of real trigonometric
polynomials, certified.

    g(theta) = Re sum_{k=0}^{H} G_k exp(i k theta),      theta = omega t in [0, 2 pi)

The search is compiled (``kernel/switching.c``). Here its instants are laid open, for tests and for
the harmonic balance of increments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.contact_integrals import cosines_and_sines_on_quarter_period
from fenics_crack.kernel import kernel, pointer
from fenics_crack.numerics.fourier import from_complex


@dataclass(frozen=True)
class Switching:
    """Sign changes of the gaps of all pairs.

    Attributes
    ----------
    pair : (m,) int
        To which pair each belongs.
    theta : (m,) [rad]
        Phase in [0, 2 pi], ascending for each pair.
    closing : (m,)
        +1 where the gap becomes positive (the pair closes), -1 where it opens.
    closed_at_start : (n_pairs,) bool
        Whether the gap is positive at theta = 0.
    """

    pair: np.ndarray
    theta: np.ndarray
    closing: np.ndarray
    closed_at_start: np.ndarray


def switching_instants(harmonics: np.ndarray) -> Switching:
    """Find all sign changes of the polynomials with complex harmonics (H+1, n_pairs)."""
    gaps = np.ascontiguousarray(from_complex(harmonics).T)
    is_closed = np.zeros(len(gaps), dtype=np.int8)
    pair_events = [_of_one(gap, is_closed[pair : pair + 1]) for pair, gap in enumerate(gaps)]
    count = [len(theta) for theta, _ in pair_events]
    theta, is_closing = (np.concatenate(part) for part in zip(*pair_events, strict=True))
    return Switching(np.repeat(np.arange(len(gaps)), count), theta, is_closing, is_closed > 0)


def _of_one(gap: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Phases and kinds of the sign changes of one gap's coefficients (2H+1,)."""
    room = count = len(gap) + 1
    while count >= room:  # more than 2H only where a gap is zero to rounding
        room = count + 1
        theta, is_closing = np.empty(room), np.empty(room)
        count = kernel.switching_instants(
            len(gap) // 2, 1, pointer(gap),
            pointer(cosines_and_sines_on_quarter_period(len(gap) // 2)), room,
            pointer(theta), pointer(is_closing), pointer(closed),
        )  # fmt: skip
    if count < 0:
        raise MemoryError("switching instants")
    return theta[:count], is_closing[:count]
