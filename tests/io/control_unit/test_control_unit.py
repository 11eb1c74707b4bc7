"""The observer in C: the numbers of the package, in double to rounding and in single precision within what is stated."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import fmpy
import h5py
import numpy as np
import pytest
from c_compiler import CHECKED, bench, compiled, rows_of, run
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu
from reference import control_unit as twin
from reference import drives, throttled_drive
from repository import CONFIGS

from lpvobs.api.export_unit import export_unit, unit_of
from lpvobs.errors import NotProven, UsageError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.control_unit.sources import Unit, sources, write_fmu
from lpvobs.io.results.engines import read_engine
from lpvobs.io.results.gains import StoredGain, read_gain
from lpvobs.io.safety.atomic import file_digest
from lpvobs.synthesis.certificate import Certificate, Gain
from lpvobs.synthesis.region import Region

HERE = Path(__file__).parent
STATE, MAP = 1e-12, 1e-10
"""Of C in double against Python: the same operations in the same order; libm alone may round differently."""
FLOAT_STATE, FLOAT_MAP = 5e-5, 1e-5
"""[-] and [kg/s] of C in single precision, docs/control-unit.md: rounding of 6e-8 through a matrix of condition some hundred."""


@pytest.fixture(scope="module", params=["constant", "falling", "corrected"])
def exported(request, chain, tmp_path_factory):
    """Return the unit, and the folder of its sources."""
    folder = tmp_path_factory.mktemp(request.param)
    stored = read_gain(chain.gain)
    if request.param == "corrected":
        unit = drawn(unit_of(chain.gain, stored, chain.result, True, 100.0))
        write(folder, unit)
        return unit, folder
    export_unit(chain.gain, folder, "c99", map_gain=request.param)
    return unit_of(chain.gain, stored, None, request.param == "falling", 100.0), folder


def drawn(unit):
    """Return a unit with other corrections, as large as they are expected, and not zero where a formula is without them."""
    rng = np.random.default_rng(1)
    sizes = {item.name: item.deviation * rng.standard_normal(item.size) for item in unit.air_path.components}
    return replace(unit, corrections=sizes)


def write(folder, unit):
    for name, text in sources(unit).items():
        (folder / name).write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def program(exported):
    folder = exported[1]
    return compiled(sorted(folder.glob("*.c")), folder / "bench", *CHECKED)


def expected(unit, log):
    return (twin.falling if unit.falling else twin.constant)(unit, log)


def part(log, kept):
    """Return some samples of a log, split where they are more than a second apart."""
    time = log.time[kept]
    cuts = [0, *(np.flatnonzero(np.diff(time) > 1.0) + 1).tolist(), time.size]
    segments = tuple(pairwise(cuts))
    return replace(log, time=time, channels={n: c[kept] for n, c in log.channels.items()}, segments=segments)


@pytest.fixture(scope="module")
def uneven(engine):
    """Return a drive of three segments at about 100 Hz: its clock trembles, samples are missing, the last segment has but two."""
    log = drives.integrated(engine, 5, legs=3, seconds=8.0, substeps=4)[0]
    rng = np.random.default_rng(1)
    channels = log.channels | {"W_maf": 1.1 * log["W_maf"]}
    log = replace(log, time=log.time + rng.uniform(-2e-3, 2e-3, log.time.size), channels=channels)
    kept = rng.random(log.time.size) > 0.05
    kept[log.segments[-1][0] :] = False
    kept[log.segments[-1][0] :][[3, 4]] = True
    return part(log, kept)


@pytest.mark.slow
def test_states_and_map_are_those_of_the_package(exported, program, uneven, tmp_path):
    unit, _ = exported
    x, theta = expected(unit, uneven)
    assert len(uneven.segments) == 3
    assert np.abs(theta).max() > 1e-4
    time, states, surface, said = bench(program, rows_of(uneven), tmp_path)
    k = np.searchsorted(uneven.time, time)
    np.testing.assert_array_equal(uneven.time[k], time)
    assert k.size > 0.95 * uneven.time.size  # what ends a segment is worked on in one step
    np.testing.assert_allclose(states[:, : x.shape[1]], x[k], rtol=STATE)
    np.testing.assert_allclose(surface, theta, rtol=0, atol=MAP * np.abs(theta).max())
    assert f"{uneven.time.size} samples, 0 dropped, 3 segments" in said


def test_every_corner_of_every_relation(exported, program, tmp_path):
    unit, _ = exported
    log = drives.scattered(3)
    x, theta = expected(unit, log)
    time, states, surface, _ = bench(program, rows_of(log), tmp_path)
    np.testing.assert_allclose(states[:, : x.shape[1]], x[np.searchsorted(log.time, time)], rtol=STATE)
    np.testing.assert_allclose(surface, theta, rtol=0, atol=MAP * np.abs(theta).max())


def test_samples_without_a_reading_are_as_if_they_were_not_there(exported, program, uneven, tmp_path):
    clean = rows_of(uneven)
    rng, hurt = np.random.default_rng(2), [clean[0]]
    for row in clean[1:]:
        if rng.random() < 0.1:
            bad = [repr(float(row[0]) - 1e-4), *row[1:]]
            bad[rng.integers(1, len(row))] = ["", "nan", "inf", "1e9", "text"][rng.integers(5)]
            hurt.append(bad)
        hurt.append(row)
    hurt.insert(200, hurt[150])  # time runs backward once
    first, second = bench(program, clean, tmp_path), bench(program, hurt, tmp_path)
    np.testing.assert_array_equal(first[2], second[2])
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1][:, :4], second[1][:, :4])
    assert f"{len(hurt) - len(clean)} dropped" in second[3]


@pytest.mark.slow
def test_single_precision_within_what_is_stated(exported, uneven, tmp_path):
    unit, folder = exported
    program = compiled(sorted(folder.glob("*.c")), tmp_path / "bench", "-DLPVOBS_FLOAT")
    x, theta = expected(unit, uneven)
    time, states, surface, said = bench(program, rows_of(uneven), tmp_path)
    np.testing.assert_allclose(states[:, : x.shape[1]], x[np.searchsorted(uneven.time, time)], rtol=FLOAT_STATE)
    np.testing.assert_allclose(surface, theta, rtol=0, atol=FLOAT_MAP)
    assert f"state {unit.bytes_of_state(4)} bytes" in said


def test_the_stated_memory_is_that_of_the_compiler(exported, program, uneven, tmp_path):
    unit, folder = exported
    said = bench(program, rows_of(uneven)[:50], tmp_path)[3]
    assert f"state {unit.bytes_of_state(8)} bytes" in said
    header = (folder / "lpvobs_config.h").read_text(encoding="utf-8")
    assert f"State: {unit.bytes_of_state(8)} bytes in double, {unit.bytes_of_state(4)} in single" in header


def test_version_and_digest_are_in_the_binary(exported, program):
    unit, folder = exported
    said = re.findall(r'lpvobs_version.* = "(.*)"', (folder / "lpvobs_tables.c").read_text(encoding="utf-8"))[0]
    assert unit.origin in said
    assert said.encode() in program.read_bytes()


@pytest.mark.parametrize("number", [(), ("-DLPVOBS_FLOAT",)], ids=["double", "float"])
@pytest.mark.slow
def test_hostile_steps_leave_everything_finite_and_flagged(exported, number, tmp_path):
    _, folder = exported
    own = [path for path in sorted(folder.glob("*.c")) if path.name != "lpvobs_bench.c"]
    flags = ("-I", folder, "-Wno-float-conversion", *CHECKED, *number)
    program = compiled([*own, HERE / "hostile.c"], tmp_path / "hostile", *map(str, flags))
    seen, unflagged, updates, most = map(int, run(program).split())
    assert unflagged == 0
    assert updates > 1000
    assert seen == 0b1_1011_1111  # every flag but that of a state beyond all bounds, for which the guards leave nothing
    assert most <= 22  # never more than the ring holds


def test_a_compiler_that_would_remove_the_guards_is_refused(exported, tmp_path):
    call = ("gcc", "-std=c99", "-Ofast", "-c", "-o", tmp_path / "unit.o", exported[1] / "lpvobs.c")
    done = subprocess.run([*map(str, call)], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "remove the guards against NaN" in done.stderr


@pytest.mark.parametrize(
    ("head", "rows", "code", "said"),
    [
        (lambda names: [names[1], *names[1:]], 3, 3, "each of these columns once"),
        (lambda names: names, 0, 3, "no sample could be used"),
        (lambda names: ["", *names], 3, 0, ""),
    ],
    ids=["a column twice, another missing", "a head alone", "a nameless column first, as pandas writes its index"],
)
def test_the_bench_reads_every_column_or_says_why_not(exported, program, uneven, tmp_path, head, rows, code, said):
    names = [*exported[0].channels, "time"]
    columns = [*(uneven.channels[name] for name in exported[0].channels), uneven.time]
    nameless = len(head(names)) - len(names)
    lines = [
        ",".join(head(names)),
        *("0," * nameless + ",".join(map(repr, map(float, row))) for row in list(zip(*columns, strict=True))[:rows]),
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    call = [str(program), str(tmp_path / "log.csv"), str(tmp_path / "map.csv")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    assert code or " 0 dropped" in done.stdout


@pytest.mark.skipif(shutil.which("clang") is None, reason="clang is not here")
@pytest.mark.slow
def test_clang_has_nothing_to_say_either(exported, uneven, program, tmp_path):
    _, folder = exported
    other = compiled(sorted(folder.glob("*.c")), tmp_path / "bench", compiler="clang")
    first, second = bench(program, rows_of(uneven), tmp_path), bench(other, rows_of(uneven), tmp_path)
    np.testing.assert_array_equal(first[2], second[2])


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="cppcheck is not here")
@pytest.mark.parametrize("number", ["-UX", "-DLPVOBS_FLOAT"], ids=["double", "float"])
@pytest.mark.proof
def test_misra_but_for_what_the_page_lists(exported, number):
    _, folder = exported
    call = ["cppcheck", "--addon=misra", "--enable=style", "--std=c99", number, f"-I{folder}"]
    said = run(*call, *(folder / f"lpvobs{part}.c" for part in ("", "_model", "_tables")))
    assert set(re.findall(r"misra-c2012-([\d.]+)", said)) <= {"2.4", "2.5"}


def test_no_heap_and_two_functions_of_libm(exported):
    _, folder = exported
    text = "".join((folder / name).read_text(encoding="utf-8") for name in ("lpvobs.c", "lpvobs_model.c", "lpvobs.h"))
    assert set(re.findall(r"\b(malloc|calloc|free|realloc)\b", text)) == set()
    called = set(re.findall(r"\b(sqrtf?|powf?|expf?|logf?|fabsf?|sinf?|cosf?|tanhf?|isnan|isfinite)\(", text))
    assert called == {"sqrt", "pow", "sqrtf", "powf"}


def test_an_observer_starts_from_map_and_engine_of_a_result(chain, tmp_path):
    done = export_unit(chain.gain, tmp_path / "unit", "c99", result=chain.result)
    unit = unit_of(chain.gain, read_gain(chain.gain), chain.result, True, 100.0)
    assert done.start == "extrapolation"
    assert np.all(unit.theta != 0.0)
    assert 0 < np.count_nonzero(unit.driven) < unit.theta.size
    with h5py.File(chain.result) as file:
        for name, values in unit.corrections.items():
            np.testing.assert_array_equal(values, file[f"engine_found/{name}/correction"][()].reshape(-1))
        assert unit.corrections["compressor"].any()
    header = (tmp_path / "unit" / "lpvobs_config.h").read_text(encoding="utf-8")
    assert "real_t egr[75];" in header
    assert "_lag" not in header  # a lag moves a signal: docs/control-unit.md
    assert unit.air_path.engine_constants()["V_d"] != load_config(CONFIGS / "diesel.toml")[0].engine.geometry.V_d


@pytest.mark.slow
def test_an_observer_of_a_calibrated_engine_starts_at_zero(chain, other_engine, tmp_path):
    done = export_unit(chain.gain, tmp_path / "unit", "c99", engine=other_engine.known)
    unit = unit_of(chain.gain, read_gain(chain.gain), None, True, 100.0, other_engine.known)
    known = read_engine(other_engine.known, load_config(CONFIGS / "diesel.toml")[0].engine_path())
    assert done.start == "zero"
    assert not unit.theta.any()
    values = np.concatenate(list(unit.corrections.values()))
    np.testing.assert_array_equal(values, known.unknowns.mean[len(known.unknowns.constants) :])
    assert np.abs(values).max() > 1e-3
    assert file_digest(other_engine.known) in (tmp_path / "unit" / "lpvobs_tables.c").read_text(encoding="utf-8")
    with pytest.raises(UsageError, match="already contains an engine"):
        export_unit(chain.gain, tmp_path / "unit", "c99", result=chain.result, engine=other_engine.known)


def test_the_gain_of_the_target_is_proven_again(chain, tmp_path, monkeypatch):
    stored = read_gain(chain.gain)
    broken = replace(stored, gain=replace(stored.gain, L=-stored.gain.L))
    monkeypatch.setattr("lpvobs.api.export_unit.gains.read_gain", lambda _: broken)
    with pytest.raises(NotProven, match="rounded to double"):
        export_unit(chain.gain, tmp_path / "unit", "c99")
    assert not (tmp_path / "unit").exists()


def test_a_falling_gain_needs_a_cascade(chain, tmp_path, monkeypatch):
    stored = read_gain(chain.gain)
    L = stored.gain.L.copy()
    L[0, -1] = 1.0
    monkeypatch.setattr(
        "lpvobs.api.export_unit.gains.read_gain", lambda _: replace(stored, gain=replace(stored.gain, L=L))
    )
    with pytest.raises(UsageError, match="stability is not proven"):
        export_unit(chain.gain, tmp_path / "unit", "c99", map_gain="falling")


@pytest.mark.slow
def test_the_unit_for_co_simulation(exported, uneven, chain, tmp_path):
    unit, _ = exported
    path = tmp_path / "observer.fmu"

    def make():
        if unit.corrections:
            write_fmu(path, unit, sources(unit))
        else:
            export_unit(chain.gain, path, "fmu", map_gain="falling" if unit.falling else "constant")

    make()
    assert validate_fmu(str(path)) == []
    first = path.read_bytes()
    make()
    assert path.read_bytes() == first  # the same inputs, the same bytes
    log = part(drives.scattered(7), np.arange(300))
    x, _ = expected(unit, log)
    described = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    by_name = {variable.name: variable.valueReference for variable in described.modelVariables}
    taken = [by_name[f"in_{name}"] for name in log.channels]
    given = [by_name["state_time"], *(by_name[f"x_{name}"] for name in unit.air_path.state_names)]
    slave = FMU2Slave(
        guid=described.guid, unzipDirectory=folder, modelIdentifier=described.coSimulation.modelIdentifier
    )
    slave.instantiate()
    slave.setupExperiment(startTime=float(log.time[0]))
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    seen = []
    for k in range(log.time.size - 1):
        slave.setReal(taken, [float(column[k]) for column in log.channels.values()])
        slave.doStep(float(log.time[k]), float(log.time[k + 1] - log.time[k]))
        seen.append(slave.getReal(given))
        if k == 150:  # a state that is kept and put back changes nothing
            kept = slave.getFMUState()
            slave.reset()
            slave.setFMUState(kept)
            slave.freeFMUState(kept)
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder)
    seen = np.array(seen)[20:]
    np.testing.assert_allclose(seen[:, 1:], x[np.searchsorted(log.time, seen[:, 0])], rtol=STATE)


@pytest.mark.slow
def test_an_engine_with_learned_curves(tmp_path):
    config = load_config(CONFIGS / "liu-ice.toml")[0]
    log = throttled_drive.log_of(throttled_drive.noisy(throttled_drive.drive(130.0), 1))
    air_path = config.engine_path().learned_from([log])
    names = air_path.parameter_names
    region = Region(names, (0.0,) * len(names), (1.0,) * len(names))
    L = np.array([[50.0, 0.1, 0.0], [0.1, 50.0, 0.0], [1e-6, 1e-6, 0.0]])
    gain = Gain(L, np.eye(3), np.eye(3), 0.5, 0.5, region, Certificate(True, 1, 1.0, None, ""))
    stored = StoredGain("made up", air_path.name, {}, air_path.state_names, config.gain.outputs, gain, {})
    size, grid = config.grid().size, config.grid()
    unit = Unit(
        config.kind, air_path, {}, air_path.channels, grid, stored, np.zeros(size), np.zeros(size), 0.15, 1.0, 200.0, 20.0,
        False, "made up", "zero",
    )  # fmt: skip
    write(tmp_path, unit)
    program = compiled(sorted(tmp_path.glob("*.c")), tmp_path / "bench", *CHECKED)
    log = replace(log, channels={name: log[name] for name in air_path.channels})
    x, theta = twin.constant(unit, log)
    time, states, surface, _ = bench(program, rows_of(log), tmp_path)
    assert time.size > 0.95 * log.time.size
    np.testing.assert_allclose(states[:, :3], x[np.searchsorted(log.time, time)], rtol=STATE)
    np.testing.assert_allclose(surface, theta, rtol=0, atol=MAP * np.abs(theta).max())


def test_what_the_verb_says(lpvobs, chain, tmp_path):
    done = lpvobs("export", chain.gain, chain.result, "--format", "c99", "--out", tmp_path / "unit", "--json")
    assert done.code == 0, done.err
    unit = json.loads(done.out)["unit"]
    assert unit["files"] == sorted(path.name for path in (tmp_path / "unit").iterdir())
    assert min(unit["smallest_pivot"].values()) > 0
    assert lpvobs("export", chain.result, "--format", "csv", "--map-gain", "falling", "--out", tmp_path / "m").code == 2
