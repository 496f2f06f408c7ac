"""What all schemes share: the checks of what is asked, the record, and when a march ends."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import catch_error, chain, oscillator, relative, two_masses

import fenics_crack as fc

LAW = fc.UnilateralPenalty(1e9)
WITH_MASS = (fc.integrate_central_difference, fc.integrate_events)
NAMES = ["central", "events"]
all_schemes = pytest.mark.parametrize(
    "scheme", [*WITH_MASS, fc.integrate_exponential], ids=[*NAMES, "exponential"]
)
Scheme = Callable[..., fc.TimeHistory]
ZEROS = np.zeros(50)


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("omega", [-3.0, 0.0, np.inf, "fast", None]),
        ("contact", ["rigid", None, fc.UnilateralPenalty]),
        ("contact stiffness", [fc.UnilateralPenalty([1e9, 1e9, 1e9])]),
        ("periods", [0, -1, 1.5, "ten", True, None]),
        ("steps_per_period", [0, 512.0, "many", True, None]),
        ("settle", [-1, -1e-9, np.nan, np.inf, "x", True, None]),
        ("record_periods", [0, -3, 1.5, "last", True]),
        ("dofs", [[1000], [-1], [0.5], [np.nan], [1j], "corner", {"corner": 1}]),
        (
            "initial",
            [
                "rest",
                5,
                ZEROS,
                (ZEROS,),
                (ZEROS, ZEROS, ZEROS),
                (np.zeros(3), np.zeros(3)),
                (ZEROS, ZEROS + 1j),
                (np.full(50, np.nan), ZEROS),
                (None, None),
                fc.solve_linear(oscillator(), 1.0),
            ],
        ),
    ],
)
@all_schemes
def test_bad_arguments_are_named(
    scheme: Scheme, soft_plate: fc.Structure, key: str, values: list[Any]
) -> None:
    """One error that names the key, whatever is wrong with its value, from every scheme."""
    for value in values:
        arguments: dict[str, Any] = {
            "omega": 2000.0, "contact": LAW, "periods": 1, "steps_per_period": 512,
        } | {key.split()[0]: value}  # fmt: skip
        catch_error(partial(scheme, soft_plate, **arguments), key)


@all_schemes
def test_a_history_beyond_the_memory_is_refused(scheme: Scheme, soft_plate: fc.Structure) -> None:
    """Before anything is marched."""
    catch_error(
        lambda: scheme(soft_plate, 2000.0, LAW, periods=10**7, steps_per_period=512),
        "record_periods",
        10**7,
        names="5120000000 instants of 50 dofs",
    )


@all_schemes
def test_a_misspelt_option_is_named(scheme: Scheme, soft_plate: fc.Structure) -> None:
    """With the function that was called, and what may be given."""
    options = rf"the options of {scheme.__name__} are periods, .*, record_periods, dofs"
    catch_error(
        lambda: scheme(soft_plate, 2000.0, LAW, periods=1, steps_per_period=512, record_dofs=[3]),
        "record_dofs",
        [3],
        names=options,
    )


@all_schemes
def test_recording(scheme: Scheme, soft_plate: fc.Structure) -> None:
    """Some dofs of the last periods are the same numbers as everything."""
    options: dict[str, Any] = {"periods": 5, "steps_per_period": 320}
    rounding = 1e-14  # products with fewer rows may round otherwise
    everything = scheme(soft_plate, 2000.0, LAW, **options)
    partial_run = scheme(soft_plate, 2000.0, LAW, record_periods=2, dofs=[3, 40], **options)
    assert len(everything.time) == 5 * 320 and len(partial_run.time) == 2 * 320
    for record, expected_record in (
        (partial_run.time, everything.time),
        (partial_run.gap, everything.gap),
        (partial_run.contact_force, everything.contact_force),
        (partial_run.displacement([40, 3]), everything.displacement([40, 3])),
    ):
        assert (
            np.abs(record - expected_record[-640:]).max()
            <= rounding * np.abs(expected_record).max()
        )
    assert np.allclose(np.diff(everything.time), everything.time[1])
    gap = everything.displacement(range(50)) @ soft_plate.gap.toarray()
    assert np.allclose(gap, everything.gap, atol=1e-20)
    catch_error(lambda: partial_run.displacement([5]), "dofs", [5])
    long_record = scheme(soft_plate, 2000.0, LAW, record_periods=7, **options)
    assert np.array_equal(long_record.gap, everything.gap)


@all_schemes
def test_a_march_without_pairs_settles_by_the_motion_of_its_load(scheme: Scheme) -> None:
    """Nothing but the displacement can say whether it repeats: exp(-0.05 t) of the oscillator."""
    bare = fc.Structure.from_matrices(
        np.ones((1, 1)), np.ones((1, 1)), gap=None, force_cos=[1.0], damping=0.1 * np.ones((1, 1))
    )
    law, options = fc.UnilateralPenalty(1.0), {"steps_per_period": 128, "settle": 1e-2}
    history = scheme(bare, 0.7, law, periods=50, **options)
    assert 8 <= history.periods <= 14 and 1e-3 < history.settled < 1e-2
    assert history.gap.shape == history.contact_force.shape == (128 * history.periods, 0)
    assert 0.0 < history.distance_to_steady_motion < 0.3 and history.change() == pytest.approx(
        history.settled
    )


@pytest.mark.parametrize(("omega", "settle"), [(0.9, 1e-4), (1.7, 1e-4), (1.7, 1e-2)])
def test_distance_that_is_left(omega: float, settle: float) -> None:
    """The last periods of a motion tell where it goes; one more period changes it by as much, or by
    twice that."""
    structure, law = two_masses(1.0), fc.UnilateralPenalty(1.0)
    history, exact = (
        fc.integrate_events(structure, omega, law, periods=4000, settle=level, record_periods=4)
        for level in (settle, 1e-11)
    )
    distances = []
    for quantity in (lambda run: run.gap + structure.clearance, lambda run: run.displacement()):
        motion, wave = (run.by_period(quantity(run))[-1] for run in (history, exact))
        moving_square = np.sum((wave - wave.mean(axis=0)) ** 2)
        size = math.sqrt(moving_square + min(np.sum(wave**2) - moving_square, moving_square))
        distances.append(np.linalg.norm(motion - wave) / size)
    assert history.distance_to_steady_motion == pytest.approx(max(distances), rel=0.02)
    assert history.distance_to_steady_motion > 0.4 * history.settled


@pytest.mark.parametrize("scheme", WITH_MASS, ids=NAMES)
def test_one_instant_in_a_period(scheme: Scheme) -> None:
    """A load faster than everything else: books and record take it."""
    structure = oscillator(clearance=1.0)
    history = scheme(structure, 20.0, fc.UnilateralPenalty(1.0), periods=3, steps_per_period=1)
    assert len(history.time) == 3 and np.all(np.isfinite(history.gap))
    assert abs(history.created_energy) < 1e-3


@all_schemes
def test_history_in_one_line(scheme: Scheme) -> None:
    """How far it went, whether it settled, and how many pairs there are."""
    structure, law = chain(), fc.UnilateralPenalty(4.0)
    two = scheme(structure, 0.8, law, periods=2, steps_per_period=64)
    settled_text = f", settled to {two.settled:.0e}"
    assert repr(two) == f"TimeHistory(2 periods of 64 steps{settled_text}, 3 pairs)"
    one_period = scheme(oscillator(), 0.8, law, periods=1, steps_per_period=64)
    assert repr(one_period) == "TimeHistory(1 period of 64 steps, 1 pair)"


def test_all_schemes_march_alike() -> None:
    """Same arguments, same motion and force, to the schemes' errors."""
    structure, law = chain("modal"), fc.UnilateralPenalty(4.0)
    central, events, exponential = (
        scheme(structure, 0.8, law, periods=3, steps_per_period=1024, record_periods=1, dofs=[2])
        for scheme in (*WITH_MASS, fc.integrate_exponential)
    )
    for history in (central, exponential):
        assert np.array_equal(history.time, events.time)
        assert relative(history.gap, events.gap) < 1e-3
        assert relative(history.contact_force, events.contact_force) < 1e-3
        assert relative(history.displacement([2]), events.displacement([2])) < 1e-3


