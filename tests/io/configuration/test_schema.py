"""`schemas/config.json`: current, true of the shipped files, and of one mind with the reader."""

import copy
import json
import tomllib
from pathlib import Path

import pytest
from repository import ROOT

from lpvobs.errors import UsageError
from lpvobs.io.configuration import config

jsonschema = pytest.importorskip("jsonschema", reason="a library of the extra lpvobs[dev]")

SCHEMAS = ROOT / "schemas"
FILES = ("diesel.toml", "heavy-duty.toml", "liu-ice.toml")


@pytest.fixture(scope="module")
def made():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "tools" / "schemas")
        import make

        yield make.documents()


@pytest.fixture(scope="module")
def schema():
    return jsonschema.Draft202012Validator(json.loads((SCHEMAS / "config.json").read_text(encoding="utf-8")))


def test_the_stored_schemas_are_current(made):
    stored = {path.name: path.read_text(encoding="utf-8") for path in SCHEMAS.iterdir()}
    assert sorted(stored) == sorted(made)
    for name, text in made.items():
        assert stored[name] == text, f"{name}: run `make schemas`"


@pytest.mark.parametrize("draft", ["Draft7Validator", "Draft202012Validator"])
@pytest.mark.parametrize("name", FILES)
def test_the_shipped_files_validate_in_old_and_new_editors(schema, draft, name):
    validator = getattr(jsonschema, draft)
    validator.check_schema(schema.schema)
    document = tomllib.loads((ROOT / "configs" / name).read_text(encoding="utf-8"))
    validator(schema.schema).validate(document)


@pytest.mark.parametrize("name", FILES)
def test_editors_find_the_schema(name):
    path = ROOT / "configs" / name
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("#:schema ")
    assert (path.parent / first.removeprefix("#:schema ")).resolve() == SCHEMAS / "config.json"


def paths(table, at=()):
    for key, value in table.items():
        yield (*at, key)
        if isinstance(value, dict):
            yield from paths(value, (*at, key))


def changed(document, path, change):
    new = copy.deepcopy(document)
    table = new
    for key in path[:-1]:
        table = table[key]
    change(table, path[-1])
    return new


CHANGES = {
    "missing": lambda table, key: table.pop(key),
    "misspelt": lambda table, key: table.update({f"{key}_": table.pop(key)}),
    "of another type": lambda table, key: table.update({key: "x"}),
}
EVERY = 4
"""One key in so many is tried, others with every change: reading a whole configuration takes 20 ms, and there are 450 cases."""
DEPENDENT = {("ekf", "measurement_noise")}
"""Which outputs need a noise is written elsewhere in the file; a schema cannot compare."""


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", FILES)
@pytest.mark.slow
def test_schema_and_reader_refuse_the_same(schema, name, change, monkeypatch):
    document = tomllib.loads((ROOT / "configs" / name).read_text(encoding="utf-8"))
    start = list(CHANGES).index(change)
    refused = 0
    for path in list(paths(document))[start::EVERY]:
        new = changed(document, path, CHANGES[change])
        monkeypatch.setattr(config, "parse", lambda text, where, new=new: new)
        valid = schema.is_valid(new)
        if path[:-1] in DEPENDENT:
            assert valid or not is_read(name), (path, change)
        else:
            assert valid == is_read(name), (path, change)
        refused += not valid
    assert refused > 5


def is_read(name):
    try:
        config.config_of("", Path(name))
    except UsageError:
        return False
    return True
