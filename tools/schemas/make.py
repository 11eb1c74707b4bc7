"""Writes the JSON Schemas in `schemas`: of every verb's output, and of the configuration; `make schemas`."""

import json
from pathlib import Path

from configuration import config_schema
from outputs import RECORDS, output_schema

FOLDER = Path(__file__).parents[2] / "schemas"


def documents() -> dict[str, str]:
    """Return the text of every schema by the name of its file."""
    schemas = {f"{verb}.json": output_schema(verb) for verb in RECORDS} | {"config.json": config_schema()}
    return {name: json.dumps(schema, indent=1, ensure_ascii=False) + "\n" for name, schema in schemas.items()}


if __name__ == "__main__":
    for name, text in documents().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
