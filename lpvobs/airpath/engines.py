"""The engines that exist, by the name that configurations and gains use."""

from lpvobs.airpath.base import AirPath
from lpvobs.airpath.diesel import Diesel

AIR_PATHS: dict[str, type[AirPath]] = {Diesel.name: Diesel}
