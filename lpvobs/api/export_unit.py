"""`export --format c99` and `fmu`: the observer for a control unit, its gain proven again in the numbers of the target."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from lpvobs.api import export, verify
from lpvobs.api.files import File, as_path, expect_one_of, write_text, writing
from lpvobs.api.known_engine import known_engine, stored_config
from lpvobs.engines.base import AirPath
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.files import Change
from lpvobs.io.configuration.config import Config
from lpvobs.io.control_unit.sources import MEMORY, Unit, sources, write_fmu
from lpvobs.io.results import engines, gains, hdf, results, surfaces
from lpvobs.io.safety.atomic import file_digest, replacing
from lpvobs.kinds import Count, Output
from lpvobs.maps.quadratic import ESTIMATED
from lpvobs.records import Array

FORMATS = ("c99", "fmu")
MAP_GAINS = ("falling", "constant")
STARTS = ("zero", *export.SOURCES)


class ExportedUnit(Output):
    """An observer for a control unit."""

    map_gain: Annotated[str, Meta(extra_json_schema={"enum": MAP_GAINS})]
    # where the map is from: `zero`, or the group of the result
    start: Annotated[str, Meta(extra_json_schema={"enum": STARTS})]
    files: Sequence[str]
    delay: Annotated[float, Meta(description="s, half of the smoothing window")]
    bytes_of_state: Mapping[str, Count]  # static memory of the state, by number format
    smallest_pivot: Mapping[str, float]  # of the certificate, proven again for the gain rounded to each number format


class ExportOutput(Output):
    """A map for calibration tools and what it changes, or an observer for a control unit."""

    out: str
    format: Annotated[str, Meta(extra_json_schema={"enum": (*export.FORMATS, *FORMATS)})]
    values: Annotated[str, Meta(extra_json_schema={"enum": (*export.SOURCES, "zero")})]
    digits: Count
    nodes: Annotated[Mapping[str, Count], Meta(description="By origin.")]
    changes: Sequence[Change] | None
    # nodes with a wider 90 % interval to either side were left out
    widest: Annotated[float | None, Meta(description="kg/s")]
    unit: ExportedUnit | None


def export_unit(
    gain: File,
    out: File,
    file_format: str,
    *,
    result: File | None = None,
    engine: File | None = None,
    map_gain: str = "",
    rate: float = 100.0,
) -> ExportedUnit:
    """Write the certified local observer as C99 sources, or as a unit for co-simulation (FMI 2.0).

    Raises UsageError if the request contradicts itself; DataError if gain or result cannot be used, or do not belong together;
    NotProven if the certificate does not hold for the numbers of the target.

    Parameters
    ----------
    out : path
        The folder of the sources for `c99`, the FMU for `fmu`.
    file_format : str
        `c99` or `fmu`.
    result : path, optional
        Its map is where the observer starts, and its engine, with the corrections of components as tables, the one that the
        observer has; by default zero, and as configured.
    engine : path, optional
        In place of a result: the map starts at zero, with a calibrated engine and its corrections.
    map_gain : str
        `constant`: Gamma of `[published]`; `falling`: it falls with the time that the nodes around have been driven, which is
        proven for a gain whose sensor does not correct the state; by default where that holds.
    rate : float
        [Hz], of the samples at most: so many wait until their window is complete.

    Notes
    -----
    Eq. (26) and (36) by backward Euler on smoothed signals, as `lpvobs.observer.recursion`.
    """
    stored = gains.read_gain(as_path(gain))
    falling = _falls(stored, map_gain)
    expect_one_of("--format", file_format, FORMATS)
    if not 1.0 <= rate <= 10_000.0:
        raise UsageError(f"--rate {rate:g}: expected 1 to 10000 samples a second")
    pivots = {}
    for name, number in (("double", np.float64), ("float", np.float32)):
        rounded = replace(stored, gain=replace(stored.gain, L=stored.gain.L.astype(number).astype(float), bound=None))
        pivots[name] = verify.expect_proven(f"{gain} rounded to {name}", verify.check_again(rounded)).smallest_pivot
    start, calibrated = (None if path is None else as_path(path) for path in (result, engine))
    unit = unit_of(as_path(gain), stored, start, falling, rate, calibrated)
    made = sources(unit)
    if file_format == "c99":
        _write_folder(as_path(out), made)
    else:
        with writing(out, [gain, result, engine]) as target, replacing(target) as temporary:
            write_fmu(temporary, unit, made)
    sizes = {"double": unit.bytes_of_state(8), "float": unit.bytes_of_state(4)}
    return ExportedUnit(
        map_gain=MAP_GAINS[0] if falling else MAP_GAINS[1],
        start=unit.start,
        files=tuple(sorted(made)),
        delay=unit.half_width,
        bytes_of_state=sizes,
        smallest_pivot=pivots,
    )


def _falls(stored: gains.StoredGain, map_gain: str) -> bool:
    """Return whether the map's gain falls; raises UsageError where nothing is proven of that."""
    cascade = not stored.gain.L[:, -1].any()
    expect_one_of("--map-gain", map_gain or MAP_GAINS[0], MAP_GAINS)
    if map_gain == "falling" and not cascade:
        raise UsageError(
            "--map-gain falling: stability is not proven for this observer gain, because its last column is not zero; give "
            "--map-gain constant"
        )
    return cascade if not map_gain else map_gain == "falling"


