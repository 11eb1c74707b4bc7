"""Where the tests find the repository's files, however deep in `tests` they lie."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
DIESEL = CONFIGS / "diesel.toml"
LIU_ICE = CONFIGS / "liu-ice.toml"
