"""The tests with the lowest and the newest versions that are admitted, on the Pythons at hand, and without the compiler.

`make matrix` runs every row, `make matrix ROW=lowest TESTS=tests/maps` one row and some tests. Lowest are the lower bounds of
pyproject.toml, on the oldest Python. A Python that is not at hand is skipped, never downloaded; of pyenv those are at hand that
PYENV_VERSION lists. The last whole run of every row stands in benchmarks/results/matrix.md.
"""

import platform
from datetime import date
from pathlib import Path

import nox

nox.options.default_venv_backend = "uv"
nox.options.download_python = "never"
nox.options.error_on_missing_interpreters = False
nox.options.envdir = "build/matrix"

OLDEST = "3.11"
PYTHONS = (OLDEST, "3.13", "3.14")
EVERYTHING = ("tests", "lpvobs")
SMALL = ("tests/engines", "tests/maps", "tests/selftest", "tests/io", "-m", "not slow")
"""What the row without the compiler runs: the others would take an hour."""
NAMES = ("numpy", "scipy", "pandas", "pyarrow", "numba", "h5py", "cvxpy", "clarabel")
RESULTS = Path("benchmarks/results/matrix.md")


@nox.session(python=OLDEST)
def lowest(session: nox.Session) -> None:
    """Run the tests with the lower bound of every dependency."""
    session.install("--resolution", "lowest-direct", "--editable", ".[dev]")
    judge(session, EVERYTHING)


@nox.session(python=PYTHONS)
def newest(session: nox.Session) -> None:
    """Run the tests with the newest versions."""
    session.install("--editable", ".[dev]")
    judge(session, EVERYTHING)


@nox.session(python=OLDEST)
def no_compiler(session: nox.Session) -> None:
    """Run the small tests with the compiled functions as plain Python."""
    session.install("--editable", ".[dev]")
    judge(session, SMALL, NUMBA_DISABLE_JIT="1")


def judge(session: nox.Session, tests: tuple[str, ...], **variables: str) -> None:
    """Run the tests, and note on the page of results what happened; or run those that the command line names, and note nothing."""
    variables |= {"OPENBLAS_NUM_THREADS": "1", "NUMBA_CACHE_DIR": f"{session.virtualenv.location}/numba"}
    python = str(session.run("python", "-V", silent=True)).split()[1]
    ask = "import importlib.metadata as m, sys; print(', '.join(f'{n} {m.version(n)}' for n in sys.argv[1:]))"
    versions = str(session.run("python", "-c", ask, *NAMES, silent=True)).strip()
    side_by_side = ("-n", "auto", "--dist", "loadfile")
    call = ("pytest", "-v", "-p", "no:cacheprovider", *side_by_side, *(session.posargs or tests))
    said = str(session.run(*call, env=variables, silent=True, success_codes=[0, 1])).splitlines()
    failed = [line for line in said if line.startswith(("FAILED", "ERROR"))]
    verdict = f"fails ({len(failed)} tests)" if failed else "passes"
    session.log(said[-1])
    if not session.posargs:
        note(session.name, python, verdict, said[-1].strip("= "), ", ".join(tests), f"{date.today()}", versions)
    if failed:
        session.error("\n".join(failed[:20]))


def note(*cells: str) -> None:
    """Write a row of the page of results in the place of the one of that name."""
    head, rule, *rows = [line for line in RESULTS.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    kept = {row.split("|")[1].strip(): row for row in rows} | {cells[0]: f"| {' | '.join(cells)} |"}
    table = "\n".join([head, rule, *(kept[name] for name in sorted(kept))])
    title = "# Versions, and whether the tests pass with them"
    how = f"`make matrix`, {platform.machine()}. *Lowest* are the lower bounds of `pyproject.toml`."
    RESULTS.write_text(f"{title}\n\n{how}\n\n{table}\n", encoding="utf-8")
