"""Runs the example notebook and writes it with its outputs as Markdown: `python tools/notebook.py NOTEBOOK > PAGE`."""

import base64
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

CONFIG = Path(__file__).parents[1] / "configs" / "diesel.toml"
PATIENCE = 600
"""[s] for a cell: the first one may have to compile kernels."""


def executed(notebook: Path) -> Any:
    """Return a notebook with its outputs; it runs in a folder of its own, with the shipped configuration in it."""
    found = nbformat.read(notebook, as_version=4)
    with TemporaryDirectory() as folder:
        shutil.copy(CONFIG, folder)
        return NotebookClient(found, timeout=PATIENCE, resources={"metadata": {"path": folder}}).execute()


def markdown(notebook: Any) -> Iterator[str]:
    """Yield the cells as Markdown, each output behind its cell."""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            yield cell.source
            continue
        yield f"```python\n{cell.source}\n```"
        for output in cell.outputs:
            data = output.get("data", {})
            if "text/html" in data:
                yield "".join(line.strip() for line in data["text/html"].splitlines())
            elif "image/png" in data:
                yield f"![figure](data:image/png;base64,{base64.b64encode(base64.b64decode(data['image/png'])).decode()})"
            elif text := data.get("text/plain") or output.get("text"):
                yield f"```text\n{text.rstrip()}\n```"


if __name__ == "__main__":
    print("\n\n".join(markdown(executed(Path(sys.argv[1])))))
