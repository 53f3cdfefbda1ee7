"""Commands as a user types them: answered by this process, which has everything imported, or by one of their own."""

from __future__ import annotations

import io
import os
import select
import signal
import subprocess
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from toolkit.cli import commands

PACKAGES = Path(commands.__file__).parents[2]
"""Where the toolkit that is tested lies: other processes are to have the same, installed or not."""

START = "import sys; sys.argv[0] = 'toolkit'; from toolkit.cli.commands import main; main()"
TERMINAL = {"COLUMNS": "120", "NO_COLOR": "1"}

_ASK = r"""
toolkit() {
    case " $* " in
        # What a plugin registers must not stay in the process of the tests.
        *" plugin "* | *" --plugin "*) "$PYTHON" -P -c "$START" "$@" && return ;;
    esac
    { printf '%s\0' "$PWD" "$@"; echo; } >"$PIPES/asked"
    read -r code <"$PIPES/answered"
    return "$code"
}
"""


def toolkit(*arguments: object, folder: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """What a command answers, given in this process."""
    call = ["toolkit", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    before = signal.getsignal(signal.SIGINT)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        for name, value in {**TERMINAL, **environment}.items():
            patch.setenv(name, value)
        patch.chdir(folder or Path.cwd())
        patch.setattr(sys, "argv", call)
        with pytest.raises(SystemExit) as end:
            commands.main()
    signal.signal(signal.SIGINT, before)
    return subprocess.CompletedProcess(call, end.value.code or 0, out.getvalue(), err.getvalue())


def own_process(*arguments: object, folder: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """What a command answers in a process of its own; it imports what is tested (-P), not the folder it is in."""
    return subprocess.run(
        [sys.executable, "-P", "-c", START, *map(str, arguments)],
        env={**os.environ, **TERMINAL, **environment},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def shell(code: str, folder: Path) -> None:
    """Run a block of Bash in a folder; its `toolkit` is this process's, but for what registers plugins."""
    path = os.pathsep.join(p for p in (str(PACKAGES), os.environ.get("PYTHONPATH")) if p)
    programs = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryFile("w+") as said:
        asked, answered = (Path(made) / name for name in ("asked", "answered"))
        for pipe in (asked, answered):
            os.mkfifo(pipe)
        own = {"PYTHONPATH": path, "PATH": programs, "PYTHON": sys.executable, "START": START, "PIPES": made}
        bash = subprocess.Popen(
            ["bash", "-euc", _ASK + code], cwd=folder, env={**os.environ, **own}, stdout=subprocess.DEVNULL, stderr=said
        )
        # For both, so that none of them waits for the other to open it.
        waiting, answering = (os.open(pipe, os.O_RDWR) for pipe in (asked, answered))
        try:
            call = b""
            while bash.poll() is None:
                if not select.select([waiting], [], [], 0.05)[0]:
                    continue
                call += os.read(waiting, 1 << 16)
                if call.endswith(b"\0\n"):
                    where, *arguments = call[:-2].decode().split("\0")
                    call = b""
                    done = toolkit(*arguments, folder=Path(where))
                    said.write(done.stderr if done.returncode else "")
                    os.write(answering, b"%d\n" % done.returncode)
        finally:
            bash.kill()
            os.close(waiting)
            os.close(answering)
        said.seek(0)
        assert bash.wait() == 0, said.read()
