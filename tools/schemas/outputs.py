"""The JSON Schemas of what every verb prints with `--json`."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from lpvobs.discovery.held_out import MEASURE
from lpvobs.io.calibration.surfaces import ORIGINS
from lpvobs.maps.quadratic import COEFFICIENTS
from lpvobs.report.gates import METRICS

Schema = Mapping[str, Any]
TEXT: Schema = {"type": "string"}
YES: Schema = {"type": "boolean"}
COUNT: Schema = {"type": "integer", "minimum": 0}
NUMBER: Schema = {"type": "number"}
MEASURED: Schema = {"type": ["number", "null"]}
"""A number that may not be known: what is not finite is printed as null."""
SHA: Schema = {"type": "string", "pattern": "^[0-9a-f]{64}$"}


def described(schema: Schema, description: str) -> Schema:
    """Return a schema that says what it is of."""
    return {**schema, "description": description}


def ref(name: str) -> Schema:
    """Return a reference to one of DEFINITIONS."""
    return {"$ref": f"#/$defs/{name}"}


def nullable(schema: Schema) -> Schema:
    """Return a schema that also takes null."""
    return {"anyOf": [schema, {"type": "null"}]}


def array(items: Schema) -> Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": items}


def pair(items: Schema) -> Schema:
    """Return the schema of a list of two."""
    return {"type": "array", "items": items, "minItems": 2, "maxItems": 2}


def table(values: Schema) -> Schema:
    """Return the schema of an object with any keys."""
    return {"type": "object", "additionalProperties": values}


def record(needed: Mapping[str, Schema], optional: Mapping[str, Schema] | None = None) -> Schema:
    """Return the schema of an object with these keys and no other."""
    return {
        "type": "object",
        "properties": {**needed, **(optional or {})},
        "required": list(needed),
        "additionalProperties": False,
    }


def open_record(needed: Mapping[str, Schema]) -> Schema:
    """Return the schema of an object with these keys and perhaps others: it stood in a file that another version may have made."""
    return {"type": "object", "properties": needed, "required": list(needed)}


FRACTION = described(MEASURED, "A fraction: 0.02 is 2 %.")
METRIC_KINDS: Mapping[str, Schema] = {
    **dict.fromkeys(("samples", "samples_read", "dropped_rows", "gaps", "repeated"), COUNT),
    "duration": described(NUMBER, "s"),
    **dict.fromkeys(("share_certified", "mean_relative_error", "share_left_out", "rms_ratio"), FRACTION),
    **dict.fromkeys(("floor_mean_relative_error", "floor_rms_ratio"), FRACTION),
    **dict.fromkeys(("rmse", "bias"), described(MEASURED, "kg/s")),
    **dict.fromkeys(("visited_cells", "compared_samples"), nullable(COUNT)),
}
LOG: Mapping[str, Schema] = {
    "log": TEXT,
    "sha256": SHA,
    "found": described(table(COUNT), "Stuck, saturated and spiked samples, by kind and channel."),
    **{name: METRIC_KINDS[name] for name in METRICS},
}
COEFFICIENT_TABLE = record(dict.fromkeys(COEFFICIENTS, MEASURED))
EXTRAPOLATION: Mapping[str, Schema] = {
    "coefficients": described(COEFFICIENT_TABLE, "Of Eq. (37): kg/s, fuel in mg/cycle, speed in rpm."),
    "coefficients_standard_error": COEFFICIENT_TABLE,
    "lack_of_fit": described(MEASURED, "kg/s"),
    "nodes": COUNT,
}
BEFORE: Mapping[str, Schema] = {
    "measure": {"const": MEASURE},
    "unit": {"const": "kg/s"},
    "before": MEASURED,
    "held_out": TEXT,
}
AFTER: Mapping[str, Schema] = {"after": MEASURED, "ratio": MEASURED, "ratio_ci90": pair(MEASURED)}
VERDICT: Schema = {"enum": ["effect", "none", "unexplained"]}
RESIDUAL: Mapping[str, Schema] = {"white": YES, "correlated_with": array(TEXT)}
LEFT: Mapping[str, Schema] = {
    "when": array(record({"log": TEXT, "from": NUMBER, "to": NUMBER, "share": MEASURED})),
    "where": record({"fuel": pair(NUMBER), "speed": pair(NUMBER), "times_median_power": MEASURED}),
    "frequency": record({"half_power_below": MEASURED, "unit": {"const": "Hz"}}),
    "balance": TEXT,
}
THROTTLED: Mapping[str, Schema] = {
    "balances": array(ref("balance")),
    "day_to_day": array(record({"name": TEXT, "value": MEASURED, "unit": TEXT, "usual": MEASURED})),
    "missing": record({"channels": array(TEXT), "balances": array(TEXT), "same_place": array(array(TEXT))}),
}


REFUSED: Mapping[str, Schema] = {"refused": described(array(TEXT), "Logs that were left out, with the reason.")}


def found(error: str, extra: Mapping[str, Schema] | None = None) -> Schema:
    """Return the schema of what `trace` or `refine` found; `error` names the definition of its error."""
    part = record(
        {"log": TEXT, "verdict": VERDICT, "effects": array(ref("effect")), "error": ref(error)},
        {"residual": described(record(RESIDUAL), "Absent for a log held out."), **THROTTLED},
    )
    return record(
        {
            **(extra or {}),
            "map_frozen": YES,
            "verdict": VERDICT,
            "effects": array(ref("effect")),
            "error": ref(error),
            "residual": record(RESIDUAL, LEFT),
            "logs": array(part),
        },
        {
            "standing": described(array(ref("effect")), "Effects that the model had already."),
            "error_on_held_out_logs": ref(error),
            **THROTTLED,
        },
    )


def ingested(shape: Callable[[Mapping[str, Schema]], Schema]) -> Mapping[str, Schema]:
    """Return what `ingest` says of its work, the objects in it of a shape: closed, or open."""
    texts = ("file", "source", "unit_in_file", "unit_read_as", "unit", "meaning", "rule", "rule_from")
    channel = {
        **dict.fromkeys(texts, TEXT),
        **dict.fromkeys(("samples", "bridged", "without_value"), COUNT),
        "rate": described(MEASURED, "Hz, null for a single sample"),
        "limit": described(MEASURED, "s"),
        "repairs": table({"type": ["integer", "string"]}),
    }
    source = {"name": TEXT, "sha256": SHA, "notes": table(TEXT), "time_repairs": table(table(COUNT))}
    return {
        "description": TEXT,
        "sources": array(shape(source)),
        "time": shape({"from_zero": YES, "start": NUMBER, "backward": TEXT}),
        "raster": shape({"rate": NUMBER, "gap": NUMBER, "samples": COUNT}),
        "channels": table(shape(channel)),
        "missing": array(TEXT),
        "profile": shape({"name": TEXT, "sha256": SHA, "text": TEXT}),
    }


STORED = ingested(open_record)
CHANNEL = record(
    {
        "unit": TEXT,
        "unit_in_file": TEXT,
        "use": {"enum": ["needed", "auxiliary"]},
        "min": MEASURED,
        "median": MEASURED,
        "max": MEASURED,
        "dropped": COUNT,
        "refresh": described(MEASURED, "Hz, how often it changes; null for a constant"),
    }
)
INSPECTED = record(
    {
        "log": TEXT,
        "sha256": SHA,
        **dict.fromkeys(("samples", "samples_read", "dropped_rows", "repeated", "gaps", "segments"), COUNT),
        "duration": described(NUMBER, "s"),
        "rate": described(MEASURED, "Hz"),
        "defects": array(
            record({"defect": TEXT, "channel": TEXT, "count": COUNT, "policy": TEXT}, {"first": MEASURED})
        ),
        "channels": table(CHANNEL),
        "ingest": nullable(open_record(STORED)),
        "lacking": described(table(array(TEXT)), "By engine, where the log suits none."),
    }
)
GAIN: Mapping[str, Schema] = {
    "origin": TEXT,
    "outputs": array(TEXT),
    "L": array(array(NUMBER)),
    "proven": YES,
    "falling_gain": YES,
    "vertices": COUNT,
}
REPORTED = record(
    {
        "result": TEXT,
        "file": TEXT,
        "method": TEXT,
        "map": ref("map"),
        "extrapolation": nullable(record(EXTRAPOLATION)),
        "gain": record({**GAIN, "smallest_pivot": MEASURED}),
    },
    {"trace": ref("traced"), "refinement": ref("refined")},
)
CASE = {
    **dict.fromkeys(("case", "basis", "unit", "note"), TEXT),
    **dict.fromkeys(("expected", "found", "tolerance"), MEASURED),
    "passed": YES,
}
AGREEMENT = {
    "name": TEXT,
    "nodes": COUNT,
    "chi_square": MEASURED,
    "mean_difference": described(MEASURED, "kg/s"),
    "deviation": MEASURED,
    "disagrees": YES,
}

DEFINITIONS: Mapping[str, Schema] = {
    "map": record({"cells": COUNT, "estimated": COUNT, "extrapolated": COUNT}),
    "effect": record(
        {
            "id": TEXT,
            "parameters": table(record({"value": MEASURED, "unit": TEXT, "ci90": pair(MEASURED)})),
            "onset": described(MEASURED, "s since the start of its log; null: from the first sample"),
            "end": described(MEASURED, "s since the start of its log; null: to the last sample"),
            "explained": FRACTION,
            "p_value": MEASURED,
            "indistinguishable": array(TEXT),
        },
        {
            "drive": described(TEXT, "What kind of drive would tell it from the others."),
            "curve": record(
                {
                    **dict.fromkeys(("channel", "of", "changes"), TEXT),
                    **dict.fromkeys(("knots", "values"), array(NUMBER)),
                }
            ),
        },
    ),
    "before": record(BEFORE),
    "before_after": record({**BEFORE, **AFTER}),
    "balance": record(
        {
            "balance": TEXT,
            "unit": {"const": "1"},
            **dict.fromkeys(("before", "after", "healthy", "usual_before", "usual_after", "recovered"), FRACTION),
            "affected": YES,
        }
    ),
    "traced": found("before", {"logs_used": array(TEXT)}),
    "refined": found("before_after", {"logs_used": array(TEXT)}),
}

OUTPUTS: Mapping[str, tuple[str, Schema]] = {
    "simulate": (
        "A log that was driven.",
        record({"log": TEXT, "samples": COUNT, "duration": described(NUMBER, "s"), "channels": array(TEXT)}),
    ),
    "ingest": ("What was done to make a log of a recording.", record({"log": TEXT, **ingested(record)})),
    "profile": (
        "A drafted profile.",
        record({"source": TEXT, "profile": nullable(TEXT), "text": TEXT}),
    ),
    "inspect": (
        "What is in logs, and what the policies did.",
        record({"logs": array(INSPECTED), "refused": array(TEXT)}),
    ),
    "synth-gain": (
        "A gain with its certificate.",
        record(
            {
                "gain": TEXT,
                **GAIN,
                "eps_1": NUMBER,
                "eps_2": NUMBER,
                "region": described(table(pair(NUMBER)), "Range of every parameter that the proof covers."),
                "nonnegative_sums": array(pair({"type": ["string", "integer"]})),
                "logs": described(table(pair(array(NUMBER))), "Least and largest parameters along each log."),
            }
        ),
    ),
    "verify": (
        "A certificate proven again, or not.",
        record(
            {
                "gain": TEXT,
                "proven": YES,
                "falling_gain": YES,
                "vertices": COUNT,
                "smallest_pivot": MEASURED,
                "failed_vertex": nullable(array(NUMBER)),
                "reason": TEXT,
                "region": TEXT,
            }
        ),
    ),
    "estimate": (
        "A map, and its metrics by log.",
        record(
            {
                "result": TEXT,
                "method": TEXT,
                "logs": array(record(LOG)),
                **REFUSED,
                "map": record({"nodes": COUNT, "estimated": COUNT}),
                "scatter": described(MEASURED, "kg/s, of a node between logs"),
                "agreement": array(record(AGREEMENT)),
            }
        ),
    ),
    "extrapolate": (
        "The quadratic of Eq. (37).",
        record({"result": TEXT, "outer_coverage": FRACTION, **EXTRAPOLATION}),
    ),
    "trace": ("What the model lacks.", found("before", REFUSED)),
    "refine": ("What was added to the model, error before and after.", found("before_after", REFUSED)),
    "export": (
        "A map for calibration tools, and what it changes.",
        record(
            {
                "out": TEXT,
                "format": {"enum": ["dcm", "csv", "netcdf"]},
                "values": {"enum": ["map", "extrapolation"]},
                "digits": COUNT,
                "nodes": described(record({}, dict.fromkeys(ORIGINS.values(), COUNT)), "By origin."),
                "changes": nullable(
                    array(record({**dict.fromkeys(("x", "y", "old", "new"), MEASURED), "origin": TEXT}))
                ),
            }
        ),
    ),
    "report": (
        "Metrics of every log; map and extrapolation are those of the first result.",
        record(
            {
                "logs": array(record({"result": TEXT, "method": TEXT, "paper_mean_relative_error": FRACTION, **LOG})),
                "map": ref("map"),
                "extrapolation": nullable(record(EXTRAPOLATION)),
                "results": array(REPORTED),
            }
        ),
    ),
    "selftest": (
        "Cases with known answers.",
        record({"passed": YES, "cases": array(record(CASE)), "versions": table(TEXT)}),
    ),
}


def output_schema(verb: str) -> Schema:
    """Return the schema of the object that a verb prints."""
    description, content = OUTPUTS[verb]
    name = f"lpvobs/{verb}/1"
    shape = {
        **content,
        "properties": {"schema": {"const": name}, **content["properties"]},
        "required": ["schema", *content["required"]],
    }
    needed = set(_references(shape))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{name.replace('/', ':')}",
        "title": f"lpvobs {verb} --json",
        "description": description,
        **shape,
        "$defs": {key: DEFINITIONS[key] for key in DEFINITIONS if key in needed},
    }


def _references(schema: Any) -> Iterator[str]:
    """Yield the definitions that a schema needs, those of its definitions included."""
    if isinstance(schema, Mapping):
        if "$ref" in schema:
            name = schema["$ref"].rsplit("/", 1)[1]
            yield name
            yield from _references(DEFINITIONS[name])
        for value in schema.values():
            yield from _references(value)
    elif isinstance(schema, list):
        for item in schema:
            yield from _references(item)
