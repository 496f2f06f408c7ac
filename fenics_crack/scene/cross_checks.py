"""Check a scene's tables against each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.scene import result_tables
from fenics_crack.scene import tables as kinds
from fenics_crack.scene.fields import (
    Rule,
    Table,
    condition_holds,
    describe_components,
    use_table_name_in_errors,
)
from fenics_crack.scene.keys import (
    LIST_TABLE_NAMES,
    OPTIONAL_TABLE_NAMES,
    TABLE_CLASS_BY_NAME,
    SceneTables,
    missing_table_error,
)

EXCLUDED_TABLES_BY_CONDITION: Mapping[str, tuple[str, ...]] = {
    "geometry.file": ("disk",),
    "structure.damping": ("damping",),
    "[disk]": ("base", "growth", "identify", "reduction"),
    "[structure]": (
        "geometry",
        "material",
        "mesh",
        "crack",
        "cracks",
        "loads",
        "base",
        "rotation",
        "disk",
    ),
}
"""Tables that a scene must not have, by the condition that excludes them.

:func:`condition_holds` explains conditions such as "[disk]": the scene has this table.
"""
_CRACK_KEYS_SET_BY_MESH_FILE = (
    *kinds.PLATE_OR_BOX_CRACK_KEYS,
    "length",
    "depth",
    "front",
    *kinds.ARBITRARY_PLANE_CRACK_KEYS,
)
"""Keys for a crack's position and shape; with a mesh file the mesh determines both."""
KEY_RULES_BY_TABLE: Mapping[str, tuple[Rule, ...]] = {
    "geometry": (Rule("mesh.layout = 'file'", ("width", "height")),),
    "mesh": (
        Rule("geometry.file", ("layout",), allowed_choices=("graded",)),
        Rule("contact.pairs = 'mouth'", ("patches",), ", which keeps a single pair"),
        Rule(
            "geometry.kind = 'solid'",
            ("order",),
            ": tetrahedra of order 1 are much too stiff",
            (2,),
        ),
        Rule("geometry.kind = 'solid'", ("layout",), allowed_choices=("graded", "file")),
        Rule("geometry.kind = 'solid'", ("cells",), ", which is meshed by tetrahedra"),
        Rule("without geometry.file", ("per_turn",), ": only such parts have curved faces"),
    ),
    "contact": (Rule("[structure]", ("pairs",), allowed_choices=("all",)),),
    "crack": (
        Rule("geometry.kind = 'plate'", kinds.ARBITRARY_PLANE_CRACK_KEYS),
        Rule("mesh.layout = 'file'", _CRACK_KEYS_SET_BY_MESH_FILE),
        Rule("crack.point", kinds.PLATE_OR_BOX_CRACK_KEYS),
        Rule("crack.center", ("edge",)),
        Rule("[disk]", ("first_omega", "first_frequency"), ": give crack.length"),
    ),
    "rotation": (
        Rule("[disk]", ("hub_radius", "axis", "center"), ", which defines the axis"),
        Rule("geometry.kind = 'plate'", ("axis", "center"), ": its rotor axis is parallel to x"),
    ),
    "disk": (
        Rule("mesh.layout = 'file'", ("inner_radius", "outer_radius")),
        Rule("without mesh.layout = 'file'", ("center", "axis")),
    ),
    "harmonic_balance": (Rule("contact.friction", ("form",), allowed_choices=("condensed",)),),
    "integration": (
        Rule("[rotation]", ("deflection", "free"), ": the mean load is partly centrifugal"),
    ),
    "identify": (Rule("without mesh.layout = 'file'", ("meshes", "uncracked")),),
}
"""Rules for keys by table, with conditions on other tables.

Rules of the table "crack" are checked for each crack; "crack" in a condition is then this crack.
"""
MAX_BOX_SIDE_RATIO = 1e4
"""Maximum ratio of width or thickness to the height, or of the height to either side."""
MIN_RELATIVE_CRACK_DISTANCE = 1e-4
"""Minimum distance between cracks, tips and edges, relative to the side along the distance."""


