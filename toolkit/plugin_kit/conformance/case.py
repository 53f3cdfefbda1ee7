"""A plugin's own tests: a class that names the plugin; the pytest plugin makes one test a check of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from toolkit.plugin_kit.conformance.kit import Check, Subject, run_check
from toolkit.registry import Plugin


class Conforms:
    """Base of test classes; `toolkit.plugin_kit.pytest_plugin` fills in `toolkit_check`.

    Attributes:
        plugin: the class under test.
        settings: settings that differ from its defaults.
    """

    plugin: ClassVar[type[Plugin]]
    settings: ClassVar[Mapping[str, Any]] = {}

    def test_conforms(self, toolkit_check: Check) -> None:
        """The plugin passes one check of its stage."""
        outcome = run_check(toolkit_check, Subject(self.plugin, self.settings))
        assert outcome.passed, f"{self.plugin.stage} '{self.plugin.name}': {outcome.check}: {outcome.note}"
