"""The server over a small scene: what comes back is what a session gives, and what is wrong gets one sentence."""

from __future__ import annotations

import io
import json
import re
import socket
import threading
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("fastapi")
pytest.importorskip("python_multipart")

from fastapi.testclient import TestClient
from typer.testing import CliRunner

import toolkit
from toolkit.cli.commands import app as commands
from toolkit.data.bop import load_capture, write_capture
from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame
from toolkit.serving.app import HOST, make_app
from toolkit.serving.desk import Desk

MOST = 8 * 2**20


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served") / "capture"
    write_capture(folder, current_frames(), goal_frame())
    return folder


@pytest.fixture(scope="module")
def session():
    return toolkit.Session("estimate")


@pytest.fixture
def client(session):
    with _client(session) as client:
        yield client


def _client(session, most=MOST, waiting=1):
    served = make_app(Desk(session, most), "estimate", most, waiting)
    return TestClient(served, base_url=f"http://{HOST}", raise_server_exceptions=False)


def zipped(folder, prefix="mine/", change=lambda name, data: (name, data)):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            name, data = change(path.relative_to(folder).as_posix(), path.read_bytes())
            archive.writestr(prefix + name, data)
    return packed.getvalue()


def send(client, data):
    return client.post("/database", files={"capture": data})


def ask(client, folder, image=None, camera=None, **form):
    image = (folder / "goal/rgb/000000.png").read_bytes() if image is None else image
    camera = json.dumps(entry(folder)) if camera is None else camera
    return client.post("/estimate", files={"image": image}, data={"camera": camera, **form})


def entry(folder):
    return json.loads((folder / "goal/scene_camera.json").read_text())["0"]


def test_answers_are_those_of_a_session_and_the_page_shows_the_last(client, folder, session):
    assert "Send the current frames" in client.get("/").text
    looked = send(client, zipped(folder)).json()
    assert (looked["scene"], looked["frames"], looked["findings"]) == (1, [0, 1, 2, 3], [])
    answers = [ask(client, folder, scene=1) for _ in range(2)]
    assert [answer.status_code for answer in answers] == [200, 200]

    capture = load_capture(folder)
    session.database(capture.current)
    expected = [e.T_goal_current for e in session.estimate(capture.goal)]
    assert any(T is not None for T in expected)
    for answer in answers:
        got = [o["T_goal_current"] for o in answer.json()["objects"]]
        assert got == [None if T is None else T.tolist() for T in expected]

    page = client.get("/").text
    assert "scene 1, goal 2" in page and "#" in page
    assert client.get("/answer/poses.json").json()["objects"][0]["goal_object"] == 0
    overlay = client.get("/answer/overlay.png")
    assert overlay.headers["content-type"] == "image/png"
    assert cv2.imdecode(np.frombuffer(overlay.content, np.uint8), 1).shape[1] == goal_frame().rgb.shape[1]


def test_the_interface_is_described(client):
    paths = client.get("/openapi.json").json()["paths"]
    assert set(paths) == {"/", "/database", "/estimate", "/answer/{name}"}
    assert "503" in paths["/estimate"]["post"]["responses"]


def _without(key):
    return lambda folder: json.dumps({k: v for k, v in entry(folder).items() if k != key})


BAD_GOALS = {
    "no picture": (400, b"hello", None, "'goal/rgb/0.png' is truncated or not an image"),
    "an empty picture": (400, b"", None, "'goal/rgb/0.png' is truncated or not an image"),
    "no JSON": (400, None, lambda _: "{cam_K", "'camera' is not JSON"),
    "deep JSON": (400, None, lambda _: "[" * 100000, "'camera' is not JSON"),
    "a list": (400, None, lambda _: "[1]", "an object"),
    "no K": (400, None, _without("cam_K"), "cam_K is missing"),
    "no pose": (400, None, _without("cam_R_w2c"), "cam_R_w2c is missing"),
    "two goals": (400, None, lambda f: json.dumps(entry(f))[:-1] + '}, "1": {}', "'camera' is not JSON"),
    "another size": (400, None, lambda f: json.dumps(entry(f) | {"width": 7}), "but its camera says 7x"),
}


