"""Contact laws."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import DEMOS, catch_error, log_slope, oscillator

from fenics_crack import (
    LayeredPenalty,
    Scene,
    SmoothedPenalty,
    Structure,
    UnilateralConstraint,
    UnilateralPenalty,
    build_structure,
    contact_law,
    reduce_structure,
    solve_harmonic_balance,
)

TABLE = Scene.load(DEMOS / "paper_plate.toml").contact
GAPS = np.linspace(-2.0, 2.0, 81)[:, None] + 0.003


def contact(**keys: Any) -> Any:
    """A scene's table ``[contact]`` with these keys."""
    return replace(TABLE, **{"stiffness": None, **keys})


def test_penalty_acts_in_penetration_only() -> None:
    """Eq. 11: k (g + |g|) / 2."""
    law = UnilateralPenalty(3.0)
    assert np.allclose(law.force(GAPS), 3.0 * (GAPS + np.abs(GAPS)) / 2.0)
    assert np.array_equal(law.tangent(GAPS), np.where(GAPS > 0.0, 3.0, 0.0))


@pytest.mark.parametrize(
    "law", [UnilateralPenalty(3.0), SmoothedPenalty(3.0, 4.0), LayeredPenalty(3.0, 0.123, 0.4)]
)
def test_tangent_is_the_derivative(law: Any) -> None:
    """Central differences away from the kink."""
    step = 1e-6
    slope = (law.force(GAPS + step) - law.force(GAPS - step)) / (2.0 * step)
    assert np.allclose(slope, law.tangent(GAPS), rtol=1e-6, atol=1e-6)


def test_smoothed_law_tends_to_the_penalty_law_like_one_over_s() -> None:
    """The largest difference is k / (pi s), on both sides: the pull on an open crack."""
    sharpnesses = np.array([10.0, 100.0, 1000.0])
    differences = []
    for s in sharpnesses:
        smoothed_law, penalty = SmoothedPenalty(3.0, s), UnilateralPenalty(3.0)
        far_gaps = np.array([[-50.0], [50.0]])
        lag = penalty.force(far_gaps) - smoothed_law.force(far_gaps)
        assert np.allclose(lag, 3.0 / (np.pi * s), rtol=1e-3)
        differences.append(np.abs(penalty.force(GAPS) - smoothed_law.force(GAPS)).max())
    assert log_slope(sharpnesses, differences) == pytest.approx(-1.0, abs=0.05)
    assert np.all(SmoothedPenalty(3.0, 1e3).tangent(GAPS) <= 3.0)


def test_stiffness_may_differ_from_pair_to_pair() -> None:
    """One stiffness per pair is broadcast over the instants."""
    law = UnilateralPenalty(np.array([1.0, 10.0])).scaled(2.0)
    assert np.array_equal(
        law.force(np.array([[1.0, 1.0], [-1.0, 2.0]])), [[2.0, 20.0], [0.0, 40.0]]
    )


@pytest.mark.parametrize(
    "stiffness", [0.0, -1.0, np.nan, np.inf, "soft", "1e9", True, [], [1.0, -2.0], [[1.0]]]
)
def test_bad_stiffness_is_named(stiffness: object) -> None:
    """One error with key and value."""
    catch_error(lambda: UnilateralPenalty(stiffness), "contact stiffness", stiffness)  # type: ignore[arg-type]
    catch_error(lambda: SmoothedPenalty(stiffness, 1.0), "contact stiffness", stiffness)  # type: ignore[arg-type]


def test_a_law_without_all_methods_is_told_which() -> None:
    """Those that are missing are named, and no others; a class is no law."""

    class Law:
        stiffness = 1.0

        def force(self, gap: np.ndarray) -> np.ndarray:
            """lambda(g) [N]."""
            return np.maximum(gap, 0.0)

    mass = Structure.from_matrices(np.eye(1), np.eye(1), gap=np.ones((1, 1)), force_sin=[1.0])
    solve: Any = solve_harmonic_balance
    catch_error(lambda: solve(mass, 0.5, Law()), "contact", names="attributes: tangent, scaled")
    catch_error(
        lambda: solve(mass, 0.5, UnilateralPenalty),
        "contact",
        names="attributes: stiffness, force, tangent, scaled",
    )


def test_scene_names_its_law() -> None:
    """The contact table becomes the law it names."""
    assert contact_law(contact(stiffness=1e9)) == UnilateralPenalty(1e9)
    smoothed_table = contact(stiffness=1e9, law="smoothed", sharpness=1e8)
    assert contact_law(smoothed_table) == SmoothedPenalty(1e9, 1e8)
    assert contact_law(contact(law="unilateral")) == UnilateralConstraint()
    layered_table = contact(stiffness=1e9, layer_depth=1e-6, layer_share=0.2)
    assert contact_law(layered_table) == LayeredPenalty(1e9, 1e-6, 0.2)


