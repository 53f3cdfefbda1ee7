"""One rearrangement: perceive, plan, move, and perceive again, until everything stands at its goal (Sec. Method)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Literal

from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.pipeline import Pipeline
from toolkit.rearrangement.dependencies import lower_bound, screen
from toolkit.rearrangement.moves import Finished, Layout, Move, Outcome
from toolkit.rearrangement.sight import Sight, SightSettings, correct, look
from toolkit.rearrangement.stages import Executor, Planner
from toolkit.types import Failure, Float, Frame

MOST_MOVES = 200
"""Moves of one round after which it is broken off."""


class EpisodeSettings(SightSettings):
    """What the rearrangement itself decides, besides its stages."""

    rounds: int = Field(
        4, ge=1, description="Number of rounds of perceiving and moving; 1 is the paper's one-step setting."
    )
    observe: Literal["round", "move"] = Field(
        "round", description="Perceive anew before every round, or before every move (Algorithm 1, line 7)."
    )


@dataclass
class Episode:
    """What happened.

    Attributes:
        goal: the goal image.
        sight: the last look at the table; None where nothing could be perceived.
        failures: by goal object of that look, why it was not brought to its goal.
        broken: why nothing could be perceived.
        rounds: rounds in which something was to be moved.
        states: true (4, 4) poses by instance id after each of these, where the executor knows them.
        moves: by true instance id, how often an object was picked; id -1 where the executor does not know.
        buffer_moves: of these, to a free place.
        touching_moves: of these, with a contact that was not meant to be.
        moved_for: by goal object, the true instance id of what was last brought to its goal.
        forced_buffers: moves to a free place that the first look's goals need at least.
        time_ms: milliseconds of perception and planning, on this machine.
        motion_s: seconds of moving, on the robot's clock.
    """

    goal: Frame
    sight: Sight | None = None
    failures: dict[int, Failure] = field(default_factory=dict[int, Failure])
    broken: Failure | None = None
    rounds: int = 0
    states: list[Mapping[int, Float]] = field(default_factory=list[Mapping[int, Float]])
    moves: Counter[int] = field(default_factory=Counter[int])
    buffer_moves: Counter[int] = field(default_factory=Counter[int])
    touching_moves: Counter[int] = field(default_factory=Counter[int])
    moved_for: dict[int, int | None] = field(default_factory=dict[int, int | None])
    forced_buffers: int = 0
    time_ms: dict[str, float] = field(default_factory=lambda: {"perception": 0.0, "planning": 0.0})
    motion_s: float = 0.0

    @contextmanager
    def timed(self, what: str) -> Generator[None]:
        """Add the block's time to `time_ms`."""
        start = perf_counter()
        yield
        self.time_ms[what] += 1e3 * (perf_counter() - start)


@contextmanager
def begun(executor: Executor, task: Any) -> Generator[Frame]:
    """An executor at work on a task, which it lets go of in the end.

    Where it cannot take the task up it is not closed either: nothing hides why.

    Args:
        executor: which.
        task: what its `begin` is given.

    Yields:
        The goal image.
    """
    goal = executor.begin(task)
    with closing(executor):
        yield goal


def rearrange(
    goal: Frame, pipeline: Pipeline, planner: Planner, executor: Executor, settings: EpisodeSettings, seed: int
) -> Episode:
    """Carry out one rearrangement.

    Args:
        goal: the goal image of the executor's task.
        pipeline: the perception module.
        planner: decides the moves.
        executor: carries them out; it has begun its task, and closing it is left to the caller.
        settings: how often, and what counts as done.
        seed: of the planner's choices; the pipeline has its own.

    Raises:
        ToolkitError: a stage refuses its input.
    """
    episode = Episode(goal)
    for number in range(settings.rounds):
        sight = _perceive(episode, pipeline, executor, settings)
        if sight is None:
            break
        episode.sight, episode.failures = sight, dict(sight.failures)
        if number == 0:
            episode.forced_buffers = _forced_buffers(sight.layout)
        if not any(item.wanted for item in sight.layout.items):
            break
        episode.rounds += 1
        _carry_out(episode, sight, pipeline, planner, executor, settings, seed + number)
        state = executor.state()
        if state is not None:
            episode.states.append(state)
    executor.home()
    return episode


def _perceive(episode: Episode, pipeline: Pipeline, executor: Executor, settings: EpisodeSettings) -> Sight | None:
    """A stage that breaks on a scene fails that scene by name; the run goes on."""
    executor.home()
    frames = executor.observe()
    try:
        with episode.timed("perception"):
            return look(pipeline, frames, episode.goal, settings)
    except ToolkitError:
        raise
    except Exception as error:
        episode.broken = Failure("pipeline", f"{type(error).__name__}: {error}")
        return None


def _forced_buffers(layout: Layout) -> int:
    layout, _ = screen(layout)
    return lower_bound(layout) - sum(item.wanted for item in layout.items)


def _carry_out(
    episode: Episode,
    sight: Sight,
    pipeline: Pipeline,
    planner: Planner,
    executor: Executor,
    settings: EpisodeSettings,
    seed: int,
) -> None:
    """One round: ask for move after move."""
    schedule = planner.start(seed)
    for _ in range(MOST_MOVES):
        with episode.timed("planning"):
            step = schedule.next(sight.layout)
        if isinstance(step, Finished):
            _note_failures(episode, sight, step)
            return
        outcome = executor.pick_place(sight.request(step))
        _count(episode, sight, step, outcome)
        sight = sight.after_outcome(step, outcome)
        if settings.observe == "move":
            seen = _perceive(episode, pipeline, executor, settings)
            if seen is None:
                return
            sight = correct(sight, seen)
    unfinished = {i.object: Failure("planner", f"not finished after {MOST_MOVES} moves") for i in sight.layout.items}
    _note_failures(episode, sight, Finished(unfinished))


def _count(episode: Episode, sight: Sight, move: Move, outcome: Outcome) -> None:
    true_id = -1 if outcome.object is None else outcome.object
    episode.moves[true_id] += outcome.picks
    episode.buffer_moves[true_id] += outcome.picks - (move.to == "goal")
    episode.touching_moves[true_id] += outcome.touched
    episode.motion_s += outcome.seconds
    goal_object = sight.goal_objects.get(move.object)
    if goal_object is None:
        return
    if outcome.failure is not None:
        episode.failures[goal_object] = outcome.failure
    elif move.to == "goal":
        episode.failures.pop(goal_object, None)
        episode.moved_for[goal_object] = outcome.object


def _note_failures(episode: Episode, sight: Sight, finished: Finished) -> None:
    """Keep what an executor said of an object; it is nearer to the cause."""
    for instance, failure in finished.failures.items():
        goal_object = sight.goal_objects.get(instance)
        if goal_object is not None:
            episode.failures.setdefault(goal_object, failure)
