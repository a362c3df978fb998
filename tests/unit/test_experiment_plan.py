"""What an experiment runs, in which order, and what it refuses."""

from typing import Any

import pytest

from dppo.errors import UsageError
from dppo.experiment.evaluation import evaluation_words, normalised
from dppo.experiment.grid_file import read_grid
from dppo.experiment.pace import GridPace
from dppo.experiment.plan import Run, in_order
from dppo.experiment.schedule import Schedule, Stage
from dppo.experiment.settings import from_words, resolved, words_of
from dppo.experiment.table2 import ENVIRONMENTS, table2


def grid_of(**changes):
    values: dict[str, Any] = {
        "envs": ENVIRONMENTS, "psis": (), "seeds": 5, "steps": 3_000_000, "evaluate": 100,
        "settings": {},
    }  # fmt: skip
    return table2(**(values | changes))


def test_table_2_is_four_environments_with_psi_0_the_papers_and_twice_that():
    grid = grid_of()
    assert len(grid.runs) == 4 * 3 * 5
    psis = {env: sorted({run.psi for run in grid.runs if run.env == env}) for env in ENVIRONMENTS}
    assert psis == {
        "HalfCheetah-v4": [0, 0.15, 0.3],
        "Hopper-v4": [0, 0.075, 0.15],
        "Ant-v4": [0, 0.1, 0.2],
        "Walker2d-v4": [0, 0.075, 0.15],
    }
    assert {run.steps for run in grid.runs} == {3_000_000}
    assert grid.steps == sum(run.real_steps for run in grid.runs) >= 180_000_000


def test_seeds_come_one_after_the_other_and_in_each_the_longest_first():
    ordered = in_order(grid_of(seeds=2).runs)
    assert [run.seed for run in ordered] == [1] * 12 + [2] * 12
    slowest_first = ["Ant-v4", "Walker2d-v4", "Hopper-v4", "HalfCheetah-v4"]
    assert [run.env for run in ordered[:12:3]] == slowest_first
    assert {run.arm for run in ordered[:3]} == {"psi0", "psi-paper", "psi-twice"}


def test_a_run_survives_json_and_says_its_flags():
    run = grid_of(settings={"preset": "paper"}).runs[7]
    assert Run.from_dict(run.to_dict()) == run
    assert run.name == "HalfCheetah-v4__psi-paper__s3"
    assert run.words == [
        "--preset", "paper", "--env", "HalfCheetah-v4", "--seed", "3", "--total-timesteps",
        "3000000", "--psi", "0.15",
    ]  # fmt: skip
    assert run.config.network.architecture == "paper"


def test_settings_and_flags_are_each_others_inverse():
    settings = {
        "psi": 0.1, "adv_norm": "joint", "hidden_sizes": [32, 16], "exact_envs": False,
        "env_kwargs": '{"a": 1}', "num_envs": 4, "clip_obs": "inf",
    }  # fmt: skip
    words = words_of(settings)
    assert "--no-exact-envs" in words
    found = from_words(words)
    assert resolved("Ant-v4", 1, 100, found) == resolved("Ant-v4", 1, 100, settings)
    assert from_words(["--exact-envs", "--psi=1e-1"]) == {"exact_envs": True, "psi": 0.1}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["stray"], "found 'stray' after --, expected a flag of dppo-learner first"),
        (["--psy", "1"], "found the setting --psy, expected .* such as --psi"),
        (["--gamma", "1", "2"], r"--gamma has the values \['1', '2'\], expected one"),
        (["--seed", "1"], "found the setting --seed; give it as seeds of the grid"),
    ],
)
def test_words_that_are_no_settings_are_refused(words, sentence):
    with pytest.raises(UsageError, match=sentence):
        from_words(words)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"envs": ("Swimmer-v5",)}, "--envs has Swimmer-v5, of which the paper names no psi"),
        ({"envs": ("Ant-v4", "Ant-v4")}, "the grid has Ant-v4__psi-paper__s1, .* twice"),
        ({"psis": (0.0, -1.0)}, "arm psi-1 on HalfCheetah-v4: --psi is -1.0, expected >= 0"),
        ({"settings": {"psi": 1.0}}, "give --psis 0 0.1 before --"),
        ({"settings": {"preset": "best"}}, "preset is 'best', expected one of default, paper"),
        ({"settings": {"num_minibatches": 7}}, "--num-minibatches is 7, expected a divisor"),
    ],
)
def test_grids_that_cannot_be_run_are_refused(changes, sentence):
    with pytest.raises(UsageError, match=sentence):
        grid_of(**changes)


GOOD = {
    "environments": '["Hopper-v4", "Ant-v4"]',
    "seeds": "2",
    "steps": "1e5",
}


