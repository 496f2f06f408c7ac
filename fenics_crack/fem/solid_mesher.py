"""Mesh solids with plane cracks by gmsh, and read mesh files.

A file is read, and a part from a CAD file is meshed, in a separate program
(:mod:`fenics_crack.basics.untrusted_files`). A box is meshed in the calling one.

A crack is an ellipse or a rectangle, as far as it is inside the solid. It has the half axes a and b
in its own frame, with rows e_1, e_2 and the normal. Elements have the length ``size`` or, at a
distance d from a crack front, ``shortest`` + ``growth`` d. A part's file is uncracked: the cracks
are cut into its volume. Its outer faces are then identified by the triangles of an earlier coarse
mesh.

Nodes in the middle of curved edges are moved to the straight middle in two places. Near fronts,
stress intensities are integrals over straight cells. At small faces, curved cells would fold.
"""

import ctypes
import math
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import gmsh
import numpy as np

Tags = list[tuple[int, int]]
"""Dimension and tag of each of several gmsh entities."""
CrackData = dict[str, Any]
"""Position, shape and mesh settings of a crack; keys in :func:`insert_cracks`."""
FrontData = dict[str, Any]
"""Curves and element lengths of a crack front; keys in :func:`insert_cracks`."""

MILLIMETRES_BY_UNIT = {"m": 1e3, "mm": 1.0, "inch": 25.4}
"""Length in mm of each unit that a user may state for a CAD file without a unit."""
EXTERNAL_REFERENCE = re.compile(
    rb"(?i)DOCUMENT_FILE|DCMFL|PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS|PDWAD"
)
"""Words of STEP, also in short, without which OpenCASCADE opens the given file alone."""
STRING_OR_COMMENT = re.compile(rb"(?s)'.*?(?:'(?=[ \n\r]*[),])|\Z)|/\*.*?(?:\*/|\Z)")
"""Strings and comments of STEP, with the ends that OpenCASCADE sees."""
INFINITE_NUMBER = re.compile(rb"(?i)\b(?:nan|inf)\w*(?![.\w]|\s*\()|\d\.?e\+?0*(?:[3-9]\d\d|\d{4})")
"""A number from 1e300, or none; but no enumeration or entity of STEP, as .INF. and INFO()."""
CELLS_PER_CUBED_LENGTH = 5.0
"""Number of tetrahedra with edge length h in a volume h^3."""
COARSE_TRIANGLES_PER_DIAGONAL = 25.0
"""Number of triangles along the diagonal of a part's bounding box, in the coarse mesh of faces."""
STRAIGHT_CELL_DISTANCE_IN_ELEMENTS = 2.5
"""Distance from a front up to which cells get straight edges, in element lengths at the front."""
MIN_JACOBIAN_RATIO_IN_CELL = 0.2
"""Minimum ratio of smallest to largest Jacobian determinant in a cell. Below, the cell's edges are
straightened."""
MIN_ELEMENT_ON_CURVED_FACE_TO_SIZE = 0.1
"""Minimum element length on curved faces, relative to ``mesh.size``."""
MIN_LIGAMENT_PER_ELEMENT_LENGTH = 0.1
"""Minimum distance between crack front and part surface, in element lengths at the front."""
MIN_COSINE_IN_FACE = 0.99
"""Minimum cosine between the normals of a crack and of the face in which it lies."""
MAX_RELATIVE_POINT_TO_FACE_DISTANCE = 0.1
"""Maximum distance between a named point and the nearest face, relative to the part's size."""
DRAWN_ELLIPSE_START_ANGLE = 1.0 + math.pi
"""Angle at which a drawn ellipse begins and ends [rad]. On an axis, the curve's end would lie
beside the mouth of a half ellipse, and rounding would make a short edge."""
MAX_SHORT_TO_LONG_ELLIPSE_RADIUS = 1.0 - 1e-9
"""Maximum ratio of shorter to longer radius. In gmsh 4.8, intersections fail for an ellipse with
equal radii."""
N_CURVE_INTERVALS = 40
"""Number of intervals between sample points on a curve.

Also the number of triangles for matching a cracked part's surface to a face.
"""


class Refusal(Exception):
    """Error for an unusable value in a scene.

    The arguments are the key, such as "mesh.size", and the requirement on the value. The calling
    process raises InputError.
    """


def read(path: str, _max_bytes: int, request: dict[str, Any] | None = None) -> dict[str, Any]:
    """Read a mesh file with gmsh, or mesh a CAD part or only the part's faces.

    Called in a separate program, whose memory the caller limits: ``_max_bytes`` is unused. Lengths
    of CAD parts are in mm.

    Parameters
    ----------
    path : str
        Mesh file or CAD file.
    request : dict or None
        None for a mesh file. For a CAD part: "unit" of the file; "size" of the elements, without
        which only faces are returned; "faces", a list of [name, point]; "cracks" for
        :func:`insert_cracks`; "per_turn", elements on a full turn of a curved face; "cells", the
        maximum number of cells.

    Returns
    -------
    dict
        For a mesh file, arrays of :func:`collect_nodes_and_groups`. For a part, arrays of
        :func:`collect_mesh` with "straight", the number of straightened cells. Without "size",
        "triangles" and "owners" of :func:`triangulate_faces_coarsely`. If a value in the scene
        makes the part unusable, the dict has only "refused". This array has two texts: the value's
        key in the scene, such as "mesh.size", and the requirement on the value.
    """
    with suppress(AttributeError, ValueError):  # as in basics/gmsh_process.py, for FLTK
        ctypes.c_ubyte.in_dll(gmsh.lib, "_ZN2Fl13options_read_E").value = 1
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.ExpertMode", 1)  # it must not ask
    if request is None:
        gmsh.merge(path)
        name_of_group, entities_of_group = (
            gmsh.model.getPhysicalName,
            gmsh.model.getEntitiesForPhysicalGroup,
        )
        return collect_nodes_and_groups(
            [
                (*dim_tag, name_of_group(*dim_tag), entities_of_group(*dim_tag))
                for dim_tag in gmsh.model.getPhysicalGroups()
            ]
        )
    try:
        return _mesh_part(path, request)
    except Refusal as refusal:
        return {"refused": np.array(refusal.args)}


