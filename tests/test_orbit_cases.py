"""The cases of the benchmark of exact orbits: format, hash, and motions followed again."""

import json
import sys
from pathlib import Path

import pytest
from helpers import catch_error

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "orbits"))
import check

FOLDER = Path(check.__file__).parent

QUICK = ("nlvib-03-0.6", "bilinear-10", "five-stops", "rub-lift", "smooth-20")
"""Stop, doubled, several pairs, friction, smoothed."""
FILES = sorted((FOLDER / "cases").glob("*.json"))


def test_all_are_what_was_written() -> None:
    """At least 30 cases, at most 8 MB, as they were sealed; a third from publications."""
    cases = [check.read(path) for path in FILES]
    published_cases = [case for case in cases if case["source"]["changed"]]
    assert len(cases) >= 30 and 3 * len(published_cases) >= 30
    assert sum(path.stat().st_size for path in FILES) < 8e6
    assert {case["law"]["kind"] for case in cases} == set(check.LIMITS)


@pytest.mark.drawn(2)
@pytest.mark.parametrize("name", QUICK)
def test_motion_of_the_second_reference(name: str) -> None:
    """Over one period, to the limit of the law."""
    check.followed(check.read(FOLDER / "cases" / f"{name}.json"))


@pytest.mark.nightly
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_motion_of_the_second_reference(path: Path) -> None:
    """Of all cases with at most 20 pairs."""
    case = check.read(path)
    if len(case["clearance"]) <= check.FEW:
        check.followed(case)


def test_damaged_case_is_refused(tmp_path: Path) -> None:
    """By its hash; and where the hash is made anew, by its motion."""
    case = json.loads((FOLDER / "cases" / "bilinear-1.json").read_text())
    case["structure"]["stiffness"][0][0] *= 1.0 + 1e-6
    path = tmp_path / "bilinear-1.json"
    path.write_text(json.dumps(case))
    catch_error(lambda: check.read(path), names="hash", kind=check.Damaged)
    path.write_text(json.dumps(check.sealed({**case, "hash": ""})))
    catch_error(
        lambda: check.followed(check.read(path)), names="second reference", kind=check.Damaged
    )


def test_proofs_are_of_these_cases() -> None:
    """Ten and more cases, the proved state within 1e-9 of the stored one."""
    proofs = json.loads((FOLDER / "proofs.json").read_text())
    assert len({name.partition("/")[0] for name in proofs}) >= 10
    for name, proof in proofs.items():
        file, _, number = name.partition("/")
        orbit = check.read(FOLDER / "cases" / f"{file}.json")["orbits"][int(number)]
        size = max(map(abs, orbit["state"]))
        pairs = zip(map(float, proof["state"]), orbit["state"], strict=False)
        assert proof["radius"] < 1e-9 and max(abs(a - b) for a, b in pairs) < 1e-9 * size


def test_page_counts_them() -> None:
    """Structures, pairs, publications, and what is proved, in docs/the_paper.md."""
    page = (FOLDER.parents[1] / "docs" / "the_paper.md").read_text().replace("\n", " ")
    cases = [check.read(path) for path in FILES]
    published_cases = json.loads((FOLDER / "published.json").read_text())
    proofs = json.loads((FOLDER / "proofs.json").read_text())
    proved_names = {name.partition("/")[0] for name in proofs}
    assert f"set of {len(cases)} structures" in page
    assert f"one mass to {max(len(case['clearance']) for case in cases)} pairs" in page
    assert f"{len(published_cases)} are from publications" in page
    assert f"{len(proofs)} orbits of {len(proved_names)} cases" in page
    assert max(proof["radius"] for proof in proofs.values()) < 1e-21
