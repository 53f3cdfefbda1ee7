"""Scans in any form: drawn as their plain OBJ is, or what is done to them is said."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

from toolkit.data import meshes
from toolkit.data.meshes import bake, unit_of
from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, build_scene
from toolkit.errors import ToolkitError
from toolkit.geometry import look_at
from toolkit.types import Camera

SIZES = (0.12, 0.09, 0.16)


@pytest.fixture
def scans(tmp_path):
    """One scan, as plain as can be: a box with another print on every side, smaller in the direction of y than of z."""
    folder = tmp_path / "scans" / "box"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    picture = cv2.resize(rng.integers(0, 256, (12, 12, 3), np.uint8), (128, 128), interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(folder / "texture_map.png"), picture)
    box(SIZES).export(folder / "textured.obj", mtl_name="textured.mtl", include_texture=True)
    for extra in (*folder.glob("*.mtl"), folder / "material_0.png"):
        extra.unlink(missing_ok=True)
    return tmp_path / "scans"


def box(size):
    """Many faces, so that a print by vertex is as sharp as one by texture; a wide base at z = 0."""
    corners = trimesh.creation.box(size)
    for _ in range(5):
        corners = corners.subdivide()
    faces = np.add(corners.triangles, [0, 0, size[2] / 2])
    flat = trimesh.Trimesh(faces.reshape(-1, 3), np.arange(faces.size // 3).reshape(-1, 3), process=False)
    normal = np.abs(flat.face_normals.repeat(3, axis=0))
    axis = normal.argmax(axis=1)
    u = flat.vertices[np.arange(len(axis)), (axis + 1) % 3] * 3 + 0.5
    v = flat.vertices[np.arange(len(axis)), (axis + 2) % 3] * 3 + 0.3
    material = trimesh.visual.material.SimpleMaterial(image=Image.new("RGB", (4, 4)))
    flat.visual = trimesh.visual.TextureVisuals(uv=np.stack([u, v], axis=1).clip(0.01, 0.99), material=material)
    return flat


def loaded(scans):
    mesh = trimesh.load(scans / "box" / "textured.obj", process=False)
    mesh.visual.material.image = Image.open(scans / "box" / "texture_map.png").convert("RGB")
    return mesh


def only(scans, keep):
    """Remove all files of the object but one."""
    for path in (scans / "box").iterdir():
        if path.name != keep:
            path.unlink()


def rewritten(scans, pattern, new):
    path = scans / "box" / "textured.obj"
    path.write_text(re.sub(pattern, new, path.read_text(), flags=re.MULTILINE))


def moved(scans, turn):
    def line(match):
        return "v " + " ".join(f"{x:.8f}" for x in turn(*map(float, match[1].split())))

    rewritten(scans, r"^v (.*)$", line)


def as_ply(scans):
    mesh = loaded(scans)
    mesh.visual = mesh.visual.to_color()
    mesh.export(scans / "box" / "a.ply")
    only(scans, "a.ply")


def as_flat_ply(scans):
    as_ply(scans)
    (scans / "box" / "a.ply").rename(scans / "box.ply")
    (scans / "box").rmdir()


def as_glb(scans):
    loaded(scans).export(scans / "box" / "a.glb")
    only(scans, "a.glb")


def as_face_colors(scans):
    mesh = loaded(scans)
    mesh.visual = mesh.visual.to_color()
    mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=mesh.visual.face_colors)
    mesh.export(scans / "box" / "a.ply")
    only(scans, "a.ply")


def with_colors(scans):
    colors = iter(loaded(scans).visual.to_color().vertex_colors[:, :3] / 255)

    def line(match):
        return f"{match[0]} " + " ".join(f"{c:.4f}" for c in next(colors))

    rewritten(scans, r"^v .*$", line)
    (scans / "box" / "texture_map.png").unlink()


def in_two_materials(scans):
    """The same picture under two names."""
    folder = scans / "box"
    lines = (folder / "textured.obj").read_text().splitlines()
    lines = [line for line in lines if not line.startswith(("mtllib", "usemtl"))]
    faces = [i for i, line in enumerate(lines) if line.startswith("f ")]
    lines.insert(faces[len(faces) // 2], "usemtl two")
    lines.insert(faces[0], "usemtl one")
    lines.insert(0, "mtllib two.mtl")
    (folder / "textured.obj").write_text("\n".join(lines) + "\n")
    (folder / "two.mtl").write_text("newmtl one\nmap_Kd texture_map.png\nnewmtl two\nmap_Kd second.png\n")
    shutil.copy(folder / "texture_map.png", folder / "second.png")


def see_through(scans):
    path = scans / "box" / "texture_map.png"
    picture = cv2.imread(str(path))
    cv2.imwrite(str(path), np.dstack([picture, np.full(picture.shape[:2], 120, np.uint8)]))


def of_odd_width(scans):
    path = scans / "box" / "texture_map.png"
    cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (131, 127)))


def with_many_faces(scans):
    mesh = loaded(scans)
    places, faces, colors = mesh.vertices, mesh.faces, mesh.visual.to_color().vertex_colors.astype(float)
    while len(faces) <= meshes._MOST_FACES:
        places, faces, kept = trimesh.remesh.subdivide(places, faces, vertex_attributes={"color": colors})
        colors = kept["color"]
    trimesh.Trimesh(places, faces, vertex_colors=colors.astype(np.uint8), process=False).export(scans / "box" / "a.ply")
    only(scans, "a.ply")


def _from_the_end(mesh):
    return lambda match: str(int(match[1]) - len(mesh.vertices) - 1)


KINDS = {
    "PLY": (as_ply, ""),
    "PLY in no folder of its own": (as_flat_ply, ""),
    "GLB": (as_glb, ""),
    "colours of faces": (as_face_colors, ""),
    "OBJ with colours of vertices": (with_colors, ""),
    "two materials": (in_two_materials, ""),
    "a picture one could see through": (see_through, ""),
    "a picture of odd width": (of_odd_width, ""),
    "a picture of another name": (
        lambda s: (s / "box" / "texture_map.png").rename(s / "box" / "albedo.png"),
        "",
    ),
    "indices from the end": (
        lambda s: rewritten(s, r"(?<= )(\d+)(?=/)", _from_the_end(loaded(s))),
        "",
    ),
    "too many faces": (with_many_faces, "box: thinned out to 80000 faces"),
    "millimetres": (lambda s: moved(s, lambda x, y, z: (1e3 * x, 1e3 * y, 1e3 * z)), "taken to be in millimetres"),
    "centimetres": (lambda s: moved(s, lambda x, y, z: (1e2 * x, 1e2 * y, 1e2 * z)), "taken to be in centimetres"),
}


def pictures(scans, cache, world):
    """What is drawn of the only object, in colour and as a mask, and its asset and the set's notes."""
    objects = load_object_set(str(scans), cache)
    (asset,) = objects.assets
    K = np.array([[500.0, 0, 159.5], [0, 500.0, 119.5], [0, 0, 1]])
    with world("tiny") as drawn:
        (body,) = drawn.add_visuals([(asset.mesh, asset.texture)])
        seen = [
            drawn.render(Camera(K, look_at(np.array(eye), np.array([0, 0, 0.08])), 320, 240), _light())
            for eye in ([0.4, -0.3, 0.4], [-0.3, 0.4, 0.2])
        ]
    return np.stack([rgb for rgb, _, _ in seen]), np.stack([ids == body for _, _, ids in seen]), asset, objects.notes


