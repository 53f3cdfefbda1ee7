"""Planners against brute force, and on puzzles that need objects to stand aside."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, milp

from toolkit.geometry import invert, make_transform, transform_points
from toolkit.rearrangement.feedback import feedback_vertex_set, is_acyclic
from toolkit.rearrangement.footprints import Footprint, gaps, planar_motion
from toolkit.rearrangement.moves import Finished, Item, Layout
from toolkit.rearrangement.planners.arrangements.running import fewest_running
from toolkit.rearrangement.planners.ordering.fewest import plan
from toolkit.rearrangement.planners.ordering.order import EXACT_UP_TO, shortest_order, travelled
from toolkit.rearrangement.planners.puzzles.rollout import rollout
from toolkit.rearrangement.planners.puzzles.suite import cycles, dense, roomy, shelf
from toolkit.stages import PLANNERS

BOX = 0.04 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def shift(x, y):
    return make_transform(np.eye(3), np.array([x, y, 0.0]))


def box(object_id, here, there=None, **changes):
    """An 8 cm box at (2,) `here` that is to go to `there`."""
    motion = None if there is None else shift(*(np.array(there) - here))
    return replace(Item.seen(object_id, BOX + np.array([*here, 0.0]), motion), **changes)


@pytest.fixture(params=PLANNERS.names())
def planner(request):
    return PLANNERS.create(request.param)


# Footprints


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_gaps_never_claim_more_room_than_there_is(seed):
    """Against the true distance of two sets of points, which that of their hulls cannot exceed."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(0, 0.05, (7, 2)), rng.normal(0, 0.05, (7, 2)) + rng.uniform(-0.3, 0.3, 2)
    gap = gaps(Footprint.of(a).support, Footprint.of(b).support)
    assert gap <= np.linalg.norm(a[:, None] - b[None], axis=2).min() + 1e-9
    inside = (a[0] + a[1] + a[2]) / 3
    assert gaps(Footprint.of(a).support, Footprint.of(inside[None]).support) <= 1e-9


def test_a_moved_footprint_is_that_of_the_moved_points():
    points = np.random.default_rng(0).normal(0, 0.05, (50, 3)) + np.array([0.2, 0.1, 0])
    footprint = Footprint.of(points)
    for steps in (0, 7, 90):
        T = planar_motion(footprint.center, np.array([0.1, -0.2]), steps)
        moved = footprint.moved(np.array([0.1, -0.2]), steps)
        np.testing.assert_allclose(moved.support, Footprint.of(transform_points(T, points)).support, atol=1e-12)


def test_a_box_is_as_wide_as_its_short_side():
    corners = np.array([[-0.1, -0.03, 0], [0.1, -0.03, 0], [0.1, 0.03, 0], [-0.1, 0.03, 0]])
    assert Footprint.of(corners).width == pytest.approx(0.06, abs=1e-9)
    assert Footprint.of(corners).reach(np.zeros(2)) == pytest.approx(np.hypot(0.1, 0.03), rel=1e-3)


# Feedback vertex sets and orders


graphs = st.integers(2, 7).flatmap(lambda n: st.lists(st.integers(0, 2**n - 1), min_size=n, max_size=n))


def without_loops(rows):
    return [row & ~(1 << i) for i, row in enumerate(rows)]


@settings(deadline=None, max_examples=300)
@given(graphs)
def test_feedback_vertex_sets_are_minimum(rows):
    graph = without_loops(rows)
    everything = (1 << len(graph)) - 1
    sizes = [mask.bit_count() for mask in range(everything + 1) if is_acyclic(graph, everything & ~mask)]
    found = feedback_vertex_set(graph)
    assert len(found.vertices) == min(sizes) == found.lower_bound
    assert is_acyclic(graph, everything & ~sum(1 << v for v in found.vertices))


