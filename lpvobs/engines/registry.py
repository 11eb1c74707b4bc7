"""The engines that exist, by the name that configurations and gains use."""

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.throttled.lpv import Throttled

AIR_PATHS: dict[str, type[Diesel] | type[Throttled]] = {Diesel.name: Diesel, Throttled.name: Throttled}