def _light():
    from toolkit.sim.world import Light

    return Light(ambient=0.8, diffuse=0.2)


@pytest.fixture
def world():
    pytest.importorskip("pybullet")
    from toolkit.sim.world import World

    return World


@pytest.mark.parametrize("kind", KINDS)
def test_a_scan_of_any_kind_is_drawn_as_the_plain_one(scans, tmp_path, world, kind):
    change, said = KINDS[kind]
    plain, outline, asset, notes = pictures(scans, tmp_path / "cache", world)
    assert notes == () and asset.mesh == scans / "box" / "textured.obj"
    assert plain[outline].std() > 30
    change(scans)
    seen, its_outline, drawn, notes = pictures(scans, tmp_path / "cache", world)
    assert (outline != its_outline).mean() < 0.002
    # Prints by vertex are a few millimetres blurred.
    both = outline & its_outline
    assert np.corrcoef(plain[both].ravel(), seen[both].ravel())[0, 1] > 0.85
    np.testing.assert_allclose(drawn.model.box_size, SIZES, atol=1e-3)
    assert len(notes) == bool(said)
    assert re.search(said, " ".join(notes))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: rewritten(s, r"^vt .*\n|(?<=\d)/\d*(/\d+)?", ""), "'texture_map.png' is not used"),
        (lambda s: (loaded(s).export(s / "box" / "a.stl"), only(s, "a.stl")), "box: drawn grey"),
    ],
)
def test_a_mesh_without_colours_is_grey_and_that_is_said(scans, tmp_path, world, change, said):
    change(scans)
    seen, outline, asset, notes = pictures(scans, tmp_path / "cache", world)
    assert said in " ".join(notes) and "box: drawn grey, since there are no colours" in notes
    assert np.ptp(seen[outline].astype(int), axis=1).max() < 4
    np.testing.assert_allclose(asset.model.box_size, SIZES, atol=1e-4)


def test_what_stands_with_y_up_is_asked_about_and_turned_where_that_is_said(scans, tmp_path):
    # A pyramid stands on its base only.
    pyramid = trimesh.creation.cone(0.06, 0.15)
    pyramid.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    shutil.rmtree(scans / "box")
    pyramid.export(scans / "cone.ply")
    objects = load_object_set(str(scans), tmp_path / "cache")
    (note,) = (n for n in objects.notes if "y up" in n)
    said = json.loads(re.search(r"\{.*\}", note)[0])
    (scans / "objects.json").write_text(json.dumps(said))
    turned = load_object_set(str(scans), tmp_path / "cache")
    assert not any("y up" in n for n in turned.notes)
    np.testing.assert_allclose(turned.assets[0].model.box_size, [0.12, 0.12, 0.15], atol=2e-3)
    points = meshes.read_points(turned.assets[0].mesh)
    assert np.ptp(points[points[:, 2] < points[:, 2].min() + 1e-4, 0]) > 0.1


