"""Campbell diagrams: natural frequencies over a rotor's speed, and the engine orders they meet.

A blade is excited at multiples of the rotor's speed, w = n W with the engine order n. Resonances
are where such a line crosses a natural frequency. Of a crack that breathes they lie near the
bilinear frequency 2 w_o w_t / (w_o + w_t), between those with lips open and tied
(:mod:`fenics_crack.model.bilinear`); where rotation holds the crack open, at the open one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError, check_count
from fenics_crack.fem.assembly import assemble
from fenics_crack.fem.build import with_crack_length
from fenics_crack.model.bilinear import BilinearFrequencies
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modes import n_tied_modes, solve_modes
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.table import UNITS, Tabular, counted, with_frequency

__all__ = ["Campbell", "campbell"]

KINDS = ("open", "tied", "bilinear")


@dataclass(frozen=True, repr=False)
class Campbell(Tabular):
    """Natural frequencies over the speed.

    Attributes
    ----------
    speed : (n,) [rad/s]
        W, rising.
    omega_open, omega_tied : (n, m) [rad/s]
        With lips open and with lips tied, in ascending order at each speed; the same without a
        crack.
    cracked : bool
        Whether there are lips.
    """

    speed: np.ndarray
    omega_open: np.ndarray
    omega_tied: np.ndarray
    cracked: bool

    KIND: ClassVar[str] = "Campbell diagram"

    @property
    def omega_bilinear(self) -> np.ndarray:
        """2 w_o w_t / (w_o + w_t): (n, m) [rad/s]."""
        return BilinearFrequencies(self.omega_open, self.omega_tied).omega_bilinear

    @property
    def kinds(self) -> tuple[str, ...]:
        """ "open", "tied" and "bilinear"; "open" alone without a crack."""
        return KINDS if self.cracked else KINDS[:1]

    def crossings(self, order: int, kind: str = "bilinear") -> np.ndarray:
        """Where w = order W meets natural frequencies: (k, 2), mode (from 1) and speed [rad/s].

        Between two speeds the square of a frequency is taken to be linear in W^2.

        Parameters
        ----------
        order : int
            Engine order n.
        kind : "open", "tied" or "bilinear"
            Of the frequencies.

        Raises
        ------
        InputError
            An argument cannot be used.
        """
        check_count("order", order, 1)
        if kind not in KINDS:
            raise InputError("kind", kind, "one of " + ", ".join(map(repr, KINDS)))
        squares, at = getattr(self, f"omega_{kind}") ** 2, self.speed**2
        over = squares - (order**2 * at)[:, None]
        found = []
        for mode, row in enumerate(over.T, 1):
            for place in np.flatnonzero((row[:-1] > 0.0) != (row[1:] > 0.0)):
                share = row[place] / (row[place] - row[place + 1])
                found.append((mode, np.sqrt(at[place] + share * (at[place + 1] - at[place]))))
        return np.array(found).reshape(-1, 2)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every speed and mode."""
        n, m = self.omega_open.shape
        speed = np.repeat(self.speed, m)
        found = {"speed": speed.tolist(), "mode": np.tile(np.arange(1, m + 1), n).tolist()}
        for kind in self.kinds:
            omega = getattr(self, f"omega_{kind}").ravel()
            found[f"omega_{kind}"] = omega.tolist()
            found[f"frequency_{kind}"] = (omega / (2.0 * np.pi)).tolist()
        return with_frequency(found)

    def _units(self) -> dict[str, str]:
        found = {**UNITS}
        for kind in KINDS:
            found |= {f"omega_{kind}": "rad/s", f"frequency_{kind}": "Hz"}
        return found

    def _title(self) -> str:
        span = f"speed {self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        first = self.omega_bilinear[[0, -1], 0]
        rise = f"first {first[0]:.6g} to {first[1]:.6g} rad/s"
        return f"{span}, {counted(self.omega_open.shape[1], 'mode')}, {rise}"


def campbell(
    scene: Scene,
    speeds: Sequence[float] | np.ndarray,
    count: int = 4,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Campbell:
    """Natural frequencies of a scene's blade at some speeds; it is meshed once (collective).

    Parameters
    ----------
    scene : Scene
        With a table ``[rotation]``, whose own speed does not matter.
    speeds : (n,) [rad/s]
        Two or more, rising from 0 or more.
    count : int
        How many of the lowest modes.
    comm : MPI.Comm
        Ranks that share the mesh.

    Returns
    -------
    Campbell
        Frequencies with lips open and tied at each speed.

    Raises
    ------
    InputError
        An argument cannot be used, or a speed is too high.

    Examples
    --------
    >>> diagram = fc.campbell(blade, [0.0, 150.0, 300.0], count=2)
    """
    if scene.rotation is None:
        raise InputError("rotation", None, "given: a table with hub_radius")
    check_count("count", count, 1)
    wanted = np.atleast_1d(numbers(speeds))
    rising = wanted.ndim == 1 and len(wanted) > 1 and bool(np.all(np.diff(wanted) > 0.0))
    if not (rising and wanted[0] >= 0.0 and np.isfinite(wanted[-1])):
        raise InputError("speeds", speeds, "two or more finite numbers, rising from 0 or more")
    scene = with_crack_length(scene.replace({"rotation.speed": float(wanted[-1])}), comm)
    top = assemble(scene, comm)
    assert top.rotation is not None
    found = [_frequencies(top.rotation.at(float(speed)), count) for speed in wanted]
    is_open, tied = (np.array(rows) for rows in zip(*found, strict=True))
    return Campbell(wanted, is_open, tied, top.n_pairs > 0)


def _frequencies(structure: Structure, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The lowest natural frequencies with lips open and with lips tied: (count,) each [rad/s]."""
    count = min(count, structure.n_modes if not structure.n_pairs else n_tied_modes(structure))
    is_open = solve_modes(structure, count).omega
    if not structure.n_pairs:
        return is_open, is_open
    return is_open, solve_modes(structure, count, lips="tied").omega