def _mesh_part(path: str, request: dict[str, Any]) -> dict[str, Any]:
    """Mesh a CAD part, or only the part's faces, as requested in :func:`read`.

    ``path`` is the CAD file. The result has the arrays that :func:`read` returns for a part. Raises
    Refusal for a part that cannot be meshed.
    """
    solid_dim_tags = _import_part(path, request["unit"])
    triangles, face_tag_of_triangle = triangulate_faces_coarsely()
    if "size" not in request:
        return {"triangles": triangles, "owners": face_tag_of_triangle}
    names_and_face_tags = _find_names_and_face_tags(
        request["faces"], triangles, face_tag_of_triangle
    )
    crack_surface_tags, fronts = insert_cracks(solid_dim_tags, request["cracks"], triangles)
    size = request["size"]
    n_bulk_cells, n_front_cells = estimate_bulk_and_front_cells(size, fronts)
    if n_bulk_cells + n_front_cells > request["cells"]:
        refused_key, larger_or_smaller_text = (
            ("mesh.size", "larger")
            if n_bulk_cells > n_front_cells
            else ("mesh.lip_elements", "smaller")
        )
        raise Refusal(
            refused_key,
            f"{larger_or_smaller_text}, for a mesh of at most {request['cells']:.0e} cells; it "
            "would have "
            f"about {n_bulk_cells + n_front_cells:.2g}",
        )
    try:
        generate_mesh(size, fronts, request["per_turn"])
        gmsh.model.mesh.setOrder(2)
    except Exception as error:
        requirement = f"another size, as gmsh cannot mesh the part with this one ({error})"
        raise Refusal("mesh.size", requirement) from None
    face_of_surface = _match_outer_surfaces_to_faces(
        crack_surface_tags, triangles, face_tag_of_triangle
    )
    surface_tags_by_name = {
        name: [
            surface_tag
            for surface_tag, face_tag in face_of_surface.items()
            if face_tag in face_tags
        ]
        for name, face_tags in names_and_face_tags
    }
    mesh_array_by_name = collect_mesh(crack_surface_tags, surface_tags_by_name)
    mesh_array_by_name["positions"], mesh_array_by_name["straight"] = straighten_edges(
        mesh_array_by_name, fronts
    )
    return mesh_array_by_name


# --- the part -------------------------------------------------------------------------------------


def _import_part(path: str, unit: str) -> Tags:
    """Import a CAD file's single solid into gmsh, scaled to mm; Refusal for other contents.

    The text is read first: gmsh would open all files that a STEP file names, and may never return
    from a NAN. ``unit`` is a key in ``MILLIMETRES_BY_UNIT``. Returns the solid's dimension and tag
    in a list.
    """
    text = Path(path).read_bytes()
    if not path.endswith(".brep"):
        if word := EXTERNAL_REFERENCE.search(text):
            requirement = f"a part alone; {word[0].decode()} in it names another file"
            raise Refusal("geometry.file", f"{requirement}; export it again without")
        text = STRING_OR_COMMENT.sub(b" ", text)
    if word := INFINITE_NUMBER.search(text):
        number = word[0][:20].decode(errors="replace")
        raise Refusal("geometry.file", f"a part whose numbers are finite; this one has {number}")
    gmsh.model.add("part")
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    try:
        solid_dim_tags = gmsh.model.occ.importShapes(path, highestDimOnly=True)
    except Exception as error:
        raise Refusal(
            "geometry.file", f"a CAD file that gmsh can read; export it again ({error})"
        ) from None
    if len(solid_dim_tags) != 1 or solid_dim_tags[0][0] != 3:
        n_solids = sum(dimension == 3 for dimension, _ in solid_dim_tags)
        raise Refusal("geometry.file", f"a file with one solid; this file has {n_solids or 'none'}")
    if (mm_per_unit := MILLIMETRES_BY_UNIT[unit]) != 1.0:
        gmsh.model.occ.dilate(solid_dim_tags, 0.0, 0.0, 0.0, mm_per_unit, mm_per_unit, mm_per_unit)
    gmsh.model.occ.synchronize()
    return solid_dim_tags


