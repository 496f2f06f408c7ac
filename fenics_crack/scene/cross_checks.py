"""Checks of a scene's tables against each other."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import Any

from fenics_crack.basics.errors import InputError
from fenics_crack.scene import tables as kinds
from fenics_crack.scene.fields import describe_components, use_table_name_in_errors
from fenics_crack.scene.keys import (
    LIST_TABLE_NAMES,
    OPTIONAL_TABLE_NAMES,
    TABLE_CLASS_BY_NAME,
    SceneTables,
    describe_table_type,
    missing_table_error,
)

PLATE_TABLE_NAMES = (
    "geometry", "material", "mesh", "crack", "cracks", "loads", "base", "rotation", "disk",
)  # fmt: skip
"""Tables for a plate or solid; forbidden with [structure], whose matrices replace them."""
MAX_ALLOWED_SIDE_RATIO = 1e4
"""Maximum ratio of width or thickness to the height, or of the height to either side."""


def check_tables(scene: SceneTables) -> None:
    """Check a scene's tables against each other, and set inferred values.

    Changes the scene in place. Raises InputError for contradicting tables or keys.
    """
    for table_name, table_class in TABLE_CLASS_BY_NAME.items():
        table = getattr(scene, table_name)
        if table_name in LIST_TABLE_NAMES:
            has_right_type = isinstance(table, tuple) and all(
                isinstance(list_element, table_class) for list_element in table
            )
        else:
            may_be_missing = table is None and (
                table_name in OPTIONAL_TABLE_NAMES or _is_replaced_by_matrices(scene, table_name)
            )
            has_right_type = isinstance(table, table_class) or may_be_missing
        if not has_right_type:
            if table is None:
                raise missing_table_error(table_name)
            raise InputError(table_name, table, describe_table_type(table_name, table))
    if scene.rotation is not None:
        scene.rotation.check_axis_position(scene.disk)
    if scene.excitation.order is not None and (scene.disk is None or scene.speed > 0.0):
        requirement_text = "left out without a rotation.speed > 0"
        scene.excitation.require(scene.speed > 0.0, "order", requirement_text)
        object.__setattr__(scene, "excitation", scene.excitation.at_speed(scene.speed))
    harmonic_balance = scene.harmonic_balance.with_load_harmonics(scene.highest_order)
    object.__setattr__(scene, "harmonic_balance", harmonic_balance)
    contact_has_friction = scene.contact is not None and bool(scene.contact.friction)
    harmonic_balance.require(
        harmonic_balance.form == "condensed" or not contact_has_friction,
        "form",
        "'condensed' with contact.friction",
    )
    if scene.curve is not None and scene.curve.parameter_and_range[0] == "speed":
        requirement_text = (
            "used with excitation.order, by which the load's frequency follows the speed"
        )
        scene.curve.require(scene.excitation.order is not None, "parameter", requirement_text)
    if scene.curve is not None and scene.curve.parameter_and_range[0] == "load":
        requirement_text = (
            "another parameter with a rotation.speed > 0, as the mean load is partly "
            "centrifugal; or add curve.at = 'resonance', which keeps the mean load"
        )
        scene.curve.require(scene.speed == 0.0, "parameter", requirement_text)
    if scene.integration is not None and scene.rotation is not None:
        circumstance = "[rotation]: the mean load is partly centrifugal"
        scene.integration.forbid_keys(("deflection", "free"), circumstance)
    if scene.structure is not None:
        _check_tables_beside_matrices(scene, scene.structure)
    else:
        _check_dimension(scene)
        if scene.geometry.file is not None:
            _check_cad_part(scene)
        else:
            (_forbid_keys_of_mesh_file if scene.mesh.layout == "file" else _check_plate)(scene)
        if scene.disk is not None:
            _check_disk(scene, scene.disk)


def _is_replaced_by_matrices(scene: SceneTables, table_name: str) -> bool:
    """Return True if [structure] replaces a table, which may then be None.

    ``structure.damping`` replaces the table [damping].
    """
    if scene.structure is None:
        return False
    return table_name in PLATE_TABLE_NAMES or (
        table_name == "damping" and scene.structure.damping is not None
    )


def _check_tables_beside_matrices(scene: SceneTables, structure: kinds.Structure) -> None:
    """Check a scene's tables against the matrices in [structure].

    Vectors get the scene's dimension. Raises InputError for tables of a plate, for a missing load
    or contact table, and for keys that need contact pairs or a model.
    """
    _forbid_tables(scene, PLATE_TABLE_NAMES, "[structure]")
    if structure.damping is not None:
        _forbid_tables(scene, ("damping",), "structure.damping")
    if structure.model is None:
        force_key = scene.excitation.first_force_key
        requirement_text = (
            "left out with [structure] without structure.model: give the load by "
            "structure.force_sin, structure.force_cos or structure.force_mean"
        )
        has_no_force = not force_key and scene.excitation.point is None
        scene.excitation.require(has_no_force, force_key or "point", requirement_text)
        matrix_paths = structure.mass, structure.stiffness, structure.damping or ""
        if not any(
            Path(matrix_path).suffix.lower() in (".sti", ".mas") for matrix_path in matrix_paths
        ):
            structure.forbid_keys(
                ("dofs",), "without structure.model or CalculiX files (.sti, .mas)"
            )
    if structure.gap is None and (structure.model is None or scene.contact is None):
        pair_keys = ("clearance", "areas", "tangential")
        structure.forbid_keys(
            pair_keys, "without contact pairs: give structure.gap, or structure.model and [contact]"
        )
    _set_vector_dimension(scene)
    if scene.excitation.point is None:
        force_paths = (structure.force_sin, structure.force_cos, structure.force_mean)
        requirement_text = (
            "given: the point of the force [m]; or a load by structure.force_sin, "
            "structure.force_cos or structure.force_mean"
        )
        scene.excitation.require(
            any(force_paths) and not scene.excitation.first_force_key, "point", requirement_text
        )
    if structure.gap is not None and scene.contact is None:
        raise missing_table_error("contact", ", as structure.gap is given")
    if scene.contact is not None:
        requirement_text = "'all' with [structure]"
        scene.contact.require(scene.contact.pairs == "all", "pairs", requirement_text)
        if structure.areas is None and (structure.model is None or structure.gap is not None):
            scene.contact.forbid_keys(
                ("stiffness_per_area",), "without structure.areas: give contact.stiffness"
            )
        if structure.model is None and structure.gap is None:
            requirement_text = (
                "left out without contact pairs: give structure.gap or structure.model"
            )
            raise InputError("contact", "a table", requirement_text)


def _forbid_tables(scene: SceneTables, table_names: Iterable[str], circumstance: str) -> None:
    """Raise InputError for the first named table that the scene has.

    ``circumstance`` follows "left out with" in the error.
    """
    for table_name in table_names:
        if getattr(scene, table_name):
            requirement_text = f"left out with {circumstance}: remove the table [{table_name}]"
            raise InputError(table_name, "a table", requirement_text)


def _set_vector_dimension(scene: SceneTables) -> None:
    """Give zero vectors in all tables the scene's dimension.

    Changes the scene in place. Raises InputError if a nonzero vector or an output point has another
    number of components.
    """
    dimension = scene.dimension
    for table_name in TABLE_CLASS_BY_NAME:
        tables = getattr(scene, table_name)
        if table_name in LIST_TABLE_NAMES:
            converted_tables: Any = []
            for list_position, table in enumerate(tables, 1):
                with use_table_name_in_errors(f"{table_name}.{list_position}"):
                    converted_tables.append(table.with_dimension(dimension))
            object.__setattr__(scene, table_name, tuple(converted_tables))
        elif tables is not None:
            object.__setattr__(scene, table_name, tables.with_dimension(dimension))
    for point in scene.output_points:
        if len(point.values) != dimension:
            raise InputError(
                f"output.points.{point.key}", point.values, describe_components("", dimension)
            )


def _check_dimension(scene: SceneTables) -> None:
    """Check keys that depend on plate or solid, and set vector lengths.

    Raises InputError for keys that a plate, or a solid, cannot have, and for wrong vectors.
    """
    geometry, dimension = scene.geometry, scene.dimension
    if dimension == 2 and scene.rotation is not None:
        scene.rotation.forbid_keys(
            ("axis", "center"), "geometry.kind = 'plate': its rotor axis is parallel to x"
        )
    for crack_name, crack in scene.crack_by_name.items() if dimension == 2 else ():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(kinds.PLANE_CRACK_KEYS, "geometry.kind = 'plate'")
    _set_vector_dimension(scene)
    mesh = scene.mesh
    if scene.contact is not None and scene.contact.pairs == "mouth":
        mesh.forbid_keys(("patches",), "contact.pairs = 'mouth', which keeps a single pair")
    if dimension == 3:
        requirement_text = (
            "2 with geometry.kind = 'solid': tetrahedra of order 1 are much too stiff"
        )
        mesh.require(mesh.order == 2, "order", requirement_text)
        requirement_text = "'graded' or 'file' with geometry.kind = 'solid'"
        mesh.require(mesh.layout != "grid", "layout", requirement_text)
        mesh.forbid_keys(("cells",), "geometry.kind = 'solid', which is meshed by tetrahedra")
        if scene.contact is not None and scene.contact.friction and scene.disk is not None:
            requirement_text = (
                "0, or left out, with [disk] and geometry.kind = 'solid', for which"
                " friction is not implemented"
            )
            scene.contact.require(False, "friction", requirement_text)
    if geometry.file is None:
        mesh.forbid_keys(("per_turn",), "without geometry.file: only such parts have curved faces")
    if dimension == 2 or (mesh.layout != "file" and geometry.file is None):
        geometry.given("thickness")


def _check_disk(scene: SceneTables, disk: kinds.Disk) -> None:
    """Raise InputError if a scene does not fit a bladed disk.

    Checked are excluded tables and keys, the load's engine order and frequency, and the rim's
    radii: blades must not overlap.
    """
    _forbid_tables(scene, ("base", "growth", "identify", "reduction"), "[disk]")
    scene.excitation.given(
        "order", "given: the engine order of the load on [disk], a whole number >= 1"
    )
    if scene.speed == 0.0:
        requirement_text = (
            "given: a finite number > 0 [rad/s], or excitation.frequency [Hz], as [disk] is at rest"
        )
        scene.excitation.given("omega", requirement_text)
    if scene.curve is not None:
        requirement_text = "another parameter with [disk], for example 'omega' or 'frequency'"
        scene.curve.require(
            scene.curve.parameter_and_range[0] != "speed", "parameter", requirement_text
        )
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(("first_omega", "first_frequency"), "[disk]: give crack.length")
    radius_keys = ("inner_radius", "outer_radius")
    if scene.mesh.layout == "file":
        disk.forbid_keys(radius_keys, "mesh.layout = 'file'")
        return
    disk.forbid_keys(("center", "axis"), "without mesh.layout = 'file'")
    inner_radius, outer_radius = (disk.given(radius_key) for radius_key in radius_keys)
    disk.require(
        inner_radius < outer_radius,
        "inner_radius",
        f"less than disk.outer_radius = {outer_radius:g} m",
    )
    blade_width = scene.geometry.circumferential_width
    foot_spacing = 2.0 * outer_radius * math.sin(math.pi / disk.sectors)
    requirement_text = (
        f"larger, as blades {blade_width:g} m wide would overlap: "
        f"their roots are {foot_spacing:g} m apart"
    )
    disk.require(
        blade_width < foot_spacing * (1.0 - MIN_ALLOWED_RELATIVE_DISTANCE),
        "outer_radius",
        requirement_text,
    )
    foot_depth = outer_radius - math.sqrt(outer_radius**2 - 0.25 * blade_width**2)
    requirement_text = f"less than {outer_radius - foot_depth:g} m, where the blade meets the rim"
    disk.require(inner_radius < outer_radius - foot_depth, "inner_radius", requirement_text)


def _check_plate(scene: SceneTables) -> None:
    """Raise InputError if sides, load points or cracks of a plate or box are wrong."""
    geometry = scene.geometry
    _, height = (geometry.given(side_key) for side_key in ("width", "height"))
    for side_key in ("width", "thickness")[: scene.dimension - 1]:
        is_similar_size = (
            height / MAX_ALLOWED_SIDE_RATIO
            <= getattr(geometry, side_key)
            <= height * MAX_ALLOWED_SIDE_RATIO
        )
        requirement_text = (
            f"within a factor {MAX_ALLOWED_SIDE_RATIO:g} of geometry.height = {height:g} m"
        )
        geometry.require(is_similar_size, side_key, requirement_text)
    if not scene.has_other_loads:
        scene.excitation.given(
            "point", "given: the point of the force, [x, y], or [x, y, z] in a solid [m]"
        )
    if scene.excitation.point is None and (force_key := scene.excitation.first_force_key):
        scene.excitation.require(False, force_key, "left out without excitation.point")
    load_by_name = {f"loads.{load_number}": load for load_number, load in enumerate(scene.loads, 1)}
    for load_name, load in ({"excitation": scene.excitation} | load_by_name).items():
        sides = geometry.sides
        within_side_flags = [
            0.0 <= coordinate <= side
            for coordinate, side in zip(load.point or (), sides, strict=False)
        ]
        with use_table_name_in_errors(load_name):
            ranges_text = ", ".join(
                f"{axis_letter} from 0 to {side:g} m"
                for axis_letter, side in zip("xyz", sides, strict=False)
            )
            load.require(all(within_side_flags), "point", f"on the {geometry.kind}: {ranges_text}")
    if scene.crack_by_name:
        _check_cracks(scene)
        if scene.contact is None:
            raise missing_table_error("contact", ", as there is a crack")


def _check_cad_part(scene: SceneTables) -> None:
    """Raise InputError if tables do not fit a part from a CAD file.

    Required are a graded mesh without [disk], a load, and for each crack its plane.
    """
    scene.mesh.require(scene.mesh.layout == "graded", "layout", "'graded' with geometry.file")
    _forbid_tables(scene, ("disk",), "geometry.file")
    if not scene.has_other_loads:
        scene.excitation.given(
            "point", "given: the point of the force, [x, y, z], on the part or near it [m]"
        )
    if scene.crack_by_name:
        scene.mesh.given("lip_elements", LIP_ELEMENTS_TEXT)
        if scene.contact is None:
            raise missing_table_error("contact", ", as there is a crack")
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.given("point", "given: a point [x, y, z] of the crack [m], with geometry.file")
            crack.check_plane_keys()


def _forbid_keys_of_mesh_file(scene: SceneTables) -> None:
    """Raise InputError for sides and crack shapes, which the mesh file defines."""
    keys_in_file = ("width", "height", "thickness")[: scene.dimension]
    scene.geometry.forbid_keys(keys_in_file, "mesh.layout = 'file'")
    for crack_name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            crack.forbid_keys(_CRACK_SHAPE_KEYS, "mesh.layout = 'file'")


LIP_ELEMENTS_TEXT = "given: a whole number >= 1, the elements along each crack face"
"""Error text for a missing ``mesh.lip_elements``."""


MIN_ALLOWED_RELATIVE_DISTANCE = 1e-4
"""Minimum distance between cracks, tips and edges, relative to the side along the distance."""


_CRACK_SHAPE_KEYS = (*kinds.BOX_CRACK_KEYS, "length", "depth", "front", *kinds.PLANE_CRACK_KEYS)
"""Keys for a crack's position and shape; forbidden with a mesh file, which has the cracks."""


