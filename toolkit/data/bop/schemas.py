"""What scene_camera.json, scene_gt.json and models_info.json must hold: a schema each, in the files' millimetres."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from toolkit.errors import ToolkitError
from toolkit.files import read_json

_MOST = 2**31 - 1
_LARGEST = 1e12
"""No length, in millimetres or pixels, is as large; squares and products of what is smaller are finite."""

_SHOWN = 60
"""Characters of a wrong value that an answer quotes."""


class Entry(BaseModel):
    """What a file says of one image, object or model. Other keys are kept, to be named."""

    model_config = ConfigDict(frozen=True, strict=True, extra="allow")


def _flat(value: Any) -> Iterable[Any]:
    if isinstance(value, list):
        for item in value:
            yield from _flat(item)
    else:
        yield value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not -_LARGEST < value < _LARGEST:
        raise ValueError
    return float(value)


def _numbers(*counts: int) -> BeforeValidator:
    """Any nesting of lists that holds so many numbers: 3x3 is 9, and 3x1 is 3."""

    def read(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list):
            raise ValueError
        numbers = tuple(map(_number, _flat(value)))
        if len(numbers) not in counts:
            raise ValueError
        return numbers

    return BeforeValidator(read)


def _whole(least: int) -> BeforeValidator:
    def read(value: Any) -> int:
        number = _number(value)
        if number != int(number) or not least <= number <= _MOST:
            raise ValueError
        return int(number)

    return BeforeValidator(read)


def _positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError
    return number


Numbers = tuple[float, ...]


class CameraEntry(Entry):
    """One image's camera in scene_camera.json."""

    cam_K: Annotated[Numbers, _numbers(9)] = Field(description="9 numbers, the camera matrix in pixels, row by row")
    cam_R_w2c: Annotated[Numbers, _numbers(9)] = Field(
        description="9 numbers, the rotation from world to camera, row by row"
    )
    cam_t_w2c: Annotated[Numbers, _numbers(3)] = Field(
        description="3 numbers, the translation from world to camera in millimetres"
    )
    depth_scale: Annotated[float | None, BeforeValidator(_positive)] = Field(
        None,
        description="a positive number, the millimetres of one unit of the depth image "
        "(1 for millimetres, 0.1 for tenths of them, 1000 for metres)",
    )
    width: Annotated[int | None, _whole(1)] = Field(None, description="a whole number of pixels, without quotes")
    height: Annotated[int | None, _whole(1)] = Field(None, description="a whole number of pixels, without quotes")
    cam_dist: Annotated[Numbers, _numbers(0, 4, 5, 8, 12, 14)] = Field(
        (), description="4, 5, 8, 12 or 14 numbers, the distortion k1 k2 p1 p2 [k3 ...] in OpenCV's order"
    )


class TrueEntry(Entry):
    """One object in one image of scene_gt.json."""

    obj_id: Annotated[int, _whole(0)] = Field(description="a whole number from 0 up, a key of models_info.json")
    inst_id: Annotated[int | None, _whole(0)] = Field(
        None, description="a whole number from 0 up, the same in every image and in the goal"
    )
    cam_R_m2c: Annotated[Numbers | None, _numbers(9)] = Field(
        None, description="9 numbers, the rotation from model to camera, row by row"
    )
    cam_t_m2c: Annotated[Numbers | None, _numbers(3)] = Field(
        None, description="3 numbers, the translation from model to camera in millimetres"
    )
    T_world_model: Annotated[Numbers | None, _numbers(16)] = Field(
        None, description="16 numbers, the pose from model to world in metres, row by row"
    )


class AxisEntry(Entry):
    """A continuous symmetry in models_info.json."""

    axis: Annotated[Numbers, _numbers(3)] = Field(description="3 numbers, a direction")
    offset: Annotated[Numbers, _numbers(3)] = Field(description="3 numbers, a point on the axis in millimetres")

    @model_validator(mode="after")
    def _is_a_direction(self) -> Self:
        if not any(self.axis):
            raise ValueError
        return self


_LEAST = Field(description="a number, the smallest coordinate of the model's box in millimetres")
_SIZE = Field(description="a number from 0 up, the size of the model's box in millimetres")
_Coordinate = Annotated[float, BeforeValidator(_number)]
_Length = Annotated[float, BeforeValidator(_number), Field(ge=0)]


class ModelEntry(Entry):
    """One model in models_info.json."""

    name: str = Field("", description="a text")
    diameter: Annotated[float, BeforeValidator(_positive)] = Field(
        description="a positive number, the largest distance between two points of the model in millimetres"
    )
    min_x: _Coordinate = _LEAST
    min_y: _Coordinate = _LEAST
    min_z: _Coordinate = _LEAST
    size_x: _Length = _SIZE
    size_y: _Length = _SIZE
    size_z: _Length = _SIZE
    symmetries_discrete: list[Annotated[Numbers, _numbers(16)]] = Field(
        default_factory=list[Numbers],
        description="a list of 16 numbers each, 4x4 transforms in millimetres, row by row",
    )
    symmetries_continuous: list[AxisEntry] = Field(
        default_factory=list[AxisEntry],
        description="a list of {axis: a direction, offset: a point in millimetres}",
    )


