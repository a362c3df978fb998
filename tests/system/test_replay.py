"""A run that went on without late slots is run again from its ledger, bit for bit."""

import json
import signal
import time
from dataclasses import replace

import pytest

from dppo.store.ledger import IterationLine, LateLine, UpdateLine, read_ledger, to_json
from learner.local import free_address
from tests.support import DEADLINE, SMALL, Harness, iterations, result, wait_until

TINY = ("--env", "CartPole-v1", *SMALL)
DROPPING = (*TINY, "--update-epochs", "8", "--num-minibatches", "4", "--drop", "2",
            "--drop-limit", "5")  # fmt: skip
SAMPLES, UPDATES, LIMIT = 8 * 64, 32, 5


def drops(run_dir):
    """Gradients that updates went on without, so far."""
    lines = (run_dir / "ledger.jsonl").read_text().splitlines()
    return sum(len(json.loads(line).get("dropped", ())) for line in lines if line.endswith("}"))


def stop_now_and_then(worker, run_dir, times):
    """Stop and continue a worker until so many of its stops have cost it an update."""
    for _ in range(times):
        before, last = drops(run_dir), time.monotonic() + DEADLINE
        while drops(run_dir) == before:
            assert time.monotonic() < last, "no update went on without the stopped worker"
            worker.send(signal.SIGSTOP)
            until = time.monotonic() + 0.3  # in a collection it is waited for: then try again
            while drops(run_dir) == before and time.monotonic() < until:
                time.sleep(0.01)
            worker.send(signal.SIGCONT)


@pytest.fixture(scope="module")
def dropped(tmp_path_factory):
    """Stopped by a signal in the middle, then resumed: four workers of two slots, one is late."""
    harness = Harness(tmp_path_factory.mktemp("dropped"))
    run_dir, address = harness.folder / "run", free_address()
    command = (*DROPPING, "--local-workers", "0", "--listen", address, "--checkpoint-every", "5")
    workers = [harness.worker(address) for _ in range(4)]
    learner = harness.learner(*command, run_dir=run_dir)
    wait_until(lambda: iterations(run_dir) >= 3, "three iterations")
    stop_now_and_then(workers[0], run_dir, times=3)
    begun = iterations(run_dir)  # the one under way would be given up, and its drops with it
    wait_until(lambda: iterations(run_dir) > begun, "the iteration of the last drop to finish")
    learner.send(signal.SIGTERM)
    assert learner.wait() == 0, learner.text
    steps = (iterations(run_dir) + 20) * SAMPLES
    learner = harness.learner(*command, "--stop-at", str(steps), run_dir=run_dir)
    assert learner.wait() == 0, learner.text
    harness.end()
    return run_dir


@pytest.mark.slow
def test_the_ledger_adds_up(dropped):
    outcome, lines = result(dropped), read_ledger(dropped / "ledger.jsonl")
    done = [line for line in lines if isinstance(line, IterationLine)]
    updates = [line for line in lines if isinstance(line, UpdateLine)]
    assert [line.iteration for line in done] == list(range(outcome["iterations"]))
    assert done[-1].parameters_sha256 == outcome["parameters_sha256"]
    assert [(line.iteration, line.update) for line in updates] == [
        (iteration, update) for iteration in range(1, len(done)) for update in range(UPDATES)
    ]
    assert done[-1].parameters_sha256.startswith(updates[-1].parameters)
    assert outcome["dropped_gradients"] == sum(len(line.dropped) for line in updates) > 0
    accepted = [1 - sum(s in line.dropped for line in updates) / len(updates) for s in range(8)]
    assert outcome["acceptance"] == pytest.approx(accepted, abs=1e-12)
    running = [0] * 8
    for line in updates:
        assert len(line.dropped) <= 2
        running = [running[s] + 1 if s in line.dropped else 0 for s in range(8)]
        assert max(running) <= LIMIT
    gone = {(line.iteration, line.update, slot) for line in updates for slot in line.dropped}
    late = [line for line in lines if isinstance(line, LateLine)]
    assert {(line.iteration, line.update, line.late) for line in late} <= gone
    assert all(line.by >= 0 for line in late)
    assert late


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "3"])
def test_it_is_replayed_with_other_workers_to_the_same_bits(dropped, harness, workers):
    out = harness.folder / "again"
    process = harness.start(
        "dppo", "replay", str(dropped), "--local-workers", workers, "--out", str(out)
    )
    assert process.wait() == 0, process.text
    outcome = result(dropped)
    assert f"same bits as {dropped}: {outcome['iterations']} iterations" in process.text
    again = result(out)
    for name in ("parameters_sha256", "iterations", "dropped_gradients", "acceptance"):
        assert again[name] == outcome[name]


@pytest.mark.slow
@pytest.mark.parametrize("change", ["hash", "slots"])
def test_an_altered_line_is_found_and_named(dropped, harness, change):
    lines = read_ledger(dropped / "ledger.jsonl")
    line = [each for each in lines if isinstance(each, UpdateLine) and each.dropped][1]
    other = {"parameters": "0" * 16} if change == "hash" else {"dropped": [7 - line.dropped[0]]}
    altered = json.loads(to_json(line)) | other
    run = harness.folder / "altered"
    run.mkdir()
    (run / "config.json").write_bytes((dropped / "config.json").read_bytes())
    texts = [to_json(each) for each in lines]
    texts[lines.index(line)] = json.dumps(altered)
    (run / "ledger.jsonl").write_text("".join(text + "\n" for text in texts))
    process = harness.start("dppo", "replay", str(run), "--local-workers", "1")
    assert process.wait() == 1, process.text
    sentence = f"iteration {line.iteration}, update {line.update} is the first that differs"
    assert sentence in process.text
    assert "Traceback" not in process.text
    assert result(run / "replay")["status"] == "failed"


