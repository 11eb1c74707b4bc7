"""Where the tests find the repository's files, however deep in `tests` they lie, and a short cycle made of one."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
DIESEL = CONFIGS / "diesel.toml"
LIU_ICE = CONFIGS / "liu-ice.toml"


def short_cycle(folder: Path) -> Path:
    """Write the first 80 s of NEDC as a table into a folder: a drive that takes a moment to simulate."""
    rows = (ROOT / "data" / "cycles" / "nedc.csv").read_text(encoding="utf-8").splitlines()
    path = folder / "cycle.csv"
    path.write_text("\n".join(rows[:80]) + "\n", encoding="utf-8")
    return path
