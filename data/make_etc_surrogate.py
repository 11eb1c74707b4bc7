"""Writes cycles/etc_surrogate.csv, the ETC surrogate; run it as `python data/make_etc_surrogate.py`.

The European Transient Cycle's own table is not reproduced here. The surrogate has its outline: 1800 s in three parts of 600
s, town, country road, motorway. It is made of short trips: idling, pulling through the gears at a torque that differs from
pull to pull, a change of gear without fuel, cruising at changing torque, overrun to the next stop. All that varies comes from
low-discrepancy sequences (van der Corput), so torque and speed are spread evenly and every run writes the same bytes.

Speed is normalised to 0 at idle and 100 at the reference speed of the ETC, torque to the full load at that speed. The highest
speed is 68 %, which is 3100 rpm for the engine in configs/diesel.toml.
"""

from collections.abc import Iterator
from pathlib import Path

Row = tuple[float, float, bool]  # speed %, torque %, motoring
PART = 600  # s
TOP = 68.0  # %, highest speed
TARGET = Path(__file__).resolve().parent / "cycles" / "etc_surrogate.csv"


def spread(index: int, base: int) -> float:
    """Return number `index` of the van der Corput sequence: the digits of the index mirrored behind the point."""
    value, scale = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        scale /= base
        value += digit * scale
    return value


def torque_level(pull: int) -> float:
    """Return the torque [%] of a pull; the top of the range is full load."""
    return min(100.0, 10.0 + 96.0 * spread(pull, 2))


def straight(seconds: int, start: float, end: float, torque: float, motoring: bool = False) -> Iterator[Row]:
    """Yield a straight change of speed at one torque, the end included."""
    for second in range(1, seconds + 1):
        yield start + (end - start) * second / seconds, torque, motoring


def idle(seconds: int) -> Iterator[Row]:
    """Yield idling."""
    for _ in range(seconds):
        yield 0.0, 0.0, False


def pulls(first: int, count: int, low: float, high: float) -> Iterator[Row]:
    """Yield pulls through gears, numbered from `first`, each from about `low` to about `high` and followed by a change of gear."""
    for number in range(first, first + count):
        bottom = low * (0.6 + 0.8 * spread(number, 3))
        top = high * (0.75 + 0.25 * spread(number, 5))
        level = torque_level(number)
        seconds = round(9.0 - 0.04 * level)
        for second, row in enumerate(straight(seconds, bottom, top, level)):
            yield row[0], min(100.0, level + 8.0 * (spread(7 * number + second, 2) - 0.5)), False
        yield 0.8 * top, 0.0, True


def cruise(number: int, seconds: int, low: float, high: float, heaviest: float) -> Iterator[Row]:
    """Yield driving along: speed wanders between the limits, torque changes every three seconds."""
    for second in range(seconds):
        step = 16 * number + second // 3
        blend = second % 3 / 3.0
        wander = (1.0 - blend) * spread(step, 3) + blend * spread(step + 1, 3)
        yield low + (high - low) * wander, heaviest * spread(step, 2), False


def town(trips: int) -> Iterator[Row]:
    """Yield short trips with stops: every pull from low speed, so the whole plane is seen."""
    for trip in range(trips):
        yield from idle(4 + round(4 * spread(trip, 2)))
        yield from pulls(1 + 4 * trip, 4, low=6.0, high=TOP)
        low = 4.0 + 40.0 * spread(trip, 3)
        yield from cruise(trip, 15, low, low + 20.0, heaviest=90.0)
        yield from straight(6, low + 10.0, 0.0, 0.0, motoring=True)


def country_road(trips: int) -> Iterator[Row]:
    """Yield a steep start and longer stretches at middle speed."""
    for trip in range(trips):
        yield from idle(3)
        yield from pulls(64 + 5 * trip, 5, low=12.0, high=TOP)
        yield from cruise(64 + trip, 45, 30.0, 60.0, heaviest=100.0)
        yield from straight(8, 45.0, 0.0, 0.0, motoring=True)


def motorway(stretches: int) -> Iterator[Row]:
    """Yield long stretches at higher speed, parted by overrun and a pull."""
    for stretch in range(stretches):
        yield from cruise(128 + stretch, 60, 42.0, 64.0, heaviest=85.0)
        yield from straight(4, 50.0, 36.0, 0.0, motoring=True)
        yield from pulls(128 + 2 * stretch, 2, low=36.0, high=TOP)


def cut(part: Iterator[Row], standing: bool) -> list[Row]:
    """Return the first 600 s of a part; `standing` ends it with overrun and 4 s of idling."""
    rows = [row for _, row in zip(range(PART), part, strict=False)]
    if len(rows) < PART:
        raise ValueError(f"a part has {len(rows)} rows, expected {PART}")
    if standing:
        rows[-10:] = [*straight(6, rows[-11][0], 0.0, 0.0, motoring=True), *idle(4)]
    return rows


def table() -> str:
    """Return the CSV text, a row per second from 0 to 1800."""
    rows = [(0.0, 0.0, False), *cut(town(13), True), *cut(country_road(7), True), *cut(motorway(8), True)]
    lines = [
        f"{second},{speed:.1f},{torque:.1f},{int(motoring)}" for second, (speed, torque, motoring) in enumerate(rows)
    ]
    return "\n".join(["time_s,speed_norm_pct,torque_norm_pct,motoring", *lines, ""])


if __name__ == "__main__":
    TARGET.write_text(table(), encoding="utf-8", newline="\n")