@pytest.mark.slow
def test_a_run_without_drops_that_was_paused_and_resumed_is_replayed(harness):
    run_dir = harness.folder / "run"
    command = (*TINY, "--total-timesteps", str(8 * SAMPLES), "--local-workers", "2")
    harness.train(*command, "--stop-at", str(3 * SAMPLES), run_dir=run_dir)
    outcome = harness.train(*command, run_dir=run_dir)
    assert outcome["acceptance"] is None
    process = harness.start("dppo", "replay", str(run_dir), "--local-workers", "1")
    assert process.wait() == 0, process.text
    assert f"same bits as {run_dir}: 8 iterations, parameters_sha256" in process.text
    assert result(run_dir / "replay")["status"] == "finished"

    again = harness.start("dppo", "replay", str(run_dir))
    assert again.wait() == 2
    sentence = f"{run_dir / 'replay'} holds a finished replay of {run_dir}; remove it to begin"
    assert sentence in again.text

    config = run_dir / "config.json"
    config.write_text(config.read_text().replace('"obs_size": 4', '"obs_size": 5'))
    out = str(harness.folder / "elsewhere")
    other = harness.start("dppo", "replay", str(run_dir), "--out", out, "--local-workers", "1")
    assert other.wait() == 2, other.text
    assert f"{run_dir} was trained on another environment" in other.text

    ledger = run_dir / "ledger.jsonl"
    ledger.write_text(ledger.read_text().replace("parameters", "paramours"))
    out = str(harness.folder / "out")
    broken = harness.start("dppo", "replay", str(run_dir), "--out", out)
    assert broken.wait() == 2
    assert "ledger.jsonl, line 1 is no line of a ledger" in broken.text
    assert "Traceback" not in broken.text
    assert not (harness.folder / "out").exists()


@pytest.mark.slow
def test_a_replay_that_is_interrupted_does_not_say_that_the_bits_are_the_same(harness):
    run_dir = harness.folder / "run"
    steps = str(200 * SAMPLES)
    harness.train(*TINY, "--total-timesteps", steps, "--local-workers", "2", run_dir=run_dir)
    process = harness.start("dppo", "replay", str(run_dir), "--local-workers", "1")
    wait_until(lambda: iterations(run_dir / "replay") >= 1, "an iteration of the replay")
    process.send(signal.SIGTERM)
    assert process.wait() == 1, process.text
    assert "of 200 iterations: not compared to the end" in process.text
    done = result(run_dir / "replay")["iterations"]
    assert done < 200

    again = harness.start("dppo", "replay", str(run_dir), "--local-workers", "2")
    assert again.wait() == 0, again.text
    assert f"resuming at iteration {done} of 200" in again.text
    assert f"same bits as {run_dir}: 200 iterations" in again.text
    assert iterations(run_dir / "replay") == 200


@pytest.mark.slow
def test_a_replay_goes_on_only_in_its_own_folder_and_with_the_original_it_began_with(harness):
    run_dir, other = harness.folder / "run", harness.folder / "other"
    steps = str(200 * SAMPLES)
    for folder, stop in ((run_dir, 30), (other, 2)):
        words = ("--total-timesteps", steps, "--stop-at", str(stop * SAMPLES))
        harness.train(*TINY, *words, "--local-workers", "2", run_dir=folder)
    replay = ("dppo", "replay", str(run_dir), "--local-workers", "1", "--out")
    for foreign in (run_dir, other):
        before = contents(foreign)
        refused = harness.start(*replay, str(foreign))
        assert refused.wait() == 2, refused.text
        sentence = f"{foreign} holds a run that is no replay of {run_dir}; give another folder"
        assert sentence in refused.text
        assert contents(foreign) == before

    out = str(harness.folder / "out")
    whole = harness.start(*replay, out)
    assert whole.wait() == 0, whole.text
    assert f"same bits as {run_dir}: 30 iterations" in whole.text
    lines = read_ledger(run_dir / "ledger.jsonl")
    assert isinstance(lines[4], IterationLine)
    lines[4] = replace(lines[4], parameters_sha256="0" * 64)
    (run_dir / "ledger.jsonl").write_text("".join(to_json(line) + "\n" for line in lines))
    altered = harness.start(*replay, out)
    assert altered.wait() == 1, altered.text
    assert f"iteration 4 is the first that differs from {run_dir}" in altered.text
    assert "Traceback" not in altered.text


def contents(folder):
    """Names and bytes of all files."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("present", "sentence"),
    [
        ("notes.txt", "holds no config.json; expected a run directory of dppo-learner"),
        ("config.json", "holds no ledger.jsonl"),
    ],
)
def test_a_folder_without_a_run_is_refused(harness, present, sentence):
    run = harness.folder / "run"
    run.mkdir()
    (run / present).write_text("{}")
    process = harness.start("dppo", "replay", str(run))
    assert process.wait() == 2, process.text
    assert f"error: {run} {sentence}" in process.text
