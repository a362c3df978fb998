"""A trained policy outside the trainer: a plain loop and the command line agree."""

import json
import runpy
import signal
from functools import partial

import numpy as np
import pytest

from dppo.errors import RunFailedError
from dppo.sources import made_by
from tests.support import ROOT, catches, checkpoints, newest_checkpoint, wait_until
from workers.envs import Adapter, make_env
from workers.evaluate import evaluate, plans_of, policy_of
from workers.play import play


@pytest.fixture(scope="module")
def run_dir(runs):
    return runs("Hopper-v5")


@pytest.mark.slow
def test_a_checkpoint_is_read_without_this_package_as_the_page_on_embedding_says(run_dir):
    """JSON, safetensors and NumPy: the same actions up to the order of sums."""
    checkpoint = newest_checkpoint(run_dir)
    (folder,) = [run_dir / "checkpoints" / name for name in checkpoints(run_dir)[-1:]]
    example = runpy.run_path(str(ROOT / "examples" / "read_a_checkpoint.py"))
    theirs, ours = example["Policy"](folder), policy_of(checkpoint)
    rng = np.random.default_rng(3)
    for _ in range(20):
        obs = rng.normal(theirs.mean, 30 * theirs.scale)  # some are clipped
        assert theirs.act(obs) == pytest.approx(ours.act(obs, 0, None), rel=1e-4, abs=1e-6)


def test_equal_arguments_give_equal_returns_and_other_seeds_others(run_dir):
    policy = policy_of(newest_checkpoint(run_dir))
    first = evaluate(policy, episodes=3, deterministic=False, seed=1)
    assert evaluate(policy, episodes=3, deterministic=False, seed=1) == first
    assert evaluate(policy, episodes=3, deterministic=False, seed=2) != first
    assert evaluate(policy, episodes=3, deterministic=True, seed=1) != first


@pytest.mark.parametrize(
    "env_id", ["Hopper-v5", pytest.param("FourRooms-v0", marks=pytest.mark.slow)]
)
def test_results_do_not_depend_on_how_many_are_played_side_by_side(runs, env_id):
    policy = policy_of(newest_checkpoint(runs(env_id)))
    play_all = partial(evaluate, policy, deterministic=False, seed=3)
    together = play_all(episodes=5, places=2)
    assert len({episode.length for episode in together.episodes}) > 5
    for rows in (1, 2, 7):
        assert play_all(episodes=5, places=2, rows=rows) == together
    assert play_all(episodes=3).episodes == together.episodes[:3]


def test_an_episode_is_the_one_that_a_plain_loop_plays(run_dir):
    policy = policy_of(newest_checkpoint(run_dir))
    plans = plans_of(seed=1, episodes=4, places=0)
    env = make_env(policy.config.run)
    adapter = Adapter(env.observation_space, env.action_space)
    found = {episode.plan: (episode, kept) for episode, kept in play(policy, plans, keep=True)}
    for plan in plans:
        episode, trajectory = found[plan]
        rng, ended = plan.noise(), False
        rewards: list[float] = []
        obs, _ = env.reset(seed=plan.reset_seed)
        seen = [obs]
        while not ended:
            action = policy.act(adapter.obs(obs), len(rewards), rng)
            obs, reward, terminated, truncated, _ = env.step(adapter.to_env(action))
            rewards.append(float(reward))
            seen.append(obs)
            ended = terminated or truncated
        assert np.array_equal(trajectory.obs, np.array(seen))
        assert trajectory.reward.tolist() == rewards
        assert (episode.length, episode.terminated) == (len(rewards), terminated)
        assert episode.total == pytest.approx(sum(rewards), rel=1e-12)
        weights = 0.995 ** np.arange(len(rewards))
        assert episode.discounted == pytest.approx(weights @ rewards, rel=1e-12)


@pytest.mark.parametrize("env_id", ["Hopper-v5", "FourRooms-v0"])
def test_episodes_of_a_fixed_start_share_it_and_nothing_else(runs, env_id):
    policy = policy_of(newest_checkpoint(runs(env_id)))
    plans = plans_of(seed=2, episodes=4, places=2, free=False)
    found = {episode.plan: kept for episode, kept in play(policy, plans, keep=True)}
    for place in (0, 1):
        kept = [found[plan] for plan in plans if plan.place == place]
        assert len({trajectory.obs[0].tobytes() for trajectory in kept}) == 1
        assert len({trajectory.obs.tobytes() for trajectory in kept}) == 4
    assert not np.array_equal(found[plans[0]].obs[0], found[plans[4]].obs[0])


def test_the_environments_own_noise_differs_from_one_start(runs):
    """The policy is deterministic here, and yet Four Rooms slips at other steps."""
    policy = policy_of(newest_checkpoint(runs("FourRooms-v0")))
    plans = plans_of(seed=2, episodes=3, places=1, free=False)
    kept = [trajectory for _, trajectory in play(policy, plans, deterministic=True, keep=True)]
    assert len({trajectory.obs.tobytes() for trajectory in kept}) == 3


