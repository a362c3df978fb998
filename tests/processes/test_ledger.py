"""The ledger: its lines, what is noted, and what a replay makes of it."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from dppo.config import Config, RolloutConfig, RunConfig, UpdateConfig
from dppo.deadlines import Deadlines
from dppo.errors import RunFailedError, UsageError
from dppo.rounds import Round, RoundId
from dppo.store.checkpoint import sha256
from dppo.store.ledger import (
    IterationLine,
    LateLine,
    Line,
    UpdateLine,
    from_json,
    read_ledger,
    to_json,
)
from dppo.wire.messages import Collected
from learner.disk import Disk
from learner.dropping import Accounts
from learner.ledger import Ledger
from learner.replay import Original
from learner.runlog import RunLog

UPDATE = UpdateLine(iteration=3, update=5, dropped=(4, 6), waited=0.01, parameters="1a2b")
LATE = LateLine(iteration=3, update=5, late=4, by=0.2)
DONE = IterationLine(iteration=3, parameters_sha256="3c4d")
FULL = IterationLine(iteration=3, parameters_sha256="3c", returns=(1.5, None), lengths=(9.0, None))
ZEROS, ONES = np.zeros(3, np.float32), np.ones(3, np.float32)
CONFIG = Config(
    run=RunConfig(total_timesteps=4 * 4 * 8),
    rollout=RolloutConfig(slots=4, num_envs=1, num_steps=8, drop=2),
    update=UpdateConfig(update_epochs=1, num_minibatches=2),
)
"""Four iterations of two updates."""


def collected(slot, *episodes):
    return Collected(
        worker="w1", generation=1, iteration=1, round=0, slot=slot, obs=np.zeros(5),
        returns=np.zeros(3), advantages=np.zeros(7), fit=np.zeros(7), sigma_target=np.zeros(3),
        reward=np.zeros(3), start_sigma=np.zeros(3), exact=True, snapshot=b"",
        episodes=np.array(episodes, np.float64),
    )  # fmt: skip


def closed(update, *taken, iteration=1):
    round_ = Round[str](RoundId(1, iteration, 1 + update), range(4), quorum=2)
    for slot in taken:
        round_.offer(round_.id, (slot, 1), "gradient")
    return round_


@pytest.mark.parametrize("line", [UPDATE, LATE, DONE, FULL], ids=lambda line: type(line).__name__)
def test_a_line_is_read_as_it_was_written(line):
    assert from_json(to_json(line)) == line


def test_a_line_of_a_run_without_drops_has_nothing_but_the_hash():
    assert json.loads(to_json(DONE)) == {"iteration": 3, "parameters_sha256": "3c4d"}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[]", "found a list, expected an object"),
        ("{", "Expecting property name"),
        ("{}", "missing"),
        ('{"iteration": "three"}', "found 'three', expected a whole number from 0"),
        ('{"iteration": true}', "found True, expected a whole number from 0"),
        ('{"iteration": 1, "update": 2}', "missing"),
        (to_json(UPDATE).replace("[4, 6]", "4"), "found 4, expected a list of slots"),
        (to_json(UPDATE).replace("[4, 6]", "[-4]"), "found -4, expected a whole number"),
        (to_json(UPDATE).replace('"1a2b"', "12"), "found 12, expected a hash"),
        (to_json(UPDATE).replace("0.01", '"soon"'), "found 'soon', expected seconds"),
        (to_json(FULL).replace("[1.5, null]", "[[]]"), "expected a number or null of each slot"),
        ('{"iteration": 1, "parameters_sha256": "a", "mood": 3}', "mood belongs to no line"),
    ],
)
def test_what_is_no_line_is_refused(text, complaint):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        from_json(text)


def test_a_torn_last_line_is_left_out_and_a_bad_one_is_named(tmp_path):
    file = tmp_path / "ledger.jsonl"
    file.write_text(f"{to_json(UPDATE)}\n{to_json(LATE)}\n{to_json(DONE)[:20]}")
    assert read_ledger(file) == [UPDATE, LATE]
    file.write_text(f"{to_json(UPDATE)}\nnonsense\n{to_json(DONE)}\n")
    with pytest.raises(UsageError, match=r"ledger\.jsonl, line 2 is no line of a ledger"):
        read_ledger(file)
    with pytest.raises(UsageError, match="is not a readable ledger"):
        read_ledger(tmp_path / "none")


def test_a_resumed_run_cuts_its_ledger_to_the_iterations_that_count(tmp_path):
    lines = [replace(line, iteration=k) for k in range(4) for line in (UPDATE, LATE, DONE)]
    file = tmp_path / "ledger.jsonl"
    file.write_text("".join(to_json(line) + "\n" for line in lines) + '{"iter')
    noted: list[Line] = []
    disk = Disk(tmp_path, "the run's logs")
    log = RunLog(tmp_path, 2, disk, noted.append)  # iterations 0 and 1 are done
    assert noted == lines[:6]
    log.note(replace(DONE, iteration=2))
    log.close()
    assert read_ledger(file) == [*lines[:6], replace(DONE, iteration=2)]


def test_a_damaged_line_does_not_keep_a_run_from_going_on(tmp_path, caplog):
    torn = to_json(UPDATE).replace("dropped", "dripped")
    (tmp_path / "ledger.jsonl").write_text(f"{torn}\n{to_json(DONE)}\n")
    noted: list[Line] = []
    RunLog(tmp_path, 5, Disk(tmp_path, "the run's logs"), noted.append).close()
    assert noted == [DONE]
    assert "left out of the accounts of dropping, a line of ledger.jsonl: found" in caplog.text


def test_each_update_leaves_a_line_with_its_drops_and_its_hash():
    written: list[Line] = []
    ledger = Ledger(CONFIG.rollout, written.append)
    assert ledger.updated(closed(0, 0, 1, 2, 3), ZEROS) == 0
    late = closed(1, 3, 0)
    late.waited = 0.1234567
    assert ledger.updated(late, ONES) == 2
    ledger.iterated(1, ONES, [collected(0, 5, 2, 7, 4), *(collected(slot) for slot in (1, 2, 3))])
    first, second, done = written
    assert first == UpdateLine(
        iteration=1, update=0, dropped=(), waited=0.0, parameters=sha256(ZEROS)[:16]
    )
    assert second == UpdateLine(
        iteration=1, update=1, dropped=(1, 2), waited=0.123457, parameters=sha256(ONES)[:16]
    )
    assert done == IterationLine(
        iteration=1, parameters_sha256=sha256(ONES), returns=(6.0, None, None, None),
        lengths=(3.0, None, None, None),
    )  # fmt: skip


def test_late_answers_leave_their_lines_where_they_came():
    written: list[Line] = []
    deadlines = Deadlines(4, drop_limit=8)
    ledger = Ledger(CONFIG.rollout, written.append, deadlines)
    round_ = closed(0)
    deadlines.open(round_, 0.0)
    for slot in (0, 1):
        round_.offer(round_.id, (slot, 1), "gradient")
        deadlines.answered(round_.id, (slot, 1), 0.5)
    deadlines.close(round_, 1.0)
    ledger.updated(round_, ZEROS)
    deadlines.answered(round_.id, (3, 1), 1.25)
    ledger.iterated(1, ZEROS, [collected(slot) for slot in range(4)])
    assert [type(line) for line in written] == [UpdateLine, LateLine, IterationLine]
    assert written[0] == UpdateLine(
        iteration=1, update=0, dropped=(2, 3), waited=1.0, parameters=sha256(ZEROS)[:16]
    )
    assert written[1] == LateLine(iteration=1, update=0, late=3, by=0.25)


def test_without_drops_only_iterations_leave_lines():
    written: list[Line] = []
    ledger = Ledger(replace(CONFIG.rollout, drop=0), written.append)
    ledger.updated(closed(0, 0, 1, 2, 3), ZEROS)
    ledger.iterated(1, ONES, [collected(0, 5, 2)])
    assert written == [IterationLine(iteration=1, parameters_sha256=sha256(ONES))]
    assert ledger.slots(1, 0) == (0, 1, 2, 3)


def test_a_resumed_run_does_not_forget_how_often_a_slot_was_dropped_running():
    deadlines = Deadlines(4, drop_limit=2)
    once, twice = replace(UPDATE, dropped=(1,)), replace(UPDATE, dropped=(1, 2))
    before: list[Line] = [once, twice, DONE]
    deadlines.resume(Accounts.of(4, before).running)
    round_ = closed(0)
    deadlines.open(round_, 0.0)
    assert round_.required == {1}


def short(array):
    return sha256(array)[:16]


def lines_of_a_run():
    """Iteration 0, then two with two updates each."""
    lines: list[Line] = [IterationLine(iteration=0, parameters_sha256=sha256(ZEROS))]
    for iteration in (1, 2):
        for update, dropped in ((0, (iteration,)), (1, ())):
            lines.append(
                UpdateLine(
                    iteration=iteration, update=update, dropped=dropped, waited=0.1,
                    parameters=short(ONES),
                )
            )  # fmt: skip
        lines.append(IterationLine(iteration=iteration, parameters_sha256=sha256(ONES)))
    return lines


def write_run(folder, lines):
    folder.mkdir(exist_ok=True)
    (folder / "config.json").write_text('{"versions": {}}')
    (folder / "ledger.jsonl").write_text("".join(to_json(line) + "\n" for line in lines))
    return folder


def test_a_replay_asks_those_that_the_original_went_on_with(tmp_path):
    original = Original.read(write_run(tmp_path, lines_of_a_run()), CONFIG)
    ledger = Ledger(CONFIG.rollout, print, original=original)
    assert [ledger.slots(i, u) for i in (1, 2) for u in (0, 1)] == [
        (0, 2, 3), (0, 1, 2, 3), (0, 1, 3), (0, 1, 2, 3),
    ]  # fmt: skip


def test_an_update_that_nobody_finished_does_not_count(tmp_path):
    more = UpdateLine(iteration=3, update=0, dropped=(3,), waited=0.1, parameters="99")
    original = Original.read(write_run(tmp_path, [*lines_of_a_run(), more]), CONFIG)
    assert len(original.iterations) == 3
    assert f"same bits as {tmp_path}: 3 iterations, 4 updates, param" in original.verdict


def test_a_replay_names_the_first_update_that_differs(tmp_path):
    written: list[Line] = []
    original = Original.read(write_run(tmp_path, lines_of_a_run()), CONFIG)
    ledger = Ledger(CONFIG.rollout, written.append, original=original)
    ledger.iterated(0, ZEROS, [])
    ledger.updated(closed(0, 0, 2, 3), ONES)
    sentence = f"iteration 1, update 1 is the first that differs from {tmp_path}: parameters "
    sentence += f"{short(ZEROS)} here, {short(ONES)} in its ledger"
    with pytest.raises(RunFailedError, match=re.escape(sentence)):
        ledger.updated(closed(1, 0, 1, 2, 3), ZEROS)
    assert len(written) == 3  # what differs is in the replay's own ledger


def test_a_replay_of_a_run_without_drops_names_the_iteration(tmp_path):
    config = replace(CONFIG, rollout=replace(CONFIG.rollout, drop=0))
    lines = [line for line in lines_of_a_run() if isinstance(line, IterationLine)]
    original = Original.read(write_run(tmp_path, lines), config)
    ledger = Ledger(config.rollout, print, original=original)
    ledger.iterated(0, ZEROS, [])
    with pytest.raises(RunFailedError, match=r"^iteration 1 is the first that differs"):
        ledger.iterated(1, ZEROS, [])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda lines: lines[:0], "it has no finished iteration yet"),
        (lambda lines: lines[1:], "found the line of iteration 1, expected 0"),
        (lambda lines: [*lines[:2], *lines[3:]], "iteration 1, update 1 has no line"),
        (
            lambda lines: [lines[0], replace(lines[1], dropped=(0, 1, 2)), *lines[2:]],
            "iteration 1, update 0 went on without slots [0, 1, 2], expected at most 2 of 0 to 3",
        ),
        (
            lambda lines: [lines[0], replace(lines[1], dropped=(4,)), *lines[2:]],
            "went on without slots [4], expected at most 2 of 0 to 3",
        ),
        (
            lambda lines: [lines[0], replace(lines[1], dropped=(1, 1)), *lines[2:]],
            "went on without slots [1, 1]",
        ),
        (
            lambda lines: [replace(lines[0], iteration=k) for k in range(5)],
            "found 5 iterations, expected 4 at most",
        ),
    ],
)
def test_a_ledger_that_cannot_be_followed_is_refused(tmp_path, change, complaint):
    write_run(tmp_path, change(lines_of_a_run()))
    sentence = f"{tmp_path / 'ledger.jsonl'} cannot be replayed: "
    with pytest.raises(UsageError, match=re.escape(sentence) + ".*" + re.escape(complaint)):
        Original.read(tmp_path, CONFIG)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(UsageError, match="holds no run to replay"):
        Original.read(tmp_path / "none", CONFIG)
