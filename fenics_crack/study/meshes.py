"""Other meshes of a scene: a coarser one, elements about twice as long or those of mesh.coarser
where the mesh is a file, and finer ones.

The ratio of lengths follows from the numbers of elements; of a solid that is meshed here it is that
at the fronts of its cracks, as no element becomes longer than the solid is thick, and of a disk's
sector that at its crack tips and corners.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.progress import within
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import extents
from fenics_crack.study.prepare import Study, prepare
from fenics_crack.study.sharing import coarser_structure_cache


def coarser(study: Study) -> tuple[Study, tuple[int, int], float] | str:
    """The twin on a coarser mesh, reduced where the study is, the elements of both, and how much
    longer those of the twin are; or why there is none (collective)."""
    structure, coarse = study.structure, coarser_scene(study.scene)
    if isinstance(coarse, str):
        return coarse
    scene = study.scene
    with within("a coarser mesh"):
        whole = structure.whole is structure
        last = structure.whole.compute_once(coarser_structure_cache, from_matrices=True)
        twin = prepare(coarse, structure.comm, whole=whole, judged=False, last=last)
    counts = n_elements(structure), n_elements(twin.structure)
    if not counts[1] < counts[0]:
        return "a coarser one has as many elements"
    own, other = (np.array(extents(one.whole)) for one in (structure, twin.structure))
    side = (other.prod() / counts[1]) ** (1.0 / len(other))
    if np.any(np.abs(other - own) > side):  # curved sides differ by parts of an element
        return f"mesh.coarser is another part, of {' x '.join(f'{size:.4g}' for size in other)} m"
    if scene.mesh.layout == "file" and (why := _other_cracks(structure, twin.structure)):
        return why
    return twin, counts, _ratio(scene, coarse, counts)


def coarser_scene(scene: Scene) -> Scene | str:
    """The scene with a coarser mesh, or why there is none."""
    if scene.structure is not None:
        return "matrices have no coarser mesh"
    if not scene.mesh.error:
        return "mesh.error = false"
    if 1 in (scene.mesh.lip_elements, scene.mesh.patches):
        return "one element or patch along the crack is too few to estimate its error"
    if scene.mesh.layout == "file":
        if scene.mesh.coarser is None:
            return "mesh.coarser is not given"
        changes: dict[str, Any] = {"mesh.file": scene.mesh.coarser, "mesh.coarser": None}
        return scene.replace(changes | _patches(scene, 0.5))
    with suppress(InputError):  # its lines miss the crack
        if (made := finer_mesh(scene, 0.5)) is not None:
            return made
    return "a grid of half as many columns and rows has no lines along the crack"


def _ratio(scene: Scene, coarse: Scene, counts: tuple[int, int]) -> float:
    """Return the ratio of the element lengths of a coarser mesh.

    It follows from their numbers, but at the fronts of the cracks of a solid, and at the tips and
    corners of a disk's sector, where they err the most, from the given sizes. Elements longer than
    a solid is thick become no longer across it, and leave more than these say.
    """
    size, plane = scene.mesh.size, scene.dimension == 2
    if scene.has_element_lengths and size is not None and (scene.all_cracks or plane):
        if plane or size <= min(scene.geometry.sides, default=math.inf):
            return coarse.mesh.given("size") / size
    return float((counts[0] / counts[1]) ** (1.0 / scene.dimension))


def _other_cracks(structure: Structure, coarse: Structure) -> str:
    """Describe the cracks of a coarser mesh that are not those of a structure: their faces have
    another area, or another middle, than the elements of the coarser one allow; or ""."""
    own, other = _lips(structure), _lips(coarse)
    if len(own) != len(other):
        return f"mesh.coarser has another number of cracks, {len(other)} instead of {len(own)}"
    for number, ((areas, points), (its, at)) in enumerate(zip(own, other, strict=True), 1):
        area, there = areas.sum(), its.sum()
        away = float(np.linalg.norm(areas @ points / area - its @ at / there))
        part = len(its) ** (-1.0 / (points.shape[1] - 1))  # elements at its front have no pairs
        size = np.linalg.norm(np.ptp(points, axis=0))
        if abs(there - area) > part * area or away > part * size:
            faces = f"crack faces of {there:.3g} m^2 instead of {area:.3g}"
            found = f"mesh.coarser has another crack {number}"
            return f"{found}: {faces}, their middle {away:.2g} m away"
    return ""


def _lips(structure: Structure) -> list[tuple[np.ndarray, np.ndarray]]:
    """Areas [m^2] and places [m] of the pairs of each crack."""
    pairs = structure.whole.pairs
    if pairs.cracks is None or pairs.areas is None or pairs.points is None:
        return []
    each = (pairs.cracks == crack for crack in np.unique(pairs.cracks))
    return [(pairs.areas[its], pairs.points[its]) for its in each]


def finer_mesh(scene: Scene, factor: float) -> Scene | None:
    """A scene whose elements are ``factor`` times as short; None where the scene makes no such
    mesh.

    Elements along crack faces are counted up to the next whole number, and all others and patches
    follow them, so that the mesh stays of one kind; three or more of a solid, or of a disk's
    sector, to that next to the factor (:func:`_similar`). Where these become finer, a size counts
    as the shortest side if it is longer; where they become coarser, it is as it is, for elements of
    a thin solid may be longer. A grid becomes finer by the next whole factor, so that cracks stay
    on its lines; or coarser by 2, where that is possible.
    """
    mesh = scene.mesh
    if mesh is None or mesh.layout == "file":
        return None
    changes: dict[str, Any] = {}
    lips, size = mesh.lip_elements, mesh.size
    if scene.has_element_lengths and size is not None and factor > 1.0:
        size = min([size, *scene.geometry.sides])
    if scene.has_element_lengths and lips is not None and lips > 2:
        count, grading, factor = _similar(lips, mesh.grading, factor)
        changes |= {"mesh.lip_elements": count, "mesh.grading": grading}
    elif lips is not None:
        count = changes["mesh.lip_elements"] = math.ceil(factor * lips)
        factor = factor if count == lips else count / lips
    if size is not None:
        changes["mesh.size"] = size / factor
    for key in ("columns", "rows"):
        count = getattr(mesh, key)
        if count is not None:
            changes[f"mesh.{key}"] = math.ceil(factor) * count if factor > 1.0 else count // 2
            if factor < 1.0 and count % 2:
                return None
    return scene.replace(changes | _patches(scene, factor))


def _patches(scene: Scene, factor: float) -> dict[str, int]:
    """Patches ``factor`` times as short, so that their error is part of the mesh's."""
    count = scene.mesh.patches
    return {"mesh.patches": max(1, round(count * factor ** (scene.dimension - 1)))} if count else {}


