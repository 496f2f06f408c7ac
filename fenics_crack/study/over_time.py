"""What a motion does over time: stress intensity at the tips of cracks, which makes these grow, and
forces and moments of the clamp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.model.nodes import AXES
from fenics_crack.scene.scene import check_known, without_clamp, without_tips
from fenics_crack.study.asked import (
    clamp_of_motion,
    numbers_at_clamp,
    numbers_at_tips,
    periods_of,
    tip_rows,
)
from fenics_crack.study.run import Run, check_motion
from fenics_crack.study.stated_errors import errors_of
from fenics_crack.study.verification import Verification
from fenics_crack.table import Tabular, quantity
from fenics_crack.time.march import TimeHistory

__all__ = ["Reaction", "StressIntensity", "reaction", "stress_intensity"]


@dataclass(frozen=True, repr=False)
class StressIntensity(Tabular):
    """K_I and K_II at the tips of a plate's cracks over a motion.

    Attributes
    ----------
    time : (n,) [s]
        Over one period of a solution, or the record of a motion in time.
    tips : tuple of str
        Which tips: "the tip", "the left tip", "the tip of crack 2".
    points, ahead : (n_tips, 2) [m], (n_tips, 2)
        Where they are, and where the cracks run straight on.
    one, two : (n, n_tips) [Pa m^1/2]
        K_I, positive where the lips part, and K_II, positive where the lip on the left of who looks
        ahead moves ahead.
    """

    time: np.ndarray
    tips: tuple[str, ...]
    points: np.ndarray
    ahead: np.ndarray
    one: np.ndarray
    two: np.ndarray
    _run: Run[Any] = field(compare=False)

    @property
    def numbers(self) -> Mapping[str, np.ndarray]:
        """Each tip's K_max, K_min, delta_K, delta_K_effective and K_II_max: (n_tips,) [Pa m^1/2].

        The effective range is that while the tip is open, max(K_I, 0) - max(min K_I, 0). With a
        table ``[growth]`` delta_K_equivalent, too: the range from 0 that, once a period of the
        load, makes the crack grow as much as all cycles of K_I do, counted by rain flow.
        """
        both = np.stack([self.one, self.two], axis=-1)
        return numbers_at_tips(both, self._run.scene.growth, periods_of(self._run.result))

    @property
    def largest(self) -> np.ndarray:
        """Largest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_max"]

    @property
    def smallest(self) -> np.ndarray:
        """Smallest K_I of each tip: (n_tips,) [Pa m^1/2]."""
        return self.numbers["K_min"]

    @property
    def effective(self) -> np.ndarray:
        """Range of K_I of each tip while it is open: (n_tips,) [Pa m^1/2]."""
        return self.numbers["delta_K_effective"]

    @property
    def leading(self) -> int:
        """The tip whose effective range is the largest."""
        return int(np.argmax(self.effective))

    @property
    def turn(self) -> np.ndarray:
        """Angle by which each crack would turn at its largest K_I, to the left, where the hoop
        stress is largest: (n_tips,) [rad].

        K_I sin(theta) + K_II (3 cos(theta) - 1) = 0 (Erdogan, Sih, Journal of Basic Engineering 85,
        1963, 519); nan where K_I is never positive.
        """
        place = self.one.argmax(axis=0)[None]
        one = np.take_along_axis(self.one, place, axis=0)[0]
        two = np.take_along_axis(self.two, place, axis=0)[0]
        found = -2.0 * np.arctan(2.0 * two / (one + np.sqrt(one**2 + 8.0 * two**2)))
        return np.where(one > 0.0, found, np.nan)

    @cached_property
    def errors(self) -> Verification | None:
        """What modes, harmonics and the mesh contribute to the error of the leading tip's numbers,
        by one other run for each; None of motions in time. Computed when first asked for
        (collective)."""
        scene = self._run.scene.replace({"output.quantities": tuple(self.numbers)})
        return errors_of(replace(self._run, scene=scene, stated=None), self._run.result)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every instant: K_I and K_II of each tip."""
        found = {"time": self.time.tolist()}
        for tip, one, two in zip(self.tips, self.one.T, self.two.T, strict=True):
            found |= {f"K_I, {tip}": one.tolist(), f"K_II, {tip}": two.tolist()}
        return found

    def _units(self) -> Mapping[str, str]:
        return {name: "s" if name == "time" else "Pa m^0.5" for name in self.to_dict()}

    def _title(self) -> str:
        shown = self.numbers, self.leading
        parts = [f"{name} = {values[shown[1]]:.4g}" for name, values in shown[0].items()]
        return f"{', '.join(parts)} Pa m^0.5 at {self.tips[self.leading]}"


def stress_intensity(run: Run[PeriodicSolution] | Run[TimeHistory]) -> StressIntensity:
    r"""Find stress intensities at the tips of a plate's cracks over a motion (collective).

    K_I and K_II of the displacement at each instant, by the interaction integral over a domain
    around the tip, with the inertia in it and the contact on the lips. Where a structure is reduced
    the modes' statics are not summed up but solved for: with q_r the amplitudes of the modes,

    .. math:: K = K_{\mathrm{static}}(f, \lambda) + \sum_r K_r (q_r - q_{r,\mathrm{static}}).

    Parameters
    ----------
    run : Run
        What :func:`fenics_crack.solve` or :func:`fenics_crack.integrate` returns, of a plate with a
        crack.

    Returns
    -------
    StressIntensity
        Over a period of a solution (1024 instants or more), or the record of a motion in time.

    Raises
    ------
    InputError
        It is neither of them, of a solid or of matrices, or without a crack.

    Examples
    --------
    >>> found = fc.stress_intensity(fc.solve(scene))
    >>> found.largest, found.effective, found.turn
    """
    check_motion(run)
    check_known(without_tips(run.scene), "run", repr(run))
    rows = tip_rows(run)
    time, found = rows.of_motion(run.result)
    return StressIntensity(
        time,
        tuple(tip.name for tip in rows.tips),
        np.array([tip.point for tip in rows.tips]),
        np.array([tip.ahead for tip in rows.tips]),
        found[..., 0],
        found[..., 1],
        run,
    )


@dataclass(frozen=True, repr=False)
class Reaction(Tabular):
    """Forces and moments of the clamp on a plate or a solid over a motion.

    Attributes
    ----------
    time : (n,) [s]
        Over one period of a solution, or the record of a motion in time.
    center : (d,) [m]
        Of the clamp: the moments are about it.
    force : (n, d) [N]
        Of the clamp on what it holds; of a plate through its whole thickness.
    moment : (n, 1) or (n, 3) [N m]
        Likewise: about z of a plate; about x, y and z of a solid.
    """

    time: np.ndarray
    center: np.ndarray
    force: np.ndarray
    moment: np.ndarray

    @property
    def numbers(self) -> Mapping[str, float]:
        """Largest size of the force [N], ``reaction_force``, and of the moment [N m],
        ``reaction_moment``."""
        return numbers_at_clamp(self.force, self.moment)

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every instant."""
        found = {"time": self.time.tolist()}
        axes, about = AXES[: self.force.shape[1]], AXES[-self.moment.shape[1] :]
        names = [f"force_{axis}" for axis in axes] + [f"moment_{axis}" for axis in about]
        columns = np.hstack([self.force, self.moment]).T.tolist()
        return found | dict(zip(names, columns, strict=True))

    def _units(self) -> Mapping[str, str]:
        units = {"time": "s", "force": "N", "moment": "N m"}
        return {name: units[name.partition("_")[0]] for name in self.to_dict()}

    def _title(self) -> str:
        force, moment = self.numbers.values()
        place = ", ".join(f"{x:.4g}" for x in self.center)
        return f"up to {quantity(force, 'N')} and {quantity(moment, 'N m')} about ({place}) m"


