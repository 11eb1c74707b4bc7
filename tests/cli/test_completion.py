"""Shell completion: what shells are told, and a real bash that asks."""

import os
import shutil
import subprocess
import sys

import pytest

from lpvobs.api.estimate import METHODS
from lpvobs.api.export import FORMATS
from lpvobs.api.export_unit import FORMATS as UNITS
from lpvobs.api.export_unit import MAP_GAINS
from lpvobs.cli import options
from lpvobs.ingest.profiles import shipped
from lpvobs.simulation.cycles import TABLES


@pytest.fixture
def command(tmp_path):
    """Return an environment in which `lpvobs` is a command, as after installation."""
    script = tmp_path / "bin" / "lpvobs"
    script.parent.mkdir()
    body = "import sys; sys.argv[0] = 'lpvobs'; from lpvobs.cli.main import run; run()"
    script.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{body}" "$@"\n', encoding="utf-8")
    script.chmod(0o755)
    return os.environ | {"PATH": f"{script.parent}{os.pathsep}{os.environ['PATH']}"}


def asked(command, *words):
    """Return what bash offers for the last word, by the script that the program prints for it."""
    script = (
        'source <(lpvobs --show-completion bash); COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); '
        "_lpvobs_completion lpvobs; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    call = ["bash", "-c", script, "bash", "lpvobs", *words]
    environment = command | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=True, env=environment)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("es",), ["estimate"]),
        (("re",), ["refine", "report"]),
        (("report", "--j"), ["--junit", "--json"]),
        (("estimate", "--method", ""), list(METHODS)),
        (("simulate", "--cycle", "ftp"), ["ftp75", "ftp75_cold"]),
        (("estimate", "no_such_"), []),
    ],
)
def test_bash_completes_verbs_options_and_names(command, words, offered):
    assert asked(command, *words) == offered


@pytest.mark.parametrize(
    ("shell", "word"), [("bash", "complete -o default"), ("zsh", "compdef"), ("fish", "complete -")]
)
def test_a_script_for_every_shell(command, shell, word):
    environment = command | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    call = ["lpvobs", "--show-completion", shell]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=True, env=environment)
    assert word in done.stdout
    assert "_LPVOBS_COMPLETE" in done.stdout


def test_what_is_offered_is_what_is_taken():
    assert set(options.CYCLES) == set(TABLES)
    assert set(options.METHODS) == set(METHODS)
    assert set(options.FORMATS) == {*FORMATS, *UNITS}
    assert options.MAP_GAINS == MAP_GAINS
    assert set(options.PROFILES) == set(shipped())
