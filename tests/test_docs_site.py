"""The docs as a site: it builds without a warning, and its tables say what the registries say."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest

from toolkit.errors import ToolkitError
from toolkit.stages import REGISTRIES
from toolkit.weights import resolve
from toolkit.weights.cards import CARDS

ROOT = Path(__file__).parents[1]
BUILT_IN = [(r.stage, entry.name) for r in REGISTRIES.values() for entry in r.entries() if entry.origin == "toolkit"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    for module in ("mkdocs", "material", "mkdocstrings_handlers", "griffe_inherited_docstrings"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: pip install 'rearrange-toolkit[docs]'")
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return out


def test_it_builds_without_a_warning_and_has_every_page(site):
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.md")]
    for page in pages:
        assert (site / page.relative_to(ROOT / "docs").with_suffix("") / "index.html").is_file()
    for page in (ROOT / "docs" / "tutorials").glob("*.md"):
        assert f'href="../{page.stem}.ipynb"' in (site / "tutorials" / page.stem / "index.html").read_text()
        assert json.loads((site / "tutorials" / f"{page.stem}.ipynb").read_text())["nbformat"] == 4
    for readme in (ROOT / "plugins").glob("*/README.md"):
        assert (site / "plugins" / readme.parent.name / "index.html").is_file()


def test_every_implementation_is_in_its_stage_s_table_with_its_settings(site):
    for stage, name in BUILT_IN:
        registry = REGISTRIES[stage]
        text = (site / "stages" / registry.group.removeprefix("toolkit.") / "index.html").read_text()
        assert f'<h2 id="{name}">' in text
        plugin = registry.get(name)
        for setting in plugin.Config.model_fields:
            assert f"<code>{setting}</code>" in text or f"<code>{setting}." in text, (stage, name, setting)
        assert all(f"<code>{weights}</code>" in text for weights in plugin.weights)


def test_the_api_reference_shows_what_docstrings_say(site):
    text = (site / "reference" / "types" / "index.html").read_text()
    assert "float64 intrinsics" in text and "toolkit.types.Camera" in text
    text = (site / "reference" / "rearrangement.executors.replay" / "index.html").read_text()
    assert text.count("Let go of the task that was begun.") == 2  # Recorder has it from its Protocol: summary and text


def test_links_between_readme_plugins_and_docs_lead_to_pages(site):
    home = (site / "index.html").read_text()
    assert 'href="contributing/"' in home and 'href="plugins/"' in home and 'href="results/#past-pnp"' in home
    assert 'src="images/overview.jpg"' in home
    assert 'href="ifor/"' in (site / "plugins" / "index.html").read_text()


@pytest.mark.parametrize(("stage", "name"), BUILT_IN)
def test_weights_are_all_that_the_settings_can_choose(stage, name, monkeypatch):
    """Every combination of the settings that are choices; nothing is fetched or read."""
    plugin = REGISTRIES[stage].get(name)
    asked: set[str] = set()
    monkeypatch.setattr(resolve, "find_card", lambda card: asked.add(card) or CARDS[card])
    monkeypatch.setattr(resolve, "find_weights", lambda card: Path(__file__))
    monkeypatch.setattr(resolve, "_is_intact", lambda card, path: True)
    monkeypatch.setattr(resolve, "_complete", lambda card, path: None)
    fields = plugin.Config.model_fields.items()
    choices = {key: get_args(info.annotation) for key, info in fields if get_origin(info.annotation) is Literal}
    required = {key: Path("nowhere") for key, info in fields if info.is_required()}
    for values in itertools.product(*choices.values()):
        try:
            plugin(plugin.Config(**dict(zip(choices, values, strict=True)), **required)).digests()
        except ToolkitError as error:
            pytest.skip(str(error))
    assert asked == set(plugin.weights)


def test_the_page_of_settings_says_what_every_one_means(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "generate"))
    page = importlib.import_module("settings_pages").settings_page()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) > 300 and not [row for row in rows if row.endswith("|  |")]
    for stage, name in BUILT_IN:
        assert not REGISTRIES[stage].get(name).Config.model_fields or f"\n### {stage} {name}\n" in page
