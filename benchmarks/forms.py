"""Formulas for what no catalogue has: what is found, beside PySINDy on the same residuals.

    python benchmarks/forms.py dev     the drives that the search was made with
    python benchmarks/forms.py SEED    others: kinds, sizes and noise drawn by this seed

Readings of a simulated drive are altered by formulas that stand here and share no line with the search; the map comes from two
healthy drives. PySINDy gets the residual of every balance on this map over the flow, the same channels and their lags in units of
their scatter, a library of polynomials of second degree and the lags, and of six thresholds the one that predicts held-out
stretches best. It is no part of the package: `pip install --target build/rival pysindy`. A second argument, 0:3, judges a part.
"""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(Path(__file__).parent)]
sys.path.append(str(ROOT / "build" / "rival"))
from common import RESULTS, machine  # noqa: E402

import lpvobs  # noqa: E402
from lpvobs.api.trace import close  # noqa: E402
from lpvobs.io.logs.parquet import channel_units, write_log  # noqa: E402
from lpvobs.records import Array  # noqa: E402

FOLDER = ROOT / "build" / "forms"
CONFIG, ROAD = ROOT / "configs" / "diesel.toml", ROOT / "configs" / "effects" / "road.toml"
HEALTHY = (("etc_part1", 11), ("ftp75", 12))
RATE = 20.0
THRESHOLDS = np.geomspace(0.01, 0.3, 6)
MOST_TERMS = 3
"""Of a formula that a person reads, for both."""
LEAST = 0.05
"""Share of the residual's power on held-out stretches that PySINDy must explain to claim something; below, it is silent."""

Channels = dict[str, Array]


@dataclass(frozen=True)
class Kind:
    """One cause: what it alters, the signals that a right formula names, and the range of its size."""

    target: str
    signals: tuple[str, ...]
    low: float
    high: float
    alter: Callable[[Channels, float], Array]


