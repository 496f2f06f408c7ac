"""Coarser and finer meshes of a scene.

Elements of the coarser mesh are about twice as long; if the mesh is a file, the coarser mesh is the
file ``mesh.coarser``. The ratio of element lengths follows from the numbers of elements; for a
solid with cracks or a disk's sector that is meshed here, from both values of ``mesh.size``.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import prefix_stages
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.key_figures import mesh_extents
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.study.sharing import make_empty_coarser_structure_list


def prepare_coarser_study_or_reason(study: Study) -> tuple[Study, tuple[int, int], float] | str:
    """Prepare a study on a coarser mesh, or return the reason for none (collective).

    If ``study`` is reduced, the coarser study is reduced, too.

    Returns
    -------
    coarser_study : Study
        Study with the coarser mesh.
    element_counts : (int, int)
        Numbers of elements of the study and of the coarser study.
    length_ratio : float
        Element length of the coarser mesh over that of the study's mesh.

    Without a usable coarser mesh, a text with the reason is returned instead.
    """
    fine_structure, coarser_scene = study.structure, make_coarser_scene_or_reason(study.scene)
    if isinstance(coarser_scene, str):
        return coarser_scene
    scene = study.scene
    with prefix_stages("a coarser mesh"):
        is_unreduced = fine_structure.whole is fine_structure
        coarser_shared_structures = fine_structure.whole.compute_once(
            make_empty_coarser_structure_list, from_matrices=True
        )
        coarser_study = prepare(
            coarser_scene,
            fine_structure.comm,
            whole=is_unreduced,
            judged=False,
            last=coarser_shared_structures,
        )
    fine_and_coarser_element_counts = (
        count_elements(fine_structure),
        count_elements(coarser_study.structure),
    )
    if not fine_and_coarser_element_counts[1] < fine_and_coarser_element_counts[0]:
        return "a coarser mesh has as many elements: refine the mesh"
    fine_mesh_extents, coarser_mesh_extents = (
        np.array(mesh_extents(fine_or_coarser_structure.whole))
        for fine_or_coarser_structure in (fine_structure, coarser_study.structure)
    )
    coarser_element_length = (coarser_mesh_extents.prod() / fine_and_coarser_element_counts[1]) ** (
        1.0 / len(coarser_mesh_extents)
    )
    # Curved sides differ by less than an element.
    if np.any(np.abs(coarser_mesh_extents - fine_mesh_extents) > coarser_element_length):
        extents_text = " x ".join(
            f"{coarser_mesh_extent:.4g}" for coarser_mesh_extent in coarser_mesh_extents
        )
        return f"mesh.coarser is the mesh of another part, which measures {extents_text} m"
    if scene.mesh.layout == "file" and (
        mismatch_text := _describe_crack_mismatch(fine_structure, coarser_study.structure)
    ):
        return mismatch_text
    return (
        coarser_study,
        fine_and_coarser_element_counts,
        _coarser_over_fine_element_length(scene, coarser_scene, fine_and_coarser_element_counts),
    )


def make_coarser_scene_or_reason(scene: Scene) -> Scene | str:
    """Return a scene with a coarser mesh, or the reason for none.

    Elements are about twice as long; for a mesh file the coarser mesh is the file ``mesh.coarser``.
    """
    if scene.structure is not None:
        return "matrices have no coarser mesh"
    if not scene.mesh.error:
        return "mesh.error = false"
    if 1 in (scene.mesh.lip_elements, scene.mesh.patches):
        return (
            "one element or patch along the crack is too few: "
            "raise mesh.lip_elements or mesh.patches"
        )
    if scene.mesh.layout == "file":
        if scene.mesh.coarser is None:
            return "mesh.coarser, the file of a coarser mesh, is not given"
        key_changes: dict[str, Any] = {"mesh.file": scene.mesh.coarser, "mesh.coarser": None}
        return scene.replace(key_changes | _patch_key_changes(scene, 0.5))
    with suppress(InputError):  # the grid's lines miss the crack
        if (coarser_scene := refine_scene_or_none(scene, 0.5)) is not None:
            return coarser_scene
    return (
        "a grid of half as many mesh.columns and mesh.rows has no line along the crack; double both"
    )


def _coarser_over_fine_element_length(
    scene: Scene, coarser_scene: Scene, element_counts: tuple[int, int]
) -> float:
    """Return the ratio of element lengths: coarser mesh over a scene's mesh.

    If a solid with cracks, or a disk's sector, is meshed here, it is the ratio of both values of
    ``mesh.size``. This ratio holds at crack fronts, tips and corners, where the error is largest.
    A ``mesh.size`` above a solid's shortest side is not used, since such elements do not fit.
    In all other cases the ratio follows from the numbers of elements.

    Parameters
    ----------
    scene, coarser_scene : Scene
        Scene, and the same scene with a coarser mesh.
    element_counts : (int, int)
        Numbers of elements of both meshes.
    """
    element_size, is_plane = scene.mesh.size, scene.dimension == 2
    if (
        scene.has_graded_lengths
        and element_size is not None
        and (scene.crack_by_name or is_plane)
        and (is_plane or element_size <= min(scene.geometry.sides, default=math.inf))
    ):
        return coarser_scene.mesh.given("size") / element_size
    return float((element_counts[0] / element_counts[1]) ** (1.0 / scene.dimension))


def _describe_crack_mismatch(structure: Structure, coarser_structure: Structure) -> str:
    """Describe how cracks in the file ``mesh.coarser`` differ from those in the mesh.

    Such a mesh cannot be used to estimate the mesh error. Area and centroid of the crack faces may
    differ by about one element of the coarser mesh. If all cracks agree, return "".
    """
    areas_and_points_of_cracks = _pair_areas_and_points_of_cracks(structure)
    coarser_areas_and_points = _pair_areas_and_points_of_cracks(coarser_structure)
    if len(areas_and_points_of_cracks) != len(coarser_areas_and_points):
        crack_counts_text = (
            f"{len(coarser_areas_and_points)} instead of {len(areas_and_points_of_cracks)}"
        )
        return f"mesh.coarser has another number of cracks: {crack_counts_text}"
    for crack_number, (
        (pair_areas, pair_points),
        (coarser_pair_areas, coarser_pair_points),
    ) in enumerate(zip(areas_and_points_of_cracks, coarser_areas_and_points, strict=True), 1):
        crack_area, coarser_crack_area = pair_areas.sum(), coarser_pair_areas.sum()
        centroid_shift = (
            pair_areas @ pair_points / crack_area
            - coarser_pair_areas @ coarser_pair_points / coarser_crack_area
        )
        centroid_distance = float(np.linalg.norm(centroid_shift))
        # Elements at the front have no pairs.
        relative_tolerance = len(coarser_pair_areas) ** (-1.0 / (pair_points.shape[1] - 1))
        crack_size = np.linalg.norm(np.ptp(pair_points, axis=0))
        if (
            abs(coarser_crack_area - crack_area) > relative_tolerance * crack_area
            or centroid_distance > relative_tolerance * crack_size
        ):
            area_text = (
                f"crack faces of {coarser_crack_area:.3g} m^2 instead of {crack_area:.3g} m^2"
            )
            crack_text = f"mesh.coarser has another shape of crack {crack_number}"
            return f"{crack_text}: {area_text}, centroid {centroid_distance:.2g} m away"
    return ""


def _pair_areas_and_points_of_cracks(structure: Structure) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return areas and positions of each crack's contact pairs.

    Returns
    -------
    list of (areas, positions)
        For each crack with n pairs: areas (n,) [m^2] and positions (n, d) [m]. The list is empty if
        areas or positions are unknown.
    """
    pairs = structure.whole.pairs
    if pairs.cracks is None or pairs.areas is None or pairs.points is None:
        return []
    pair_masks = (pairs.cracks == crack_index for crack_index in np.unique(pairs.cracks))
    return [(pairs.areas[pair_mask], pairs.points[pair_mask]) for pair_mask in pair_masks]


