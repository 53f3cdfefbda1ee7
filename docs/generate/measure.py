"""Run the commands on a page of the docs and put the tables they print under them.

python docs/generate/measure.py docs/results.md
python docs/generate/measure.py docs/results.md --only Lookalikes    # the sections whose headings contain it

An indented block of commands owns the first table after it in its section; the block's last command prints it. Run it
from the repository's root. Runs lie under runs/docs and are gone on with when they are there; at first a page takes
hours.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

from toolkit.results.folder import ROWS, TABLE

RUNS = Path("runs") / "docs"
_OWNED = re.compile(
    r"(?P<commands>(?:^    (?:toolkit|python) (?:.*\\\n)*.*\n)+)"
    r"(?P<between>(?:(?!#|    |\|).*\n)*)"
    r"(?P<table>(?:^\|.*\n)+)",
    re.MULTILINE,
)


def fill(text: str, measure: Callable[[str], str], only: str = "") -> str:
    """The page with the table under every block of commands replaced by what `measure` returns for its last command."""

    def renew(owned: re.Match[str]) -> str:
        headings = re.findall(r"^#+ (.*)$", text[: owned.start()], re.MULTILINE)
        if only and not any(only in heading for heading in headings[-1:]):
            return owned[0]
        *before, last = [line.split("  #")[0].strip() for line in _whole_lines(owned["commands"])]
        for command in before:
            measure(command)
        return owned["commands"] + owned["between"] + measure(last)

    return _OWNED.sub(renew, text)


def _whole_lines(commands: str) -> list[str]:
    return re.sub(r"\s*\\\n\s*", " ", commands).splitlines()


def measure(command: str) -> str:
    """Run a command as a reader would; its first table, which a run leaves in summary.md and a benchmark prints."""
    words = shlex.split(command)
    print(command, flush=True)
    if words[:3] == ["toolkit", "dataset", "build"]:
        return "" if Path(words[3]).exists() else _run(command)
    if words[0] == "python":
        return _first_table(_run(command))
    run = RUNS / re.sub(r"[^\w.=-]+", "-", " ".join(words[1:]).replace("/", "-"))
    _run(f"{command} --out {run}{' --resume' if (run / ROWS).exists() else ''}")
    return _first_table((run / TABLE).read_text())


def _run(command: str) -> str:
    done = subprocess.run(command, shell=True, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"'{command}' failed with code {done.returncode}")
    return done.stdout


def _first_table(text: str) -> str:
    found = re.search(r"(?:^\|.*(?:\n|\Z))+", text, re.MULTILINE)
    if found is None:
        raise SystemExit("the command printed no table")
    return found[0].rstrip("\n") + "\n"


def main() -> None:
    """Renew a page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("--only", default="", help="part of a section's heading")
    options = parser.parse_args()
    options.page.write_text(fill(options.page.read_text(), measure, options.only))


if __name__ == "__main__":
    main()