def _check_cracks(scene: SceneTables) -> None:
    """Raise InputError if a crack of a plate or box has wrong keys.

    Checked are position, length, depth and the distances to edges and other cracks. Cracks around
    ``crack.point`` are only checked for consistent keys.
    """
    crack_by_name, geometry, mesh = scene.crack_by_name, scene.geometry, scene.mesh
    for crack_name, crack in crack_by_name.items():
        with use_table_name_in_errors(crack_name):
            if crack.point is not None:
                crack.check_plane_keys()
                continue
            crack.forbid_keys(kinds.PLANE_CRACK_KEYS, "without crack.point")
            crack.require(
                crack.front != "through", "front", "'straight' or 'elliptical' without crack.point"
            )
            _check_crack(crack, geometry, list(crack_by_name))
            _check_crack_front(crack, geometry)
            if mesh.layout == "grid":
                _check_crack_on_grid(crack, geometry, mesh)
    if mesh.layout == "graded":
        mesh.given("lip_elements", LIP_ELEMENTS_TEXT)
    for first_name, second_name in combinations(
        [crack_name for crack_name, crack in crack_by_name.items() if crack.point is None], 2
    ):
        _check_crack_distance(scene, first_name, second_name)


def _check_crack(crack: kinds.Crack, geometry: kinds.Geometry, crack_names: list[str]) -> None:
    """Raise InputError if a crack's keys contradict, or the crack leaves the plate.

    ``crack_names`` are the names of all cracks: only a single crack may have ``first_omega``.
    """
    width, height, *_ = geometry.sides
    geometry_kind = geometry.kind
    margin_text = f"and at least {MIN_ALLOWED_RELATIVE_DISTANCE:g} of this length from both"
    is_internal_crack = crack.center is not None
    if is_internal_crack:
        crack.forbid_keys(("edge",), "crack.center")
    else:
        crack.given(
            "edge", f"given: 'left' or 'right'; or center, for a crack inside the {geometry_kind}"
        )
    requirement_text = (
        f"inside the {geometry_kind}: between 0 and geometry.height = {height:g} m, {margin_text}"
    )
    crack.require(_is_inside_with_margin(crack.height or 0.0, height), "height", requirement_text)
    if len(crack_names) > 1:
        circumstance = "several cracks: it sets the length of a single crack"
        crack.forbid_keys(("first_frequency", "first_omega"), circumstance)
    requirement_text = (
        "given: a finite number > 0 [m]; or crack.first_omega or crack.first_frequency"
        if crack.length is None
        else "left out with crack.first_omega or crack.first_frequency: give one of them"
    )
    crack.require((crack.length is None) != (crack.first_omega is None), "length", requirement_text)
    requirement_text = (
        f"shorter than the {geometry_kind}: between 0 and geometry.width = {width:g} m, "
        f"{margin_text}"
    )
    crack.require(
        crack.length is None or _is_inside_with_margin(crack.length, width),
        "length",
        requirement_text,
    )
    if is_internal_crack:
        tip_positions = [crack.center] if crack.length is None else crack.span(width)
        requirement_text = (
            f"such that both tips are inside the {geometry_kind}: "
            f"between 0 and {width:g} m, {margin_text}"
        )
        crack.require(
            all(
                _is_inside_with_margin(tip_position or 0.0, width) for tip_position in tip_positions
            ),
            "center",
            requirement_text,
        )


