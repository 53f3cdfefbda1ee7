"""Tutorials as Jupyter notebooks, made of the same Markdown.

python docs/generate/notebooks.py docs/tutorials/1-from-a-capture-to-poses.md poses.ipynb
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

_BLOCK = re.compile(r"^```(?P<language>sh|python)\n(?P<code>.*?)^```\n?", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[([^\]]+)\]\((?!https?://)[^)]*\)")
_SHELL = "%%bash -e\n"
"""How a code cell begins that IPython hands to bash; it stops at the first command that fails."""


def notebook(markdown: str) -> dict[str, Any]:
    """A page as a notebook (nbformat 4.5): its blocks of Python and shell are code cells.

    Links into the docs keep their words only: a notebook lies elsewhere.
    """
    cells: list[dict[str, Any]] = []

    def add(kind: str, source: str, **more: Any) -> None:
        if source.strip():
            lines = source.strip("\n").splitlines(keepends=True)
            cells.append({"cell_type": kind, "id": f"cell-{len(cells)}", "metadata": {}, "source": lines, **more})

    end = 0
    for block in _BLOCK.finditer(markdown):
        add("markdown", _LINK.sub(r"\1", markdown[end : block.start()]))
        shell = _SHELL if block["language"] == "sh" else ""
        add("code", shell + block["code"], execution_count=None, outputs=[])
        end = block.end()
    add("markdown", _LINK.sub(r"\1", markdown[end:]))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def code_cells(page: dict[str, Any]) -> list[tuple[str, str]]:
    """(`sh` or `python`, code) of every code cell of a notebook, in order."""
    sources = ["".join(cell["source"]) for cell in page["cells"] if cell["cell_type"] == "code"]
    return [("sh", s.removeprefix(_SHELL)) if s.startswith(_SHELL) else ("python", s) for s in sources]


def main() -> None:
    """Write a page as a notebook."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    options.out.write_text(json.dumps(notebook(options.page.read_text()), indent=1) + "\n")


if __name__ == "__main__":
    main()
