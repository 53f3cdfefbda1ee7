"""`toolkit serve`: a session over HTTP."""

from __future__ import annotations

import signal
import socket
from importlib.util import find_spec
from typing import Annotated, Any

import typer

from toolkit.cli.console import bars, say
from toolkit.cli.options import ExperimentArgument, read_cell, with_experiment_options
from toolkit.errors import ToolkitError

app = typer.Typer()

_NEEDED = ("fastapi", "uvicorn", "python_multipart")
_STOPPING_S = 5


@app.command()
@with_experiment_options
def serve(
    experiment: ExperimentArgument = "estimate",
    port: Annotated[int, typer.Option(min=1, max=65535, metavar="N", help="Port on this machine.")] = 8000,
    most_mib: Annotated[int, typer.Option(min=1, metavar="N", help="Size of the largest request, MiB.")] = 256,
    waiting: Annotated[
        int, typer.Option(min=0, metavar="N", help="Requests that may wait while one is worked on.")
    ] = 4,
    *,
    choices: dict[str, Any],
) -> None:
    """Answer goal after goal over HTTP on this machine, with models and compiled code kept; one page shows the last."""
    if any(find_spec(module) is None for module in _NEEDED):
        raise ToolkitError(
            "`toolkit serve` needs FastAPI and uvicorn, not all installed; run: pip install 'rearrange-toolkit[serve]'"
        )
    import uvicorn

    from toolkit.serving.app import HOST, make_app

    with bars().waiting("Loading"):
        from toolkit.harness.session import Session
        from toolkit.serving.desk import Desk

        most_bytes = most_mib * 2**20
        desk = Desk(Session(read_cell(experiment, choices)), most_bytes)
    served = make_app(desk, experiment, most_bytes, waiting)
    config = uvicorn.Config(served, log_level="warning", timeout_graceful_shutdown=_STOPPING_S, server_header=False)
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, port))
        except OSError as error:
            raise ToolkitError(f"port {port} cannot be had ({error.strerror}); choose another with --port") from error
        say(
            f"The last answer: http://{HOST}:{port}/",
            f"The interface:   http://{HOST}:{port}/openapi.json",
            "Ctrl-C stops.",
        )
        # uvicorn stops at the first signal, and then raises it once more.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        uvicorn.Server(config).run([listening])
