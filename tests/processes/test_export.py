"""A policy as a file for others: it acts like the trainer's, or the command says why not."""

import importlib.util
import os

import numpy as np
import pytest

from dppo.sources import made_by
from dppo.store.checkpoint import sha256
from dppo.store.contents import chosen
from tests.support import printed
from workers.envs import Adapter, make_env, spaces_of
from workers.evaluate import policy_of
from workers.export import Exporter

HAS_ONNX = all(importlib.util.find_spec(name) for name in ("onnx", "onnxruntime", "onnxscript"))
needs_onnx = pytest.mark.skipif(not HAS_ONNX, reason="the extra `export` is not installed")


def expected(run_dir, count=50):
    """Observations far apart, steps, and what the trainer's policy does, as the env takes it."""
    _, checkpoint = chosen(str(run_dir), "newest")
    policy = policy_of(checkpoint)
    env, rng = make_env(policy.config.run), np.random.default_rng(0)
    adapter = Adapter(env.observation_space, env.action_space)
    obs = 3 * rng.standard_normal((count, spaces_of(env).obs_size))
    steps = rng.integers(0, 1000, count)
    actions = adapter.to_envs(policy.actions(obs, steps, None)).reshape(count, -1)
    inputs = {"obs": obs}
    if policy.config.rollout.time_limit == "time-feature":
        inputs["steps"] = steps
    return inputs, actions


KINDS = [
    ("Hopper-v5",),
    ("Hopper-v5", "--time-limit", "time-feature"),
    ("FourRooms-v0",),
    ("tests.odd_envs:Choices-v0",),
]
"""Gaussian, with a time feature, one choice, and several that do not begin at 0."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_torchscript_acts_like_the_trainer_and_needs_nothing_of_ours(harness, runs, kind):
    run_dir, file = runs(*kind), harness.folder / "policy.pt"
    process = harness.start("dppo", "export", str(run_dir), "--torchscript", str(file))
    assert process.wait() == 0, process.text
    assert "largest difference from the trainer's own actions on" in process.text
    inputs, actions = expected(run_dir)
    assert len(np.unique(actions)) > 1
    code = (
        "import sys, warnings; warnings.simplefilter('ignore'); import numpy as np, torch\n"
        f"module = torch.jit.load({str(file)!r})\n"
        f"inputs = np.load({str(harness.folder / 'inputs.npz')!r})\n"
        "tensors = [torch.from_numpy(inputs[name]) for name in inputs]\n"
        f"np.save({str(harness.folder / 'actions.npy')!r}, module(*tensors).numpy())\n"
        "assert not {'dppo', 'workers', 'learner'} & set(sys.modules)\n"
    )
    np.savez(harness.folder / "inputs.npz", **inputs)
    script = harness.folder / "other.py"
    script.write_text(code)
    printed(script)
    np.testing.assert_allclose(np.load(harness.folder / "actions.npy"), actions, atol=1e-6)
    assert not list(harness.folder.glob(".*.part"))


@pytest.mark.slow
@needs_onnx
@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_onnx_acts_like_the_trainer_for_any_number_of_observations(harness, runs, kind):
    import onnxruntime

    run_dir, file = runs(*kind), harness.folder / "policy.onnx"
    process = harness.start("dppo", "export", str(run_dir), "--onnx", str(file))
    assert process.wait() == 0, process.text
    assert len(process.text.splitlines()) == 1, "the packages' own remarks are kept out"
    session = onnxruntime.InferenceSession(str(file))
    _, checkpoint = chosen(str(run_dir), "best")
    assert session.get_modelmeta().custom_metadata_map == {
        "env": kind[0],
        "dppo_version": made_by()["dppo"],
        "parameters_sha256": sha256(checkpoint.arrays["parameters"]),
    }
    inputs, actions = expected(run_dir)
    for count in (1, 7, 50):
        (found,) = session.run(["action"], {name: all[:count] for name, all in inputs.items()})
        np.testing.assert_allclose(found, actions[:count], atol=1e-6)


@pytest.mark.slow
def test_a_file_that_acts_otherwise_is_not_written(runs, tmp_path):
    from dppo.errors import RunFailedError

    _, checkpoint = chosen(str(runs("Hopper-v5")), "newest")
    exporter = Exporter(checkpoint)
    exporter._module.mean += 0.5
    with pytest.raises(RunFailedError, match=r"policy.pt acts otherwise .* differ by up to 0"):
        exporter.torchscript(tmp_path / "policy.pt")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_cannot_be_exported_is_one_sentence_and_code_2(harness, runs):
    hopper, folder = runs("Hopper-v5"), harness.folder
    for words, sentence in (
        (
            (hopper, "--torchscript", "/nowhere/a.pt"),
            "/nowhere/a.pt lies in no folder that exists",
        ),
        ((hopper, "--onnx", folder), f"{folder} is a folder, expected a file to write"),
        (
            (hopper, "--torchscript", folder / "a", "--onnx", folder / ".." / folder.name / "a"),
            "are the same file, expected one of its own for each",
        ),
        ((hopper,), "--onnx is empty and --torchscript, too, expected a file for one of them"),
    ):
        process = harness.start("dppo", "export", *map(str, words))
        assert process.wait() == 2, process.text
        assert sentence in " ".join(process.text.replace("│", " ").split())
        assert "Traceback" not in process.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "text", "sentence"),
    [
        (
            "onnxruntime",
            "raise ModuleNotFoundError('there is none', name='onnxruntime')",
            "--onnx needs the package onnxruntime, which is not installed; pip install",
        ),
        pytest.param(
            "onnxscript",
            "__version__ = '0.5.7'  # it lacks what this torch imports from it",
            "and onnxscript 0.5.7 make no ONNX file together (ModuleNotFoundError: No module",
            marks=needs_onnx,
        ),
    ],
)
def test_without_the_right_packages_onnx_is_refused_with_advice(
    harness, runs, package, text, sentence
):
    first = harness.folder / "packages"
    first.mkdir()
    (first / f"{package}.py").write_text(text)
    path = os.pathsep.join([str(first), os.environ.get("PYTHONPATH", "")])
    words = ("dppo", "export", str(runs("Hopper-v5")), "--onnx", str(harness.folder / "a.onnx"))
    process = harness.start(*words, environment={"PYTHONPATH": path})
    assert process.wait() == 2, process.text
    assert sentence in process.text
    assert "Traceback" not in process.text
    assert not list(harness.folder.glob("*a.onnx*"))


@pytest.mark.slow
def test_a_policy_whose_episodes_never_end_is_verified_all_the_same(harness, runs):
    file = harness.folder / "policy.pt"
    words = ("dppo", "export", str(runs("tests.odd_envs:Endless-v0")), "--torchscript", str(file))
    process = harness.start(*words)
    assert process.wait() == 0, process.text
    assert "on 4002 observations" in process.text  # two episodes of 2,000 steps, each with its end
