"""The JSON Schemas of what every verb prints with `--json`, from the records that are printed."""

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from lpvobs.api.compare import CompareOutput
from lpvobs.api.estimate import EstimateOutput
from lpvobs.api.export_unit import ExportOutput
from lpvobs.api.extrapolate import ExtrapolateOutput
from lpvobs.api.ingest_log import ProfileOutput
from lpvobs.api.inspect import InspectOutput
from lpvobs.api.refine import RefineOutput
from lpvobs.api.simulate import SimulateOutput
from lpvobs.api.synth_gain import SynthGainOutput
from lpvobs.api.trace import TraceOutput
from lpvobs.api.track import TrackOutput
from lpvobs.api.verify import VerifyOutput
from lpvobs.discovery.outcome import StoredOutcome
from lpvobs.ingest.record import IngestOutput, IngestRecord
from lpvobs.report.engines import CalibrateOutput
from lpvobs.report.outputs import ReportOutput
from lpvobs.selftest.cases import SelftestOutput

Schema = dict[str, Any]
RECORDS: Mapping[str, Any] = {
    "simulate": SimulateOutput,
    "ingest": IngestOutput,
    "profile": ProfileOutput,
    "inspect": InspectOutput,
    "calibrate": CalibrateOutput,
    "synth-gain": SynthGainOutput,
    "verify": VerifyOutput,
    "estimate": EstimateOutput,
    "compare": CompareOutput,
    "extrapolate": ExtrapolateOutput,
    "trace": TraceOutput,
    "refine": RefineOutput,
    "export": ExportOutput,
    "track": TrackOutput,
    "report": ReportOutput,
    "selftest": SelftestOutput,
}


def output_schema(verb: str) -> Schema:
    """Return the schema of the object that a verb prints."""
    shape, defs = _of_record(RECORDS[verb])
    name = f"lpvobs/{verb}/1"
    shape["properties"] = {**shape["properties"], "schema": {"const": name}}
    shape["required"] = list(dict.fromkeys(["schema", *shape["required"]]))
    needed = set(_references(shape, defs))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{name.replace('/', ':')}",
        **shape,
        "title": f"lpvobs {verb} --json",
        "$defs": {key: defs[key] for key in sorted(needed)},
    }


def _of_record(record: Any) -> tuple[Schema, Mapping[str, Schema]]:
    """Return the schema of a record, and those of the records in it by name."""
    (reference, *_), components = msgspec.json.schema_components(
        [record, IngestRecord, StoredOutcome], ref_template="#/$defs/{name}"
    )
    defs = {name: _as_printed(component) for name, component in components.items()}
    return defs[reference["$ref"].rsplit("/", 1)[1]], defs


def _as_printed(schema: Any) -> Any:
    """Return a schema of what is printed: no keys but the record's, null for a number that is not finite."""
    if isinstance(schema, list):
        return [_as_printed(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    if {"type": "null"} in schema.get("anyOf", []):
        (one,) = (item for item in schema.pop("anyOf") if item != {"type": "null"})
        schema = {"anyOf": [one, {"type": "null"}], **schema} if "$ref" in one else schema | one
        if "type" in schema and schema["type"] != "number":
            schema["type"] = [schema["type"], "null"]
    shape = {key: _as_printed(value) for key, value in schema.items() if key not in ("finite", "default")}
    if shape.get("type") == "number" and "finite" not in schema:
        shape["type"] = ["number", "null"]
    if "properties" in shape:
        shape["additionalProperties"] = False
        shape["description"] = shape.get("description", "").split("\n\n")[0]
    return shape


def _references(schema: Any, defs: Mapping[str, Any]) -> Iterator[str]:
    """Yield the definitions that a schema needs, those of its definitions included."""
    if isinstance(schema, Mapping):
        if "$ref" in schema:
            name = schema["$ref"].rsplit("/", 1)[1]
            yield name
            yield from _references(defs[name], defs)
        for value in schema.values():
            yield from _references(value, defs)
    elif isinstance(schema, list):
        for item in schema:
            yield from _references(item, defs)