LIMITED = "[arms.limited]\nvariance-limit = 10\n"
"""Without a ψ of its own, but with one that moves: no baseline."""


def written(tmp_path, arms, **changes):
    file = tmp_path / "grid.toml"
    lines = [f"{name} = {value}" for name, value in (GOOD | changes).items() if value]
    file.write_text("\n".join([*lines, arms]))
    return file


def test_a_file_names_arms_that_may_differ_between_environments(tmp_path):
    arms = "[settings]\nnum-envs = 4\n[arms.safe]\npsi = 0.1\n[arms.safe.Ant-v4]\npsi = 0.3\n"
    grid = read_grid(written(tmp_path, f"{arms}{LIMITED}[arms.plain]\n", seeds="[3, 9]"))
    found = {(run.env, run.arm, run.seed): run.psi for run in grid.runs}
    assert len(found) == 12
    assert found["Hopper-v4", "safe", 3] == 0.1
    assert found["Ant-v4", "safe", 9] == 0.3
    assert {run.config.rollout.num_envs for run in grid.runs} == {4}
    assert (grid.title, grid.baseline, grid.evaluate) == ("grid", "plain", 100)


@pytest.mark.parametrize(
    ("arms", "changes", "sentence"),
    [
        ("[arms.a]", {"steps": ""}, "found no steps, expected environments, seeds, steps, arms"),
        ("[arms.a]", {"steps": "0.5"}, "--steps is 0.5, expected a whole number >= 1"),
        ("[arms.a]", {"steps": '"many"'}, "steps is 'many', expected a number"),
        ("[arms.a]", {"seeds": "0"}, "seeds is 0, expected a count >= 1 or a list"),
        ("[arms.a]", {"environments": "[]"}, r"environments is \[\], expected a list"),
        ("[arms.a]", {"size": "3"}, "found 'size', expected title, environments"),
        ("[arms.a]\npsi = -1", {}, "arm a on Hopper-v4: --psi is -1.0, expected >= 0"),
        ("[arms.a]\npsi = 'x'", {}, "psi is 'x', expected a float"),
        ("[arms.a]\nseed = 3", {}, "arm a on Hopper-v4: found the setting --seed; give it as"),
        ("[arms.a.Walker2d-v4]\npsi = 1", {}, "has a table 'Walker2d-v4', expected one of the"),
        ("[arms.'a b']", {}, "an arm is called 'a b', expected at most 100 letters"),
        (f"[arms.{'a' * 101}]", {}, "an arm is called 'aaa.*, expected at most 100 letters"),
        ("[arms.a]", {"baseline": '"b"'}, "baseline is 'b', expected an arm: a"),
        ("[arms.a]", {"baseline": '["a"]'}, r"baseline is \['a'\], expected an arm: a"),
        ("[arms.a]", {"title": "3"}, "title is 3, expected a text"),
        ("[arms.a]\npreset = ['paper']", {}, r"preset is \['paper'\], expected one of default"),
        ("[arms.a]\nadv-norm = 'joint'\nadv_norm = 'none'", {}, "arms.a has --adv-norm twice"),
        ("[arms.a.env-kwargs]\na = nan", {}, "env-kwargs is .*, expected what JSON can hold"),
        ("[arms.a.env-kwargs]\na = 2020-01-01", {}, "env-kwargs is .*, expected what JSON"),
        ("arms = 3", {}, "arms is 3, expected a table"),
        ("[arms]", {}, "arms is empty"),
        ("[arms", {}, "is not a readable TOML file"),
    ],
)
def test_a_file_that_is_no_grid_is_refused(tmp_path, arms, changes, sentence):
    with pytest.raises(UsageError, match=sentence):
        read_grid(written(tmp_path, arms, **changes))


def schedule_of(seeds=2, **done):
    grid = grid_of(envs=("Ant-v4",), seeds=seeds)
    return Schedule(
        in_order(grid.runs), trained=done.get("trained", ()), evaluated=done.get("evaluated", ())
    )


def test_a_run_is_trained_then_evaluated_before_another_begins():
    schedule = schedule_of()
    first = schedule.start()
    assert first.stage is Stage.TRAIN
    schedule.succeeded(first, evaluate=True)
    second = schedule.start()
    assert (second.run, second.stage) == (first.run, Stage.EVALUATE)
    schedule.succeeded(second, evaluate=True)
    assert schedule.done == 1
    assert schedule.start().run != first.run


def test_what_was_trained_before_is_only_evaluated_and_comes_first():
    names = [run.name for run in in_order(grid_of(envs=("Ant-v4",), seeds=2).runs)]
    schedule = schedule_of(trained=[names[4]], evaluated=names[:1])
    tasks = [(task.run.name, task.stage) for task in schedule.waiting]
    assert tasks[0] == (names[4], Stage.EVALUATE)
    assert [name for name, _ in tasks[1:]] == [names[1], names[2], names[3], names[5]]
    assert schedule.done == 1


