"""An engine is one folder: no other room names it, its channels, its states, its parameters or its constants.

Reads the sources with `ast`: texts, attributes, keywords, arguments, imports and the names of functions, classes and fields count;
docstrings, comments and local names do not.
"""

import ast
import re
from fnmatch import fnmatch
from functools import cache

import pytest
from repository import ROOT

from lpvobs.engines.channels import recorded
from lpvobs.engines.registry import ENGINES
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.io.configuration.config import load_config

PACKAGE = ROOT / "lpvobs"
PLANTS = {
    "nine states": (
        "effects", "instruments", "integrate", "parameters", "plant", "readings", "road", "scene", "simulate",
        "stationary", "structure", "vehicle",
    ),
}  # fmt: skip
"""The files of `simulation` that are one engine's plant, with its control, its sensors and its road."""
NOT_YET = ()
"""What still names an engine. This list may only shrink: an entry that has become clean fails the test until it is removed."""
EXEMPT = (
    "engines/registry.py",
    "engines/*/*.py",
    *(f"simulation/{name}.py" for names in PLANTS.values() for name in names),
)
SOURCES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


def fits(source, patterns):
    return any(fnmatch(source, pattern) for pattern in patterns)


@cache
def words_of(name):
    """Return every name that is one engine's own business."""
    kind = ENGINES[name]
    path = load_config(ROOT / "configs" / kind.example)[0].engine_path()
    own = {
        *path.channels, *kind.recorded(), *path.state_names, *path.parameter_names, *path.temperature_names, *path.rate_names,
        *path.smoothed, *path.usual_tolerance, *path.engine_constants(), *(axis.channel for axis in path.axes), path.sensor,
    }  # fmt: skip
    own_records = (kind.air_path, *kind.tables.values())
    return frozenset(own | {r.__name__ for r in own_records if r.__module__ != ResidualModel.__module__})


TRUTH = {"W_c"}
"""The true flow past the sensor, which a simulated log holds as `ref_W_c` and one engine as a state."""
ALL_WORDS = (frozenset(word for name in ENGINES for word in words_of(name)) | frozenset(recorded(""))) - TRUTH


def docstrings(tree):
    """Yield the texts that only explain: any that stands as a statement of its own."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield id(node.value)


def said(tree):
    """Yield the words that code says, with their lines."""
    explaining = set(docstrings(tree))
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        match node:
            case ast.Constant(value=str(text)) if id(node) not in explaining:
                texts = [text]
            case ast.Attribute(attr=text) | ast.arg(arg=text) | ast.keyword(arg=str(text)) | ast.alias(name=text):
                texts = [text]
            case ast.FunctionDef(name=text) | ast.ClassDef(name=text) | ast.AnnAssign(target=ast.Name(id=text)):
                texts = [text]
            case ast.ImportFrom(module=str(text)):
                texts = [text]
            case _:
                texts = []
        for text in texts:
            yield from ((word, line) for word in re.findall(r"\w+", text))


def offences(tree, words=ALL_WORDS, names=tuple(ENGINES)):
    """Return what a module says that only an engine's folder may."""
    return sorted(
        {
            f"{word} in line {line}"
            for word, line in said(tree)
            if word in words or any(name in word.lower() for name in names)
        }
    )


def tree_of(source):
    return ast.parse(SOURCES[source].read_text(encoding="utf-8"))


@pytest.mark.parametrize("source", [source for source in SOURCES if not fits(source, (*EXEMPT, *NOT_YET, "engines/*"))])
def test_a_room_knows_no_engine(source):
    assert offences(tree_of(source)) == []


@pytest.mark.parametrize(
    "source", [source for source in SOURCES if fits(source, ["engines/*.py"]) and source.count("/") == 1]
)
def test_what_engines_share_names_none_of_them(source):
    if source != "engines/registry.py":
        assert offences(tree_of(source), ALL_WORDS - set(recorded(""))) == []


@pytest.mark.parametrize("source", [source for source in SOURCES if fits(source, ["engines/*/*.py"])])
def test_an_engine_knows_no_other_engine(source):
    others = [name for name, kind in ENGINES.items() if kind.air_path.__module__.split(".")[2] != source.split("/")[1]]
    assert offences(tree_of(source), words=frozenset(), names=others) == []


@pytest.mark.parametrize("pattern", NOT_YET)
def test_what_is_not_yet_clean_is_still_not(pattern):
    assert any(offences(tree_of(source)) for source in SOURCES if fnmatch(source, pattern)), f"remove {pattern}"


def test_a_plant_belongs_to_an_engine():
    assert set(PLANTS) == {kind.plant for kind in ENGINES.values() if kind.plant}
    for source in (source for source in EXEMPT if source.startswith("simulation/")):
        assert source in SOURCES


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ('log["u_delta"]', ["u_delta in line 1"]),
        ("log.omega_t", ["omega_t in line 1"]),
        ("f(m_f=1)", ["m_f in line 1"]),
        ("def f(alpha_th): ...", ["alpha_th in line 1"]),
        ('path == "diesel"', ["diesel in line 1"]),
        ("from lpvobs.engines.throttled import ENGINE", ["throttled in line 1"]),
        ("isinstance(path, a.Diesel)", ["Diesel in line 1"]),
        ('f"{x} of p_em"', ["p_em in line 1"]),
        ("class A:\n    T_ic: float", ["T_ic in line 2"]),
        ('{"V_d": 1}', ["V_d in line 1"]),
        ('log["n_e"]', ["n_e in line 1"]),
        ('"""A diesel."""\nn_e, speed = axes', []),
    ],
)
def test_the_reader_sees_what_it_should(code, found):
    assert offences(ast.parse(code)) == found