@pytest.mark.slow
def test_a_failing_environment_ends_the_evaluation_with_its_reset_seed(runs):
    run = runs("tests.odd_envs:Walk-v0")
    config = json.loads((run / "config.json").read_text())
    assert config["config"]["run"]["env"] == "tests.odd_envs:Walk-v0"
    checkpoint = newest_checkpoint(run)
    checkpoint.facts["config"]["run"]["env"] = "tests.odd_envs:Raises-v0"
    sentence = r"Raises-v0 raised RuntimeError: the arm fell off at step 10 .* reset seed \d+"
    with pytest.raises(RunFailedError, match=sentence):
        evaluate(policy_of(checkpoint), episodes=2, deterministic=True, seed=0)


def test_an_episode_that_may_never_end_is_remarked_upon_once(runs, monkeypatch, caplog):
    policy = policy_of(newest_checkpoint(runs("tests.odd_envs:Walk-v0")))
    monkeypatch.setattr("workers.play._LONG_STEPS", 17)
    evaluate(policy, episodes=4, deterministic=False, seed=0)  # of 16 steps each
    assert not caplog.messages
    monkeypatch.setattr("workers.play._LONG_STEPS", 16)
    evaluate(policy, episodes=4, deterministic=False, seed=0, rows=4)
    (said,) = caplog.messages
    assert said.startswith("an episode of Walk-v0 has lasted 16 steps;")
    assert "--max-steps 1000 cuts episodes" in said


@pytest.mark.parametrize("env_id", ["Hopper-v5", "tests.odd_envs:Walk-v0"])
def test_episodes_that_are_cut_are_beginnings_of_whole_ones(runs, env_id):
    policy = policy_of(newest_checkpoint(runs(env_id)))
    plans = plans_of(seed=1, episodes=5, places=1)
    whole, cut, same = (
        {episode.plan: (episode, kept) for episode, kept in played}
        for played in (
            play(policy, plans, keep=True, max_steps=limit, rows=3) for limit in (0, 6, 10**6)
        )
    )
    for plan in plans:
        (episode, kept), (short, begun) = whole[plan], cut[plan]
        assert episode.terminated
        assert (short.length, short.terminated) == (6, False)
        assert np.array_equal(begun.obs, kept.obs[:7])
        assert begun.reward.tolist() == kept.reward[:6].tolist()
        assert same[plan][0] == episode


def test_an_episode_that_ends_in_the_step_it_would_be_cut_in_has_ended(runs):
    policy = policy_of(newest_checkpoint(runs("tests.odd_envs:Walk-v0")))
    found = evaluate(policy, episodes=2, deterministic=True, seed=0, max_steps=16)
    assert [(one.length, one.terminated) for one in found.episodes] == [(16, True)] * 2


@pytest.mark.slow
def test_dppo_eval_cuts_episodes_that_never_end(harness, runs):
    words = ("dppo", "eval", str(runs("tests.odd_envs:Endless-v0")), "--max-steps", "30")
    process = harness.start(*words, "--episodes", "3", "--json")
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    assert printed["max_steps"] == 30
    assert [one["length"] for one in printed["episodes"]] == [30] * 3
    assert printed["summary"]["free"]["falls"] == 0
    people = harness.start(*words, "--episodes", "1")
    assert people.wait() == 0
    assert "gamma 0.995, episodes cut after 30 steps\n" in people.text


@pytest.mark.slow
def test_a_sigma_up_to_the_time_limit_is_not_compared_with_returns_that_are_cut(harness, runs):
    run = runs("InvertedPendulum-v5", "--time-limit", "time-feature")
    words = ("dppo", "eval", str(run), "--calibration", "--episodes", "2", "--max-steps")
    process = harness.start(*words, "2")
    assert process.wait() == 2, process.text
    assert "by --max-steps 2 with --calibration, and the run has --time-limit" in process.text
    whole = harness.start(*words, "1000000")
    assert whole.wait() == 0, whole.text


def test_dppo_eval_prints_mean_spread_tail_falls_and_intervals(harness, run_dir):
    words = ("--episodes", "12", "--fixed-start", "--json", "--rows", "5")
    process = harness.start("dppo", "eval", str(run_dir), *words)
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    _, log_std = policy_of(newest_checkpoint(run_dir)).networks.split_policy(
        newest_checkpoint(run_dir).arrays["parameters"]
    )
    assert 0 < printed["action_std"] == pytest.approx(float(np.exp(log_std).mean()))
    assert [episode["start"] for episode in printed["episodes"]] == ["free"] * 12 + ["fixed"] * 12
    assert len({episode["reset_seed"] for episode in printed["episodes"][12:]}) == 1
    for start, episodes in (
        ("free", printed["episodes"][:12]),
        ("fixed", printed["episodes"][12:]),
    ):
        summary = printed["summary"][start]
        returns = np.array([episode["return"] for episode in episodes])
        discounted = np.array([episode["discounted_return"] for episode in episodes])
        assert summary["episodes"] == 12
        assert summary["return_mean"] == pytest.approx(returns.mean())
        assert summary["return_std"] == pytest.approx(returns.std(ddof=1))
        assert summary["return_median"] == pytest.approx(np.median(returns))
        assert summary["return_cvar10"] == pytest.approx(np.sort(returns)[:2].mean())
        assert summary["return_min"] == returns.min()
        assert summary["discounted_mean"] == pytest.approx(discounted.mean())
        assert summary["falls"] == np.mean([episode["terminated"] for episode in episodes]) == 1
        assert summary["length_mean"] == np.mean([episode["length"] for episode in episodes])
        low, high = summary["return_mean_interval"]
        assert low < summary["return_mean"] < high
        low, high = summary["falls_interval"]
        assert low < 0.8  # all 12 have fallen, and yet one in five may not
        assert high == 1
    again = harness.start("dppo", "eval", str(run_dir), *words[:4], "--rows", "16")
    assert again.wait() == 0
    assert again.text == process.text


