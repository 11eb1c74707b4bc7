"""Names of files that mean nothing, are too long, or lead to a pipe: one line, and the contract's code."""

import errno
import os
from pathlib import Path

import pytest
import typer

import lpvobs
from lpvobs.cli.common import guarded, refuse_overwriting
from lpvobs.errors import DataError, UsageError
from lpvobs.io.dcm import read_dcm_map
from lpvobs.io.finding import find_logs

LONG = "x" * 300


def test_a_pattern_that_means_nothing_is_named():
    with pytest.raises(UsageError, match="Invalid pattern"):
        find_logs([Path("logs/**.parquet")])


def test_a_pattern_leaves_folders_out(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "log.parquet").touch()
    assert find_logs([tmp_path / "a" / "*"]) == [tmp_path / "a" / "log.parquet"]


def test_a_name_that_is_too_long_is_refused_everywhere(samples, tmp_path):
    out = tmp_path / LONG
    with pytest.raises(DataError, match="name too long"):
        refuse_overwriting(out, [samples.log])
    with pytest.raises(DataError, match="name too long"):
        lpvobs.export(samples.result, out, "csv")


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
    assert "ulimit -v) is 300 MiB; expected at least 1024" in capsys.readouterr().err
    assert not ran


def test_a_pipe_in_the_place_of_an_old_map_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "old.dcm")
    with pytest.raises(DataError, match="not a regular file"):
        read_dcm_map(tmp_path / "old.dcm", "MAF")
