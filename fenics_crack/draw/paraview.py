"""Files for ParaView (VTK XML): mode shapes, and one period of the breathing crack.

Rank 0 writes all nodes, also those of quadratic elements.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from base64 import b64encode
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.draw.period import PeriodFields, magnifying, von_mises
from fenics_crack.fem.nodal_mesh import NodalMesh
from fenics_crack.model.modes import Modes
from fenics_crack.parallel import on_root
from fenics_crack.scene.tables import Material
from fenics_crack.stages import begin
from fenics_crack.whole import write_together, write_whole

__all__ = ["write_modes", "write_period"]


def write_modes(modes: Modes, path: str | Path) -> None:
    """Write mode shapes as vector fields of one .vtu file (collective).

    The fields are called ``mode 1: 2302.9 rad/s`` and so on. Their largest displacement is a tenth
    of the structure's size, ready for ParaView's Warp By Vector; the field data ``magnification of
    mode 1`` is that displacement over the shape's own.

    Parameters
    ----------
    modes : Modes
        Of a structure with a mesh.
    path : str or Path
        The .vtu file.

    Raises
    ------
    InputError
        The structure has no mesh.

    Examples
    --------
    >>> fc.write_modes(fc.solve_modes(structure, 2), "modes.vtu")
    """
    mesh = NodalMesh(modes.structure)
    shapes = mesh.field(modes.structure.expand(modes.shapes.T))

    def write() -> None:
        fields, facts = {}, {}
        for number, (omega, shape) in enumerate(zip(modes.omega, shapes, strict=True), 1):
            factor = magnifying(shape, mesh.size)
            fields[f"mode {number}: {omega:.1f} rad/s"] = factor * shape
            facts[f"magnification of mode {number}"] = factor
        write_whole(path, _vtu(mesh, mesh.points, fields, facts))

    on_root(mesh.structure.comm, write)


def write_period(
    solution: PeriodicSolution,
    path: str | Path,
    *,
    frames: int = 60,
    magnification: float | None = None,
    material: Material | None = None,
) -> float:
    """Write one period of a vibration as a time series for ParaView (collective).

    A script beside it, ``paraview --script=NAME_paraview.py``, shows the plate from the front,
    coloured by stress or displacement, says the magnification and plays the period once. Each frame
    has the ``magnification`` in its field data.

    Parameters
    ----------
    solution : PeriodicSolution
        What to show.
    path : str or Path
        The .pvd file to open in ParaView; the frames (.vtu) go into a folder beside it.
    frames : int
        Instants in the period.
    magnification : float, optional
        Factor of the displacement that moves the nodes; default: the largest displacement becomes a
        tenth of the structure's size.
    material : Material, optional
        Of the scene, for stresses.

    Returns
    -------
    float
        The magnification.

    Raises
    ------
    InputError
        The structure has no mesh, or an argument cannot be used.

    Notes
    -----
    Point fields: ``displacement`` [m], true to scale; ``contact state``: 1 on a closed pair of lip
    nodes, 0 on an open one, -1 away from the lips; ``contact force`` [N] on each node of a pair,
    and ``contact pressure`` [Pa], that force over the pair's area: smooth along the lips if the
    contact stiffness is given per area. With a material: ``stress`` (xx, yy, xy) and ``von Mises
    stress`` [Pa] of plane stress. At the tip and under the point load they grow without bound as
    the mesh is refined.

    Examples
    --------
    >>> magnification = fc.write_period(solution, "crack.pvd", frames=4)
    """
    begin(Path(path).name)
    fields = PeriodFields.of(solution, frames, magnification, material)
    target = Path(path)

    def write() -> None:
        names = [f"{target.stem}/frame_{frame:04d}.vtu" for frame in range(len(fields.time))]
        entries = [
            f'    <DataSet timestep="{instant:.12g}" file={quoteattr(name)}/>'
            for instant, name in zip(fields.time, names, strict=True)
        ]
        lines = ['<VTKFile type="Collection" version="0.1">', "  <Collection>", *entries]
        series = "\n".join([*lines, "  </Collection>", "</VTKFile>", ""])
        field, unit = fields.colour
        script = target.with_name(f"{target.stem}_paraview.py")
        words = {"script": script.name, "folder": str(target.parent.resolve()), "pvd": target.name}
        colours = {"field": field, "title": f"{field} [{unit}]", "end": fields.colour_end}
        colours["caption"] = f"displacement x {fields.magnification:.3g}"
        about = [(target, series), (script, STATE.format(**words, **colours))]
        frames = ((target.parent / name, _frame(fields, n)) for n, name in enumerate(names))
        write_together(itertools.chain(about, frames))

    on_root(fields.mesh.structure.comm, write)
    return fields.magnification


STATE = """\
# Shows one period of the vibration in ParaView:
#     paraview --script={script}        or File > Load State
import os

