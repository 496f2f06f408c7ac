"""What the clamp of a mesh has to hold: Newton's law of all that hangs on it.

A rigid motion r of the whole mesh stretches nothing, K r = 0, and closes no gap, B^T r = 0. So of
all nodes, those in the clamp too, with their displacement u relative to it,

    r . R = r^T M (u'' + a u') - r^T f,

R being the forces of the clamp: a translation gives their sum, a rotation about the clamp's centre
their moment about it. What damps by M, a of Rayleigh's damping, is a drag from outside; all other
damping, that of modes too, is taken to act inside, where it exerts no force on the whole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenics_crack.numerics.fourier import evaluate

__all__ = ["Clamp"]

SPLINE_DEGREE = 5
"""Of the spline through a record: its second derivative is known to the fourth order."""


@dataclass(frozen=True)
class Clamp:
    """Inertia and load of a mesh under its rigid motions: translations first, then rotations.

    Attributes
    ----------
    center : (d,) [m]
        Middle of the clamped nodes, between their least and largest coordinates.
    inertia : (n_rigid, n_local)
        r^T M of the free dofs; 3 motions of a plate, 6 of a solid.
    load : (3, n_rigid) [N], [N m]
        r^T f of the load's mean, cosine and sine part.
    """

    center: np.ndarray
    inertia: np.ndarray
    load: np.ndarray

    def varied(self, weights: float | np.ndarray) -> Clamp:
        """The same under a load whose parts are multiplied by a factor, or mapped to others."""
        return replace(self, load=np.dot(weights, self.load))

    def of_waves(
        self, waves: np.ndarray, omega: float, subharmonic: int, drag: float, phases: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n, d) and moments at phases (n,) of a periodic motion of angular frequency omega.

        ``waves`` (2H+1, n_rigid) are the coefficients of r^T M u; the load has ``subharmonic``
        times the motion's frequency."""
        rate = omega * np.arange(1, len(waves) // 2 + 1)[:, None]
        cosines, sines = waves[1::2], waves[2::2]
        moved = np.zeros_like(waves)
        moved[1::2] = rate * (drag * sines - rate * cosines)
        moved[2::2] = -rate * (drag * cosines + rate * sines)
        return self._split(evaluate(moved, 1.0, phases) - evaluate(self.load, subharmonic, phases))

    def of_record(
        self, time: np.ndarray, seen: np.ndarray, omega: float, drag: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n, d) and moments at the instants (n,) [s] of a record (n, n_rigid) of r^T M u
        under a load of angular frequency omega."""
        from scipy.interpolate import make_interp_spline  # takes a while, for marches alone

        record = make_interp_spline(time, seen, k=SPLINE_DEGREE)
        moved = record.derivative(2)(time) + drag * record.derivative(1)(time)
        return self._split(moved - evaluate(self.load, omega, time))

    def _split(self, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n, d) [N] and moments (n, n_rigid - d) [N m] of R (n, n_rigid)."""
        dimension = len(self.center)
        return found[:, :dimension], found[:, dimension:]
