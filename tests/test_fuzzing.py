"""Damaged inputs and small structures through every command: a part of benchmarks/fuzzing.py."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import ends
import fuzzing
import numpy as np
import pytest


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Inputs that are right."""
    folder = tmp_path_factory.mktemp("fuzzing") / "base"
    fuzzing.make_base(folder)
    return folder


@pytest.fixture(scope="module")
def trial(base: Path) -> Iterator[fuzzing.Trial]:
    """A process that has imported the program."""
    with fuzzing.Trial(base, base.parent / "case") as trial:
        yield trial


@pytest.mark.parametrize(
    ("part", "count"),
    [
        ("inputs", 12), ("wheels", 12), ("structures", 20),
        pytest.param("inputs", 400, marks=pytest.mark.nightly),
        pytest.param("wheels", 600, marks=pytest.mark.nightly),
        pytest.param("calls", 600, marks=pytest.mark.nightly),
        pytest.param("structures", 150, marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_every_input_ends_well(part: str, count: int, trial: fuzzing.Trial) -> None:
    """With a result, a line about the input, or what did not converge."""
    attempts = [trial.attempt(part, case, 1) for case in range(count)]
    assert not [attempt for attempt in attempts if attempt.wrong]
    counts = Counter(attempt.outcome for attempt in attempts)
    assert len(attempts) == count and min(counts["done"], counts["refused"]) > 2


@pytest.mark.parametrize(
    ("part", "count", "most"),
    [
        pytest.param("names", 800, 20, marks=pytest.mark.nightly),
        pytest.param("files", 2000, 0, marks=pytest.mark.nightly),
    ],
)  # fmt: skip
def test_calls_end_well(part: str, count: int, most: int, base: Path, tmp_path: Path) -> None:
    """Of all public names in an InputError, but for a few; of forged files in one, or a result."""
    attempts = [*fuzzing.attempts(part, range(count), 1, base, tmp_path)]
    assert len([attempt for attempt in attempts if attempt.wrong]) <= most, [
        attempt for attempt in attempts if attempt.wrong
    ]
    assert (
        len(attempts) == count
        and sum(attempt.outcome == "refused" for attempt in attempts) > count / 2
    )


@pytest.mark.filterwarnings("ignore")
def test_drawn_calls_end_well(tmp_path: Path) -> None:
    """The same of a few, in this process."""
    wrong_calls = []
    for case in range(60):
        description, attempt = fuzzing.public_call(Random(f"2 {case}"), tmp_path)
        with np.errstate(all="ignore"):
            code, message = fuzzing.called(attempt)
        wrong_calls += [f"{description}: {message}"] if code == 1 or "\n" in message else []
    assert len(wrong_calls) <= 3, wrong_calls


@pytest.mark.nightly
def test_inputs_of_the_day(base: Path, tmp_path: Path) -> None:
    """The same with as many inputs as two minutes allow, on each day others."""
    until, seed = time.monotonic() + 120.0, int(time.time()) // 86_400
    for attempt in fuzzing.attempts("inputs", itertools.count(), seed, base, tmp_path):
        assert not attempt.wrong, attempt
        if time.monotonic() > until:
            break


def test_a_case_is_always_the_same(base: Path, tmp_path: Path) -> None:
    """It follows from the seed and its own number."""

    def drawn(case: int) -> tuple[Any, dict[str, bytes]]:
        folder = tmp_path / "case"
        fuzzing.shutil.rmtree(folder, ignore_errors=True)
        fuzzing.shutil.copytree(base, folder)
        words = fuzzing.draw("inputs", case, 1, folder)
        files = (path for path in sorted(folder.rglob("*.toml")) if path.is_file())
        return words, {path.name: path.read_bytes() for path in files}

    first_draws = [drawn(case) for case in range(5)]
    assert [drawn(case) for case in reversed(range(5))] == first_draws[::-1]


@pytest.mark.parametrize("end", ends.ENDS)
def test_what_the_process_does_is_seen(
    end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It dies, or does not end; another one takes the next case."""
    monkeypatch.setattr(fuzzing, "work", ends.work)
    if end == "TOO LONG":  # a slow machine may take as long to start a process that dies
        monkeypatch.setattr(fuzzing, "SECONDS", 0.1)
    attempts = [*fuzzing.attempts(end, range(2), 1, tmp_path)]
    assert [(attempt.case, attempt.outcome, attempt.wrong) for attempt in attempts] == [
        (n, end, True) for n in (0, 1)
    ]


TWO = "fenics-crack: a is missing: must be b\nfenics-crack: c = 1: not allowed\n"
JUDGED: dict[str, tuple[Callable[[], tuple[str, str]], str]] = {
    "a result": (lambda: fuzzing.outcome_of(0, "remark: a\nremark: b\n", ""), "done"),
    "one line": (lambda: fuzzing.outcome_of(2, "fenics-crack: a = 1\n", ""), "refused"),
    "no word": (lambda: fuzzing.outcome_of(2, "", ""), "RAW"),
    "two lines": (lambda: fuzzing.outcome_of(2, "fenics-crack: a\nfenics-crack: b\n", ""), "RAW"),
    "two keys": (lambda: fuzzing.outcome_of(2, TWO, ""), "refused"),
    "a fault": (lambda: fuzzing.outcome_of(1, "Traceback\nValueError: x\n", ""), "RAW"),
    "a library": (lambda: fuzzing.outcome_of(0, "", "HDF5-DIAG: error\n"), "RAW"),
}


@pytest.mark.parametrize(("judge", "outcome"), JUDGED.values(), ids=JUDGED.keys())
def test_judgements(judge: Callable[[], tuple[str, str]], outcome: str) -> None:
    """What counts as right and as raw."""
    assert judge()[0] == outcome