def _similar(count: int, grading: float, factor: float) -> tuple[int, float, float]:
    """Elements along a crack face of a solid and their grading so that the mesh is similar and
    about ``factor`` times as fine, and the factor that it is.

    The n elements are h_0 r^k long, r^(n - 1) being the grading, and those beside them
    h_0 + (r - 1) d at a distance d from the front. Where r^n stays, so does h_0 / (r - 1).
    """
    grown = math.log(grading) * count / (count - 1) or 1e-9  # log r^n; next to none: r > 1
    rise = math.expm1(grown / count)
    new = round(grown / math.log1p(rise / factor))
    return new, math.exp(grown * (new - 1) / new), rise / math.expm1(grown / new)


def n_elements(structure: Structure) -> int:
    """Return the number of elements; of matrices 1 (collective)."""
    whole = structure.whole
    return max(1, 0 if whole.nodes is None else whole.comm.allreduce(len(whole.nodes.cells)))


def is_even(scene: Scene) -> bool:
    """Return True if a mesh 1.5 times finer is of the same kind: not where elements along a crack
    face, rounded up, are many more than that."""
    if scene.mesh.layout != "graded":
        return False
    finer, lips = finer_mesh(scene, 1.5), scene.mesh.lip_elements
    return finer is None or lips is None or finer.mesh.given("lip_elements") <= 1.56 * lips
