"""The list of mutants that do what the original does names what is in the code."""

import subprocess
import sys

from repository import ROOT

CHECK = """
import runpy
bench = runpy.run_path("benchmarks/mutants/__main__.py", run_name="bench")
everything = {room: [m for module in bench["modules"](room) for m in bench["mutants"](module)] for room in bench["ROOMS"]}
print(len(bench["reasons"](everything)))
"""


def test_every_mutant_of_the_list_is_one_of_the_code():
    """In a process of its own: the bench turns the compiler off where it is imported."""
    done = subprocess.run([sys.executable, "-c", CHECK], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # it ends where an entry names nothing
    assert int(done.stdout) > 0
