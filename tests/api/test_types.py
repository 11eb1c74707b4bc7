"""A user's own file passes `mypy --strict` beside the package, with every public function called as the documentation calls it."""

import ast
import os
import subprocess
import sys

import pytest
from repository import ROOT

import lpvobs

SCRIPT = """
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import lpvobs

FOLDER, CONFIG = Path("drives"), "diesel.toml"


def tell(fraction: float) -> None:
    print(f"{fraction:.0%}")


def make(names: Sequence[str], profile: PathLike[str]) -> None:
    draft: str = lpvobs.draft_profile("drive.mf4", out=profile, names="names.csv")
    record = lpvobs.ingest_log([Path(name) for name in names], profile, FOLDER / "drive.parquet", vehicle="A", date="2026-01-31")
    driven = lpvobs.simulate(CONFIG, "nedc", "nedc.parquet", effects=None, rate=20.0, seed=2, progress=tell)
    table = lpvobs.simulate_bench(CONFIG, 100, "bench.parquet", seed=3)
    rate: float = lpvobs.inspect(FOLDER / "drive.parquet", CONFIG).rate
    print(draft[:80], sorted(record), driven, table, rate)


def estimate(logs: list[Path], jobs: int | None) -> float:
    engine = lpvobs.calibrate(CONFIG, bench="bench.parquet", healthy=logs, maps=["compressor=c.csv"], out="engine.h5")
    gain = lpvobs.synth_gain(CONFIG, logs, out="gain.h5")
    if not lpvobs.verify("gain.h5").proven:
        raise SystemExit(1)
    done = lpvobs.estimate(CONFIG, logs, "map.h5", gain="gain.h5", engine="engine.h5", jobs=jobs, progress=tell)
    filled, half_width = lpvobs.extrapolate("map.h5", "quadratic", smooth=True)
    print(engine, gain.gain.L.shape, filled)
    headline: str = done.headline
    return len(headline) + half_width


def look(log: Path) -> dict[str, float | None]:
    surface = lpvobs.read_map("map.h5")
    mean = surface.mean({"n_e": (1500, 2000)})
    print(surface, mean.values, mean.ci90)
    traced = lpvobs.trace("map.h5", log, freeze_map=True, progress=tell)
    refined = lpvobs.refine("map.h5", [log], "refined.h5", hold_out=log)
    fleet, output = lpvobs.track(CONFIG, [FOLDER], out="fleet.h5", by="vehicle", every="month", jobs=2)
    print(traced, refined, fleet, output)
    change = lpvobs.compare("map.h5", "refined.h5", gates=["largest_change<=0.5 g/s"], figure="change.svg")
    report = lpvobs.write_report("map.h5", log, html="report.html", gates=["nodes>=30"])
    print(lpvobs.export("map.h5", "maf.dcm", "dcm", name="MAF_dW", unit="kg/h"))
    print(lpvobs.export_unit("gain.h5", "unit", "c99", result="map.h5", rate=50.0))
    return {fit.balance: fit.fit for fit in report.fits} | {"change": change.largest_change}
"""


def checked(folder, script):
    """Return code and complaints of `mypy --strict` about a file in another folder, for which the package is installed."""
    (folder / "mine.py").write_text(script, encoding="utf-8")
    call = [sys.executable, "-m", "mypy", "--strict", "--config-file=", f"--cache-dir={folder / 'cache'}", "mine.py"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, timeout=900, check=False)
    return done.returncode, done.stdout + done.stderr


def test_the_script_calls_every_public_function():
    called = {ast.unparse(node.func) for node in ast.walk(ast.parse(SCRIPT)) if isinstance(node, ast.Call)}
    assert {f"lpvobs.{name}" for name in lpvobs.__all__} <= called


@pytest.mark.slow
def test_mypy_passes_a_script_outside_and_refuses_a_wrong_one(tmp_path):
    assert checked(tmp_path, SCRIPT) == (0, "Success: no issues found in 1 source file\n")
    code, said = checked(
        tmp_path, SCRIPT.replace('"gain.h5", engine=', "3.5, engine=").replace("rate: float", "rate: str")
    )
    assert code == 1
    assert said.count("error: ") == 2