def test_hulls_are_moved_with_their_mesh(scans, tmp_path):
    trimesh.creation.box([s * 1e3 for s in SIZES]).export(scans / "box" / "textured_coacd_0.stl")
    moved(scans, lambda x, y, z: (1e3 * x, -1e3 * z, 1e3 * y))
    (scans / "objects.json").write_text(json.dumps({"box": {"up": "y", "unit": "mm"}}))
    (asset,) = load_object_set(str(scans), tmp_path / "cache").assets
    (hull,) = asset.hulls
    np.testing.assert_allclose(np.ptp(meshes.read_points(hull), axis=0), [SIZES[0], SIZES[2], SIZES[1]], atol=1e-6)


def test_the_unit_is_told_by_the_middle_object():
    assert unit_of([0.05, 0.2, 0.3], "s") == ("m", None)
    assert unit_of([5, 20, 30], "s")[0] == "cm"
    assert unit_of([50, 200, 300, 9], "s")[0] == "mm"
    with pytest.raises(ToolkitError, match=r"are 0\.2 mm large"):
        unit_of([2e-4], "s")


def test_what_a_set_states_goes_before_what_its_size_says(scans, tmp_path):
    (scans / "objects.json").write_text(json.dumps({"*": {"unit": "cm"}}))
    objects = load_object_set(str(scans), tmp_path / "cache")
    np.testing.assert_allclose(objects.assets[0].model.box_size, np.array(SIZES) / 100, atol=1e-6)
    assert objects.notes == ()


BAD = {
    "two meshes": (
        lambda f: (loaded(f.parent).export(f / "b.ply"), (f / "textured.obj").rename(f / "a.obj")),
        "several",
    ),
    "no picture": (lambda f: (f / "texture_map.png").unlink(), "has no texture: put its image"),
    "half a GLB": (
        lambda f: (as_glb(f.parent), (f / "a.glb").write_bytes((f / "a.glb").read_bytes()[:500])),
        "cannot be read",
    ),
    "a cloud": (
        lambda f: (
            trimesh.PointCloud(np.random.default_rng(0).random((9, 3))).export(f / "a.ply"),
            only(f.parent, "a.ply"),
        ),
        "face",
    ),
    "no image": (lambda f: (f / "texture_map.png").write_text("hello"), "is not an image"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_scans_are_answered_in_one_sentence(scans, tmp_path, kind):
    damage, said = BAD[kind]
    damage(scans / "box")
    with pytest.raises(ToolkitError, match=said) as error:
        load_object_set(str(scans), tmp_path / "cache")
    assert "\n" not in str(error.value)


def test_without_what_thins_out_one_sentence_says_what_to_install(scans, tmp_path, monkeypatch):
    with_many_faces(scans)
    monkeypatch.setitem(__import__("sys").modules, "fast_simplification", None)
    with pytest.raises(ToolkitError, match=re.escape("pip install 'rearrange-toolkit[scans]'")):
        load_object_set(str(scans), tmp_path / "cache")


@pytest.mark.parametrize("faces", [1, 2, 7, 12])
def test_every_triangle_has_its_colours_in_the_baked_image(faces):
    corners = np.random.default_rng(faces).integers(0, 256, (faces, 3, 3), np.uint8)
    image, uv = bake(corners)
    assert image.shape[1] % 4 == 0
    pixels = uv * image.shape[0] - 0.5
    x, y = np.rint(pixels[:, 0]).astype(int), image.shape[0] - 1 - np.rint(pixels[:, 1]).astype(int)
    np.testing.assert_array_equal(image[y, x].reshape(faces, 3, 3), corners)
    # Half-way along an edge lies the mean of its ends.
    middle = pixels.reshape(faces, 3, 2)[:, :2].mean(axis=1)
    x, y = np.rint(middle[:, 0]).astype(int), image.shape[0] - 1 - np.rint(middle[:, 1]).astype(int)
    np.testing.assert_allclose(image[y, x], corners[:, :2].astype(float).mean(axis=1), atol=8)


def test_an_object_that_is_not_drawn_fails_the_build_by_name(scans, tmp_path, world, monkeypatch):
    objects = load_object_set(str(scans), tmp_path / "cache")
    config = TabletopConfig(objects=str(scans), scenes=1, min_objects=1, max_objects=1, views=2, renderer="tiny")
    # A mesh that the renderer leaves out, as it does one of too many faces: nothing of it is in any picture.
    (tmp_path / "gone.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    gone = replace(objects, assets=(replace(objects.assets[0], mesh=tmp_path / "gone.obj"),))
    build_scene(config, objects, 0, tmp_path / "seen", tmp_path / "cache")
    with pytest.raises(ToolkitError, match=r"scene 0: object 'box' shows in no picture"):
        build_scene(config, gone, 0, tmp_path / "unseen", tmp_path / "cache")
