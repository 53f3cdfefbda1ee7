"""Pipeline slots by stage. Imports nothing, so that the command line starts at once."""

SLOTS: dict[str, str] = {
    "registration": "registration",
    "segmenter": "segmenter",
    "goal_segmenter": "segmenter",
    "associator": "associator",
    "explainer": "explainer",
    "descriptor": "descriptor",
    "index": "index",
    "retriever": "retriever",
    "matcher": "matcher",
    "pnp": "pnp",
    "refiner": "refiner",
}
"""Pipeline slot -> the stage that fills it. Every slot is a command-line option and a key under `pipeline`."""

REARRANGE_SLOTS: dict[str, str] = {"planner": "planner", "executor": "executor"}
"""The same under `rearrange`: options of `toolkit rearrange` only."""
