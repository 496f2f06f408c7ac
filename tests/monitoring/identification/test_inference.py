"""Interpolation, likelihood and regions against closed forms; and failures inside of sweeps."""

from __future__ import annotations

import json
import math
import re
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import identification
import numpy as np
import pytest
from helpers import catch_error, passing_angles, wrap
from scipy.interpolate import CubicSpline
from scipy.stats import kstest
from surroundings import RunCommand, main
from test_identify import PROBES, SPINNING, command_of_one_unknown

import fenics_crack as fc
from fenics_crack import SweepResult
from fenics_crack.basics.errors import StoppedError
from fenics_crack.monitoring.identification.identify import list_measurement_shortcoming_remarks
from fenics_crack.monitoring.identification.interpolation import (
    Interpolation,
    UnknownGrid,
    compute_leave_one_out_errors,
)
from fenics_crack.monitoring.identification.nuisance import (
    UncrackedPlate,
    compute_crack_geometry_deviations,
)
from fenics_crack.monitoring.identification.posterior import (
    Likelihood,
    Posterior,
    PosteriorForTextValues,
)
from fenics_crack.monitoring.identification.predictor import (
    MeasurementPredictions,
    ProbeDisplacements,
)
from fenics_crack.monitoring.identification.worth import (
    Worth,
    list_advice_texts,
    rank_measurements_by_information,
)
from fenics_crack.monitoring.scene_timing import describe_passage, match_mode_or_give_reason

pytestmark = pytest.mark.usefixtures("not_drawn")

SQUARE = UnknownGrid((np.linspace(0.0, 2.0, 6), np.linspace(1.0, 3.0, 7)))


def test_errors_at_nodes_left_out() -> None:
    """Of a fifth power between the ends; a cubic has none."""
    line = np.linspace(0.0, 1.0, 8) ** 1.3
    errors = compute_leave_one_out_errors(line, np.column_stack([line**3 - line, line**5]))
    np.testing.assert_allclose(errors[:, 0], 0.0, atol=1e-13)
    other_nodes = np.delete(line, 3)
    expected_error = line[3] ** 5 - CubicSpline(other_nodes, other_nodes**5)(line[3])
    assert errors[3, 1] == pytest.approx(expected_error, rel=1e-9) and abs(expected_error) > 1e-5
    assert errors[0, 1] == errors[1, 1] and errors[-1, 1] == errors[-2, 1]


def test_order_of_the_interpolation() -> None:
    """Fourth, also next to the ends, in two unknowns of different scales; cubics are exact, of
    fewer values than a cubic needs quadratics."""

    def worst(count: int) -> float:
        cube = UnknownGrid((np.linspace(0.0, 2.0, count), np.linspace(1.0, 3.0, count)))
        x = np.stack(np.meshgrid(np.linspace(0, 2, 41), np.linspace(1, 3, 41)), -1).reshape(-1, 2)
        wave = np.sin(2.0 * cube.nodes[:, :1] + cube.nodes[:, 1:])
        return float(
            np.abs(
                Interpolation(cube, wave).interpolate(x) - np.sin(2.0 * x[:, :1] + x[:, 1:])
            ).max()
        )

    order = np.log2(worst(9) / worst(17))
    assert 3.5 < order < 5.0
    for shape, power in (((4, 4), 3), ((5, 6), 3), ((4, 5, 3), 2)):
        cube = UnknownGrid(tuple(np.linspace(0.0, k + 1.0, n) for k, n in enumerate(shape)))
        x = cube.upper_bounds * np.random.default_rng(0).random((9, len(shape)))
        found = Interpolation(
            cube, (1.0 + cube.nodes**power).prod(axis=1, keepdims=True)
        ).interpolate(x)
        np.testing.assert_allclose(found[:, 0], (1.0 + x**power).prod(axis=1), rtol=1e-12)


def test_stated_error_of_the_interpolation() -> None:
    """Nine in ten errors are within three of the stated standard deviations, and nan
    at some nodes leaves the others alone."""
    nodes = SQUARE.nodes
    values = np.column_stack([np.sin(2.0 * nodes[:, 0]) * nodes[:, 1], nodes[:, 0] + nodes[:, 1]])
    values[5, 1] = np.nan
    found = Interpolation(SQUARE, values)
    x = SQUARE.lower_bounds + (SQUARE.upper_bounds - SQUARE.lower_bounds) * np.random.default_rng(
        3
    ).random((200, 2))
    predicted, deviation = (
        found.interpolate(x),
        np.sqrt(np.sum(found.list_weighted_node_errors(x) ** 2, axis=1)),
    )
    exact = np.column_stack([np.sin(2.0 * x[:, 0]) * x[:, 1], x.sum(axis=1)])
    assert np.mean(np.abs(predicted - exact)[:, 0] < 3.0 * deviation[:, 0]) > 0.9
    np.testing.assert_allclose(predicted[:, 1], exact[:, 1], atol=1e-9)
    too_few = Interpolation(SQUARE, np.where(np.arange(42)[:, None] < 3, 1.0, np.nan))
    assert found.has_enough_known_nodes.all() and not too_few.has_enough_known_nodes.any()


def test_what_failed_between_others() -> None:
    """Is made up for, with an error that holds what is missed, unless fewer than half are left or
    none of four may be spared; at an end it is said that nothing stands beyond."""
    cube = UnknownGrid((np.linspace(0.0, 3.0, 8),))
    values = np.exp(cube.nodes) * np.sin(2.0 * cube.nodes)
    for lost_node in range(8):
        interpolation = Interpolation(
            cube, np.where(np.arange(8)[:, None] == lost_node, np.nan, values)
        )
        assert (
            interpolation.has_enough_known_nodes.all()
            and interpolation.are_failed_cases_between_known.all() == (0 < lost_node < 7)
        )
        node = cube.nodes[[lost_node]]
        true_error = abs(interpolation.interpolate(node) - values[lost_node]).item()
        stated_error = np.sqrt(np.sum(interpolation.list_weighted_node_errors(node) ** 2)).item()
        assert (
            true_error < 3.0 * stated_error
            or not interpolation.are_failed_cases_between_known.all()
        )
    for count in (20, 21):
        node_values = np.where(np.arange(42)[:, None] < count, 1.0, np.nan)
        assert Interpolation(SQUARE, node_values).has_enough_known_nodes.all() == (count == 21)
    four = UnknownGrid((np.linspace(0.0, 3.0, 4),))
    for count in (3, 4):
        case_values = np.where(np.arange(4)[:, None] < count, 1.0, np.nan)
        assert Interpolation(four, case_values).has_enough_known_nodes.all() == (count == 4)
    holes = np.ones((42, 3))
    holes[[0, 3], [0, 1]] = np.nan  # a corner, and a place on a side
    np.testing.assert_array_equal(
        Interpolation(SQUARE, holes).are_failed_cases_between_known, [False, True, True]
    )


