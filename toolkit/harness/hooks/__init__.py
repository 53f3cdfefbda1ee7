"""What follows a run and tells others of it: one file per service."""

from toolkit.harness.hooks.hook import RunHook
from toolkit.registry import Registry

HOOKS: Registry[RunHook] = Registry(
    "hook", "toolkit.hooks", {"tensorboard": "toolkit.harness.hooks.tensorboard:TensorBoard"}
)
"""Hooks by name (`--log NAME`); other distributions add theirs behind the entry point `toolkit.hooks`."""
