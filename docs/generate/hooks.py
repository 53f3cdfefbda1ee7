"""What makes a site of docs/: pages from outside it, pages that are generated, and links that fit both here and GitHub.

mkdocs calls the functions named `on_...` (https://www.mkdocs.org/user-guide/plugins/#events).
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from modules import reference_nav, reference_pages
from settings_pages import PAGE, settings_page
from stage_pages import stage_nav, stage_pages

ROOT = Path(__file__).parents[2]
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
    """Add the pages that are not in docs/."""
    outside = {page: (ROOT / source).read_text() for source, page in _outside().items()}
    for page, text in {**outside, **stage_pages(), PAGE: settings_page(), **reference_pages()}.items():
        files.append(File.generated(config, page, content=text))


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links between files of the repository become links between pages; what has no page is left, and mkdocs warns."""
    pages = _outside()
    home = {there: source for source, there in pages.items()}
    source = home.get(page.file.src_uri, f"docs/{page.file.src_uri}")

    def to_page(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link[0]))
        there = pages.get(target, pages.get(f"{target}/README.md", target.removeprefix("docs/")))
        inside = there != target or source != f"docs/{page.file.src_uri}"
        return posixpath.relpath(there, posixpath.dirname(page.file.src_uri) or ".") if inside else link[0]

    return _LINK.sub(to_page, markdown)
