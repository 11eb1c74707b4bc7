"""stdout and stderr that are closed, full, without a reader, or unable to show a letter."""

import os
import subprocess
from pathlib import Path

import pytest
from repository import ROOT
from verbs import AFRESH


def lpvobs(*arguments, **streams):
    """Return the ended command; `closed` lists descriptors that it starts without, `encoding` is that of its streams."""
    closed = streams.pop("closed", ())
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": streams.pop("encoding", "utf-8")}
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    return subprocess.run(
        [*AFRESH, *map(str, arguments)], check=False, timeout=100, env=environment, **streams,
        preexec_fn=lambda: [os.close(handle) for handle in closed],
    )  # fmt: skip


@pytest.mark.slow
def test_a_reader_that_has_left_is_no_failure(samples):
    for arguments in (("inspect", samples.log), ("inspect", samples.log, "--json"), ("--help",), ("--version",)):
        reading, writing = os.pipe()
        os.close(reading)
        done = lpvobs(*arguments, stdout=writing)
        os.close(writing)
        assert done.returncode == 0, arguments
        assert done.stderr == b""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_output_that_nobody_can_read_is_one_line_and_a_code(samples):
    with Path("/dev/full").open("wb") as full:
        for arguments in (("inspect", samples.log), ("--help",), ("--version",)):
            done = lpvobs(*arguments, stdout=full)
            assert done.returncode == 3, arguments
            assert done.stderr.startswith(b"lpvobs: stdout: No space left")
            assert done.stderr.count(b"\n") == 1
        assert lpvobs("inspect", "missing", stderr=full).returncode == 3
        assert lpvobs("no-such-verb", stderr=full).returncode == 2
        assert lpvobs("inspect", samples.log, stderr=full).returncode == 0  # the log is as it was asked for, on stdout


@pytest.mark.parametrize("closed", [(1,), pytest.param((2,), marks=pytest.mark.proof), (0, 1, 2)])
@pytest.mark.slow
def test_closed_streams_hinder_nothing_and_no_file_takes_their_place(samples, tmp_path, closed):
    copy = tmp_path / "map.h5"
    copy.write_bytes(Path(samples.result).read_bytes())
    assert lpvobs("extrapolate", copy, closed=closed).returncode == 0
    assert lpvobs("export", copy, "--format", "csv", "--out", tmp_path / "map.csv", closed=closed).returncode == 0
    assert all(
        line[0] not in "kl" for line in (tmp_path / "map.csv").read_text().splitlines()
    )  # "kg/s, ...", "lpvobs: ..."
    assert lpvobs("inspect", tmp_path / "missing", closed=closed).returncode == 3


def test_a_letter_that_the_stream_does_not_have_is_shown_by_its_number(samples, tmp_path):
    named = tmp_path / "größe.parquet"
    named.write_bytes(Path(samples.log).read_bytes())
    done = lpvobs("inspect", named, encoding="ascii")
    assert done.returncode == 0
    assert b"gr\\xf6\\xdfe.parquet: " in done.stdout
