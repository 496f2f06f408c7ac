"""Rotor angles at which a vibrating tip passes stationary probes.

The tip's angle is that of the rotor, alpha, plus what its vibration adds (Heath and Imregun,
International Journal of Mechanical Sciences 38, 1996, 1047, solve the same for arrival times):

    theta(alpha) = alpha + u(alpha) / R,     u(alpha) = Re sum_k U_k exp(i k q alpha)

U_k are the harmonics of the tip's tangential displacement, positive in the direction of rotation,
and q the periods of the response in a revolution. The tip passes a probe at phi in revolution n
where theta = phi + 2 pi n. As |u| <= sum |U_k|, each root lies within sum |U_k| / R of that angle.
Newton's method finds all roots at once; a step that leaves its root's bracket, or is not half as
long as the one before, is replaced by the middle of the bracket. There is one root, as long as the
tip moves forwards: theta' > 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval

from fenics_crack.numerics.fourier import from_complex, sampled

__all__ = ["Rotor", "TipMotion", "passing_angles"]

BLOCK = 2**15
"""Passages solved at once."""
MOST_STEPS = 200
"""More than bisection needs from any bracket to rounding."""


@dataclass(frozen=True)
class Rotor:
    """Rotation at constant acceleration, from angle 0 at time 0.

    Attributes
    ----------
    begin, end : float [rad/s]
        Speed at the beginning, and after all revolutions.
    revolutions : int
        How many.
    """

    begin: float
    end: float
    revolutions: int

    @property
    def acceleration(self) -> float:
        """[rad/s^2]."""
        return (self.end - self.begin) * (self.end + self.begin) / (4.0 * np.pi * self.revolutions)

    def speed(self, angle: np.ndarray) -> np.ndarray:
        """Speed [rad/s] at angles [rad]."""
        return np.asarray(np.sqrt(self.begin**2 + 2.0 * self.acceleration * angle))

    def time(self, angle: np.ndarray) -> np.ndarray:
        """Time [s] at angles [rad]; no cancellation where the acceleration is small."""
        return np.asarray(2.0 * angle / (self.begin + self.speed(angle)))


@dataclass(frozen=True)
class TipMotion:
    """The tip's tangential displacement over the rotor's angle.

    Attributes
    ----------
    rotor : Rotor
        How the hub turns.
    speeds : (n,) [rad/s]
        Speeds at which the vibration is known, increasing; between them it is interpolated.
    harmonics : (n, H+1) complex [m]
        U_k at these speeds.
    order : float
        Periods of the response in a revolution, q.
    """

    rotor: Rotor
    speeds: np.ndarray
    harmonics: np.ndarray
    order: float

    @property
    def reach(self) -> float:
        """Bound of |u| [m]."""
        return float(np.abs(self.harmonics).sum(axis=1).max())

    @property
    def _rates(self) -> np.ndarray:
        """Harmonics of du/dalpha at the speeds: (n, H+1)."""
        return 1j * self.order * np.arange(self.harmonics.shape[1]) * self.harmonics

    def fastest_backwards(self) -> float:
        """Bound of -du/dalpha [m], at all speeds: the largest of samples over a period, and what
        it may be between them."""
        rates = self._rates.T
        orders = np.arange(len(rates))[:, None]
        count = max(1024, 64 * len(rates))
        between = (2.0 * np.pi / count) ** 2 / 8.0 * (orders**2 * np.abs(rates)).sum(axis=0)
        return float((between - sampled(from_complex(rates), count).min(axis=0)).max())

    def at(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u [m] and du/dalpha [m] at rotor angles (n,) [rad]."""
        turn = np.exp(1j * self.order * angle)
        if len(self.speeds) == 1:
            parts = self.harmonics[0], self._rates[0]
            return polyval(turn, parts[0]).real, polyval(turn, parts[1]).real
        speed = self.rotor.speed(angle)
        left = np.clip(np.searchsorted(self.speeds, speed) - 1, 0, len(self.speeds) - 2)
        width = self.speeds[left + 1] - self.speeds[left]
        share = np.clip((speed - self.speeds[left]) / width, 0.0, 1.0)
        steps = (self.harmonics[left + 1] - self.harmonics[left]).T
        here = self.harmonics[left].T + share * steps
        rates = 1j * self.order * np.arange(len(here))[:, None] * here
        inside = (speed > self.speeds[0]) & (speed < self.speeds[-1])
        rates += np.where(inside, self.rotor.acceleration / (speed * width), 0.0) * steps
        return (polyval(turn, here, tensor=False).real, polyval(turn, rates, tensor=False).real)


def passing_angles(motion: TipMotion, targets: np.ndarray, radius: float) -> np.ndarray:
    """Rotor angles alpha with alpha + u(alpha) / R = targets (n,) [rad], to rounding: (n,) [rad];
    nan where the tip moves backwards."""
    count = -(-len(targets) // BLOCK)
    return np.concatenate([_roots(motion, part, radius) for part in np.array_split(targets, count)])


def _roots(motion: TipMotion, targets: np.ndarray, radius: float) -> np.ndarray:
    reach = motion.reach / radius * (1.0 + 1e-12) + 4.0 * np.spacing(np.abs(targets))
    low, high, angle = targets - reach, targets + reach, targets.copy()
    last, slope = high - low, np.ones_like(targets)
    for _ in range(MOST_STEPS):
        value, rate = motion.at(angle)
        excess, slope = angle - targets + value / radius, 1.0 + rate / radius
        high, low = np.where(excess >= 0.0, angle, high), np.where(excess <= 0.0, angle, low)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -excess / slope
        middle = 0.5 * (low + high) - angle
        inside = (angle + step >= low) & (angle + step <= high)
        step = np.where(inside & (np.abs(step) <= 0.5 * last), step, middle)
        angle, last = angle + step, np.abs(step)
        if np.all(last <= 2.0 * np.spacing(np.abs(targets) + reach)):
            break
    return np.where(slope > 0.0, angle, np.nan)
