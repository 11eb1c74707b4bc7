"""What a log says of the map as it is, and what it would say with one channel more."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from msgspec import Meta

from lpvobs.io.configuration.config import Config
from lpvobs.kinds import Count
from lpvobs.records import Log

if TYPE_CHECKING:
    from lpvobs.observer.estimate import MapEstimate


@dataclass(frozen=True, kw_only=True)
class Informed:
    """Nodes of the map that get a value from a log, as it is or with one channel more."""

    channel: Annotated[str | None, Meta(description="The further channel; null for the log as it is.")]
    supposed: Annotated[str, Meta(description="What this channel is taken to read.")]
    nodes: Count
    standard_error: Annotated[
        float | None,
        Meta(description="kg/s, median over the nodes that the log as it is informs, or over all if it informs none."),
    ]


def informed_with_each(config: Config, path: Path, log: Log, lacking: Sequence[str]) -> tuple[Informed, ...]:
    """Return what a log says of the map as it is, and with each channel that it lacks; nothing if the engine has no stand-in.

    A stand-in is what the channel would read of the engine as configured. The map behind it is not shown: only its errors count,
    and they come from the noise of the other channels and from what the log's operation tells apart.
    """
    air_path = config.engine_path()
    stand_ins = {name: given for name, given in air_path.stand_ins(log).items() if name in lacking}
    if not stand_ins:
        return ()
    from lpvobs.api.estimate import gain_for  # load the compiler and the solver, which `inspect` needs for this alone
    from lpvobs.observer.estimate import estimate_default
    from lpvobs.observer.parts import StateGain

    stored = gain_for(config, [path], None, "observer")
    gain, grid = StateGain(stored.outputs, stored.gain.L, stored.gain.region), config.grid()
    now = estimate_default(air_path, grid, gain, [log], config.estimate)
    found = [_informed(None, "", now, now)]
    for name, (supposed, values) in stand_ins.items():
        with_it = replace(log, channels={**log.channels, name: values})
        found.append(_informed(name, supposed, estimate_default(air_path, grid, gain, [with_it], config.estimate), now))
    return tuple(found)


def _informed(channel: str | None, supposed: str, found: "MapEstimate", now: "MapEstimate") -> Informed:
    on = found.supported & now.supported if now.supported.any() else found.supported
    error = float(np.median(found.standard_error[on])) if on.any() else None
    return Informed(channel=channel, supposed=supposed, nodes=int(found.supported.sum()), standard_error=error)