@settings(deadline=None, max_examples=40)
@given(st.integers(2, 15), st.floats(0.05, 0.5), st.integers(0, 10_000))
def test_feedback_vertex_sets_are_as_small_as_integer_programming_says(count, density, seed):
    """The judge numbers the vertices that stay so that edges between them go up (Miller, Tucker and Zemlin, 1960)."""
    matrix = np.random.default_rng(seed).random((count, count)) < density
    np.fill_diagonal(matrix, False)
    edges = np.argwhere(matrix)
    rows = np.zeros((len(edges), 2 * count))  # chosen or not, then numbers
    for row, (i, j) in zip(rows, edges, strict=True):
        row[[i, j]] = count  # n (chosen_i + chosen_j) + number_j - number_i >= 1
        row[[count + j, count + i]] = 1, -1
    judge = milp(
        np.repeat([1, 0], count),
        integrality=np.repeat([1, 0], count),
        bounds=Bounds(0, np.repeat([1, count - 1], count)),
        constraints=LinearConstraint(rows, lb=1) if len(edges) else None,
    )
    assert judge.success
    found = feedback_vertex_set([sum(1 << j for j in map(int, np.flatnonzero(row))) for row in matrix])
    assert len(found.vertices) == found.lower_bound == round(judge.fun)


@settings(deadline=None, max_examples=60)
@given(graphs)
def test_no_order_has_fewer_running_buffers(rows):
    """Against all orders, by the number of items aside at a time."""
    graph = without_loops(rows)
    count = len(graph)
    found = fewest_running(graph, (1 << count) - 1, ~0, float)
    assert sorted(found) == list(range(count))
    if count <= 6:
        assert running(graph, found) == min(running(graph, order) for order in itertools.permutations(range(count)))


def test_only_what_may_wait_goes_aside():
    """A cycle of two beside one of three: with one vertex of each, the others go where they belong at once."""
    cycles = [0b00010, 0b00001, 0b01000, 0b10000, 0b00100]
    order = fewest_running(cycles, 0b11111, 0b01001, float)
    gone = 0
    for item in order:
        assert not cycles[item] & ~(gone | 0b01001)
        gone |= 1 << item


def running(graph, order):
    """The most items that are aside at a time."""
    done = aside = most = 0
    for item in order:
        aside = (aside | graph[item]) & ~done
        most = max(most, aside.bit_count())
        done |= 1 << item
        aside &= ~done
    return most


def test_large_graphs_are_bounded_from_both_sides():
    rng = np.random.default_rng(1)
    for density in (0.05, 0.15, 0.3):
        matrix = rng.random((40, 40)) < density
        graph = without_loops([sum(1 << j for j in map(int, np.flatnonzero(row))) for row in matrix])
        found = feedback_vertex_set(graph)
        chosen = sum(1 << v for v in found.vertices)
        assert is_acyclic(graph, ((1 << 40) - 1) & ~chosen)
        assert 0 < found.lower_bound <= len(found.vertices)


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 6), st.integers(0, 10_000))
def test_orders_are_the_shortest_that_precedence_allows(count, seed):
    rng = np.random.default_rng(seed)
    picks, places = rng.random((2, count, 2))
    before = [sum(1 << j for j in range(i) if rng.random() < 0.3) for i in range(count)]
    found = shortest_order(picks, places, before)
    allowed = [
        order
        for order in itertools.permutations(range(count))
        if all(order.index(j) < order.index(i) for i in range(count) for j in range(count) if before[i] >> j & 1)
    ]
    assert tuple(found) in allowed
    best = min(travelled(order, picks, places) for order in allowed)
    assert travelled(found, picks, places) == pytest.approx(best)


def test_many_moves_are_ordered_within_precedence():
    rng = np.random.default_rng(0)
    count = 3 * EXACT_UP_TO
    picks, places = rng.random((2, count, 2))
    before = [sum(1 << j for j in range(i) if rng.random() < 0.1) for i in range(count)]
    order = shortest_order(picks, places, before)
    assert sorted(order) == list(range(count))
    assert all(order.index(j) < order.index(i) for i in range(count) for j in range(count) if before[i] >> j & 1)
    assert travelled(order, picks, places) < travelled(range(count), picks, places)


