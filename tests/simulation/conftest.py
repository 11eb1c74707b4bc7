"""Twenty seconds of an engine, simulated once for the whole room."""

import pytest
from repository import DIESEL

from lpvobs.io.configuration.config import load_config
from lpvobs.simulation.simulate import simulate

# Idling, pulling away, full load and overrun: enough for every branch of the relations.
SHORT = "time_s,speed_norm_pct,torque_norm_pct,motoring\n" + "\n".join(
    f"{second},{speed},{torque},{motoring}"
    for second, (speed, torque, motoring) in enumerate(
        [(0, 0, 0)] * 4
        + [(8, 25, 0), (25, 60, 0), (45, 100, 0), (60, 100, 0), (66, 30, 0), (62, 0, 1), (50, 0, 1)]
        + [
            (40, 10, 0),
            (42, 45, 0),
            (55, 90, 0),
            (70, 70, 0),
            (70, 5, 0),
            (55, 0, 1),
            (30, 0, 1),
            (10, 3, 0),
            (0, 0, 0),
        ]
    )
)


@pytest.fixture(scope="session")
def config():
    return load_config(DIESEL)[0]


@pytest.fixture(scope="session")
def cycle(tmp_path_factory):
    path = tmp_path_factory.mktemp("cycle") / "short.csv"
    path.write_text(SHORT)
    return str(path)


@pytest.fixture(scope="session")
def clean(config, cycle):
    """Return the drive on which nothing has happened."""
    return simulate(config.engine, config.simulation, cycle)


@pytest.fixture(scope="session")
def truth(clean):
    return clean.truth


@pytest.fixture(scope="session")
def inject(config, cycle):
    """Return a function that repeats the short drive with effects in it."""

    def run(*effects, **options):
        return simulate(config.engine, config.simulation, options.pop("cycle", cycle), effects=effects, **options)

    return run


@pytest.fixture(scope="session")
def minutes(tmp_path_factory):
    """Return a drive of three minutes, the short one over and over: long enough for what comes and goes."""
    rows = SHORT.splitlines()
    repeated = [row.split(",", 1)[1] for row in rows[1:]] * 9
    path = tmp_path_factory.mktemp("minutes") / "minutes.csv"
    path.write_text("\n".join([rows[0], *(f"{second},{row}" for second, row in enumerate(repeated))]))
    return str(path)
