"""Every bad input that a scene or a command can meet, and the one line that the program answers.

Of messages that end with a library's own words only the beginning is compared.
"""

# ruff: noqa: E501

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from helpers import DEMOS, ROOT
from surroundings import RunCommand
from test_any_input import TINY

from fenics_crack import Scene

# fmt: off
LISTS = {
    "SWEPT": "geometry, material, damping, excitation, mesh, contact, crack, cracks, loads, base, " "rotation, disk, structure, harmonic_balance, reduction",
    "REMOVABLE": "contact, crack, base, rotation, disk, structure, reduction, curve, integration, sweep, " "growth, identify, tip_timing, output, cracks, loads",
}
LISTS["TABLES"] = LISTS["SWEPT"] + ", curve, integration, sweep, growth, identify, tip_timing, output"
"""Names of tables that errors list."""
PART = """
geometry = { kind = "solid", file = "part.step", faces = { clamp = [[0.0, 0.0, 0.0]] } }
crack = { point = [0.0, 0.03, 0.0], normal = [0.0, 1.0, 0.0], radii = [0.004, 0.004] }
material = { young = 2.1e11, poisson = 0.3, density = 7850.0 }
damping = { ratio = 0.002 }
excitation = { point = [0.0, 0.09, 0.0], force_sin = [0.0, 0.0, 0.1], frequency = 560.0 }
contact = { law = "unilateral" }
mesh = { layout = "graded", size = 0.006, lip_elements = 2 }
"""
TABLE = [
    # command, scene or file and arguments (key=value stands for --set key=value), message
    ("check missing.toml", "scene = 'missing.toml': must be a readable file (No such file or directory)"),
    (
        "check folder",
        "scene = 'folder': must be a readable file (it is not a regular file, but a folder, link, "
        "pipe or device)",
    ),
    ("check bad.toml", "scene = 'bad.toml': must be a TOML file ("),
    ("check long.toml", "scene = 'long.toml': must be a TOML file whose names have at most 50 parts"),
    ("check empty.toml", "geometry is missing: give a table [geometry]"),
    ("check extra.toml", "x = 1: not allowed; known tables: TABLES"),
    ("check word.toml", "mesh.colour = 1: not allowed; known keys: layout, cells, order, columns, rows, size, lip_elements, grading, file"),
    ("check flat.toml", "mesh = 1: must be a table with the keys layout, cells, order, columns, rows, size, lip_elements, grading, file"),
    ("check less.toml", "material.young is missing: give a finite number > 0 (1e-30 to 1e+30) [Pa]"),
    ("new scene.toml", "scene = 'scene.toml': must be the name of a new file; this file exists"),
    ("new scene.toml/x.toml", "scene = 'scene.toml/x.toml': must be a file that can be written ("),
    ("modes scene.toml --count 0", "--count = 0: must be a whole number >= 1"),
    ("modes scene.toml --count 1000", "--count = 1000: must be a whole number from 1 to n_dofs = 14"),
    ("modes scene.toml --count 9999999999", "--count = 9999999999: must be at most 1e+09"),
    ("solve scene.toml --output scene.toml", "--output = 'scene.toml': must be a folder that can be written ("),
    ("plot missing.h5", "path = 'missing.h5': must be an existing file"),
    ("plot text.h5", "path = 'text.h5': must be a readable result file, an .h5 file"),
    ("plot folder", "result = 'folder': must be a folder with results (.h5 files)"),
    ("solve scene.toml crack.length", "--set = 'crack.length': must be key=value, for example contact.stiffness=1e9"),
    ("check scene.toml sweep.over.x=1", "sweep.over.x = 1: must be changed as a whole: sweep.over={\"x\"=...}"),
    ("solve scene.toml crack=1", "crack = 1: must be changed key by key, as crack.edge=...; only these tables can be removed, by TABLE=none (in Python None): REMOVABLE"),
    ("solve scene.toml colour=1", "colour = 1: not allowed; known tables: TABLES"),
    ("solve scene.toml mesh.colour=1", "mesh.colour = 1: not allowed; known keys: layout, cells, order, columns, rows, size, lip_elements, grading, file"),
    ("solve scene.toml mesh=none", "mesh = 'none': must be changed key by key, as mesh.layout=...; only these tables can be removed, by TABLE=none (in Python None): REMOVABLE"),
    ("solve scene.toml geometry.thickness=0", "geometry.thickness = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml geometry.thickness=1e31", "geometry.thickness = 1e+31: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml geometry.width=1e-7", "geometry.width = 1e-07: must be a number from 1e-6 to 1e6"),
    ("solve scene.toml geometry.width=none", "geometry.width is missing: give a number from 1e-6 to 1e6 [m]"),
    ("solve scene.toml geometry.height=none", "geometry.height is missing: give a number from 1e-6 to 1e6 [m]"),
    ("solve scene.toml geometry.width=2e3", "geometry.width = 2000.0: must be within a factor 10000 of geometry.height = 0.1"),
    ("solve scene.toml crack.edge=top", "crack.edge = 'top': must be one of 'left', 'right'"),
    ("solve scene.toml crack.edge=none", "crack.edge is missing: give 'left' or 'right'; or center, for a crack inside the plate"),
    ("solve scene.toml crack.center=0.05", "crack.edge = 'left': not allowed with crack.center"),
    ("solve scene.toml crack.edge=none crack.center=0.02", "crack.center = 0.02: must be such that both tips are inside the plate: between 0 and 0.1 m, and at least 0.0001 of this length from both"),
    ("solve scene.toml mesh.columns=4 crack.edge=none crack.center=0.06", "crack.center = 0.06: must be such that both tips are on grid lines, which are 0.025 m apart"),
    ("solve scene.toml cracks.1.edge=left cracks.1.height=0.05 cracks.1.length=0.05", "cracks.1.height = 0.05: must be farther from crack.height = 0.05 m, as cracks may not touch: at least 1e-05 m above or below, or with 1e-05 m between the tips"),
    ("solve scene.toml cracks.1.edge=right cracks.1.height=0.05 cracks.1.length=0.05", "cracks.1.height = 0.05: must be farther from crack.height = 0.05 m, as cracks may not touch: at least 1e-05 m above or below, or with 1e-05 m between the tips"),
    ("solve scene.toml cracks.2.edge=right", "cracks.2.edge = 'right': must be in cracks.1, the next number, as the scene has 0 tables [[cracks]]"),
    ("solve scene.toml cracks.1.edge=top", "cracks.1.edge = 'top': must be one of 'left', 'right'"),
    ("solve scene.toml cracks.1.edge=right cracks.1.length=0.05", "cracks.1.height is missing: must be inside the plate: between 0 and "),
    ("solve scene.toml cracks.edge=right", "cracks.edge = 'right': not allowed; known keys: cracks.1.edge, cracks.1.center, cracks.1.height, "),
    ("solve scene.toml mesh.rows=4 cracks.1.edge=right cracks.1.height=0.025 cracks.1.first_omega=2000", "cracks.1.first_omega = 2000.0: not allowed with several cracks: it sets the length of a single crack"),
    ("solve scene.toml sweep.over={'cracks.1.length'=[0.05]}", "sweep.over = 'cracks.1.length': must be a key of the scene with its table, as 'crack.length', given once; the tables are SWEPT; did you mean crack.length?"),
    ("check list.toml", "cracks = 1: must be a list of tables headed [[cracks]]"),
    ("check part.toml mesh.layout=file mesh.file=a.msh mesh.size=none mesh.lip_elements=none", "mesh.layout = 'file': must be 'graded' with geometry.file"),
    ("check part.toml excitation.point=none", "excitation.point is missing: give the point of the force, [x, y, z], on the part or near it [m]"),
    ("check part.toml crack.point=none", "crack.point is missing: give a point [x, y, z] of the crack [m], with geometry.file"),
    ("check part.toml disk.sectors=8 excitation.order=1", "disk = 'a table': not allowed with geometry.file"),
    ("check part.toml geometry.file=none geometry.faces={} geometry.width=1 geometry.height=1 geometry.thickness=1 crack.point=none crack.normal=none crack.direction=none crack.radii=none crack.front=through", "crack.front = 'through': must be 'straight' or 'elliptical' without crack.point"),
    ("check lists.toml", "cracks.2.edge = 'top': must be one of 'left', 'right'"),
    ("solve scene.toml crack.height=0.1", "crack.height = 0.1: must be inside the plate: between 0 and geometry.height = 0.1 m, and at least 0.0001 of this length from both"),
    ("solve scene.toml crack.height=0.04", "crack.height = 0.04: must be a whole number of grid cells of 0.05 m, at least one cell from each end"),
    ("solve scene.toml crack.length=0.1", "crack.length = 0.1: must be shorter than the plate: between 0 and geometry.width = 0.1 m, and at least 0.0001 of this length from both"),
    ("solve scene.toml crack.length=0.03", "crack.length = 0.03: must be a whole number of grid cells of 0.05 m, at least one cell from each end"),
    ("solve scene.toml crack.length=none", "crack.length is missing: give a finite number > 0 [m]; or crack.first_omega or crack.first_frequency"),
    ("solve scene.toml crack.first_omega=2000", "crack.length = 0.05: not allowed with crack.first_omega or crack.first_frequency: give one of them"),
    ("solve scene.toml crack.first_omega=0", "crack.first_omega = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml crack.clearance=nan", "crack.clearance = nan: must be a finite number (0, or of magnitude 1e-30 to 1e+30) [m]"),
    ("solve scene.toml contact=none", "contact is missing: give a table [contact], as there is a crack"),
    ("solve scene.toml material.young=-1", "material.young = -1: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml material.poisson=0.5", "material.poisson = 0.5: must be a finite number with -1 < nu < 0.5"),
    ("solve scene.toml material.density=0", "material.density = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml damping.ratio=-1", "damping.ratio = -1: must be a number from 0 to 1 (0.02 for 2 %), or a list of them, one per mode"),
    ("solve scene.toml damping.modes=0", "damping.modes = 0: must be 'all' or a whole number >= 1"),
    ("solve scene.toml damping.modes=1000", "damping.modes = 1000: must be at most n_dofs = 14"),
    ("check scene.toml damping.modes=1000", "damping.modes = 1000: must be at most n_dofs = 14"),
    ("solve scene.toml excitation.omega=0", "excitation.omega = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml excitation.point=1", "excitation.point = 1: must be [x, y], two finite numbers (0, or of magnitude 1e-30 to 1e+30), or [x, y, z] in a solid [m]"),
    ("solve scene.toml excitation.point=none", "excitation.point is missing: give the point of the force, [x, y], or [x, y, z] in a solid [m]"),
    ("solve scene.toml excitation.point=[1,1]", "excitation.point = (1.0, 1.0): must be on the plate: x from 0 to 0.1 m, y from 0 to 0.1 m"),
    ("solve scene.toml excitation.point=[0,0]", "excitation.point = (0.0, 0.0): must be a place that is not clamped, as forces on clamped nodes move nothing"),
    ("solve scene.toml excitation.force_sin=1", "excitation.force_sin = 1: must be [fx, fy], two finite numbers (0, or of magnitude 1e-30 to 1e+30), or [fx, fy, fz] in a solid [N]"),
    ("solve scene.toml excitation.force_cos=[1]", "excitation.force_cos = [1]: must be [fx, fy], two finite numbers (0, or of magnitude 1e-30 to 1e+30), or [fx, fy, fz] in a solid [N]"),
    ("solve scene.toml excitation.force_mean=['a',1]", "excitation.force_mean = ['a', 1]: must be [fx, fy], two finite numbers (0, or of magnitude 1e-30 to 1e+30), or [fx, fy, fz] in a solid [N]"),
    ("solve scene.toml contact.stiffness=none", "contact.stiffness is missing: must be given, or contact.stiffness_per_area, but not both, with contact.law = 'penalty'"),
    ("solve scene.toml contact.stiffness=0", "contact.stiffness = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml contact.stiffness=1e30 harmonic_balance.harmonics=100", "contact.stiffness = 1e+30: must be at most "),
    ("solve scene.toml contact.stiffness_per_area=1e9", "contact.stiffness = 10000000.0: must be given, or contact.stiffness_per_area, but not both, with contact.law = 'penalty'"),
    ("solve scene.toml contact.stiffness_per_area=0", "contact.stiffness_per_area = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml contact.law=glue", "contact.law = 'glue': must be one of 'penalty', 'smoothed', 'unilateral'"),
    ("solve scene.toml contact.law=unilateral", "contact.stiffness = 10000000.0: not allowed with contact.law = 'unilateral'"),
    ("solve scene.toml contact.sharpness=1", "contact.sharpness = 1.0: not allowed with contact.law = 'penalty'"),
    ("solve scene.toml harmonic_balance.form=full", "harmonic_balance.form = 'full': must be one of 'condensed', 'block'"),
    ("solve scene.toml harmonic_balance.form=block harmonic_balance.tolerance=0.01", "harmonic_balance.tolerance = 0.01: not allowed with harmonic_balance.form = 'block'"),
    ("solve scene.toml harmonic_balance.form=block contact.friction=0.3", "harmonic_balance.form = 'block': must be 'condensed' with contact.friction"),
    ("curve scene.toml harmonic_balance.form=block", "harmonic_balance.form = 'block': must be 'condensed' for a command that uses [curve]"),
    ("solve scene.toml contact.law=smoothed", "contact.sharpness is missing: give a finite number > 0 [1/m], for the smoothed law"),
    ("solve scene.toml contact.sharpness=0", "contact.sharpness = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml contact.layer_depth=1e-6", "contact.layer_share is missing: give a number between 0 and 1, with contact.layer_depth"),
    ("solve scene.toml contact.layer_share=0.5", "contact.layer_depth is missing: give a finite number > 0 [m], with contact.layer_share"),
    ("solve scene.toml contact.layer_depth=0 contact.layer_share=0.5", "contact.layer_depth = 0: must be a finite number > 0 (1e-30 to 1e+30) [m]"),
    ("solve scene.toml contact.layer_depth=1e-6 contact.layer_share=1", "contact.layer_share = 1: must be a number between 0 and 1"),
    ("solve scene.toml contact.layer_depth=1e-6 contact.layer_share=0.5 contact.friction=0.3", "contact.tangential_stiffness_per_area is missing: give a stiffness [N/m^3], with contact.friction and contact.layer_depth"),
    ("solve scene.toml contact.law=unilateral contact.stiffness=none contact.layer_depth=1e-6", "contact.layer_depth = 1e-06: not allowed with contact.law = 'unilateral'"),
    ("solve scene.toml contact.friction_error=0", "contact.friction_error = 0: must be a finite number > 0, or false"),
    ("solve scene.toml contact.friction_error=true", "contact.friction_error = True: must be a finite number > 0, or false"),
    ("solve scene.toml contact.pairs=none", "contact.pairs is missing: must be one of 'all', 'mouth'"),
    ("solve scene.toml harmonic_balance.harmonics=0", "harmonic_balance.harmonics = 0: must be a whole number >= 1"),
    ("solve scene.toml harmonic_balance.harmonics=100000000000", "harmonic_balance.harmonics = 100000000000: must be a whole number below 2^31 = 2147483648"),
    ("grow scene.toml growth.until=0.07 growth.rate=1e-11 growth.exponent=1000", "growth.exponent = 1000: must be a number from 0.1 to 50"),
    ("grow scene.toml growth.until=0.07 growth.rate=1e-11 growth.exponent=3 growth.exponent_deviation=1e30", "growth.exponent_deviation = 1e+30: must be a number from 0 to 10"),
    ("solve scene.toml harmonic_balance.harmonics=100000", "harmonic_balance.harmonics = 100000: must be at most "),
    ("solve scene.toml harmonic_balance.samples=5", "harmonic_balance.samples = 5: must be a whole number from 13 (4 times harmonics + 1) to 1048576, or left out"),
    ("solve scene.toml harmonic_balance.samples=0", "harmonic_balance.samples = 0: must be a whole number >= 1"),
    ("solve scene.toml mesh.layout=a", "mesh.layout = 'a': must be one of 'grid', 'graded', 'file'"),
    ("solve scene.toml mesh.cells=a", "mesh.cells = 'a': must be one of 'triangle', 'quadrilateral'"),
    ("solve scene.toml mesh.order=3", "mesh.order = 3: must be 1 or 2"),
    ("solve scene.toml mesh.columns=0", "mesh.columns = 0: must be a whole number >= 1"),
    ("solve scene.toml mesh.columns=none", "mesh.columns is missing: give a whole number >= 1, with layout = 'grid'"),
    ("solve scene.toml mesh.rows=3000000", "mesh.columns = 2: must be such that the mesh has fewer cells: 6e+06 cells are more than 5e+06"),
    ("solve scene.toml mesh.size=0.1", "mesh.size = 0.1: not allowed with mesh.layout = 'grid'"),
    ("solve scene.toml mesh.lip_elements=2", "mesh.lip_elements = 2: not allowed with mesh.layout = 'grid'"),
    ("solve scene.toml mesh.grading=0", "mesh.grading = 0: must be a number from 1 to 1e+06"),
    ("solve scene.toml mesh.grading=3", "mesh.grading = 3.0: not allowed with mesh.layout = 'grid'"),
    ("solve scene.toml mesh.file=a", "mesh.file = 'a': not allowed with mesh.layout = 'grid'"),
    ("solve scene.toml mesh.file=1", "mesh.file = 1: must be the path of a .msh file"),
    ("solve scene.toml mesh.layout=file", "mesh.columns = 2: not allowed with mesh.layout = 'file'"),
    ("solve scene.toml reduction.method=a", "reduction.method = 'a': must be one of 'massless', 'free_interface', 'off'"),
    ("solve scene.toml reduction.modes=0", "reduction.modes = 0: must be a whole number >= 1"),
    ("solve scene.toml reduction.modes=1000", "reduction.modes = 1000: must be a whole number from 1 to n_dofs = 14"),
    ("solve scene.toml curve.parameter=a", "curve.parameter = 'a': must be one of 'omega', 'frequency', 'load', 'stiffness', 'damping', 'clearance'"),
    ("solve scene.toml curve.start=none", "curve.start is missing: must be a finite number (0, or of magnitude 1e-30 to 1e+30)"),
    ("solve scene.toml curve.start=a", "curve.start = 'a': must be a finite number (0, or of magnitude 1e-30 to 1e+30)"),
    ("solve scene.toml curve.start=-1", "curve.start = -1.0: must be a number > 0 with curve.parameter = 'omega'"),
    ("solve scene.toml curve.stop=2000", "curve.stop = 2000.0: must be different from curve.start = 2000"),
    ("solve scene.toml curve.stability=1", "curve.stability = 1: must be true or false"),
    ("solve scene.toml integration.method=a", "integration.method = 'a': must be one of 'exponential', 'central_difference', 'events'"),
    ("solve scene.toml integration.periods=0", "integration.periods = 0: must be a whole number >= 1"),
    ("solve scene.toml integration.settle=0", "integration.settle = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml integration.steps_per_period=0", "integration.steps_per_period = 0: must be a whole number >= 1"),
    ("solve scene.toml sweep.over=1", "sweep.over = 1: must be a table with keys of the scene and lists of values, 'crack.length' = [0.02, 0.03]"),
    ("solve scene.toml sweep.over={}", "sweep.over = {}: must be a table with keys of the scene and lists of values, 'crack.length' = [0.02, 0.03]"),
    ("solve scene.toml sweep.over={a=[1]}", "sweep.over = 'a': must be a key of the scene with its table, as 'crack.length', given once; the tables are SWEPT"),
    ("solve scene.toml sweep.over={'crack.length'=[]}", "sweep.over.\"crack.length\" = []: must be a list of values, or a table with start, stop, count (2 to 1e6) and, optionally, spacing = 'linear' or 'logarithmic'"),
    ("solve scene.toml sweep.over={'crack.length'=1}", "sweep.over.\"crack.length\" = 1: must be a list of values, or a table with start, stop, count (2 to 1e6) and, optionally, spacing = 'linear' or 'logarithmic'"),
    ("solve scene.toml sweep.over={'crack.length'={start=0.01,stop=0.02,count=1}}", "sweep.over.\"crack.length\" = {'start': 0.01, 'stop': 0.02, 'count': 1}: must be a list of values, or a table with start, stop, count (2 to 1e6) and, optionally, spacing = 'linear' or 'logarithmic'"),
    ("solve scene.toml sweep.over={'crack.clearance'={start=-1,stop=1,count=3,spacing='logarithmic'}}", "sweep.over.\"crack.clearance\" = {'start': -1, 'stop': 1, 'count': 3, 'spacing': 'logarithmic'}: must be a range with start and stop both > 0 or both < 0, for that spacing"),
    ("solve scene.toml sweep.over={'crack.length'=[-1]}", "crack.length = -1: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("solve scene.toml sweep.over={'crack.length'=[0.1,0.1]}", 'sweep.over."crack.length" = (0.1, 0.1): must be one or more different values'),
    ("solve scene.toml sweep.at_resonance=true", "sweep.over is missing: give a table with keys of the scene and lists of values, 'crack.length' = [0.02, 0.03]"),
    ("solve scene.toml excitation.point=none base.acceleration_sin=[1,0]", "excitation.force_sin = (1.0, 0.0): not allowed without excitation.point"),
    ("solve scene.toml base.acceleration_sin=[0,0]", "base.acceleration_sin = (0.0, 0.0): must be given and not zero, or base.acceleration_cos or base.harmonics given"),
    ("solve scene.toml structure.mass=a structure.stiffness=b", "structure.force_sin is missing: must be given, or structure.force_cos, structure.force_mean or structure.model"),
    ("solve scene.toml structure.mass=a structure.stiffness=b structure.force_sin=c", "geometry = 'a table': not allowed with [structure]"),
    ("solve matrices.toml structure.damping=c", "damping = 'a table': not allowed with structure.damping"),
    ("solve matrices.toml excitation.force_sin=[1,0]", "excitation.force_sin = (1.0, 0.0): not allowed with [structure] without structure.model: give the load by structure.force_sin, structure.force_cos or structure.force_mean"),
    ("solve matrices.toml structure.gap=b contact=none", "contact is missing: give a table [contact], as structure.gap is given"),
    ("solve matrices.toml structure.dofs=rows.dof", "structure.dofs = 'rows.dof': not allowed without structure.model or CalculiX files (.sti, .mas)"),
    ("solve matrices.toml structure.clearance=1e-6", "structure.clearance = 1e-06: not allowed without contact pairs: give structure.gap, or structure.model and [contact]"),
    ("solve matrices.toml structure.areas=a.mtx", "structure.areas = 'a.mtx': not allowed without contact pairs: give structure.gap, or structure.model and [contact]"),
    ("solve matrices.toml structure.tangential=t.mtx", "structure.tangential = 't.mtx': not allowed without contact pairs: give structure.gap, or structure.model and [contact]"),
    ("solve matrices.toml structure.clearance=g.mtx structure.model=m.inp contact=none", "structure.clearance = 'g.mtx': not allowed without contact pairs: give structure.gap, or structure.model and [contact]"),
    ("solve matrices.toml", "contact = 'a table': not allowed without contact pairs: give structure.gap or structure.model"),
    ("solve matrices.toml contact.pairs=mouth", "contact.pairs = 'mouth': must be 'all' with [structure]"),
    ("solve matrices.toml contact.stiffness=none contact.stiffness_per_area=1", "contact.stiffness_per_area = 1.0: not allowed without structure.areas: give contact.stiffness"),
    ("solve scene.toml loads.1.edge=top", "loads.1.traction_sin is missing: must be given, or one of pressure_mean, pressure_cos, pressure_sin, traction_mean, traction_cos"),
    ("solve scene.toml loads.1.edge=top loads.1.pressure_mean=1 loads.1.phase=90", "loads.1.phase = 90.0: not allowed with a mean load alone"),
    ("solve scene.toml loads.1.edge=tob loads.1.pressure_sin=1", "loads.1.edge = 'tob': must be one of 'bottom', 'left', 'lower_lip', 'right', 'top', 'upper_lip'"),
    ("solve scene.toml loads.1.edge=bottom loads.1.pressure_sin=1", "loads.1.edge = 'bottom': must be a place that is not clamped, as forces on clamped nodes move nothing"),
    ("solve scene.toml loads.1.point=[1,1] loads.1.force_sin=[1,0]", "loads.1.point = (1.0, 1.0): must be on the plate: x from 0 to 0.1 m, y from 0 to 0.1 m"),
    ("solve scene.toml loads.2.point=[1,1] loads.2.force_sin=[1,0]", "loads.2.point = [1, 1]: must be in loads.1, the next number, as the scene has 0 tables [[loads]]"),
    ("solve scene.toml excitation.frequency=0", "excitation.frequency = 0: must be a finite number > 0 (up to 1e29)"),
    ("solve scene.toml excitation.omega=none", "excitation.omega is missing: give a finite number > 0 [rad/s], or excitation.frequency [Hz]"),
    ("solve scene.toml excitation.omega=1 excitation.frequency=1", "excitation.frequency = 1: not allowed with excitation.omega = 1: give one of the two"),
    ("solve scene.toml sweep.over={'excitation.omega'=[1],'excitation.frequency'=[1]}", "sweep.over = 'excitation.frequency': not allowed with excitation.omega: give one of the two"),
    ("solve scene.toml crack.lenght=1", "crack.lenght = 1: not allowed; did you mean crack.length? known keys: edge, center, height, length, "),
    ("solve scene.toml sweep.over={'crack.lenght'=[1]}", "sweep.over = 'crack.lenght': must be a key of the scene with its table, as 'crack.length', given once; the tables are SWEPT; did you mean crack.length?"),
    ("solve scene.toml mesh.layout=gird", "mesh.layout = 'gird': must be one of 'grid', 'graded', 'file'; did you mean 'grid'?"),
    ("solve scene.toml damping.ratio=[0.1,0.2] damping.modes=3", "damping.ratio = (0.1, 0.2): must be a list with damping.modes = 3 ratios"),
    ("solve scene.toml damping.ratio=[0.1,0.2]", "damping.ratio = '2 ratios': must be one ratio, or 14 with one per mode"),
    ("solve scene.toml damping.mass=1", "damping.mass = 1.0: not allowed with damping.ratio = 0.02"),
    ("solve scene.toml damping.ratio=none", "damping.ratio is missing: must be given; or damping.mass or damping.stiffness; or damping.ratios with damping.omegas or damping.frequencies"),
    ("solve scene.toml damping.ratio=none damping.mass=-1", "damping.mass = -1: must be a finite number >= 0 (0, or of magnitude 1e-30 to 1e+30) [1/s]"),
    ("solve scene.toml damping.ratio=none damping.mass=1 damping.modes=5", "damping.modes = 5: not allowed with damping.mass, which damps all modes"),
    ("solve scene.toml damping.ratio=none damping.mass=1 damping.ratios=[0.1,0.1]", "damping.ratios = (0.1, 0.1): not allowed with damping.mass = 1.0"),
    ("solve scene.toml damping.ratio=none damping.ratios=[0.1,0.1]", "damping.omegas is missing: give [omega_1, omega_2] [rad/s], or damping.frequencies, for damping.ratios = (0.1, 0.1)"),
    ("solve scene.toml damping.ratio=none damping.ratios=0.1", "damping.ratios = 0.1: must be [xi_1, xi_2], two numbers from 0 to 1"),
    ("solve scene.toml damping.ratio=none damping.omegas=[1,2]", "damping.ratios is missing: give [xi_1, xi_2] at damping.omegas = (1.0, 2.0)"),
    ("solve scene.toml damping.ratio=none damping.ratios=[0.1,0.1] damping.omegas=[1,1]", "damping.omegas = [1, 1]: must be [omega_1, omega_2], two different numbers > 0"),
    ("solve scene.toml damping.ratio=none damping.ratios=[0.01,0.1] damping.omegas=[1,2]", "damping.ratios = (0.01, 0.1): must be ratios with which both Rayleigh coefficients are >= 0: for 0.01 at 1 rad/s, a ratio from 0.005 to 0.02 at 2 rad/s"),
    ("solve scene.toml contact.law=unilateral contact.stiffness=none contact.sharpness=1", "contact.sharpness = 1.0: not allowed with contact.law = 'unilateral'"),
    ("solve scene.toml contact.law=unilateral contact.stiffness=none harmonic_balance.samples=64", "harmonic_balance.samples = 64: not allowed with UnilateralConstraint"),
    ("solve scene.toml contact.stiffness=none contact.law=unilateral contact.stiffness_per_area=1", "contact.stiffness_per_area = 1.0: not allowed with contact.law = 'unilateral'"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=graded mesh.size=0.05 mesh.lip_elements=2 mesh.size=none", "mesh.size is missing: give a finite number > 0 (1e-30 to 1e+30) [m], with layout = 'graded'"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=graded mesh.size=0.05 mesh.lip_elements=2 mesh.lip_elements=none", "mesh.lip_elements is missing: give a whole number >= 1, the elements along each crack face"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=graded mesh.size=0.05 mesh.lip_elements=2 mesh.size=1e-5", "mesh.size = 1e-05: must be such that the mesh has fewer cells: 5e+07 cells are more than 5e+06"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=graded mesh.size=0.05 mesh.lip_elements=2 mesh.grading=1e6 crack.length=1e-4", "mesh.grading = 1000000.0: must be smaller: the element at the tip of this crack would be only "),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=graded mesh.size=0.05 mesh.lip_elements=2 crack.length=none crack.first_omega=1", "crack.first_omega = 1.0: must be between "),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=file mesh.file=missing.msh geometry.width=none geometry.height=none crack.edge=none crack.height=none crack.length=none", "mesh.file = 'missing.msh': must be an existing gmsh mesh file"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=file mesh.file=text.h5 geometry.width=none geometry.height=none crack.edge=none crack.height=none crack.length=none", "mesh.file = 'text.h5': must be a mesh file that gmsh can read ("),
    ("solve scene.toml crack.length=none crack.first_omega=2000", "crack.length is missing: give a finite number > 0 [m]; a grid cannot have crack.first_omega"),
    ("solve scene.toml geometry.thickness=none", "geometry.thickness is missing: give a finite number > 0 (1e-30 to 1e+30) [m]"),
    ("solve scene.toml mesh.columns=none mesh.rows=none mesh.layout=file mesh.file=missing.msh geometry.width=none geometry.height=none", "crack.edge = 'left': not allowed with mesh.layout = 'file'"),
    ("curve scene.toml curve=none", "curve is missing: give a table [curve] with start, stop, which this command needs"),
    ("curve scene.toml crack=none", "crack is missing: give a table [crack], which this command needs"),
    ("curve scene.toml contact.law=unilateral contact.stiffness=none", "contact.law = 'unilateral': must be 'penalty' or 'smoothed' for a curve; or set reduction.method = 'massless'"),
    ("curve scene.toml curve.parameter=load curve.start=-1 curve.stop=1", "curve.start, curve.stop = (-1.0, 1.0): must be both > 0 or both < 0, as without clearance the motion vanishes at 0"),
    ("curve scene.toml curve.parameter=damping curve.start=-1", "curve.start = -1.0: must be a finite number >= 0"),
    ("curve scene.toml curve.parameter=stiffness curve.start=0", "curve.start = 0.0: must be a number > 0 with curve.parameter = 'stiffness'"),
    ("integrate scene.toml crack=none", "crack is missing: give a table [crack], which this command needs"),
    ("integrate scene.toml integration.method=events contact.law=unilateral contact.stiffness=none", "integration.method = 'events': must be 'central_difference' with contact.law = 'unilateral'; or set reduction.method = 'massless'"),
    ("integrate scene.toml integration.method=events contact.law=smoothed contact.sharpness=1e6", "contact.law = 'smoothed': must be 'penalty' or 'unilateral' with integration.method = 'events'"),
    ("integrate scene.toml integration.method=central_difference reduction.modes=3", "integration.method = 'central_difference': must be 'events' or 'exponential' for crack faces without mass; or set reduction.method = 'free_interface'"),
    ("integrate scene.toml integration.method=central_difference reduction.modes=3", "integration.method = 'central_difference': must be 'events' or 'exponential' for crack faces without mass; or set reduction.method = 'free_interface'"),
    ("integrate scene.toml reduction.modes=3 contact.law=smoothed contact.sharpness=1e6", "contact.law = 'smoothed': must be 'penalty' or 'unilateral' with integration.method = 'exponential'"),
    ("integrate scene.toml integration.method=exponential contact.law=unilateral contact.stiffness=none", "integration.method = 'exponential': must be 'central_difference' with contact.law = 'unilateral'; or set reduction.method = 'massless'"),
    ("integrate scene.toml integration.method=exponential reduction.method=off mesh.columns=20 mesh.rows=20", "integration.method = 'exponential': must be 'central_difference' with 860 dofs; or set reduction.method = 'massless'"),
    ("timing scene.toml", "tip_timing is missing: give a table [tip_timing] with probes, tip_radius, which this command needs"),
    ("timing scene.toml tip_timing.probes=[1]", "tip_timing.tip_radius is missing: give a finite number > 0 (1e-30 to 1e+30) [m]"),
    ("timing scene.toml tip_timing.tip_radius=1", "tip_timing.probes is missing: give a list of rising angles in degrees, from 0 to less than 360"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[2,1]", "tip_timing.probes = [2, 1]: must be a list of rising angles in degrees, from 0 to less than 360"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[0,360]", "tip_timing.probes = [0, 360]: must be a list of rising angles in degrees, from 0 to less than 360"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[]", "tip_timing.probes = []: must be a list of rising angles in degrees, from 0 to less than 360"),
    ("check scene.toml disk.sectors=6", "excitation.order is missing: give the engine order of the load on [disk], a whole number >= 1"),
    ("check scene.toml disk.sectors=6 excitation.order=2", "excitation.omega is missing: give a finite number > 0 [rad/s], or excitation.frequency [Hz], as [disk] is at rest"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2", "disk.inner_radius is missing: give a finite number > 0 (1e-30 to 1e+30) [m]"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.2", "disk.outer_radius is missing: give a finite number > 0 (1e-30 to 1e+30) [m]"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.2 disk.outer_radius=0.4 reduction.modes=3", "reduction = 'a table': not allowed with [disk]"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.2 disk.outer_radius=0.4 disk.center=[0,0]", "disk.center = (0.0, 0.0): not allowed without mesh.layout = 'file'"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.5 disk.outer_radius=0.4", "disk.inner_radius = 0.5: must be less than disk.outer_radius = 0.4"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.398 disk.outer_radius=0.4", "disk.inner_radius = 0.398: must be less than 0.396863 m, where the blade meets the rim"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.05 disk.outer_radius=0.09", "disk.outer_radius = 0.09: must be larger, as blades 0.1 m wide would overlap: their roots are 0.09 m apart"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.2 disk.outer_radius=0.4 disk.deviation=0.5", "disk.deviation = 0.5: must be a number from 0 to 0.1"),
    ("check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2 disk.inner_radius=0.2 disk.outer_radius=0.4 disk.seed=-1", "disk.seed = -1: must be a whole number >= 0"),
    ("timing scene.toml tip_timing.tip_radius=0 tip_timing.probes=[1]", "tip_timing.tip_radius = 0: must be a finite number > 0 (1e-30 to 1e+30)"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1]", "tip_timing.order is missing: must be given without excitation.order: the periods of the load"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=0", "tip_timing.order = 0: must be a whole number >= 1"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2 rotation.rpm=100 rotation.hub_radius=0", "tip_timing.order = 2: not allowed with the rotor speed of [rotation]"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2 rotation.rpm=100 rotation.hub_radius=0 excitation.order=2", "tip_timing.order = 2: not allowed with excitation.order"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.tangential=0", "tip_timing.tangential = 0: must be a finite number other than 0 "),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.noise=-1", "tip_timing.noise = -1: must be a finite number >= 0 "),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.clock=nan", "tip_timing.clock = nan: must be a finite number >= 0 "),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.seed=-1", "tip_timing.seed = -1: must be a whole number >= 0"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.orders=[1.5]", "tip_timing.orders = [1.5]: must be a list of different whole numbers >= 1"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.orders=[2,2]", "tip_timing.orders = [2, 2]: must be a list of different whole numbers >= 1"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.frequencies=[2,1]", "tip_timing.frequencies = [2, 1]: must be two finite numbers > 0, the second one larger"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.frequencies=[1,2] tip_timing.subharmonic=2", "tip_timing.subharmonic = 2: must be 1 with tip_timing.frequencies"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.frequencies=[1,2] tip_timing.orders=[2]", "tip_timing.orders = (2.0,): not allowed with tip_timing.frequencies"),
    ("timing scene.toml --quiet tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2", "tip_timing.probes = '1 probe at "),
    ("timing scene.toml tip_timing.tip_radius=1e-9 tip_timing.probes=[1] tip_timing.order=2", "tip_timing.tip_radius = 1e-09: must be so large that the tip always moves forwards"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2 tip_timing.revolutions=100000000", "tip_timing.revolutions = 100000000: must be at most 10000000, since 1e+07 passages"),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2 tip_timing.clock=1", "tip_timing.clock = 1.0: must be less than the duration of a revolution, "),
    ("timing scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1] tip_timing.order=2 tip_timing.noise=20", "tip_timing.noise = 20.0: must be less than the duration of a revolution, "),
    ("timing scene.toml missing.csv tip_timing.tip_radius=1 tip_timing.probes=[1]", "path = 'missing.csv': must be a readable file (No such file or directory)"),
    ("timing scene.toml missing.h5 tip_timing.tip_radius=1 tip_timing.probes=[1]", "path = 'missing.h5': must be an existing file"),
    ("timing scene.toml scene.toml tip_timing.tip_radius=1 tip_timing.probes=[1]", "path = 'scene.toml': must be a file with the column 'revolution'"),
    ("identify scene.toml empty.csv --modes 1 2", "--modes = [1, 2]: not allowed without a file of frequency responses (.uff, .unv)"),
    ("curve scene.toml curve.stop=1e-20", "curve.stop = 1e-20: must be a number > 0 with curve.parameter = 'omega', and above 1e-12 of the other end"),
    ("integrate scene.toml integration.steps_per_period=1", "integration.steps_per_period = 1: must be >= "),
    ("integrate scene.toml integration.steps_per_period=2000000000", "integration.steps_per_period = 2000000000: must be at most 1e+09"),
    ("solve scene.toml excitation.harmonics=[{order=100000,cos=[1.0,0.0]}]", "excitation.harmonics = [{'order': 100000, 'cos': [1.0, 0.0]}]: must be a list of tables: each has a different order from 1 to 100, and cos or sin or both, or amplitude and, optionally, phase (the lag in degrees)"),
    ("solve scene.toml excitation.wave=wave.csv excitation.wave_harmonics=1000000", "excitation.wave_harmonics = 1000000: must be a whole number from 1 to 100"),
    ("disk scene.toml", "disk is missing: give a table [disk] with sectors, which this command needs"),
    ("disk wheel.toml --patterns 1000000000", "--patterns = 1000000000: must be at most 1e+06"),
    ("check wheel.toml disk.outer_radius=1e9", "mesh.size = 0.01: must be such that the mesh has fewer cells: 1.3e+21 cells are more than 5e+06"),
    ("disk wheel.toml --patterns -1", "--patterns = -1: must be a whole number >= 0"),
    ("disk wheel.toml --deviation .5", "--deviation = 0.5: must be a number from 0 to 0.1"),
    ("disk wheel.toml --patterns 1 --deviation nan", "--deviation = nan: must be a number from 0 to 0.1"),
    ("campbell scene.toml", "rotation is missing: give a table [rotation], which this command needs"),
    ("campbell scene.toml --speeds 0 1 1e9 rotation.rpm=10 rotation.hub_radius=1", "--speeds = [0.0, 1.0, 1000000000.0]: must be START STOP COUNT with 0 <= START < STOP, and COUNT a whole number from 2 to 1000000"),
]
FURTHER = {
    "check empty.toml": "material damping excitation mesh",
    "check extra.toml": "geometry material damping excitation mesh",
    "check scene.toml disk.sectors=6": "excitation.omega disk.inner_radius disk.outer_radius",
    "check scene.toml disk.sectors=6 excitation.order=2": "disk.inner_radius disk.outer_radius",
    "check scene.toml disk.sectors=6 excitation.omega=2000.0 excitation.order=2": "disk.outer_radius",
}
"""Further keys that are refused at once, each by a line of its own."""
# fmt: on


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a scene that can be used and files that cannot."""
    monkeypatch.chdir(tmp_path)
    more = {"curve.start": 2000.0, "curve.stop": 2100.0, "integration.periods": 2}
    text = Scene.from_mapping(TINY).replace(more).as_toml()
    contents = {
        "scene.toml": text,
        "bad.toml": "[geometry",
        "matrices.toml": (
            "structure = {mass = 'a', stiffness = 'b', force_sin = 'c'}\n"
            "excitation.omega = 1\ncontact.stiffness = 1\ndamping.ratio = 0.1\n"
        ),
        "empty.toml": "",
        "extra.toml": "x = 1",
        "long.toml": f"[{'.'.join(51 * 'a')}]",
        "word.toml": text.replace("[mesh]", "[mesh]\ncolour = 1"),
        "flat.toml": "mesh = 1\n" + text.split("[mesh]")[0],
        "list.toml": "cracks = 1\n" + text,
        "lists.toml": text + "\n[[cracks]]\nedge = 'left'\n[[cracks]]\nedge = 'top'\n",
        "part.toml": PART,
        "less.toml": text.replace("young", "#"),
        "text.h5": "no",
        "wheel.toml": (DEMOS / "bladed_disk.toml").read_text(),
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content)
    (tmp_path / "folder").mkdir()
    return tmp_path


@pytest.mark.parametrize(("line", "message"), TABLE, ids=[line[:60] for line, _ in TABLE])
def test_bad_input_is_one_line(
    line: str, message: str, folder: Path, run_command: RunCommand
) -> None:
    """Exit code 2, and what was found and what may stand there on standard error."""
    for name, list_items in LISTS.items():
        message = message.replace(name, list_items)
    arguments: list[str] = []
    for word in line.split():
        arguments += ["--set", word] if "=" in word or word in SETTINGS else [word]
    process = run_command(*arguments, code=2)
    written_files = list(Path("output").glob("*/*"))
    assert not process.out and (
        not written_files or line.startswith("timing")
    )  # which writes arrivals
    error_text, _, _ = (errors := process.err).partition("for example:")
    error, *further = [row for row in error_text.splitlines() if not row.startswith("remark: ")]
    assert error.startswith(f"fenics-crack: {message}")
    assert all(further_message.startswith("fenics-crack: ") for further_message in further)
    assert [further_message.split()[1] for further_message in further] == FURTHER.get(
        line, ""
    ).split()
    error_rows = [row for row in errors.splitlines() if not row.startswith("remark: ")][
        1 + len(further) :
    ]
    lines = [
        further_message
        for further_message in (error, *further)
        if " is missing: " in further_message
    ]
    tables = [further_message.split()[1] for further_message in lines]
    lacks = [
        further_message
        for further_message in tables
        if any(f"{name}.".startswith(f"{further_message}.") for name in TABLES)
    ]
    assert error_rows[:2] == (["for example:", ""] if lacks else [])
    if lacks:  # lines that a new scene has, some of them commented out
        assert error_rows[2].startswith((f"[{lacks[0]}]", f"[{lacks[0]}.")) and len(error_rows) > 3
        for words in (line.split("#")[0].strip() for line in error_rows[2:]):
            assert words in TEMPLATE or lacks == ["curve"]  # that of this scene


TEMPLATES = ("new_scene.toml", "new_solid.toml", "new_disk.toml")
TEMPLATE = "\n".join((ROOT / "fenics_crack" / "cli" / name).read_text() for name in TEMPLATES)
TABLES = re.findall(r"^(?:# )?\[([\w.]+)", TEMPLATE, re.MULTILINE)
"""Tables of which a new scene has an example."""
SETTINGS = ("crack.length",)
"""Words of the table that are settings without a value."""


@pytest.mark.parametrize("name", ["scene.py", "fields.py"])
def test_every_message_of_the_scene_is_in_the_table(name: str) -> None:
    """A check that is added to the scene needs a line above."""
    table_text = "\n".join(message for _, message in TABLE)
    tree = ast.parse((ROOT / "fenics_crack" / "scene" / name).read_text(encoding="utf-8"))
    missing_messages = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args:
            function_name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if function_name in ("InputError", "require", "given", "holds"):
                words = [
                    part.value
                    for part in ast.walk(node.args[0 if function_name == "holds" else -1])
                    if isinstance(part, ast.Constant) and isinstance(part.value, str)
                ]
                longest = max(words, key=len, default="")
                longest = (
                    longest.strip("' ").removeprefix("left out").removeprefix("given:").strip()
                )
                if longest not in table_text and longest not in ("allowed", "a"):
                    missing_messages.append(longest)
    assert not missing_messages
