"""TOML files read strictly into frozen records.

What the record does not know is refused with the nearest key that exists; what the file lacks is named.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from lpvobs.engines.constants import Within
from lpvobs.errors import UsageError

Record = TypeVar("Record")
MOST_BYTES = 2**18
_ENDLESS_KEY = re.compile(r"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){32}")
"""A key of so many parts; the parser's time grows with the square of their number."""


def read_text(path: Path) -> str:
    """Return the text of a TOML file, or say why it cannot be read."""
    try:
        if path.is_file() and path.stat().st_size > MOST_BYTES:
            raise UsageError(f"{path}: is larger than {MOST_BYTES} bytes, the limit for a TOML file; name another file")
        if path.exists() and not path.is_file():
            raise UsageError(f"{path}: cannot be read (not a regular file); name a TOML file")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); name a TOML file") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is not UTF-8 text; name a TOML file") from None


def parse(text: str, path: Path) -> dict[str, Any]:
    """Return the document in a TOML text; `path` names it in errors."""
    if _ENDLESS_KEY.search(text):
        raise UsageError(f"{path}: a key has more than 32 names separated by dots; shorten this key")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise UsageError(f"{path}: has too many brackets inside brackets; write fewer levels") from None
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        raise UsageError(f"{path}: is not TOML ({error}); correct this line") from None


def convert(path: Path, document: Mapping[str, Any], record: type[Record], example: str) -> Record:
    """Return a document as a record; `example` is a commented file that shows every key."""
    try:
        converted: Record = _record(document, record, "", example)
    except ArithmeticError as error:  # two values, each possible, that cannot be divided or counted
        raise UsageError(f"{path}: a value is far too large or too small ({error}); correct the value") from None
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from None
    return converted


def _record(table: Mapping[str, Any], record: Any, where: str, example: str) -> Any:
    """Return a table as a record; raises ValueError for a key that is unknown or missing, and for a value that cannot be."""
    known, hints = {item.name: item for item in fields(record)}, get_type_hints(record, include_extras=True)
    for key in table:
        if key not in known:
            import difflib

            near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
            hint = f"did you mean '{near[0]}'?" if near else f"keys known here: {', '.join(known)}"
            raise ValueError(f"unknown key '{where}{key}'; {hint}")
    for key, wanted in known.items():
        if key not in table and wanted.default is MISSING and wanted.default_factory is MISSING:
            raise ValueError(f"key '{where}{key}' is missing; the commented file {example} explains it")
    values = {key: _value(value, hints[key], f"{where}{key}", example) for key, value in table.items()}
    try:
        return record(**values)
    except ValueError as error:  # values that do not go together
        raise _wrong(where.removesuffix("."), error) from None


def _value(value: Any, hint: Any, place: str, example: str) -> Any:
    """Return a value as a type hint has it, the tables in it as records."""
    said = getattr(hint, "__metadata__", ())
    kind = hint.__origin__ if said else hint
    inner, several = record_in(kind), get_origin(kind) is tuple
    if is_mapping(kind) and isinstance(value, Mapping):
        of = get_args(kind)[1]
        return {name: _value(item, of, f"{place}.{name}", example) for name, item in value.items()}
    if inner is not None and isinstance(value, list) and several:
        return tuple(_value(item, inner, f"{place}[{number}]", example) for number, item in enumerate(value))
    if inner is not None and isinstance(value, Mapping) and not several:
        return _record(value, inner, f"{place}.", example)
    try:
        found = msgspec.convert(value, kind if inner is None else list if several else dict)
    except msgspec.ValidationError as error:
        raise _wrong(place, error) from None
    for bounds in (item for item in said if isinstance(item, Within)):
        for number in found if isinstance(found, tuple) else (found,):
            if number is not None and (complaint := bounds.complaint(number)):
                raise ValueError(f"{place} = {complaint}")
    return found


PLAIN = {"bool": "true or false", "int": "a whole number", "float": "a number", "str": "a text"}
PLAIN |= {"object": "a table", "array": "a list", "null": "nothing"}
"""What TOML calls the types that msgspec names."""


def _wrong(place: str, error: Exception) -> ValueError:
    """Return what is wrong at a place of the file; msgspec says behind it which item of a list it means."""
    raw, _, within = str(error).replace("`", "").partition(" - at $")
    said = re.sub(r"\w+", lambda found: PLAIN.get(found[0], found[0]), raw)
    return ValueError(f"{place}{within}: {said[:1].lower()}{said[1:]}; correct this key".removeprefix(": "))


def is_mapping(hint: Any) -> bool:
    """Return whether a type hint is that of a table by name."""
    origin = get_origin(hint)
    return isinstance(origin, type) and issubclass(origin, Mapping)


def record_in(hint: Any) -> type | None:
    """Return the dataclass inside a type hint: itself, of an optional, a tuple, or a mapping's values."""
    if is_dataclass(hint) and isinstance(hint, type):
        return hint
    if get_origin(hint) in (Union, UnionType, tuple) or is_mapping(hint):
        return next((found for found in map(record_in, get_args(hint)) if found is not None), None)
    return None
