"""The observer as an FMU (FMI 2.0, co-simulation): description, sources, and a shared library for 64-bit Linux."""

import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from shutil import which
from string import Template
from xml.sax.saxutils import quoteattr

from lpvobs.errors import UsageError
from lpvobs.io.control_unit.sources import Unit, own_text

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
    path, grid, channels = unit.air_path, unit.grid, unit.channels.items()
    speed, fuel = path.axes[1].unit, path.axes[0].unit
    given = [(f"x_{name}", "state estimate, SI") for name in path.state_names]
    given += [("map_value", "kg/s: the map at the operating point"), ("innovation", "kg/s"), ("state_time", "s")]
    given += [
        (f"theta_{j}_{i}", f"kg/s: node at {n:g} {speed}, {u:g} {fuel}")
        for j, n in enumerate(grid.speed)
        for i, u in enumerate(grid.fuel)
    ]
    variables = [("in_" + name, f"{c.unit}: {c.meaning}", "input", 'Real start="0"') for name, c in channels]
    first = len(variables)
    variables += [(name, told, "output", "Real") for name, told in given]
    variables.append(("flags", "LPVOBS_BAD_CHANNEL and the following", "output", "Integer"))
    return Template(own_text("modelDescription.xml")).substitute(
        guid=quoteattr(version),
        sources="\n".join(f'      <File name="{name}"/>' for name in sorted(sources) if name.endswith(".c")),
        step=1.0 / unit.rate,
        variables="\n".join(_variable(i, *each) for i, each in enumerate(variables)),
        outputs="\n".join(f'      <Unknown index="{i + 1}"/>' for i in range(first, len(variables))),
    )


def _variable(reference: int, name: str, told: str, causality: str, kind: str) -> str:
    return (
        f'    <ScalarVariable name="{name}" valueReference="{reference}" description={quoteattr(told)} '
        f'causality="{causality}" variability="discrete"><{kind}/></ScalarVariable>'
    )
