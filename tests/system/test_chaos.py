"""Hundreds of faults over real processes: every run finishes, with the bits of the quiet one.

DPPO_CHAOS_FAULTS=2000 makes it longer, DPPO_CHAOS_SEED=1 draws others.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest

from dppo.chaos.cast import Setup
from dppo.chaos.drill import ByClock, ByIteration, Drill
from dppo.chaos.plan import KINDS, Fault, Plan
from tests.support import ROOT, SMALL, checkpoints, is_alive, wait_until

pytestmark = pytest.mark.slow
ITERATIONS, PER_RUN = 80, 3 * len(KINDS)
FAULTS = int(os.environ.get("DPPO_CHAOS_FAULTS", 4 * PER_RUN))
SEED = int(os.environ.get("DPPO_CHAOS_SEED", "0"))
FLAGS = (
    "--env", "Hopper-v5", *SMALL, "--total-timesteps", str(ITERATIONS * 8 * 64),
    "--checkpoint-every", "5",
)  # fmt: skip
PATIENCE = 60.0


def drilled(folder, plan, *, flags=FLAGS, local_workers=1, workers=2, seed=0):
    folder.mkdir()
    setup = Setup(flags, local_workers, workers)
    return Drill(setup, ByIteration(plan, PATIENCE), folder, seed).run()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The hash of the run when nothing happens to it."""
    outcome = drilled(tmp_path_factory.mktemp("quiet") / "run", Plan(()), workers=0)
    assert (outcome.problem, outcome.left_behind) == ("", [])
    assert (outcome.status, outcome.iterations) == ("finished", ITERATIONS)
    return outcome.sha256


def test_hundreds_of_faults_of_every_kind_cost_no_bits(tmp_path, undisturbed):
    seeds = [SEED + number for number in range(-(-FAULTS // PER_RUN))]

    def disturbed(seed):
        plan = Plan.seeded(seed, faults=PER_RUN, iterations=ITERATIONS, workers=2)
        return drilled(tmp_path / str(seed), plan, seed=seed)

    with ThreadPoolExecutor(2) as pool:  # faults are waiting, mostly
        outcomes = list(pool.map(disturbed, seeds))
    for seed, outcome in zip(seeds, outcomes, strict=True):
        assert outcome.problem == "", f"seed {seed}"
        assert outcome.sha256 == undisturbed, f"seed {seed}"
        assert outcome.exact
        assert outcome.left_behind == [], f"seed {seed}"
    records = [record for outcome in outcomes for record in outcome.faults]
    assert sum(record.recovered is not None for record in records) >= min(FAULTS, 200)
    as_planned = Counter(record.fault.fault for record in records if not record.said)
    assert set(as_planned) == set(KINDS)


def test_a_run_that_cannot_go_on_is_ended_with_what_did_not_come(tmp_path):
    plan = Plan((Fault(5, "stop-worker", "w0"),))
    (tmp_path / "drill").mkdir()
    setup = Setup(FLAGS, 0, 1)
    outcome = Drill(setup, ByIteration(plan, 5.0), tmp_path / "drill").run()
    assert "did not come within 5 s; the last faults were stop-worker of w0" in outcome.problem
    assert outcome.left_behind == []
    assert len(outcome.faults) == 1
    assert outcome.faults[0].recovered is None


def test_a_learner_that_fails_by_itself_is_not_started_again(tmp_path):
    flags = (*FLAGS, "--env", "tests.odd_envs:Raises-v0")
    outcome = drilled(tmp_path / "drill", Plan(()), flags=flags)
    assert "ended with exit code 1, unasked" in outcome.problem
    assert "the arm fell off" in outcome.problem
    assert outcome.left_behind == []


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--env", "Nope-v1"], "error: the learner refuses the run: --env is 'Nope-v1', which"),
        (["--", "--drop", "8"], "refuses the run: Value error Error parsing rollout: --drop is 8"),
        (["--minutes", "1", "--env", "Nope-v1"], "the learner refuses the run: --env is 'Nope-v1"),
    ],
    ids=["environment", "flag", "soak"],
)
@pytest.mark.parametrize("there", [False, True])
def test_what_the_learner_refuses_is_wrong_usage_and_leaves_nothing(
    tmp_path, words, sentence, there
):
    out = tmp_path / "out"
    if there:
        out.mkdir()
    done = subprocess.run(
        chaos("--out", out, *words), cwd=ROOT, capture_output=True, text=True, check=False,
        timeout=120,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.rglob("*")) == ([out] if there else [])


def test_a_run_with_an_end_of_its_own_is_over_there(tmp_path):
    outcome = drilled(tmp_path / "drill", Plan(()), flags=(*FLAGS, "--stop-at", str(10 * 8 * 64)))
    assert (outcome.problem, outcome.status, outcome.iterations) == ("", "stopped", 10)
    assert outcome.left_behind == []


def test_a_soak_ends_in_time_with_a_run_that_can_be_continued(tmp_path):
    endless = (Fault(1, "kill-worker", f"w{turn % 2}") for turn in range(10**6))
    flags = (*FLAGS, "--total-timesteps", str(10**9))
    schedule = ByClock(endless, every=2.0, seconds=8.0)
    outcome = Drill(Setup(flags, 1, 2), schedule, tmp_path).run()
    assert (outcome.problem, outcome.status) == ("", "stopped")
    assert outcome.left_behind == []
    assert 1 <= len(outcome.faults) <= 3
    assert outcome.steps == outcome.iterations * 8 * 64 > 0
    assert len(checkpoints(tmp_path / "run")) >= 1


def chaos(*words):
    return [sys.executable, "-m", "dppo", "chaos", *map(str, words)]


def test_the_command_reports_faults_and_hashes(tmp_path):
    plan = tmp_path / "plan.json"
    plan.write_text(Plan((Fault(10, "kill-learner", "learner"),)).to_json())
    words = ("--plan", plan, "--out", tmp_path / "out", "--json", "--", "--total-timesteps", 10240)
    done = subprocess.run(
        chaos(*words), cwd=ROOT, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["same_bits"] is True
    assert report["undisturbed"]["iterations"] == report["disturbed"]["iterations"] == 20
    (fault,) = report["disturbed"]["faults"]
    assert (fault["fault"], fault["target"], fault["at"]) == ("kill-learner", "learner", 10)
    assert fault["recovered"] > 0
    assert json.loads((tmp_path / "out" / "chaos.json").read_text()) == report


@pytest.mark.parametrize("times", [1, 200])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_whoever_ends_a_drill_leaves_nothing_running(tmp_path, number, times):
    out = tmp_path / "out"
    drill = subprocess.Popen(
        chaos("--out", out, "--", "--total-timesteps", 10**9), cwd=ROOT, stdin=subprocess.DEVNULL
    )
    run = out / "undisturbed" / "run"
    wait_until(lambda: (run / "metrics.jsonl").exists(), "the learner to begin")
    learner, *workers = started_by(drill.pid)
    assert len(workers) == 3
    for _ in range(times):  # the second and later ones while it tidies up
        drill.send_signal(number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            drill.wait(0.001 if times > 1 else 30)
    assert drill.wait(30) == 128 + number
    try:
        wait_until(lambda: not any(map(is_alive, (learner, *workers))), "all to end", 10)
    finally:
        for pid in filter(is_alive, (learner, *workers)):
            os.kill(pid, signal.SIGKILL)


def started_by(pid):
    """The learner of a drill, and the learner's own workers."""
    from tests.support import descendants

    (learner,) = descendants(pid)
    return [learner, *descendants(learner)]
