"""SIGINT and SIGTERM: the contract's code, one line, nothing left, whatever the program is doing."""

import os
import signal
import subprocess
import sys
import textwrap

import pytest

from lpvobs.api.jobs import Workers

# Runs a verb whose work is to wait in the way given, with a file half written; tells when it is ready.
SCRIPT = """
    import sys, time
    from lpvobs.api.files import writing
    from lpvobs.cli import common, main, start
    from lpvobs.io.safety.atomic import replacing

    class Noisy:
        def __del__(self):
            print("ready", flush=True)
            time.sleep(200)

    def wait():
        print("ready", flush=True)
        time.sleep(200)

    def in_a_finaliser():
        thing = Noisy()
        del thing  # an exception in here is swallowed by the interpreter
        time.sleep(200)

    def in_a_library_that_fails_for_it():
        thing = Noisy()
        del thing
        raise RuntimeError("the callback gave me nothing")

    def behind_a_broad_except():
        try:
            wait()
        except Exception:
            print("swallowed", flush=True)

    @common.guarded
    def verb():
        with writing({target!r}, []) as target, replacing(target) as temporary:
            temporary.write_text("half")
            {way}()

    main.app.command("wait")(verb)
    sys.argv = ["lpvobs", "wait"]
    start.run()
"""


@pytest.mark.parametrize(("sent", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "term")])
@pytest.mark.parametrize("way", ["wait", "in_a_finaliser", "in_a_library_that_fails_for_it", "behind_a_broad_except"])
@pytest.mark.slow
def test_a_signal_ends_a_verb_with_its_code_and_leaves_the_old_file_alone(tmp_path, sent, code, word, way):
    target = tmp_path / "old.h5"
    target.write_text("old")
    script = textwrap.dedent(SCRIPT).format(target=str(target), way=way)
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    assert len(list(tmp_path.iterdir())) == 3  # the old file, the lock, the half
    os.kill(process.pid, sent)
    out, err = process.communicate(timeout=100)
    assert process.returncode == code, err
    assert out == ""
    assert err.startswith(f"lpvobs: {word}")
    assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["old.h5"]
    assert target.read_text() == "old"


# The libraries take as long to load as a test wants.
LOADING = """
    import sys, time

    class Slow:
        @staticmethod
        def find_spec(name, path=None, target=None):
            if name == "typer":
                print("ready", flush=True)
                time.sleep(200)

    sys.meta_path.insert(0, Slow)
    from lpvobs.cli.start import run
    run()
"""


@pytest.mark.parametrize(("sent", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "term")])
def test_a_signal_while_the_libraries_are_loaded_is_one_line_too(sent, code, word):
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(LOADING)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, sent)
    _, err = process.communicate(timeout=100)
    assert process.returncode == code, err
    assert err.startswith(f"lpvobs: {word}")
    assert len(err.splitlines()) == 1


def held_back(_):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interrupt_of_the_whole_group_is_not_for_workers_that_are_still_starting():
    with Workers(2) as workers:
        assert all(held for _, held in workers.finished(held_back, range(4)))
    assert not held_back(None)  # here it is let through again
