"""A crack's length over the cycles: the result of :func:`fenics_crack.grow`, and its file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from fenics_crack.errors import InputError
from fenics_crack.files.store import Stored, check_shapes, read, write
from fenics_crack.scene.scene import Scene
from fenics_crack.table import Tabular, counted, with_frequency

__all__ = ["ENDS", "Growth"]

ENDS = {
    "reached": "the length that was asked for is reached",
    "arrested": "there it stops: the range falls below growth.threshold, or to nothing",
    "broken": "there the plate breaks: K_max is growth.toughness",
}
"""How growth ends, in words."""


@dataclass(frozen=True, repr=False)
class Growth(Tabular):
    """A crack's length over the cycles, and what the vibration does meanwhile.

    Attributes
    ----------
    scene : Scene
        With the length of the crack at the beginning.
    length, cycles, time : (n,) [m], [-], [s]
        Of the crack, the cycles until then, and how long they take; one row where it does not grow.
    omega, omega_open, omega_bilinear : (n,) [rad/s]
        Of the load, the mean of a spectrum, and natural frequencies with lips open and of the
        breathing crack, of the mode that is nearest to the load, or to that load of a spectrum
        which drives the crack most.
    response : (n,) [m]
        Half the peak-to-peak displacement of the load's point, in the load's direction.
    largest, smallest, effective, sliding : (n,) [Pa m^1/2]
        K_max, K_min, delta_K_effective and K_II_max; the largest of a spectrum, K_min and K_II_max
        of the load that drives most.
    rate : (n,) [m]
        In a cycle; the mean of a spectrum.
    end : "reached", "arrested" or "broken"
        Whether the length that was asked for is reached, the range falls below the threshold, or
        K_max reaches the toughness.
    solved : (k,) [m]
        Lengths that were solved; between them are splines.
    errors : dict of str to float
        Relative standard deviations of the cycles by the "rate", the "exponent", the "vibration"
        (mesh, modes and harmonics, where half of the cycles are over), and by "interpolation".
    remarks : tuple of str
        What is in doubt.
    """

    scene: Scene
    length: np.ndarray
    cycles: np.ndarray
    time: np.ndarray
    omega: np.ndarray
    omega_open: np.ndarray
    omega_bilinear: np.ndarray
    response: np.ndarray
    largest: np.ndarray
    smallest: np.ndarray
    effective: np.ndarray
    sliding: np.ndarray
    rate: np.ndarray
    end: str
    solved: np.ndarray
    errors: dict[str, float]
    remarks: tuple[str, ...]

    KIND: ClassVar[str] = "crack growth"

    @property
    def life(self) -> float:
        """Cycles to the last length."""
        return float(self.cycles[-1])

    @property
    def factor(self) -> float:
        """Factor, > 1, within which the life is known with 68 %: its logarithm is normal."""
        return math.exp(math.hypot(*self.errors.values()))

    @property
    def repeats(self) -> np.ndarray | None:
        """Run-ups, or repeats of the spectrum, until then (n,); None without a spectrum."""
        repeat = self.scene.given("growth").repeat
        return None if repeat is None else self.cycles / repeat[0]

    @property
    def frequency_drop(self) -> np.ndarray:
        """How much the breathing crack's natural frequency has fallen, relative to the first: (n,)
        [-]."""
        return np.asarray(1.0 - self.omega_bilinear / self.omega_bilinear[0])

    def at(self, cycles: float) -> float:
        """The crack's length after some cycles [m]; nan beyond the last."""
        return float(np.interp(cycles, self.cycles, self.length, right=math.nan))

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every length."""
        found = {
            "cycles": self.cycles,
            "time": self.time,
            "crack_length": self.length,
            "rate": self.rate,
            "omega": self.omega,
            "omega_open": self.omega_open,
            "omega_bilinear": self.omega_bilinear,
            "frequency_drop": self.frequency_drop,
            "response": self.response,
            "K_max": self.largest,
            "K_min": self.smallest,
            "delta_K_effective": self.effective,
            "K_II_max": self.sliding,
        }
        if self.repeats is not None:
            found = {"repeats": self.repeats} | found
        return with_frequency({name: values.tolist() for name, values in found.items()})

    def _title(self) -> str:
        ends = f"{self.length[0]:.4g} to {self.length[-1]:.4g} m"
        drop = f"frequency falls by {self.frequency_drop[-1]:.2%}"
        known = f"{self.life:.4g} cycles within a factor of {self.factor:.3g}"
        return f"{ends}, {known}, {self.end}, {drop}, {counted(len(self.solved), 'length')} solved"

    # --- its file ---------------------------------------------------------------------------------

    def save(self, path: str | Path, comm: MPI.Comm = MPI.COMM_SELF) -> None:
        """Write a file that :meth:`load`, ``fenics-crack plot`` and ``report`` read (collective).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        parts = {name: getattr(self, name) for name in _ARRAYS} | {"end": self.end}
        words = {name: json.dumps(getattr(self, name)) for name in ("errors", "remarks")}
        write(parts | words, path, self.KIND, self.scene, comm)

    @classmethod
    def load(cls, path: str | Path) -> Growth:
        """Read a file of :meth:`save`; nothing is computed.

        Raises
        ------
        InputError
            The file cannot be read, is damaged, or is of something else.
        """
        return cls.of(read(path))

    @classmethod
    def of(cls, stored: Stored) -> Growth:
        """The same of a file that has been read."""
        with stored.taken() as parts:
            scene, end = stored.scene(), str(parts["end"])
            if stored.kind != cls.KIND or scene is None or scene.growth is None or end not in ENDS:
                raise InputError("path", str(stored.path), f"a file of {cls.KIND}")
            check_shapes(parts, dict.fromkeys(_ARRAYS, (len(parts["length"]),)) | {"solved": (-1,)})
            arrays = {name: np.asarray(parts[name], dtype=float) for name in _ARRAYS}
            errors = {str(name): float(e) for name, e in json.loads(parts["errors"]).items()}
            remarks = tuple(map(str, json.loads(parts["remarks"])))
            return cls(scene, end=end, errors=errors, remarks=remarks, **arrays)


_ARRAYS = [field.name for field in fields(Growth) if field.type == "np.ndarray"]
