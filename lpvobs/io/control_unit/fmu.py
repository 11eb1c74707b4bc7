"""The observer as an FMU (FMI 2.0, co-simulation): description, sources, and a shared library for 64-bit Linux."""

import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from shutil import which
from xml.sax.saxutils import quoteattr

from lpvobs.errors import UsageError
from lpvobs.io.control_unit.sources import Unit

NAME = "lpvobs"
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
SAME_DAY = (1980, 1, 1, 0, 0, 0)
"""Stamp of every file inside: the same inputs give the same bytes."""


def write_fmu(path: Path, unit: Unit, made: Mapping[str, str]) -> None:
    """Write an FMU of the C sources; raises UsageError without a C compiler."""
    own = {name: text for name, text in made.items() if name != "lpvobs_bench.c"}
    own["lpvobs_fmu.c"] = (files("lpvobs.io.control_unit") / "lpvobs_fmu.c").read_text(encoding="utf-8")
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
            "--format fmu: needs a C compiler, and there is no `cc`; install gcc or clang, or take --format c99"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        files_in_c = sorted(name for name in sources if name.endswith(".c"))
        command = ["cc", *FLAGS, *files_in_c, "-lm", "-o", f"{NAME}.so"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise UsageError(
                f"--format fmu: the C compiler failed: {done.stderr.strip().splitlines()[-1]}; try another one"
            )
        return (Path(folder) / f"{NAME}.so").read_bytes()


def _description(unit: Unit, version: str, sources: Mapping[str, str]) -> str:
    states, path = unit.air_path.state_names, unit.air_path
    taken = [("in_" + name, f"{item.unit}: {item.meaning}") for name, item in unit.channels.items()]
    given = [(f"x_{name}", "state estimate, SI") for name in states]
    given += [("map_value", "kg/s: the map at the operating point"), ("innovation", "kg/s"), ("state_time", "s")]
    given += [
        (f"theta_{j}_{i}", f"kg/s: node at {speed:g} {path.axes[1].unit}, {fuel:g} {path.axes[0].unit}")
        for j, speed in enumerate(unit.grid.speed)
        for i, fuel in enumerate(unit.grid.fuel)
    ]
    lines = [_variable(i, name, told, "input", "discrete", '<Real start="0"/>') for i, (name, told) in enumerate(taken)]
    lines += [
        _variable(i, name, told, "output", "discrete", "<Real/>") for i, (name, told) in enumerate(given, len(taken))
    ]
    lines.append(
        _variable(len(lines), "flags", "LPVOBS_BAD_CHANNEL and the following", "output", "discrete", "<Integer/>")
    )
    outputs = [f'      <Unknown index="{i + 1}"/>' for i in range(len(taken), len(lines))]
    listed = [f'      <File name="{name}"/>' for name in sorted(sources) if name.endswith(".c")]
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="2.0" modelName="{NAME}" guid={quoteattr(version)}',
            '    description="Adaptive observer of a mass air flow sensor" generationTool="lpvobs">',
            f'  <CoSimulation modelIdentifier="{NAME}" canHandleVariableCommunicationStepSize="true"',
            '      canGetAndSetFMUstate="true" canSerializeFMUstate="true">',
            "    <SourceFiles>",
            *listed,
            "    </SourceFiles>",
            "  </CoSimulation>",
            f'  <DefaultExperiment startTime="0" stepSize="{1.0 / unit.rate!r}"/>',
            "  <ModelVariables>",
            *lines,
            "  </ModelVariables>",
            "  <ModelStructure>",
            "    <Outputs>",
            *outputs,
            "    </Outputs>",
            "    <InitialUnknowns>",
            *outputs,
            "    </InitialUnknowns>",
            "  </ModelStructure>",
            "</fmiModelDescription>\n",
        ]
    )


def _variable(reference: int, name: str, told: str, causality: str, variability: str, kind: str) -> str:
    return (
        f'    <ScalarVariable name="{name}" valueReference="{reference}" description={quoteattr(told)} '
        f'causality="{causality}" variability="{variability}">{kind}</ScalarVariable>'
    )