def reaction(run: Run[PeriodicSolution] | Run[TimeHistory]) -> Reaction:
    r"""Find the forces and moments of the clamp over a motion (collective).

    By Newton's law of all that the clamp holds: with r the translations, and the rotations about
    its centre,

    .. math:: r \cdot R = r^T M (\ddot u + \alpha \dot u) - r^T f,

    :math:`\alpha` that of Rayleigh's damping, a drag from outside; all other damping acts inside,
    and adds no force. Contact presses both lips alike, and adds none either. What modes leave out
    has no inertia, but its share of the load is in it.

    Parameters
    ----------
    run : Run
        What :func:`fenics_crack.solve` or :func:`fenics_crack.integrate` returns, of a mesh at
        rest.

    Returns
    -------
    Reaction
        Over a period of a solution (1024 instants or more), or the record of a motion in time,
        whose acceleration is that of a spline.

    Raises
    ------
    InputError
        It is neither of them, or of matrices, which have no clamp, or of a structure that rotates.

    Examples
    --------
    >>> held = fc.reaction(fc.solve(scene))
    >>> held.force.mean(axis=0), held.numbers["reaction_moment"]
    """
    check_motion(run)
    check_known(without_clamp(run.scene), "run", repr(run))
    time, force, moment = clamp_of_motion(run.result)
    return Reaction(time, run.result.structure.whole.clamp.center, force, moment)
