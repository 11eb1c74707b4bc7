"""The library does what the verbs do: the same files, the same refusals."""

import os
import subprocess
import sys
import typing
from pathlib import Path

import pytest
from hdf5 import contents
from repository import DIESEL, ROOT, short_cycle

import lpvobs
from lpvobs.errors import DataError, NotProven, UsageError

RATE = "10"


def python(*arguments):
    """Run Python as a user does, with linear algebra on one thread as the command line has it."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    call = [sys.executable, *map(str, arguments)]
    done = subprocess.run(call, capture_output=True, text=True, timeout=300, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """Return the folder that the example has filled, and what it printed."""
    folder = tmp_path_factory.mktemp("example")
    script, cycle = ROOT / "examples" / "map_of_a_drive.py", short_cycle(folder)
    done = python(script, "--out", folder / "out", "--cycle", cycle, "--rate", RATE)
    return folder / "out", done.stdout


@pytest.fixture(scope="module")
def by_verbs(lpvobs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("verbs")
    log, gain, result = folder / "drive.parquet", folder / "gain.h5", folder / "map.h5"
    for call in (
        ("simulate", "--config", DIESEL, "--cycle", short_cycle(folder), "--rate", RATE, "--seed", 3, "--out", log),
        ("synth-gain", "--config", DIESEL, log, "--out", gain),
        ("estimate", "--config", DIESEL, "--gain", gain, log, "--out", result),
        ("extrapolate", result),
        ("export", result, "--format", "dcm", "--name", "MAF_dW", "--out", folder / "maf.dcm"),
    ):
        done = lpvobs(*call)
        assert done.code == 0, done.err
    return folder


@pytest.mark.slow
def test_the_example_tells_what_it_did(example):
    folder, printed = example
    assert "gain: proven at 128 vertices" in printed
    assert "map: off by " in printed
    assert {path.name for path in folder.iterdir()} == {"drive.parquet", "gain.h5", "map.h5", "maf.dcm", "report.html"}


def test_the_log_has_the_bytes_of_the_verb(example, by_verbs):
    assert (example[0] / "drive.parquet").read_bytes() == (by_verbs / "drive.parquet").read_bytes()


@pytest.mark.parametrize("name", ["gain.h5", "map.h5"])
def test_every_number_is_that_of_the_verb(example, by_verbs, name):
    mine, theirs = contents(example[0] / name), contents(by_verbs / name)
    assert mine.keys() == theirs.keys()
    assert [key for key in mine if mine[key] != theirs[key]] == []


def test_the_calibration_file_is_that_of_the_verb(example, by_verbs):
    """Beside the line with the digest of the result, which holds the command line."""
    mine, theirs = ((folder / "maf.dcm").read_text().splitlines() for folder in (example[0], by_verbs))
    assert [line for line in mine if "sha256" not in line] == [line for line in theirs if "sha256" not in line]


def test_gates_and_tables_are_those_of_the_verb(example):
    folder, _ = example
    content = lpvobs.write_report(folder / "map.h5", gates=["mean_relative_error<=0.5"])
    assert content.logs[0].log == "drive"
    for gates in (["samples>=1e9"], "samples>=1e9"):
        with pytest.raises(NotProven, match="gate failed"):
            lpvobs.write_report(folder / "map.h5", gates=gates)


def test_a_gain_is_proven_again(example):
    assert lpvobs.verify(example[0] / "gain.h5").proven


def test_what_is_in_a_log(example):
    content = lpvobs.inspect(example[0] / "drive.parquet", DIESEL)
    assert content.rate == pytest.approx(float(RATE))
    assert lpvobs.inspect(example[0] / "drive.parquet").channels.keys() == content.channels.keys()


def test_an_output_that_is_an_input_is_refused(example):
    log = example[0] / "drive.parquet"
    with pytest.raises(UsageError, match="also an input"):
        lpvobs.estimate(DIESEL, log, log)
    with pytest.raises(DataError, match="no such file"):
        lpvobs.extrapolate(example[0] / "absent.h5")


def test_type_checkers_and_notebooks_find_the_types():
    assert (Path(lpvobs.__file__).parent / "py.typed").is_file()
    for name in lpvobs.__all__:
        assert "return" in typing.get_type_hints(getattr(lpvobs, name)), name


def test_python_runs_the_package():
    assert python("-m", "lpvobs", "--version").stdout.strip() == lpvobs.__version__


def test_nothing_stays_claimed(example):
    assert not list(example[0].glob(".*"))


def test_the_package_loads_its_library_when_it_is_asked_for():
    """Asking for the version must cost nothing: shells complete by starting the program."""
    code = "import sys, lpvobs; assert lpvobs.__version__; assert not {'numpy', 'lpvobs.api'} & set(sys.modules)"
    python("-c", code)
    python("-c", "import sys, lpvobs; dir(lpvobs); lpvobs.verify; assert 'cvxpy' not in sys.modules")


def test_every_name_that_is_offered_exists():
    """Twice: a function of the name of a room would give way to the room as soon as that is loaded."""
    for name in [*lpvobs.__all__, *lpvobs.__all__]:
        assert callable(getattr(lpvobs, name)), name
    assert dir(lpvobs) == sorted(["__version__", *lpvobs.__all__])
    with pytest.raises(AttributeError, match="no attribute 'estimation'"):
        _ = lpvobs.estimation


def test_a_map_appears_with_what_its_logs_show_of_a_healthy_engine_or_not_at_all(monkeypatch, chain, tmp_path):
    """A run that was stopped meanwhile left a map that looked whole, and `trace` judged a sound drive by the model alone."""

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("lpvobs.api.search_start.learn_healthy", stopped)
    with pytest.raises(KeyboardInterrupt):
        lpvobs.estimate(DIESEL, [chain.log], tmp_path / "map.h5", gain=chain.gain)
    assert not (tmp_path / "map.h5").exists()
    assert not list(tmp_path.glob(".*"))
