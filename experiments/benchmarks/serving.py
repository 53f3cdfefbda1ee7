"""Show that a server stays as large as it is: a row of requests to `toolkit serve`, and the memory it holds.

toolkit dataset build served --scenes 4 --seed 51 --set views=3 --set min_objects=1 --set max_objects=2
python experiments/benchmarks/serving.py served --requests 200

Scenes and goals take turns: every second request sends the frames of the next capture, the one after it its goal. Every
tenth is followed by one that is wrong on purpose, and must be answered with a sentence. Memory is the resident set of
the server's process; growth is that from the median of the second quarter of the requests to that of the last.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
import zipfile
from itertools import cycle, islice
from pathlib import Path

import httpx2 as httpx
import numpy as np

from toolkit.data.dataset import read_dataset


def main() -> None:
    """Start a server, ask it, stop it, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--requests", type=int, default=200)
    options = parser.parse_args()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-c", "from toolkit.cli.commands import main; main()", "serve", "--port", str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=600) as client:
            _wait(client, server)
            memory, seconds = _ask(client, server, read_dataset(options.dataset), options.requests)
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(30)
    _print(np.array(memory), np.array(seconds))


def _wait(client: httpx.Client, server: subprocess.Popen[bytes]) -> None:
    while server.poll() is None:
        try:
            client.get("/").raise_for_status()
            return
        except httpx.TransportError:
            time.sleep(0.5)
    raise SystemExit("the server did not start")


def _ask(
    client: httpx.Client, server: subprocess.Popen[bytes], captures: list[Path], requests: int
) -> tuple[list[float], list[float]]:
    """MiB after every request, and the seconds that it took."""
    memory: list[float] = []
    seconds: list[float] = []
    for capture in islice(cycle(captures), -(-requests // 2)):
        image = (capture / "goal/rgb/000000.png").read_bytes()
        camera = json.dumps(json.loads((capture / "goal/scene_camera.json").read_text())["0"])
        for path, parts in (
            ("/database", {"files": {"capture": _zipped(capture)}}),
            ("/estimate", {"files": {"image": image}, "data": {"camera": camera}}),
        ):
            began = time.perf_counter()
            client.post(path, **parts).raise_for_status()
            seconds.append(time.perf_counter() - began)
            memory.append(_resident(server.pid))
        if len(memory) % 10 == 0:
            print(f"{len(memory)} requests, {memory[-1]:.0f} MiB", file=sys.stderr, flush=True)
            wrong = client.post("/estimate", files={"image": b"no image"}, data={"camera": camera})
            assert wrong.status_code == 400 and wrong.json()["detail"], wrong.text
    return memory[:requests], seconds[:requests]


def _zipped(capture: Path) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(path for path in (capture / "current").rglob("*") if path.is_file()):
            archive.write(path, path.relative_to(capture))
    return packed.getvalue()


def _resident(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


def _print(memory: np.ndarray, seconds: np.ndarray) -> None:
    quarter = len(memory) // 4
    second, last = (float(np.median(part)) for part in (memory[quarter : 2 * quarter], memory[-quarter:]))
    print(
        "| requests | resident after 2, MiB | at 25 to 50 % | at 75 to 100 % | growth | /database p50, s | /estimate |"
    )
    print("| --- " * 7 + "|")
    cells = [f"{memory[1]:.0f}", f"{second:.0f}", f"{last:.0f}", f"{last / second - 1:+.1%}"]
    cells += [f"{np.median(part):.1f}" for part in (seconds[::2], seconds[1::2])]
    print(f"| {len(memory)} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
