"""Broken captures, drawn at random: every one is answered by an exit code and a sentence, never a traceback.

The suite draws two hundred, the same every time; `pytest -n 2 -m slow tests/data/test_fuzz.py` draws 2,000 others.
"""

from __future__ import annotations

import io
import json
import shutil
import sys
import tempfile
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from written import small_capture

from toolkit.cli.commands import main

QUICK = [
    *("--segmenter", "masks", "--goal-segmenter", "masks", "--index", "numpy", "--pnp", "poselib"),
    *("--refiner", "none", "--set", "pipeline.assignment=vote", "--set", "pipeline.matcher.crop_size=96"),
]
"""The cheapest pipeline that needs no truth."""

JSON_FILES = (
    "current/scene_camera.json",
    "goal/scene_camera.json",
    "current/scene_gt.json",
    "goal/scene_gt.json",
    "models_info.json",
)
FOLDERS = ("current", "goal", "current/rgb", "current/depth", "current/mask_visib", "goal/rgb", "goal/mask_visib")

numbers = st.one_of(st.integers(), st.floats(), st.sampled_from([0, -1, 1e300, -0.0, 2**63, 10**400]))
values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=12,
)
keys = st.one_of(
    st.text(max_size=4), st.sampled_from(["0", "00", "-1", "+1", "1.5", "99999999999", "cam_dist", "inst_id"])
)


def places(data, found=()):
    """Every place in a JSON value, as the keys that lead there."""
    yield found
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield from places(value, (*found, key))


def spoil_value(draw, path: Path) -> None:
    """Remove, replace, rename or wrap one value of a JSON file."""
    data = {"": json.loads(path.read_text())}
    place = draw(st.sampled_from(list(places(data))[1:]))
    holder = data
    for key in place[:-1]:
        holder = holder[key]
    last = place[-1]
    match draw(st.sampled_from(["remove", "replace", "replace", "rename", "wrap", "jitter"])):
        case "remove":
            del holder[last]
        case "replace":
            holder[last] = draw(values)
        case "rename" if isinstance(holder, dict):
            holder[draw(keys)] = holder.pop(last)
        case "wrap":
            holder[last] = [holder[last]]
        case "jitter" if isinstance(holder[last], int | float) and not isinstance(holder[last], bool):
            holder[last] = holder[last] * draw(st.sampled_from([-1, 0, 1.01, 2, 1000, 0.001]))
    path.write_text(json.dumps(data.get("", draw(values))))


def spoil_bytes(draw, path: Path) -> None:
    """Cut a file, add to it, replace it, or make it something else."""
    data = path.read_bytes()
    match draw(st.sampled_from(["cut", "add", "flip", "noise", "empty", "remove", "folder", "encoding"])):
        case "cut":
            path.write_bytes(data[: draw(st.integers(0, len(data)))])
        case "add":
            path.write_bytes(data + draw(st.binary(max_size=40)))
        case "flip":
            at = draw(st.integers(0, max(len(data) - 1, 0)))
            path.write_bytes(data[:at] + draw(st.binary(min_size=1, max_size=4)) + data[at + 1 :])
        case "noise":
            path.write_bytes(draw(st.binary(max_size=60)))
        case "empty":
            path.write_bytes(b"")
        case "remove":
            path.unlink()
        case "folder":
            path.unlink()
            path.mkdir()
        case "encoding":
            path.write_bytes(data.decode("latin-1").encode(draw(st.sampled_from(["utf-8-sig", "utf-16", "utf-32"]))))


