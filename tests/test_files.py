"""Files and folders are there whole or not at all."""

from __future__ import annotations

import ast
import json
import os
import stat
from pathlib import Path

import pytest

import toolkit
from toolkit.errors import ToolkitError
from toolkit.files import is_whole, make_once, new_file, write_bytes, write_json
from toolkit.paths import cache_root

DAY_S = 24 * 3600


def write_two(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "one").write_text("one")
    (folder / "two").write_text("two")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_is_made_once(tmp_path):
    made = []
    place = tmp_path / "deep" / "set"
    for _ in range(2):
        assert make_once(place, lambda folder: (made.append(folder), write_two(folder))) == place
    assert len(made) == 1 and (place / "sub" / "one").read_text() == "one"
    assert names(tmp_path / "deep") == ["set"]


DAMAGE = {
    "a file is lost": lambda place: (place / "two").unlink(),
    "a file is cut": lambda place: (place / "sub" / "one").write_text("o"),
    "an older version made it": lambda place: (place / ".whole.json").unlink(),
    "its list is cut": lambda place: (place / ".whole.json").write_text('{"two": 3'),
    "its list is another thing": lambda place: (place / ".whole.json").write_text("[1]"),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_what_is_not_whole_is_made_again(case, tmp_path):
    place = make_once(tmp_path / "set", write_two)
    assert is_whole(place)
    DAMAGE[case](place)
    assert not is_whole(place)
    make_once(place, write_two)
    assert is_whole(place) and (place / "two").read_text() == "two" and (place / "sub" / "one").read_text() == "one"
    assert names(tmp_path) == ["set"]


def test_a_place_that_is_taken_meanwhile_is_accepted(tmp_path):
    place = tmp_path / "set"

    def slow(folder: Path) -> None:
        write_two(folder)
        make_once(place, lambda other: (write_two(other), (other / "first").write_text("")))

    make_once(place, slow)
    assert (place / "first").exists() and names(tmp_path) == ["set"]


def test_nothing_is_left_of_what_breaks(tmp_path):
    def broken(folder: Path) -> None:
        write_two(folder)
        raise ValueError

    with pytest.raises(ValueError):
        make_once(tmp_path / "set", broken)
    with pytest.raises(ValueError), new_file(tmp_path / "file") as temporary:
        temporary.write_text("half")
        raise ValueError
    assert names(tmp_path) == []


def test_what_a_killed_process_left_is_ignored_and_removed_in_time(tmp_path):
    left = [tmp_path / f".{name}.17.abcdef.tmp" for name in ("set", "file", "other")]
    for path in left[:1]:
        path.mkdir()
        write_two(path)
    for path in left[1:]:
        path.write_text("half")
    make_once(tmp_path / "set", write_two)
    write_bytes(tmp_path / "file", b"whole")
    assert names(tmp_path) == [".file.17.abcdef.tmp", ".other.17.abcdef.tmp", ".set.17.abcdef.tmp", "file", "set"]
    for path in left:
        os.utime(path, (0, path.stat().st_mtime - 2 * DAY_S))
    (tmp_path / "set" / "two").unlink()
    make_once(tmp_path / "set", write_two)
    write_bytes(tmp_path / "file", b"whole")
    assert names(tmp_path) == [".other.17.abcdef.tmp", "file", "set"]


def test_what_is_written_can_be_read_by_whom_a_plain_file_can(tmp_path):
    """A cache may be shared by a group: no private modes, as those of temporary files often are."""
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "file").write_text("")
    make_once(tmp_path / "made", write_two)
    write_json(tmp_path / "made" / "file", {})
    for name in ("", "file"):
        modes = [stat.S_IMODE((tmp_path / folder / name).stat().st_mode) for folder in ("plain", "made")]
        assert modes[0] == modes[1]


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolkitError, match=r"cannot be written: .*\$TOOLKIT_CACHE") as error:
        make_once(tmp_path / "file" / "set", write_two)
    assert "\n" not in str(error.value)


def test_there_is_no_second_road():
    """Who renames, or invents temporary names to keep, does not use `toolkit.files`."""
    root, found = Path(toolkit.__file__).parent, []
    for path in sorted(root.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                name, arguments = node.func.attr, len(node.args)
                if name in ("rename", "mkdtemp", "mkstemp") or (
                    name == "replace" and (arguments, node.keywords) == (1, [])
                ):
                    found.append(str(path.relative_to(root)))
    # A download that was cut off is kept under a name of its own for whoever goes on with it.
    assert sorted(set(found)) == ["files.py", "weights/download.py"]


def test_json_ends_in_a_line(tmp_path):
    write_json(tmp_path / "x.json", {"a": 1})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": 1} and (tmp_path / "x.json").read_text()[-1] == "\n"


def test_without_a_home_the_cache_has_to_be_named(monkeypatch, tmp_path):
    monkeypatch.delenv("TOOLKIT_CACHE", raising=False)
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    with pytest.raises(ToolkitError, match=r"no home folder; name one for the cache in \$TOOLKIT_CACHE"):
        cache_root()
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path))
    assert cache_root() == tmp_path
