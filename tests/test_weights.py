"""Checkpoints: where they are looked for, and every way in which one is not to be had."""

from __future__ import annotations

import http.server
import threading

import numpy as np
import pytest
import torch

from toolkit.errors import ToolkitError
from toolkit.stages import MATCHERS
from toolkit.weights import cards, resolve
from toolkit.weights.cards import WeightCard
from toolkit.weights.download import download, source_url

CONTENT = np.random.default_rng(0).bytes(600_000)


class _Server(http.server.BaseHTTPRequestHandler):
    """Serves CONTENT, with ranges; /cut ends half-way."""

    def do_GET(self):
        start = int(self.headers.get("Range", "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        self.send_response(206 if start else 200)
        body = CONTENT[start:]
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if self.path == "/cut" else body)

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
    monkeypatch.setattr(resolve, "download", None)
    assert resolve.resolve_weights("test").parent == tmp_path / "cache" / "weights"


def test_a_broken_download_goes_on_where_it_stopped(server, tmp_path):
    target = tmp_path / "file.bin"
    with pytest.raises(OSError):
        download(f"{server}/cut", target)
    assert not target.exists()
    assert 0 < (tmp_path / "file.bin.part").stat().st_size < len(CONTENT)
    download(f"{server}/whole", target)
    assert target.read_bytes() == CONTENT


def test_a_named_folder_comes_before_the_cache(card, tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "test.bin").write_bytes(b"mine")
    monkeypatch.setenv("TOOLKIT_WEIGHTS", str(tmp_path / "mine"))
    assert resolve.resolve_weights("test").read_bytes() == b"mine"


def test_another_digest_is_refused(card, monkeypatch):
    pinned = WeightCard(**{**vars(card), "sha256": "0" * 64})
    monkeypatch.setitem(cards.CARDS, "test", pinned)
    with pytest.raises(ToolkitError, match="sha256 differs"):
        resolve.resolve_weights("test")


def test_no_network_says_which_file_to_put_where(card, tmp_path, monkeypatch):
    monkeypatch.setitem(cards.CARDS, "test", WeightCard(**{**vars(card), "sources": ("http://127.0.0.1:9/x",)}))
    with pytest.raises(ToolkitError, match=r"put test\.bin into '.*/cache/weights'") as error:
        resolve.resolve_weights("test")
    assert "\n" not in str(error.value)


def test_a_file_that_is_absent_damaged_or_foreign_is_one_sentence(tmp_path):
    with pytest.raises(ToolkitError, match="does not exist"):
        MATCHERS.create("loftr", {"file": str(tmp_path / "no.ckpt")}).check_ready()
    (tmp_path / "torn.ckpt").write_bytes(b"PK\x03\x04 torn")
    torch.save({"state_dict": {"weight": torch.zeros(3)}}, tmp_path / "foreign.ckpt")
    for name in ("torn.ckpt", "foreign.ckpt"):
        with pytest.raises(ToolkitError, match="is not a checkpoint of kornia's LoFTR") as error:
            MATCHERS.create("loftr", {"file": str(tmp_path / name)}).check_ready()
        assert "\n" not in str(error.value)
