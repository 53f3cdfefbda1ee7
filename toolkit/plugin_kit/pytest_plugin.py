"""The pytest plugin (entry point `pytest11`): one test a check for every class that derives from Conforms.

Every pytest run of an environment that has the toolkit loads this file, so it imports nothing heavy.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any


def pytest_generate_tests(metafunc: Any) -> None:
    """Parametrize `toolkit_check` by the checks of the class's plugin; skip them where it lacks something."""
    kit = sys.modules.get("toolkit.plugin_kit.conformance")
    if kit is None or metafunc.cls is None or not issubclass(metafunc.cls, kit.Conforms):
        return
    if "toolkit_check" in metafunc.fixturenames and hasattr(metafunc.cls, "plugin"):
        metafunc.parametrize("toolkit_check", kit.checks_of(metafunc.cls.plugin.stage), ids=kit.title)


def pytest_runtest_setup(item: Any) -> None:
    """Skip, with the plugin's own sentence, what lacks a checkpoint or a device."""
    if "toolkit_check" not in getattr(item, "fixturenames", ()) or not hasattr(item.cls, "plugin"):
        return
    import pytest

    lacking = _what_it_lacks(item.cls)
    if lacking is not None:
        pytest.skip(lacking)


@lru_cache
def _what_it_lacks(case: Any) -> str | None:
    from toolkit.errors import ToolkitError
    from toolkit.plugin_kit.conformance import Subject, make_ready

    try:
        make_ready(Subject(case.plugin, case.settings))
    except ToolkitError as error:
        return str(error)
    return None
