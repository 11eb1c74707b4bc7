"""TOML files read strictly into frozen records.

What the record does not know is refused with the nearest key that exists; what the file lacks is named.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import reduce
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
    _refuse_unknown(path, document, record, "", example)
    try:
        converted = msgspec.convert(document, record)
    except msgspec.ValidationError as error:
        raise UsageError(f"{path}: {_in_words(error, document, record)}; correct this key") from None
    except ArithmeticError as error:  # two values, each possible, that cannot be divided or counted
        raise UsageError(f"{path}: a value is far too large or too small ({error}); correct the value") from None
    for where, complaint in _out_of_bounds(converted, ""):
        raise UsageError(f"{path}: {where} = {complaint}")
    return converted


PLAIN = {"bool": "true or false", "int": "a whole number", "float": "a number", "str": "a text"}
PLAIN |= {"object": "a table", "array": "a list", "null": "nothing"}
"""What TOML calls the types that msgspec names."""


def _in_words(error: msgspec.ValidationError, document: Mapping[str, Any], record: type) -> str:
    """Return what a value should be behind its place in the file; msgspec writes `[...]` for an entry of a table by name."""
    raw, _, place = str(error).replace("`", "").partition(" - at $")
    said = re.sub(r"\b(bool|int|float|str|object|array|null)\b", lambda found: PLAIN[found[0]], raw)
    place = place.removeprefix(".")
    table, by_name, _ = place.partition("[...]")
    parts = table.split(".")
    for name in reduce(lambda inner, part: inner.get(part, {}), parts, document) if by_name else ():
        try:
            msgspec.convert(_with_only(document, parts, name), record)
        except msgspec.ValidationError as again:
            if str(again) == str(error):
                place = place.replace("[...]", f".{name}", 1)
    return f"{place}: {said[:1].lower()}{said[1:]}".removeprefix(": ")


def _with_only(document: Mapping[str, Any], parts: list[str], name: str) -> dict[str, Any]:
    """Return a document with one entry alone in one of its tables."""
    if not parts:
        return {name: document[name]}
    return {**document, parts[0]: _with_only(document[parts[0]], parts[1:], name)}


def _out_of_bounds(record: Any, where: str) -> Iterator[tuple[str, str]]:
    """Yield the place of every value, at any depth, that its record says cannot be, with the complaint."""
    for name, hint in get_type_hints(type(record), include_extras=True).items():
        value = getattr(record, name)
        if is_dataclass(value):
            yield from _out_of_bounds(value, f"{where}{name}.")
        for bounds in (item for item in getattr(hint, "__metadata__", ()) if isinstance(item, Within)):
            for number in value if isinstance(value, tuple) else (value,):
                if number is not None and (complaint := bounds.complaint(number)):
                    yield f"{where}{name}", complaint


def _refuse_unknown(path: Path, document: Mapping[str, Any], record: type, where: str, example: str) -> None:
    """Raise for the first key that the record does not have, at any depth."""
    known = {item.name: item for item in fields(record)}
    hints = get_type_hints(record)
    for key, value in document.items():
        if key not in known:
            import difflib

            near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
            hint = f"did you mean '{near[0]}'?" if near else f"keys known here: {', '.join(known)}"
            raise UsageError(f"{path}: unknown key '{where}{key}'; {hint}")
        inner = record_in(hints[key])
        if inner is None:
            continue
        for place, item in _tables(value, f"{where}{key}", is_mapping(hints[key])):
            _refuse_unknown(path, item, inner, f"{place}.", example)
    for key, wanted in known.items():
        if key not in document and wanted.default is MISSING and wanted.default_factory is MISSING:
            raise UsageError(f"{path}: key '{where}{key}' is missing; the commented file {example} explains it")


def _tables(value: Any, where: str, by_name: bool) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the tables in a value with their places: the value itself, its entries by name, or those of a list."""
    if isinstance(value, list):
        entries = [(f"{where}[{number}]", item) for number, item in enumerate(value)]
    elif by_name and isinstance(value, Mapping):
        entries = [(f"{where}.{name}", item) for name, item in value.items()]
    else:
        entries = [(where, value)]
    return [(place, item) for place, item in entries if isinstance(item, Mapping)]


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
