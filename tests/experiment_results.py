"""What results.json has of arms with given verdicts, without any run."""

from typing import Any

from dppo.experiment.together import together

AROUND_0 = {"higher": [1.0, 2.0], "lower": [-2.0, -1.0], "open": [-1.0, 1.0]}
AROUND_1 = {"higher": [1.1, 2.0], "lower": [0.5, 0.9], "open": [0.5, 2.0]}
STDS = {"higher": [4.0, 1.0], "lower": [1.0, 4.0], "open": [1.0, 4.0]}


def compared(**verdicts):
    """What results.json has of an arm against the baseline, with these verdicts; else open."""
    of = {name: verdicts.get(name, "open") for name in ("mean", "spread", "within", "policy_mean",
                                                        "life", "falls", "speed")}  # fmt: skip
    stds = STDS[of["spread"]]
    return {
        "last200": {
            "seeds": [5, 5], "difference": 0.0, "welch_interval": AROUND_0[of["mean"]],
            "brown_forsythe_p": 0.5 if of["spread"] == "open" else 0.01,
            "stds": stds, "distances": stds, "std_ratio": stds[0] / stds[1],
            "std_ratio_interval": [0.1, 10.0],
        },
        "free": {
            "seeds": [5, 5],
            "undiscounted": {
                "mean": {"interval": AROUND_0[of["policy_mean"]]}, "mean_ratio": 1.0,
                "std_ratio": 1.0, "std_ratio_interval": AROUND_1[of["within"]],
                "mean_beyond_goal": {"difference": 0.05, "interval": None},
            },
            "length": {"difference": 0.0, "interval": AROUND_0[of["life"]]},
            "terminated": {"difference": 0.0, "interval": AROUND_0[of["falls"]]},
        },
        "on_the_way": {
            "1000000": {"difference": 0.0, "interval": AROUND_0[of["speed"]]},
            "2000000": {"difference": 0.0, "interval": AROUND_0["open"]},
        },
    }  # fmt: skip


def results_of(verdicts, status="whole"):
    """Of some environments, each with its verdicts."""
    psis = {"HalfCheetah-v4": 0.15, "Hopper-v4": 0.075, "Ant-v4": 0.1, "Walker2d-v4": 0.075}
    environments: dict[str, Any] = {}
    for env, of in verdicts.items():
        arm = {
            "training": {"last200": {"mean": 1.0, "std_across_seeds": 1.0,
                                     "std_of_all_episodes": 2.0}},
            "evaluation": {"free": {"undiscounted": {"std_by_seed": [1.0, 4.0]},
                                    "length_mean": 10.0, "falls": 0.5}},
            "steps": 3_000_320,
            "on_the_way": {"1000000": {"mean": 1.0}, "2000000": {"mean": 2.0}},
        }  # fmt: skip
        plain = arm | {"psi": 0.0, "settings": {"psi": 0.0}, "is_plain": True}
        safe = arm | {"psi": psis[env], "settings": {"psi": psis[env]}, "is_plain": False}
        safe |= {"against_baseline": compared(**of)}
        environments[env] = {"arms": {"psi0": plain, "psi-paper": safe}}
    return {
        "baseline": "psi0", "status": status, "environments": environments,
        "together": together(environments, "psi0"),
    }  # fmt: skip