def refine_scene_or_none(scene: Scene, refinement_factor: float) -> Scene | None:
    """Return a scene with a finer or coarser mesh, or None.

    None is returned for mesh files. It is also returned if a grid with an odd number of columns or
    rows would have to become coarser.

    - The number of elements along crack faces is rounded up. ``mesh.size`` and ``mesh.patches``
      change by the resulting factor, so that the mesh stays similar.
    - In a solid or a disk's sector with three or more elements along a face, the grading changes,
      too (:func:`_refine_graded_elements`).
    - For a finer mesh of a solid or sector, a ``mesh.size`` above the shortest side is first
      replaced by this side.
    - A grid becomes finer by ``refinement_factor``, rounded up to a whole number, so that cracks
      stay on grid lines. It becomes coarser by 2.

    Parameters
    ----------
    scene : Scene
        Scene with a mesh.
    refinement_factor : float
        Divides the element lengths; below 1 the mesh becomes coarser.
    """
    mesh_table = scene.mesh
    if mesh_table is None or mesh_table.layout == "file":
        return None
    key_changes: dict[str, Any] = {}
    n_elements_along_face, element_size = mesh_table.lip_elements, mesh_table.size
    if scene.has_graded_lengths and element_size is not None and refinement_factor > 1.0:
        element_size = min([element_size, *scene.geometry.sides])
    if scene.has_graded_lengths and n_elements_along_face is not None and n_elements_along_face > 2:
        n_new_elements_along_face, grading, refinement_factor = _refine_graded_elements(
            n_elements_along_face, mesh_table.grading, refinement_factor
        )
        key_changes |= {"mesh.lip_elements": n_new_elements_along_face, "mesh.grading": grading}
    elif n_elements_along_face is not None:
        n_new_elements_along_face = key_changes["mesh.lip_elements"] = math.ceil(
            refinement_factor * n_elements_along_face
        )
        refinement_factor = (
            refinement_factor
            if n_new_elements_along_face == n_elements_along_face
            else n_new_elements_along_face / n_elements_along_face
        )
    if element_size is not None:
        key_changes["mesh.size"] = element_size / refinement_factor
    for key in ("columns", "rows"):
        n_old_columns_or_rows = getattr(mesh_table, key)
        if n_old_columns_or_rows is not None:
            key_changes[f"mesh.{key}"] = (
                math.ceil(refinement_factor) * n_old_columns_or_rows
                if refinement_factor > 1.0
                else n_old_columns_or_rows // 2
            )
            if refinement_factor < 1.0 and n_old_columns_or_rows % 2:
                return None
    return scene.replace(key_changes | _patch_key_changes(scene, refinement_factor))


