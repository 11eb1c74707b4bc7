"""Compiles exported sources with `cc`, as a user would, and runs what comes of it."""

import csv
import subprocess

import numpy as np

STRICT = ("-std=c99", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
CHECKED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def compiled(sources, program, *flags, compiler="cc"):
    """Return the path of the program made of C sources; a warning is an error."""
    call = [compiler, *STRICT, *flags, *map(str, sources), "-lm", "-o", str(program)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


def run(*call):
    done = subprocess.run([*map(str, call)], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, f"{done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def rows_of(log):
    """Return a log as rows of text, numbers to the last bit, with the line of names first."""
    names = ["time", *log.channels]
    columns = [log.time, *log.channels.values()]
    return [names, *(list(map(repr, row)) for row in np.column_stack(columns).tolist())]


def write_csv(path, rows):
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    return path


def bench(program, rows, folder):
    """Return time, states and map that the test bench makes of rows, and what it says."""
    log, surface, states = folder / "log.csv", folder / "map.csv", folder / "states.csv"
    said = run(program, write_csv(log, rows), surface, states)
    found = np.loadtxt(states, delimiter=",", ndmin=2)
    return found[:, 0], found[:, 1:], np.loadtxt(surface, delimiter=",", skiprows=1)[:, 2], said
