"""Plans of faults: drawn again the same, read back the same, and refused with a sentence."""

import json
from collections import Counter

import pytest

from dppo.chaos.plan import AT_ONCE, KINDS, Fault, Plan
from dppo.errors import UsageError


def drawn(seed=0, faults=50, **others):
    return Plan.seeded(seed, faults=faults, **({"iterations": 100, "workers": 2} | others))


def test_the_same_seed_draws_the_same_plan_and_another_seed_another():
    assert drawn() == drawn()
    assert drawn() != drawn(seed=1)


def test_each_kind_comes_once_before_any_comes_twice():
    assert set(Counter(one.fault for one in drawn(faults=len(KINDS)).faults).values()) == {1}
    counts = Counter(one.fault for one in drawn(faults=3 * len(KINDS) + 1).faults)
    assert sorted(counts.values()) == [3] * (len(KINDS) - 1) + [4]


def test_faults_come_in_the_order_of_their_iterations_and_leave_the_end_of_the_run_free():
    places = [one.at for one in drawn(faults=500).faults]
    assert places == sorted(places)
    assert min(places) == 2
    assert max(places) == 90


def test_what_happens_in_an_instant_has_no_length_and_all_else_has_one():
    for fault in drawn(faults=500).faults:
        assert (fault.seconds == 0) or (0.5 <= fault.seconds <= 3)
        assert fault.seconds > 0 or fault.fault in (*AT_ONCE, "stop-worker")


def test_the_first_worker_is_never_stopped_for_ever():
    stopped = [
        (one.target, one.seconds == 0)
        for one in drawn(faults=2000, local_workers=0).faults
        if one.fault == "stop-worker"
    ]
    assert ("w1", True) in stopped
    assert ("w0", False) in stopped
    assert ("w0", True) not in stopped


def test_without_external_workers_no_link_is_disturbed():
    targets = {one.target for one in drawn(workers=0, local_workers=2).faults}
    assert targets == {"learner", "local-0", "local-1", "x0", "x1", "x2"}


def test_only_the_kinds_that_were_asked_for_are_drawn():
    faults = drawn(kinds=("loss", "kill-worker"), faults=10).faults
    assert {one.fault for one in faults} == {"loss", "kill-worker"}


def test_a_run_that_is_too_short_or_has_no_worker_is_refused():
    with pytest.raises(ValueError, match="a run of 9 iterations is too short, expected at least"):
        drawn(iterations=9)
    with pytest.raises(ValueError, match="there is no worker to disturb"):
        drawn(workers=0, local_workers=0)


def test_a_plan_is_read_back_as_it_was_written(tmp_path):
    file = tmp_path / "plan.json"
    file.write_text(drawn().to_json())
    assert Plan.read(file) == drawn()
    file.write_text(Plan(()).to_json())
    assert Plan.read(file) == Plan(())


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ({"at": 0, "fault": "loss", "target": "w0", "seconds": 1}, "at is 0, expected an iter"),
        (
            {"at": 1, "fault": "lose", "target": "w0", "seconds": 1},
            "fault is 'lose', expected one",
        ),
        ({"at": 1, "fault": "loss", "target": "local-0", "seconds": 1}, "a name such as w0"),
        ({"at": 1, "fault": "kill-worker", "target": "w"}, "a name such as w0 or local-0"),
        ({"at": 1, "fault": "kill-learner", "target": "w0"}, "a name such as learner"),
        ({"at": 1, "fault": "join-worker", "target": "w0"}, "a name such as x0"),
        ({"at": 1, "fault": "loss", "target": "w0"}, "loss needs seconds > 0"),
        ({"at": 1, "fault": "loss", "target": "w0", "seconds": float("nan")}, "a finite number"),
        ({"at": 1, "fault": "disconnect", "target": "w0", "seconds": 1}, "leave seconds out"),
        ({"at": True, "fault": "loss", "target": "w0"}, "at is True, of the wrong type"),
        ({"at": 1, "fault": "loss"}, "target is missing"),
        ({"at": 1, "who": "w0"}, "'who' is no field of a fault"),
        ("loss", "it is a str, expected an object"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused_with_its_place(tmp_path, row, sentence):
    good = {"at": 1, "fault": "kill-worker", "target": "w0"}
    file = tmp_path / "plan.json"
    file.write_text(json.dumps([good, row]))
    with pytest.raises(UsageError, match="fault 1: ") as raised:
        Plan.read(file)
    assert sentence in str(raised.value)


@pytest.mark.parametrize("text", ["{", "{}", ""])
def test_a_file_that_holds_no_list_is_refused(tmp_path, text):
    file = tmp_path / "plan.json"
    file.write_text(text)
    with pytest.raises(UsageError, match=r"is not a readable JSON file|holds a dict, expected"):
        Plan.read(file)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (Fault(20, "kill-learner", "learner"), "the run ends with iteration 20"),
        (Fault(1, "kill-worker", "w2"), "planned for w2, but there are 2 external workers"),
        (Fault(1, "kill-worker", "local-1"), "planned for local-1, but there are 2 external"),
    ],
)
def test_a_plan_that_the_run_cannot_carry_out_is_refused(fault, sentence):
    plan = Plan((Fault(19, "kill-worker", "w1"), Fault(1, "kill-worker", "local-0"), fault))
    with pytest.raises(UsageError, match=sentence):
        plan.check(iterations=20, workers=2, local_workers=1)


def test_a_plan_that_stops_every_worker_for_ever_is_refused():
    plan = Plan((Fault(1, "stop-worker", "w0"), Fault(2, "stop-worker", "w1")))
    plan.check(iterations=20, workers=3, local_workers=0)
    plan.check(iterations=20, workers=2, local_workers=1)
    with pytest.raises(UsageError, match="stops every worker for ever"):
        plan.check(iterations=20, workers=2, local_workers=0)
