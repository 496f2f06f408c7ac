# The names of fenics_crack and where they are from: for __init__.py, editors and mypy.

from fenics_crack.balance.error_report import ErrorReport as ErrorReport
from fenics_crack.balance.harmonic_balance import solve_harmonic_balance as solve_harmonic_balance
from fenics_crack.balance.harmonic_balance import solve_linear as solve_linear
from fenics_crack.balance.problem import Problem as Problem
from fenics_crack.balance.solution import PeriodicSolution as PeriodicSolution
from fenics_crack.balance.solution import Stability as Stability
from fenics_crack.curves.backbone import Backbone as Backbone
from fenics_crack.curves.backbone import follow_backbone as follow_backbone
from fenics_crack.curves.continuation import Continuation as Continuation
from fenics_crack.curves.continuation import CurvePoint as CurvePoint
from fenics_crack.curves.curve import Bifurcation as Bifurcation
from fenics_crack.curves.curve import ResponseCurve as ResponseCurve
from fenics_crack.curves.exact import judge_curve as judge_curve
from fenics_crack.curves.follow import continue_frequency as continue_frequency
from fenics_crack.curves.follow import continue_parameter as continue_parameter
from fenics_crack.curves.follow import follow_branch as follow_branch
from fenics_crack.curves.refine import refine_curve as refine_curve
from fenics_crack.draw.animation import animate_period as animate_period
from fenics_crack.draw.animation import show_period as show_period
from fenics_crack.draw.paraview import write_modes as write_modes
from fenics_crack.draw.paraview import write_period as write_period
from fenics_crack.draw.plot import Wave as Wave
from fenics_crack.draw.plot import draw_contact_map as draw_contact_map
from fenics_crack.draw.plot import draw_content as draw_content
from fenics_crack.draw.plot import draw_curve as draw_curve
from fenics_crack.draw.plot import draw_laws as draw_laws
from fenics_crack.draw.plot import draw_map as draw_map
from fenics_crack.draw.plot import draw_modes as draw_modes
from fenics_crack.draw.plot import draw_multipliers as draw_multipliers
from fenics_crack.draw.plot import draw_response as draw_response
from fenics_crack.draw.plot import draw_waves as draw_waves
from fenics_crack.draw.plot_motion import draw_orbits as draw_orbits
from fenics_crack.draw.plot_motion import draw_spectrum as draw_spectrum
from fenics_crack.errors import ConvergenceError as ConvergenceError
from fenics_crack.errors import InputError as InputError
from fenics_crack.fem.build import build_structure as build_structure
from fenics_crack.fem.build import find_crack_length as find_crack_length
from fenics_crack.files.results import load as load
from fenics_crack.files.results import save as save
from fenics_crack.model.contact import ContactLaw as ContactLaw
from fenics_crack.model.contact import SmoothedPenalty as SmoothedPenalty
from fenics_crack.model.contact import UnilateralConstraint as UnilateralConstraint
from fenics_crack.model.contact import UnilateralPenalty as UnilateralPenalty
from fenics_crack.model.damping import ModalDamping as ModalDamping
from fenics_crack.model.damping import RayleighDamping as RayleighDamping
from fenics_crack.model.modes import Modes as Modes
from fenics_crack.model.modes import solve_modes as solve_modes
from fenics_crack.model.reduced import MasslessStructure as MasslessStructure
from fenics_crack.model.reduced import ReducedStructure as ReducedStructure
from fenics_crack.model.reduction import reduce_structure as reduce_structure
from fenics_crack.model.structure import Structure as Structure
from fenics_crack.scene.scene import Scene as Scene
from fenics_crack.stability.floquet import floquet as floquet
from fenics_crack.stability.refinement import refine_bifurcation as refine_bifurcation
from fenics_crack.stability.shooting import PeriodicOrbit as PeriodicOrbit
from fenics_crack.stability.shooting import shoot as shoot
from fenics_crack.study.prepare import Study as Study
from fenics_crack.study.prepare import contact_law as contact_law
from fenics_crack.study.prepare import prepare as prepare
from fenics_crack.study.run import Run as Run
from fenics_crack.study.run import load_run as load_run
from fenics_crack.sweep.result import SweepResult as SweepResult
from fenics_crack.sweep.result import run_sweep as run_sweep
from fenics_crack.time.central_differences import (
    integrate_central_difference as integrate_central_difference,
)
from fenics_crack.time.central_differences import stable_steps_per_period as stable_steps_per_period
from fenics_crack.time.events import integrate_events as integrate_events
from fenics_crack.time.exponential import integrate_exponential as integrate_exponential
from fenics_crack.time.implicit import integrate_implicit as integrate_implicit
from fenics_crack.time.march import TimeHistory as TimeHistory

__all__: list[str]
__version__: str