def triangulate_faces_coarsely() -> tuple[np.ndarray, np.ndarray]:
    """Mesh the faces of gmsh's current part coarsely, and clear the mesh again.

    Returns
    -------
    triangles : (n, 3, 3) [mm]
        Corners of the triangles.
    owners : (n,) int
        gmsh's tag for the face on which each triangle lies.
    """
    bounding_box_corners = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    max_size = (
        float(np.linalg.norm(np.ptp(bounding_box_corners, axis=0))) / COARSE_TRIANGLES_PER_DIAGONAL
    )
    set_size_options(Max=max_size, FromCurvature=16, Min=0.05 * max_size)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:
        requirement = f"a part whose faces gmsh can mesh; repair it in the CAD program ({error})"
        raise Refusal("geometry.file", requirement) from None
    triangles, face_tag_of_triangle = [], []
    for _, face_tag in gmsh.model.getEntities(2):
        face_triangles = _face_triangles(face_tag)
        triangles.append(face_triangles)
        face_tag_of_triangle += [face_tag] * len(face_triangles)
    gmsh.model.mesh.clear()
    return np.concatenate(triangles), np.array(face_tag_of_triangle)


def _face_triangles(tag: int) -> np.ndarray:
    """Return the corners of the mesh's triangles on gmsh's face ``tag``: (n, 3, 3).

    The triangles may be of any order. Without triangles n is 0.
    """
    kinds, _, nodes = gmsh.model.mesh.getElements(2, tag)
    if not kinds:
        return np.zeros((0, 3, 3))
    n_nodes_per_element = gmsh.model.mesh.getElementProperties(kinds[0])[3]
    node_numbers, positions, _ = gmsh.model.mesh.getNodes()
    number_order = np.argsort(node_numbers)
    corner_numbers = nodes[0].reshape(-1, n_nodes_per_element)[:, :3]
    node_index = number_order[np.searchsorted(node_numbers, corner_numbers, sorter=number_order)]
    return positions.reshape(-1, 3)[node_index]