def check_tables(scene: SceneTables) -> None:
    """Check a scene's tables against each other, and set inferred values.

    Inferred values are, for example, a load frequency from an engine order and a rotor speed. The
    scene is changed in place. Raises InputError for contradicting tables or keys.
    """
    _check_presence_and_types(scene)
    for name, table in scene.table_by_name.items():
        table_name = table.full_key()
        with use_table_name_in_errors(name):
            table.check_rules(
                KEY_RULES_BY_TABLE.get(table_name, ()), vars(scene) | {table_name: table}
            )
    if scene.rotation is not None and scene.disk is None and scene.rotation.center is None:
        scene.rotation.given("hub_radius", "given: a finite number >= 0 [m]")
    if scene.excitation.order is not None and (scene.disk is None or scene.speed > 0.0):
        scene.excitation.require(
            scene.speed > 0.0, "order", "left out without a rotation.speed > 0"
        )
        object.__setattr__(scene, "excitation", scene.excitation.at_speed(scene.speed))
    harmonic_balance = scene.harmonic_balance.with_load_harmonics(scene.highest_load_harmonic)
    object.__setattr__(scene, "harmonic_balance", harmonic_balance)
    if scene.curve is not None:
        _check_curve_parameter(scene, scene.curve)
    if scene.structure is not None:
        _check_tables_beside_matrices(scene, scene.structure)
    _fit_zero_vectors_to_dimension(scene)
    if scene.structure is None:
        _check_body_loads_and_cracks(scene)
    if scene.disk is not None:
        _check_disk(scene, scene.disk)


def _check_presence_and_types(scene: SceneTables) -> None:
    """Raise InputError if a table is missing, must be left out, or has a wrong type.

    A table must be left out if another table of the scene excludes it.
    """
    condition_by_excluded_table = {
        table_name: condition
        for condition, excluded_table_names in EXCLUDED_TABLES_BY_CONDITION.items()
        if condition_holds(condition, vars(scene))
        for table_name in excluded_table_names
    }
    for table_name, table_class in TABLE_CLASS_BY_NAME.items():
        table, condition = getattr(scene, table_name), condition_by_excluded_table.get(table_name)
        if table and condition is not None:
            raise InputError(
                table_name, "a table", f"left out with {condition}: remove the table [{table_name}]"
            )
        if table_name in LIST_TABLE_NAMES:
            has_right_type = isinstance(table, tuple) and all(
                isinstance(list_element, table_class) for list_element in table
            )
        elif table is None:
            has_right_type = table_name in OPTIONAL_TABLE_NAMES or condition is not None
        else:
            has_right_type = isinstance(table, table_class)
        if not has_right_type:
            if table is None:
                raise missing_table_error(table_name)
            type_text = "a tuple of" if table_name in LIST_TABLE_NAMES else "of the class"
            advice_text = "; to read the file of a scene, use Scene.load(path)"
            advice_text *= isinstance(table, str | Path)
            raise InputError(table_name, table, f"{type_text} {table_class.__name__}{advice_text}")


def _check_curve_parameter(scene: SceneTables, curve: result_tables.Curve) -> None:
    """Raise InputError if the parameter of a curve does not suit the scene.

    The parameter "speed" needs an engine order, and no bladed disk. The parameter "load" needs a
    rotor at rest.
    """
    parameter = curve.parameter_and_range[0]
    curve.require(
        parameter != "speed" or scene.excitation.order is not None,
        "parameter",
        "used with excitation.order, by which the load's frequency follows the speed",
    )
    curve.require(
        parameter != "load" or scene.speed == 0.0,
        "parameter",
        "another parameter with a rotation.speed > 0, as the mean load is partly "
        "centrifugal; or add curve.at = 'resonance', which keeps the mean load",
    )
    curve.require(
        parameter != "speed" or scene.disk is None,
        "parameter",
        "another parameter with [disk], for example 'omega' or 'frequency'",
    )


