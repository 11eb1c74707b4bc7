"""The parts of logs as bytes, and where they wait beside the result until all of them are there.

`RESULT.h5.parts/` holds one file per finished log, named by the SHA-256 of the log, until the result has been written. A run that
was killed finds there what it had done. Each file says what it was computed with, so parts of another configuration, gain or
version are not taken for this run's; it appears whole or not at all.
"""

import hashlib
import json
import math
import re
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from stat import S_ISREG

import numpy as np
from numpy.typing import NDArray

from lpvobs import __version__
from lpvobs.errors import DataError
from lpvobs.observer.parts import LogPart, LogRun, StateGain
from lpvobs.records import Defects, Finding

FORMAT = 2
ENDING = ".part"
OWN = re.compile(r"[0-9a-f]{64}\.part")
UNFINISHED = re.compile(r"\.[0-9a-f]{64}\.part\.(part|lock)")
MOST_BYTES = 2**29
"""Of a part; that of 10^9 samples has a quarter of it."""
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
    """Return a part as the bytes of its file; the same part gives the same bytes.

    A digest, the length of a heading in JSON, the heading, and the arrays that it lists one after the other: parts of a thousand
    logs are read by one process while the others wait.
    """
    part = stored.part
    run = part.run
    arrays = [*(getattr(part, name) for name in ARRAYS), run.lower, run.upper, *stored.kept]
    head = {
        "key": key,
        "name": run.name,
        "sha256": run.sha256,
        "samples": run.samples,
        "duration": run.duration,
        "share_certified": run.share_certified,
        "defects": asdict(run.defects),
        "arrays": [(array.dtype.str, array.shape) for array in arrays],
    }
    text = json.dumps(head).encode()
    body = b"".join(
        [len(text).to_bytes(8, "little"), text, *(np.ascontiguousarray(array).tobytes() for array in arrays)]
    )
    return hashlib.sha256(body).digest() + body


def part_of_bytes(data: bytes) -> tuple[StoredPart, str]:
    """Return a part and the key that it was made with; raises ValueError for anything else."""
    digest, body = data[:32], data[32:]
    if hashlib.sha256(body).digest() != digest:
        raise ValueError("not a part, or a damaged one")
    try:
        begin = 8 + int.from_bytes(body[:8], "little")
        head = json.loads(body[8:begin])
        arrays = []
        for kind, shape in head["arrays"]:
            count = math.prod(shape)
            arrays.append(np.frombuffer(body, kind, count, begin).reshape(shape).copy())
            begin += arrays[-1].nbytes
        named, (lower, upper, *kept) = arrays[: len(ARRAYS)], arrays[len(ARRAYS) :]
        run = LogRun(
            name=head["name"],
            sha256=head["sha256"],
            samples=head["samples"],
            duration=head["duration"],
            defects=replace(
                Defects(**head["defects"]), findings=tuple(Finding(**item) for item in head["defects"]["findings"])
            ),
            lower=lower,
            upper=upper,
            share_certified=head["share_certified"],
        )
        return StoredPart(LogPart(run, *named), tuple(kept)), str(head["key"])
    except (KeyError, TypeError, AttributeError, OverflowError, RecursionError, SyntaxError) as error:
        raise ValueError(f"not a part ({error})") from None


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
        return frozenset(file.stem for file in self._own(OWN) if self._usable(file))

    def keep(self, sha256: str, data: bytes) -> None:
        """Store the part of a log."""
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise DataError(
                f"{self.path}: cannot be made ({error.strerror}); parts of many logs wait there: name a writable folder in --out"
            ) from None
        # No lock: the result is claimed. No wait for the disk: a part that a power cut tears has a wrong digest, and is made anew.
        file = self._file(sha256)
        temporary = file.with_name(f".{file.name}{ENDING}")
        try:
            temporary.write_bytes(data)
            temporary.replace(file)
        except OSError as error:
            with suppress(OSError):
                temporary.unlink()  # half a part would take room that the disk does not have
            raise DataError(f"{file}: writing failed ({error.strerror or error}); finished logs are kept") from None

    def read(self, sha256: str) -> StoredPart:
        """Return the part of a log that is known to be there."""
        try:
            return part_of_bytes(self._file(sha256).read_bytes())[0]
        except (OSError, ValueError) as error:
            raise DataError(f"{self._file(sha256)}: {error}; delete the folder and run again") from None

    def remove(self) -> None:
        """Delete the parts, what a killed writer left of them, and the folder, unless there is something else in it."""
        with suppress(OSError):  # the result has been written: what cannot be removed costs nothing
            for file in (*self._own(OWN), *self._own(UNFINISHED)):
                file.unlink()
            self.path.rmdir()

    def _own(self, name: re.Pattern[str]) -> list[Path]:
        """Return the files of this kind; what has another name, or is a link, folder or pipe, is somebody else's."""
        try:
            return [file for file in self.path.iterdir() if name.fullmatch(file.name) and S_ISREG(file.lstat().st_mode)]
        except OSError:  # no such folder, or none that may be read: making a part will tell
            return []

    def _file(self, sha256: str) -> Path:
        return self.path / f"{sha256}{ENDING}"

    def _usable(self, file: Path) -> bool:
        try:
            if file.stat().st_size > MOST_BYTES:
                return False
            stored, key = part_of_bytes(file.read_bytes())
        except (OSError, ValueError):
            return False
        return key == self.key and stored.part.run.sha256 == file.stem
