"""Periodic vibration of structures with a crack that opens and closes.

Start with ``demos/paper_plate.py``; the equations and conventions are in ``docs/theory.md``.
"""

from mpi4py import MPI  # noqa: F401  (before petsc4py, which would start MPI for one thread)

from fenics_crack.backbone import Backbone, follow_backbone
from fenics_crack.contact import (
    SmoothedPenalty,
    UnilateralConstraint,
    UnilateralPenalty,
    contact_law,
)
from fenics_crack.continuation import (
    Continuation,
    CurvePoint,
    continue_frequency,
    continue_parameter,
    follow_branch,
)
from fenics_crack.curve import Bifurcation, ResponseCurve
from fenics_crack.error_report import ErrorReport
from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.events import PeriodicOrbit, integrate_events, shoot
from fenics_crack.fill import fill_curve
from fenics_crack.finite_elements import build_structure, find_crack_length
from fenics_crack.harmonic_balance import solve_harmonic_balance, solve_linear
from fenics_crack.implicit import integrate_implicit
from fenics_crack.integration import (
    TimeHistory,
    integrate_central_difference,
    stable_steps_per_period,
)
from fenics_crack.modes import Modes, solve_modes
from fenics_crack.preparation import prepare
from fenics_crack.reduction import ReducedStructure, reduce_structure
from fenics_crack.refinement import refine_bifurcation
from fenics_crack.scene import Scene
from fenics_crack.solution import PeriodicSolution, Stability
from fenics_crack.stability import floquet
from fenics_crack.structure import ModalDamping, Structure
from fenics_crack.sweep import SweepResult, run_sweep
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
    "prepare",
    "reduce_structure",
    "refine_bifurcation",
    "run_sweep",
    "shoot",
    "solve_harmonic_balance",
    "solve_linear",
    "solve_modes",
    "stable_steps_per_period",
]
__version__ = VERSION