@dataclass
class Linear:
    """Predictions s = A x + b without an error, in place of those of a forward model."""

    matrix: np.ndarray
    offset: np.ndarray
    grid_of_solved_cases: UnknownGrid
    unknown_keys: tuple[str, ...] = ("crack.length", "crack.height")

    @property
    def model(self) -> Any:
        return self

    rows: tuple[Any, ...] = ()

    @property
    def scene(self) -> fc.Scene:
        return fc.Scene.from_text(identification.SCENE)

    def compute_crack_geometry_deviations(self, x: np.ndarray) -> np.ndarray:
        return np.zeros_like(x)

    def make_predictor(self, rows: Any, more_rows: Any = ()) -> Any:
        places = [*range(len(self.matrix)), *range(len(more_rows))]
        return replace(self, matrix=self.matrix[places], offset=self.offset[places])

    def __call__(self, x: np.ndarray) -> MeasurementPredictions:
        return exact(x @ self.matrix.T + self.offset)

    def iterate_face_state_predictions(
        self, x: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, MeasurementPredictions]]:
        """One alone."""
        yield np.arange(len(x)), np.ones(len(x)), self(x)


def exact(values: np.ndarray) -> MeasurementPredictions:
    """Predictions (m, q) without an error."""
    (m, q), is_known = values.shape, np.ones(values.shape[1], dtype=bool)
    return MeasurementPredictions(values, np.zeros((m, q, q)), np.zeros((m, q, 0)), is_known)


