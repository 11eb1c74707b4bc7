"""The tests with the lowest and the newest versions that are admitted, on the Pythons at hand, and without the compiler.

    python benchmarks/matrix.py [--python 3.11=/path/to/python3.11 ...] [--only lowest-3.11,...] [--tests tests/io,...]

Lowest are the lower bounds of pyproject.toml, run-time and test dependencies alike, on the oldest Python; newest is what pip
finds. Each row of the matrix gets an environment of its own in build/matrix; the last results stand in
benchmarks/results/matrix.md.
"""

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "matrix"
RESULTS = ROOT / "benchmarks" / "results" / "matrix.md"
STATE = BUILD / "results.json"
SMALL = ("tests/engines", "tests/maps", "tests/selftest", "tests/io")
"""What the row without the compiler runs: the others would take an hour."""
NAMES = ("numpy", "scipy", "pandas", "pyarrow", "numba", "h5py", "cvxpy", "clarabel")


@dataclass(frozen=True)
class Row:
    """One environment and what runs in it."""

    name: str
    python: str
    lowest: bool
    compiler: bool = True


def rows(pythons: dict[str, str]) -> list[Row]:
    """Return the matrix: lowest on the oldest Python, newest on every one, and the small tests without the compiler."""
    oldest, newest = (sorted(pythons, key=_number)[end] for end in (0, -1))
    found = [Row(f"lowest-{oldest}", oldest, True), Row(f"newest-{oldest}", oldest, False)]
    if newest != oldest:
        found.append(Row(f"newest-{newest}", newest, False))
    return [*found, Row(f"no-compiler-{oldest}", oldest, False, compiler=False)]


def lower_bounds() -> dict[str, str]:
    """Return the lower bound of every dependency in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [
        *project["dependencies"],
        *(item for extra in project["optional-dependencies"].values() for item in extra),
    ]
    bounds = {}
    for item in wanted:
        match = re.fullmatch(r"([A-Za-z0-9_.-]+)>=([0-9.]+)", item)
        if match:
            bounds[match[1]] = match[2]
        elif not item.startswith("lpvobs["):
            raise SystemExit(f"pyproject.toml: '{item}' has no lower bound, expected name>=version")
    return bounds


def environment(row: Row, python: str) -> Path:
    """Make the environment of a row; return its Python."""
    place = BUILD / row.name.replace("no-compiler", "newest")
    executable = place / "bin" / "python"
    if (place / "ready").exists():
        return executable
    shutil.rmtree(place, ignore_errors=True)
    subprocess.run([python, "-m", "venv", str(place)], check=True)
    constraints = place / "constraints.txt"
    bounds = lower_bounds() if row.lowest else {}
    constraints.write_text("".join(f"{name}=={version}\n" for name, version in bounds.items()))
    pip = [str(executable), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--constraint", str(constraints), "--editable", f"{ROOT}[dev]"], check=True)
    (place / "ready").touch()
    return executable


def run(row: Row, executable: Path, tests: list[str]) -> dict[str, str]:
    """Run the tests of a row; return what happened."""
    variables = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_CACHE_DIR": str(BUILD / row.name / "cache"),
        "PYTHONPATH": str(ROOT),
    }
    if not row.compiler:
        variables["NUMBA_DISABLE_JIT"] = "1"
        tests = list(SMALL)
    began = time.monotonic()
    side_by_side = ("-n", "auto", "--dist", "loadfile")
    call = [str(executable), "-m", "pytest", "-q", "-p", "no:cacheprovider", *side_by_side, *tests]
    done = subprocess.run(call, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
    summary = [line for line in done.stdout.splitlines() if re.search(r"\d+ (passed|failed|error)", line)]
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    print("\n".join(failed[:20] or done.stderr.splitlines()[-5:]))
    ask = "import json, sys, importlib.metadata as m; print(json.dumps({n: m.version(n) for n in sys.argv[1:]}))"
    versions = json.loads(
        subprocess.run([str(executable), "-c", ask, *NAMES], capture_output=True, text=True, check=True).stdout
    )
    python = subprocess.run([str(executable), "-V"], capture_output=True, text=True, check=True).stdout.split()[1]
    return {
        "python": python,
        "tests": summary[-1].strip("= ") if summary else _counted(done.stdout),
        "verdict": "passes" if done.returncode == 0 else f"fails ({len(failed)} tests)",
        "seconds": f"{time.monotonic() - began:.0f}",
        "date": date.today().isoformat(),
        "what": "all" if tests == ["tests", "lpvobs"] else ", ".join(tests),
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
    }


def _counted(output: str) -> str:
    """Return how many tests ran, from the dots of a quiet run."""
    lines = [line for line in output.splitlines() if re.fullmatch(r"[.sxEF]+(\s+\[\s*\d+%\])?", line)]
    dots = "".join(line.split()[0] for line in lines)
    return f"{dots.count('.')} passed, {dots.count('F') + dots.count('E')} failed, {dots.count('s')} skipped"


def page(found: dict[str, dict[str, str]]) -> str:
    """Return the page of results."""
    lines = [
        "# Versions, and whether the tests pass with them",
        "",
        f"`make matrix`, {platform.machine()}. *Lowest* are the lower bounds of `pyproject.toml`.",
        "",
        "| row | Python | verdict | tests | s | of | date |",
        "|---|---|---|---|---:|---|---|",
    ]
    for name, item in found.items():
        cells = (name, *(item[key] for key in ("python", "verdict", "tests", "seconds", "what", "date")))
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *(f"- {name}: {item['versions']}" for name, item in found.items())]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the matrix."""
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--python", action="append", metavar="VERSION=PATH", help="by default the Pythons of pyenv from 3.11 on"
    )
    parser.add_argument("--only", type=lambda text: text.split(","))
    parser.add_argument("--tests", type=lambda text: text.split(","), default=["tests", "lpvobs"])
    options = parser.parse_args()
    pythons = dict(item.split("=", 1) for item in options.python) if options.python else at_hand()
    BUILD.mkdir(parents=True, exist_ok=True)
    found = json.loads(STATE.read_text()) if STATE.exists() else {}
    bad = 0
    for row in rows(pythons):
        if options.only and row.name not in options.only:
            continue
        print(f"{row.name} ...", flush=True)
        found[row.name] = run(row, environment(row, pythons[row.python]), options.tests)
        print(f"{row.name}: {found[row.name]['verdict']}, {found[row.name]['tests']}", flush=True)
        bad += found[row.name]["verdict"] != "passes"
        STATE.write_text(json.dumps(found, indent=1))
        RESULTS.write_text(page(found), encoding="utf-8")
    sys.exit(bool(bad))


def at_hand() -> dict[str, str]:
    """Return the Pythons from 3.11 on: of pyenv, and the one that runs this."""
    found = {f"{sys.version_info.major}.{sys.version_info.minor}": sys.executable}
    for path in sorted(
        (Path.home() / ".pyenv" / "versions").glob("3.*/bin/python"), key=lambda item: _number(item.parts[-3])
    ):
        version = ".".join(path.parts[-3].split(".")[:2])
        if _number(version) >= (3, 11):
            found[version] = str(path)
    return found


def _number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


if __name__ == "__main__":
    main()
