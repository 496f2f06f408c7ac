"""Where the cracks of a plate may be: inside it, on its grid, and apart from each other."""

from __future__ import annotations

from itertools import combinations

from fenics_crack.errors import InputError
from fenics_crack.scene.fields import named
from fenics_crack.scene.tables import Crack, Geometry, Mesh

__all__ = ["OF_SHAPES", "check_cracks"]

LEAST_DISTANCE = 1e-4
"""Least distance of cracks and tips from the edges and each other, relative to the side."""
OF_SHAPES = (
    "edge", "center", "height", "length", "depth", "front", "first_frequency", "first_omega",
)  # fmt: skip
"""Keys of a crack that a mesh file knows by itself."""


def check_cracks(cracks: dict[str, Crack], geometry: Geometry, mesh: Mesh) -> None:
    """Raise InputError where a crack cannot be in a plate, by the crack's name in the scene."""
    for name, crack in cracks.items():
        with named(name):
            _check_one(crack, geometry, list(cracks))
            _check_front(crack, geometry)
            if mesh.layout == "grid":
                _check_grid(crack, geometry, mesh)
    if mesh.layout == "graded":
        mesh.given("lip_elements", "given where there is a crack")
    for first, second in combinations(cracks, 2):
        _check_apart(cracks, first, second, geometry)


def _check_one(crack: Crack, geometry: Geometry, names: list[str]) -> None:
    width, height, *_ = geometry.sides
    kind, margin = geometry.kind, f"at least {LEAST_DISTANCE:g} of that from both"
    inside = crack.center is not None
    if inside:
        crack.leave_out(("edge",), "crack.center")
    else:
        crack.given("edge", f"given: 'left' or 'right'; or center, for a crack inside the {kind}")
    crack.require(
        crack.height is not None and _inside(crack.height, height),
        "height",
        f"inside the {kind}: between 0 and geometry.height = {height:g}, {margin}",
    )
    if len(names) > 1:
        crack.leave_out(
            ("first_frequency", "first_omega"),
            "several cracks: it finds the length of the only one",
        )
    crack.require(
        (crack.length is None) != (crack.first_omega is None),
        "length",
        "given, or left out where crack.first_omega determines it, or first_frequency",
    )
    crack.require(
        crack.length is None or _inside(crack.length, width),
        "length",
        f"shorter than the {kind}: between 0 and geometry.width = {width:g}, {margin}",
    )
    if inside:
        ends = [crack.center] if crack.length is None else crack.span(width)
        crack.require(
            all(_inside(end or 0.0, width) for end in ends),
            "center",
            f"such that both tips are inside the {kind}: between 0 and {width:g}, {margin}",
        )


def _check_front(crack: Crack, geometry: Geometry) -> None:
    if geometry.dimension == 2:
        crack.leave_out(("depth", "front"), "geometry.kind = 'plate'")
    elif crack.depth is None:
        crack.leave_out(("front",), "a crack through the thickness: there is no crack.depth")
    else:
        thickness = geometry.sides[2]
        words = f"geometry.thickness = {thickness:g}"
        allowed = f"less than {words}, by {LEAST_DISTANCE:g} of that; left out: through it"
        crack.require(_inside(crack.depth, thickness), "depth", allowed)


def _check_grid(crack: Crack, geometry: Geometry, mesh: Mesh) -> None:
    crack.given("length", "given with mesh.layout = 'grid'")
    (width, height), columns = geometry.sides, mesh.given("columns")
    sides = {"length": (width, columns), "height": (height, mesh.given("rows"))}
    for key, (extent, count) in sides.items():
        cells = getattr(crack, key) / extent * count
        crack.require(
            0 < round(cells) < count and abs(cells - round(cells)) < 1e-9 * count,
            key,
            f"a whole number of grid cells of {extent / count:g} m, at least one from each end",
        )
    if crack.center is not None:
        tip = crack.span(width)[0] / width * columns
        crack.require(
            abs(tip - round(tip)) < 1e-9 * columns,
            "center",
            f"such that both tips are on grid lines, {width / columns:g} m apart",
        )


def _check_apart(cracks: dict[str, Crack], first: str, second: str, geometry: Geometry) -> None:
    """Raise InputError unless two cracks are far enough from each other."""
    one, other = cracks[first], cracks[second]
    width, height, *_ = geometry.sides
    distance = abs(one.given("height") - other.given("height"))
    if distance >= LEAST_DISTANCE * height:
        return
    same = distance <= 1e-9 * height
    spans = sorted(crack.span(width) for crack in (one, other))
    ligament = spans[1][0] - spans[0][1]
    if not same or ligament < LEAST_DISTANCE * width:
        least = f"{LEAST_DISTANCE * height:g} m above or below"
        if same:
            least += f", or with {LEAST_DISTANCE * width:g} m between their tips"
        allowed = f"apart from that of {first}: cracks may not touch; at least {least}"
        raise InputError(f"{second}.height", other.height, allowed)


def _inside(place: float, extent: float) -> bool:
    """Whether a place is between 0 and an extent, and not too near to either."""
    return LEAST_DISTANCE * extent <= place <= (1.0 - LEAST_DISTANCE) * extent
