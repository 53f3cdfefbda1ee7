"""The command line: the groups of commands in one, and how it ends. Nothing heavy is imported before it is needed."""

from __future__ import annotations

import errno
import logging
import signal
import sys
from typing import Annotated, NoReturn

import typer

from toolkit import __version__
from toolkit.cli import captures, data, inspect, plugins, results, run, serve, train, weights
from toolkit.errors import ToolkitError

app = typer.Typer(
    name="toolkit",
    help="Image-goal object rearrangement by multi-view fusion: every stage swappable, every swap measured.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for group in (run, captures, serve, results, inspect, plugins, train, data, weights):
    app.add_typer(group.app)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"toolkit {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say which version this is, and exit.")
    ] = False,
) -> None:
    """Options of the toolkit itself; what they do is done before any command."""


_FULL_OR_FORBIDDEN = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EEXIST}
"""What goes wrong wherever a command writes: no room, no permission, or a file where a folder is to be."""

_RUNS = {"ablate", "rearrange"}
"""Commands that write rows as they come, and have --resume."""


class _Stopped(BaseException):
    """Ctrl-C. Not a KeyboardInterrupt, which Typer would answer in its own words."""

    heard = False


def _stop(*_: object) -> None:
    _Stopped.heard = True
    raise _Stopped


def _say_stopped() -> NoReturn:
    kept = "; finished rows are kept, and --resume goes on with them" if _RUNS.intersection(sys.argv[1:2]) else ""
    sys.stderr.write(f"stopped{kept}\n")
    sys.exit(130)


def main() -> None:
    """Entry point: a user's mistake is answered in one or two lines and exit code 2, never with a traceback."""
    _Stopped.heard = False
    signal.signal(signal.SIGINT, _stop)
    # It warns where a home cannot be written, which costs it a second and nobody else anything.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        app()
    except ToolkitError as error:
        if _Stopped.heard:  # in the middle of an import, which then says that something cannot be loaded
            _say_stopped()
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)
    except plugins.CheckFailedError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(1)
    except OSError as error:
        if error.errno not in _FULL_OR_FORBIDDEN:
            raise
        what = f"'{error.filename}' cannot be written or opened" if error.filename else "a file cannot be written"
        sys.stderr.write(f"error: {what}: {error.strerror}; name another folder ($TOOLKIT_CACHE names the cache's)\n")
        sys.exit(2)
    except _Stopped:
        _say_stopped()
