import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from repository import DIESEL


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


def run(*arguments, cwd=None) -> Done:
    """Run the command line as its users do: a process of its own."""
    call = [sys.executable, "-c", "from lpvobs.cli.main import run; run()", *map(str, arguments)]
    done = subprocess.run(
        call, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL, check=False, cwd=cwd
    )
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="session")
def lpvobs() -> Callable[..., Done]:
    return run


@pytest.fixture(scope="session")
def config() -> Path:
    return DIESEL


@dataclass(frozen=True)
class Chain:
    """One pass through the chain at 20 Hz, so that it takes seconds."""

    folder: Path
    log: Path
    gain: Path
    result: Path


@pytest.fixture(scope="session")
def chain(tmp_path_factory) -> Chain:
    folder = tmp_path_factory.mktemp("chain")
    log, gain, result = folder / "ftp75_cold.parquet", folder / "gain.h5", folder / "result.h5"
    steps = (
        ("simulate", "--config", DIESEL, "--cycle", "ftp75_cold", "--rate", 20, "--seed", 3, "--out", log),
        ("synth-gain", "--config", DIESEL, log, "--out", gain),
        ("estimate", "--config", DIESEL, "--gain", gain, log, "--out", result),
        ("extrapolate", result),
    )
    for step in steps:
        done = run(*step)
        assert done.code == 0, f"{step}: {done.err}"
    return Chain(folder, log, gain, result)


@pytest.fixture(scope="session")
def table(chain):
    return pq.read_table(chain.log)


@pytest.fixture(scope="session")
def rewritten():
    """Return a function that writes a table to a path with other units."""

    def write(table, path, **units):
        fields = [
            pa.field(f.name, f.type, metadata={"unit": units.get(f.name, f.metadata[b"unit"].decode())})
            for f in table.schema
        ]
        pq.write_table(pa.table(table.columns, schema=pa.schema(fields)), path)

    return write