def read_cameras(path: Path, worlds: Mapping[int, TrueEntry] | None = None) -> dict[int, CameraEntry]:
    """Read scene_camera.json: image id -> camera, by rising id.

    Args:
        path: the file.
        worlds: by image, the object whose coordinates are the world, in place of what the file says; images without it
            are left out.

    Raises:
        ToolkitError: it is missing or damaged, lists no image, or an entry is not as `CameraEntry`; the sentence names
            file, image and key, and what belongs there.
    """
    entries = _by_id(path, "image")
    if worlds is not None:
        entries = {image: _in_world(entries[image], worlds[image]) for image in entries if image in worlds}
    if not entries:
        raise ToolkitError(f"'{path}' lists no image; it needs an entry for every image, such as \"0\": {{...}}")
    return {number: _checked(CameraEntry, value, path, f"image {number}") for number, value in entries.items()}


def _in_world(entry: Any, world: TrueEntry) -> Any:
    if not isinstance(entry, Mapping) or world.cam_R_m2c is None or world.cam_t_m2c is None:
        return entry
    return {**entry, "cam_R_w2c": list(world.cam_R_m2c), "cam_t_w2c": list(world.cam_t_m2c)}


def read_truth(path: Path, images: Iterable[int]) -> dict[int, list[TrueEntry]]:
    """Read scene_gt.json: the objects of every image that is asked for, by image id.

    Raises:
        ToolkitError: as `read_cameras`; or an image is not listed, or one instance stands in an image twice.
    """
    entries = _by_id(path, "image")
    truth: dict[int, list[TrueEntry]] = {}
    for image in images:
        where = f"image {image}"
        if image not in entries:
            raise ToolkitError(
                f"'{path}' lists no {where}, which scene_camera.json does; add it, as [] where it shows no object"
            )
        if not isinstance(entries[image], list):
            raise ToolkitError(f"'{path}', {where}: a list of objects is wanted, got {_quoted(entries[image])}")
        found = [_checked(TrueEntry, v, path, f"{where}, object {n}") for n, v in enumerate(entries[image])]
        named = [entry.inst_id for entry in found if entry.inst_id is not None]
        if len(named) not in (0, len(found)):
            raise ToolkitError(f"'{path}', {where}: some objects have an inst_id and some have none; give it to all")
        twice = next((number for number in named if named.count(number) > 1), None)
        if twice is not None:
            raise ToolkitError(f"'{path}', {where}: inst_id {twice} stands there twice; every object has its own")
        truth[image] = found
    return truth


def read_models(path: Path) -> dict[int, ModelEntry]:
    """Read models_info.json: object id -> model.

    Raises:
        ToolkitError: as `read_cameras`.
    """
    entries = _by_id(path, "object")
    return {number: _checked(ModelEntry, value, path, f"object {number}") for number, value in entries.items()}


def _by_id(path: Path, what: str) -> dict[int, Any]:
    data = read_json(path)
    if not isinstance(data, dict):
        raise ToolkitError(f"'{path}' must be a JSON object keyed by {what} id, got {_quoted(data)}")
    keys: dict[int, str] = {}
    for key in data:
        if not (key.isascii() and key.isdigit() and len(key) <= 10 and int(key) <= _MOST):
            raise ToolkitError(
                f"'{path}': the key {_quoted(key)} is no {what} id; ids are whole numbers from 0 up, such as \"0\""
            )
        if int(key) in keys:
            raise ToolkitError(f"'{path}': the keys '{keys[int(key)]}' and '{key}' are the same {what} id; remove one")
        keys[int(key)] = key
    return {number: data[keys[number]] for number in sorted(keys)}


EntryT = TypeVar("EntryT", bound=Entry)


def _checked(schema: type[EntryT], value: Any, path: Path, where: str) -> EntryT:
    if not isinstance(value, Mapping):
        raise ToolkitError(f"'{path}', {where}: an object {{...}} of its keys is wanted, got {_quoted(value)}")
    try:
        return schema.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        key = str(first["loc"][0])
        wanted = schema.model_fields[key].description
        if first["type"] == "missing" and len(first["loc"]) == 1:
            raise ToolkitError(f"'{path}', {where}: {key} is missing; it is {wanted}") from error
        raise ToolkitError(f"'{path}', {where}: {key} must be {wanted}; got {_quoted(value[key])}") from error


def _quoted(value: Any) -> str:
    """A value as JSON, cut to a length that a sentence can carry."""
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
