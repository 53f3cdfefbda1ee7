"""The checks a plugin must pass, for `toolkit check STAGE NAME` and for a plugin's own tests:

from toolkit.plugin_kit.conformance import Conforms

class TestMine(Conforms):
    plugin = MyMatcher
"""

from toolkit.plugin_kit.conformance.case import Conforms
from toolkit.plugin_kit.conformance.kit import (
    Check,
    ConformanceError,
    Outcome,
    Subject,
    check_plugin,
    checks_of,
    make_ready,
    require,
    run_check,
    title,
)

__all__ = [
    "Check",
    "ConformanceError",
    "Conforms",
    "Outcome",
    "Subject",
    "check_plugin",
    "checks_of",
    "make_ready",
    "require",
    "run_check",
    "title",
]