def _check_tables_beside_matrices(scene: SceneTables, structure: kinds.Structure) -> None:
    """Check a scene's load and contact against the matrices in [structure].

    Raises InputError for a missing load or a missing [contact]. A scene without contact pairs, or
    without ``structure.model``, must not have keys that need them.
    """
    excitation, contact = scene.excitation, scene.contact
    force_key = excitation.first_force_key
    if structure.model is None:
        excitation.require(
            not force_key and excitation.point is None,
            force_key or "point",
            "left out with [structure] without structure.model: give the load by "
            "structure.force_sin, structure.force_cos or structure.force_mean",
        )
        matrix_paths = structure.mass, structure.stiffness, structure.damping or ""
        if not any(path.lower().endswith((".sti", ".mas")) for path in matrix_paths):
            structure.forbid_keys(
                ("dofs",), "without structure.model or CalculiX files (.sti, .mas)"
            )
    if structure.gap is None and (structure.model is None or contact is None):
        structure.forbid_keys(
            ("clearance", "areas", "tangential"),
            "without contact pairs: give structure.gap, or structure.model and [contact]",
        )
    has_force_file = any((structure.force_sin, structure.force_cos, structure.force_mean))
    excitation.require(
        excitation.point is not None or (has_force_file and not force_key),
        "point",
        "given: the point of the force [m]; or a load by structure.force_sin, "
        "structure.force_cos or structure.force_mean",
    )
    if contact is None:
        if structure.gap is not None:
            raise missing_table_error("contact", ", as structure.gap is given")
        return
    if structure.areas is None and (structure.model is None or structure.gap is not None):
        contact.forbid_keys(
            ("stiffness_per_area",), "without structure.areas: give contact.stiffness"
        )
    if structure.model is None and structure.gap is None:
        raise InputError(
            "contact",
            "a table",
            "left out without contact pairs: give structure.gap or structure.model",
        )


def _fit_zero_vectors_to_dimension(scene: SceneTables) -> None:
    """Give zero vectors in all tables as many components as the scene has dimensions.

    A plane has 2, space has 3. The scene is changed in place. Raises InputError if a nonzero vector
    or an output point has another number of components.
    """
    dimension = scene.dimension
    for table_name in TABLE_CLASS_BY_NAME:
        tables = getattr(scene, table_name)
        if table_name in LIST_TABLE_NAMES:
            converted_tables = []
            for list_position, table in enumerate(tables, 1):
                with use_table_name_in_errors(f"{table_name}.{list_position}"):
                    converted_tables.append(_fit_table_to_dimension(table, dimension))
            object.__setattr__(scene, table_name, tuple(converted_tables))
        elif tables is not None:
            object.__setattr__(scene, table_name, _fit_table_to_dimension(tables, dimension))
    for output_point in scene.output_points:
        if len(output_point.values) != dimension:
            raise InputError(
                f"output.points.{output_point.key}",
                output_point.values,
                describe_components("", dimension),
            )


def _fit_table_to_dimension(table: Table, dimension: int) -> Table:
    """Return a copy of a table for a scene with 2 or 3 dimensions.

    Raises InputError if a nonzero vector, or the vector of a load's further harmonic, has another
    number of components. A harmonic on an edge may have one number, a pressure.
    """
    if isinstance(table, kinds.PeriodicLoad):
        allowed_counts = (dimension,) if getattr(table, "edge", None) is None else (dimension, 1)
        table.require(
            all(len(harmonic.cos) in allowed_counts for harmonic in table.harmonics),
            "harmonics",
            f"vectors of {dimension} components each, one for each direction",
        )
    return table.with_dimension(dimension)


