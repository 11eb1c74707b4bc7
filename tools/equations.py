"""Lists where each equation of the paper stands in the code, as a page in Markdown: `python tools/equations.py > PAGE`.

A line that computes an equation ends with `# Eq. (26)`, or with several, `# Eq. (14), Eq. (15)`. The plain transcriptions that the
tests compare the package with are looked through as well.
"""

import io
import re
import sys
import tokenize
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("lpvobs", "tests/reference")
SPELLING = re.compile(r"# Eq\. \(\d+\)(, Eq\. \(\d+\))*")

EQUATIONS = {
    1: "the nonlinear air path",
    2: "flows and powers of the air path",
    3: "scheduling parameters rho_1 to rho_5",
    4: "the air path as an LPV system",
    5: "the matrices A and E of Eq. (4), with a_1 and a_2",
    6: "the outputs y",
    7: "the measured outputs y_m: the sensor reads the flow plus its error",
    8: "the grid of the map",
    9: "the nodes theta: the sensor's error at the grid points",
    10: "interpolation along the fuel axis, inside the grid",
    11: "interpolation along both axes, inside the grid",
    12: "the map everywhere: constant beyond the speed axis",
    13: "the map everywhere: constant beyond the fuel axis",
    14: "intervals of the fuel axis",
    15: "intervals of the speed axis",
    16: "membership functions of the fuel intervals",
    17: "membership functions of the speed intervals",
    18: "the map as a product over the speed axis",
    19: "Psi_n, the weights along the speed axis",
    20: "the map as a product over the fuel axis",
    21: "Psi_u, the weights along the fuel axis",
    22: "the map as the product of Psi(v) and theta",
    23: "Psi(v), and the order of the nodes in theta",
    24: "state space equation with the map in the output",
    25: "the matrices C and G of Eq. (24)",
    26: "the adaptive observer",
    27: "the matrix inequality of Theorem 1",
    28: "the condition of Theorem 1 on eps_1 and eps_2",
    29: "persistency of excitation",
    30: "the system of the errors",
    31: "derivative of the Lyapunov function",
    32: "the integral of this derivative",
    33: "the inequality at the vertices of the region",
    34: "Psi_l, the weights of the four nodes around the operating point",
    35: "eta_1 and eta_2, the place within a cell",
    36: "the observer, written for these four nodes only",
    37: "the quadratic for extrapolation",
    38: "the published gain",
    39: "the published quadratic, ETC part 1",
    40: "the published quadratic, FTP75",
}
WITHOUT_LINE = {
    9: "definition: names the values at the nodes",
    10: "definition: a step towards Eq. (34), which contains the weights of Eq. (10) and (11)",
    11: "definition: a step towards Eq. (34), which contains the weights of Eq. (10) and (11)",
    18: "definition: Eq. (12) written with membership functions; the code computes Eq. (22) instead",
    20: "definition: Eq. (13) written with membership functions; the code computes Eq. (22) instead",
    31: "proof only: a step in the proof of Theorem 1",
    32: "proof only: a step in the proof of Theorem 1",
}


@dataclass(frozen=True)
class Place:
    """A line of code that computes an equation."""

    path: str
    line: int
    code: str


def comments(path: Path) -> list[tuple[int, str, str]]:
    """Return line number, code before it and text of every comment in a file."""
    text = path.read_text(encoding="utf-8")
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [(t.start[0], t.line[: t.start[1]].strip(), t.string) for t in tokens if t.type == tokenize.COMMENT]


@cache
def places() -> dict[int, list[Place]]:
    """Return the lines of every equation that has any, in the order of files and lines."""
    found: dict[int, list[Place]] = {}
    for path in (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))):
        for line, code, comment in comments(path):
            if SPELLING.fullmatch(comment):
                for number in re.findall(r"\d+", comment):
                    found.setdefault(int(number), []).append(Place(str(path.relative_to(ROOT)), line, code))
    return found


def page() -> str:
    """Return the list in Markdown."""
    lines = []
    for number, what in EQUATIONS.items():
        lines += ["", f"**Eq. ({number})**, {what}", ""]
        lines += [f"- `{place.path}:{place.line}`: `{place.code}`" for place in places().get(number, [])]
        lines += [f"- {WITHOUT_LINE[number]}"] if number in WITHOUT_LINE else []
    return "\n".join(lines[1:]) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
