"""Periodic vibration of structures with a crack that opens and closes.

Start with ``demos/paper_plate.py``; the equations and conventions are in ``docs/theory.md``.
"""

from mpi4py import MPI  # noqa: F401  (before petsc4py, which would start MPI for one thread)

from fenics_crack.balance.error_report import ErrorReport
from fenics_crack.balance.harmonic_balance import solve_harmonic_balance, solve_linear
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.curves.backbone import Backbone, follow_backbone
from fenics_crack.curves.continuation import (
    Continuation,
    CurvePoint,
    continue_frequency,
    continue_parameter,
    follow_branch,
)
from fenics_crack.curves.curve import Bifurcation, ResponseCurve
from fenics_crack.curves.refine import fill_curve
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.fem.assembly import build_structure, find_crack_length
from fenics_crack.files.results import load, save
from fenics_crack.model.contact import SmoothedPenalty, UnilateralConstraint, UnilateralPenalty
from fenics_crack.model.modes import Modes, solve_modes
from fenics_crack.model.reduction import ReducedStructure, reduce_structure
from fenics_crack.model.structure import ModalDamping, Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.stability.floquet import floquet
from fenics_crack.stability.refinement import refine_bifurcation
from fenics_crack.stability.shooting import PeriodicOrbit, shoot
from fenics_crack.study.prepare import contact_law, prepare
from fenics_crack.sweep.result import SweepResult, run_sweep
from fenics_crack.time.central_differences import (
    integrate_central_difference,
    stable_steps_per_period,
)
from fenics_crack.time.events import integrate_events
from fenics_crack.time.implicit import integrate_implicit
from fenics_crack.time.march import TimeHistory
from fenics_crack.version import VERSION

__all__ = [
    "Backbone",
    "Bifurcation",
    "Continuation",
    "ConvergenceError",
    "CurvePoint",
    "ErrorReport",
    "InputError",
    "ModalDamping",
    "Modes",
    "PeriodicOrbit",
    "PeriodicSolution",
    "ReducedStructure",
    "ResponseCurve",
    "Scene",
    "SmoothedPenalty",
    "Stability",
    "Structure",
    "SweepResult",
    "TimeHistory",
    "UnilateralConstraint",
    "UnilateralPenalty",
    "build_structure",
    "contact_law",
    "continue_frequency",
    "continue_parameter",
    "fill_curve",
    "find_crack_length",
    "floquet",
    "follow_backbone",
    "follow_branch",
    "integrate_central_difference",
    "integrate_events",
    "integrate_implicit",
    "load",
    "prepare",
    "reduce_structure",
    "refine_bifurcation",
    "run_sweep",
    "save",
    "shoot",
    "solve_harmonic_balance",
    "solve_linear",
    "solve_modes",
    "stable_steps_per_period",
]
__version__ = VERSION
