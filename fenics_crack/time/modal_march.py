"""Time integration of small structures in the coordinates of all their modes, by the kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, pointer
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.modal import CACHED, all_modes
from fenics_crack.time.march import March, Scheme, Window


class ModalSteps(Scheme):
    """State of a small structure in modal coordinates, and what the kernel's steps have in common.

    What acts on the modes is "by mode": an array (n,) where the damping leaves them uncoupled, and
    a matrix (n, n) where it couples them.
    """

    _known: Struct
    """State of the scheme in the kernel's form; with the arrays that hold it."""

    def __init__(self, asked: March) -> None:
        self._asked, self._modes = asked, all_modes(asked.structure)
        self._springs = None
        if not asked.rigid:
            stiffness = np.asarray(asked.contact.stiffness, float)
            self._springs = np.broadcast_to(stiffness, self._modes.pairs.shape[1])

    def _begin(self) -> np.ndarray:
        """The shape at the start, of which the velocity is returned."""
        pairs = self._modes.pairs
        self._shape, velocity = (self._modes.inverse @ part for part in self._asked.start)
        gap = self._gap()
        if self._asked.rigid and np.any(gap > 0.0):  # by the least change in the norm of M
            self._shape -= pairs @ solve_complementarity(pairs.T @ pairs, gap)
        return np.asarray(velocity)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """f - w^2 q - P lambda - c v at phase zero of the load; forces of a constraint, which
        belong to the next step, are left out."""
        modes, mean_and_cosine = self._modes, self._asked.structure.force[:2].sum(axis=0)
        found = mean_and_cosine @ modes.shapes - modes.squares * self._shape
        if self._springs is not None:
            found -= modes.pairs @ self._asked.contact.force(self._gap())
        return np.asarray(found - modes.damped(velocity))

    def _inverse(self, undamped: np.ndarray, dashpot: float) -> np.ndarray:
        """Return the inverse of ``undamped`` (n,) + dashpot C, by mode."""
        damped = dashpot * self._modes.damping
        if damped.ndim == 1:
            return np.asarray(1.0 / (undamped + damped))
        return np.linalg.inv(np.diag(undamped) + damped)

    def _energy_of(self, velocity: np.ndarray) -> float:
        """Kinetic and elastic, without contact [J]."""
        return 0.5 * float(self._modes.squares @ self._shape**2 + velocity @ velocity)

    def _body(self, **more: Any) -> Struct:
        """Return the kernel's vibrating structure, and its load."""
        asked, modes, rows = self._asked, self._modes, np.ascontiguousarray
        count, pairs = modes.pairs.shape
        return Struct(
            "vibration", modes=count, pairs=pairs, coupled=modes.damping.ndim == 2,
            squares=rows(modes.squares), rows=rows(modes.pairs.T),
            clearance=np.broadcast_to(np.asarray(asked.structure.clearance, float), pairs).copy(),
            springs=None if self._springs is None else self._springs.copy(),
            load=rows(asked.structure.force @ modes.shapes), waves=asked.waves, **more,
        )  # fmt: skip

    def _march(self, window: Window, steps: Callable[..., int]) -> None:
        """Record a period by the kernel's function."""
        modes, asked, count = self._modes, self._asked, len(window.gap)
        some = max(1, CACHED // len(modes.squares))
        for first in range(0, count, some):
            place = slice(first, min(first + some, count))
            shape = np.empty((place.stop - first, len(modes.squares)))
            made = steps(
                self._known.at, first, len(shape), pointer(window.gap[place]),
                pointer(window.force[place]), pointer(shape),
            )  # fmt: skip
            if made < len(shape):
                raise ConvergenceError(f"contact: no forces of step {first + made} were found")
            window.motion[place] = shape @ modes.shapes[asked.recorded_dofs].T
            window.load_motion[place] = shape @ modes.shapes[asked.load_rows].T

    def _gap(self) -> np.ndarray:
        """Gap at the end of the integration."""
        return np.asarray(self._shape @ self._modes.pairs - self._asked.structure.clearance)


def times_by_mode(values: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return values by mode times columns (n, m)."""
    return np.asarray(values[:, None] * columns if values.ndim == 1 else values @ columns)
