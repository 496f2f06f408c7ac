"""Result of a command with its study: scene, structure, contact law and watched points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import on_root
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.peak import Peak
from fenics_crack.errors.stated import errors_of
from fenics_crack.errors.verification import Verification
from fenics_crack.files.results import Result, save
from fenics_crack.model.modes import Modes
from fenics_crack.motion.motions import ObservedMotion
from fenics_crack.runs.conclusion import Answer, said_of
from fenics_crack.time.march import TimeHistory

Found = TypeVar("Found", bound=Result, covariant=True)


@dataclass(frozen=True, repr=False)
class Run(Answer, Generic[Found]):
    """A study with its result, whose attributes are also its own: ``run.peak()``.

    Attributes
    ----------
    scene, structure, contact, watched
        As :class:`Study` has them.
    result : Modes, PeriodicSolution, ResponseCurve or TimeHistory
        Result of the computation.
    stated : Verification or None
        Its :attr:`errors`, where they were computed with it.
    """

    result: Found
    stated: Verification | None = None

    @cached_property
    def errors(self) -> Verification | None:
        """Return the stated errors of each number; None for motions in time.

        A curve has those of its largest response. They are computed when first requested
        (collective).
        """
        return self.stated or errors_of(self, self.result)

    def __str__(self) -> str:
        return f"{self.result!r}: {said_of(self).closing()}"

    def __repr__(self) -> str:
        return f"Run({self.result!r}, {self.scene!r})"

    def _repr_html_(self) -> str:
        return self.result.table().html(str(self))

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__()} - {"peak"} | {*dir(self.result)})

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or "result" not in vars(self):  # while it is being copied
            raise AttributeError(f"'Run' object has no attribute {name!r}")
        return getattr(self.result, name)

    def peak(self, dof: int | None = None) -> Peak:
        """Return the largest response of a curve (:meth:`ResponseCurve.peak`; collective).

        The watched dof's peak has the stated :attr:`errors`.
        """
        if not isinstance(self.result, ResponseCurve):
            raise AttributeError("'Run' object has no attribute 'peak'")
        peak, errors = self.result.peak(dof), self.errors
        if errors is None or not errors.parts or dof not in (None, self.watched_dof):
            return peak
        names = self.watched[0].column("amplitude"), errors.resonance
        amplitude_error, omega_error = (errors.stated(name)[0] for name in names)
        return replace(
            peak,
            error=amplitude_error,
            omega_error=math.nan if peak.at_end else omega_error,
            without=errors.without,
        )

    def motion(self) -> dict[str, np.ndarray]:
        """Return the motion of what is watched [m], by its words (collective).

        A solution has coefficients (2H+1,), a curve (n, 2H+1), a motion in time displacements (n,),
        and modes have none.
        """
        result, dofs = self.result, [watched.dof for watched in self.watched]
        columns: list[np.ndarray] = []
        if isinstance(result, TimeHistory):
            columns = list(result.displacement(dofs).T)
        elif isinstance(result, ObservedMotion):
            columns = [displacement.coefficients for displacement in result.observe(dofs)[0]]
        return dict(zip((watched.words for watched in self.watched), columns, strict=False))

    def save(self, path: str | Path) -> None:
        """Write the result with its scene, stated errors and watched motion (collective).

        :func:`load_run` reads it, and so do programs without the structure
        (:func:`fenics_crack.save`).

        Raises
        ------
        InputError
            The file cannot be written.
        """
        errors = None if self.stated is None else self.stated.text()
        write = partial(save, self.result, path, self.scene, watched=self.motion(), errors=errors)
        is_shared = isinstance(self.result, PeriodicSolution | Modes)  # spread over ranks
        if self.structure.comm.size > 1 and is_shared:
            write()
        else:
            on_root(self.structure.whole.comm, write)


def check_motion(run: object) -> None:
    """Raise InputError unless it is the run of a solution or of a time integration."""
    if not (isinstance(run, Run) and isinstance(run.result, PeriodicSolution | TimeHistory)):
        allowed = "what fc.solve(scene) or fc.integrate(scene) returns"
        raise InputError("run", type(getattr(run, "result", run)).__name__, allowed)
