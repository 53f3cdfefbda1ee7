"""What the benchmarks print is read again as figures, and two runs are compared by them."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "experiments" / "benchmarks"
ALL = runpy.run_path(str(FOLDER / "all.py"))
PRINTED = """Six captures; some machine

| road | database, ms | goal object, ms |
| --- | --- | --- |
| automatic masks | 1200 | 640 |
| true masks | 300 | 320 |

| outliers | solver | success, % | rotation, deg |
| --- | --- | --- | --- |
| 10% | jax_joint | 99.0 | 0.12 [0.10, 0.14] |
"""


def test_tables_become_figures_by_line_and_column():
    figures = dict(ALL["tables"](PRINTED))
    assert figures["automatic masks"] == {"road": "automatic masks", "database, ms": "1200", "goal object, ms": "640"}
    assert figures["jax_joint"]["rotation, deg"] == "0.12 [0.10, 0.14]"
    assert len(figures) == 3


def test_two_runs_are_compared_number_by_number():
    now = {"waiting": dict(ALL["tables"](PRINTED))}
    before = {"waiting": dict(ALL["tables"](PRINTED.replace("640", "1280")))}
    compared = ALL["comparison"](now, before)
    assert "| waiting | automatic masks | goal object, ms | 1280 | 640 | 0.50 |" in compared
    assert "| waiting | jax_joint | rotation, deg | 0.12 [0.10, 0.14] | 0.12 [0.10, 0.14] | 1.00 |" in compared


@pytest.mark.parametrize("name", ALL["BENCHMARKS"])
def test_every_benchmark_is_a_script(name):
    assert (FOLDER / f"{name}.py").is_file()