# Puzzles


@pytest.mark.parametrize("make", [dense, shelf, lambda count, rng: dense(count, rng, 0.5, ring=0.0)])
@pytest.mark.parametrize("count", [6, 12])
def test_puzzles_have_no_overlap_before_and_after(make, count):
    layout = make(count, np.random.default_rng(count))
    items = layout.items
    goals = [item.goal or item.footprint for item in items]
    for where in ([item.footprint for item in items], goals):
        for a, b in itertools.combinations(where, 2):
            assert gaps(a.support, b.support) > 0
    assert all(layout.holds(item.footprint) and layout.holds(item.goal) for item in items if not item.fixed)
    assert sum(item.wanted for item in items) == count


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10_000))
def test_goals_of_cycles_do_not_overlap(seed):
    layout = cycles(6, 3, np.random.default_rng(seed))
    assert all(gaps(a.goal.support, b.goal.support) > 0 for a, b in itertools.combinations(layout.items, 2))


def test_half_the_area_of_a_dense_puzzle_is_covered():
    layout = dense(10, np.random.default_rng(0), 0.5, ring=0.0)
    covered = sum(area(item.footprint) for item in layout.items)
    assert covered == pytest.approx(0.5 * np.pi * layout.radius**2, rel=0.02)


def area(footprint):
    """Of an outline, from its support and the lengths of its edges along each direction."""
    h, step = footprint.support, 2 * np.pi / len(footprint.support)
    edges = (np.roll(h, 1) + np.roll(h, -1) - 2 * h * np.cos(step)) / np.sin(step)
    return float((h * edges).sum() / 2)


# Plans


def carry_out(layout, moves):
    """Check every move where it happens: nothing is touched, nothing leaves the table."""
    for move in moves:
        item = layout.item(move.object)
        assert not layout.in_the_way(move.footprint, of=move.object)
        assert layout.holds(move.footprint)
        assert not item.settled
        layout = layout.after(move)
    return layout


def true_place(item, moves):
    """(4, 4) motion that all moves of an item do together."""
    T = np.eye(4)
    for move in moves:
        if move.object == item.object:
            T = move.T_place_pick @ T
    return T


def test_every_roomy_puzzle_is_solved_without_a_collision(planner):
    for puzzle in roomy(seed=3, repeats=1):
        found = rollout(planner, puzzle.layout, seed=0)
        assert not found.failures
        check_end(puzzle.layout, found)


@pytest.fixture(scope="module")
def tight():
    rng = np.random.default_rng(2)
    return [dense(10, rng, fill, ring=0.0) for fill in (0.3, 0.4, 0.5)] + [shelf(8, rng)]


def test_without_room_whatever_is_not_given_up_gets_to_its_goal(planner, tight):
    for layout in tight:
        found = rollout(planner, layout, seed=0)
        check_end(layout, found)
        assert found.failures or len(found.moves) >= found.lower_bound


def check_end(layout, found):
    """Exactly the items that were not given up are at their goals, and there exactly."""
    end = carry_out(layout, found.moves)
    for item in layout.items:
        if item.wanted:
            assert end.item(item.object).settled == (item.object not in found.failures)
        if end.item(item.object).settled:
            np.testing.assert_allclose(true_place(item, found.moves), item.T_goal_current, atol=1e-9)


@pytest.mark.parametrize("name", ["monotone", "mcts", "trlb"])
def test_optimal_is_no_worse_than_the_literature_where_there_is_room(name):
    for puzzle in roomy(seed=1, repeats=1):
        best, other = (rollout(PLANNERS.create(n), puzzle.layout, 0) for n in ("optimal", name))
        assert len(best.moves) <= len(other.moves)


def test_the_monotone_solver_alone_gives_up_cycles():
    swap = (box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (0, 0)), box(2, (-0.3, 0), (-0.3, 0.2)))
    found = rollout(PLANNERS.create("monotone", {"perturbations": 0}), Layout(swap), seed=0)
    assert [move.object for move in found.moves] == [2] and set(found.failures) == {0, 1}
    assert found.failures[0].reason == "no way was found in 0 perturbations"