def _patch_key_changes(scene: Scene, refinement_factor: float) -> dict[str, int]:
    """Return the changed number of contact patches, for ``Scene.replace``.

    Lengths of patches are divided by ``refinement_factor``, as the lengths of elements. So the mesh
    error includes the error due to patches.

    Returns
    -------
    dict of str to int
        ``{"mesh.patches": n}`` with the new number n; empty if the scene has no patches.
    """
    n_old_patches = scene.mesh.patches
    return (
        {"mesh.patches": max(1, round(n_old_patches * refinement_factor ** (scene.dimension - 1)))}
        if n_old_patches
        else {}
    )


def _refine_graded_elements(
    n_elements: int, grading: float, refinement_factor: float
) -> tuple[int, float, float]:
    """Refine graded elements along a solid's crack face to a similar mesh.

    Element k = 0 to n - 1 from the front has the length h_0 r^k. The grading is r^(n - 1). The
    element at the distance d from the front is h_0 + (r - 1) d long. The mesh stays similar if r^n,
    and so h_0 / (r - 1), stays the same.

    Parameters
    ----------
    n_elements : int
        Number n of elements along the face.
    grading : float
        Length of the longest over the shortest element.
    refinement_factor : float
        Requested ratio of old to new element lengths.

    Returns
    -------
    n_new_elements : int
        Number of elements after refinement.
    grading : float
        Length of the longest over the shortest element after refinement.
    refinement_factor : float
        Actual ratio of old to new element lengths, which differs since n is whole.
    """
    # log r^n; equal elements count as hardly graded, since r must exceed 1
    log_growth = math.log(grading) * n_elements / (n_elements - 1) or 1e-9
    growth_rate = math.expm1(log_growth / n_elements)
    n_new_elements = round(log_growth / math.log1p(growth_rate / refinement_factor))
    return (
        n_new_elements,
        math.exp(log_growth * (n_new_elements - 1) / n_new_elements),
        growth_rate / math.expm1(log_growth / n_new_elements),
    )


def count_elements(structure: Structure) -> int:
    """Return the number of elements in a structure's mesh; 1 for given matrices (collective)."""
    whole_structure = structure.whole
    return max(
        1,
        0
        if whole_structure.nodes is None
        else whole_structure.comm.allreduce(len(whole_structure.nodes.cells)),
    )


def has_similar_finer_mesh(scene: Scene) -> bool:
    """Return True if a similar mesh 1.5 times finer exists.

    False for mesh layouts other than "graded", and if rounding multiplies the number of elements
    along a crack face by more than 1.56.
    """
    if scene.mesh.layout != "graded":
        return False
    finer_scene, n_elements_along_face = refine_scene_or_none(scene, 1.5), scene.mesh.lip_elements
    return (
        finer_scene is None
        or n_elements_along_face is None
        or finer_scene.mesh.given("lip_elements") <= 1.56 * n_elements_along_face
    )
