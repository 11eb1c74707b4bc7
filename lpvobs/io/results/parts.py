"""Where the parts of logs wait beside the result, as files, until all of them are there.

`RESULT.h5.parts/` holds one file per finished log, named by the SHA-256 of the log, until the result has been written. A run that
was killed finds there what it had done. Each file says what it was computed with, so parts of another configuration, gain or
version are not taken for this run's; it appears whole or not at all.
"""

import hashlib
import json
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from lpvobs import __version__
from lpvobs.errors import DataError
from lpvobs.io.results.mapping import element_of
from lpvobs.observer import balance_agreement, parts

FORMAT = 7
ENDING = ".part"
OWN = re.compile(r"[0-9a-f]{64}\.part")
UNFINISHED = re.compile(r"\.[0-9a-f]{64}\.part\.(part|lock)")
MOST_BYTES = 2**29  # largest size of a part; the part of 10^9 samples has a quarter of it
Left = TypeVar("Left")


@dataclass(frozen=True)
class StoredPart:
    """The part of a log, which rows of its file were used, eight in a byte, slab by slab, and what its balances say."""

    part: parts.LogInformation
    kept: tuple[NDArray[np.uint8], ...]
    balances: balance_agreement.BalanceSums


@dataclass(frozen=True)
class _File(Generic[Left]):
    """What a file holds, of which log, and what it was made with."""

    key: str
    sha256: str
    stored: Left


def run_key(config_text: str, gain: parts.StateGain) -> str:
    """Return a digest of everything but the logs that a part depends on."""
    made_with = [FORMAT, __version__, config_text, list(gain.outputs), gain.L.tolist(), str(gain.region)]
    return hashlib.sha256(json.dumps(made_with).encode()).hexdigest()


def part_bytes(key: str, sha256: str, stored: object) -> bytes:
    """Return the part of a log as the bytes of its file, a digest before them; the same part gives the same bytes."""
    body = msgspec.msgpack.encode(_File(key, sha256, stored), enc_hook=_shape_and_bytes)
    return hashlib.sha256(body).digest() + body


def part_of_bytes(data: bytes, kind: type[Left]) -> tuple[Left, str, str]:
    """Return a part, the key that it was made with, and the digest of its log; raises ValueError for anything else."""
    body = data[32:]
    if hashlib.sha256(body).digest() != data[:32]:
        raise ValueError("is damaged, or is not the stored part of a log")
    try:
        of_kind: Any = _File
        file: _File[Left] = msgspec.msgpack.decode(body, type=of_kind[kind], dec_hook=_array)
    except (msgspec.MsgspecError, RecursionError, MemoryError, OverflowError) as error:
        raise ValueError(f"is not the stored part of a log ({error})") from None
    return file.stored, file.key, file.sha256


def _shape_and_bytes(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else (value.shape, value.tobytes())


def _array(kind: Any, stored: Any) -> NDArray[Any]:
    shape, data = msgspec.convert(stored, tuple[tuple[int, ...], bytes])
    return np.frombuffer(data, element_of(kind)).reshape(shape).copy()


class PartsFolder(Generic[Left]):
    """The folder of parts of a kind beside a result that is being made; `key` says what those of this run are made with."""

    def __init__(self, result: Path, key: str, kind: type[Left]):
        self.path = result.with_name(result.name + ".parts")
        self.key, self.kind = key, kind

    def found(self) -> frozenset[str]:
        """Return the digests of the logs that an earlier run has done."""
        return frozenset(file.stem for file in self._own(OWN) if self._usable(file))

    def keep(self, sha256: str, stored: Left) -> None:
        """Store the part of a log."""
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise DataError(
                f"{self.path}: this folder cannot be made ({error.strerror}), but the run needs it to store finished logs; "
                f"give --out in a folder that you can write to"
            ) from None
        # No lock: the result is claimed. No wait for the disk: a part that a power cut tears has a wrong digest, and is made anew.
        file = self._file(sha256)
        temporary = file.with_name(f".{file.name}{ENDING}")
        try:
            temporary.write_bytes(part_bytes(self.key, sha256, stored))
            temporary.replace(file)
        except OSError as error:
            with suppress(OSError):
                temporary.unlink()  # half a part would take room that the disk does not have
            raise DataError(
                f"{file}: writing failed ({error.strerror or error}); finished logs are kept; free disk space and run this again"
            ) from None

    def read(self, sha256: str) -> Left:
        """Return the part of a log that is known to be there."""
        try:
            return part_of_bytes(self._file(sha256).read_bytes(), self.kind)[0]
        except (OSError, ValueError) as error:
            raise DataError(f"{self._file(sha256)}: {error}; delete the folder of this file and run again") from None

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
            small = file.stat().st_size <= MOST_BYTES
            return small and part_of_bytes(file.read_bytes(), self.kind)[1:] == (self.key, file.stem)
        except (OSError, ValueError):
            return False
