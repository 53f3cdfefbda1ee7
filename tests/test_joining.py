"""The files that greet a newcomer agree with the package: pre-commit's ruff, the citation, the workflow."""

from __future__ import annotations

import tomllib
from pathlib import Path

import yaml

import toolkit

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_pre_commit_runs_the_ruff_of_the_dev_extra():
    (ruff,) = [package for package in PROJECT["optional-dependencies"]["dev"] if package.startswith("ruff")]
    (repo,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert [hook["additional_dependencies"] for hook in repo["hooks"]] == [[ruff], [ruff]]
    assert all(
        hook["entry"].removesuffix(" --force-exclude") in (ROOT / ".ci/run").read_text() for hook in repo["hooks"]
    )


def test_the_citation_names_this_version_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == PROJECT["version"] == toolkit.__version__
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    assert paper["title"] in (ROOT / "README.md").read_text()


def test_the_workflow_runs_what_ci_runs():
    jobs = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]
    assert {"run": ".ci/run"} in jobs["checks"]["steps"]