def _check_body_loads_and_cracks(scene: SceneTables) -> None:
    """Check a plate or solid with load and cracks.

    Raises InputError for missing sides, load points or keys of a crack, and for points or cracks
    outside the body. Sides and cracks in a mesh file are not checked.
    """
    geometry, mesh, contact = scene.geometry, scene.mesh, scene.contact
    is_plate_or_box_by_sides = geometry.file is None and mesh.layout != "file"
    if scene.dimension == 3 and contact is not None and scene.disk is not None:
        contact.require(
            not contact.friction,
            "friction",
            "0, or left out, with [disk] and geometry.kind = 'solid', for which"
            " friction is not implemented",
        )
    if scene.dimension == 2 or is_plate_or_box_by_sides:
        geometry.given("thickness")
    elif mesh.layout == "file":
        geometry.forbid_keys(("thickness",), "mesh.layout = 'file'")
    if mesh.layout == "file":
        return
    if is_plate_or_box_by_sides:
        _check_sides(geometry)
    if not scene.has_other_loads:
        force_point_format_text = (
            "[x, y], or [x, y, z] in a solid"
            if is_plate_or_box_by_sides
            else "[x, y, z], on the part or near it"
        )
        scene.excitation.given(
            "point", f"given: the point of the force, {force_point_format_text} [m]"
        )
    if is_plate_or_box_by_sides:
        _check_load_points(scene)
    for name, crack in scene.crack_by_name.items():
        with use_table_name_in_errors(name):
            if geometry.file is not None:
                crack.given(
                    "point", "given: a point [x, y, z] of the crack [m], with geometry.file"
                )
            if crack.point is not None:
                _check_arbitrary_plane_crack_keys(crack)
            else:
                _check_box_crack(crack, scene)
    if scene.crack_by_name:
        if mesh.layout == "graded":
            mesh.given(
                "lip_elements", "given: a whole number >= 1, the elements along each crack face"
            )
        if contact is None:
            raise missing_table_error("contact", ", as there is a crack")
    box_crack_names = [name for name, crack in scene.crack_by_name.items() if crack.point is None]
    for first_crack_name, second_crack_name in combinations(box_crack_names, 2):
        _check_crack_distance(scene, first_crack_name, second_crack_name)


def _check_disk(scene: SceneTables, disk: kinds.Disk) -> None:
    """Raise InputError if a scene does not fit a bladed disk.

    Checked are the load's engine order and frequency, and the rim's radii: blades must not overlap.
    """
    scene.excitation.given(
        "order", "given: the engine order of the load on [disk], a whole number >= 1"
    )
    if scene.speed == 0.0:
        scene.excitation.given(
            "omega",
            "given: a finite number > 0 [rad/s], or excitation.frequency [Hz], as [disk] is at "
            "rest",
        )
    if scene.mesh.layout == "file":
        return
    inner_radius, outer_radius = disk.given("inner_radius"), disk.given("outer_radius")
    disk.require(
        inner_radius < outer_radius,
        "inner_radius",
        f"less than disk.outer_radius = {outer_radius:g} m",
    )
    blade_width = scene.geometry.circumferential_width
    foot_spacing = 2.0 * outer_radius * math.sin(math.pi / disk.sectors)
    disk.require(
        blade_width < foot_spacing * (1.0 - MIN_RELATIVE_CRACK_DISTANCE),
        "outer_radius",
        f"larger, as blades {blade_width:g} m wide would overlap: "
        f"their roots are {foot_spacing:g} m apart",
    )
    foot_radius = math.sqrt(outer_radius**2 - 0.25 * blade_width**2)
    disk.require(
        inner_radius < foot_radius,
        "inner_radius",
        f"less than {foot_radius:g} m, where the blade meets the rim",
    )


def _check_sides(geometry: kinds.Geometry) -> None:
    """Raise InputError if a plate or box lacks a side, or has very different sides."""
    plate_or_box_width, plate_or_box_height = geometry.given("width"), geometry.given("height")
    for width_or_thickness_key, side in zip(
        ("width", "thickness"), (plate_or_box_width, *geometry.sides[2:]), strict=False
    ):
        geometry.require(
            plate_or_box_height / MAX_BOX_SIDE_RATIO
            <= side
            <= plate_or_box_height * MAX_BOX_SIDE_RATIO,
            width_or_thickness_key,
            f"within a factor {MAX_BOX_SIDE_RATIO:g} of geometry.height = "
            f"{plate_or_box_height:g} m",
        )