def _check_crack_front(crack: kinds.Crack, geometry: kinds.Geometry) -> None:
    """Raise InputError if a crack's ``depth`` and ``front`` do not fit the geometry."""
    if geometry.dimension == 2:
        crack.forbid_keys(("depth", "front"), "geometry.kind = 'plate'")
    elif crack.depth is None:
        crack.forbid_keys(("front",), "without crack.depth: the crack goes through the thickness")
    else:
        thickness = geometry.sides[2]
        requirement_text = (
            f"less than geometry.thickness = {thickness:g} m, by at least "
            f"{MIN_ALLOWED_RELATIVE_DISTANCE:g} of it; or left out for a crack through it"
        )
        crack.require(_is_inside_with_margin(crack.depth, thickness), "depth", requirement_text)


def _check_crack_on_grid(crack: kinds.Crack, geometry: kinds.Geometry, mesh: kinds.Mesh) -> None:
    """Raise InputError unless a crack lies on a grid line and ends at grid lines.

    The tolerance is 1e-9 of the side. A crack keeps at least one cell from each end of a side.
    """
    crack.given("length", "given: a finite number > 0 [m]; a grid cannot have crack.first_omega")
    (width, height), n_columns = geometry.sides, mesh.given("columns")
    extent_and_cells_by_key = {"length": (width, n_columns), "height": (height, mesh.given("rows"))}
    for extent_key, (extent, n_cells) in extent_and_cells_by_key.items():
        n_crack_cells = getattr(crack, extent_key) / extent * n_cells
        cell_size_text = f"{extent / n_cells:g} m"
        is_on_grid_line = (
            0 < round(n_crack_cells) < n_cells
            and abs(n_crack_cells - round(n_crack_cells)) < 1e-9 * n_cells
        )
        requirement_text = (
            f"a whole number of grid cells of {cell_size_text}, at least one cell from each end"
        )
        crack.require(is_on_grid_line, extent_key, requirement_text)
    if crack.center is not None:
        tip_column = crack.span(width)[0] / width * n_columns
        requirement_text = (
            f"such that both tips are on grid lines, which are {width / n_columns:g} m apart"
        )
        crack.require(
            abs(tip_column - round(tip_column)) < 1e-9 * n_columns, "center", requirement_text
        )


