"""The table of tuned numbers, read from the source of `lpvobs/discovery/thresholds.py`."""

import ast
import re
import runpy
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path("lpvobs") / "discovery" / "thresholds.py"
DOCSTRING = re.compile(r"\[(?P<unit>[^\]]+)\] (?P<meaning>.+?) Set by (?P<run>.+)")


@dataclass(frozen=True)
class Threshold:
    """A tuned number as its source says it; `value` is a float, an int, or a tuple of them."""

    name: str
    value: float | int | tuple[float, ...]
    unit: str
    meaning: str
    run: str


def read_table(repository: Path) -> list[Threshold]:
    """Return the entries; raises ValueError for one that lacks unit, meaning or the run that set it."""
    values = runpy.run_path(str(repository / SOURCE))
    body = ast.parse((repository / SOURCE).read_text(encoding="utf-8")).body
    found = []
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, (ast.Assign, ast.AnnAssign)):
            continue
        name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
        told = after.value if isinstance(after, ast.Expr) else None
        text = " ".join(str(told.value).split()) if isinstance(told, ast.Constant) else ""
        match = DOCSTRING.fullmatch(text)
        if match is None:
            raise ValueError(f"{name}: its docstring is {text!r}, expected `[unit] meaning. Set by run.`")
        found.append(Threshold(name, values[name], *match.groups()))
    return found
