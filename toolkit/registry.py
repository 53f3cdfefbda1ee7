"""One Registry per stage: built-ins named in a table, third parties by entry point or by file, imported when chosen."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from typing_extensions import TypeVar

from toolkit.errors import ToolkitError, suggest

if TYPE_CHECKING:
    from toolkit.weights.cards import WeightCard


class PluginConfig(BaseModel):
    """Base of every plugin's settings: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class StageChoice(BaseModel):
    """A stage's implementation by name, with its settings: `sift`, or `{name: sift, ratio: 0.8}`.

    Experiments choose so, and so do plugins that work with another stage: a setting of this type that is read by
    `Registry.choose` is checked, and written out, with the plugin's own.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    name: str

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: Any) -> Any:
        return {"name": value} if isinstance(value, str) else value

    @property
    def settings(self) -> dict[str, Any]:
        """The implementation's own settings."""
        return dict(self.model_extra or {})


ConfigT = TypeVar("ConfigT", bound=PluginConfig, default=PluginConfig, covariant=True)


class Plugin(Generic[ConfigT]):
    """Base of every stage implementation: `class Mine(Plugin[MineConfig], Matcher)`, with the stage's Protocol.

    Attributes:
        stage: the stage it implements, singular, as on the command line.
        name: how users choose it.
        version: part of every cache key; raise it when outputs change for reasons the source does not show.
        Config: the class of its settings, which is what stands in the brackets; or set by hand.
        config: its settings.
        weights: names of the weight cards of every checkpoint that its settings can choose.
        cards: cards of its checkpoints that the toolkit does not know; they state the licence, and
            `toolkit.weights.resolve.resolve_weights` finds and fetches what they name.
    """

    stage: ClassVar[str]
    name: ClassVar[str]
    version: ClassVar[str] = "1"
    Config: ClassVar[type[PluginConfig]] = PluginConfig
    weights: ClassVar[tuple[str, ...]] = ()
    cards: ClassVar[tuple[WeightCard, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "Config" not in vars(cls):
            for base in vars(cls).get("__orig_bases__", ()):
                if issubclass(get_origin(base) or object, Plugin):
                    (config,) = get_args(base)
                    # Of a family of plugins, the settings that all members have.
                    cls.Config = getattr(config, "__bound__", config)

    def __init__(self, config: ConfigT | None = None) -> None:
        self.config = config if config is not None else cast(ConfigT, self.Config())

    def check_ready(self) -> None:
        """Raise ToolkitError when something it needs (a checkpoint, a device) cannot be had.

        Called before any work starts.
        """

    def digests(self) -> dict[str, str]:
        """sha256 by name of the weights it uses; part of every cache key and named in the result rows."""
        return {}


StageT = TypeVar("StageT")


@dataclass(frozen=True)
class Entry:
    """Where one implementation lives: `module:attribute`, and who provides it."""

    name: str
    target: str
    origin: str
    load: Callable[[], Any]


class Registry(Generic[StageT]):
    """The implementations of one stage, by name.

    Args:
        stage: singular stage name, as on the command line.
        group: the entry-point group third parties use.
        builtins: name -> `module:Class`; nothing is imported until the name is chosen.
    """

    def __init__(self, stage: str, group: str, builtins: dict[str, str]) -> None:
        self.stage = stage
        self.group = group
        self._entries: dict[str, list[Entry]] = {
            name: [Entry(name, target, "toolkit", lambda target=target: _import(target))]
            for name, target in builtins.items()
        }
        self._scanned = False

    def register(self, plugin: type[Any], origin: str) -> None:
        """Add a class; `origin` names who provides it in messages. Registering the same class again is harmless."""
        target = f"{plugin.__module__}:{plugin.__qualname__}"
        entry = Entry(plugin.name, target, origin, lambda: plugin)
        others = [e for e in self._entries.get(plugin.name, []) if (e.target, e.origin) != (target, origin)]
        self._entries[plugin.name] = [*others, entry]

    def names(self) -> list[str]:
        """All names, sorted; nothing is imported."""
        self._scan()
        return sorted(self._entries)

    def entries(self) -> list[Entry]:
        """All entries, sorted by name; nothing is imported."""
        self._scan()
        return [entry for name in sorted(self._entries) for entry in self._entries[name]]

    def get(self, name: str) -> type[Plugin]:
        """Import and return the class registered as `name`.

        Raises:
            ToolkitError: unknown name (the nearest is offered), two providers of one name, or a plugin that does not
                import.
        """
        self._scan()
        if name not in self._entries:
            raise ToolkitError(f"unknown {self.stage} '{name}'{suggest(name, self.names())}")
        entries = self._entries[name]
        if len(entries) > 1:
            origins = " and ".join(f"{e.origin} ({e.target})" for e in entries)
            raise ToolkitError(f"two plugins are called {self.stage} '{name}': {origins}; rename or remove one")
        try:
            loaded = entries[0].load()
        except Exception as error:
            raise ToolkitError(
                f"{self.stage} '{name}' from {entries[0].origin} cannot be loaded: {type(error).__name__}: {error}"
            ) from error
        if not (isinstance(loaded, type) and issubclass(loaded, Plugin)):
            raise ToolkitError(f"{self.stage} '{name}' from {entries[0].origin} is not a toolkit Plugin class")
        lacking = sorted(getattr(loaded, "__abstractmethods__", ()))
        if lacking:
            raise ToolkitError(
                f"{self.stage} '{name}' from {entries[0].origin} lacks {' and '.join(lacking)}; "
                "toolkit.stages says what each must do"
            )
        return loaded

    def create(self, name: str, settings: dict[str, Any] | None = None) -> StageT:
        """Make the implementation `name` with `settings` checked against its Config.

        Raises:
            ToolkitError: as `get`; or a setting is unknown (the nearest is offered) or does not fit.
        """
        plugin = self.get(name)
        return cast(StageT, plugin(self.config(plugin, settings or {})))

    def choose(self, value: Any, default: str | None = None) -> StageChoice:
        """Read a choice of this stage, with its settings checked and every default written out.

        Args:
            value: `sift`, `{name: sift, ratio: 0.8}`, or a StageChoice.
            default: whose settings they are where no name is given.

        Raises:
            ToolkitError: as `create`; or there is no name.
        """
        if default is not None and isinstance(value, Mapping):
            value = {"name": default, **value}
        choice = validated(StageChoice, value, self.stage)
        config = self.config(self.get(choice.name), choice.settings)
        return StageChoice(name=choice.name, **config.model_dump(mode="json"))

    def config(self, plugin: type[Plugin], settings: dict[str, Any]) -> PluginConfig:
        """Check `settings` against `plugin.Config`; raises ToolkitError with the key and the reason."""
        return validated(plugin.Config, settings, f"{self.stage} '{plugin.name}'")

    def _scan(self) -> None:
        if self._scanned:
            return
        self._scanned = True
        for point in entry_points(group=self.group):
            origin = point.dist.name if point.dist is not None else point.value
            self._entries.setdefault(point.name, []).append(Entry(point.name, point.value, origin, point.load))


ModelT = TypeVar("ModelT", bound=BaseModel)


def validated(model: type[ModelT], settings: Any, what: str) -> ModelT:
    """Build a pydantic model, turning its first error into one sentence.

    Raises:
        ToolkitError: an unknown key (the nearest is offered) or a value that does not fit.
    """
    try:
        return model.model_validate(settings)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            hint = suggest(str(first["loc"][-1]), list(model.model_fields)) if len(first["loc"]) == 1 else ""
            raise ToolkitError(f"{what}: unknown setting '{path}'{hint}") from error
        where = f"{what}: setting '{path}'" if path else what
        said = first["msg"].removeprefix("Value error, ")
        raise ToolkitError(f"{where}: {said} (got {first.get('input')!r})") from error


def load_plugin_file(path: Path) -> Any:
    """Import a plugin file that is not installed (`--plugin my_matcher.py`) and return its module.

    Raises:
        ToolkitError: there is no such file, or it does not import.
    """
    if not path.is_file():
        raise ToolkitError(f"plugin file '{path}' does not exist")
    name = f"toolkit_plugin_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ToolkitError(f"plugin file '{path}' is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ToolkitError(f"plugin file '{path}' cannot be loaded: {type(error).__name__}: {error}") from error
    return module


def _import(target: str) -> Any:
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