def _check_crack_distance(scene: SceneTables, first_name: str, second_name: str) -> None:
    """Raise InputError if two cracks are closer than 1e-4 of a side.

    Cracks at the same height need this distance, relative to the width, between their tips; other
    cracks need it in height.
    """
    first_crack, second_crack = (
        scene.crack_by_name[crack_name] for crack_name in (first_name, second_name)
    )
    width, height, *_ = scene.geometry.sides
    height_distance = abs(first_crack.given("height") - second_crack.given("height"))
    if height_distance >= MIN_ALLOWED_RELATIVE_DISTANCE * height:
        return
    has_same_height = height_distance <= 1e-9 * height
    spans = sorted(crack.span(width) for crack in (first_crack, second_crack))
    ligament = spans[1][0] - spans[0][1]
    if not has_same_height or ligament < MIN_ALLOWED_RELATIVE_DISTANCE * width:
        min_distance_text = f"{MIN_ALLOWED_RELATIVE_DISTANCE * height:g} m above or below"
        if has_same_height:
            min_distance_text += (
                f", or with {MIN_ALLOWED_RELATIVE_DISTANCE * width:g} m between the tips"
            )
        requirement_text = (
            f"farther from {first_name}.height = {first_crack.height:g} m, as cracks "
            f"may not touch: at least {min_distance_text}"
        )
        raise InputError(f"{second_name}.height", second_crack.height, requirement_text)


def _is_inside_with_margin(coordinate: float, extent: float) -> bool:
    """Return True if a coordinate is inside the interval from 0 to ``extent``.

    The distance to both ends must be at least 1e-4 of the extent.
    """
    return (
        MIN_ALLOWED_RELATIVE_DISTANCE * extent
        <= coordinate
        <= (1.0 - MIN_ALLOWED_RELATIVE_DISTANCE) * extent
    )
