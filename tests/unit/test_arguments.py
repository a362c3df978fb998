"""The command line before the parser: other tools' habits, presets, files, addresses."""

import re

import pytest

from dppo.config import Config, RolloutConfig
from dppo.errors import UsageError
from dppo.presets import paper
from dppo.process import parse
from learner.__main__ import _ALIASES, _WHOLE_NUMBERS, LearnerArgs
from learner.arguments import defaults, listening_address, normalised


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("--num_steps 8", "--num-steps 8"),
        ("--num-steps=8", "--num-steps 8"),
        ("--num_steps=8", "--num-steps 8"),
        ("--env_id Ant-v4", "--env Ant-v4"),
        ("--env-id=Ant-v4", "--env Ant-v4"),
        ("--n_envs=4", "--num-envs 4"),
        ("--n-steps 8", "--num-steps 8"),
        ("--n_epochs 3", "--update-epochs 3"),
        ("--lr 1e-3", "--learning-rate 1e-3"),
        ("--target_kl=0.1", "--kl-target 0.1"),
        ("-n 1e6", "--total-timesteps 1000000"),
        ("--stop_at=1e3", "--stop-at 1000"),
        ("--total-timesteps 1e6", "--total-timesteps 1000000"),
        ("--total_timesteps=2.5e5", "--total-timesteps 250000"),
        ("--total-timesteps 1.5", "--total-timesteps 1.5"),  # for the parser to refuse
        ("--total-timesteps inf", "--total-timesteps inf"),
        ("--total-timesteps many", "--total-timesteps many"),
        ("--learning-rate 1e-3", "--learning-rate 1e-3"),
        ("--clip-obs 1e1", "--clip-obs 1e1"),
        ("--lambda-ret -1", "--lambda-ret -1"),
        ("--log_std_init -0.5", "--log-std-init -0.5"),
        ("--log-std-init=-5e-1", "--log-std-init -5e-1"),
        ("--total-timesteps -1e3", "--total-timesteps -1000"),
        ("--run-dir my_run", "--run-dir my_run"),
        ("--run_dir=my_run/x_y", "--run-dir my_run/x_y"),
        ("--no_exact_envs", "--no-exact-envs"),
        ("-v", "-v"),
        ("", ""),
    ],
)
def test_what_is_typed_and_what_is_meant(typed, meant):
    assert normalised(typed.split(), _ALIASES, _WHOLE_NUMBERS) == meant.split()


def test_a_value_keeps_its_underscores_and_equals_signs():
    kwargs = '{"ctrl_cost_weight": 0.1, "xml_file": "a=b.xml"}'
    expected = ["--env-kwargs", kwargs]
    assert normalised([f"--env_kwargs={kwargs}"], {}, ()) == expected
    assert normalised(["--env_kwargs", kwargs], {}, ()) == expected


@pytest.mark.parametrize("steps", [2**53 + 1, 2**63 - 1])
def test_a_whole_number_is_not_rounded(steps):
    argv = ["--total-timesteps", str(steps)]
    assert normalised(argv, {}, _WHOLE_NUMBERS) == argv


def test_an_empty_value_stays():
    assert normalised(["--run-dir="], {}, ()) == ["--run-dir", ""]


def test_no_preset_is_the_default_of_the_given_environment():
    assert defaults([]) == Config()
    assert defaults(["--env", "Hopper-v4"]).run.env == "Hopper-v4"


def test_a_preset_knows_the_environment():
    assert defaults(["--preset", "paper", "--env", "Hopper-v4"]) == paper("Hopper-v4")


def test_the_last_environment_counts_as_for_the_parser():
    argv = ["--preset", "paper", "--env", "HalfCheetah-v4", "--env", "Hopper-v4"]
    assert defaults(argv) == paper("Hopper-v4")


def test_a_config_file_sets_the_defaults(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[run]\nenv = 'Hopper-v4'\n[safety]\npsi = 1\n")
    config = defaults(["--config", str(file)])
    assert (config.run.env, config.safety.psi) == ("Hopper-v4", 1.0)


def test_a_preset_and_a_config_file_contradict_each_other():
    with pytest.raises(UsageError, match="--preset and --config both set all defaults"):
        defaults(["--preset", "paper", "--config", "mine.toml"])


def test_an_unknown_preset_names_the_known_ones():
    known = "'papr', expected one of default, paper, authors-2019, heess2017"
    with pytest.raises(UsageError, match=known):
        defaults(["--preset", "papr"])


@pytest.mark.parametrize("flag", ["--preset", "--config", "--env"])
def test_a_flag_at_the_end_needs_a_value(flag):
    with pytest.raises(UsageError, match=f"{flag} needs a value"):
        defaults(["--seed", "1", flag])


def test_a_missing_config_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=re.escape(f"{tmp_path}/none.json is not a readable")):
        defaults(["--config", str(tmp_path / "none.json")])


@pytest.mark.parametrize(
    "address",
    [
        "tcp/127.0.0.1:7447", "tcp/127.1.2.3:1", "tcp/[::1]:7447", "tcp/localhost:7447",
        "unixsock-stream//tmp/dppo.sock", "tcp/127.0.0.1:7447#so_sndbuf=65000",
    ],
)  # fmt: skip
def test_loopback_needs_no_leave(address):
    assert listening_address(address, insecure=False) == address


@pytest.mark.parametrize(
    "address",
    [
        "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.2:7447", "tcp/[2001:db8::1]:7447",
        "tcp/learner:7447", "tcp/localhost.example.org:7447", "tcp/10.0.0.1:7447",
        "tcp/0.0.0.0:7447#iface=127.0.0.1:1",
    ],
)  # fmt: skip
def test_everything_else_needs_insecure(address):
    with pytest.raises(UsageError, match=re.escape(f"--listen {address} is open to other")):
        listening_address(address, insecure=False)
    assert listening_address(address, insecure=True) == address


def test_auto_is_a_free_port_of_loopback():
    address = listening_address("auto", insecure=False)
    assert re.fullmatch(r"tcp/127\.0\.0\.1:[1-9]\d+", address)
    assert listening_address(address, insecure=False) == address


def test_a_value_that_an_older_parser_lets_through_is_wrong_usage_all_the_same(monkeypatch):
    """tyro before 1.0.16 builds the arguments unguarded."""
    seven = RolloutConfig(num_envs=1, num_steps=7)
    monkeypatch.setattr("tyro.cli", lambda kind, **_: kind(rollout=seven))
    with pytest.raises(UsageError, match="--num-minibatches is 2, expected a divisor"):
        parse(LearnerArgs, [], "dppo-learner")
