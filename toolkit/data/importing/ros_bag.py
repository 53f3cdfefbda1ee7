"""A recording of ROS 1 or 2 and its messages, read by rosbags."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from toolkit.data.importing.recording import library
from toolkit.errors import ToolkitError, suggest

Array = TypeVar("Array")


class Bag:
    """A recording whose messages are read again whenever they are asked for."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._rosbags = library("rosbags.highlevel", "ros", "the import kind 'ros'")
        stores = library("rosbags.typesys", "ros", "the import kind 'ros'")
        self._store = stores.get_typestore(stores.Stores.LATEST)

    def gather(
        self, needed: Mapping[str, Callable[[Any], Any]], others: Mapping[str, Callable[[Any], Any]]
    ) -> dict[str, list[tuple[int, Any]]]:
        """By topic, when each message was recorded (nanoseconds), and what a function has of it.

        Raises:
            ToolkitError: of the needed topics one is unknown, or has no message.
        """
        topics = {**needed, **others}
        found: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
        with self._open() as reader:
            for topic in needed:
                if topic not in reader.topics or not reader.topics[topic].msgcount:
                    known = suggest(topic, [name for name, info in reader.topics.items() if info.msgcount])
                    raise ToolkitError(f"'{self._source}' has nothing of the topic {topic}{known}")
            connections = [c for c in reader.connections if c.topic in topics]
            for connection, at, data in reader.messages(connections):
                message = reader.deserialize(data, connection.msgtype)
                found[connection.topic].append((at, topics[connection.topic](message)))
        return found

    def pick(self, topic: str, decode: Callable[[Any], Array], times: Sequence[int]) -> dict[int, Array]:
        """By time of recording, some messages of a topic."""
        found: dict[int, Array] = {}
        with self._open() as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            for time in times:
                for connection, at, data in reader.messages(connections, start=time, stop=time + 1):
                    found[at] = decode(reader.deserialize(data, connection.msgtype))
        return found

    @contextmanager
    def _open(self) -> Generator[Any]:
        try:
            with self._rosbags.AnyReader([self._source], default_typestore=self._store) as reader:
                yield reader
        except ToolkitError:
            raise
        except Exception as error:
            # rosbags reports damaged files in a dozen ways.
            said = " ".join(str(error).split())
            raise ToolkitError(f"'{self._source}' is no recording of ROS that can be read: {said}") from error
