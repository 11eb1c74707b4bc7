"""What the logs of a throttled engine are tried for."""

from lpvobs.engines.mix_ups import Suspects, below, exchanged

# The intercooler of the LiU-ICE bench holds T_ic within 2 K of T_amb, mostly below it: two thermometers, not two temperatures.
SUSPECTS = Suspects(
    checks=(below("p_ic", "p_im", 0.5), below("T_ic", "T_amb", 0.5, slack=5.0, unit="K")),
    mix_ups=tuple(exchanged(*pair) for pair in (("p_ic", "p_im"), ("p_ic", "p_amb"), ("T_ic", "T_amb"))),
)