def spoil_picture(draw, path: Path) -> None:
    """Another picture in its place: of another size, type or kind, turned by EXIF, or an array."""
    size = draw(st.sampled_from([(240, 320), (240, 320), (320, 240), (1, 1), (7, 5)]))
    kind = draw(st.sampled_from(["uint8", "uint16", "int32", "float32", "colour", "alpha"]))
    fill = draw(st.sampled_from([0, 1, 255, 65535, -1, np.nan, np.inf, 1e30]))
    path.unlink()
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if kind in ("colour", "alpha"):
            array = np.full((*size, 3 if kind == "colour" else 4), fill).astype(np.uint8)
        else:
            array = np.full(size, fill).astype(kind)
        array[: draw(st.sampled_from([0, 1, 200]))] = 1
    suffix = draw(st.sampled_from([".png", ".PNG", ".jpg", ".tif", ".bmp", ".webp", ".npy", ".exr", ".txt", ""]))
    stem = draw(st.sampled_from([path.stem, str(int(path.stem.partition("_")[0])), "7", "goal", "-1", "0x1"]))
    target = path.with_name(stem + suffix)
    if suffix == ".npy":
        np.save(target, array)
        return
    data = io.BytesIO()
    exif = Image.Exif()
    exif[0x0112] = draw(st.sampled_from([1, 1, 3, 6, 99]))
    form = {".jpg": "JPEG", ".tif": "TIFF", ".bmp": "BMP", ".webp": "WEBP"}.get(suffix.lower(), "PNG")
    try:
        Image.fromarray(array).save(data, form, exif=exif)
    except (OSError, ValueError, TypeError):
        data.write(b"no such picture")
    target.write_bytes(data.getvalue())


def spoil_folder(draw, path: Path) -> None:
    """A folder that is gone, empty, a file, or has more in it."""
    match draw(st.sampled_from(["remove", "empty", "file", "more"])):
        case "remove":
            shutil.rmtree(path)
        case "empty":
            shutil.rmtree(path)
            path.mkdir()
        case "file":
            shutil.rmtree(path)
            path.write_text("not a folder")
        case "more":
            for name in ("Thumbs.db", "000001.png.part", "._000000.png", "9.png", "000000_000009.png"):
                (path / name).write_bytes(draw(st.binary(max_size=20)))


def spoil(draw, folder: Path) -> None:
    """Break a capture in one place."""
    how = draw(st.sampled_from(["value", "value", "value", "bytes", "picture", "folder"]))
    if how == "folder":
        existing = [folder / name for name in FOLDERS if (folder / name).is_dir()]
        if existing:
            spoil_folder(draw, draw(st.sampled_from(existing)))
        return
    texts = [folder / name for name in JSON_FILES if (folder / name).is_file()]
    pictures = sorted(path for path in folder.glob("*/*/*.png") if path.is_file())
    chosen = {"value": texts, "picture": pictures}.get(how, [*texts, *pictures[:: max(len(pictures) // 5, 1)]])
    if not chosen:
        return
    path = draw(st.sampled_from(chosen))
    if how == "value":
        try:
            spoil_value(draw, path)
        except (ValueError, IndexError, RecursionError):
            return  # broken already
    elif how == "picture" and path.stem.partition("_")[0].isdigit():
        spoil_picture(draw, path)
    else:
        spoil_bytes(draw, path)


def answered(folder: Path, out: Path) -> None:
    """Run the command in this process, and look at how it answers."""
    said, error = io.StringIO(), io.StringIO()
    call = ["toolkit", "estimate", str(folder), *QUICK, "--out", str(out)]
    with patch.object(sys, "argv", call), redirect_stdout(said), redirect_stderr(error), warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SystemExit) as end:
            main()
    code = end.value.code or 0
    assert code in (0, 1, 2)
    assert "Traceback" not in error.getvalue()
    if code:
        start = "no motion: " if code == 1 else "error: "
        (sentence,) = [line for line in error.getvalue().splitlines() if line.startswith(start)]
        assert len(sentence) > 20 and error.getvalue().endswith(f"{sentence}\n")
    else:
        assert (out / "poses.json").exists()


def check(draw) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = small_capture(Path(place) / "capture", truth=draw(st.booleans()))
        for _ in range(draw(st.integers(1, 3))):
            spoil(draw, folder)
        answered(folder, Path(place) / "out")


ANY_TIME = {"deadline": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=200, derandomize=True, **ANY_TIME)
@given(st.data())
def test_a_broken_capture_is_answered(data):
    check(data.draw)


@pytest.mark.slow
@settings(max_examples=2000, **ANY_TIME)
@given(st.data())
def test_two_thousand_broken_captures_are_answered(data):
    check(data.draw)


def test_the_whole_capture_is_estimated_by_the_same_pipeline(tmp_path):
    answered(small_capture(tmp_path / "capture"), tmp_path / "out")
    objects = json.loads((tmp_path / "out/poses.json").read_text())["objects"]
    assert len(objects) == 3 and all(entry["status"] == "estimated" for entry in objects)
