"""The JSON Schema of the configuration, from the records that it is read into and the comments of the shipped files."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from lpvobs.engines.base import AirPath
from lpvobs.engines.diesel.constants import COMPRESSOR_FORMS, TURBINE_FORMS
from lpvobs.engines.registry import ENGINES
from lpvobs.io.configuration.config import SCHEMA, load_config, record_of
from lpvobs.observer.settings import CONSTANTS
from lpvobs.simulation.parameters import SURFACE_KINDS

Schema = dict[str, Any]
CONFIGS = Path(__file__).parents[2] / "configs"
CHOICES = {
    ("LogPolicies", "backward_time"): ("refuse", "drop"),
    ("ErrorSurface", "kind"): SURFACE_KINDS,
    ("EstimateSettings", "constants"): CONSTANTS,
}
"""Texts of which only these are taken; the records check them when they are made."""
FORMS = {"Compressor": COMPRESSOR_FORMS, "Turbine": TURBINE_FORMS}
"""The forms of a component's relation with the keys that each has for itself; the first one is meant where none is named."""
TABLE = re.compile(r"\[(?P<name>[\w.]+)\]\s*(#\s*(?P<comment>.*\S))?\s*")
KEY = re.compile(r"(?P<name>\w+)\s*=\s*[^#]*#\s*(?P<comment>.*\S)\s*")
"""A key with its comment; no value of a shipped configuration contains a hash."""


def config_schema() -> Schema:
    """Return the schema: one alternative for every kind of engine, told apart by `air_path`.

    Arrays are written so that drafts before 2020-12, which editors still use, read them alike.
    """
    records = {name: record_of(kind) for name, kind in ENGINES.items()}
    _, components = msgspec.json.schema_components(records.values(), ref_template="#/$defs/{name}")
    defs = {name: _strict(component) for name, component in components.items()}
    for (record, key), choices in CHOICES.items():
        defs[record]["properties"][key]["enum"] = list(choices)
    for record, forms in FORMS.items():
        defs[record] |= {"oneOf": [_of_form(forms, form) for form in forms]}
    for name, kind in ENGINES.items():
        record, shipped = records[name].__name__, _shipped(name, kind.example)
        defs[record] = _of_engine(defs[record], name, [load_config(path)[0].engine_path() for path in shipped])
        for file in shipped:
            for path, comment in comments(file.read_text(encoding="utf-8")):
                _describe(defs, record, path, comment)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:lpvobs:config:{SCHEMA}",
        "title": "Configuration of lpvobs",
        "description": "Engine, map grid, gain and policies; commented examples: "
        + ", ".join(f"configs/{kind.example}" for kind in ENGINES.values())
        + ".",
        "oneOf": [{"$ref": f"#/$defs/{record.__name__}"} for record in records.values()],
        "$defs": defs,
    }


def _shipped(name: str, example: str) -> list[Path]:
    """Return the shipped configurations of a kind of engine, its example first."""
    others = [path for path in sorted(CONFIGS.glob("*.toml")) if path.name != example]
    return [CONFIGS / example, *(path for path in others if load_config(path)[0].air_path == name)]


def _of_form(forms: Mapping[str, Sequence[str]], form: str) -> Schema:
    """Return what a component's table has in one of its forms: its own keys, and none of another form."""
    named = () if form == next(iter(forms)) else ("form",)
    others = {key: False for other, keys in forms.items() if other != form for key in keys}
    return {"properties": {"form": {"const": form}} | others, "required": [*named, *forms[form]]}


def comments(text: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the comments behind tables and keys of a TOML text, with the path of each."""
    table: tuple[str, ...] = ()
    for line in text.splitlines():
        if found := TABLE.fullmatch(line):
            table = tuple(found["name"].split("."))
            if found["comment"]:
                yield table, found["comment"]
        elif found := KEY.fullmatch(line):
            yield (*table, found["name"]), found["comment"]


def _strict(schema: Any) -> Any:
    """Refuse unknown keys, as the reader does; write tuples as arrays of one kind; TOML has no null."""
    if isinstance(schema, list):
        return [_strict(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    if {"type": "null"} in schema.get("anyOf", []):
        (schema,) = (item for item in schema["anyOf"] if item != {"type": "null"})
    # an empty mapping by default is written by some versions of msgspec alone
    strict = {key: _strict(value) for key, value in schema.items() if not (key == "default" and value in (None, {}))}
    if "properties" in strict:
        strict["additionalProperties"] = False
        strict["description"] = strict.get("description", "").split("\n\n")[0]
    kinds = strict.pop("prefixItems", None)
    if kinds:
        if any(kind != kinds[0] for kind in kinds):
            raise ValueError(f"an array of several kinds, which older drafts write otherwise: {kinds}")
        strict["items"] = kinds[0]
    return strict


def _of_engine(schema: Schema, name: str, paths: Sequence[AirPath]) -> Schema:
    """Return a configuration's schema with the names that the engine has, in any form, where the records take any."""
    path = paths[0]
    axes = [axis.channel for axis in path.axes]
    rho = [parameter for parameter in path.parameter_names if parameter not in path.rate_names]
    constants = list(dict.fromkeys(c for path in paths for c in (*path.engine_constants(), *path.usual_tolerance)))
    temperatures = _named(path.temperature_names)
    own: Mapping[str, Schema] = {
        "schema": {"const": SCHEMA},
        "air_path": {"const": name},
        "map": _named(axes),
        "gain": _with(
            outputs={"items": {"enum": list(path.state_names)}, "uniqueItems": True},
            bounds=_named(rho, needed=()),
            temperatures=temperatures,
        ),
        "estimate": _with(tolerance=_named(constants, needed=())),
        "published": _with(
            temperatures=temperatures, x_0=dict.fromkeys(("minItems", "maxItems"), len(path.state_names))
        ),
        "ekf": _with(
            process_noise=_named(path.state_names),
            measurement_noise=_named((*path.state_names, path.sensor), needed=(path.sensor,)),
        ),
        "policies": _with(limits=_named(tuple(path.channels), needed=())),
    }
    properties = {key: dict(value) for key, value in schema["properties"].items()}
    for key, more in own.items():
        properties[key] = {"allOf": [properties[key], more]} if "$ref" in properties[key] else properties[key] | more
    return schema | {"properties": properties}


def _named(names: Sequence[str], needed: Sequence[str] | None = None) -> Schema:
    """Return the schema of a table with these names, all of them unless fewer are needed."""
    return {"propertyNames": {"enum": list(names)}, "required": list(names if needed is None else needed)}


def _with(**tables: Schema) -> Schema:
    return {"properties": tables}


def _describe(defs: dict[str, Schema], name: str, path: tuple[str, ...], comment: str) -> None:
    """Write a comment to the schema of a key; the first file that says something of it counts."""
    head, *rest = path
    found = defs[name].get("properties", {}).get(head)
    if found is None:
        return
    if not rest:
        found.setdefault("description", comment)
        return
    inner = next((item["$ref"] for item in found.get("allOf", [found]) if "$ref" in item), None)
    if inner is not None:
        _describe(defs, inner.rsplit("/", 1)[1], tuple(rest), comment)
