"""What a control unit's description (A2L, ASAM MCD-2 MC) says of a map: units, axes, limits, and how its numbers are rounded.

The file is read by the library pya2l, an extra. Points of an axis stand in the description only where they are fixed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.errors import DataError, UsageError
from lpvobs.records import Array

LARGEST = 1 << 28  # [bytes] of a description; those of large control units have a tenth of it


@dataclass(frozen=True)
class A2lAxis:
    """An axis as described."""

    unit: str
    most: int  # points
    points: Array | None  # (n,) [unit] where they are fixed


@dataclass(frozen=True)
class A2lMap:
    """A map as described."""

    name: str
    unit: str
    lower: float  # [unit], limits of a value
    upper: float
    step: float  # [unit] of one count; 0 for a floating-point number
    zero: float  # [unit] at count zero
    axes: tuple[A2lAxis, A2lAxis]  # X, Y

    def fitted(self, values: Array) -> tuple[Array, int]:
        """Return values as the control unit can hold them, and how many a limit has changed."""
        whole = values if self.step == 0.0 else np.round((values - self.zero) / self.step) * self.step + self.zero
        held = np.clip(whole, self.lower, self.upper)
        return held, int(np.count_nonzero(held != whole))


def read_a2l_map(path: Path, name: str) -> A2lMap:
    """Return the map of this name; raises DataError where the file has none, or is none, UsageError without the library."""
    try:
        from pya2l.parser import A2lParser
    except ImportError:
        raise UsageError(f"--a2l {path}: needs the library pya2l; install it with: pip install 'lpvobs[a2l]'") from None
    try:
        text = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); name an A2L file") from None
    if b"/begin" not in text:  # the library would print words of its own
        raise DataError(f"{path}: is not an A2L file; name the control unit's A2L file")
    if len(text) > LARGEST:
        raise DataError(f"{path}: has {len(text) >> 20} MiB, expected an A2L file of at most {LARGEST >> 20} MiB")
    try:
        with A2lParser() as parser:
            modules = parser.tree_from_a2l(text).PROJECT.MODULE
    except Exception as error:  # whatever the library raises, the file is why
        line = str(error).strip().partition(":")[0]
        at = f" (line {line})" if line.isdecimal() else ""
        raise DataError(f"{path}: is a damaged A2L file{at}; export it again") from None
    for module in modules:
        found = {item.Name.Value: item for item in module.CHARACTERISTIC}
        if name in found:
            return _map(path, module, found[name])
    names = [item.Name.Value for module in modules for item in module.CHARACTERISTIC if item.Type == "MAP"][:8]
    raise DataError(
        f"{path}: has no map '{name}'; the file has the maps: {', '.join(names) or 'none'}; name one with --name"
    )


def _map(path: Path, module: Any, item: Any) -> A2lMap:
    axes = [_axis(module, axis) for axis in item.AXIS_DESCR]
    if item.Type != "MAP" or len(axes) != 2:
        raise DataError(
            f"{path}: characteristic '{item.Name.Value}' is a {item.Type} with {len(axes)} axes; expected a MAP with two "
            "axes; name another one with --name"
        )
    unit, step, zero = _conversion(path, module, item.Conversion.Value)
    layouts = {each.Name.Value: each.FNC_VALUES.DataType.Value for each in module.RECORD_LAYOUT}
    if "FLOAT" in layouts.get(item.Deposit.Value, ""):
        step = 0.0
    return A2lMap(item.Name.Value, unit, item.LowerLimit.Value, item.UpperLimit.Value, step, zero, (axes[0], axes[1]))


def _conversion(path: Path, module: Any, name: str) -> tuple[str, float, float]:
    """Return unit, step and zero of a linear conversion."""
    found = next((each for each in module.COMPU_METHOD if each.Name.Value == name), None)
    if found is None:
        return "", 0.0, 0.0
    unit = found.Unit.Value
    if found.ConversionType == "LINEAR":
        return unit, abs(found.COEFFS_LINEAR.A.Value), found.COEFFS_LINEAR.B.Value
    if found.ConversionType == "RAT_FUNC":  # count = (a p^2 + b p + c) / (d p^2 + e p + f) of a physical value p
        a, b, c, d, e, f = (getattr(found.COEFFS, letter).Value for letter in "ABCDEF")
        if a or d or e or not b:
            raise DataError(
                f"{path}: conversion '{name}' is not linear; expected a map with a linear conversion; choose another map"
            )
        return unit, abs(f / b), -c / b
    return unit, 1.0 if found.ConversionType == "IDENTICAL" else 0.0, 0.0


def _axis(module: Any, axis: Any) -> A2lAxis:
    unit = next((each.Unit.Value for each in module.COMPU_METHOD if each.Name.Value == axis.Conversion.Value), "")
    most, points = axis.MaxAxisPoints.Value, None
    if axis.HasField("FIX_AXIS_PAR_LIST"):
        points = np.array([each.Value for each in axis.FIX_AXIS_PAR_LIST.AxisPtsValue], dtype=float)
    elif axis.HasField("FIX_AXIS_PAR_DIST"):
        given = axis.FIX_AXIS_PAR_DIST
        points = given.Offset.Value + given.Distance.Value * np.arange(given.Numberapo.Value, dtype=float)
    return A2lAxis(unit, most, points)