def _check_load_points(scene: SceneTables) -> None:
    """Raise InputError for a force without a point, or a point outside a plate or box."""
    excitation, sides = scene.excitation, scene.geometry.sides
    if excitation.point is None and (force_key := excitation.first_force_key):
        excitation.require(False, force_key, "left out without excitation.point")
    ranges_text = ", ".join(
        f"{axis_letter} from 0 to {side:g} m"
        for axis_letter, side in zip("xyz", sides, strict=False)
    )
    for name, load in scene.table_by_name.items():
        if isinstance(load, kinds.Excitation | kinds.Load):
            with use_table_name_in_errors(name):
                load.require(
                    all(
                        0.0 <= load_point_coordinate <= side
                        for load_point_coordinate, side in zip(
                            load.point or (), sides, strict=False
                        )
                    ),
                    "point",
                    f"on the {scene.geometry.kind}: {ranges_text}",
                )


def _check_arbitrary_plane_crack_keys(crack: kinds.Crack) -> None:
    """Raise InputError unless the keys define a crack around a point in a solid."""
    normal = np.array(crack.given("normal"))
    crack.require(any(normal), "normal", "a vector that is not zero")
    crack.require(
        crack.front in (None, "through"), "front", "'through', or left out, with crack.point"
    )
    if crack.front == "through":
        crack.forbid_keys(("radii", "depth"), "crack.front = 'through'")
    elif crack.radii is not None:
        crack.forbid_keys(("length", "depth"), "crack.radii")
    else:
        crack.require(
            crack.length is not None and crack.depth is not None,
            "radii",
            "given: [a, b] [m]; or crack.length and crack.depth; or crack.front = 'through'",
        )
    if crack.front == "through" or crack.half_axes[0] != crack.half_axes[1]:
        crack.given(
            "direction", "given: [dx, dy, dz], the direction of the first radius or of growth"
        )
    if crack.direction is not None:
        cross_norm = np.linalg.norm(np.cross(normal, crack.direction))
        norm_product = np.linalg.norm(normal) * np.linalg.norm(crack.direction)
        crack.require(
            cross_norm > 1e-3 * norm_product, "direction", "a vector not along crack.normal"
        )


def _check_box_crack(crack: kinds.Crack, scene: SceneTables) -> None:
    """Raise InputError if a crack in a plate or box has contradicting keys, or leaves the plate."""
    geometry = scene.geometry
    crack.forbid_keys(kinds.ARBITRARY_PLANE_CRACK_KEYS, "without crack.point")
    crack.require(
        crack.front != "through", "front", "'straight' or 'elliptical' without crack.point"
    )
    if len(scene.crack_by_name) > 1:
        crack.forbid_keys(
            ("first_frequency", "first_omega"),
            "several cracks: it sets the length of a single crack",
        )
    _check_crack_position(crack, geometry)
    if geometry.dimension == 2:
        crack.forbid_keys(("depth", "front"), "geometry.kind = 'plate'")
    elif crack.depth is None:
        crack.forbid_keys(("front",), "without crack.depth: the crack goes through the thickness")
    else:
        thickness = geometry.sides[2]
        crack.require(
            _is_inside_with_margin(crack.depth, thickness),
            "depth",
            f"less than geometry.thickness = {thickness:g} m, by at least "
            f"{MIN_RELATIVE_CRACK_DISTANCE:g} of it; or left out for a crack through it",
        )
    if scene.mesh.layout == "grid":
        _check_crack_on_grid(crack, geometry, scene.mesh)


def _check_crack_position(crack: kinds.Crack, geometry: kinds.Geometry) -> None:
    """Raise InputError if a crack's position or length is missing, or leaves the plate."""
    (width, height, *_), geometry_kind = geometry.sides, geometry.kind
    margin_text = f"and at least {MIN_RELATIVE_CRACK_DISTANCE:g} of this length from both"
    if crack.center is None:
        crack.given(
            "edge", f"given: 'left' or 'right'; or center, for a crack inside the {geometry_kind}"
        )
    crack.require(
        _is_inside_with_margin(crack.height or 0.0, height),
        "height",
        f"inside the {geometry_kind}: between 0 and geometry.height = {height:g} m, {margin_text}",
    )
    crack.require(
        (crack.length is None) != (crack.first_omega is None),
        "length",
        "given: a finite number > 0 [m]; or crack.first_omega or crack.first_frequency"
        if crack.length is None
        else "left out with crack.first_omega or crack.first_frequency: give one of them",
    )
    crack.require(
        crack.length is None or _is_inside_with_margin(crack.length, width),
        "length",
        f"shorter than the {geometry_kind}: between 0 and geometry.width = {width:g} m, "
        f"{margin_text}",
    )
    if crack.center is not None:
        tip_positions = [crack.center] if crack.length is None else crack.span(width)
        crack.require(
            all(_is_inside_with_margin(tip_position, width) for tip_position in tip_positions),
            "center",
            f"such that both tips are inside the {geometry_kind}: "
            f"between 0 and {width:g} m, {margin_text}",
        )