@pytest.mark.parametrize("kind", BAD_GOALS)
def test_a_bad_goal_gets_one_sentence_and_the_scene_stays(client, folder, kind):
    status, image, camera, said = BAD_GOALS[kind]
    assert send(client, zipped(folder)).status_code == 200
    answer = ask(client, folder, image, camera and camera(folder))
    assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text
    assert "\n" not in answer.json()["detail"] and "/tmp" not in answer.text
    assert client.get("/answer/poses.json").status_code == 404


BAD_SCENES = {
    "no zip": (b"hello", "no zip"),
    "nothing": (b"", "no zip"),
    "an empty zip": (lambda f: zipped(f / "models"), "holds no current/scene_camera.json"),
    "a cut zip": (lambda f: zipped(f)[:-1000], "no zip"),
    "two captures": (lambda f: _two(f), "several captures"),
    "EXR": (lambda f: zipped(f, change=lambda n, d: (n.replace("depth/000000.png", "depth/0.exr"), d)), "EXR"),
    "no depth": (
        lambda f: zipped(f, change=lambda n, d: (n.replace("depth/", "deep/"), d)),
        "no current frame has depth: 'current/depth/000000.png' is missing",
    ),
    "no JSON": (
        lambda f: zipped(f, change=lambda n, d: (n, b"{" if n.endswith(".json") else d)),
        "'current/scene_camera.json' is not readable JSON",
    ),
}


def _two(folder):
    packed = io.BytesIO(zipped(folder, "a/"))
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr("b/current/scene_camera.json", "{}")
    return packed.getvalue()


@pytest.mark.parametrize("kind", BAD_SCENES)
def test_a_bad_scene_gets_one_sentence_and_there_is_none_then(client, folder, kind):
    data, said = BAD_SCENES[kind]
    assert send(client, zipped(folder)).status_code == 200
    answer = send(client, data if isinstance(data, bytes) else data(folder))
    assert (answer.status_code, said in answer.json()["detail"]) == (400, True), answer.text
    assert "/tmp" not in answer.text
    assert ask(client, folder).status_code == 409


def test_a_capture_that_cannot_be_right_is_refused(client, tmp_path):
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    flipped = [
        replace(f, camera=replace(f.camera, T_world_camera=f.camera.T_world_camera @ flip)) for f in current_frames()
    ]
    write_capture(tmp_path / "gl", flipped, goal_frame())
    answer = send(client, zipped(tmp_path / "gl"))
    assert answer.status_code == 422 and "OpenGL" in answer.json()["detail"]


@pytest.mark.parametrize("name", ["../../evil.png", "/etc/evil.png", "..\\..\\evil.png", "rgb/../../evil.png", ".evil"])
def test_names_of_a_zip_are_never_paths(client, folder, tmp_path, name):
    def renamed(n, data):
        return (name if n == "current/rgb/000003.png" else n, data)

    for prefix in ("current/rgb/", "current/", ""):
        packed = io.BytesIO(zipped(folder, prefix="x/"))
        with zipfile.ZipFile(packed, "a") as archive:
            archive.writestr(f"x/{prefix}{name}", b"evil")
        assert send(client, packed.getvalue()).status_code == 200
    assert not list(tmp_path.rglob("*evil*"))


def test_a_link_in_a_zip_is_only_a_file(client, folder, tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes((folder / "current/rgb/000000.png").read_bytes())
    packed = io.BytesIO(zipped(folder, change=lambda n, d: (n.replace("rgb/000000", "rgb/x"), d)))
    with zipfile.ZipFile(packed, "a") as archive:
        link = zipfile.ZipInfo("mine/current/rgb/000000.png")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, str(secret))
    answer = send(client, packed.getvalue())
    assert answer.status_code == 400 and "not an image" in answer.json()["detail"]


