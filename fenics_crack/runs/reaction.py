"""Forces and moments of the clamp over a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.observables import Place, read_observables
from fenics_crack.basics.tables import Tabular, format_quantity
from fenics_crack.model.nodes import AXES
from fenics_crack.runs.run import Run, check_run_has_motion
from fenics_crack.scene.scene import reason_without_clamp_forces, refuse_for_reason
from fenics_crack.study.observer import clamp_inertia_rows, compute_clamp_reactions
from fenics_crack.time.march import TimeHistory


@dataclass(frozen=True, repr=False)
class Reaction(Tabular):
    """Forces and moments of a plate's or solid's clamp during a motion.

    Attributes
    ----------
    time : (n,) [s]
        Instants in one period of a solution, or in the record of a motion in time.
    center : (d,) [m]
        Centre of the clamp, the reference point of the moments.
    force : (n, d) [N]
        Force of the clamp on the body; for a plate through its whole thickness.
    moment : (n, 1) or (n, 3) [N m]
        Moment of the clamp on the body: about z for a plate; about x, y and z for a solid.
    """

    time: np.ndarray
    center: np.ndarray
    force: np.ndarray
    moment: np.ndarray

    @property
    def numbers(self) -> Mapping[str, float]:
        """Largest magnitudes over time: ``reaction_force`` [N] and ``reaction_moment`` [N m]."""
        return read_observables(Place.CLAMP, self)

    def to_dict(self) -> dict[str, Any]:
        """Return columns by name, with a row for every instant.

        The names are "time" [s], "force_x" [N] and so on, then "moment_z" [N m]. A solid also has
        "moment_x" and "moment_y".
        """
        force_axis_names = AXES[: self.force.shape[1]]
        moment_axis_names = AXES[-self.moment.shape[1] :]
        column_names = [
            *(f"force_{axis_name}" for axis_name in force_axis_names),
            *(f"moment_{axis_name}" for axis_name in moment_axis_names),
        ]
        columns = np.hstack([self.force, self.moment]).T.tolist()
        return {"time": self.time.tolist()} | dict(zip(column_names, columns, strict=True))

    def _unit_by_name(self) -> Mapping[str, str]:
        unit_by_prefix = {"time": "s", "force": "N", "moment": "N m"}
        return {name: unit_by_prefix[name.partition("_")[0]] for name in self.to_dict()}

    def _repr_text(self) -> str:
        largest_force, largest_moment = self.numbers.values()
        center_text = ", ".join(f"{center_coordinate:.4g}" for center_coordinate in self.center)
        return (
            f"up to {format_quantity(largest_force, 'N')} and "
            f"{format_quantity(largest_moment, 'N m')} about ({center_text}) m"
        )


def reaction(run: Run[PeriodicSolution] | Run[TimeHistory]) -> Reaction:
    r"""Find forces and moments of the clamp over a motion (collective).

    Newton's law holds for the whole body. With the rigid-body motions r (translations, and
    rotations about the clamp's centre), mass M, displacement u and load f, the reaction R follows
    from

    .. math:: r \cdot R = r^T M (\ddot u + \alpha \dot u) - r^T f.

    The factor :math:`\alpha` of Rayleigh damping is a drag from outside. All other damping acts
    inside the body and adds no force. Contact forces on both crack faces cancel. In a reduced
    structure, truncated modes have no inertia, but the load on them is included.

    Parameters
    ----------
    run : Run
        Result of :func:`fenics_crack.solve` or :func:`fenics_crack.integrate`, for a meshed
        structure without rotation.

    Returns
    -------
    Reaction
        Reaction over a period of a solution (1024 instants or more), or over the record of a motion
        in time. The acceleration of a record is that of a spline.

    Raises
    ------
    InputError
        The run is of another kind, has matrices (which have no clamp), or rotates.

    Examples
    --------
    >>> held = fc.reaction(fc.solve(scene))
    >>> held.force.mean(axis=0), held.numbers["reaction_moment"]
    """
    check_run_has_motion(run)
    refuse_for_reason(reason_without_clamp_forces(run.scene), "run", repr(run))
    structure = run.result.structure
    [record] = run.result.yield_motion_records(structure.compute_once(clamp_inertia_rows))
    return Reaction(record.time, structure.whole.clamp.center, *compute_clamp_reactions(record))
