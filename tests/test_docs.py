"""The docs' code runs: every cell of a tutorial's notebook, in order, in an empty folder, as a reader would type it."""

from __future__ import annotations

import re
import runpy
import socket
from pathlib import Path

import pytest
from command_line import shell

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```", re.MULTILINE | re.DOTALL)
MEASURE = runpy.run_path(str(ROOT / "docs" / "generate" / "measure.py"))
NOTEBOOKS = runpy.run_path(str(ROOT / "docs" / "generate" / "notebooks.py"))
PORT = "8799"
"""Where the page's cluster answers."""

LINK = re.compile(r"\]\((?!https?://)([^)#]+)")


def free_port() -> int:
    with socket.socket() as asked:
        asked.bind(("127.0.0.1", 0))
        return asked.getsockname()[1]


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_every_block_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    blocks = NOTEBOOKS["code_cells"](NOTEBOOKS["notebook"](page.read_text()))
    assert blocks
    port = str(free_port())  # two suites may run on one machine
    for language, text in blocks:
        code = text.replace(PORT, port)
        if language == "python":
            exec(compile(code, str(page), "exec"), scope)
        else:
            shell(code, tmp_path)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_notebook_has_all_of_its_page(page):
    text = page.read_text()
    made = NOTEBOOKS["notebook"](text)
    assert NOTEBOOKS["code_cells"](made) == [(language, code.rstrip("\n")) for language, code in BLOCK.findall(text)]
    said = "".join("".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == "markdown")
    assert all(heading in said for heading in re.findall(r"^#+ .*$", BLOCK.sub("", text), re.MULTILINE))
    assert not LINK.search(said) and len({cell["id"] for cell in made["cells"]}) == len(made["cells"])


@pytest.mark.parametrize("page", [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")], ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    missing = [target for target in LINK.findall(page.read_text()) if not (page.parent / target).exists()]
    assert not missing


def test_the_readme_has_one_picture_one_film_and_two_commands():
    text = (ROOT / "README.md").read_text()
    assert [Path(picture).suffix for picture in re.findall(r"!\[.*?\]\((.*?)\)", text)] == [".jpg", ".gif"]
    assert [code.strip() for language, code in BLOCK.findall(text) if language == "sh"][:2] == [
        "pip install . && toolkit ablate",
        "pip install '.[test]' && pytest",
    ]


def test_tables_are_put_under_the_commands_that_print_them():
    page = r"""# One

    toolkit dataset build captures    # --set track=d435
    python experiments/benchmarks/some.py captures

Words.

| old |
| --- |

Another table:

| kept |

## Two

    toolkit ablate quick \
      --scenes 2

| old |
"""
    asked = []

    def measure(command):
        asked.append(command)
        return "| new |\n"

    filled = MEASURE["fill"](page, measure)
    assert asked == [
        "toolkit dataset build captures",
        "python experiments/benchmarks/some.py captures",
        "toolkit ablate quick --scenes 2",
    ]
    assert filled == page.replace("| old |\n| --- |\n", "| new |\n").replace("| old |\n", "| new |\n")
    assert MEASURE["fill"](page, measure, "Two") == page[: page.index("## Two")] + filled[filled.index("## Two") :]


def test_every_command_above_a_table_of_results_is_found():
    asked = []
    MEASURE["fill"]((ROOT / "docs" / "results.md").read_text(), lambda command: asked.append(command) or "| |\n")
    tables = re.findall(r"^\| -+ \|", (ROOT / "docs" / "results.md").read_text(), re.MULTILINE)
    assert len([command for command in asked if not command.startswith("toolkit dataset")]) == len(tables) > 10