def point_to_triangle_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the distance from each point (n, 3) to each triangle (m, 3, 3): (n, m)."""
    side_1, side_2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    offsets_from_corner_to_point = points[:, None] - triangles[:, 0]
    side_1_squared = (side_1**2).sum(1)
    side_1_dot_side_2 = (side_1 * side_2).sum(1)
    side_2_squared = (side_2**2).sum(1)
    offset_dot_side_1 = (offsets_from_corner_to_point * side_1).sum(2)
    offset_dot_side_2 = (offsets_from_corner_to_point * side_2).sum(2)
    gram_determinant = np.maximum(side_1_squared * side_2_squared - side_1_dot_side_2**2, 1e-300)
    u = (
        side_2_squared * offset_dot_side_1 - side_1_dot_side_2 * offset_dot_side_2
    ) / gram_determinant
    v = (
        side_1_squared * offset_dot_side_2 - side_1_dot_side_2 * offset_dot_side_1
    ) / gram_determinant
    distances_to_triangles = np.linalg.norm(
        offsets_from_corner_to_point - u[..., None] * side_1 - v[..., None] * side_2, axis=2
    )
    distances_to_triangles[(u < 0.0) | (v < 0.0) | (u + v > 1.0)] = np.inf
    for start_corner, stop_corner in ((0, 1), (1, 2), (2, 0)):
        side = triangles[:, stop_corner] - triangles[:, start_corner]
        offsets_from_corner_to_point = points[:, None] - triangles[:, start_corner]
        fractions = np.clip(
            (offsets_from_corner_to_point * side).sum(2) / np.maximum((side**2).sum(1), 1e-300),
            0.0,
            1.0,
        )
        distances_to_triangles = np.minimum(
            distances_to_triangles,
            np.linalg.norm(offsets_from_corner_to_point - fractions[..., None] * side, axis=2),
        )
    return distances_to_triangles


def _find_names_and_face_tags(
    names_and_points: Iterable[tuple[str, list[float]]],
    part_triangles: np.ndarray,
    triangle_faces: np.ndarray,
) -> Iterable[tuple[str, set[int]]]:
    """Find the faces of a CAD part named by a user through points.

    Parameters
    ----------
    names_and_points : pairs of (str, (3,)) [mm]
        Name of a face, and a point on the face. A name may occur with several points.
    part_triangles : (n, 3, 3) [mm]
        Corners of triangles in a coarse mesh on all faces of the part.
    triangle_faces : (n,) int
        gmsh's face tag for each triangle.

    Returns
    -------
    pairs of (str, set of int)
        Each name with gmsh's tags for the faces nearest to the points.

    Raises
    ------
    Refusal
        A point is farther than a tenth of the part's size from all faces.
    """
    part_size = np.ptp(part_triangles.reshape(-1, 3), axis=0).max()
    face_tags_by_name: dict[str, set[int]] = {}
    for name, point in names_and_points:
        point_distances = point_to_triangle_distances(np.array([point]), part_triangles)[0]
        if point_distances.min() > MAX_RELATIVE_POINT_TO_FACE_DISTANCE * part_size:
            position_text = ", ".join(f"{1e-3 * coordinate:.4g}" for coordinate in point)
            requirement = (
                f"points on faces; the point ({position_text}) m of {name} is"
                f" {point_distances.min():.3g} mm away from the nearest face"
            )
            raise Refusal("geometry.faces", requirement)
        face_tags_by_name.setdefault(name, set()).add(triangle_faces[point_distances.argmin()])
    return face_tags_by_name.items()


def _match_outer_surfaces_to_faces(
    crack_surface_tags: list[int], part_triangles: np.ndarray, triangle_faces: np.ndarray
) -> dict[int, int]:
    """Match each outer surface of the cracked part to a face of the uncracked part.

    Used because a crack changes gmsh's tags, but names belong to faces of the uncracked part.

    Parameters
    ----------
    crack_surface_tags : list of int
        gmsh's tags for the cracks; they are not matched.
    part_triangles : (n, 3, 3)
        Corners of triangles in a coarse mesh on the faces of the uncracked part.
    triangle_faces : (n,) int
        gmsh's face tag for each triangle.

    Returns
    -------
    dict of int to int
        Tag of the uncracked part's face, by tag of the cracked part's surface. 0 for a surface
        without triangles.
    """
    face_of_surface = {}
    for _, surface_tag in gmsh.model.getEntities(2):
        if surface_tag not in crack_surface_tags:
            triangle_centres = _face_triangles(surface_tag).mean(axis=1)
            sample_points = triangle_centres[:: max(1, len(triangle_centres) // N_CURVE_INTERVALS)]
            nearest_faces = triangle_faces[
                point_to_triangle_distances(sample_points, part_triangles).argmin(axis=1)
            ]
            face_of_surface[surface_tag] = (
                np.bincount(nearest_faces).argmax() if len(nearest_faces) else 0
            )
    return face_of_surface


# --- cracks ---------------------------------------------------------------------------------------


def insert_cracks(
    solid_dim_tags: Tags, cracks: list[CrackData], part_triangles: np.ndarray
) -> tuple[list[int], list[FrontData]]:
    """Cut cracks into a solid in gmsh, and return crack surfaces and fronts.

    Raises Refusal unless each crack is one connected surface inside the solid, without contact with
    another crack. Also if cracks cut the solid in two.

    Parameters
    ----------
    solid_dim_tags : list of (int, int)
        gmsh's dimension and tag of the solid.
    cracks : list of dict
        Keys: "key", table of the crack in the scene, as "cracks.1"; "shape", the table's key for
        the crack's size, as "radii", which error messages name; "unit", unit of length in the mesh
        [m]; "middle" (3,); "frame" (3, 3), rows e_1, e_2 and the normal; "half", half axes (2,),
        None for a half-plane that ends at the middle; "is_round", True for an ellipse, False for a
        rectangle; "reach", distance on the crack face from the front to the middle or mouth, None
        for a half-plane; "elements", number of elements over this distance; "grading", longest over
        shortest element length.
    part_triangles : (n, 3, 3)
        Triangles on the faces of the solid. Empty if the crack's position is checked already.

    Returns
    -------
    surfaces : list of int
        gmsh's tag for each crack's surface.
    fronts : list of dict
        Keys: "curves", gmsh's tags for the front's curves; "points", on the curves (n, 3); "ends",
        end points of the front (m, 3); "shortest", element length at the front; "growth", increase
        of the element length per distance; "length", length of the front.
    """
    occ, crack_face_dim_tags = gmsh.model.occ, []
    for crack in cracks:
        if is_half_plane := crack["half"] is None:
            corners = part_triangles.reshape(-1, 3)
            distance = np.linalg.norm(corners - crack["middle"], axis=1).max()
            crack["half"] = [max(2.0 * np.ptp(corners, axis=0).max(), distance)] * 2
        crack_piece_dim_tags = occ.intersect(
            _draw_crack_face(crack), solid_dim_tags, removeObject=True, removeTool=False
        )[0]
        crack_piece_dim_tags = [
            crack_piece_dim_tag
            for crack_piece_dim_tag in crack_piece_dim_tags
            if crack_piece_dim_tag[0] == 2
        ]
        if len(crack_piece_dim_tags) != 1:
            centres = np.reshape(
                [occ.getCenterOfMass(*face_dim_tag) for face_dim_tag in crack_piece_dim_tags],
                (-1, 3),
            )
            is_on_part_face = point_to_triangle_distances(centres, part_triangles) < 1e-6 * np.ptp(
                part_triangles
            )
            problem = (
                f"the crack misses the part{_describe_solid_extent(crack, part_triangles)}"
                if not crack_piece_dim_tags
                else "the crack lies in a face of the part" if np.any(is_on_part_face)
                else f"the crack is in {len(crack_piece_dim_tags)} pieces"
            )  # fmt: skip
            if is_half_plane and len(crack_piece_dim_tags) > 1:
                problem += (
                    "; for one that starts at a hole give radii in place of front = 'through'"
                )
            requirement_text = f"such that the crack is one surface inside the part; {problem}"
            raise Refusal(f"{crack['key']}.point", requirement_text)
        crack_face_dim_tags += crack_piece_dim_tags
    fragments, children = (
        occ.fragment(solid_dim_tags, crack_face_dim_tags)
        if crack_face_dim_tags
        else (solid_dim_tags, [solid_dim_tags])
    )
    occ.synchronize()
    rims = [
        {
            curve_tag
            for _, curve_tag in gmsh.model.getBoundary(
                surface_dim_tags, combined=False, oriented=False
            )
        }
        for surface_dim_tags in children[1:]
    ]
    fronts = [_make_front_data(crack, rim) for crack, rim in zip(cracks, rims, strict=True)]
    if sum(dimension == 3 for dimension, _ in fragments) != 1:
        crack = next(
            (crack for crack, front in zip(cracks, fronts, strict=True) if not front["curves"]),
            cracks[-1],
        )
        requirement_text = "such that the crack does not cut the part in two, and crosses no other"
        raise Refusal(f"{crack['key']}.{crack['shape']}", requirement_text)
    cracks_rims_and_fronts = [*zip(cracks, children[1:], rims, fronts, strict=True)]
    for crack_index, (crack, surface_dim_tags, rim, front) in reversed(
        [*enumerate(cracks_rims_and_fronts)]
    ):
        if len(surface_dim_tags) != 1 or any(rim & other_rim for other_rim in rims[:crack_index]):
            requirement = "such that the crack neither crosses nor touches another crack"
            raise Refusal(f"{crack['key']}.point", requirement)
        if len(part_triangles):
            _check_front_and_ligament_exist(crack, surface_dim_tags[0][1], front, part_triangles)
    return [surface_dim_tags[0][1] for surface_dim_tags in children[1:]], fronts


def _describe_solid_extent(crack: CrackData, part_triangles: np.ndarray) -> str:
    """Return text for an error: the range of coordinates [m] of the uncracked part.

    If the crack's point seems to be in mm, the text has a hint. ``part_triangles`` (n, 3, 3) are
    triangles on the part's faces, in the mesh's unit.
    """
    lower_corner, upper_corner = part_triangles.min(axis=(0, 1)), part_triangles.max(axis=(0, 1))
    lower_corner_text, upper_corner_text = (
        ", ".join(f"{crack['unit'] * coordinate:.4g}" for coordinate in box_corner)
        for box_corner in (lower_corner, upper_corner)
    )
    middle_read_as_mm = 1e-3 * np.array(crack["middle"])
    distance = point_to_triangle_distances(np.array([crack["middle"]]), part_triangles).min()
    unit_hint = ""
    if distance > np.linalg.norm(upper_corner - lower_corner) and np.all(
        (lower_corner <= middle_read_as_mm) & (middle_read_as_mm <= upper_corner)
    ):
        unit_hint = "; give the point in m, not in mm"
    return f", which is from ({lower_corner_text}) to ({upper_corner_text}) m{unit_hint}"


def _draw_crack_face(crack: CrackData) -> Tags:
    """Draw a crack's ellipse or rectangle in gmsh at the crack's position.

    ``crack`` has the keys in :func:`insert_cracks`. Returns a list with gmsh's (dimension, tag) of
    the face.
    """
    occ, (e_1, e_2, normal), (half_axis_a, half_axis_b) = (
        gmsh.model.occ,
        np.array(crack["frame"]),
        crack["half"],
    )
    if crack["is_round"] and half_axis_a < half_axis_b:
        half_axis_a, half_axis_b, e_1 = half_axis_b, half_axis_a, e_2
    if crack["is_round"]:
        ellipse_tag = occ.addEllipse(
            0.0, 0.0, 0.0, half_axis_a,
            min(half_axis_b, MAX_SHORT_TO_LONG_ELLIPSE_RADIUS * half_axis_a),
            angle1=DRAWN_ELLIPSE_START_ANGLE, angle2=DRAWN_ELLIPSE_START_ANGLE + 2.0 * math.pi,
        )  # fmt: skip
        face_dim_tags = [(2, occ.addPlaneSurface([occ.addCurveLoop([ellipse_tag])]))]
    else:
        face_dim_tags = [
            (
                2,
                occ.addRectangle(
                    -half_axis_a, -half_axis_b, 0.0, 2.0 * half_axis_a, 2.0 * half_axis_b
                ),
            )
        ]
    e_2 = np.cross(normal, e_1)
    is_horizontal = math.hypot(normal[0], normal[1]) < 1e-12
    euler_angles = (
        math.atan2(e_1[1], e_1[0] * normal[2]) if is_horizontal else math.atan2(e_2[2], -e_1[2]),
        math.acos(np.clip(normal[2], -1.0, 1.0)),
        0.0 if is_horizontal else math.atan2(normal[1], normal[0]),
    )
    for rotation_axis, euler_angle in zip(
        ((0, 0, 1), (0, 1, 0), (0, 0, 1)), euler_angles, strict=True
    ):
        occ.rotate(face_dim_tags, 0.0, 0.0, 0.0, *rotation_axis, euler_angle)
    occ.translate(
        face_dim_tags, *(crack["middle"] - (crack["reach"] is None) * half_axis_a * np.array(e_1))
    )
    return face_dim_tags


def _sample_curve(curve_tag: int) -> np.ndarray:
    """Return 41 points on a gmsh curve, with both ends: (41, 3)."""
    (first_parameter,), (last_parameter,) = gmsh.model.getParametrizationBounds(1, curve_tag)
    parameters = np.linspace(first_parameter, last_parameter, N_CURVE_INTERVALS + 1)
    return np.reshape(gmsh.model.getValue(1, curve_tag, parameters), (-1, 3))


def _make_front_data(crack: CrackData, rim: set[int]) -> FrontData:
    """Return the front of a crack as a dict, with the keys in :func:`insert_cracks`.

    ``rim`` has gmsh's tags for all curves around the crack's surface. The curves on the border of
    the ellipse or rectangle form the front; all other curves lie on the part's surface. ``crack``
    has the keys in :func:`insert_cracks`.
    """
    half_axes, frame, is_straight = crack["half"], np.array(crack["frame"]), crack["reach"] is None
    front_curves, point_arrays, extent_behind_front = [], [np.zeros((0, 3))], 0.0
    for rim_curve in rim:
        rim_points = _sample_curve(rim_curve)
        x, y, _ = ((rim_points - crack["middle"]) @ frame.T).T
        if is_straight:
            position_relative_to_border = 1.0 + x / half_axes[0]
            extent_behind_front = max(extent_behind_front, -float(x.min()))
        elif crack["is_round"]:
            position_relative_to_border = np.hypot(x / half_axes[0], y / half_axes[1])
        else:
            position_relative_to_border = np.maximum(
                np.abs(x) / half_axes[0], np.abs(y) / half_axes[1]
            )
        if np.abs(position_relative_to_border - 1.0).max() < 1e-5:
            front_curves.append(rim_curve)
            point_arrays.append(rim_points)
    extent_behind_front = extent_behind_front if is_straight else crack["reach"]
    length_over_previous = crack["grading"] ** (1.0 / max(crack["elements"] - 1, 1))
    curve_end_points = np.array(
        [curve_points[end_index] for curve_points in point_arrays[1:] for end_index in (0, -1)]
    ).reshape(-1, 3)
    is_same_end = (
        np.linalg.norm(curve_end_points[:, None] - curve_end_points, axis=2)
        < 1e-5 * extent_behind_front
    )
    return {
        "curves": front_curves, "points": np.concatenate(point_arrays),
        "ends": curve_end_points[is_same_end.sum(axis=1) == 1],
        "shortest": float(
            extent_behind_front / (length_over_previous ** np.arange(crack["elements"])).sum()
        ),
        "growth": max(length_over_previous - 1.0, 1.0 / 3.0),
        "length": sum(
            np.linalg.norm(np.diff(curve_points, axis=0), axis=1).sum()
            for curve_points in point_arrays
        ),
    }  # fmt: skip


def _check_front_and_ligament_exist(
    crack: CrackData, surface_tag: int, front: FrontData, part_triangles: np.ndarray
) -> None:
    """Raise Refusal if a crack lies in a face of the part, or the front is too close to a face.

    The limit is 0.1 times the element length at the front. The crack's centre, and the front except
    near its ends, must be farther than this from the part's faces. A crack without a front inside
    the part is refused, too.

    Parameters
    ----------
    crack : CrackData
        Crack, with the keys in :func:`insert_cracks`.
    surface_tag : int
        gmsh's tag for the crack's surface.
    front : FrontData
        The crack's front, with the keys in :func:`insert_cracks`.
    part_triangles : (n, 3, 3)
        Triangles on the faces of the part.
    """
    point_key, shortest_element_length = f"{crack['key']}.point", front["shortest"]
    centre = np.array([gmsh.model.occ.getCenterOfMass(2, surface_tag)])
    centre_distances = point_to_triangle_distances(centre, part_triangles)[0]
    if (
        not front["curves"]
        or centre_distances.min() < MIN_LIGAMENT_PER_ELEMENT_LENGTH * shortest_element_length
    ):
        problem_text = "has no front inside the part"
        if front["curves"]:
            a, b, c = part_triangles[centre_distances.argmin()]
            normal = np.cross(b - a, c - a)
            problem_text = "lies in a face of the part"
            if abs(normal @ crack["frame"][2]) < MIN_COSINE_IN_FACE * np.linalg.norm(normal):
                depth = centre_distances.min() / shortest_element_length
                problem_text = (
                    f"is too shallow for the mesh: its centre is {depth:.2g} element lengths deep; "
                    "raise mesh.lip_elements, or give a deeper crack"
                )
        raise Refusal(
            point_key, f"such that the crack is inside the part; the crack {problem_text}"
        )
    points, end_points = front["points"], front["ends"]
    distances_to_nearest_end = np.linalg.norm(points[:, None] - end_points, axis=2).min(
        axis=1, initial=np.inf
    )
    points_off_ends = points[distances_to_nearest_end > 2.0 * shortest_element_length]
    shortest_ligament = point_to_triangle_distances(points_off_ends, part_triangles).min(
        initial=np.inf
    )
    if shortest_ligament < MIN_LIGAMENT_PER_ELEMENT_LENGTH * shortest_element_length:
        distance_text = f"{shortest_ligament / shortest_element_length:.2g} element lengths away"
        requirement_text = f"farther from the surface: a part of the front is only {distance_text}"
        raise Refusal(point_key, requirement_text)


def estimate_bulk_and_front_cells(size: float, fronts: list[FrontData]) -> tuple[float, float]:
    """Estimate the number of cells for gmsh's current model.

    Around a front the elements are shorter. The number is 5 L int 2 pi d / h^3 dd, with the
    front's length L, the distance d from the front, and the element length h at d.

    Parameters
    ----------
    size : float
        Element length far from the fronts, in the mesh's unit.
    fronts : list of FrontData
        Fronts, with the keys in :func:`insert_cracks`.

    Returns
    -------
    float
        Number of cells if the element length were ``size`` in the whole volume.
    float
        Number of cells around the fronts, with elements shorter than ``size``.
    """
    relative_volume = (
        sum(gmsh.model.occ.getMass(3, volume_tag) for _, volume_tag in gmsh.model.getEntities(3))
        / size**3
    )
    front_integral = 0.0
    for front in fronts:
        shortest_element_length = min(front["shortest"], size)
        radial_integral = (
            0.5 / shortest_element_length - 1.0 / size + 0.5 * shortest_element_length / size**2
        )
        front_integral += front["length"] * 2.0 * math.pi / front["growth"] ** 2 * radial_integral
    return CELLS_PER_CUBED_LENGTH * relative_volume, CELLS_PER_CUBED_LENGTH * front_integral


# --- the mesh -------------------------------------------------------------------------------------


def generate_mesh(size: float, fronts: list[FrontData], per_turn: int = 0) -> None:
    """Mesh gmsh's current model with elements of length ``size``, shorter at fronts.

    ``fronts`` have the keys in :func:`insert_cracks`. ``per_turn`` is the number of elements around
    a full circle of a curved face; 0: curved faces have no shorter elements.
    """
    length_fields = []
    for front in fronts:
        if front["curves"]:
            distance_field, length_field = add_graded_field(
                "CurvesList", front["curves"], size, front["shortest"], front["growth"]
            )
            n_curve_samples = min(
                2000, max(N_CURVE_INTERVALS, math.ceil(2.0 * front["length"] / front["shortest"]))
            )
            for option_name in ("NumPointsPerCurve", "Sampling"):  # gmsh until 4.8, and later
                with suppress(Exception):
                    gmsh.model.mesh.field.setNumber(distance_field, option_name, n_curve_samples)
            length_fields.append(length_field)
    if length_fields:
        use_smallest_length(length_fields)
    # Small faces of a part are not resolved, as some meshes would not end.
    min_size = min(
        [MIN_ELEMENT_ON_CURVED_FACE_TO_SIZE * size, *(front["shortest"] for front in fronts)]
    )
    set_size_options(
        FromPoints=0, ExtendFromBoundary=0, FromCurvature=per_turn, Max=size, Min=min_size
    )
    try:
        gmsh.model.mesh.generate(3)
    finally:
        set_size_options(FromCurvature=0, Max=1e22, Min=0)  # defaults for the next mesh


def add_graded_field(
    list_name: str, tags: list[int], size: float, shortest: float, growth: float
) -> tuple[int, int]:
    """Make the element length in gmsh grow with the distance from points or curves.

    At the distance d the length is ``shortest`` + ``growth`` d, at most ``size``. The field has an
    effect only after :func:`use_smallest_length`.

    Parameters
    ----------
    list_name : str
        "CurvesList" if the tags belong to curves, "PointsList" for points.
    tags : list of int
        gmsh's tags for the curves or points.
    size, shortest : float
        Longest and shortest element length.
    growth : float
        Increase of the element length per distance.

    Returns
    -------
    distance_field, length_field : int
        gmsh's tags for the field of distances, and of the field of element lengths.
    """
    field = gmsh.model.mesh.field
    distance_field, length_field = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance_field, list_name, tags)
    min_size = min(shortest, size)
    threshold_options = {
        "InField": distance_field, "SizeMin": min_size, "SizeMax": size, "DistMin": 0.0,
        "DistMax": max((size - min_size) / growth, 1e-9 * size),
    }  # fmt: skip
    for option_name, option_value in threshold_options.items():
        field.setNumber(length_field, option_name, option_value)
    return distance_field, length_field


def use_smallest_length(length_fields: list[int]) -> None:
    """Set gmsh's element length to the smallest of several length fields, at every point.

    ``length_fields`` are gmsh's tags from :func:`add_graded_field`.
    """
    minimum_field = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(minimum_field, "FieldsList", length_fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(minimum_field)


def set_size_options(**options: float) -> None:
    """Set gmsh's options for element lengths, by the end of the option's name.

    As an example, ``set_size_options(Max=2.0)`` sets ``Mesh.MeshSizeMax`` to 2.
    """
    for option_suffix, option_value in options.items():
        gmsh.option.setNumber(f"Mesh.MeshSize{option_suffix}", option_value)


def collect_mesh(
    crack_surface_tags: list[int], surface_tags_by_name: dict[str, list[int]]
) -> dict[str, Any]:
    """Collect gmsh's current mesh as arrays, with the solid, named surfaces and cracks as groups.

    Parameters
    ----------
    crack_surface_tags : list of int
        gmsh's tag for each crack. The groups are named "crack 1", "crack 2" and so on.
    surface_tags_by_name : dict of str to list of int
        gmsh's tags for the surfaces with each name.

    Returns
    -------
    dict
        Arrays of :func:`collect_nodes_and_groups`, and "middles", the cracks' centres of mass (n,
        3).
    """
    surface_groups = [
        *surface_tags_by_name.items(),
        *(
            (f"crack {crack_number}", [tag])
            for crack_number, tag in enumerate(crack_surface_tags, 1)
        ),
    ]
    groups = [(3, 1, "solid", [tag for _, tag in gmsh.model.getEntities(3)])]
    groups += [(2, tag, *surface_group) for tag, surface_group in enumerate(surface_groups, 2)]
    crack_centres = [gmsh.model.occ.getCenterOfMass(2, tag) for tag in crack_surface_tags]
    return collect_nodes_and_groups(groups) | {"middles": np.reshape(crack_centres, (-1, 3))}


def collect_nodes_and_groups(groups: list[tuple[Any, ...]]) -> dict[str, Any]:
    """Collect the nodes and named groups of gmsh's current mesh as arrays.

    Parameters
    ----------
    groups : list of (dimension, tag, name, entities)
        Groups, with gmsh's tags for the points, curves, surfaces or volumes in each.

    Returns
    -------
    dict
        For all nodes: "numbers" (n,) and "positions" (n, 3).

        For each group: a row in "names" (m,), and in "heads" (m, 4): dimension, group tag, gmsh's
        kind of elements, number of entries in "nodes". A group with several kinds of elements or
        several entities has several rows.

        "nodes": node numbers of all elements, row after row.
    """
    node_numbers, node_positions, _ = gmsh.model.mesh.getNodes()
    headers, header_names, node_arrays = [], [], [np.zeros(0, dtype=np.uint64)]
    for dimension, tag, group_name, entities in groups:
        for entity in entities:
            element_kinds, _, element_nodes = gmsh.model.mesh.getElements(dimension, entity)
            headers += [
                (dimension, tag, element_kind, len(nodes_of_kind))
                for element_kind, nodes_of_kind in zip(element_kinds, element_nodes, strict=True)
            ]
            header_names += [group_name] * len(element_kinds)
            node_arrays += element_nodes
    return {
        "numbers": node_numbers, "positions": node_positions.reshape(-1, 3),
        "heads": np.array(headers, dtype=np.int64).reshape(-1, 4),
        "names": np.array(header_names, dtype=str), "nodes": np.concatenate(node_arrays),
    }  # fmt: skip


TETRAHEDRON_EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)])
"""Corners at the ends of a tetrahedron's edges, for the middle nodes 4 to 9 in gmsh's order."""


def straighten_edges(
    array_by_name: dict[str, Any], fronts: list[FrontData]
) -> tuple[np.ndarray, int]:
    """Straighten the edges of cells at crack fronts, and of nearly folded cells.

    To straighten an edge, the middle node is moved halfway between the ends. A cell is nearly
    folded if its Jacobian determinant varies too much.

    Parameters
    ----------
    array_by_name : dict
        Arrays of :func:`collect_nodes_and_groups` for quadratic tetrahedra.
    fronts : list of FrontData
        Fronts, with the keys in :func:`insert_cracks`.

    Returns
    -------
    positions : (n_nodes, 3)
        New positions of all nodes.
    int
        Number of cells that had a curved edge and are straight now.
    """
    positions, node_numbers = array_by_name["positions"].copy(), array_by_name["numbers"]
    number_order = np.argsort(node_numbers)
    cell_node_numbers = array_by_name["nodes"][
        : array_by_name["heads"][array_by_name["heads"][:, 0] == 3, 3].sum()
    ]
    cells = number_order[
        np.searchsorted(node_numbers, cell_node_numbers, sorter=number_order)
    ].reshape(-1, 10)
    element_kind = gmsh.model.mesh.getElementType("tetrahedron", 2)
    reference_points = gmsh.model.mesh.getElementProperties(element_kind)[4]
    _, basis_gradients, _ = gmsh.model.mesh.getBasisFunctions(
        element_kind, reference_points, "GradLagrange"
    )
    basis_gradients = np.reshape(basis_gradients, (10, 10, 3))

    def is_folded() -> np.ndarray:
        """Return True for each nearly folded cell: (n_cells,) bool.

        The Jacobian determinant varies too much within such a cell.
        """
        determinants = np.linalg.det(np.einsum("cnx,pnr->cpxr", positions[cells], basis_gradients))
        return np.asarray(
            determinants.min(axis=1) < MIN_JACOBIAN_RATIO_IN_CELL * determinants.max(axis=1)
        )

    must_straighten_cell, is_straightened_cell = is_folded(), np.zeros(len(cells), dtype=bool)
    for front in fronts:
        for front_point in front["points"]:
            corner_distances = np.linalg.norm(positions[cells[:, :4]] - front_point, axis=2).min(
                axis=1
            )
            must_straighten_cell |= (
                corner_distances
                < STRAIGHT_CELL_DISTANCE_IN_ELEMENTS * front["shortest"]
                + front["length"] / N_CURVE_INTERVALS
            )
    edge_centres = positions[cells[:, TETRAHEDRON_EDGES]].mean(axis=2)
    is_initially_curved_cell = np.abs(positions[cells[:, 4:]] - edge_centres).max(
        axis=(1, 2)
    ) > 1e-9 * np.ptp(positions)
    while np.any(must_straighten_cell & ~is_straightened_cell):
        is_straightened_cell |= must_straighten_cell
        positions[cells[must_straighten_cell, 4:]] = positions[
            cells[must_straighten_cell][:, TETRAHEDRON_EDGES]
        ].mean(axis=2)
        must_straighten_cell = is_folded()
    return positions, int((is_straightened_cell & is_initially_curved_cell).sum())
