"""The command ``timing``: arrival times of a blade tip, and the vibration found in them."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import Exit, InputError
from fenics_crack.basics.progress import within
from fenics_crack.basics.ranks import on_root
from fenics_crack.basics.tables import RPM, TURN, Table, counted, quantity, speed_in_words
from fenics_crack.cli.account import Account, in_one_unit, of_error, of_stability
from fenics_crack.cli.commands import tell
from fenics_crack.cli.given import Console, Inputs, changes, keep_before, make_writable, one_of
from fenics_crack.draw.plot_study import draw_arrivals, draw_passages, draw_tip_fit, draw_tip_track
from fenics_crack.monitoring.tip_timing import scene_timing
from fenics_crack.monitoring.tip_timing.arrival_times import ArrivalTimes, read_record, write_record
from fenics_crack.monitoring.tip_timing.fit_order import TipTrack
from fenics_crack.monitoring.tip_timing.harmonics import ORDERS, TipFit, in_words
from fenics_crack.monitoring.tip_timing.passages import PassageFit, find_passages
from fenics_crack.monitoring.tip_timing.robust import LEVELS
from fenics_crack.monitoring.tip_timing.timing import Timing
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import TipTiming
from fenics_crack.study.plausibility import remarks_on_scene
from fenics_crack.study.run import Run

RECORD_KEYS = ("tip_radius", "orders", "probes", "stiffening")
"""Keys of [tip_timing] for a record in place of a scene."""
UNFITTED = "harmonics are missing (tip_timing.fitted_harmonics), and folded onto the fitted ones"
UNTESTED = "as many unknowns as probes: neither the order nor the fitted harmonics are tested"
FOLDED = (
    "harmonics that are not fitted may be folded onto the fitted ones (fit more, or more probes)"
)
ONCE = "no probe sees the vibration twice: fit and standard errors are untested (more revolutions)"
UNCLEAR = "at no speed larger than its errors, at most {} (more revolutions determine it better)"
NEARBY = "residuals are correlated, by a vibration nearby or drift: order and errors may be wrong"
UNTESTED_ORDER = "cannot test an order: {:g} fits, and others may as well (tip_timing.orders)"
BLIND = "does not measure the vibration that the others do: excluded; are its pulses the blade's?"
CONSTANT = (
    "frequencies are taken not to change with the speed; else damping is wrong, and a fast run-up "
    "overestimates and a run-down underestimates the frequency (tip_timing.stiffening)"
)
UNSWEPT = "the speed varies by less than 1 %: with a scene a vibration at that speed is found"


def timing(given: Namespace, inputs: Inputs | None, console: Console) -> Exit:
    """Compute arrival times unless they are measured, and fit a vibration to them."""
    if inputs is None:
        return _record(given, console)
    scene, folder = inputs.scene, inputs.folder
    if scene.disk is not None:
        return _of_blades(inputs, console)
    assert not isinstance(inputs.arrivals, dict)
    with console.stage("arrival times"):
        arrivals, run = scene_timing.arrivals_of(scene, inputs.arrivals, console.comm)

    def write() -> None:
        arrivals.to_csv(folder / "arrivals.csv")
        picture = folder / f"arrivals.{console.pictures}"
        draw_arrivals(arrivals, path=picture, in_rpm=scene.in_rpm)

    rows = arrivals.table().formatted("csv")
    console.note(keep_before(folder / "arrivals.csv", rows, console.comm))
    on_root(console.comm, write)
    first, last = (speed_in_words(arrivals.speed[end], scene.in_rpm) for end in (0, -1))
    ends = f"{first} to {last}" if scene_timing.is_run_up(arrivals, run) else first
    console.note(
        f"arrivals of {_size(arrivals)}, {ends}: {folder / 'arrivals.csv'}, .{console.pictures}"
    )
    if run is not None:
        console.note(scene_timing.tip_in_words(scene.given("tip_timing"), run))
    with console.stage("vibration"):
        fit = scene_timing.vibration_in(scene, arrivals, run)
    if isinstance(fit, tuple):
        account, draw = _account_of_passages({1: fit}), partial(draw_passages, fit, arrivals)
    elif isinstance(fit, TipTrack):
        account = _account_of_track(fit, scene)
        draw = partial(draw_tip_track, fit, in_hertz=scene.in_hertz)
    else:
        account, draw = _account_of_fit(fit, scene), partial(draw_tip_fit, fit, arrivals)
    warnings = [*_warnings_of(arrivals, scene, run), *account.warnings]
    found = replace(account, warnings=warnings, remarks=remarks_on_scene(scene))
    return tell(found, folder, console, draw)


def _of_blades(inputs: Inputs, console: Console) -> Exit:
    """The same of every blade of a bladed disk: one record of all, and a fit of each."""
    scene, folder, source = inputs.scene, inputs.folder, inputs.arrivals
    table = scene.given("tip_timing")
    assert not isinstance(source, ArrivalTimes)
    with console.stage("arrival times"):
        blades, run = scene_timing.arrivals_of_blades(scene, source, console.comm)
    record = folder / "arrivals.csv"
    if run is not None:
        on_root(console.comm, lambda: write_record(blades, record, np.radians(table.probes)))
        console.note(f"arrivals of {counted(len(blades), 'blade')}: {record}")
    with console.stage("vibration"):
        fits, doubts = {}, []
        for blade, arrivals in blades.items():
            with within(f"blade {blade}"):
                fit = scene_timing.vibration_in(scene, arrivals, run)
            if not isinstance(fit, TipFit):
                allowed = "arrivals at one speed of a bladed disk"
                raise InputError("arrivals", str(source or "a curve"), allowed)
            fits[blade] = fit
            doubts += [f"blade {blade}: {text}" for text in _account_of_fit(fit, scene).warnings]
    shown = Timing(scene, blades, fits).table()
    largest = max(fits, key=lambda blade: float(fits[blade].amplitudes[0]))
    draw = partial(draw_tip_fit, fits[largest], blades[largest])
    notes = [f"the picture shows blade {largest}, whose amplitude is the largest"]
    warnings = [*doubts, *(() if run is None else _warnings_of(blades[largest], scene, run))]
    remarks = remarks_on_scene(scene)
    account = Account("timing", shown, notes=notes, warnings=warnings, remarks=remarks)
    return tell(account, folder, console, draw)


def _size(arrivals: ArrivalTimes) -> str:
    return f"{counted(len(arrivals), 'revolution')}, {counted(len(arrivals.probes), 'probe')}"


def _warnings_of(arrivals: ArrivalTimes, scene: Scene, run: Run[Any] | None) -> Iterator[str]:
    """Yield warnings about measured arrivals, or about the run that they are computed from."""
    if run is None:
        yield from scene_timing.remarks_on_arrivals(arrivals)
        speeds = arrivals.mean_speed, scene.speed
        if scene.speed > 0.0 and not 0.5 <= speeds[0] / speeds[1] <= 2.0:
            seen, own = (speed_in_words(speed, scene.in_rpm) for speed in speeds)
            yield f"the arrivals are of {seen}, [rotation] has {own}: are they in seconds?"
        return
    yield from filter(
        None, (scene_timing.of_another_scene(scene, run), scene_timing.run_up_ends(scene, run))
    )
    if isinstance(run.result, PeriodicSolution):
        found = run.result
        yield from of_error(run.scene, found.report, found.harmonics)
        yield from of_stability(run.scene, run, found.stability)


def _record(given: Namespace, console: Console) -> Exit:
    """Find the resonances that the blades of a measured record pass, without a scene."""
    words = {}
    for key, value in changes(given.set).items():
        table, _, name = key.partition(".")
        if table != "tip_timing" or name not in RECORD_KEYS:
            allowed = ", ".join(f"tip_timing.{known}" for known in RECORD_KEYS)
            raise InputError(
                key, value, f"left out with a record in place of a scene, or {allowed}"
            )
        words[name] = TipTiming.checked(name, value)
    with console.stage("arrival times"):
        probes = words.get("probes")
        blades = read_record(
            given.scene,
            tip_radius=words.get("tip_radius"),
            probes=None if probes is None else np.radians(probes),
        )
        blades = one_of(blades, given.blade, given.scene)
    folder = given.output or Path("output") / given.scene.stem
    make_writable(folder, console.comm)
    orders, stiffening = words.get("orders") or ORDERS, words.get("stiffening", 0.0)
    with console.stage("resonances"):
        found = {}
        for blade, one in blades.items():
            with within(f"blade {blade}"):
                found[blade] = find_passages(one, orders, stiffening=stiffening)

    first, *others = blades

    def write() -> None:
        for blade in others:
            path = folder / f"timing_blade_{blade}.{console.pictures}"
            draw_passages(found[blade], blades[blade], path=path)

    on_root(console.comm, write)
    console.note(f"{counted(len(blades), 'blade')}, {_size(blades[first])}")
    draw = partial(draw_passages, found[first], blades[first])
    account = _account_of_passages(found)
    warnings = [*scene_timing.remarks_on_arrivals(blades[first]), *account.warnings]
    warnings += [UNSWEPT] * blades[first].steady
    return tell(replace(account, warnings=warnings), folder, console, draw)


def _account_of_passages(found: Mapping[int, tuple[PassageFit, ...]]) -> Account:
    """Return the account of resonances of each blade, and doubts about them."""
    every = [(blade, fit) for blade, fits in found.items() for fit in fits]
    table = Timing(None, {}, found).table()
    warnings = ["no resonance stands out"] * (not every)
    for blade, fits in found.items():
        angles = [f"{np.degrees(angle):.5g}" for angle in (fits[0].blind if fits else ())]
        warnings += [f"blade {blade}, probe at {angle} degrees: {BLIND}" for angle in angles]
    for blade, fit in every:
        name = f"blade {blade}, {fit.speed / RPM:.5g} rpm"
        if fit.untested:
            seen = counted(fit.probes, "probe")
            warnings.append(f"{name}: {seen} {UNTESTED_ORDER.format(fit.order)}")
        elif fit.ambiguous:
            warnings.append(f"{name}: {_orders('explain the arrivals as well', fit.ambiguous)}")
        if fit.disagree:
            warnings.append(f"{name}: {fit.disagreement}")
        if fit.in_doubt:
            warnings.append(f"{name}: {NEARBY}")
    notes = [CONSTANT] * any(fit.stiffening == 0.0 for _, fit in every[:1])
    for blade, fits in found.items():
        lines = fits[0].asynchronous if fits else ()
        notes += [f"blade {blade}: {_of_line(line)}" for line in lines]
    return Account("timing", table, notes=notes, warnings=warnings)


def _orders(words: str, orders: Iterable[float]) -> str:
    """Return orders that do something, in words."""
    return f"orders that {words}: {in_words([*orders])}"


def _of_line(line: TipFit) -> str:
    """Return a vibration of constant frequency in words."""
    size, error = line.amplitudes[0], line.amplitude_errors[0]
    of = f"{line.omega / TURN:.6g} Hz, {quantity(size, 'm')} ± {quantity(error, 'm')}"
    return f"a vibration that follows no order: {of}"


def _account_of_track(track: TipTrack, scene: Scene) -> Account:
    """Return the account of a run-up, with the point where each harmonic is largest."""
    table = track.table()
    kept = [n for n, name in enumerate(table.columns) if not name.startswith("amplitude")]
    rows, notes = [], []
    # The largest of so many amplitudes is several errors large where there is no vibration.
    limit = float(np.sqrt(2.0 * np.log(len(track.speed) / LEVELS.misfit)))
    for place, multiple in enumerate(track.multiples):
        sizes, errors = track.amplitudes[:, place], track.amplitude_errors[:, place]
        clear = np.where(sizes <= limit * errors, np.nan, sizes)
        if not np.all(np.isnan(clear)):
            at = int(np.nanargmax(clear))
            about = (float(sizes[at]), float(errors[at]))
            rows.append([float(multiple), *(table.rows[at][n] for n in kept), *about])
        elif not np.all(np.isnan(sizes)):
            most = quantity(float(np.nanmax(sizes + LEVELS.deviations * errors)), "m")
            notes.append(f"harmonic {multiple:g}: {UNCLEAR.format(most)}")
    columns = ["multiple, where it is largest", *(table.columns[n] for n in kept)]
    shown = in_one_unit(Table([*columns, "amplitude [m]", "amplitude_error [m]"], rows), scene)
    doubts = [UNTESTED] if np.isnan(track.misfit) else []
    if track.does_not_fit:
        doubts.append(
            f"the residual repeats in all revolutions: {UNFITTED}, the vibration "
            "changes within the revolutions that are fitted together "
            f"(tip_timing.fitted_revolutions), or it is not of order {track.order:g}"
        )
    elif track.in_doubt and not doubts:
        doubts.append(FOLDED)
    return Account("timing", table, shown=shown, notes=notes, warnings=doubts)


def _account_of_fit(fit: TipFit, scene: Scene) -> Account:
    """Return the account of a fit, with the ratio that indicates a crack, and warnings."""
    notes = [f"in addition, {_of_line(line)}" for line in fit.asynchronous]
    warnings = []
    if np.any(np.isclose(fit.multiples, 2.0)):
        ratio, error = fit.ratio()
        notes.append(f"second harmonic over first: {ratio:.4g} ± {error:.2g}")
    if fit.does_not_fit:
        warnings.append(
            f"residuals differ between the probes by more than their scatter: {UNFITTED}, probes "
            "are misplaced (tip_timing.angle_deviation), or the order is none of tip_timing.orders"
        )
    elif fit.may_be_folded and fit.spare > 0:
        warnings.append(FOLDED)
    if fit.spare < 1:
        warnings.append(UNTESTED)
    elif fit.seen_once:
        warnings.append(ONCE)
    if fit.ambiguous:
        warnings.append(_orders("explain the arrivals as well", fit.ambiguous))
    if fit.hidden:
        warnings.append(_orders("these probes cannot measure", fit.hidden))
    table = fit.table()
    shown = in_one_unit(table, scene)
    return Account("timing", table, shown=shown, notes=notes, warnings=warnings)
