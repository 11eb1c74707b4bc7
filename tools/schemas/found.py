"""The JSON Schemas of what `trace` and `refine` have found, whose objects are not made of records yet."""

from collections.abc import Mapping
from typing import Any

from lpvobs.discovery.held_out import MEASURE

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


FRACTION = described(MEASURED, "A fraction: 0.02 is 2 %.")
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
MISSING: Mapping[str, Schema] = {
    "missing": record({"channels": array(TEXT), "balances": array(TEXT), "same_place": array(array(TEXT))}),
}


REFUSED: Mapping[str, Schema] = {"refused": described(array(TEXT), "Logs that were left out, with the reason.")}


def found(error: str, extra: Mapping[str, Schema] | None = None) -> Schema:
    """Return the schema of what `trace` or `refine` found; `error` names the definition of its error."""
    part = record(
        {
            "log": TEXT,
            "verdict": VERDICT,
            "effects": array(ref("effect")),
            "error": ref(error),
            "balances": array(ref("balance")),
            "day_to_day": array(record({"name": TEXT, "value": MEASURED, "unit": TEXT, "usual": MEASURED})),
        },
        {"residual": described(record(RESIDUAL), "Absent for a log held out."), **MISSING},
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
            "known_effects": described(array(ref("effect")), "Effects that the model had already."),
            "error_on_held_out_logs": ref(error),
        },
    )


DEFINITIONS: Mapping[str, Schema] = {
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
            "unit": {"enum": ["1", "kg/s"]},
            **dict.fromkeys(("before", "after", "healthy", "usual_before", "usual_after", "recovered"), FRACTION),
            "affected": YES,
        }
    ),
    "traced": found("before", {"logs_used": array(TEXT)}),
    "refined": found("before_after", {"logs_used": array(TEXT)}),
}