def test_dppo_eval_that_is_stopped_does_not_end_as_if_it_had_printed_something(harness, run_dir):
    process = harness.start("dppo", "eval", str(run_dir), "--episodes", "1000000", "--json")
    wait_until(lambda: catches(process.popen.pid, signal.SIGTERM), "it to take signals")
    process.send(signal.SIGTERM)
    assert process.wait() == 143
    assert process.text == "stopped by SIGTERM; the result is not complete\n"


def test_dppo_eval_prints_a_line_per_figure_for_people(harness, run_dir):
    process = harness.start("dppo", "eval", str(run_dir), "--episodes", "3", "--deterministic")
    assert process.wait() == 0, process.text
    first, kinds, mean, *_ = process.text.splitlines()
    assert first.startswith("Hopper-v5, iteration-")
    assert first.endswith("most likely actions, gamma 0.995")
    assert kinds == "3 episodes, free starts; [95 % interval]"
    assert mean.startswith("  return_mean")


@pytest.mark.slow
def test_a_single_episode_has_no_spread_and_no_interval(harness, run_dir):
    words = ("eval", str(run_dir), "--episodes", "1", "--fixed-start")
    process = harness.start("dppo", *words)
    assert process.wait() == 0, process.text
    _, *lines = process.text.splitlines()
    assert [line for line in lines if "episode" in line] == [
        "1 episode, free starts",
        "1 episode, the same start",
    ]
    assert not [line for line in lines if "_std" in line or "[" in line]
    printed = harness.start("dppo", *words, "--json")
    assert printed.wait() == 0, printed.text
    summary = json.loads(printed.text)["summary"]["free"]
    unknown = {name for name, value in summary.items() if value is None}
    assert unknown == {name for name in summary if name.endswith(("_std", "_interval"))}
    assert summary["return_mean"] == summary["return_min"] == summary["return_cvar10"]


def test_dppo_checkpoint_shows_hashes_and_contents(harness, run_dir):
    process = harness.start("dppo", "checkpoint", str(run_dir))
    assert process.wait() == 0, process.text
    printed = json.loads(process.text)
    outcome = json.loads((run_dir / "result.json").read_text())
    assert printed["parameters_sha256"] == outcome["parameters_sha256"]
    assert printed["state"]["iteration"] == 3
    assert printed["made_by"] == made_by()
    assert {"policy_sha256", "value_sha256", "variance_sha256"} <= printed.keys()
    assert "slot/7" in printed["arrays"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["eval", "/nowhere"], "/nowhere holds no checkpoint"),
        (["eval", "{run}", "--which", "latest"], "--which is latest, expected best, newest"),
        (
            ["eval", "{one}", "--which=newest"],
            "--which chooses among a run's checkpoints, but {one} is one of them; leave --which",
        ),
        (["checkpoint", "--which", "best", "{one}"], "or give the run directory"),
        (["eval", "{run}", "--episodes", "0"], "--episodes is 0, expected >= 1"),
        (["eval", "{run}", "--max-steps", "-1"], "--max-steps is -1, expected >= 0"),
        (["eval", "{run}", "--rows", "0"], "--rows is 0, expected >= 1"),
        (["eval", "{run}", "--env", "Ant-v5"], "give the environment that it was trained on"),
        (["eval", "{run}", "--env-kwargs", "3"], "--env-kwargs is '3', expected a JSON object"),
        (
            ["eval", "{run}", "--env", "Hopper-v4", "--calibration"],
            "--env is Hopper-v4, expected nothing with --calibration",
        ),
        (["train"], "found train, expected eval, export, video, watch, checkpoint, replay"),
        ([], "found nothing, expected eval, export, video, watch, checkpoint, replay"),
    ],
)
def test_wrong_usage_is_one_sentence_and_code_2(harness, run_dir, words, sentence):
    one = run_dir / "checkpoints" / checkpoints(run_dir)[-1]
    process = harness.start("dppo", *(word.format(run=run_dir, one=one) for word in words))
    assert process.wait() == 2
    assert sentence.format(one=one) in " ".join(process.text.replace("│", " ").split())
    assert "Traceback" not in process.text
