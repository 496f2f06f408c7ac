"""A scene for a part from a CAD file: list of faces, and proposals of clamp, load and crack."""

from __future__ import annotations

import json
import os
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_crack.draw.plot_mesh import draw_numbered_faces
from fenics_crack.fem.solid import find_ray_hit_distance, read_part_triangles_and_owners
from fenics_crack.version import read_packaged_text

MAX_LISTED_FACES = 40
"""Maximum number of the part's faces, largest first, listed in the scene and in the picture."""
CRACK_TO_CLAMP_OVER_PART_LENGTH = 0.2
"""Height of the proposed crack above the clamp, relative to the part's length."""


@dataclass(frozen=True)
class _PartSurface:
    """Hold the surface triangles of a CAD part, and a point on each face.

    Attributes
    ----------
    triangle_corner_points : (n, 3, 3) [m]
        Three corners of each triangle, with coordinates.
    face_numbers : (n,)
        Face number of each triangle.
    triangle_areas : (n,) [m^2]
    triangle_normals : (n, 3)
        Outward unit vectors.
    triangle_centers : (n, 3) [m]
    face_numbers_largest_first : list of int
        Face numbers, the largest face first.
    face_center_points : (n_faces, 3) [m]
        Triangle center nearest to each face's center, in the order of
        ``face_numbers_largest_first``.
    """

    triangle_corner_points: np.ndarray
    face_numbers: np.ndarray
    triangle_areas: np.ndarray
    triangle_normals: np.ndarray
    triangle_centers: np.ndarray
    face_numbers_largest_first: list[int]
    face_center_points: np.ndarray

    def face_area(self, face_number: int) -> float:
        """Return a face's area [m^2]."""
        return float(self.triangle_areas[self.face_numbers == face_number].sum())

    def find_end_face_index(self, axis: int, *, at_top: bool) -> int:
        """Find the largest face at an end of the part along a coordinate axis.

        A face counts as at the end if no face center lies further out, by more than 0.1 % of the
        part's length.

        Parameters
        ----------
        axis : int
            Coordinate axis, 0 to 2.
        at_top : bool
            True for the end with the highest coordinate, False for the lowest.

        Returns
        -------
        int
            Index in ``face_numbers_largest_first`` and ``face_center_points``.
        """
        point_heights = self.face_center_points[:, axis]
        height_tolerance = 1e-3 * float(np.ptp(self.triangle_corner_points[..., axis]))
        is_at_end = (
            point_heights > point_heights.max() - height_tolerance
            if at_top
            else point_heights < point_heights.min() + height_tolerance
        )
        return int(is_at_end.argmax())


def _read_part_surface(part_path: Path, length_unit: str | None) -> _PartSurface:
    """Read the triangles of a CAD part, and compute area, normals and center of all faces.

    ``part_path`` is the CAD file. ``length_unit`` is "mm" for a file format without units; None:
    the file states the unit.
    """
    arrays_by_name = read_part_triangles_and_owners(str(part_path), length_unit)
    triangle_corner_points, face_numbers = arrays_by_name["triangles"], arrays_by_name["owners"]
    edge_vectors = triangle_corner_points[:, 1:] - triangle_corner_points[:, :1]
    triangle_normals = np.cross(edge_vectors[:, 0], edge_vectors[:, 1])
    triangle_centers = triangle_corner_points.mean(axis=1)
    triangle_areas = 0.5 * np.linalg.norm(triangle_normals, axis=1)
    triangle_normals /= np.maximum(2.0 * triangle_areas, 1e-300)[:, None]
    face_numbers_largest_first = sorted(
        set(face_numbers.tolist()),
        key=lambda face_number: -triangle_areas[face_numbers == face_number].sum(),
    )
    face_center_points = []
    for face_number in face_numbers_largest_first:
        is_on_face = face_numbers == face_number
        face_center = (
            triangle_areas[is_on_face]
            @ triangle_centers[is_on_face]
            / triangle_areas[is_on_face].sum()
        )
        center_distances = np.linalg.norm(triangle_centers[is_on_face] - face_center, axis=1)
        face_center_points.append(triangle_centers[is_on_face][center_distances.argmin()])
    return _PartSurface(
        triangle_corner_points,
        face_numbers,
        triangle_areas,
        triangle_normals,
        triangle_centers,
        face_numbers_largest_first,
        np.array(face_center_points),
    )