def test_a_search_ends_after_its_iterations():
    swap = Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (0, 0))))
    assert rollout(PLANNERS.create("mcts", {"iterations": 1}), swap, seed=0).failures
    assert not rollout(PLANNERS.create("mcts", {"iterations": 100}), swap, seed=0).failures


def test_lazy_buffers_take_a_place_that_is_free_only_for_as_long_as_it_is_needed():
    """Four boxes fill a shelf but for one place, which is the last one's goal: every other way out is blocked."""
    places = [-0.18, -0.09, 0.0, 0.09, 0.18]
    wall = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * (0.3, 0.1, 0)
    walls = [
        replace(Item.seen(9 + k, wall + np.array([0, y, 0]), None), fixed=True) for k, y in enumerate((-0.143, 0.143))
    ]
    goals = [1, 0, 2, 4]
    boxes = [box(k, (places[k], 0), (places[goal], 0)) for k, goal in enumerate(goals)]
    boxes[2] = replace(boxes[2], T_goal_current=None, goal=None)
    for name in ("trlb", "optimal"):
        found = rollout(PLANNERS.create(name), Layout((*boxes, *walls), radius=0.225), seed=0)
        assert not found.failures and len(found.moves) == found.lower_bound == 4


def test_optimal_is_proven_optimal_and_never_needs_more_moves_than_the_paper():
    optimal, paper = PLANNERS.create("optimal"), PLANNERS.create("paper")
    for puzzle in roomy(seed=0, repeats=3):
        best, greedy = rollout(optimal, puzzle.layout, 0), rollout(paper, puzzle.layout, 0)
        assert len(best.moves) <= len(greedy.moves)
        if len(puzzle.layout.items) <= 9:
            assert best.proven_optimal
        assert len(best.moves) <= 1.05 * best.lower_bound


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 6), st.integers(0, 10_000))
def test_plans_have_as_few_moves_as_brute_force_over_who_stands_aside(count, seed):
    """With room to stand aside, n + k moves are enough exactly where k objects moved away free all others in turn."""
    layout = dense(count, np.random.default_rng(seed))
    found = plan(layout)
    assert not found.failures
    carry_out(layout, found.moves)
    extra = next(
        k
        for k in range(count + 1)
        for aside in itertools.combinations(range(count), k)
        if _solved_in_turn(layout, set(aside))
    )
    assert len(found.moves) == count + extra


def _solved_in_turn(layout, aside):
    here = {item.object for item in layout.items} - aside
    waiting = {item.object for item in layout.items}
    while waiting:
        free = [
            i
            for i in waiting
            if all(
                j == i or gaps(layout.item(i).goal.support, layout.item(j).footprint.support) >= layout.clearance
                for j in here
            )
        ]
        if not free:
            return False
        waiting.discard(free[0])
        here.discard(free[0])
    return True


def test_the_same_seed_gives_the_same_moves(planner):
    layout = dense(9, np.random.default_rng(4))
    first, second = (rollout(planner, layout, seed=5) for _ in range(2))
    assert [m.T_place_pick.tobytes() for m in first.moves] == [m.T_place_pick.tobytes() for m in second.moves]


def test_a_swap_takes_three_moves(planner):
    found = rollout(planner, Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (0, 0)))), seed=0)
    assert len(found.moves) == found.lower_bound == 3 and found.buffer_moves == 1


def test_an_object_without_a_goal_makes_room_for_one_that_has():
    found = plan(Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0)))))
    assert [(move.object, move.to) for move in found.moves] == [(1, "buffer"), (0, "goal")]
    assert found.moves[0].reason == "it stands in the goal of object 0"
    assert found.proven_optimal


def test_settled_objects_stay_where_they_are(planner):
    found = rollout(planner, Layout((box(0, (0, 0), (0, 0), settled=True), box(1, (0.3, 0), (0.15, 0)))), seed=0)
    assert [move.object for move in found.moves] == [1]