def test_ridge_that_is_narrower_than_the_grid() -> None:
    """One number of two unknowns: the grid holds the region of a wide ridge, of which it says so
    little as of that of a bound, and not that of a thin one."""
    cube = UnknownGrid((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    rng = np.random.default_rng(7)
    for deviation, is_resolved in ((1.0, True), (0.4, True), (1e-2, False), (1e-4, False)):
        model: Any = Linear(np.array([[1.0, 0.37]]), np.zeros(1), cube)
        likelihood = Likelihood(np.array([9.13]), np.array([deviation]), model)
        posterior = Posterior({"": PosteriorForTextValues(likelihood)})
        assert (posterior.unresolved_probability < 0.01) == is_resolved
        assert (posterior.unresolved_probability > 0.3) != is_resolved
        # Of that posterior: along the ridge both are uniform.
        y = rng.uniform(0.0, 20.0, 4000)
        x = 9.13 + deviation * rng.standard_normal(4000) - 0.37 * y
        is_inside = (x > 0.0) & (x < 10.0)
        heights = likelihood(np.column_stack([x, y])[is_inside])
        held_share = np.mean(heights >= posterior.find_region_border_log_likelihood(0.95))
        assert (abs(held_share - 0.95) < 0.03) == is_resolved


def test_linear_model() -> None:
    """Estimate, intervals, region, evidence and gain of a Gaussian posterior in closed form."""
    matrix = np.array([[1.0, 0.2], [0.3, 1.0], [1.0, 1.0]])
    cube = UnknownGrid((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    truth, deviations = np.array([3.0, 8.0]), np.array([0.1, 0.2, 0.15])
    likelihood = Likelihood(
        matrix @ truth + 5.0,
        deviations,
        Linear(matrix, np.full(3, 5.0), cube, rows=(None,) * 3),  # type: ignore[arg-type]
    )
    posterior = Posterior({"": PosteriorForTextValues(likelihood)})
    weights = matrix / deviations[:, None]
    covariance = np.linalg.inv(weights.T @ weights)
    np.testing.assert_allclose(posterior.best_words_and_unknowns[1], truth, atol=1e-6)
    for place in range(2):
        sigma = math.sqrt(covariance[place, place])
        low, high = posterior.compute_interval(place, 0.95)
        assert low == pytest.approx(truth[place] - 1.96 * sigma, abs=0.05 * sigma)
        assert high == pytest.approx(truth[place] + 1.96 * sigma, abs=0.05 * sigma)
        assert posterior.compute_deviation(place) == pytest.approx(sigma, rel=0.02)
    # Of two unknowns: chi^2 < 5.991 holds 95 %.
    assert posterior.find_region_border_log_likelihood(0.95) == pytest.approx(
        -0.5 * 5.991, rel=0.05
    )
    volume = 2.0 * math.pi * math.sqrt(np.linalg.det(covariance))
    assert posterior.log_evidence == pytest.approx(math.log(volume / 200.0), abs=0.02)
    assert [round(part[2], 2) for part in posterior.find_region_parts(0.95, 0.03)] == [0.95]
    repeated_measurement = fc.Measurement("harmonic_1", 1.0, 0.1, frequency=10.0)
    worth = rank_measurements_by_information(
        likelihood, truth, [repeated_measurement], (1e-3, 0.05)
    )
    later_covariance = np.linalg.inv(
        weights.T @ weights + np.outer(matrix[0], matrix[0]) / 0.01 + np.diag([0.12, 0.03])
    )
    assert worth.improved_deviations_by_key["crack.length"][0] == pytest.approx(
        math.sqrt(later_covariance[0, 0]), rel=1e-3
    )
    earlier_covariance = np.linalg.inv(weights.T @ weights + np.diag([0.12, 0.03]))
    gain = 0.5 * math.log(np.linalg.det(earlier_covariance) / np.linalg.det(later_covariance))
    assert worth.information_gains[0] == pytest.approx(gain, rel=1e-3)


def test_misfit_of_what_is_fitted() -> None:
    """By chance its probability is as often small as large: chi^2 has as many degrees of freedom as
    there are measurements more than unknowns. At the same place without one of them it is less by
    the square of that one's residual."""
    matrix = np.array([[1.0, 0.2], [0.3, 1.0], [1.0, 1.0], [-0.5, 1.0]])
    cube = UnknownGrid((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    linear = Rows(matrix, np.zeros(4), cube, rows=(0, 1, 2, 3))
    rng, chances = np.random.default_rng(8), []
    for _ in range(150):
        values = matrix @ [3.0, 8.0] + 0.1 * rng.normal(size=4)
        likelihood = Likelihood(values, np.full(4, 0.1), linear)  # type: ignore[arg-type]
        x = np.linalg.lstsq(matrix, values, rcond=None)[0]
        total, chance = likelihood.compute_chi_square_and_p_value(x)
        chances.append(chance)
    assert kstest(chances, "uniform").pvalue > 0.01
    posterior = Posterior({"": PosteriorForTextValues(likelihood)})
    remaining_misfits = (total - ((values - matrix @ x) / 0.1) ** 2).tolist()
    assert [misfit[0] for misfit in posterior.misfits_without_each_measurement] == pytest.approx(
        remaining_misfits, rel=1e-3
    )


def test_picture_of_one_unknown() -> None:
    """The density of a normal distribution, over its largest, and what is within 1.96 standard
    deviations; of two unknowns that of each alone, and neither twice."""
    cube = UnknownGrid((np.linspace(0.0, 0.1, 4), np.linspace(0.0, 0.2, 4)))
    linear = Linear(np.eye(2), np.zeros(2), cube, rows=(None,) * 2)
    likelihood = Likelihood(np.array([0.03, 0.08]), np.array([1e-3, 4e-3]), linear)  # type: ignore[arg-type]
    posterior = Posterior({"": PosteriorForTextValues(likelihood)})
    keys = ("crack.length", "crack.height")
    found: Any = type("Identification", (SimpleNamespace,), {})(
        unknown=keys,
        posterior=posterior,
        estimate=dict(zip(keys, posterior.best_words_and_unknowns[1].tolist(), strict=True)),
        priors={"confidence": 0.95},
        intervals={key: posterior.compute_interval(place, 0.95) for place, key in enumerate(keys)},
    )
    for key, middle, sigma in (("crack.length", 0.03, 1e-3), ("crack.height", 0.08, 4e-3)):
        [panel] = fc.draw_posterior(found, key).axes
        x, density = np.transpose(panel.lines[0].get_xydata())
        is_near = np.abs(x - middle) < 3.0 * sigma
        expected_density = np.exp(-0.5 * ((x - middle) / sigma) ** 2)
        assert is_near.sum() > 10
        np.testing.assert_allclose(density[is_near], expected_density[is_near], atol=0.02)
        shaded_x = panel.collections[0].get_paths()[0].vertices[:, 0]
        assert np.ptp(shaded_x) == pytest.approx(2.0 * 1.96 * sigma, rel=0.05)
        assert panel.collections[0].get_label() == "95 %"
        assert panel.get_xlabel() in ("crack length [mm]", "height of the crack [mm]")
    for wrong_keys in (("crack.length", "crack.length"), ("crack.depth",)):
        catch_error(
            partial(fc.draw_posterior, found, *wrong_keys),
            "x",
            wrong_keys[-1],
            names=r"crack\.length, crack\.height",
        )


class Advised(Linear):
    """The same, with a plate without a crack: what may be measured has the slopes of the first
    row."""

    @property
    def coarse_mesh_cases(self) -> Any:
        return SimpleNamespace(uncracked_cases=True)

    @property
    def uncracked_plate(self) -> Any:
        return SimpleNamespace(natural_frequencies_hz=np.array([100.0]))


@pytest.mark.parametrize("slope", [0.0, 1000.0])
def test_advice_that_gains_nothing_is_not_given(slope: float) -> None:
    """To the digits that are printed, of each unknown; neither of the plate before it had a crack
    nor of the most informative one."""
    cube = UnknownGrid((np.linspace(0.01, 0.02, 4), np.linspace(0.1, 0.2, 4)))
    matrix, offset = np.array([[slope, 0.0], [30.0, 40.0]]), np.zeros(2)
    rows = (fc.Measurement("frequency_open", 100.0, 0.1, 1),) * 2
    model = Advised(matrix, offset, cube, rows=rows)
    likelihood = Likelihood(np.zeros(2), np.array([0.1, 0.1]), model)  # type: ignore[arg-type]
    more_measurement, x = fc.Measurement("frequency_tied", 100.0, 1e-4, 1), np.array([0.015, 0.15])
    advice_text = list_advice_texts(
        likelihood,
        x,
        rank_measurements_by_information(likelihood, x, [more_measurement], (1e-3, 0.05)),
    )
    assert len(advice_text) == (2 if slope else 0)
    for text in advice_text:
        assert "crack length then ± " in text and len(set(re.findall(r"[\d.]+ [mµ]m", text))) > 1
    now = {"crack.length": 1.00001e-3, "crack.height": 2e-3}
    left = {"crack.length": np.array([1e-3]), "crack.height": np.array([1e-3])}
    [*_, text] = list_advice_texts(likelihood, x, Worth((more_measurement,), np.ones(1), left, now))
    assert text == "frequency_tied of mode 1: height of the crack then ± 1 mm instead of ± 2 mm"


class Rows(Linear):
    """Of some of the rows, which are numbers."""

    def make_predictor(self, rows: Any, more: Any = ()) -> Any:
        places = list(rows)
        return replace(self, matrix=self.matrix[places], offset=self.offset[places], rows=rows)


class Even(Linear):
    """s = (x - 5)^2, which does not tell 2 from 8."""

    def __call__(self, x: np.ndarray) -> MeasurementPredictions:
        return exact(np.column_stack([(x[:, 0] - 5.0) ** 2, x[:, 1]]))


def test_two_that_cannot_be_told_apart() -> None:
    """Both are reported, each with half of the probability."""
    cube = UnknownGrid((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    even_likelihood = Even(np.zeros((2, 2)), np.zeros(2), cube)
    likelihood = Likelihood(np.array([9.0, 4.0]), np.array([0.3, 0.2]), even_likelihood)  # type: ignore[arg-type]
    parts = Posterior({"": PosteriorForTextValues(likelihood)}).find_region_parts(0.95, 0.03)
    assert sorted(round(float(x[0]), 1) for _, x, _ in parts) == [2.0, 8.0]
    assert all(mass == pytest.approx(0.475, abs=0.02) for *_, mass in parts)


def test_soft_clamps() -> None:
    """Of a slender beam one that turns takes as much from all natural frequencies, one that moves
    (s b)^2: of the modes cosh bx - cos bx - s (sinh bx - sin bx) the moments and shear forces at
    the clamp are as b^2 and s b^3, the frequencies as b^2."""
    size = 0.006, 0.3
    changes = {
        "geometry.width": size[0], "geometry.height": size[1], "excitation.point": size,
        "output": None, "crack": None, "contact": None, "mesh.lip_elements": None,
        "mesh.layout": "grid", "mesh.size": None, "mesh.columns": 2, "mesh.rows": 60,
    }  # fmt: skip
    scene = fc.Scene.from_text(identification.SCENE)
    table = scene.given("identify")
    frequency_deviations = UncrackedPlate(
        scene.replace(changes | {"identify": None}), table
    ).compute_clamp_and_temperature_sensitivities(1.0)[0]
    roots, shares = np.array([1.8751041, 4.6940911, 7.8547574]), [0.7340955, 1.0184673, 0.9992245]
    forces = (roots * shares) ** 2
    for column, expected in ((0, 1.0), (1, forces / forces[0])):
        bending = frequency_deviations[:3, column]
        np.testing.assert_allclose(bending / bending[0], expected, rtol=0.03)
    assert np.hypot(*frequency_deviations[0, :2]) == pytest.approx(
        table.before_deviation, rel=1e-12
    )


def test_units_at_other_speeds() -> None:
    """At 9000 rpm a blade has 1.3 times the frequency of 3000: no other unit, and no other mode. A
    stiffer material moves what is elastic alone, by half of it: at rest all."""
    scene = fc.Scene.from_text(SPINNING)
    plain_scene = scene.replace({"identify": None, "crack": None, "contact": None})

    def hertz(**rotor: float | None) -> float:
        rotor_settings = {f"rotation.{key}": rotor_value for key, rotor_value in rotor.items()}
        structure = fc.build_structure(
            plain_scene.replace(rotor_settings) if rotor else plain_scene.without_rotation()
        )
        return float(fc.solve_modes(structure, 1).omega[0]) / (2.0 * np.pi)

    whole_model, fast = UncrackedPlate(plain_scene, scene.given("identify")), hertz(rpm=9000.0)
    assert fast > 1.3 * whole_model.natural_frequencies_hz[0]
    row = fc.Measurement("frequency_uncracked", fast, 0.1, 1, rpm=9000.0)
    whole_model.check_units_and_modes(fc.Measurements((row,)), [], may_be_other_plate=False)
    wrong_row = replace(row, value=2.0 * np.pi * fast)
    catch_error(
        lambda: whole_model.check_units_and_modes(
            fc.Measurements((wrong_row,)), [], may_be_other_plate=False
        ),
        "measurements.value, frequency_uncracked of mode 1 at 9000 rpm",
        names="rad/s",
    )
    young = 0.5 * scene.given("identify").young_deviation
    change_at_rest, own_change, faster = (
        whole_model.compute_prior_sensitivities(speed)[0, 0] for speed in (0.0, 1.0, 3.0)
    )
    assert change_at_rest == pytest.approx(young)
    assert own_change == pytest.approx(young * (hertz() / hertz(rpm=3000.0)) ** 2, rel=0.01)
    assert faster == pytest.approx(young * (hertz() / fast) ** 2, rel=0.01)
    # Of another modulus at another speed: all of the change to 1 %, at 0 that of the root.
    softer = plain_scene.replace(
        {"material.young": 0.98 * plain_scene.material.young, "rotation.rpm": 9000.0}
    )
    changed = fc.solve_modes(fc.build_structure(softer), 1).omega[0] / (2.0 * np.pi * fast) - 1.0
    assert whole_model.compute_frequency_factors_by_modulus(3.0, 0.98)[0] - 1.0 == pytest.approx(
        changed, rel=0.01
    )
    assert whole_model.compute_frequency_factors_by_modulus(0.0, 0.98)[0] == pytest.approx(
        np.sqrt(0.98), rel=1e-9
    )


PASSED = fc.PassageFit(
    order=5.0, omega=1500.0, omega_error=0.03, damping=2e-3, damping_error=1e-5, amplitude=6e-5,
    forces=np.ones(1), ends=np.array([[0, 300]]), omegas=np.array([1500.0]),
    omega_errors=np.array([0.03]), dampings=np.array([2e-3]), damping_errors=np.array([1e-5]),
    orders=np.array([5.0, 6.0]), margins=np.array([0.0, 50.0]), asynchronous=(), blind=(),
    stiffening=0.0,
    probes=4, scatter=2e-6, whiteness=0.4,
)  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "opened", "tied", "why"),
    [
        ({}, (0.9, 2.0), (1.02, 2.1), ""),
        ({}, (1.08, 2.0), (1.2, 2.1), ""),
        ({}, (1.12, 2.0), (1.2, 2.1), "no mode of the blade is within 10% of this"),
        ({}, (0.9, 1.03), (1.02, 1.1), "two modes are near this frequency: mode 1"),
        ({"margins": np.zeros(2)}, (0.9, 2.0), (1.02, 2.1), ""),
        ({"margins": np.zeros(2)}, (0.9, 1.19), (1.02, 1.25), "order 6 meets a mode of the blade"),
        ({"probes": 2}, (0.9, 2.0), (1.02, 2.1), ""),
        ({"probes": 2}, (0.9, 1.19), (1.02, 1.25), "order 6 meets a mode of the blade"),
    ],
)  # fmt: skip
def test_modes_of_resonances(
    changes: dict[str, Any], opened: tuple[float, ...], tied: tuple[float, ...], why: str
) -> None:
    """That between whose frequencies with lips open and tied one is, or to a tenth; and why none is
    used."""
    fit = replace(PASSED, **changes)
    frequencies = 1500.0 * np.array([opened, tied])
    diagram: Any = SimpleNamespace(interpolate_open_and_tied=lambda speed: frequencies)
    mode, said = match_mode_or_give_reason(fit, diagram)
    assert mode == (not why) and said.startswith(why) and bool(said) == bool(why)
    words = describe_passage(fit, mode, said)
    message_text = "238.732 ± 0.0048 Hz, engine order 5 at 2864.79 rpm"
    assert words == (f"not used: {message_text} ({said})" if why else f"mode 1: {message_text}")


@pytest.mark.parametrize(
    ("changes", "deviation", "why"),
    [
        (
            {"whiteness": 0.0}, 3.0,
            "another vibration is near this resonance, and frequency and damping may be wrong",
        ),
        (
            {"omegas": np.array([1500.0, 1501.0]), "omega_errors": np.full(2, 0.05)},
            0.5, "its passages differ by more than their errors: by 0.07% in frequency, "
            "which the error covers",
        ),
        (
            {"dampings": np.array([2e-3, 3e-3]), "damping_errors": np.full(2, 1e-4)},
            0.03, "its passages differ by more than their errors: in damping, 0.002 to 0.003",
        ),
    ],
)  # fmt: skip
def test_resonances_in_doubt(changes: dict[str, Any], deviation: float, why: str) -> None:
    """Are known to half of their width, or to half of what their passages differ by, as those of a
    crack may, and this is said."""
    fit = replace(PASSED, **changes)
    [row] = fc.Measurements.from_passages([fit, PASSED], [1, 0]).rows
    assert row.deviation == pytest.approx(deviation / (2.0 * np.pi))
    assert row.value == pytest.approx(1500.0 / (2.0 * np.pi))
    assert describe_passage(fit, 1, "").endswith(f"Hz, engine order 5 at 2864.79 rpm ({why})")


# --- displacements at probes ----------------------------------------------------------------------


def displaced(phases: np.ndarray, values: np.ndarray) -> list[fc.Measurement]:
    """Displacements with a standard deviation of 1e-8 m."""
    return [
        fc.Measurement("displacement", value, 1e-8, frequency=100.0, phase=phase)
        for phase, value in zip(phases.tolist(), values.tolist(), strict=True)
    ]


def test_displacements_whatever_the_load_is() -> None:
    """A wave 1.7 times as large, 2.5 rad later and shifted by 3 um is that of the model; one with
    another second harmonic is not. Slopes and free directions, by differences."""
    rng = np.random.default_rng(2)
    wave = 1e-5 * (rng.normal(size=6) + 1j * rng.normal(size=6)) / np.arange(1, 7) ** 2
    wave[1] *= 6.0  # larger than the first one, as at a superharmonic resonance
    phases = np.sort(rng.uniform(0.0, 2.0 * np.pi, 12))
    orders = np.arange(1, 7)

    def motion(waves: np.ndarray, size: float, shift: float) -> np.ndarray:
        turns = np.exp(1j * np.multiply.outer(phases - shift, orders))
        return np.asarray(size * (turns @ waves).real)

    made = displaced(phases, motion(wave, 1.7, 2.5) + 3e-6)
    passages = ProbeDisplacements(range(12), made, [])
    both = np.stack([wave, wave * [1, 2, 1, 1, 1, 1]])
    values, turns, free, _ = passages.fit_load_to_displacements(both)
    errors = np.abs(values - [row.value for row in made])
    assert errors[0].max() < 1e-9 and errors[1].max() > 1e-6
    steps = 1.7 * 1e-3, 1e-3, 1e-8  # of size, phase and constant
    expected = [motion(wave, 1.7 * 1.001, 2.5), motion(wave, 1.7, 2.501)]
    for place, (step, after) in enumerate(zip(steps, expected, strict=False)):
        scale = (1.0 / 1.7, np.pi / np.sqrt(3.0))[place]
        difference = (after - motion(wave, 1.7, 2.5)) / step
        size = np.abs(difference).max()
        np.testing.assert_allclose(
            free[0, :, place] * (scale if place == 0 else 1.0 / scale), difference,
            atol=2e-3 * size,
        )  # fmt: skip
    step = 1e-9 * (1.0 + 2.0j) * np.eye(6)[2]
    np.testing.assert_allclose(
        (turns[0] @ step).real, motion(wave + step, 1.7, 2.5) - motion(wave, 1.7, 2.5),
        atol=1e-12,
    )  # fmt: skip


def test_arrivals_become_displacements(tmp_path: Path) -> None:
    """At the phase of the arrival itself, with the standard error of the mean of each probe."""
    probes, radius, speed, order = np.radians([10.0, 95.0, 200.0, 310.0]), 0.5, 100.0, 4
    rng, marks = np.random.default_rng(4), 2.0 * np.pi / speed * np.arange(51)

    def motion(angle: np.ndarray) -> np.ndarray:
        return 1e-4 * np.cos(order * angle) + 3e-5 * np.sin(2 * order * angle)

    angles = passing_angles(probes + np.zeros((50, 1)), motion, radius)
    u = motion(angles)
    time = marks[:-1, None] + angles / speed + 2e-8 * rng.normal(size=angles.shape)
    arrivals = fc.ArrivalTimes(time, marks, probes, radius)
    measurements = fc.Measurements.from_arrivals(arrivals, order, "tip.ux")
    for row, angle, value in zip(measurements.rows, angles[0], u[0], strict=True):
        assert row.deviation == pytest.approx(2e-8 * radius * speed / math.sqrt(50.0), rel=0.2)
        assert abs(row.value - value) < 4.0 * row.deviation
        assert row.phase == pytest.approx(order * angle % (2.0 * np.pi), abs=1e-5)
        assert row.frequency == pytest.approx(400.0 / (2.0 * np.pi)) and row.point == "tip.ux"
    wrong_time = time.copy()
    wrong_time[[7, 20], 2] -= 2e-5  # another blade, or a pulse of something else
    skewed_measurements = fc.Measurements.from_arrivals(replace(arrivals, time=wrong_time), order)
    for row, value in zip(skewed_measurements.rows, u[0], strict=True):
        assert row.deviation < 1.5 * measurements.rows[0].deviation
        assert abs(row.value - value) < 4.0 * row.deviation
    measurements.to_csv(tmp_path / "m.csv")
    assert str(fc.Measurements.from_csv(tmp_path / "m.csv").rows) == str(measurements.rows)
    [other_row, *_] = fc.Measurements.from_arrivals(
        arrivals, order, against=True, noise=1e-6, angle_deviation=1e-5
    ).rows
    assert other_row.value == -measurements.rows[0].value
    expected_deviation = radius * math.hypot(1e-6 * speed / math.sqrt(50.0), 1e-5)
    assert other_row.deviation == pytest.approx(expected_deviation)
    catch_error(lambda: fc.Measurements.from_arrivals(arrivals.between(3, 4), order), "noise", None)
    catch_error(
        lambda: fc.Measurements.from_arrivals(
            fc.ArrivalTimes(time[:, :3], marks, probes[:3], radius), order
        ),
        "arrivals",
        names="4 probes",
    )
    catch_error(
        lambda: fc.Measurements.from_arrivals(
            fc.ArrivalTimes(time[:3], np.array([0.0, 0.06, 0.13, 0.19]), probes, radius), order
        ),
        "arrivals",
    )


@pytest.mark.parametrize("revolutions", [3, pytest.param(6, marks=pytest.mark.nightly)])
def test_displacements_of_few_revolutions_have_true_errors(revolutions: int) -> None:
    """Of 100 records their deviations are one of those stated in root mean square; they were 1.28
    and 1.16, of tails that few arrivals have by chance, and of a scatter that they hardly tell."""
    probes, radius, speed, order = np.radians([10.0, 95.0, 200.0, 310.0]), 0.5, 100.0, 4
    marks = 2.0 * np.pi / speed * np.arange(revolutions + 1)
    targets, errors = probes + np.zeros((revolutions, 1)), []
    angles = passing_angles(targets, lambda angle: 1e-4 * np.cos(order * angle), radius)
    u = 1e-4 * np.cos(order * angles)
    for seed in range(100):
        noise = 2e-8 * np.random.default_rng(seed).normal(size=angles.shape)
        arrivals = fc.ArrivalTimes(marks[:-1, None] + angles / speed + noise, marks, probes, radius)
        rows = fc.Measurements.from_arrivals(arrivals, order).rows
        errors += [
            (row.value - value) / row.deviation for row, value in zip(rows, u[0], strict=True)
        ]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.1)


# --- measurements ---------------------------------------------------------------------------------

TABLE = """\
# measured on Monday
quantity,value,deviation,mode,frequency [Hz],point
frequency_bilinear,841.1,0.8,1,,
ratio_2_1,0.02,0.001,,250,tip.ux
"""


def test_measurements_from_a_file(tmp_path: Path) -> None:
    """Read, and as they are written; arrays make the same."""
    path = tmp_path / "measured.csv"
    path.write_text(TABLE)
    found = fc.Measurements.from_csv(path)
    assert [row.name for row in found.rows] == [
        "frequency_bilinear of mode 1", "ratio_2_1 at 250 Hz of tip.ux",
    ]  # fmt: skip
    found.to_csv(path)
    assert repr(fc.Measurements.from_csv(path).rows) == repr(found.rows)  # nan differs from nan
    assert str(found.rows) == str(fc.Measurements.from_csv(path).rows)  # nan is not equal to nan
    arrays = fc.Measurements.from_arrays("frequency_bilinear", [841.1], 0.8, mode=[1])
    assert str(arrays.rows[0]) == str(found.rows[0])
    own_measurements = fc.Measurements.from_arrays(
        "frequency_open", [841.1, 5e3], 0.8, mode=np.array([1, 2])
    )
    assert [row.mode for row in own_measurements.rows] == [1, 2]


def test_phases_in_degrees() -> None:
    """Are refused, and written as they should be."""
    columns = {"frequency": 100.0, "point": "tip.ux"}
    fc.Measurement("displacement", -1e-5, 1e-7, phase=-2.0, **columns)  # type: ignore[arg-type]
    catch_error(
        lambda: fc.Measurement("displacement", -1e-5, 1e-7, phase=90.0, **columns),
        "measurements.phase",
        90.0,
        names=r"1\.5708",
    )


BAD_ROWS: list[tuple[str, str, Any, str | None]] = [
    ("frequency_bilinear,841,0.8,7,,", "measurements.mode", 7, "1 to 6"),
    ("frequency_bilinear,841,0.8,,250,", "measurements.mode", 0, "1 to 6"),
    ("frequency_bilinear,841,0,1,,", "measurements.deviation", 0.0, "> 0"),
    ("frequency_bilinear,841,1e-200,1,,", "measurements.deviation", 1e-200, "1e-30"),
    ("frequency_bilinear,1e300,1,1,,", "measurements.value", 1e300, "1e-30"),
    ("frequency,841,1,1,,", "measurements.quantity", "frequency", "'frequency_open', "),
    ("ratio_2_1,x,1,,250,", "measurements.value", "x", "line 3"),
    ("ratio_2_1,0.1,0.1,,,tip.ux", "measurements.frequency", np.nan, "> 0"),
    ("ratio_2_1,0.1,0.1", "measurements, line 3", "ratio_2_1,0.1,0.1", "6 cells"),
    ("displacement,-1e-5,1e-7,,250,", "measurements.phase", np.nan, None),
    (
        "frequency_open,841,1,1,,\nfrequency_open,850,1,1,,",
        "measurements, frequency_open of mode 1",
        [841.0, 850.0],
        None,
    ),
]


@pytest.mark.parametrize(("rows", "key", "value", "names"), BAD_ROWS, ids=range(len(BAD_ROWS)))
def test_rows_that_cannot_be_used(
    tmp_path: Path, rows: str, key: str, value: Any, names: str | None
) -> None:
    """One line says what is wrong."""
    path = tmp_path / "measured.csv"
    path.write_text(TABLE.split("frequency_bilinear")[0] + rows)
    catch_error(lambda: fc.Measurements.read(path), key, value, names=names)


BAD_TABLES: list[tuple[str, str, str | None]] = [
    ("", ": no columns", "quantity, value, deviation"),
    ("# none\n", ": no columns", "quantity, value, deviation"),
    ("a,b\n", ": the columns a, b", "quantity, value, deviation"),
    # Numbers that may be read in two ways, and units that the program does not convert.
    ("quantity,value,deviation,mode\nfrequency_open,841,1,0,8,1", "", "line 2 "),
    ("quantity;value;deviation;mode\nfrequency_open;1,234;1,000;1", "", ": 1,234;"),
    ("quantity;value;deviation;mode\nfrequency_open;841,5;0.8;1", "", r": 0\.8 and 841,5;"),
    ("quantity;value;deviation;mode\nfrequency_open;1.841,5;1;1", "", r": 1\.841,5;"),
    (
        "quantity;value,deviation\nfrequency_open;1;1",
        ": the columns quantity;value, deviation",
        None,
    ),
    ("quantity,value [mm],deviation\nharmonic_1,1,1", ": the column value [mm]", "Hz or m or -"),
    (
        "quantity,value,deviation,frequency [rad/s]\nfrequency_open,1,1,4400",
        ": the column frequency [rad/s]",
        "Hz$",
    ),
    (
        "quantity,value,deviation,phase [turn]\nfrequency_open,1,1,90",
        ": the column phase [turn]",
        "rad$",
    ),
    ("quantity,value,deviation,mode [-]\nfrequency_open,1,1,1", ": the column mode [-]", None),
]


@pytest.mark.parametrize(("text", "place", "names"), BAD_TABLES, ids=range(len(BAD_TABLES)))
def test_tables_that_cannot_be_used(
    tmp_path: Path, text: str, place: str, names: str | None
) -> None:
    """One line says what is wrong, and where."""
    path = tmp_path / "measured.csv"
    path.write_text(text)
    catch_error(lambda: fc.Measurements.read(path), "measurements", f"{path}{place}", names=names)


def test_a_cell_with_a_line_break(tmp_path: Path) -> None:
    """Leaves an empty row."""
    path = tmp_path / "measured.csv"
    path.write_text('quantity,value,deviation,mode\nfrequency_open,1,1,"1\n"')
    catch_error(
        lambda: fc.Measurements.read(path), "measurements, line 3", "", names="4 cells: quantity, "
    )


def test_harmonics_that_the_model_does_not_have() -> None:
    """A ratio of the third one is none of a scene with two; with a tolerance, which may choose two
    for a case, it is not, either. A displacement is compared with what there is."""
    scene = fc.Scene.from_text(identification.SCENE).replace({"harmonic_balance.harmonics": 2})
    columns = {"frequency": 700.0, "point": "tip.ux"}
    third = fc.Measurement("ratio_3_1", 1e-3, 1e-4, **columns)
    for changed_scene in (scene, scene.replace({"harmonic_balance.tolerance": 0.01})):
        for row in (third, replace(third, quantity="harmonic_3")):
            catch_error(
                partial(fc.Measurements((row,)).check, changed_scene),
                "harmonic_balance.harmonics",
                2,
                names=f" 3 for {row.quantity}$",
            )
    fits = [fc.Measurement("ratio_2_1", 1e-3, 1e-4, **columns), *displaced(np.zeros(1), np.ones(1))]
    fc.Measurements(tuple(fits)).check(scene)
    fc.Measurements((third,)).check(scene.replace({"harmonic_balance.harmonics": 3}))


# --- what is said, and what is not known --------------------------------------------------------


def test_remark_on_the_size_of_the_load() -> None:
    """With a clearance or a steady force the shape of a motion depends on it; amplitudes always."""
    scene = fc.Scene.from_text(identification.SCENE)
    row = fc.Measurement("ratio_2_1", 0.1, 0.01, frequency=700.0)
    assert list_measurement_shortcoming_remarks(scene, fc.Measurements((row,))) == ()
    for key, value in {"crack.clearance": 1e-6, "excitation.force_mean": (0.0, 5.0)}.items():
        changed_scene = scene.replace({key: value})
        [remark] = list_measurement_shortcoming_remarks(changed_scene, fc.Measurements((row,)))
        assert remark.startswith("with a clearance or a steady load")
        assert (
            list_measurement_shortcoming_remarks(
                changed_scene, fc.Measurements((replace(row, quantity="harmonic_1"),))
            )
            == ()
        )


def test_an_inclined_crack_acts_at_its_tip(tmp_path: Path) -> None:
    """What 10 degrees change of four frequencies is what a straight crack at the height of the tip
    changes; so much is its height less sure by an angle."""
    scene = fc.Scene.from_text(identification.SCENE)
    length, height, rise = 0.025, 0.1, np.tan(np.radians(10.0))
    keys = ("geometry.width", "geometry.height", "crack.edge", "crack.height", "crack.length",
            "mesh.size", "mesh.lip_elements", "identify", "output")  # fmt: skip
    files = dict.fromkeys(keys) | {"mesh.layout": "file"}

    def logs(changes: dict[str, object]) -> np.ndarray:
        modes = fc.solve_modes(fc.build_structure(scene.replace(changes)), 4)
        return np.log(modes.omega)

    log_changes = []
    for side in (1.0, -1.0):
        path = tmp_path / "inclined.msh"
        identification.inclined_mesh(np.array([length, height]), side * 10.0, path)
        tilted = logs(files | {"mesh.file": str(path)})
        straight = logs({"crack.length": length, "crack.height": height + side * rise * length})
        log_changes.append((side * tilted, side * straight))
    tilted, straight = np.sum(log_changes, axis=0)
    assert 0.8 < tilted @ straight / (straight @ straight) < 1.15
    deviations = compute_crack_geometry_deviations(
        np.array([[length, height]]), ("crack.length", "crack.height"), scene
    )
    assert deviations[0, 1] == pytest.approx(length * np.tan(np.radians(5.0)))


def test_tables_of_spreadsheets(tmp_path: Path) -> None:
    """Semicolons, tabs, decimal commas, numbered rows and other units: the same measurements."""
    (path := tmp_path / "table.csv").write_text(TABLE)
    rows, lines = fc.Measurements.from_csv(path).rows, TABLE.splitlines()[1:]
    numbered_lines = [",".join(pair) for pair in zip(["", "0", "1"], lines, strict=True)]
    for text in (
        "\n".join(lines).replace(",", ";").replace("0.", "0,").replace("841.", "841,"),
        "\n".join(lines).replace(",", "\t"),
        "\n".join(numbered_lines).replace("[Hz]", "(kHz)").replace("250", "0.25"),
    ):
        path.write_text(text)
        assert str(fc.Measurements.from_csv(path).rows) == str(rows)
    path.write_text(
        "quantity,value,deviation,frequency,phase [deg]\ndisplacement,-1e-3,1e-5,9,90\n"
    )
    assert fc.Measurements.from_csv(path).rows[0].phase == pytest.approx(0.5 * np.pi)


# --- sweeps that end early, and comparisons by the command --------------------------------------


@pytest.fixture
def little(not_laid_out: None, tmp_path: Path) -> list[str]:
    """The words of a command for one unknown and a frequency; its results are in "out"."""
    return command_of_one_unknown(tmp_path)


@pytest.mark.nightly
def test_stops_at_ctrl_c(
    little: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """Nothing is inferred from a part of a sweep, and no other sweep begins; the same call goes on
    with it."""
    left = 2

    def interrupted(record: Callable[..., None], *arguments: Any) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            signal.raise_signal(signal.SIGINT)
        record(*arguments)

    wrap(
        monkeypatch,
        "fenics_crack.sweep.file.SweepFile.write_cases_unless_already_stored",
        interrupted,
    )
    messages = run_command(*little, code=3).err
    assert "fenics-crack: identification was stopped; run the same command again" in messages
    [path] = (tmp_path / "out").iterdir()  # no file of what was found
    assert np.count_nonzero(SweepResult.load(path)["state"]) == 2
    left = 1
    catch_error(
        lambda: fc.identify(
            fc.Scene.load(tmp_path / "plate.toml"), tmp_path / "m.csv", folder=tmp_path / "out"
        ),
        kind=StoppedError,
    )
    assert np.count_nonzero(SweepResult.load(path)["state"]) == 3
    left = 1  # in the sweep's last case
    assert main(little) == 3
    assert SweepResult.load(path).complete and [*(tmp_path / "out").iterdir()] == [path]
    assert main(little) == 0
    assert (tmp_path / "out" / "identify.json").exists()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.drawn(1)
@pytest.mark.parametrize(("lost", "used"), [([2], True), ([4], False), ([1, 2], False)])
def test_cases_that_failed(
    lost: list[int],
    used: bool,
    little: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run_command: RunCommand,
) -> None:
    """They are said, and the exit code is that of a sweep with failed cases. The harmonics of one
    between others are made up for; of one at an end, or of too many, what needs them is left out,
    and the answer, with its evidences, is that of the other measurements."""

    def failing(
        record: Callable[..., None], file: Any, numbers: np.ndarray, cases: list[dict[str, Any]]
    ) -> None:
        for case in (one for at, one in zip(numbers, cases, strict=True) if at in lost):
            for name in [name for name in case if not name.startswith("omega_")]:
                del case[name]
            case["status"] = "no luck"
        record(file, numbers, cases)

    wrap(
        monkeypatch, "fenics_crack.sweep.file.SweepFile.write_cases_unless_already_stored", failing
    )
    scene = fc.Scene.load(tmp_path / "plate.toml").replace(
        {"identify.unknown": {"crack.length": [0.01, 0.015, 0.02, 0.025, 0.03]}}
    )
    (tmp_path / "plate.toml").write_text(scene.as_toml())
    single_measurements = fc.Measurements.read(tmp_path / "m.csv")
    ratio = fc.Measurements.from_arrays("ratio_2_1", [0.01], 1e-3, frequency=[700.0])
    (single_measurements + ratio).to_csv(tmp_path / "m.csv")
    messages = run_command(*little, code=3).err
    value = (0.01, 0.015, 0.02, 0.025, 0.03)[lost[0]]
    assert f"failed, the first at length = {value}, frequency = 700.0: no luck" in messages
    assert ("ratio_2_1 at 700 Hz is not used: too few" in messages) == (not used)
    assert ("ratio_2_1" in (tmp_path / "out" / "fit.csv").read_text()) == used
    written_text = (tmp_path / "out" / "identify.json").read_text()
    summary = json.loads(written_text)
    assert "no luck" in summary["warnings"][0] and "NaN" not in written_text
    repeated_identification = fc.identify(scene, single_measurements, folder=tmp_path / "out")
    is_same = (repeated_identification.estimate, repeated_identification.log_bayes_factor) == (
        summary["estimate"], summary["log_bayes_factor"]
    )  # fmt: skip
    assert is_same == (not used) and not repeated_identification.doubts
    if not used:
        catch_error(
            lambda: fc.identify(scene, ratio, folder=tmp_path / "out"),
            names=r"no measurement can be .* no luck",
            kind=fc.ConvergenceError,
        )


def test_arrivals_of_a_solid_are_its_circumferential_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: RunCommand
) -> None:
    """A box that turns about x passes the probes along z: what is compared with them."""
    tables = {
        "rotation": {"rpm": 1500.0, "hub_radius": 0.2},
        "excitation": {"order": 12},
        "tip_timing": {"probes": [0.0], "tip_radius": 0.29},
        "output": {"points": {"tip": [0.03, 0.09, 0.0]}},
        "identify": {"unknown": {"crack.depth": {"start": 0.001, "stop": 0.004, "count": 4}}},
        "crack": {"edge": "left", "height": 0.03, "length": 0.02, "depth": 0.002},
        "contact": {"law": "unilateral"},
        "loads": [{"edge": "front", "pressure_cos": 100.0}],
        "geometry": {"kind": "solid", "width": 0.03, "height": 0.09, "thickness": 0.006},
        "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
        "damping": {"ratio": 0.005},
        "mesh": {"layout": "graded", "order": 2, "size": 0.008, "lip_elements": 3},
        "reduction": {"modes": 10},
    }
    box = fc.Scene.from_mapping(tables)
    turn, rng = 60.0 / 1500.0, np.random.default_rng(0)
    marks = turn * np.arange(6.0)
    time = marks[:-1, None] + turn * PROBES / (2.0 * np.pi) + 1e-8 * rng.normal(size=(5, 9))
    fc.ArrivalTimes(time, marks, PROBES, 0.29).to_csv(tmp_path / "a.csv")
    identify = Mock(side_effect=fc.InputError("identify", None, "asked for no more"))
    monkeypatch.setattr("fenics_crack.monitoring.identification.identify.identify", identify)
    words, values = ["identify", box, "--arrivals", tmp_path / "a.csv", "--output", tmp_path], []
    options = [
        f"tip_timing.tangential={share}" for share in (1.0, -0.5)
    ]  # of u_x, along or against
    for sets, point in (([], "tip.uz"), (options[:1], "tip.ux"), (options[1:], "tip.ux")):
        run_command(*words, sets=sets, code=2)
        rows = identify.call_args.args[1].rows
        assert [row.point for row in rows] == [point] * len(PROBES)
        values.append([row.value for row in rows])
    assert values[2] == pytest.approx([-value for value in values[1]])
