"""Interpolation, likelihood and regions against closed forms and other methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

import fenics_crack as fc
from fenics_crack.identification.interpolation import Cube, Interpolation, Way, left_out_errors
from fenics_crack.identification.posterior import Likelihood, Posterior, explore
from fenics_crack.identification.where import worth_of

SQUARE = Cube((np.linspace(0.0, 2.0, 6), np.linspace(1.0, 3.0, 7)))


@pytest.mark.parametrize("kernel", ["thin_plate_spline", "cubic", "quintic"])
@pytest.mark.parametrize("smoothing", [0.0, 1e-4])
def test_errors_at_nodes_left_out(kernel: str, smoothing: float) -> None:
    """Rippa's formula, against SciPy's interpolation of all other nodes."""
    nodes = SQUARE.scaled(SQUARE.nodes, False)
    values = np.column_stack([np.sin(3.0 * nodes[:, 0] + nodes[:, 1] ** 2), nodes.prod(axis=1)])
    errors = left_out_errors(nodes, values, Way(kernel, smoothing, False))
    degree = 2 if kernel == "quintic" else 1
    for place in (0, 9, 24, 41):
        others = np.arange(len(nodes)) != place
        spline = RBFInterpolator(
            nodes[others], values[others], kernel=kernel, degree=degree, smoothing=smoothing
        )
        expected = values[place] - spline(nodes[[place]])[0]
        np.testing.assert_allclose(errors[place], expected, rtol=1e-5, atol=1e-9)


def test_stated_error_of_the_interpolation() -> None:
    """Nine in ten errors are within three of the stated standard deviations, and nan
    at some nodes leaves the others alone."""
    nodes = SQUARE.nodes
    values = np.column_stack([np.sin(2.0 * nodes[:, 0]) * nodes[:, 1], nodes[:, 0] + nodes[:, 1]])
    values[5, 1] = np.nan
    found = Interpolation(SQUARE, values)
    x = SQUARE.low + (SQUARE.high - SQUARE.low) * np.random.default_rng(3).random((200, 2))
    predicted, deviation = found(x)
    exact = np.column_stack([np.sin(2.0 * x[:, 0]) * x[:, 1], x.sum(axis=1)])
    assert np.mean(np.abs(predicted - exact)[:, 0] < 3.0 * deviation[:, 0]) > 0.9
    np.testing.assert_allclose(predicted[:, 1], exact[:, 1], atol=1e-9)
    too_few = Interpolation(SQUARE, np.where(np.arange(42)[:, None] < 3, 1.0, np.nan))
    assert np.all(np.isinf(too_few(x)[1]))


@dataclass
class Linear:
    """Predictions s = A x + b without an error, in place of those of a forward model."""

    matrix: np.ndarray
    offset: np.ndarray
    cube: Cube
    keys: tuple[str, ...] = ("crack.length", "crack.height")

    @property
    def model(self) -> Any:
        return self

    def quantities(self, rows: Any) -> Any:
        return Linear(self.matrix[: len(rows)], self.offset[: len(rows)], self.cube)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = x @ self.matrix.T + self.offset
        return values, np.zeros_like(values)


def test_linear_model() -> None:
    """Estimate, intervals, region, evidence and gain of a Gaussian posterior in closed form."""
    matrix = np.array([[1.0, 0.2], [0.3, 1.0], [1.0, 1.0]])
    cube = Cube((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    truth, deviations = np.array([3.0, 8.0]), np.array([0.1, 0.2, 0.15])
    likelihood = Likelihood(
        matrix @ truth + 5.0,
        deviations,
        Linear(matrix, np.full(3, 5.0), cube),  # type: ignore[arg-type]
    )
    posterior = Posterior({"": explore(likelihood)})
    weights = matrix / deviations[:, None]
    covariance = np.linalg.inv(weights.T @ weights)
    np.testing.assert_allclose(posterior.best[1], truth, atol=1e-6)
    for place in range(2):
        sigma = math.sqrt(covariance[place, place])
        low, high = posterior.interval(place, 0.95)
        assert low == pytest.approx(truth[place] - 1.96 * sigma, abs=0.05 * sigma)
        assert high == pytest.approx(truth[place] + 1.96 * sigma, abs=0.05 * sigma)
        assert posterior.spread(place) == pytest.approx(sigma, rel=0.02)
    # Of two unknowns: chi^2 < 5.991 holds 95 %.
    assert posterior.level(0.95) == pytest.approx(-0.5 * 5.991, rel=0.05)
    volume = 2.0 * math.pi * math.sqrt(np.linalg.det(covariance))
    assert posterior.log_evidence == pytest.approx(math.log(volume / 200.0), abs=0.02)
    assert [round(part[2], 2) for part in posterior.parts(0.95, 0.03)] == [0.95]
    again = fc.Measurement("harmonic_1", 1.0, 0.1, frequency=10.0)
    worth = worth_of(likelihood, truth, [again], (1e-3, 0.05))
    more = np.linalg.inv(
        weights.T @ weights + np.outer(matrix[0], matrix[0]) / 0.01 + np.diag([0.12, 0.03])
    )
    assert worth.deviations["crack.length"][0] == pytest.approx(math.sqrt(more[0, 0]), rel=1e-3)
    before = np.linalg.inv(weights.T @ weights + np.diag([0.12, 0.03]))
    gain = 0.5 * math.log(np.linalg.det(before) / np.linalg.det(more))
    assert worth.information[0] == pytest.approx(gain, rel=1e-3)


class Even(Linear):
    """s = (x - 5)^2, which does not tell 2 from 8."""

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.column_stack([(x[:, 0] - 5.0) ** 2, x[:, 1]])
        return values, np.zeros_like(values)


def test_two_that_cannot_be_told_apart() -> None:
    """Both are reported, each with half of the probability."""
    cube = Cube((np.linspace(0.0, 10.0, 4), np.linspace(0.0, 20.0, 4)))
    even = Even(np.zeros((2, 2)), np.zeros(2), cube)
    likelihood = Likelihood(np.array([9.0, 4.0]), np.array([0.3, 0.2]), even)  # type: ignore[arg-type]
    parts = Posterior({"": explore(likelihood)}).parts(0.95, 0.03)
    assert sorted(round(float(x[0]), 1) for _, x, _ in parts) == [2.0, 8.0]
    assert all(mass == pytest.approx(0.475, abs=0.02) for *_, mass in parts)


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
    assert fc.Measurements.from_csv(path).rows == fc.Measurements.from_csv(path).rows
    assert str(found.rows) == str(fc.Measurements.from_csv(path).rows)  # nan is not equal to nan
    arrays = fc.Measurements.from_arrays("frequency_bilinear", [841.1], 0.8, mode=[1])
    assert str(arrays.rows[0]) == str(found.rows[0])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("frequency_bilinear,841,0.8,7,,", "measurements.mode = 7: must be a whole number"),
        ("frequency_bilinear,841,0.8,,250,", "measurements.mode = 0"),
        ("frequency_bilinear,841,0,1,,", "measurements.deviation = 0.0"),
        ("frequency,841,1,1,,", "measurements.quantity = 'frequency': must be one of"),
        ("ratio_2_1,x,1,,250,", "measurements.value = 'x': must be a finite number (line 3)"),
        ("ratio_2_1,0.1,0.1,,,tip.ux", "measurements.frequency = nan"),
        ("ratio_2_1,0.1,0.1", "measurements, line 3 = 'ratio_2_1,0.1,0.1': must be 6 cells"),
    ],
)
def test_lines_that_cannot_be_used(tmp_path: Path, line: str, message: str) -> None:
    """One line says what is wrong."""
    path = tmp_path / "measured.csv"
    path.write_text("\n".join([*TABLE.splitlines()[:2], line]))
    with pytest.raises(fc.InputError) as error:
        fc.Measurements.from_csv(path)
    assert message in str(error.value)


def test_tip_fit_becomes_measurements() -> None:
    """The ratio of the harmonics that a fit finds, at the load's frequency."""
    fit = fc.TipFit(
        order=4.0, order_error=0.0, speed=100.0, multiples=np.array([1.0, 2.0]),
        coefficients=np.array([0.0, 3e-5, 4e-5, 1e-5, 0.0]), covariance=1e-14 * np.eye(5),
        scatter=1e-7, misfit=0.5, candidates=None,  # type: ignore[arg-type]
    )  # fmt: skip
    [row] = fc.Measurements.from_tip_fit(fit, "tip.ux").rows
    assert row.quantity == "ratio_2_1" and row.value == pytest.approx(0.2)
    assert row.frequency == pytest.approx(400.0 / (2.0 * math.pi))
    assert row.deviation == pytest.approx(1e-7 / 5e-5 * math.hypot(1.0, 0.2), rel=1e-6)
