"""Names of files that mean nothing, are too long, or lead to a pipe: one line, and the contract's code."""

import errno
import os

import pytest
import typer

import lpvobs
from lpvobs.cli.common import guarded
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.dcm import read_dcm_map
from lpvobs.io.logs.finding import find_logs

LONG = "x" * 300


def test_a_pattern_that_means_nothing_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"Invalid pattern|no log there"):  # from Python 3.13 on ** is * within a name
        find_logs([tmp_path / "**.parquet"])


def test_a_pattern_leaves_folders_out(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "log.parquet").touch()
    assert find_logs([tmp_path / "a" / "*"]) == [tmp_path / "a" / "log.parquet"]


@pytest.mark.parametrize("code", [errno.ENAMETOOLONG, errno.EACCES, errno.EMFILE])
def test_what_the_system_refuses_is_no_fault_of_the_program(code, capsys):
    @guarded
    def verb():
        raise OSError(code, os.strerror(code), "some.parquet")

    with pytest.raises(typer.Exit) as end:
        verb()
    assert end.value.exit_code == 3
    said = capsys.readouterr().err
    assert said.startswith(f"lpvobs: some.parquet: {os.strerror(code)}; ")
    assert said.count("\n") == 1


def test_too_little_memory_for_the_libraries_is_one_line_before_they_are_loaded(monkeypatch, capsys):
    monkeypatch.setattr("resource.getrlimit", lambda which: (300 << 20, -1))
    ran = []
    with pytest.raises(typer.Exit) as end:
        guarded(lambda: ran.append(1))()
    assert end.value.exit_code == 3
    assert "ulimit -v) is 300 MiB; expected 1024 MiB or more" in capsys.readouterr().err
    assert not ran


def test_a_pipe_in_the_place_of_an_old_map_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "old.dcm")
    with pytest.raises(DataError, match="not a regular file"):
        read_dcm_map(tmp_path / "old.dcm", "MAF")


@pytest.mark.parametrize("name", [LONG, f"folder/{LONG}", "half\0name"])
@pytest.mark.slow
def test_a_name_that_no_file_can_have_is_refused_from_python(samples, tmp_path, name):
    out = tmp_path / "out"
    for call in (
        lambda: lpvobs.estimate(samples.config, name, out, gain=samples.gain),
        lambda: lpvobs.estimate(samples.config, samples.log, out, gain=name),
        lambda: lpvobs.ingest_log(samples.log, name, out),
        lambda: lpvobs.inspect(name),
        lambda: lpvobs.export(samples.result, tmp_path / name, "csv"),
        lambda: lpvobs.extrapolate(name),
        lambda: lpvobs.trace(samples.result, [samples.log, name]),
        lambda: lpvobs.simulate(samples.config, f"{name}.csv", out),
    ):
        with pytest.raises(UsageError, match="this is no valid file name"):
            call()
    assert list(tmp_path.iterdir()) == []


def test_nothing_to_work_on_is_named_from_python(samples, tmp_path):
    for call in (
        lambda: lpvobs.estimate(samples.config, [], tmp_path / "out", gain=samples.gain),
        lambda: lpvobs.trace(samples.result, []),
        lambda: lpvobs.refine(samples.result, [], tmp_path / "out"),
        lambda: lpvobs.ingest_log([], "kit-obd", tmp_path / "out"),
    ):
        with pytest.raises(UsageError, match="name at least one"):
            call()
    with pytest.raises(UsageError, match="expected a number of processes of at least 1"):
        lpvobs.estimate(samples.config, samples.log, tmp_path / "out", gain=samples.gain, jobs=0)