def unit_of(
    gain: Path, stored: gains.StoredGain, result: Path | None, falling: bool, rate: float, engine: Path | None = None
) -> Unit:
    """Return what the C is made from; raises as `export_unit` does."""
    origin, start, corrections = f"gain {file_digest(gain)}", STARTS[0], dict[str, Array]()
    if result is None:
        config = stored_config(gain, "gain", "make it with `lpvobs synth-gain`")
        air_path = config.engine_path()
        theta, driven = np.zeros((2, *config.grid().shape))
        if engine is not None:
            known, origin = engines.read_engine(engine, air_path), f"{origin}, engine {file_digest(engine)}"
            air_path = air_path.knowing(known.learned.known) if known.learned else air_path.deviating(known.deviation)
            corrections = known.corrections()
        elif air_path.learns:
            raise UsageError(
                f"an engine of kind {air_path.name} needs curves learned from healthy logs; name a RESULT.h5 or an --engine "
                "that contains them"
            )
    elif engine is not None:
        raise UsageError(f"--engine {engine}: {result} already contains an engine; drop --engine or the result")
    else:
        config, air_path, corrections = _of_map(result)
        surface = surfaces.read_surface(result)
        theta, driven, start = surface.values, MEMORY * (surface.origin == ESTIMATED), surface.source
        origin += f", result {file_digest(result)}"
    gains.expect_engine(gain, stored, config)
    return Unit(
        kind=config.kind,
        air_path=air_path,
        corrections=corrections,
        channels=config.policies.limited(air_path.channels),
        grid=config.grid(),
        stored=stored,
        theta=np.nan_to_num(theta).reshape(-1),
        driven=driven.reshape(-1),
        half_width=config.estimate.smoothing,
        gap=config.policies.gap_limit,
        gamma=config.published.gamma,
        rate=rate,
        falling=falling,
        origin=origin,
        start=start,
    )


def _of_map(result: Path) -> tuple[Config, AirPath, dict[str, Array]]:
    """Return configuration and engine of a map, and the values of the engine's corrections."""
    found = results.read_result(result)
    engine = known_engine(found)
    if found.engine is None or engine.air_path.learns:
        return engine.config, engine.air_path, {}
    told = dict(zip(found.engine.constants, found.engine.deviation.tolist(), strict=True))
    air_path = engine.air_path.deviating(engine.air_path.as_certified(told))
    with hdf.reading(result, results.KIND, results.REMEDY) as file:
        return engine.config, air_path, engines.read_corrections(file, engine.air_path)


def _write_folder(folder: Path, made: Mapping[str, str]) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be created ({error.strerror}); name another folder with --out") from None
    for name, text in made.items():
        write_text(folder / name, text)