def calm(x: Array, width: int = 41) -> Array:
    return np.convolve(np.pad(x, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def behind(x: Array, tau: float) -> Array:
    """Return the state of a first-order lag at RATE, by Euler's forward rule."""
    out = np.empty_like(x)
    state = x[0]
    for k, value in enumerate(x):
        out[k] = state
        state += (value - state) / (tau * RATE)
    return out


DEV = {
    "housing follows the exhaust": Kind(
        "W_maf", ("T_em",), 5e-4, 5e-4,
        lambda c, x: c["W_maf"] * (1 + x * (behind(c["T_em"], 40.0) - 550.0)),
    ),
    "vane reads too far open": Kind("u_vgt", (), 4.0, 4.0, lambda c, x: c["u_vgt"] + x),
    "barometer": Kind("p_amb", (), 1500.0, 1500.0, lambda c, x: c["p_amb"] + x),
    "exhaust pressure follows the boost": Kind(
        "p_em", ("p_im",), 0.08, 0.08,
        lambda c, x: c["p_em"] + x * (calm(c["p_im"]) - 1e5),
    ),
    "turbine speed drifts": Kind("omega_t", ("time",), 4e-5, 4e-5, lambda c, x: c["omega_t"] * (1 + x * c["time"])),
    "reading follows the boost": Kind(
        "W_maf", ("p_im",), 6e-7, 6e-7,
        lambda c, x: c["W_maf"] * (1 + x * (calm(c["p_im"]) - 1.1e5)),
    ),
    "nothing": Kind("", (), 0.0, 0.0, lambda c, x: c["W_maf"]),
}  # fmt: skip
FRESH = {
    "housing follows the charge": Kind(
        "W_maf", ("T_im",), 2e-3, 4e-3,
        lambda c, x: c["W_maf"] * (1 + x * (behind(c["T_im"], 60.0) - 310.0)),
    ),
    "reading follows speed": Kind("W_maf", ("n_e",), 4e-5, 8e-5, lambda c, x: c["W_maf"] * (1 + x * (calm(c["n_e"]) - 1500.0))),
    "air temperature reads high": Kind("T_amb", (), 5.0, 10.0, lambda c, x: c["T_amb"] + x),
    "exhaust temperature by load": Kind("T_em", ("u_delta",), 1.0, 2.5, lambda c, x: c["T_em"] + x * calm(c["u_delta"])),
    "boost sensor warms up": Kind(
        "p_im", ("T_coolant",), 50.0, 120.0,
        lambda c, x: c["p_im"] + x * (behind(c["T_coolant"], 30.0) - 330.0),
    ),
    "turbine speed by flow": Kind(
        "omega_t", ("W_maf",), 0.2, 0.5,
        lambda c, x: c["omega_t"] * (1 + x * (calm(c["W_maf"]) - 0.03)),
    ),
    "nothing": Kind("", (), 0.0, 0.0, lambda c, x: c["W_maf"]),
}  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """`found`, `honest` or `wrong`, and what was said."""

    verdict: str
    said: str


def altered(kind: Kind, size: float, base: Path, path: Path) -> None:
    table, units = pq.read_table(base), channel_units(base)
    channels = {
        name: table[name].to_numpy().astype(float) for name in table.column_names if not name.startswith("ref_")
    }
    if kind.target:
        channels |= {kind.target: kind.alter(channels, size)}
    write_log(path, channels, {name: units[name] for name in channels})


def ours(kind: Kind, effects: list[Mapping[str, object]], verdict: str) -> Judged:
    """Judge a trace: a formula is found if it names the reading that is off, and nothing but the signals that it follows."""
    said = "; ".join(
        str(e.get("formula", e["id"])) + "".join(f" or {other}" for other in e["indistinguishable"]) for e in effects
    )
    if not effects:
        return Judged("honest", verdict)
    alike = [e["id"], *effects[0]["indistinguishable"]] if (e := effects[0]) else []
    right = len(effects) == 1 and any(_right(kind, str(id_)) for id_ in alike[:3])
    return Judged("found" if right else "wrong", said)


def _right(kind: Kind, id_: str) -> bool:
    target, _, product = id_.removeprefix("form:").partition(" ~ ")
    return bool(kind.target) and target == kind.target and all(signal in product for signal in kind.signals)


def rival(kind: Kind, closed: object) -> Judged:
    """Judge what PySINDy makes of the residual of every balance: whether any is a short formula of the right signals."""
    import pysindy  # noqa: PLC0415 only this benchmark has it

    before = closed.refinement.before
    problem, left = before.problem, before.raw[0] / np.maximum(calm(before.problem.along("W_maf"), 11), 2e-3)
    names, columns = _signals(problem)
    train = problem.block // problem.per_coarse % 4 != 0
    found: list[Judged] = []
    for balance, y in zip(problem.model.balances, left / left.std(1, keepdims=True), strict=True):
        best = (1.0 - LEAST, None)
        for threshold in THRESHOLDS:
            half = len(names) // 2
            library = pysindy.GeneralizedLibrary(
                [pysindy.PolynomialLibrary(degree=2), pysindy.PolynomialLibrary(degree=1, include_bias=False)],
                inputs_per_library=[range(half), range(half, len(names))],
            )
            model = pysindy.SINDy(optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-3), feature_library=library)
            model.fit(columns[train], t=0.1, x_dot=y[train, None], feature_names=names)
            error = float(np.mean((y - model.predict(columns)[:, 0])[~train] ** 2) / np.mean(y[~train] ** 2))
            best = min(best, (error, model), key=lambda item: item[0])
        if best[1] is None:
            continue
        terms = [best[1].get_feature_names()[i] for i in np.flatnonzero(best[1].coefficients()[0])]
        wanted = (kind.target, *kind.signals) if kind.target else ("?",)
        right = len(terms) <= MOST_TERMS and all(any(signal in term for term in terms) for signal in wanted)
        found.append(Judged("found" if right else "wrong", f"{balance}: {len(terms)} terms ({', '.join(terms[:3])})"))
    if not found:
        return Judged("honest", "no balance better on held-out stretches")
    return next((each for each in found if each.verdict == "found"), found[0])


def _signals(problem: object) -> tuple[list[str], Array]:
    """Return channels, rates and lags at the places of a problem in units of their scatter, shape (K, m)."""
    recorded = {**problem.inputs(), "W_maf": problem.along("W_maf"), **problem.auxiliary, "time": problem.time}
    even = {name: calm(x, 11) for name, x in recorded.items() if np.std(x) > 1e-9 * abs(np.mean(x))}
    even |= {f"lag({name})": _lagged(x, problem.time, 40.0) for name, x in even.items()}
    return list(even), np.stack([(x - x.mean()) / max(x.std(), 1e-12) for x in even.values()], axis=1)


def _lagged(x: Array, t: Array, tau: float) -> Array:
    out = x.copy()
    for k in range(1, x.size):
        out[k] = out[k - 1] + (1.0 - np.exp(-(t[k] - t[k - 1]) / tau)) * (x[k] - out[k - 1])
    return out


def main() -> None:
    which = sys.argv[1]
    FOLDER.mkdir(parents=True, exist_ok=True)
    map_ = FOLDER / "map.h5"
    for cycle, seed in HEALTHY:
        path = FOLDER / f"healthy_{cycle}.parquet"
        if not path.exists():
            lpvobs.simulate(CONFIG, cycle, path, effects=ROAD, rate=RATE, seed=seed)
    if not map_.exists():
        lpvobs.estimate(CONFIG, [FOLDER / f"healthy_{cycle}.parquet" for cycle, _ in HEALTHY], map_)
    rng = np.random.default_rng(0 if which == "dev" else int(which))
    seed = 21 if which == "dev" else int(rng.integers(100, 2**31))
    base = FOLDER / f"ftp75_cold_{seed}.parquet"
    if not base.exists():
        lpvobs.simulate(CONFIG, "ftp75_cold", base, effects=ROAD, rate=RATE, seed=seed)
    page = RESULTS / "forms.md"
    first, last = (int(end) for end in (sys.argv[2] if len(sys.argv) > 2 else "0:99").split(":"))
    for number, (name, kind) in enumerate((DEV if which == "dev" else FRESH).items()):
        size = float(rng.uniform(kind.low, kind.high)) * (1.0 if which == "dev" else float(rng.choice([-1.0, 1.0])))
        if not first <= number < last:
            continue
        path, begin = FOLDER / f"altered_{which}_{number}.parquet", time.process_time()
        altered(kind, size, base, path)
        closed = close(map_, [path], [], None, lambda _: None)
        shown = closed.refinement.trace.as_json(refined=True)
        own, seconds = ours(kind, shown["effects"], shown["verdict"]), time.process_time() - begin
        other = rival(kind, closed)
        ratio = shown["error"]["ratio"]
        said = f"{own.verdict}: {own.said} | {ratio:.2f} | {seconds:.0f} | {other.verdict}: {other.said}"
        row = f"| {which} | {name} | {size:.3g} | {said} |\n"
        with page.open("a", encoding="utf-8") as file:
            file.write(row)
        print(row, end="", flush=True)
    print(machine())


if __name__ == "__main__":
    main()
