"""What JAX compiled is compiled once, by whichever process came first; what one left half-written is not believed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CODE = """
import jax

from toolkit.perception.compiled import keep_compiled

keep_compiled()
jax.jit(lambda x: 2 * x + 1)(1.0)
"""


TRACED = """
import jax.numpy as jnp
import numpy as np

from toolkit.perception.compiled import Compiled, keep_compiled
from toolkit.perception.pnp.solving.damped import Pose


@Compiled
def turned(pose: Pose, count):
    print("traced")
    return Pose(pose.R @ pose.R, pose.t + count)


keep_compiled()
for points in (3, 3, 5):
    found = turned(Pose(2 * np.eye(3, dtype=np.float32), np.zeros(points, np.float32)), 2)
    assert isinstance(found, Pose) and (found.R == 4 * jnp.eye(3)).all() and (found.t == 2).all()
"""


def run(code: str, cache: Path) -> str:
    """Run code in another process, which must not complain; gives what it prints."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | {"TOOLKIT_CACHE": str(cache)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout


def compile_in(cache: Path) -> dict[str, bytes]:
    """Compile one program in another process; gives the programs that are kept then."""
    run(CODE, cache)
    return {path.name: path.read_bytes() for path in (cache / "compiled").glob("*/*-cache")}


def test_what_one_process_traced_no_other_traces(tmp_path):
    assert run(TRACED, tmp_path).split() == ["traced"] * 2  # once for each shape
    assert run(TRACED, tmp_path) == ""
    kept = list((tmp_path / "compiled").glob("*/*-traced"))
    assert len(kept) == 2
    kept[0].write_bytes(kept[0].read_bytes()[:-9])
    assert run(TRACED, tmp_path).split() == ["traced"]
    assert run(TRACED, tmp_path) == ""


def test_a_folder_that_cannot_be_written_is_no_matter_to_what_is_traced(tmp_path):
    (tmp_path / "compiled").write_text("a file")
    assert run(TRACED, tmp_path).split() == ["traced"] * 2


def test_programs_are_kept_and_broken_ones_made_again(tmp_path):
    first = compile_in(tmp_path)
    assert first
    assert compile_in(tmp_path) == first
    for path in (tmp_path / "compiled").glob("*/*-cache"):
        path.write_bytes(path.read_bytes()[:-9])
    assert compile_in(tmp_path).keys() == first.keys()
    assert all(len(data) >= len(first[name]) - 8 for name, data in compile_in(tmp_path).items())


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path):
    (tmp_path / "compiled").write_text("a file")
    assert compile_in(tmp_path) == {}


def test_a_gpu_alone_keeps_the_processor_and_room_for_others():
    code = """
import os

from toolkit.perception.compiled import share_accelerator

share_accelerator()
import jax

print(jax.config.jax_platforms, os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"])
"""
    shown: list[str] = []
    for own in ({"JAX_PLATFORMS": "cuda"}, {"JAX_PLATFORMS": "cpu", "XLA_PYTHON_CLIENT_PREALLOCATE": "true"}):
        done = subprocess.run([sys.executable, "-c", code], env={**os.environ, **own}, capture_output=True, text=True)
        shown.append(done.stdout.strip())
    assert shown == ["cuda,cpu false", "cpu true"]
