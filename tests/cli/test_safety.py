"""What nobody should lose: inputs, other people's files, trust in a gain, and the exit code of a signal."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest
from verbs import AFRESH


def test_an_input_is_not_overwritten(lpvobs, config, chain, tmp_path):
    log, gain = (Path(shutil.copy(path, tmp_path)) for path in (chain.log, chain.gain))
    for out in (log, gain):
        before = out.read_bytes()
        done = lpvobs("estimate", "--config", config, "--gain", gain, log, "--out", out)
        assert done.code == 2
        assert "input" in done.err
        assert out.read_bytes() == before
    assert lpvobs("synth-gain", "--config", config, log, "--out", log).code == 2


def test_the_same_drive_does_not_count_twice(lpvobs, config, chain, tmp_path):
    copy = shutil.copy(chain.log, tmp_path / "other_name.parquet")
    done = lpvobs("estimate", "--config", config, "--gain", chain.gain, chain.log, copy, "--out", tmp_path / "r.h5")
    assert done.code == 2
    assert "same content" in done.err


def test_a_gain_is_proven_again_before_it_is_trusted(lpvobs, config, chain, tmp_path):
    broken, out = shutil.copy(chain.gain, tmp_path / "broken.h5"), tmp_path / "r.h5"
    with h5py.File(broken, "r+") as file:
        file["gain/L"][0, 0] = -1e5
    done = lpvobs("estimate", "--config", config, "--gain", broken, chain.log, "--out", out)
    assert done.code == 1
    assert "not proven" in done.err
    assert not out.exists()


def test_verify_notices_exchanged_parameters(lpvobs, chain, tmp_path):
    swapped = shutil.copy(chain.gain, tmp_path / "swapped.h5")
    with h5py.File(swapped, "r+") as file:
        names = file["gain/parameter"][()]
        names[[0, 1]] = names[[1, 0]]
        file["gain/parameter"][()] = names
    assert lpvobs("verify", swapped).code == 3


def test_the_default_method_refuses_a_gain_that_is_no_cascade(lpvobs, config, chain, tmp_path):
    published, out = tmp_path / "published.h5", tmp_path / "r.h5"
    assert lpvobs("synth-gain", "--config", config, "--published", "FTP75", "--out", published).code == 0
    done = lpvobs("estimate", "--config", config, "--gain", published, chain.log, "--out", out)
    assert done.code == 3
    assert "cascade" in done.err
    assert (
        lpvobs(
            "estimate", "--config", config, "--gain", published, chain.log, "--out", out, "--method", "published"
        ).code
        == 0
    )


def test_a_library_that_a_signal_ends_while_it_is_loaded_prints_no_traceback():
    """Compiled code prints the exception through the hook, and raises another one."""
    code = """
import os, signal, sys
from lpvobs.cli import main, start
from lpvobs.cli.signals import Stopped

def loading():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except Stopped:
        sys.excepthook(*sys.exc_info())
        raise ImportError("numpy.core.multiarray failed to import")

main.run = loading
start.run()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "lpvobs: interrupted; the unfinished step changed no file\n")


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
@pytest.mark.slow
def test_signals_end_a_simulation_cleanly(config, tmp_path, sent, code):
    call = ["simulate", "--config", str(config), "--cycle", "wltc", "--out", str(tmp_path / "log.parquet")]
    process = subprocess.Popen([*AFRESH, *call], stderr=subprocess.PIPE, text=True)
    while not list(tmp_path.iterdir()) and process.poll() is None:
        time.sleep(0.01)  # until it has claimed its target
    time.sleep(0.1)  # in the plant's course: it takes seconds, even if this process gets its turn late
    process.send_signal(sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
