"""Commands as their users run them: wall time, processor time and the memory of all their processes together (Linux)."""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

LPVOBS = [sys.executable, "-c", "from lpvobs.cli.main import run; run()"]
LOOK = 0.05
"""[s] between two looks at the memory."""


@dataclass(frozen=True)
class Watched:
    """What a command took: seconds of the clock and of the processors, and the most memory at any look [bytes]."""

    seconds: float
    processor: float
    memory: int
    code: int


def watch(arguments: Sequence[object], environment: dict[str, str] | None = None) -> Watched:
    """Run `lpvobs` with arguments and watch it; it keeps its byte code, as it does for its users."""
    usual = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before, begin = os.times(), time.perf_counter()
    call = [*LPVOBS, *map(str, arguments)]
    process = subprocess.Popen(
        call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=usual | (environment or {})
    )
    most = 0
    while process.poll() is None:
        most = max(most, sum(_resident(pid) for pid in _tree(process.pid)))
        time.sleep(LOOK if time.perf_counter() - begin > 1.0 else 0.005)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return Watched(time.perf_counter() - begin, used, most, process.returncode)


def _tree(root: int) -> list[int]:
    """Return a process and all below it."""
    found, todo = [], [root]
    while todo:
        pid = todo.pop()
        found.append(pid)
        try:
            tasks = list(Path(f"/proc/{pid}/task").iterdir())
            todo += [int(child) for task in tasks for child in (task / "children").read_text().split()]
        except OSError:
            continue
    return found


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
    except OSError:
        return 0
