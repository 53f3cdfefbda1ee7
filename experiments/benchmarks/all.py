"""Every figure of docs/performance.md in one run, beside its peers; two commits' runs can be compared.

python experiments/benchmarks/all.py --out performance
python experiments/benchmarks/all.py --out performance --against before/performance.json

Writes OUT/performance.md, the tables as the benchmarks print them, and OUT/performance.json, the same by benchmark,
line and column. With `--against`, every number stands beside the one of the other run and their ratio, which says
something only where both ran on the same machine. Takes a quarter of an hour.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

HERE = Path(__file__).parent
_TOOLKIT = "import sys; sys.argv[0] = 'toolkit'; from toolkit.cli.commands import main; main()"
BENCHMARKS = {
    "waiting": ["captures", "--scenes", "6"],
    "kernels": ["captures/000001"],
    "pnp": ["--problems", "160", "--seed", "0"],
    "loftr": ["--crop", "320", "--candidates", "8", "--objects", "3", "--repeats", "3"],
    "motion": ["--pairs", "100", "--seed", "0"],
    "planners": ["--repeats", "1", "--most", "12"],
    "rendering": ["--scenes", "2"],
    "overhead": ["quick", "--scenes", "4"],
} | ({"gpu": ["captures", "--scenes", "3"]} if torch.cuda.is_available() else {})
"""Arguments by name; OUT/captures are built first. A GPU is measured where there is one."""

Figures = dict[str, dict[str, dict[str, str]]]
"""Cells by benchmark, line and column."""

_NUMBER = re.compile(r"^-?\d+(\.\d+)?%?$")


def tables(markdown: str) -> Iterator[tuple[str, dict[str, str]]]:
    """The lines of all tables in a text: what stands before their first number, and their cells by column."""
    header: list[str] = []
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")] if line.startswith("|") else []
        if not cells:
            header = []
        elif not header:
            header = cells
        elif set("".join(cells)) - set("-: "):
            words = [cell for cell in cells if not _NUMBER.match(cell.split(" ")[0])]
            yield ", ".join(words) or cells[0], dict(zip(header, cells, strict=False))


def comparison(now: Figures, before: Figures) -> str:
    """A Markdown table of every number that both runs have, with their ratio."""
    lines = ["| benchmark | line | column | before | now | ratio |", "| --- | --- | --- | --- | --- | --- |"]
    for benchmark, rows in now.items():
        for line, cells in rows.items():
            for column, cell in cells.items():
                other = before.get(benchmark, {}).get(line, {}).get(column, "")
                new, old = (text.split(" ")[0].rstrip("%") for text in (cell, other))
                if _NUMBER.match(new or "-") and _NUMBER.match(old or "-") and float(old):
                    lines.append(
                        f"| {benchmark} | {line} | {column} | {other} | {cell} | {float(new) / float(old):.2f} |"
                    )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run all benchmarks, and write what they print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("performance"))
    parser.add_argument("--only", action="append", choices=BENCHMARKS, help="only these; all when left out")
    parser.add_argument("--against", type=Path, help="performance.json of another run")
    options = parser.parse_args()

    options.out.mkdir(parents=True, exist_ok=True)
    if not (options.out / "captures").exists():
        build = ["dataset", "build", "captures", "--scenes", "6", "--seed", "0"]
        subprocess.run([sys.executable, "-c", _TOOLKIT, *build], cwd=options.out, check=True)
    text, figures = [f"{platform.platform()}, Python {platform.python_version()}\n"], Figures()
    for name in options.only or BENCHMARKS:
        started = time.monotonic()
        command = [sys.executable, str(HERE / f"{name}.py"), *BENCHMARKS[name]]
        done = subprocess.run(command, cwd=options.out, stdout=subprocess.PIPE, text=True, check=True)
        print(f"{name}: {time.monotonic() - started:.0f} s", file=sys.stderr)
        text += [
            f"## {name}\n\n    python experiments/benchmarks/{name}.py {' '.join(BENCHMARKS[name])}\n",
            done.stdout,
        ]
        figures[name] = dict(tables(done.stdout))
    if options.against is not None:
        before: dict[str, Any] = json.loads(options.against.read_text())
        text += [f"## Against {options.against}\n", comparison(figures, before["figures"])]
    (options.out / "performance.md").write_text("\n".join(text))
    written = {"machine": text[0].strip(), "figures": figures}
    (options.out / "performance.json").write_text(json.dumps(written, indent=1) + "\n")
    print("\n".join(text))


if __name__ == "__main__":
    main()