def _check_crack_on_grid(crack: kinds.Crack, geometry: kinds.Geometry, mesh: kinds.Mesh) -> None:
    """Raise InputError unless a crack lies on a grid line and ends at grid lines.

    Length and height of the crack are whole numbers of grid cells. Both are at least one cell, and
    less than the plate's side. The tolerance is 1e-9 times the side.
    """
    crack.given("length", "given: a finite number > 0 [m]; a grid cannot have crack.first_omega")
    (width, height), n_columns = geometry.sides, mesh.given("columns")
    extent_and_cells_by_key = {"length": (width, n_columns), "height": (height, mesh.given("rows"))}
    for crack_length_or_height_key, (extent, n_cells) in extent_and_cells_by_key.items():
        crack_length_or_height_in_cells = (
            getattr(crack, crack_length_or_height_key) / extent * n_cells
        )
        is_on_grid_line = (
            0 < round(crack_length_or_height_in_cells) < n_cells
            and abs(crack_length_or_height_in_cells - round(crack_length_or_height_in_cells))
            < 1e-9 * n_cells
        )
        crack.require(
            is_on_grid_line,
            crack_length_or_height_key,
            f"a whole number of grid cells of {extent / n_cells:g} m, at least one cell from each "
            "end",
        )
    if crack.center is not None:
        tip_column = crack.span(width)[0] / width * n_columns
        crack.require(
            abs(tip_column - round(tip_column)) < 1e-9 * n_columns,
            "center",
            f"such that both tips are on grid lines, which are {width / n_columns:g} m apart",
        )


def _check_crack_distance(
    scene: SceneTables, first_crack_name: str, second_crack_name: str
) -> None:
    """Raise InputError if two cracks are too close.

    The tips of cracks at the same height must be at least 1e-4 times the plate's width apart. The
    heights of cracks at different heights must differ by at least 1e-4 times the plate's height.

    Parameters
    ----------
    scene : SceneTables
        Scene with the cracks.
    first_crack_name, second_crack_name : str
        Names of the cracks, such as "cracks.1".
    """
    first_crack, second_crack = (
        scene.crack_by_name[crack_name] for crack_name in (first_crack_name, second_crack_name)
    )
    width, height, *_ = scene.geometry.sides
    height_distance = abs(first_crack.given("height") - second_crack.given("height"))
    if height_distance >= MIN_RELATIVE_CRACK_DISTANCE * height:
        return
    has_same_height = height_distance <= 1e-9 * height
    spans = sorted(crack.span(width) for crack in (first_crack, second_crack))
    ligament = spans[1][0] - spans[0][1]
    if not has_same_height or ligament < MIN_RELATIVE_CRACK_DISTANCE * width:
        min_distance_text = f"{MIN_RELATIVE_CRACK_DISTANCE * height:g} m above or below"
        if has_same_height:
            min_distance_text += (
                f", or with {MIN_RELATIVE_CRACK_DISTANCE * width:g} m between the tips"
            )
        raise InputError(
            f"{second_crack_name}.height",
            second_crack.height,
            f"farther from {first_crack_name}.height = {first_crack.height:g} m, as cracks "
            f"may not touch: at least {min_distance_text}",
        )


def _is_inside_with_margin(coordinate: float, extent: float) -> bool:
    """Return True if a coordinate is inside the interval from 0 to ``extent``.

    The distance to both ends must be at least 1e-4 of the extent.
    """
    return (
        MIN_RELATIVE_CRACK_DISTANCE * extent
        <= coordinate
        <= (1.0 - MIN_RELATIVE_CRACK_DISTANCE) * extent
    )
