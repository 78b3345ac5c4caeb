"""Values that a JSON schema allows, for the keywords that pydantic and FastAPI use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hypothesis import strategies as st

Schema = Mapping[str, Any]
_KNOWN = {
    "$ref", "$defs", "additionalProperties", "anyOf", "const", "default", "description",
    "discriminator", "enum", "items", "maxLength", "maximum", "minLength", "minimum", "oneOf",
    "pattern", "properties", "required", "title", "type",
}  # fmt: skip


def values(schema: Schema, root: Schema) -> st.SearchStrategy[Any]:
    """Return values that ``schema`` allows; references are looked up in ``root``."""
    assert set(schema) <= _KNOWN, set(schema) - _KNOWN
    if "$ref" in schema:
        found: Any = root
        for key in schema["$ref"].removeprefix("#/").split("/"):
            found = found[key]
        return values(found, root)
    for word in ("oneOf", "anyOf"):
        if word in schema:
            return st.one_of([values(one, root) for one in schema[word]])
    if "const" in schema:
        return st.just(schema["const"])
    if "enum" in schema:
        return st.sampled_from(schema["enum"])
    kind = schema.get("type")
    if kind == "object":
        return _objects(schema, root)
    if kind == "array":
        return st.lists(values(schema.get("items", {}), root), max_size=4)
    if kind == "string":
        if "pattern" in schema:
            return st.from_regex(schema["pattern"].replace("$", r"\Z"))
        return st.text(min_size=schema.get("minLength", 0), max_size=schema.get("maxLength", 20))
    low, high = schema.get("minimum"), schema.get("maximum")
    if kind == "integer":
        return st.integers(low, high)
    if kind == "number":
        return st.floats(low, high, allow_nan=False, allow_infinity=False)
    if kind == "boolean":
        return st.booleans()
    if kind == "null":
        return st.none()
    return st.none() | st.booleans() | st.integers() | st.text(max_size=8)


def _objects(schema: Schema, root: Schema) -> st.SearchStrategy[Any]:
    own = {name: values(one, root) for name, one in schema.get("properties", {}).items()}
    required = set(schema.get("required", ()))
    if not own:
        return st.dictionaries(st.text(max_size=8), st.integers(), max_size=3)
    return st.fixed_dictionaries(
        {name: one for name, one in own.items() if name in required},
        optional={name: one for name, one in own.items() if name not in required},
    )
