"""What every verb prints with --json against its published schema, which refuses anything else."""

import copy
import json
import shutil

import pyarrow.parquet as pq
import pytest
from msgspec import UNSET
from typer.testing import CliRunner

import lpvobs.selftest.cases
from lpvobs.cli.main import app
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.outcome import (
    BalanceError,
    DayLevel,
    DrivesNeeded,
    Finding,
    Followed,
    Leading,
    Missing,
    OutcomeOnLog,
    Parameter,
    ResidualOutput,
    Trace,
    error_output,
)
from lpvobs.discovery.whiteness import Leftover, Stretch

jsonschema = pytest.importorskip("jsonschema", reason="a library of the extra lpvobs[dev]")

VERBS = tuple(command.name for command in app.registered_commands)
PROFILE = 'schema = 1\n[time]\nsource = "t"\nunit = "s"\n[channels.p_im]\nsource = "map"\nunit = "Pa"\n'


@pytest.fixture(scope="module")
def validator(config):
    def of(verb):
        path = config.parents[1] / "schemas" / f"{verb}.json"
        return jsonschema.Draft202012Validator(json.loads(path.read_text(encoding="utf-8")))

    return of


@pytest.fixture(scope="module")
def outputs(config, chain, other_engine, refined, traced, together, tmp_path_factory):
    """Return what each verb prints, called in ways that fill as much of its object as possible."""
    folder = tmp_path_factory.mktemp("outputs")
    table = pq.read_table(chain.log).slice(0, 3000)
    slow, bare, result = folder / "slow.parquet", folder / "bare.parquet", folder / "result.h5"
    pq.write_table(table.drop_columns([name for name in table.column_names if name.startswith("ref_")]), bare)
    gain = table.column_names.index("W_maf")
    wrong = table.set_column(gain, table.schema.field("W_maf"), [1.05 * table["W_maf"].to_numpy()])
    pq.write_table(wrong, slow)
    shutil.copy(chain.result, result)
    (folder / "drive.csv").write_text(
        "t,map [kPa]\n0.7,broken\n" + "".join(f"{0.1 * k:.1f},{100 + k}\n" for k in range(8, 40)), encoding="utf-8"
    )
    (folder / "mine.toml").write_text(PROFILE, encoding="utf-8")
    cycle = folder / "short.csv"
    cycle.write_text("time_s,speed_kmh\n0,0\n5,0\n20,30\n30,30\n40,0\n", encoding="utf-8")
    log = folder / "log.parquet"
    (folder / "whose.csv").write_text(f"log,vehicle,date\n{bare},a,2025-01\n{slow},b,2025-02\n", encoding="utf-8")
    fleet = ("--origins", folder / "whose.csv")
    calls = {
        "ingest": (
            "ingest",
            folder / "drive.csv",
            "--profile",
            folder / "mine.toml",
            "--out",
            folder / "drive.parquet",
        ),
        "profile": ("profile", folder / "drive.csv"),
        "inspect": ("inspect", folder / "drive.parquet", chain.log),
        "simulate": ("simulate", "--config", config, "--cycle", cycle, "--rate", 10, "--out", log),
        "synth-gain": ("synth-gain", "--config", config, chain.log, "--out", folder / "gain.h5"),
        "calibrate": ("calibrate", "--config", config, "--bench", other_engine.bench, "--out", folder / "engine.h5"),
        "verify": ("verify", chain.gain),
        "extrapolate": ("extrapolate", result),
        "compare": ("compare", chain.result, result),
        "export": ("export", result, "--format", "dcm", "--digits", 3, "--out", folder / "map.dcm"),
        "export again": ("export", result, "--format", "dcm", "--old", folder / "map.dcm", "--out", folder / "new.dcm"),
        "export unit": ("export", chain.gain, result, "--format", "c99", "--out", folder / "unit"),
        "report": ("report", refined[0], traced[0]),
        "selftest": ("selftest",),
        "track": (
            "track",
            bare,
            slow,
            *fleet,
            "--config",
            config,
            "--gain",
            chain.gain,
            "--out",
            folder / "fleet.h5",
        ),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lpvobs.selftest.cases, "CASES", {"units": lpvobs.selftest.cases.units})
        shared = {"estimate": together[1].json, "trace": traced[2].json, "refine": refined[1]}
        return {name: printed(call) for name, call in calls.items()} | shared


def printed(call):
    done = CliRunner().invoke(app, [*map(str, call), "--json"])
    assert done.exit_code == 0, f"{call}: {done.stderr}"
    return json.loads(done.stdout)