def test_a_layer_is_soft_to_its_depth() -> None:
    """Slopes a k and k, with a bend at the depth; the stiffness may differ from pair to pair."""
    law = LayeredPenalty([10.0, 20.0], layer_depth=2.0, layer_share=0.25)
    gaps = np.array([[-1.0, 1.0], [2.0, 3.0]])
    assert np.allclose(law.force(gaps), [[0.0, 5.0], [5.0, 30.0]])
    assert np.allclose(law.tangent(gaps), [[0.0, 5.0], [2.5, 20.0]])
    assert np.allclose(law.scaled(2.0).force(gaps), 2.0 * law.force(gaps))
    for number in (0.0, -1.0, np.inf, "deep", [0.5]):
        catch_error(lambda n=number: LayeredPenalty(1.0, n, 0.5), "contact layer_depth", number)
        catch_error(lambda n=number: LayeredPenalty(1.0, 1.0, n), "contact layer_share", number)
    catch_error(lambda: LayeredPenalty(1.0, 1.0, 1.0), "contact layer_share", 1.0)


@pytest.mark.parametrize("weight", [0.0, -1.0, np.nan, np.inf, "heavy", [1.0, -1.0]])
def test_bad_weight_is_named(weight: object) -> None:
    """One error with key and value; without a weight there is nothing to check."""
    assert UnilateralConstraint().weight is None
    catch_error(lambda: UnilateralConstraint(weight), "contact weight", weight)  # type: ignore[arg-type]


def test_stiffness_in_a_list_is_scaled_like_any_other() -> None:
    """A list of stiffnesses, one per pair, is multiplied, not repeated."""
    for law in (UnilateralPenalty([1.0, 10.0]), SmoothedPenalty([1.0, 10.0], 3.0)):
        for factor in (2, 2.0):
            assert np.array_equal(law.scaled(factor).stiffness, [2.0, 20.0])


# --- stiffness per area ---------------------------------------------------------------------------


def plate(scene: Scene, columns: int) -> Structure:
    """The paper's plate of quadratic square elements, little more damped."""
    mesh = {"mesh.order": 2, "mesh.columns": columns, "mesh.rows": columns}
    return build_structure(scene.replace(mesh | {"damping.ratio": 0.05, "damping.modes": 20}))


def test_stiffness_per_area_is_shared_by_the_pairs(paper_scene: Scene) -> None:
    """k of a pair is that of its area, for both laws; fixed stiffness stays as it is."""
    structure = plate(paper_scene, 4)
    areas = structure.pair_areas
    assert areas is not None and len(areas) == 4 and np.ptp(areas) > 0.0
    penalty = contact_law(contact(stiffness_per_area=1e12), structure)
    assert np.allclose(penalty.stiffness, 1e12 * areas, rtol=1e-15)
    smoothed_law = contact_law(
        contact(stiffness_per_area=1e12, law="smoothed", sharpness=3.0), structure
    )
    assert isinstance(smoothed_law, SmoothedPenalty) and smoothed_law.sharpness == 3.0
    assert np.allclose(smoothed_law.stiffness, 1e12 * areas, rtol=1e-15)
    assert contact_law(contact(stiffness=1e9), structure) == UnilateralPenalty(1e9)
    reduced_law = contact_law(
        contact(stiffness_per_area=1e12), reduce_structure(structure, modes=3)
    )
    assert np.array_equal(reduced_law.stiffness, penalty.stiffness)


def test_stiffness_per_area_needs_areas() -> None:
    """Matrices have no lips whose area could be known."""
    for structure in (None, oscillator()):
        catch_error(
            partial(contact_law, contact(stiffness_per_area=1e12), structure),
            "contact.stiffness_per_area",
            1e12,
        )


def test_refining_the_mesh_does_not_change_the_physics(paper_scene: Scene) -> None:
    """Stiffness per area: penetration and force converge; per pair: 2/3 of it or less each time.

    4, 8 and 16 quadratic elements across the plate, 300 rad/s. What is left of the change, 2.5 and
    1.1 %, is the plate's own discretisation.
    """
    per_area = 1e10
    extremes_by_law: dict[str, list[tuple[float, float]]] = {"area": [], "pair": []}
    per_pair = None
    for columns in (4, 8, 16):
        structure = plate(paper_scene, columns)
        per_pair = per_pair or per_area * float(structure.pair_areas.mean())
        reduced_structure = reduce_structure(structure, modes=20, method="massless")
        for name, table in (
            ("area", contact(stiffness_per_area=per_area)),
            ("pair", contact(stiffness=per_pair)),
        ):
            law = contact_law(table, structure)
            solution = solve_harmonic_balance(reduced_structure, 300.0, law, harmonics=9)
            t = np.linspace(0.0, solution.period, 2000)
            extremes_by_law[name].append(
                (solution.gap(t).max(), solution.force_coefficients[0].sum())
            )
    area, pair = (np.array(extremes_by_law[name]) for name in ("area", "pair"))
    changes = np.abs(area[1:] / area[:-1] - 1.0)
    assert np.all(changes[0] < 0.04) and np.all(changes[1] < 0.02)
    assert np.all(changes[1] < 0.6 * changes[0])
    assert np.all(pair[1:, 0] < 0.7 * pair[:-1, 0])
    assert np.all(pair[1:, 1] > 1.05 * pair[:-1, 1])
