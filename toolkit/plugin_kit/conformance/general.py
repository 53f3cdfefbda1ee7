"""What every plugin must do, whatever its stage."""

from __future__ import annotations

import re
from typing import Any

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.kit import Check, Subject, require
from toolkit.registry import PluginConfig
from toolkit.weights.cards import CARDS, WeightCard


def it_says_what_it_is(subject: Subject) -> str:
    """Stage, name, version and a docstring, which `toolkit list` shows."""
    plugin: Any = subject.plugin
    require(re.fullmatch(r"[a-z0-9_]+", plugin.name), f"its name, '{plugin.name}', must be of a-z, 0-9 and _")
    require(isinstance(plugin.version, str) and plugin.version, "its version must be a string that is not empty")
    require((plugin.__doc__ or "").strip(), "its class has no docstring, which `toolkit list` would show")
    return f"version {plugin.version}"


def settings_are_frozen_and_described(subject: Subject) -> str:
    """Config is a PluginConfig, whose fields all have a description and whose unknown keys are refused."""
    config: Any = subject.plugin.Config
    require(issubclass(config, PluginConfig), "its Config must be a toolkit.registry.PluginConfig")
    require(config.model_config.get("frozen"), "its Config must be frozen")
    require(config.model_config.get("extra") == "forbid", "its Config must refuse unknown keys (extra='forbid')")
    for name, info in config.model_fields.items():
        require(info.description, f"setting '{name}' has no description: add Field(..., description=...)")
    return f"{len(config.model_fields)} settings"


def settings_survive_a_file(subject: Subject) -> None:
    """Written as JSON and read again, the settings are equal: they travel in experiments, rows and cache keys."""
    config = subject.make().config
    read = subject.plugin.Config.model_validate_json(config.model_dump_json())
    require(read == config, "its settings change when they are written as JSON and read again")


def weights_have_a_digest_and_a_licence(subject: Subject) -> str:
    """Every checkpoint is named with its sha256, and a weight card states its licence."""
    digests = subject.make().digests()
    cards = {name: card for card in (*CARDS.values(), *subject.plugin.cards) for name in (card.file, *card.companions)}
    licences: list[str] = []
    for name, sha256 in digests.items():
        require(re.fullmatch(r"[0-9a-f]{64}", sha256), f"digests() must give '{name}' a sha256 of 64 hex digits")
        card = next((card for file, card in cards.items() if name.endswith(file.rpartition("/")[2])), None)
        require(card, f"no weight card states the licence of '{name}': name one in the class attribute `cards`")
        assert card is not None
        licences.append(_licence(card))
    return "; ".join(dict.fromkeys(licences)) or "no weights"


def it_is_ready_or_says_what_it_lacks(subject: Subject) -> None:
    """check_ready() returns nothing, or raises ToolkitError with a sentence."""
    try:
        require(subject.make().check_ready() is None, "check_ready() must return nothing")
    except ToolkitError as error:
        require(str(error).strip(), "check_ready() raises ToolkitError without saying what is missing")


def _licence(card: WeightCard) -> str:
    return f"{card.name}: {card.licence}" + (", non-commercial" if card.non_commercial else "")


CHECKS: tuple[Check, ...] = (
    it_says_what_it_is,
    settings_are_frozen_and_described,
    settings_survive_a_file,
    it_is_ready_or_says_what_it_lacks,
    weights_have_a_digest_and_a_licence,
)