def test_lips_without_mass_are_refused(wide_plate: fc.Structure) -> None:
    """By steps that need mass, and with them the stable step."""
    reduced_plate = fc.reduce_structure(wide_plate, modes=10, method="massless")
    catch_error(
        lambda: fc.integrate_central_difference(
            reduced_plate, 2000.0, LAW, periods=1, steps_per_period=512
        ),
        "structure",
        names="'free_interface'.*integrate_exponential",
    )
    catch_error(lambda: fc.stable_steps_per_period(reduced_plate, 2000.0, LAW), "structure")


def test_exponential_without_pairs(wide_plate: fc.Structure) -> None:
    """The linear motion, whose end is judged by the modes alone: what has no mass is at rest."""
    full_structure = fc.Structure.from_matrices(
        wide_plate.mass, wide_plate.stiffness, gap=None, damping=fc.ModalDamping(0.05),
        force_sin=wide_plate.force[2],
    )  # fmt: skip
    reduced_structure = fc.reduce_structure(full_structure, modes=10, method="massless")
    corner = int(np.argmax(np.abs(full_structure.force[2])))
    history = fc.integrate_exponential(reduced_structure, 2000.0, LAW, periods=60, settle=1e-6)
    assert 20 < history.periods < 60 and history.gap.shape[1] == 0
    motion = history.by_period(history.displacement([corner]))[-1]
    linear = fc.solve_linear(full_structure, 2000.0)
    assert relative(motion, linear.displacement(history.time[-512:], [corner])) < 1e-3


@pytest.mark.parametrize(("mean", "clearance"), [(-1000.0, 0.0), (1000.0, 0.0), (0.0, 1e6)])
def test_means_do_not_make_a_motion_settle(mean: float, clearance: float) -> None:
    """A steady load a thousand times the vibration, by which the mass stays off the stop or on it:
    the amplitude against its closed form. It was told 108 % too large, 6e-4 from where it settles.
    """
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[1.0], force_mean=[mean], force_sin=[1.0], clearance=clearance,
        damping=[[0.02]],
    )  # fmt: skip
    law, is_closed = fc.UnilateralPenalty(10.0), mean > 0.0
    history = fc.integrate_events(
        structure, 0.7, law, periods=1000, settle=1e-3, record_periods=4
    )  # fmt: skip
    exact = 1.0 / abs((11.0 if is_closed else 1.0) - 0.49 + 0.014j)
    assert history.settled < 1e-3
    assert history.indicators().amplitude == pytest.approx(
        exact, rel=3.0 * history.distance_to_steady_motion
    )


def test_a_longer_period_is_told_by_what_moves() -> None:
    """Shaw and Holmes' oscillator: every second period is alike."""
    structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[1.0], force_sin=[1.0], damping=[[0.2]]
    )
    history = fc.integrate_events(
        structure, 3.4, fc.UnilateralPenalty(100.0), periods=150, record_periods=4
    )
    assert history.change(2) < 1e-9 < 0.1 < history.change() == pytest.approx(history.settled)
    catch_error(lambda: history.change(4), "periods", 4)
