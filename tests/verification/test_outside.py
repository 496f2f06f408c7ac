"""Predictions against published numbers: what the pages say, and that the program still says it."""

import re

import numpy as np
import outside
import pytest

import fenics_crack as fc

pytestmark = pytest.mark.verification
DEAR = ("measured_cantilever", "ross_rod")
"""Of several meshes, or of a solid."""
NAMES = [pytest.param(name, marks=[pytest.mark.nightly] * (name in DEAR)) for name in outside.CASES]


@pytest.mark.drawn(3)
@pytest.mark.parametrize("name", NAMES)
def test_prediction_is_what_the_program_says(name: str) -> None:
    """The numbers of the page, to a twentieth of the half-width of its intervals."""
    rows = {row.quantity: row for row in outside.rows_of(outside.PAGES / f"{name}.md")}
    values = outside.CASES[name]()
    assert rows.keys() == values.keys()
    for quantity, row in rows.items():
        assert values[quantity] == pytest.approx(row.prediction, abs=0.05 * row.half_width)


def test_published_numbers_lie_in_the_intervals() -> None:
    """Eight in ten, and more than half of each source; README and the index count them."""
    rows = {name: list(outside.rows_of(outside.PAGES / f"{name}.md")) for name in outside.CASES}
    n_inside = {name: sum(row.is_inside for row in rows[name]) for name in rows}
    for source in {name.partition("_")[0] for name in rows}:
        names = [name for name in rows if name.startswith(source)]
        assert sum(map(n_inside.get, names)) > sum(len(rows[name]) for name in names) / 2
    total = sum(map(len, rows.values()))
    assert sum(n_inside.values()) >= 0.8 * total
    count_text = f"{sum(n_inside.values())} of {total}"
    index = (outside.PAGES / "index.md").read_text()
    readme = (outside.PAGES.parents[2] / "README.md").read_text()
    assert count_text in index and count_text in readme
    for name in rows:
        assert re.search(rf"\]\({name}\.md\) \| {n_inside[name]} of {len(rows[name])} \|", index)


def test_misses_of_a_plate_are_its_source_s_mesh() -> None:
    """With 30 x 50 elements of first order, as there, all eight frequencies agree to .3 %."""
    scene = fc.Scene.from_text(outside.PLATE).replace(
        {
            "mesh.layout": "grid", "mesh.size": None, "mesh.lip_elements": None,
            "mesh.columns": 30, "mesh.rows": 50, "mesh.order": 1,
        }
    )  # fmt: skip
    frequencies = fc.solve_modes(fc.build_structure(scene), 8).omega / (2.0 * np.pi)
    rows = outside.rows_of(outside.PAGES / "aster_sdls120.md")
    assert frequencies == pytest.approx([row.published for row in rows], rel=0.003)
