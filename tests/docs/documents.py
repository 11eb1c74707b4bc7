"""Reads and runs the commands of a Markdown page, and compares what they print with what the page shows.

A block of language sh is run as a whole; one of language text after it shows what that printed: `...` alone stands for any lines,
three dots in a word for anything. Numbers may differ a little, names and words may not.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from repository import ROOT

SKIPPED = ("make ", "python3 -m venv ", "pip install ", ".venv/bin/pip install ", ". .venv/bin/activate")
"""Commands that set up what the tests have already, an environment with the package in it; and `make`, which would run them all."""
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
SHARE = 0.01
"""By which numbers may differ. They repeat to the last digit on one machine; other processors and libraries sum in another
order, and the solver of the gain stops elsewhere."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page; `line` is where it begins."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page in order."""
    found, inside, start, language = [], None, 0, ""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            if inside is None:
                inside, start, language = [], number, line[3:].strip()
            else:
                found.append(Block(language, "\n".join(inside), start))
                inside = None
        elif inside is not None:
            inside.append(line)
    return found


def commands(page: Path) -> list[tuple[Block, Block | None]]:
    """Return every block of commands with the block that shows its output, if there is one."""
    all_blocks = [*blocks(page), Block("", "", 0)]
    return [
        (first, second if second.language == "text" else None)
        for first, second in pairwise(all_blocks)
        if first.language == "sh"
    ]


def without_set_up(text: str) -> str:
    """Return commands without those that the tests skip."""
    return "\n".join(line for line in text.splitlines() if not line.startswith(SKIPPED))


def prepare(folder: Path) -> dict[str, str]:
    """Make a folder look like the project's own to its reader, and return an environment in which its commands are found."""
    for name in ("configs", "examples"):
        (folder / name).symlink_to(ROOT / name)
    programs = folder / ".programs"
    programs.mkdir()
    verb = f'exec {sys.executable} -c "from lpvobs.cli.main import run; run()" "$@"'
    for name, call in (("lpvobs", verb), ("python", f'exec {sys.executable} "$@"')):
        (programs / name).write_text(f"#!/bin/sh\n{call}\n", encoding="utf-8")
        (programs / name).chmod(0o755)
    return os.environ | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONUNBUFFERED": "1",  # both streams in the order of a terminal
        "COLUMNS": "200",
        "OPENBLAS_NUM_THREADS": "1",
    }


def run(text: str, folder: Path, environment: dict[str, str]) -> str:
    """Run commands in a shell and return all that they printed; fails where one of them fails."""
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, f"exit code {done.returncode} from\n{text}\n{done.stdout}"
    return done.stdout


def missing(shown: str, printed: str) -> str:
    """Return the first shown line that was not printed in its place; empty where all were."""
    lines = [line for line in printed.splitlines() if line.strip()]
    at, anywhere = 0, False
    for line in shown.splitlines():
        if line.strip() == "...":
            anywhere = True
        elif line.strip():
            places = range(at, len(lines)) if anywhere else range(at, min(at + 1, len(lines)))
            place = next((place for place in places if same_line(line, lines[place])), None)
            if place is None:
                return line
            at, anywhere = place + 1, False
    return "" if anywhere or at == len(lines) else f"(not shown) {lines[at]}"


def same_line(shown: str, printed: str) -> bool:
    """Tell whether two lines say the same, however wide their columns are."""
    mine, theirs = shown.split(), printed.split()
    return len(mine) == len(theirs) and all(map(same_word, mine, theirs))


def same_word(shown: str, printed: str) -> bool:
    """Tell whether two words are the same, but for dots and the last digits of numbers."""
    if "..." in shown:
        return re.fullmatch(".*".join(map(re.escape, shown.split("..."))), printed) is not None
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    return all(map(close, NUMBER.findall(shown), NUMBER.findall(printed)))


def close(shown: str, printed: str) -> bool:
    """Tell whether two numbers agree within `SHARE`, or within one unit of the last decimal that is shown."""
    mine, theirs = float(shown), float(printed)
    decimals = len(shown.partition(".")[2]) if "e" not in shown else 0
    last = 10.0**-decimals if "." in shown and "e" not in shown else 0.0
    return abs(mine - theirs) <= max(SHARE * abs(mine), 1.0001 * last)
