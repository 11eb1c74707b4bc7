"""`lpvobs.toml` of the working folder: found from any folder below, said, and outweighed by --config."""

import shutil

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from lpvobs.cli.common import folder_config
from lpvobs.cli.main import app


@pytest.fixture
def project(config, tmp_path, monkeypatch):
    """Return a folder with a configuration, whose subfolder is the working folder."""
    shutil.copy(config, tmp_path / "lpvobs.toml")
    below = tmp_path / "logs" / "monday"
    below.mkdir(parents=True)
    monkeypatch.chdir(below)
    return tmp_path


def called(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def shortened(config, path):
    """Write a configuration with a map of its own: seven speeds."""
    text = config.read_text(encoding="utf-8")
    changed = text.replace(
        "n_e = { start = 0, stop = 4000, step = 250 }", "n_e = { start = 0, stop = 3000, step = 500 }"
    )
    assert changed != text
    path.write_text(changed, encoding="utf-8")


@pytest.mark.slow
def test_the_chain_runs_without_naming_it(config, chain, project):
    shortened(config, project / "lpvobs.toml")
    said = f"configuration: {project / 'lpvobs.toml'}"
    for call in (
        ("simulate", "--cycle", cycle(project), "--rate", 10, "--out", "log.parquet"),
        ("synth-gain", "--published", "ETC", "--out", "gain.h5"),
        ("inspect", chain.log),
        ("estimate", "--gain", chain.gain, chain.log, "--out", "result.h5"),
    ):
        done = called(*call)
        assert done.exit_code == 0, f"{call}: {done.stderr}"
        assert done.stderr.splitlines()[0] == said
        assert said not in done.stdout
    assert f"of {15 * 7} nodes" in done.stderr


def cycle(folder):
    path = folder / "short.csv"
    path.write_text("time_s,speed_kmh\n0,0\n5,0\n20,30\n", encoding="utf-8")
    return path


def test_the_nearest_one_counts_and_the_one_named_wins(config, project):
    near = project / "logs" / "lpvobs.toml"
    near.write_text("[[[", encoding="utf-8")
    done = called("synth-gain", "--published", "ETC", "--out", "gain.h5")
    assert done.exit_code == 2
    assert f"{near}: is not TOML" in done.stderr
    done = called("synth-gain", "--config", config, "--published", "ETC", "--out", "gain.h5")
    assert done.exit_code == 0, done.stderr
    assert str(near) not in done.stderr


def test_a_folder_of_that_name_is_none(project):
    (project / "logs" / "lpvobs.toml").mkdir()
    assert folder_config() == project / "lpvobs.toml"


def test_without_either_both_ways_are_named(lpvobs, tmp_path):
    for call in (("simulate", "--cycle", "nedc"), ("synth-gain",), ("estimate", "log.parquet")):
        done = lpvobs(*call, "--out", "out", cwd=tmp_path)
        assert done.code == 2
        (line,) = done.err.strip().splitlines()
        assert "--config TOML" in line
        assert "lpvobs.toml in this folder or a folder above" in line
    assert list(tmp_path.iterdir()) == []


def test_a_working_folder_that_is_gone_has_none(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert folder_config() is None


def test_inspect_holds_a_log_against_the_engine_of_the_folder(config, chain, project):
    shutil.copy(config.parent / "liu-ice.toml", project / "lpvobs.toml")
    done = called("inspect", chain.log)
    assert done.exit_code == 3
    assert "channel 'm_f' is missing" in done.stderr


@pytest.mark.parametrize(
    ("left_out", "said"),
    [
        (
            (),
            [
                "has all required channels of the engines: diesel, series, speed_density",
                "'series': would also use, if the log had them: lambda_e (lambda in the exhaust)",
            ],
        ),
        (
            ("omega_t", "p_em"),
            [
                "has all required channels of the engines: series, speed_density",
                "'diesel': required channels missing in this log: p_em (exhaust manifold pressure), omega_t (turbine",
            ],
        ),
        (
            ("omega_t", "p_em", "u_delta", "u_egr"),
            [
                "has all required channels of the engines: speed_density",
                "u_egr (EGR valve opening) or lambda_e (lambda in the exhaust)",
            ],
        ),
    ],
)
def test_inspect_says_which_engines_a_log_serves_and_what_further_channels_are_for(chain, project, left_out, said):
    (project / "lpvobs.toml").unlink()
    kept = pq.read_table(chain.log).drop_columns(list(left_out))
    pq.write_table(kept, "few.parquet")
    shown = called("inspect", "few.parquet").stdout
    for line in said:
        assert line in shown
