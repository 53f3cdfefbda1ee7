"""What `estimate` prints: every motion in words, and what to look at, on 80 columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from toolkit.geometry import make_transform, rotation_z
from toolkit.results.answer import in_words, motions, to_look_at, why_nothing
from toolkit.types import Abstention, Failure, Finding, PoseEstimate, Segment

SEGMENT = Segment(np.ones((4, 4), bool))
TURN = make_transform(rotation_z(np.pi / 2)[:3, :3], np.array([0.3, 0.0, 0.0]))
POINTS = np.zeros((5, 3), np.float32)
ESTIMATES = [
    PoseEstimate(0, SEGMENT, 12, TURN, confidence=0.93),
    PoseEstimate(1, SEGMENT, 1, TURN, confidence=0.2, equivalents=np.stack([TURN, TURN]), ambiguity="symmetric"),
    PoseEstimate(2, SEGMENT, 2, TURN),
    PoseEstimate(3, SEGMENT, 3, None, Abstention("refiner", "confidence 0.02 is below 0.05")),
    PoseEstimate(4, SEGMENT, None, None, Failure("explainer", "it is new, or hidden in all frames")),
    PoseEstimate(5, SEGMENT, 5, None, Failure("matcher", "too few lifted matches (best candidate: 3, 6 needed)")),
]
WORDS = ["sure", "doubtful", "found", "withheld", "unknown", "failed"]


def printed(table):
    console = Console(width=80, no_color=True)
    with console.capture() as capture:
        console.print(table)
    return capture.get().splitlines()


def test_every_object_has_one_line_that_says_what_is_known_of_it():
    lines = printed(motions(ESTIMATES, [POINTS, POINTS, POINTS, POINTS, None, None]))
    rows = [line.split() for line in lines if line.strip()[:1].isdigit()]
    assert [row[0] for row in rows] == list("012345")
    assert [in_words(e) for e in ESTIMATES] == WORDS
    assert all(word in row for row, word in zip(rows, WORDS, strict=True))
    assert rows[0][1:] == ["#12", "sure", "93%", "30.0", "cm", "90.0", "deg"]
    assert rows[2][-4:] == ["30.0", "cm", "90.0", "deg"]
    assert max(map(len, lines)) <= 80


def test_doubts_come_with_their_reason_and_what_is_sure_without():
    doubts = list(to_look_at(ESTIMATES, [7, 8], [Finding("doubtful", "the goal image is nearly black", 0.3)]))
    assert doubts == [
        "the capture (doubtful): the goal image is nearly black",
        "object 1: the motion is doubtful; 1 other motion would look the same",
        "object 3: withheld: confidence 0.02 is below 0.05",
        "object 4: unknown: it is new, or hidden in all frames",
        "object 5: failed: too few lifted matches (best candidate: 3, 6 needed)",
        "not seen in the goal: #7, #8",
    ]
    assert not list(to_look_at(ESTIMATES[:1], [], []))


def test_what_holds_for_several_objects_is_said_once():
    alike = [replace(ESTIMATES[4], goal_object=number) for number in (4, 6, 9)]
    assert list(to_look_at([*alike[:2], ESTIMATES[3], alike[2]], [], [])) == [
        "objects 4, 6, 9: unknown: it is new, or hidden in all frames",
        "object 3: withheld: confidence 0.02 is below 0.05",
    ]


@pytest.mark.parametrize(
    ("estimates", "regions", "cause"),
    [([], 0, "stands out"), ([], 5, "goal image"), (ESTIMATES[3:], 5, "below 0.05")],
)
def test_nothing_found_is_one_sentence(estimates, regions, cause):
    sentence = why_nothing(estimates, regions)
    assert cause in sentence
    assert "\n" not in sentence
