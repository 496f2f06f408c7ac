"""Names that there are, and what is said of those that there are not."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, catch_error
from mpi4py import MPI
from test_any_input import TINY

import fenics_crack as fc

SHORT = ("solve", "curve", "integrate", "modes", "run_sweep", "verify", "campbell", "load", "save")


def test_short_names_after_every_folder_is_loaded() -> None:
    """Python puts a folder that is loaded under its name: none may hide a function."""
    for module in pkgutil.walk_packages(fc.__path__, "fenics_crack."):
        if not module.name.endswith(("__main__", "kernel.build")):
            importlib.import_module(module.name)
    for name in SHORT:
        assert callable(getattr(fc, name)), name


def test_what_tab_shows() -> None:
    """The public names, and none that the file itself uses."""
    assert [name for name in dir(fc) if not name.startswith("__")] == sorted(fc.__all__)


SHARED = [
    function
    for function in (getattr(fc, name) for name in fc.__all__)
    if inspect.isfunction(function) and "comm" in inspect.signature(function).parameters
]
"""Functions whose work ranks share."""


@pytest.mark.parametrize("function", [*SHARED, fc.Structure.from_matrices])
def test_a_communicator_is_one(function: Any) -> None:
    """Changes of a scene in its place end in no other library."""
    parameters = inspect.signature(function).parameters.values()
    arguments = {
        parameter.name: None for parameter in parameters if parameter.default is parameter.empty
    }
    for wrong in ({"contact.stiffness": 1e9}, MPI.COMM_NULL):
        assert catch_error(partial(function, **arguments, comm=wrong), "comm").value is wrong


@pytest.mark.parametrize(
    ("call", "key", "value", "names"),
    [
        (lambda: fc.solve("plate.toml"), "scene", "plate.toml", r"a Scene, .*fc\.Scene\.load"),
        (lambda: fc.load_run(1.0), "path", 1.0, None),
        (lambda: fc.load_run(fc), "path", "module", None),
        (lambda: fc.draw_friction_loops(np.ones(3)), "solution", "ndarray", "PeriodicSolution"),
        (lambda: fc.prepare(None), "scene", None, "a Scene"),
        (lambda: fc.arrivals_of_blades(None, 3), "scene", None, None),
        (lambda: fc.write_record(3, "a.csv", []), "blades", 3, "dict"),
        (lambda: fc.write_record({}, "a.csv", []), "blades", {}, None),
    ],
)
def test_an_object_of_another_class(
    call: Callable[[], object], key: str, value: Any, names: str | None
) -> None:
    """Is refused by the annotation of its argument, before anything asks it for an attribute."""
    catch_error(call, key, value, names=names)


def test_a_run_stands_for_its_result() -> None:
    """Of a solution, a curve and modes; not where its result is of another class."""
    scene = fc.Scene.from_mapping(TINY)
    run, modes = fc.solve(scene), fc.modes(scene, 2)
    call: Any = fc  # a Run is no result to mypy
    multipliers = fc.floquet(run.structure, run.result).multipliers
    assert np.array_equal(call.floquet(run.structure, run).multipliers, multipliers)
    problem = {"structure": run.structure, "omega": 2000.0, "contact": run.contact}
    restarted_solution = call.solve_harmonic_balance(**problem, harmonics=3, initial=run)
    assert restarted_solution.converged and restarted_solution.iterations <= 1
    history = call.integrate_events(**problem, periods=1, initial=run)
    first_displacement = history.displacement([run.watched_dof])[0, 0]
    start = run.result.displacement(np.zeros(1), [run.watched_dof])[0, 0]
    assert first_displacement == pytest.approx(start, rel=1e-9)
    assert call.draw_spectrum(run).axes and call.draw_modes(modes).axes
    catch_error(lambda: call.draw_curve(run), "curve", "Run", names="ResponseCurve")
    curve = fc.curve(scene.replace({"curve.start": 1900.0, "curve.stop": 2000.0}))
    (line, *_), (other_line, *_) = (
        figure.axes[0].lines for figure in (call.draw_curve(curve), fc.draw_curve(curve.result))
    )
    assert np.array_equal(line.get_xydata(), other_line.get_xydata(), equal_nan=True)


def test_what_annotations_allow() -> None:
    """A subclass, a path of another kind, and None."""
    structure = fc.Structure.from_matrices(np.eye(1), np.eye(1), gap=np.eye(1), force_cos=[1.0])

    class Mine(fc.Structure):
        pass

    class Place:
        def __fspath__(self) -> str:
            return "missing.h5"

    own_object = object.__new__(Mine)
    vars(own_object).update(vars(structure))
    fc.solve_harmonic_balance(own_object, 0.5, fc.UnilateralPenalty(1.0), harmonics=1, initial=None)
    catch_error(lambda: fc.load_run(Place()), "path", "missing.h5")


@pytest.mark.parametrize(
    ("function", "given", "right"),
    [
        (fc.solve_harmonic_balance, {"n_harmonics": 9}, "harmonics"),
        (fc.solve, {"harmonics": 9}, "harmonic_balance.harmonics"),
        (fc.solve, {"tol": 1e-8}, "harmonic_balance.tolerance"),
        (fc.curve, {"progres": True}, "progress"),
        (fc.Scene.replace, {"force": 3.0}, "excitation.force_sin"),
        (fc.load, {"path": "plate.toml"}, "fc.load_run(path)"),
    ],
)
def test_a_wrong_call_leads_on(function: Any, given: dict[str, Any], right: str) -> None:
    """To the nearest argument, to the key of the scene, to another function."""
    error = catch_error(lambda: function(**given), kind=TypeError)
    suggestions = re.search(r"did you mean (.*?)\? ", str(error))
    first_suggestion = suggestions[1].split(" or ")[0]
    assert first_suggestion in (right, f'scene.replace({{"{right}": ...}})')


def test_a_misspelt_option_of_a_picture_leads_on() -> None:
    """To the option."""
    catch_error(
        lambda: fc.draw_map(
            [0.0, 1.0], [0.0, 1.0], np.eye(2), x_label="", y_label="", value_label="", legnd=False
        ),
        "legnd",
        False,
        names=r"did you mean legend\?",
    )


def test_an_old_name_of_an_attribute_is_answered_with_a_warning() -> None:
    """For one version."""
    scene = fc.Scene.load(ROOT / "demos" / "blade.toml")
    with pytest.warns(FutureWarning, match="Scene.in_hertz is Scene.is_frequency_in_hertz now"):
        assert scene.in_hertz == scene.is_frequency_in_hertz


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("from_matrices", "fc.Structure.from_matrices(mass, stiffness, gap=...)"),
        ("Friction", "fc.CoulombFriction"),
    ],
)
def test_a_missing_name_leads_on(name: str, right: str) -> None:
    """To the nearest one of the package."""
    catch_error(lambda: getattr(fc, name), kind=AttributeError, names=re.escape(f"mean {right}?"))


def test_a_missing_attribute_of_a_run_leads_on() -> None:
    """To where it is; old names of an assessment are answered."""
    scene = {"damping.ratio": 0.01, "contact.stiffness": 1e9}
    run = fc.solve(fc.Scene.load(ROOT / "demos" / "paper_plate.toml").replace(scene))
    for name, right in (("multipliers", "run.stability.multipliers"), ("modes", "fc.modes(scene)")):
        right = re.escape(f"mean {right}?")
        catch_error(lambda name=name: getattr(run, name), kind=AttributeError, names=right)
    for old, new in (("accepted", "is_accepted"), ("distance", "relative_orbit_distance")):
        with pytest.warns(FutureWarning, match=f"Assessment.{old} is Assessment.{new} now"):
            assert getattr(run.assessment, old) == getattr(run.assessment, new)
