"""CDFX (ASAM CDF 2.0) and INCA's label lists for further calibration tools; maps in the units of control units."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.io.calibration.dcm import DcmMap
from lpvobs.io.logs.units import canonical, convert
from lpvobs.io.results.surfaces import LEFT_OUT, NONE, Surface
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Array

FACTOR, PERCENT, PER_STROKE = "factor", "%", "mg/cycle"
DOCTYPE = '<!DOCTYPE MSRSW PUBLIC "-//ASAM//DTD CALIBRATION DATA FORMAT:V2.0.0:LAI:IAI:XML:CDF200.XSD//EN" "cdf_v2.0.0.sl.dtd">'


def in_unit(surface: Surface, unit: str, reading: Array | None, cylinders: float) -> Surface:
    """Return a map [kg/s] in another unit; nodes where that cannot be said are left out.

    `%` is a share of the mean reading around the node, shape (p2, p1) [kg/s], and `factor` what to multiply a reading with:
    1 - error / reading. `mg/stroke` is air per cylinder and cycle at the speed of the node, of an engine with so many cylinders.
    """
    share = np.full(surface.values.shape, np.nan) if reading is None else np.where(reading > 0.0, reading, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        if unit in (FACTOR, PERCENT):
            by, name = (-1.0 / share, "1") if unit == FACTOR else (100.0 / share, "%")
        elif canonical(unit) == PER_STROKE:
            by, name = np.broadcast_to(1.2e8 / (cylinders * surface.x.nodes[:, None]), surface.values.shape), unit
        else:
            try:
                by, name = np.full(surface.values.shape, float(convert(np.ones(1), surface.unit, unit)[0])), unit
            except ValueError:
                raise UsageError(
                    f"--unit {unit}: is not a unit of flow; expected for example kg/h, g/s, mg/stroke or %"
                ) from None
        values = by * surface.values + (1.0 if unit == FACTOR else 0.0)
    known = np.isfinite(by) | (surface.origin == NONE)
    scale = np.where(np.isfinite(by), by, 0.0).ravel()
    return replace(
        surface,
        values=np.where(known, values, np.nan),
        standard_error=np.where(known, np.abs(by) * surface.standard_error, np.nan),
        covariance=surface.covariance * np.outer(scale, scale),
        origin=np.where(known, surface.origin, LEFT_OUT).astype(np.int8),
        unit=name,
    )


def write_cdfx(path: Path, item: DcmMap, digits: int, comments: Sequence[str]) -> None:
    """Write a map as CDF 2.0: a value group for every Y, with the values along X; both axes are the map's own."""
    head = [("SHORT-NAME", item.name), ("LONG-NAME", item.long_name), ("CATEGORY", "MAP")]
    values = [
        ("VG", [("LABEL", f"{node:.{digits}g}"), *_numbers(row, digits)])
        for node, row in zip(item.y, item.values, strict=True)
    ]
    axes = [
        (
            "SW-AXIS-CONT",
            [("CATEGORY", "STD_AXIS"), ("UNIT-DISPLAY-NAME", unit), ("SW-VALUES-PHYS", _numbers(nodes, digits))],
        )
        for unit, nodes in ((item.unit_x, item.x), (item.unit_y, item.y))
    ]
    own = [("UNIT-DISPLAY-NAME", item.unit), ("SW-VALUES-PHYS", values)]
    instance = ("SW-INSTANCE", [*head, ("SW-VALUE-CONT", own), ("SW-AXIS-CONTS", axes)])
    tree = ("SW-INSTANCE-TREE", [("SHORT-NAME", "calibration"), ("CATEGORY", "NO_VCD"), instance])
    system = ("SW-SYSTEM", [("SHORT-NAME", "lpvobs"), ("SW-INSTANCE-SPEC", [tree])])
    said = ("INTRODUCTION", [("P", line) for line in comments])
    root = ElementTree.Element("MSRSW", {"CREATOR": "lpvobs"})
    _add(root, [("SHORT-NAME", item.name), said, ("CATEGORY", "CDF20"), ("SW-SYSTEMS", [system])])
    ElementTree.indent(root)
    body = ElementTree.tostring(root, encoding="unicode")
    with replacing(path) as temporary:
        temporary.write_text(f'<?xml version="1.0" encoding="utf-8"?>\n{DOCTYPE}\n{body}\n', encoding="utf-8")


def _add(parent: ElementTree.Element, contents: Sequence[Any]) -> None:
    """Add elements, each a tag with its text, or with a list of the elements in it."""
    for tag, inside in contents:
        element = ElementTree.SubElement(parent, tag)
        if isinstance(inside, str):
            element.text = "".join(letter for letter in inside if letter.isprintable())
        else:
            _add(element, inside)


def _numbers(values: Array, digits: int) -> list[tuple[str, str]]:
    return [("V", f"{value:.{digits}g}") for value in values]


def write_lab(path: Path, parameters: Sequence[str], channels: Sequence[str]) -> None:
    """Write a label list of INCA: parameters to calibrate, and channels that a log needs, to measure."""
    lines = ["[SETTINGS]", "Version;V1.1", "", "[RAMCELL]", *channels, "", "[LABEL]", *parameters, ""]
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines), encoding="latin-1", errors="replace", newline="\r\n")
