"""The engines that exist, by the name that configurations and gains use."""

from lpvobs.airpath.diesel import Diesel

AIR_PATHS: dict[str, type[Diesel]] = {Diesel.name: Diesel}