def test_a_failure_is_tried_once_more_at_the_end():
    schedule = schedule_of(seeds=1)
    first = schedule.start()
    assert schedule.failed_with(first, "killed")
    for _ in range(2):
        schedule.succeeded(schedule.start(), evaluate=False)
    assert schedule.start() == first
    assert not schedule.failed_with(first, "killed again")
    assert schedule.is_over
    assert schedule.done == 2
    assert schedule.failed == {first.run.name: "killed again"}


def test_a_run_that_was_trained_at_the_second_try_has_no_third_for_its_evaluation():
    schedule = schedule_of(seeds=1)
    first = schedule.start()
    schedule.failed_with(first, "killed")
    for _ in range(2):
        schedule.succeeded(schedule.start(), evaluate=False)
    schedule.succeeded(schedule.start(), evaluate=True)
    task = schedule.start()
    assert (task.run, task.stage) == (first.run, Stage.EVALUATE)
    assert not schedule.failed_with(task, "no memory")
    assert list(schedule.failed) == [first.run.name]


def test_a_run_whose_folder_is_in_use_is_passed_over():
    schedule = schedule_of(seeds=1)
    names = [task.run.name for task in schedule.waiting]
    assert schedule.start(busy=names[:1]).run.name == names[1]
    assert schedule.start(busy=[names[0], names[2]]) is None
    assert not schedule.is_over


def test_a_seed_is_over_when_none_of_its_runs_waits_or_runs():
    schedule = schedule_of()
    for _ in range(3):
        assert not schedule.is_seed_over(1)
        schedule.succeeded(schedule.start(), evaluate=False)
    assert schedule.is_seed_over(1)
    assert not schedule.is_seed_over(2)


def test_the_time_left_comes_from_what_was_measured_and_is_no_less_than_the_longest_run():
    pace = GridPace(jobs=2)
    pace.ended("Ant-v4", 1000, 10)  # 10 ms a step
    assert pace.left([("Ant-v4", 1000), ("Ant-v4", 3000)]) == 30  # sum / 2 = 20 < the longest
    assert pace.left([("Ant-v4", 1000)] * 8) == 40
    # another environment: guessed 41 / 13.6 times as fast as Ant
    assert pace.left([("HalfCheetah-v4", 41_000)]) == pytest.approx(136)
    assert pace.left([]) == 0


def test_what_runs_now_is_measured_too_but_not_while_it_starts():
    pace = GridPace(jobs=1)
    guess = pace.seconds_per_step("Ant-v4")
    assert pace.seconds_per_step("Ant-v4", {"Ant-v4": (10, 1.0)}) == guess
    assert pace.seconds_per_step("Ant-v4", {"Ant-v4": (100, 10.0)}) == 0.1


@pytest.mark.parametrize(
    ("settings", "episodes", "calibrates"),
    [
        ({}, 100, True),
        ({}, 1, False),
        ({"preset": "authors-2019"}, 100, False),
        ({"variance_critic": False}, 100, False),
    ],
)
def test_sigma_is_calibrated_where_it_is_a_variance(settings, episodes, calibrates, tmp_path):
    config = resolved("Ant-v4", 1, 100, {"psi": 0.0, **settings})
    words = evaluation_words(tmp_path, config, episodes)
    assert ("--calibration" in words) == calibrates
    assert words[words.index("--episodes") + 1] == str(episodes)
    assert words[words.index("--max-steps") + 1] == "100000"  # an episode need not end by itself
    assert "--fixed-start" in words


def test_an_evaluation_keeps_what_it_has_of_each_episode():
    episode = {
        "start": "fixed", "return": 3, "discounted_return": 2.5, "length": 9, "terminated": True,
        "worth": 1,
    }  # fmt: skip
    found = normalised({"episodes": [episode], "calibration": {"ratio": 1.1}, "seed": 3,
                        "action_std": 0.2, "x": 4})  # fmt: skip
    assert found["settings"] == {"action_std": 0.2, "seed": 3}
    assert found["calibration"] == {"ratio": 1.1}
    assert found["episodes"] == [{name: episode[name] for name in list(episode)[:-1]}]


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([], "found a list, expected an object"),
        ({"mean": 1}, "found mean, expected episodes"),
        ({"episodes": [{"return": 1}]}, "expected return and length"),
    ],
)
def test_what_is_no_evaluation_is_refused(values, sentence):
    with pytest.raises(ValueError, match=sentence):
        normalised(values)
