"""Draws the map of a result as a picture of its own: `python tools/picture.py map.h5 > docs/map.svg`."""

import re
import sys

import lpvobs

LOOK = 'xmlns="http://www.w3.org/2000/svg" style="background: white; color: black; font-family: sans-serif"'
"""A picture of its own inherits neither paper nor letters from a page."""


if __name__ == "__main__":
    drawing = re.search(r"<svg.*</svg>", lpvobs.read_map(sys.argv[1])._repr_html_(), flags=re.DOTALL)
    assert drawing is not None
    print(
        re.sub(r"<g class=\"tip\"><title>[^<]*</title>(.*?)</g>", r"\1", drawing[0]).replace("<svg", f"<svg {LOOK}", 1)
    )
