"""Runs in MLflow: `pip install mlflow`, $MLFLOW_TRACKING_URI, and

toolkit ablate --plugin docs/examples/mlflow_hook.py --log mlflow
"""

import math

import mlflow

from toolkit.harness.hooks.hook import RunHook
from toolkit.registry import Plugin


class MLflow(Plugin, RunHook):
    """One MLflow run per run: its settings, the figures of every cell, and report, tables and plots as artifacts."""

    stage = "hook"
    name = "mlflow"

    def begin(self, start):
        mlflow.set_experiment(start.experiment)
        mlflow.start_run(run_name=start.title, tags={"folder": str(start.run)})
        mlflow.log_dict(dict(start.settings), "settings.yaml")

    def table(self, lines):
        for line in lines:
            figures = {name: value for name, value in line.items() if isinstance(value, int | float)}
            cell = "".join(c if c.isalnum() or c in " _-./" else "_" for c in line["cell"])
            mlflow.log_metrics({f"{cell}/{name}": value for name, value in figures.items() if math.isfinite(value)})

    def end(self, run):
        if run is not None:
            mlflow.log_artifacts(str(run))
        mlflow.end_run("FAILED" if run is None else "FINISHED")
