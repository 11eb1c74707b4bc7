"""The part of a log at the configured engine, and the estimate from parts, in one call each."""

from lpvobs.observer.estimate import Point, merged
from lpvobs.observer.parts import inform


def point(air_path, settings, deviation=()):
    """Return the engine where it is linearised, as configured or elsewhere, with a tolerance for every constant of its balances."""
    return Point(air_path, settings.of_engine(air_path.usual_tolerance), dict(deviation))


def informed(air_path, grid, gain, log, settings, deviation=()):
    at = point(air_path, settings, deviation)
    return inform(at.air_path, grid, gain, log, at.settings, at.unknowns)


def solved(air_path, grid, settings, parts, deviation=()):
    """Return the estimate and the solution behind it."""
    return merged(grid, parts, point(air_path, settings, deviation))
