"""The observer as an FMU (FMI 2.0, co-simulation): description, sources, and a shared library for 64-bit Linux."""

import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from shutil import which
from xml.sax.saxutils import quoteattr

from lpvobs.errors import UsageError
from lpvobs.io.control_unit.sources import FOLDER, Unit, own_text
from lpvobs.io.templates import filled

NAME = "lpvobs"
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
SAME_DAY = (1980, 1, 1, 0, 0, 0)  # stamp of every file inside: the same inputs give the same bytes


def write_fmu(path: Path, unit: Unit, made: Mapping[str, str]) -> None:
    """Write an FMU of the C sources; raises UsageError without a C compiler."""
    own = {name: text for name, text in made.items() if name != "lpvobs_bench.c"}
    own["lpvobs_fmu.c"] = own_text("lpvobs_fmu.c")
    version = re.findall(r'lpvobs_version.* = "(.*)"', own["lpvobs_tables.c"])[0]
    inside: dict[str, bytes] = {"modelDescription.xml": _description(unit, version, own).encode()}
    inside |= {f"sources/{name}": text.encode() for name, text in own.items()}
    inside[f"binaries/linux64/{NAME}.so"] = _library(own)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in sorted(inside.items()):
            file.writestr(zipfile.ZipInfo(name, SAME_DAY), content, zipfile.ZIP_DEFLATED)


def _library(sources: Mapping[str, str]) -> bytes:
    if which("cc") is None:
        raise UsageError(
            "--format fmu: needs a C compiler, but there is no `cc`; install gcc or clang, or use --format c99"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        files_in_c = sorted(name for name in sources if name.endswith(".c"))
        command = ["cc", *FLAGS, *files_in_c, "-lm", "-o", f"{NAME}.so"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise UsageError(
                f"--format fmu: the C compiler failed: {done.stderr.strip().splitlines()[-1]}; try another compiler"
            )
        return (Path(folder) / f"{NAME}.so").read_bytes()


def _description(unit: Unit, version: str, sources: Mapping[str, str]) -> str:
    path, grid = unit.air_path, unit.grid
    speed, fuel = path.axes[1].unit, path.axes[0].unit
    outputs = [(f"x_{name}", "state estimate, SI") for name in path.state_names]
    outputs += [("map_value", "kg/s: the map at the operating point"), ("innovation", "kg/s"), ("state_time", "s")]
    outputs += [
        (f"theta_{j}_{i}", f"kg/s: node at {n:g} {speed}, {u:g} {fuel}")
        for j, n in enumerate(grid.speed)
        for i, u in enumerate(grid.fuel)
    ]
    return filled(
        FOLDER,
        "modelDescription.xml",
        {"quoted": quoteattr},
        version=version,
        files_in_c=sorted(name for name in sources if name.endswith(".c")),
        step=1.0 / unit.rate,
        channels=unit.channels,
        outputs=outputs,
    )