GIVEN_UP = {
    "outside": ((box(0, (0, 0), (0.6, 0)),), "outside the reachable table"),
    "onto a settled one": (
        (box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (0.2, 0), settled=True)),
        "stands at its own goal",
    ),
    "onto a fixed one": ((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), fixed=True)), "object 1, which cannot be moved"),
    "fixed itself": ((box(0, (0, 0), (0.2, 0), fixed=True),), "cannot be moved"),
    "the less sure of two": (
        (box(0, (0, 0), (0.2, 0), confidence=0.4), box(1, (-0.2, 0), (0.21, 0), confidence=0.6)),
        "overlaps the goal of object 1",
    ),
}


@pytest.mark.parametrize("case", GIVEN_UP)
def test_goals_that_cannot_be_reached_are_named_and_the_rest_goes_on(case):
    items, said = GIVEN_UP[case]
    other = box(9, (0, -0.3), (0.1, -0.3))
    found = plan(Layout((*items, other)))
    assert said in found.failures[0].reason and found.failures[0].stage == "planner"
    assert 9 in {move.object for move in found.moves} and 0 not in {move.object for move in found.moves}
    assert not found.proven_optimal


def test_no_free_place_is_a_reason():
    """Two boxes that must change places on a table that holds no third."""
    swap = (box(0, (-0.045, 0), (0.045, 0)), box(1, (0.045, 0), (-0.045, 0)))
    found = plan(Layout(swap, radius=0.1))
    assert not found.moves
    assert any("no free place" in failure.reason for failure in found.failures.values())
    assert len(found.failures) == 2


def test_the_paper_s_loop_gives_up_by_name():
    stuck = Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0))))
    found = rollout(PLANNERS.create("paper", {"max_tries": 4, "max_failures": 9}), stuck, seed=0)
    assert not found.moves
    assert found.failures[0].reason == "given up after 4 passes: its goal is taken by object 1, again"


def test_a_failed_move_is_planned_again_and_then_worked_around():
    layout = Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (0.2, 0.2)), box(2, (-0.2, 0), (-0.2, 0.2))))
    schedule = PLANNERS.create("optimal", {"tries": 2}).start(0)
    tried = []
    while not isinstance(step := schedule.next(layout), Finished):
        tried.append(step.object)
        if step.object != 1:  # object 1 slips every time
            layout = layout.after(step)
    assert tried.count(1) == 2 and 2 in tried and 0 not in tried
    assert "cannot be moved" in step.failures[0].reason
    assert step.failures[1].reason == "it cannot be moved"


def test_a_turn_that_leaves_the_footprint_as_it_was_is_not_tried_for_ever():
    half_turn = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    layout = Layout((Item.seen(0, BOX, half_turn),))
    schedule = PLANNERS.create("optimal", {"tries": 2}).start(0)
    steps = [schedule.next(layout) for _ in range(3)]  # it slips every time
    assert [isinstance(step, Finished) for step in steps] == [False, False, True]


def test_the_newest_motion_is_the_one_that_is_carried_out():
    layout = Layout((box(0, (0, 0), (0.2, 0)), box(1, (0.2, 0), (-0.2, 0))))
    schedule = PLANNERS.create("optimal").start(0)
    layout = layout.after(schedule.next(layout))
    corrected = shift(0.201, 0.001)
    layout = layout.with_item(replace(layout.item(0), T_goal_current=corrected))
    np.testing.assert_array_equal(schedule.next(layout).T_place_pick, corrected)


def test_items_keep_their_goal_when_they_move_aside():
    item = box(0, (0, 0), (0.2, 0))
    layout = Layout((item, box(1, (0.2, 0), (0, 0))))
    first = plan(layout).moves[0]
    moved = layout.after(first).item(first.object)
    before = layout.item(first.object)
    np.testing.assert_allclose(moved.T_goal_current @ first.T_place_pick, before.T_goal_current, atol=1e-12)
    np.testing.assert_allclose(invert(moved.T_goal_current) @ moved.T_goal_current, np.eye(4), atol=1e-12)
