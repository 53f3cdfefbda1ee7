"""Object sets: the procedural one, folders of scans, and what is wrong with a scan."""

from __future__ import annotations

import json
import shutil
from collections import Counter

import cv2
import numpy as np
import pytest
import trimesh

from toolkit.data.layout import resting_poses
from toolkit.data.objects import load_object_set
from toolkit.data.procedural import procedural_folder
from toolkit.errors import ToolkitError


@pytest.fixture(scope="module")
def procedural(cache):
    return load_object_set("procedural", cache)


@pytest.fixture
def scans(procedural, tmp_path):
    """Two scans in YCB's layout."""
    for asset in (procedural.assets[0], procedural.assets[40]):
        shutil.copytree(asset.mesh.parent, tmp_path / "scans" / asset.name)
    return tmp_path / "scans"


def test_the_procedural_set_has_seven_categories_of_ten(procedural):
    counts = Counter(asset.category for asset in procedural.assets)
    assert len(counts) >= 7
    assert min(counts.values()) >= 10


def test_procedural_objects_are_distinct_and_textured(procedural):
    textures = {asset.texture.read_bytes() for asset in procedural.assets}
    assert len(textures) == len(procedural.assets)
    plain = [asset.name for asset in procedural.assets if cv2.imread(str(asset.texture)).std() < 5]
    assert not plain


def test_procedural_objects_stand_upright_and_fit_a_hand(procedural):
    for asset in procedural.assets:
        assert 0.03 < asset.model.diameter < 0.35, asset.name
        assert 0.01 < asset.mass_kg < 3, asset.name
        upright = resting_poses(asset)[0].T_rest_model
        np.testing.assert_allclose(upright[:3, :3], np.eye(3), err_msg=asset.name)


def test_the_procedural_set_is_the_same_every_time(cache, tmp_path):
    made = procedural_folder(tmp_path)
    kept = procedural_folder(cache / "objects")
    files = sorted(path.relative_to(made) for path in made.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(kept) for path in kept.rglob("*") if path.is_file())
    assert all((made / file).read_bytes() == (kept / file).read_bytes() for file in files)


def test_scans_get_hulls_where_they_have_none(scans, tmp_path):
    for hull in scans.glob("*/*.stl"):
        hull.unlink()
    for asset in load_object_set(str(scans), tmp_path / "cache").assets:
        assert len(asset.hulls) == 1 and asset.hulls[0].is_file()
        assert resting_poses(asset)


def test_google_scanned_objects_layout(scans, tmp_path):
    old = next(scans.iterdir())
    new = tmp_path / "gso" / old.name
    (new / "meshes").mkdir(parents=True)
    (new / "materials" / "textures").mkdir(parents=True)
    shutil.copy(old / "textured.obj", new / "meshes" / "model.obj")
    shutil.copy(old / "texture_map.jpg", new / "materials" / "textures" / "texture.jpg")
    (asset,) = load_object_set(str(tmp_path / "gso"), tmp_path / "cache").assets
    assert asset.name == old.name and asset.texture.name == "texture.jpg"


def test_what_objects_json_says_counts(scans, tmp_path):
    first, second = sorted(path.name for path in scans.iterdir())
    notes = {first: {"symmetry": "continuous_z", "category": "cup"}, second: {"mass_kg": 2.5}}
    (scans / "objects.json").write_text(json.dumps(notes))
    one, two = load_object_set(str(scans), tmp_path / "cache").assets
    assert one.category == "cup" and len(one.model.continuous_axes) == 1
    assert two.mass_kg == 2.5


def _first(folder, name):
    return next(folder.glob(f"*/{name}"))


BAD = {
    "no texture": (lambda f: _first(f, "texture_map.jpg").unlink(), "has no texture: put its image beside"),
    "no mesh": (lambda f: _first(f, "textured.obj").unlink(), "has no mesh: expected one of"),
    "flat mesh": (
        lambda f: _first(f, "textured.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"),
        "is flat",
    ),
    "words for numbers": (lambda f: _first(f, "textured.obj").write_text("v a b c\n"), "not three numbers"),
    "not finite": (lambda f: _first(f, "textured.obj").write_text("v nan 0 0\n"), "not finite"),
    "unknown symmetry": (
        lambda f: (f / "objects.json").write_text(json.dumps({p.name: {"symmetry": "round"} for p in f.iterdir()})),
        "setting 'symmetry'",
    ),
    "JSON that does not parse": (lambda f: (f / "objects.json").write_text("{"), "not valid JSON"),
    "empty": (lambda f: [shutil.rmtree(p) for p in f.iterdir()], "holds no object"),
    "absent": (shutil.rmtree, "is not a folder"),
    "one object": (lambda f: shutil.copytree(_first(f, "textured.obj").parent, f, dirs_exist_ok=True), "of one object"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_object_sets_are_answered_in_one_sentence(scans, tmp_path, case):
    damage, said = BAD[case]
    damage(scans)
    with pytest.raises(ToolkitError, match=said) as error:
        load_object_set(str(scans), tmp_path / "cache")
    assert "\n" not in str(error.value)


def test_surfaces_face_outwards(procedural):
    """A renderer leaves out what faces away: of a part that is inside out, it shows the inside of the far wall."""
    for asset in procedural.assets:
        mesh = trimesh.load(asset.mesh, force="mesh")
        places, where = np.unique(np.round(mesh.vertices, 6), axis=0, return_inverse=True)
        whole = trimesh.Trimesh(places, where.reshape(-1)[mesh.faces])  # the texture's seams closed
        whole.update_faces(whole.nondegenerate_faces())
        for part in whole.split(only_watertight=False):
            part.apply_translation(-part.vertices.mean(axis=0))  # some are open at their ends
            assert part.volume > 0, asset.name
