"""The engines that exist, by the name that configurations and gains use."""

from lpvobs.airpath.diesel import Diesel
from lpvobs.airpath.throttled import Throttled

AIR_PATHS: dict[str, type[Diesel] | type[Throttled]] = {Diesel.name: Diesel, Throttled.name: Throttled}
