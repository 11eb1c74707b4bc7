"""The parts of logs as bytes, and where they wait beside the result until all of them are there.

`RESULT.h5.parts/` holds one file per finished log, named by the SHA-256 of the log, until the result has been written. A run that
was killed finds there what it had done. Each file says what it was computed with, so parts of another configuration, gain or
version are not taken for this run's; it appears whole or not at all.
"""

import hashlib
import io
import json
import zipfile
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs import __version__
from lpvobs.errors import DataError
from lpvobs.io.atomic import replacing
from lpvobs.observer.parts import LogPart, LogRun, StateGain
from lpvobs.records import Defects, Finding

FORMAT = 1
ENDING = ".part"
ARRAYS = ("cells", "gram", "H", "h", "coupling")


@dataclass(frozen=True)
class StoredPart:
    """The part of a log, and which rows of its file were used, eight in a byte, slab by slab."""

    part: LogPart
    kept: tuple[NDArray[np.uint8], ...]


def run_key(config_text: str, gain: StateGain) -> str:
    """Return a digest of everything but the logs that a part depends on."""
    made_with = [FORMAT, __version__, config_text, list(gain.outputs), gain.L.tolist(), str(gain.region)]
    return hashlib.sha256(json.dumps(made_with).encode()).hexdigest()


def part_bytes(stored: StoredPart, key: str) -> bytes:
    """Return a part as the bytes of its file; the same part gives the same bytes."""
    part = stored.part
    run = part.run
    head = {
        "key": key,
        "name": run.name,
        "sha256": run.sha256,
        "samples": run.samples,
        "duration": run.duration,
        "share_certified": run.share_certified,
        "defects": asdict(run.defects),
    }
    arrays: dict[str, Any] = {name: getattr(part, name) for name in ARRAYS}
    arrays |= {"lower": run.lower, "upper": run.upper, "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)}
    arrays |= {f"kept_{number}": mask for number, mask in enumerate(stored.kept)}
    target = io.BytesIO()
    np.savez(target, allow_pickle=False, **arrays)
    return target.getvalue()


def part_of_bytes(data: bytes) -> tuple[StoredPart, str]:
    """Return a part and the key that it was made with; raises ValueError for anything else."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            head = json.loads(stored["head"].tobytes())
            kept = [stored[f"kept_{number}"] for number in range(sum(name.startswith("kept_") for name in stored))]
            run = LogRun(
                name=head["name"],
                sha256=head["sha256"],
                samples=head["samples"],
                duration=head["duration"],
                defects=replace(
                    Defects(**head["defects"]), findings=tuple(Finding(**item) for item in head["defects"]["findings"])
                ),
                lower=stored["lower"],
                upper=stored["upper"],
                share_certified=head["share_certified"],
            )
            part = LogPart(run, *(stored[name] for name in ARRAYS))
    except (KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"not a part ({error})") from None
    return StoredPart(part, tuple(kept)), str(head["key"])


class PartsFolder:
    """The folder of parts beside a result.

    Parameters
    ----------
    result : Path
        The result that is being made.
    key : str
        What the parts of this run are made with.
    """

    def __init__(self, result: Path, key: str):
        self.path = result.with_name(result.name + ".parts")
        self.key = key

    def found(self) -> frozenset[str]:
        """Return the digests of the logs that an earlier run has done."""
        return frozenset(file.stem for file in self.path.glob(f"*{ENDING}") if self._usable(file))

    def keep(self, sha256: str, data: bytes) -> None:
        """Store the part of a log."""
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise DataError(
                f"{self.path}: cannot be made ({error.strerror}); parts of many logs wait there: name a writable folder in --out"
            ) from None
        with replacing(self._file(sha256)) as temporary:
            temporary.write_bytes(data)

    def read(self, sha256: str) -> StoredPart:
        """Return the part of a log that is known to be there."""
        try:
            return part_of_bytes(self._file(sha256).read_bytes())[0]
        except (OSError, ValueError) as error:
            raise DataError(f"{self._file(sha256)}: {error}; delete the folder and run again") from None

    def remove(self) -> None:
        """Delete the parts, what a killed writer left of them, and the folder, unless there is something else in it."""
        for pattern in (f"*{ENDING}", f".*{ENDING}.lock"):
            for file in self.path.glob(pattern):
                file.unlink()
        with suppress(OSError):
            self.path.rmdir()

    def _file(self, sha256: str) -> Path:
        return self.path / f"{sha256}{ENDING}"

    def _usable(self, file: Path) -> bool:
        try:
            stored, key = part_of_bytes(file.read_bytes())
        except (OSError, ValueError):
            return False
        return key == self.key and stored.part.run.sha256 == file.stem
