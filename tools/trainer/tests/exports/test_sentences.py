"""The robot's sentences about what happened."""

from __future__ import annotations

import re
from pathlib import Path

from embodied_depth_trainer.exports.sentences import ERROR, LOST, OK, WARN, Sentence, Sentences

REPOSITORY = Path(__file__).resolve().parents[4]
NO_PARALLAX = {"event": "no_depth", "why": "too_little_parallax"}
NO_FRAME = {"event": "no_depth", "why": "no_frame"}
REACHED = {"event": "goal_reached"}


def logged(*texts: str) -> list[Sentence]:
    return [Sentence(OK, text) for text in texts]


def test_ticks_in_a_row_without_depth_have_the_sentence_of_the_first() -> None:
    sentences = Sentences()
    steps = [
        # Events, what the recording holds, and what was said.
        ([NO_PARALLAX], ["no depth: too little parallax"], ["no depth: too little parallax"]),
        ([NO_PARALLAX], [], ["no depth: too little parallax"]),
        ([NO_PARALLAX, REACHED], ["goal reached"], ["no depth: too little parallax", "goal reached"]),
        ([NO_FRAME], ["no depth: no image arrived"], ["no depth: no image arrived"]),
        ([], ["depth again"], []),
        ([NO_FRAME], ["no depth: no image arrived"], ["no depth: no image arrived"]),
    ]
    for events, held, said in steps:
        assert sentences.of(events, logged(*held)) == logged(*said)


def test_an_event_without_its_sentence_is_named() -> None:
    assert Sentences().of([REACHED], []) == logged("goal reached")


def test_levels_are_those_of_ros() -> None:
    assert [Sentence.logged(level, "").level for level in (1, 2, 3, 4, 5)] == [OK, OK, WARN, ERROR, ERROR]


def test_reasons_of_being_lost_are_the_words_of_the_robots_program() -> None:
    source = (REPOSITORY / "runtime/src/recording/sentences.rs").read_text()
    words = re.findall(r'LostReason::(\w+) => "(.*)"', source)
    assert words
    assert {re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower(): text for name, text in words} == LOST