from paraview.simple import *

# Beside this file; where ParaView does not tell where that is, where it was written.
folder = os.path.dirname(os.path.abspath(__file__)) if "__file__" in globals() else {folder!r}
field = {field!r}

paraview.simple._DisableFirstRenderCameraReset()
series = PVDReader(registrationName={pvd!r}, FileName=os.path.join(folder, {pvd!r}))
view = GetActiveViewOrCreate("RenderView")
view.InteractionMode = "2D"
scene = GetAnimationScene()
scene.UpdateAnimationUsingDataTimeSteps()
scene.PlayMode = "Snap To TimeSteps"
scene.GoToFirst()

display = Show(series, view)
display.NonlinearSubdivisionLevel = 2
ColorBy(display, ("POINTS", field))
colours = GetColorTransferFunction(field)
colours.ApplyPreset("Viridis (matplotlib)", True)
colours.RescaleTransferFunction(0.0, {end!r})
display.SetScalarBarVisibility(view, True)
bar = GetScalarBar(colours, view)
bar.Title = {title!r}
bar.ComponentTitle = ""

caption = Text(registrationName="magnification", Text={caption!r})
shown = Show(caption, view)
shown.WindowLocation = "Lower Center"

view.ResetActiveCameraToNegativeZ()
view.ResetCamera(False)
Render(view)
scene.Play()
scene.Loop = 1  # from now on; the play button starts it again
"""


def _frame(fields: PeriodFields, frame: int) -> str:
    """The magnified mesh of a frame with the point fields of :func:`write_period`."""
    nodes, force = fields.pair_nodes, fields.force[frame]
    closed = np.minimum(nodes @ (force > 0.0), 1.0)
    shown = {
        "displacement": fields.displacement[frame],
        "contact state": np.where(nodes.any(axis=1), closed, -1.0),
        "contact force": nodes @ force,
        "contact pressure": nodes @ (force / fields.areas),
    }
    if fields.material is not None:
        stress = fields.stress[frame]
        shown |= {"stress": stress, "von Mises stress": von_mises(stress)}
    facts = {"magnification": fields.magnification}
    return _vtu(fields.mesh, fields.places[frame], shown, facts)


COMPONENTS = {"stress": ("xx", "yy", "xy")}
"""Names of the components of fields that are no vectors."""


def _vtu(
    mesh: NodalMesh,
    places: np.ndarray,
    fields: Mapping[str, np.ndarray],
    facts: Mapping[str, float],
) -> str:
    """The text of a .vtu file: the mesh with its nodes at some places (n_nodes, 2), fields of its
    nodes, vectors (n_nodes, 2) filled up with zeros, and single numbers."""
    count, size = mesh.cells.shape
    kinds = np.full(count, mesh.vtk_type, dtype=np.uint8)
    single = (_array(name, np.array([fact]), NumberOfTuples=1) for name, fact in facts.items())
    points = "".join(_array(name, field) for name, field in fields.items())
    cells = (("connectivity", mesh.cells), ("offsets", size * np.arange(1, count + 1)))
    rows = "".join(_array(name, part.ravel().astype("<i8")) for name, part in cells)
    return (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
        f"<FieldData>\n{''.join(single)}</FieldData>\n"
        f'<Piece NumberOfPoints="{len(places)}" NumberOfCells="{count}">\n'
        f"<PointData>\n{points}</PointData>\n<Points>\n{_array('Points', places)}</Points>\n"
        f"<Cells>\n{rows}{_array('types', kinds)}</Cells>\n"
        "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
    )


def _array(name: str, values: np.ndarray, **attributes: object) -> str:
    """An array of a .vtu file, compressed: its sizes in bytes as one block, and its content."""
    if values.shape[1:] == (2,):
        values = np.pad(values, ((0, 0), (0, 1)))
    if values.dtype.kind == "f":
        values = values.astype("<f8")
    kind = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}[values.dtype.str[1:]]
    named = enumerate(COMPONENTS.get(name, ()))
    attributes |= {"type": kind, "Name": name, "format": "binary"}
    attributes |= {"NumberOfComponents": values.shape[1]} if values.ndim > 1 else {}
    attributes |= {f"ComponentName{number}": component for number, component in named}
    words = " ".join(f"{key}={quoteattr(str(value))}" for key, value in attributes.items())
    content = values.tobytes()
    packed = zlib.compress(content, 1)
    sizes = struct.pack("<4Q", 1, len(content), 0, len(packed))
    return f"<DataArray {words}>{(b64encode(sizes) + b64encode(packed)).decode()}</DataArray>\n"