@pytest.mark.proof
def test_every_verb_is_called_and_has_a_schema(outputs, validator):
    assert {content["schema"] for content in outputs.values()} == {f"lpvobs/{verb}/1" for verb in VERBS}
    for verb in VERBS:
        found = validator(verb)
        found.check_schema(found.schema)


def test_what_is_printed_is_valid(outputs, validator):
    for content in outputs.values():
        validator(verb_of(content)).validate(content)
    assert outputs["refine"]["effects"]
    assert outputs["report"]["results"][0]["refinement"]["effects"]
    assert outputs["export again"]["changes"]
    assert outputs["inspect"]["logs"][0]["ingest"]
    assert len(outputs["estimate"]["agreement"]) == 4  # the pieces


def test_a_key_too_many_or_too_few_is_refused(outputs, validator):
    for content in outputs.values():
        schema = validator(verb_of(content))
        assert not schema.is_valid(content | {"surprise": 1})
        for key in content.keys() - {"error_on_held_out_logs"}:  # there where a log was held out
            assert not schema.is_valid({name: value for name, value in content.items() if name != key}), key


@pytest.mark.slow
def test_a_value_of_another_type_is_refused_at_any_depth(outputs, validator):
    for content in map(shortened, outputs.values()):
        schema = validator(verb_of(content))
        schema.validate(content)
        for path in leaves(content):
            assert not schema.is_valid(replaced(content, path, {"of": ["another", {"type": 1}]})), path


def verb_of(content):
    return content["schema"].split("/")[1]


def shortened(value):
    """Return the same with the first items of each list or table of alike, as many as level, gain and shape are."""
    if isinstance(value, dict):
        return {key: shortened(item) for key, item in value.items()}
    return [shortened(item) for item in value[:3]] if isinstance(value, list) else value


def leaves(value, at=()):
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*at, key))
    elif "ingest" not in at:  # what a log says of its making may hold more than this version knows
        yield at


def replaced(content, path, value):
    new = copy.deepcopy(content)
    inner = new
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return new


ERROR = Comparison(2e-4, 1e-4, 0.5, (0.4, 0.6))
FINDING = Finding(
    "channel:T_amb", {"amplitude": Parameter(1.0, "1", (0.9, 1.1))}, 3.0, None, 0.4, 0.001, ("maf.temperature",),
    drive="a cold day", curve=Followed("T_amb", "value", "maf.gain", (280.0, 300.0), (0.0, 0.1)),
)  # fmt: skip
LEADING = Leading(id="maf.lag", parameters={"tau": Parameter(0.1, "s", (0.05, 0.15))}, explained=0.3, course="ramp")
LEFT = Leftover((Stretch("drive", 1.0, 21.0, 0.6),), (8.0, 12.0), (1500.0, 1750.0), 3.0, 0.02, "filling", {"T_im": 0.4})


@pytest.mark.parametrize(("verb", "refined"), [("trace", False), ("refine", True)])
@pytest.mark.parametrize("verdict", ["effect", "unexplained"])
def test_what_the_chain_does_not_show(validator, verb, refined, verdict):
    """Left-over structure, effects of before, logs held out, and what a log without some channels cannot show."""
    part = OutcomeOnLog(
        log="drive", verdict="effect", effects=(FINDING,), error=error_output(ERROR, "whole"),
        balances=(BalanceError("throttle", "1", 0.08, 0.02, 0.015, 0.07, 0.02, True, 0.92),),
        day_to_day=(DayLevel("fuel", 0.01, "1", 0.02),),
        missing=Missing(("T_ic",), ("ambient",), (("a", "b"),)),
    )  # fmt: skip
    found = Trace(
        verdict=verdict, p_value=1e-9, effects=(FINDING,), error=error_output(ERROR, "parts"),
        residual=ResidualOutput(False, ("T_im",), **LEFT.as_json()),
        candidates=(LEADING,) if verdict == "unexplained" else UNSET, healthy_drives=("monday",),
        healthy_drives_needed=DrivesNeeded("maf.lag", 9), known_effects=(FINDING,),
        error_on_held_out_logs=error_output(ERROR, "whole"), logs=(part,), ranking=(), left=LEFT,
    )  # fmt: skip
    said = json.loads(json.dumps(found.as_json(refined)))
    content = {"schema": f"lpvobs/{verb}/1", "map_frozen": True, "refused": ["bad.parquet: damaged"], **said}
    validator(verb).validate(content)
    assert ("candidates" in content) is (verdict == "unexplained")
    assert ("after" in content["error"]) is refined
    assert {"known_effects", "error_on_held_out_logs"} <= set(content)
    assert "when" in content["residual"]
    assert content["logs"][0].keys() >= {"balances", "day_to_day", "missing"}
