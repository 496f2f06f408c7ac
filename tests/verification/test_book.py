"""The verification book: every row of every case holds, and so do the committed pages."""

import beams  # each enters its cases
import calculix
import elements
import fronts
import impacts
import intensities
import oscillators
import plates
import programs
import pytest
import rubbing
import uncertainties
from book import CASES, PAGES, differences, index

pytestmark = pytest.mark.verification
FILES = (
    oscillators, impacts, rubbing, plates, beams, elements, fronts, intensities, calculix,
    programs, uncertainties,
)  # fmt: skip
DEAR = (
    "breathing_crack_in_a_beam", "ellipse_in_a_block", "energy_release_on_three_meshes",
    "friction_on_a_solid", "fronts_on_coarse_meshes",
    "growth_of_half_ellipses", "penny_in_a_block",
    "rotor_with_a_crack", "stress_intensity_along_a_front", "stress_intensity_factors",
    "torsion_of_a_cracked_bar", "true_errors_over_stated_ones",
)  # fmt: skip
"""Of a crack's tip on meshes that are refined, and of many references."""
NAMES = [pytest.param(name, marks=[pytest.mark.nightly] * (name in DEAR)) for name in CASES]


@pytest.mark.drawn(6)
@pytest.mark.parametrize("name", NAMES)
def test_book(name: str, request: pytest.FixtureRequest) -> None:
    """The rows hold, and the committed page shows them; --write-book writes it instead."""
    case = CASES[name]
    if case.maker and not case.maker():
        pytest.skip("the program that makes the references is not installed")
    rows = case.rows()
    if request.config.getoption("--write-book"):
        case.write(rows)
    assert [row for row in rows if not row.holds] == []
    assert differences(case.page.read_text(), rows, case.render(rows)) == []
    assert case.page.with_suffix(".png").exists()


def test_index(request: pytest.FixtureRequest) -> None:
    """It lists the pages as they are, and there is no page without a case."""
    if request.config.getoption("--write-book"):
        (PAGES / "index.md").write_text(index())
    assert (PAGES / "index.md").read_text() == index()
    assert {page.stem for page in PAGES.glob("*.md")} == {"index", *CASES}


def test_a_wrong_figure_is_seen() -> None:
    """A figure of a page that is off by half of what is allowed is named."""
    case = CASES["bilinear_oscillator"]
    rows = case.rows()
    page = case.render(rows)
    old_row = page.split("\n|")[3]
    cells = old_row.split(" | ")
    cells[1] = f"{rows[0].ours + 0.5 * rows[0].tolerance * abs(rows[0].reference):.15g}"
    assert differences(page, rows, page) == []
    page_differences = differences(page.replace(old_row, " | ".join(cells)), rows, page)
    assert len(page_differences) == 1 and page_differences[0].startswith(rows[0].quantity)