def test_only_files_of_the_last_answer_are_given(client, folder):
    send(client, zipped(folder))
    assert ask(client, folder).status_code == 200
    assert client.get("/answer/overlay.png").status_code == 200
    for name in ("../../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "/etc/passwd", "masks", "nothing.png"):
        assert client.get(f"/answer/{name}").status_code == 404, name


def test_what_is_too_large_is_not_read(session, folder):
    with _client(session, most=100_000) as client:
        answer = send(client, b"x" * 200_000)
        assert answer.status_code == 413 and "larger than" in answer.json()["detail"]

        def body():
            for _ in range(200):
                yield b"x" * 1000

        told = client.post("/database", content=body(), headers={"content-type": "multipart/form-data; boundary=x"})
        assert told.status_code == 413

    # A zip that would fill the disk.
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("current/scene_camera.json", "{}")
        archive.writestr("current/rgb/000000.png", b"\0" * (5 * MOST))
    with _client(session) as client:
        answer = send(client, packed.getvalue())
        assert answer.status_code == 400 and "holds more than" in answer.json()["detail"]


def test_pictures_that_would_fill_memory_are_refused(client, folder):
    _, huge = cv2.imencode(".png", np.zeros((12000, 13000), np.uint8))
    answer = send(client, zipped(folder, change=lambda n, d: (n, huge.tobytes() if "rgb/" in n else d)))
    assert answer.status_code == 400 and "megapixels" in answer.json()["detail"]


def test_missing_parts_are_named(client, folder):
    answer = client.post("/estimate", files={"image": b"x"})
    assert answer.status_code == 422 and answer.json()["detail"].startswith("'camera': ")
    assert client.post("/database").status_code == 422


def test_another_scene_is_never_answered_for(client, folder):
    assert ask(client, folder).status_code == 409
    send(client, zipped(folder))
    send(client, zipped(folder))
    answer = ask(client, folder, scene=1)
    assert answer.status_code == 409 and "scene 2" in answer.json()["detail"]
    assert ask(client, folder, scene="first").status_code == 422


def test_pages_of_elsewhere_are_kept_out(client, folder):
    data = {"capture": zipped(folder)}
    foreign = client.post("/database", files=data, headers={"origin": "http://evil.example"})
    assert foreign.status_code == 403
    rebound = client.post("/database", files=data, headers={"host": "evil.example"})
    assert rebound.status_code == 400
    own = client.post("/database", files=data, headers={"origin": f"http://{HOST}"})
    assert own.status_code == 200


class Slow:
    """A desk that works until it is let go, and counts who is at it."""

    def __init__(self):
        self.go = threading.Event()
        self.most = self.now = 0

    def look(self, _):
        self.now += 1
        self.most = max(self.most, self.now)
        assert self.go.wait(60)
        self.now -= 1
        return {"scene": 1, "frames": [], "instances": 0, "findings": [], "notes": []}


def test_one_request_at_a_time_a_few_wait_and_more_are_sent_away():
    desk, codes, answered = Slow(), [], threading.Semaphore(0)

    def ask_and_note():
        codes.append(send(client, b"x").status_code)
        answered.release()

    with TestClient(make_app(desk, "slow", MOST, 2), base_url=f"http://{HOST}") as client:
        threads = [threading.Thread(target=ask_and_note) for _ in range(6)]
        for thread in threads:
            thread.start()
        assert all(answered.acquire(timeout=60) for _ in range(3))
        assert codes == [503, 503, 503]
        desk.go.set()
        for thread in threads:
            thread.join(60)
        assert sorted(codes) == [200, 200, 200, 503, 503, 503]
        assert desk.most == 1
        assert send(client, b"x").status_code == 200


def test_a_server_that_fails_says_so_and_goes_on(session, folder, monkeypatch):
    with _client(session) as client:
        send(client, zipped(folder))
        with monkeypatch.context() as broken:
            broken.setattr(session, "estimate", lambda goal: 1 / 0)
            answer = ask(client, folder)
        assert answer.status_code == 500 and "ZeroDivisionError" in answer.json()["detail"]
        assert ask(client, folder).status_code == 200


def test_without_fastapi_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setattr("toolkit.cli.serve.find_spec", lambda name: None)
    result = CliRunner().invoke(commands, ["serve"])
    assert isinstance(result.exception, ToolkitError)
    assert re.fullmatch(r"`toolkit serve` needs .*; run: pip install '.*\[serve\]'", str(result.exception))


def test_a_port_that_is_taken_is_named():
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = CliRunner().invoke(commands, ["serve", "--port", str(port)])
    assert isinstance(result.exception, ToolkitError)
    assert f"port {port} cannot be had" in str(result.exception)
