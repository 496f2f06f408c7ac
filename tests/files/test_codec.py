"""Results that stand by themselves come back as they were; what is none is refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catch_error, changed
from rotating import cracked
from surroundings import DEMOS, main

import fenics_crack as fc
from fenics_crack.files.store import SavableResult

pytestmark = pytest.mark.usefixtures("not_drawn")

DISK = fc.Scene.load(DEMOS / "bladed_disk.toml").replace(
    {"mesh.size": 0.012, "mesh.lip_elements": 3, "disk.sectors": 6, "disk.cracked": []}
)
PROBES = np.radians([12.0, 47.0, 93.0, 131.0, 200.0])


def record(speeds: np.ndarray, order: float = 4.0) -> fc.ArrivalTimes:
    """Arrivals of a blade that vibrates by 0.5 mm at its resonance of 100 Hz, and by noise."""
    marks = np.append(0.0, np.cumsum(2.0 * np.pi / speeds))
    alpha = PROBES / (2.0 * np.pi)
    time = marks[:-1, None] + np.diff(marks)[:, None] * alpha
    omega, own = order * speeds[:, None], 200.0 * np.pi
    size = 5e-4 / (1.0 - (omega / own) ** 2 + 0.02j * omega / own) / 50.0
    displacement = np.real(size * np.exp(1j * order * PROBES))
    displacement += np.random.default_rng(1).normal(0.0, 1e-6, displacement.shape)
    return fc.ArrivalTimes(time - displacement / (0.5 * speeds[:, None]), marks, PROBES, 0.5)


def of_one_speed() -> fc.Timing:
    """An order of two blades."""
    arrivals = {blade: record(np.full(40, 150.0)) for blade in (1, 3)}
    fits = {blade: fc.fit_order(blade_times, [3, 4, 5]) for blade, blade_times in arrivals.items()}
    return fc.Timing(None, arrivals, fits, ("doubtful",))


def of_run_up() -> fc.Timing:
    """A known order."""
    arrivals = record(np.linspace(120.0, 200.0, 90))
    return fc.Timing(None, {1: arrivals}, {1: fc.track_order(arrivals, 4)})


def of_resonances() -> fc.Timing:
    """Those of a run-up."""
    arrivals = record(np.linspace(140.0, 175.0, 250))
    return fc.Timing(None, {2: arrivals}, {2: fc.find_passages(arrivals, [3, 4])})


RESULTS: dict[str, Callable[[], SavableResult]] = {
    "campbell": lambda: fc.campbell(cracked(100.0), [0.0, 130.0, 400.0], 2),
    "nodal_diameters": lambda: fc.nodal_diameters(DISK),
    "amplification": lambda: fc.amplification(DISK, 3, 0.01),
    "timing": of_one_speed,
    "timing_track": of_run_up,
    "timing_passages": of_resonances,
}


def same(one: Any, two: Any) -> bool:
    """Return True if all fields are equal, nan included; functions are left out."""
    if is_dataclass(one) and not isinstance(one, fc.Scene):
        names = [item.name for item in fields(one)]
        return all(same(getattr(one, name), getattr(two, name)) for name in names)
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(same(one[key], two[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, np.ndarray):
        assert one.dtype.kind == two.dtype.kind and one.shape == two.shape
        return np.array_equal(one, two, equal_nan=one.dtype.kind != "U")
    return callable(one) or one == two or (one != one and two != two)


RATIOS = {
    "blade", "conditions", "coriolis", "cracked", "damping_errors", "dampings", "deviation", "ends",
    "equivalent", "factor", "first", "hidden", "margins", "multiples", "order", "orders", "sectors",
    "seed",
}  # fmt: skip
"""Fields without a unit."""


def is_ratio(item: h5py.Dataset) -> bool:
    """Return True if a dataset is of words, a count or a ratio."""
    words = h5py.check_string_dtype(item.dtype) is not None
    return words or item.name.strip("/").rpartition(".")[2] in RATIOS


@pytest.mark.drawn(3)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.nightly] * (name == "amplification"))
        for name in RESULTS
    ],
)
def test_result_comes_back(name: str, tmp_path: Path) -> None:
    """Every field, and what is computed from them."""
    result, path = RESULTS[name](), tmp_path / f"{name}.h5"
    result.save(path)
    result_of_file = type(result).load(path)
    assert same(result, result_of_file) and repr(result_of_file) == repr(result)
    assert result_of_file.table().rows == result.table().rows or "nan" in str(result.table().rows)
    if isinstance(result, fc.Campbell) and isinstance(result_of_file, fc.Campbell):
        assert result_of_file.crossings(1, "real") == pytest.approx(
            result.crossings(1, "real"), rel=1e-9
        )
    with h5py.File(path) as file:
        plain_keys = [
            key for key, item in file.items() if not (item.attrs.get("unit") or is_ratio(item))
        ]
    assert not plain_keys
    assert main(["plot", str(path), "--quiet", "--output", str(tmp_path)]) in (0, 2)


@pytest.mark.parametrize("kind", ["modes", "solution"])
def test_arrays_are_finite(kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Each array of a file with nan is refused by its name, and nothing is drawn."""
    path, scene = tmp_path / f"{kind}.h5", cracked(100.0).replace({"harmonic_balance.harmonics": 3})
    run: fc.Run[Any] = fc.modes(scene, 2) if kind == "modes" else fc.solve(scene)
    run.save(path)
    content = path.read_bytes()
    with h5py.File(path) as file:
        names = [name for name, item in file.items() if item.ndim and item.dtype.kind == "f"]
    assert names
    for name in names:
        path.write_bytes(content)
        with changed(path) as file:
            file[name][...] = np.nan
        assert main(["plot", str(path), "--quiet"]) == 2
        [line] = capfd.readouterr().err.splitlines()
        assert str(path) in line and f"'{name}'" in line and "finite" in line


def test_unknown_numbers_come_back(tmp_path: Path) -> None:
    """The condition number of an order that the probes cannot measure, and a missing arrival."""
    timing = of_one_speed()
    timing.arrivals[1].time[3, 2], timing.fits[1].candidates.conditions[0] = np.nan, np.inf
    timing.save(tmp_path / "timing.h5")
    assert same(timing, fc.Timing.load(tmp_path / "timing.h5"))


def test_forged_results_are_refused(tmp_path: Path) -> None:
    """Datasets that are not what their fields are, by one InputError each."""
    of_one_speed().save(tmp_path / "timing.h5")
    values: list[tuple[str, Any]] = [
        ("fits", "[" * 100_000), ("arrivals", "{}"), ("fits", "[1]"), ("doubts", '{"1": 2}'),
        ("arrivals", "nothing"), ("arrivals.1.time", np.ones(3)),
        ("fits.1.candidates.orders", "words"), ("fits.1.coefficients", np.full(3, 1e300)),
        ("fits.1.multiples", np.ones(2, dtype=complex)),
        ("fits.1.candidates.residuals", np.full(3, np.nan)),
    ]  # fmt: skip
    for name, value in values:
        forged_path = tmp_path / "forged.h5"
        shutil.copy(tmp_path / "timing.h5", forged_path)
        with changed(forged_path) as file:
            del file[name]
            file[name] = value
        catch_error(partial(fc.Timing.load, forged_path), "path", str(forged_path))
    catch_error(
        lambda: fc.Growth.load(tmp_path / "timing.h5"), "path", names="crack growth.*tip timing"
    )
