"""Files of earlier versions: each is read, and gives the numbers that it gave."""

from __future__ import annotations

import json
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import catch_error
from write_fixtures import numbers

FIXTURES = Path(__file__).with_name("fixtures")
PNG = b"\x89PNG\r\n\x1a\n"
FILES = [
    (version.stem, name)
    for version in sorted(FIXTURES.glob("*.zip"))
    for name in zipfile.ZipFile(version).namelist()
    if name.endswith(".h5")
]


def same(found: object, expected: object) -> bool:
    """Return True if numbers agree to rounding, and words and keys exactly."""
    if isinstance(expected, dict):
        assert isinstance(found, dict) and found.keys() == expected.keys()
        return all(same(found[key], value) for key, value in expected.items())
    array = np.asarray(expected)
    if array.dtype.kind not in "fi":
        return bool(np.array_equal(np.asarray(found), array))
    return np.allclose(np.asarray(found, float), array, rtol=1e-7, atol=1e-20, equal_nan=True)


@pytest.mark.parametrize(("version", "name"), FILES)
def test_file_of_a_version(version: str, name: str, tmp_path: Path) -> None:
    """Read, or refused in a line that says what to do."""
    with zipfile.ZipFile(FIXTURES / f"{version}.zip") as archive:
        archive.extract(name, tmp_path)
        expected_numbers = json.loads(archive.read("numbers.json"))[Path(name).stem]
    (tmp_path / "posterior.png").write_bytes(PNG)
    if isinstance(expected_numbers, str):
        catch_error(
            partial(numbers, Path(name).stem, tmp_path / name),
            "path",
            str(tmp_path / name),
            names=expected_numbers,
        )
    else:
        assert same(numbers(Path(name).stem, tmp_path / name), expected_numbers)