def _propose_crack(part_surface: _PartSurface, axis: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Propose a crack's start on a part, along the longest axis.

    The crack is on the largest face along this axis: all normals of this face differ by more than
    45 degrees from the axis. Without a face like this, the largest face is taken. The clamped end
    is the lowest. The crack's height above this end is :data:`CRACK_TO_CLAMP_OVER_PART_LENGTH`,
    0.2, of the part's length.

    Parameters
    ----------
    part_surface : _PartSurface
        Surface of the part.
    axis : int
        Coordinate axis, 0 to 2, with the part's largest length.

    Returns
    -------
    crack_point : (3,) [m]
        Point on the face.
    face_normal : (3,)
        Outward unit normal at the point.
    part_depth : float [m]
        Distance from the point to the opposite side of the part, along the inward normal.
    """
    axis_direction = np.eye(3)[axis]
    bottom_height = part_surface.triangle_corner_points[..., axis].min()
    top_height = part_surface.triangle_corner_points[..., axis].max()
    max_normal_components_along_axis = [
        np.abs(
            part_surface.triangle_normals[part_surface.face_numbers == face_number][:, axis]
        ).max()
        for face_number in part_surface.face_numbers_largest_first
    ]
    face_index = int((np.array(max_normal_components_along_axis) < 0.7).argmax())
    is_on_face = part_surface.face_numbers == part_surface.face_numbers_largest_first[face_index]
    target_point = part_surface.face_center_points[face_index] * (1.0 - axis_direction)
    target_point[axis] = bottom_height + CRACK_TO_CLAMP_OVER_PART_LENGTH * (
        top_height - bottom_height
    )
    triangle_index = np.linalg.norm(
        part_surface.triangle_centers[is_on_face] - target_point, axis=1
    ).argmin()
    crack_point = part_surface.triangle_centers[is_on_face][triangle_index]
    face_normal = part_surface.triangle_normals[is_on_face][triangle_index]
    return (
        crack_point,
        face_normal,
        find_ray_hit_distance(crack_point, -face_normal, part_surface.triangle_corner_points),
    )


def propose_scene_and_draw_faces(part_path: Path, scene_path: Path) -> tuple[str, Path]:
    """Write a scene's text for a CAD part, and draw the part's numbered faces.

    The text proposes clamp, load and crack.

    Returns
    -------
    scene_text : str
        TOML text for ``scene_path``, not written yet.
    picture_path : Path
        Picture of the faces, beside the scene.

    Raises
    ------
    InputError
        The file of the part cannot be used.
    """
    length_unit = "mm" if part_path.suffix.lower() == ".brep" else None
    part_surface = _read_part_surface(part_path, length_unit)
    part_extents = np.ptp(part_surface.triangle_corner_points.reshape(-1, 3), axis=0)
    longest_axis = int(part_extents.argmax())
    clamp_point, tip_point = (
        part_surface.face_center_points[
            part_surface.find_end_face_index(longest_axis, at_top=is_top_end)
        ]
        for is_top_end in (False, True)
    )
    crack_point, face_normal, part_depth = _propose_crack(part_surface, longest_axis)
    listed_face_numbers = part_surface.face_numbers_largest_first[:MAX_LISTED_FACES]
    picture_path = scene_path.with_name(f"{scene_path.stem}_faces.png")
    draw_numbered_faces(
        part_surface.triangle_corner_points,
        part_surface.face_numbers,
        listed_face_numbers,
        part_surface.face_center_points,
        path=picture_path,
    )
    face_toml_lines = [
        f"clamp = [{_format_vector_as_toml(clamp_point)}]",
        f"tip = [{_format_vector_as_toml(tip_point)}]",
    ]
    for face_rank, (face_number, face_point) in enumerate(
        zip(listed_face_numbers, part_surface.face_center_points, strict=False), 1
    ):
        area_mm2 = 1e6 * part_surface.face_area(face_number)
        face_toml_lines.append(
            f"# face_{face_rank} = [{_format_vector_as_toml(face_point)}]  # {area_mm2:.4g} mm^2"
        )
    text_by_placeholder = {
        "EXTENTS": " x ".join(
            f"{part_extent_along_axis:.4g}" for part_extent_along_axis in part_extents
        ),
        "UNIT": f'unit = "{length_unit}"' if length_unit else "",
        "PART": json.dumps(os.path.relpath(part_path, scene_path.parent)),
        "PICTURE": picture_path.name,
        "FACES": "\n".join(face_toml_lines),
        "POINT": _format_vector_as_toml(crack_point),
        "NORMAL": _format_vector_as_toml(np.eye(3)[longest_axis]),
        "DIRECTION": _format_vector_as_toml(np.cross(np.eye(3)[longest_axis], face_normal)),
        "LOAD": _format_vector_as_toml(tip_point),
        "RADII": _format_vector_as_toml([0.5 * part_depth, 0.3 * part_depth]),
        "FORCE": _format_vector_as_toml(np.eye(3)[np.abs(face_normal).argmax()]),
        "SIZE": f"{min(part_depth, part_extents[longest_axis] / 15.0):.2g}",
        "SCENE": shlex.quote(scene_path.name),
    }
    scene_text = read_packaged_text("cli/new_part.toml")
    for template_placeholder, placeholder_replacement_text in text_by_placeholder.items():
        scene_text = scene_text.replace(template_placeholder, placeholder_replacement_text)
    return scene_text, picture_path


def _format_vector_as_toml(components: np.ndarray | list[float]) -> str:
    """Return a vector as a TOML list: "[0.1, 0.0, 0.02]", six digits for each component."""
    return json.dumps([float(f"{round(component, 9):.6g}") + 0.0 for component in components])
