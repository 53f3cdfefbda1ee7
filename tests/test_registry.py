from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Protocol, TypeVar

import pytest
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig, Registry, load_plugin_file
from toolkit.stages import MATCHERS, REGISTRIES, register_module


class SomeConfig(PluginConfig):
    ratio: float = Field(0.8, gt=0, le=1)


class Some(Plugin):
    stage, name, Config = "thing", "some", SomeConfig


class Other(Plugin):
    stage, name = "thing", "some"


class Thing(Protocol):
    @abstractmethod
    def work(self) -> int:
        """Work."""


class Worker(Plugin[SomeConfig], Thing):
    stage, name = "thing", "worker"

    def work(self) -> int:
        return round(10 * self.config.ratio)


class Idle(Plugin[SomeConfig], Thing):
    stage, name = "thing", "idle"


class OtherConfig(SomeConfig):
    more: int = Field(7)


SomeConfigT = TypeVar("SomeConfigT", bound=SomeConfig)


class Family(Plugin[SomeConfigT], Thing):
    stage = "thing"


class Member(Family[OtherConfig]):
    name = "member"

    def work(self) -> int:
        return self.config.more


class Child(Worker):
    name = "child"


@pytest.fixture
def registry() -> Registry:
    return Registry("thing", "toolkit.things", {"builtin": "no.such.module:Class"})


def test_names_need_no_import(registry):
    registry.register(Some, "here")
    assert registry.names() == ["builtin", "some"]


def test_settings_are_checked_and_the_nearest_key_is_offered(registry):
    registry.register(Some, "here")
    assert registry.create("some", {"ratio": 0.5}).config.ratio == 0.5
    with pytest.raises(ToolkitError, match="unknown setting 'ratoi'; did you mean 'ratio'"):
        registry.create("some", {"ratoi": 0.5})
    with pytest.raises(ToolkitError, match="less than or equal to 1"):
        registry.create("some", {"ratio": 2})


def test_the_settings_class_is_what_stands_in_the_brackets(registry):
    registry.register(Worker, "here")
    assert Worker.Config is SomeConfig and registry.create("worker", {"ratio": 0.5}).work() == 5
    assert Family.Config is SomeConfig and Member.Config is OtherConfig and Member().work() == 7
    assert Child.Config is SomeConfig and Child(SomeConfig(ratio=0.1)).work() == 1
    assert Other.Config is PluginConfig and Some.Config is SomeConfig


def test_a_method_that_is_lacking_is_named(registry):
    registry.register(Idle, "here")
    with pytest.raises(ToolkitError, match=r"thing 'idle' from here lacks work; toolkit\.stages says"):
        registry.create("idle")


def test_an_unknown_name_is_answered_with_the_nearest(registry):
    registry.register(Some, "here")
    with pytest.raises(ToolkitError, match="unknown thing 'sime'; did you mean 'some'"):
        registry.get("sime")


def test_a_broken_plugin_breaks_only_when_chosen(registry):
    registry.register(Some, "here")
    assert registry.get("some") is Some
    with pytest.raises(ToolkitError, match="'builtin' from toolkit cannot be loaded: ModuleNotFoundError"):
        registry.get("builtin")


def test_two_plugins_of_one_name_are_an_error_that_names_both(registry):
    registry.register(Some, "first")
    registry.register(Other, "second")
    with pytest.raises(ToolkitError, match=r"first .*Some.* and second .*Other"):
        registry.get("some")


def test_registering_the_same_class_again_is_harmless(registry):
    registry.register(Some, "here")
    registry.register(Some, "here")
    assert registry.get("some") is Some


def test_a_plugin_file_is_loaded_and_registered():
    path = Path(__file__).parent.parent / "docs/examples/orb_matcher.py"
    assert register_module(load_plugin_file(path), str(path)) == 1
    assert MATCHERS.create("orb", {"max_features": 100}).config.max_features == 100
    assert len([line for line in path.read_text().splitlines() if line]) <= 40


def test_a_plugin_file_that_is_absent_or_broken_is_said_to_be_so(tmp_path):
    with pytest.raises(ToolkitError, match="does not exist"):
        load_plugin_file(tmp_path / "absent.py")
    broken = tmp_path / "broken.py"
    broken.write_text("import no_such_library")
    with pytest.raises(ToolkitError, match="cannot be loaded: ModuleNotFoundError"):
        load_plugin_file(broken)


@pytest.mark.parametrize("stage", list(REGISTRIES))
def test_every_builtin_loads_and_says_what_it_is(stage):
    for entry in REGISTRIES[stage].entries():
        plugin = REGISTRIES[stage].get(entry.name)
        assert (plugin.stage, plugin.name) == (stage, entry.name)
        assert plugin.__doc__
        assert all(info.description for info in plugin.Config.model_fields.values())
