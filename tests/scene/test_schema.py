"""The JSON schema of a scene, beside the scenes that there are."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import pytest
from helpers import DEMOS

import fenics_crack as fc

KINDS = {
    "boolean": bool, "integer": int, "number": int | float, "string": str, "array": list,
    "object": dict,
}  # fmt: skip


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """What a validator would say of the parts of the language in use."""
    if "anyOf" in schema:
        return any(fits(value, one) for one in schema["anyOf"])
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    if not any(isinstance(value, KINDS[kind]) for kind in kinds):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if isinstance(value, list) and "items" in schema:
        return all(fits(one, schema["items"]) for one in value)
    if isinstance(value, dict) and "properties" in schema:
        known_properties = schema["properties"]
        return (
            value.keys() <= known_properties.keys()
            and {*schema.get("required", ())} <= value.keys()
            and all(fits(one, known_properties[key]) for key, one in value.items())
        )
    return True


@pytest.mark.parametrize("demo", sorted(DEMOS.glob("*.toml")), ids=lambda path: path.stem)
def test_demos_fit(demo: Any) -> None:
    """Each scene is valid and does, as it stands in its file; a misspelt key or a wrong word does
    not."""
    assert fc.Scene.load(demo).excitation.omega > 0.0
    schema = json.loads(json.dumps(fc.Scene.schema()))
    tables = tomllib.loads(demo.read_text(encoding="utf-8"))
    assert fits(tables, schema)
    assert not fits(tables | {"excitation": tables["excitation"] | {"omgea": 1.0}}, schema)
    assert not fits(tables | {"contact": {"law": "sticky"}}, schema)
    assert not fits(tables | {"plate": {}}, schema)


def test_a_word_for_a_table() -> None:
    """``reduction = "off"``, and nothing else that is no table."""
    schema = fc.Scene.schema()["properties"]["reduction"]
    assert fits("off", schema) and fits({"modes": 9}, schema)
    assert not fits("on", schema) and not fits(3, schema)
