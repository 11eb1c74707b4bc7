"""What `ingest` did to make a log, as it is stored with the log and read back."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

SCHEMA = "lpvobs/ingest/1"
KEY = "lpvobs.ingest"
SOURCE = {"name": str, "sha256": str, "notes": dict, "time_repairs": dict}
SHOWN = {
    "file": str,
    "source": str,
    "unit_read_as": str,
    "unit": str,
    "rate": float | None,
    "rule": str,
    "bridged": int,
    "without_value": int,
    "repairs": dict,
}


def stored_record(path: Path) -> dict[str, Any] | None:
    """Return what `ingest` did to make a log, None for a log that it did not make."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        stored = (pq.read_schema(path).metadata or {}).get(KEY.encode())
        record = json.loads(stored) if stored else None
    except (pa.ArrowException, OSError, ValueError):
        return None
    return record if isinstance(record, dict) and _is_whole(record) else None


def _is_whole(record: Mapping[str, Any]) -> bool:
    """Return whether a stored record has everything that `inspect` shows; files come from strangers."""
    shape: list[tuple[Any, dict[str, Any]]] = [
        (record, {"schema": str, "sources": list, "channels": dict, "missing": list}),
        (record.get("time"), {"from_zero": bool, "start": float}),
        (record.get("raster"), {"rate": int | float, "gap": int | float, "samples": int}),
        (record.get("profile"), {"name": str, "sha256": str}),
    ]
    if record.get("schema") != SCHEMA or not all(_has(item, kinds) for item, kinds in shape):
        return False
    clocks = [found for item in record["sources"] if _has(item, SOURCE) for found in item["time_repairs"].values()]
    return (
        all(_has(item, SOURCE) for item in record["sources"])
        and all(isinstance(found, dict) for found in clocks)
        and all(isinstance(name, str) for name in record["missing"])
        and all(_has(item, SHOWN) for item in record["channels"].values())
    )


def _has(item: Any, kinds: Mapping[str, Any]) -> bool:
    return isinstance(item, dict) and all(isinstance(item.get(key), kind) for key, kind in kinds.items())
