"""What makes a site of docs/: pages from outside it, pages that are generated, and links that fit both here and GitHub.

mkdocs calls the functions named `on_...` (https://www.mkdocs.org/user-guide/plugins/#events).
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from modules import reference_nav, reference_pages
from notebooks import notebook
from settings_pages import PAGE, settings_page
from stage_pages import stage_nav, stage_pages

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
_LINK = re.compile(r"(?<=\]\()(?!https?://|#)([^)#\s]+)")


def _outside() -> dict[str, str]:
    """Markdown of the repository that lies outside docs/ -> its page. Folders stand for their README."""
    pages = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
    pages["plugins/README.md"] = "plugins/index.md"
    for readme in sorted(ROOT.glob("plugins/*/README.md")):
        pages[readme.relative_to(ROOT).as_posix()] = f"plugins/{readme.parent.name}.md"
    return pages


def on_config(config: Any) -> None:
    """Put the pages that are not in docs/ into the nav."""
    plugins = [page for page in _outside().values() if page.startswith("plugins/")]
    config.nav += [
        {"Stages": [*stage_nav(), {"Every setting": PAGE}]},
        {"API": reference_nav()},
        {"Plugins": plugins},
        {"Contributing": ["contributing.md", "changelog.md"]},
    ]


def on_files(files: Files, config: Any) -> None:
    """Add the pages that are not in docs/, and every tutorial as a notebook."""
    outside = {page: (ROOT / source).read_text() for source, page in _outside().items()}
    for page, text in {**outside, **stage_pages(), PAGE: settings_page(), **reference_pages()}.items():
        files.append(File.generated(config, page, content=text))
    for tutorial in sorted(TUTORIALS.glob("*.md")):
        content = json.dumps(notebook(tutorial.read_text()), indent=1)
        files.append(File.generated(config, f"tutorials/{tutorial.stem}.ipynb", content=content))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links between files of the repository become links between pages; what has no page is left, and mkdocs warns.

    A tutorial begins with a link to its notebook.
    """
    if page.file.src_uri.startswith("tutorials/"):
        heading, rest = markdown.split("\n", 1)
        name = posixpath.basename(page.file.src_uri).removesuffix(".md")
        markdown = f"{heading}\n\n[This page as a Jupyter notebook]({name}.ipynb)\n{rest}"
    pages = _outside()
    home = {there: source for source, there in pages.items()}
    source = home.get(page.file.src_uri, f"docs/{page.file.src_uri}")

    def to_page(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[0]))
        there = pages.get(target, pages.get(f"{target}/README.md", target.removeprefix("docs/")))
        inside = there != target or source != f"docs/{page.file.src_uri}"
        return posixpath.relpath(there, posixpath.dirname(page.file.src_uri) or ".") if inside else link[0]

    return _LINK.sub(to_page, markdown)
