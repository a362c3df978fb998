"""A policy, seen: films without a screen, and one sentence where there can be none."""

import ctypes.util
import importlib.util
import json
import re
import signal
import sys

import numpy as np
import pytest
from PIL import Image, ImageSequence

from dppo.errors import RunFailedError, UsageError
from dppo.store.contents import chosen
from tests.support import wait_until
from workers.film import Stage, film

SCREENLESS = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}
needs_egl = pytest.mark.skipif(
    ctypes.util.find_library("EGL") is None, reason="there is no libEGL to draw with"
)
needs_ffmpeg = pytest.mark.skipif(
    importlib.util.find_spec("imageio_ffmpeg") is None, reason="the extra `video` is not installed"
)


@pytest.fixture(scope="module")
def runs(runs):
    """Of episodes of 60 steps at most."""
    limit = json.dumps({"max_episode_steps": 60})
    return lambda env_id, *words: runs(env_id, *words or ("--env-kwargs", limit))


def video(harness, run_dir, name, *words, **environment):
    """The output of a command that has to succeed, and the file's path."""
    file = harness.folder / name
    process = harness.start(
        "dppo", "video", str(run_dir), "--out", str(file), *words,
        environment=SCREENLESS | environment,
    )  # fmt: skip
    assert process.wait() == 0, process.text
    return process.text, file


def seconds(file):
    """Of a GIF: equal pictures in a row may lie in it as one that is shown for longer."""
    with Image.open(file) as image:
        return sum(frame.info["duration"] for frame in ImageSequence.Iterator(image)) / 1000


@pytest.mark.slow
def test_a_film_shows_the_episodes_that_dppo_eval_plays(harness, runs):
    run_dir = runs("FourRooms-v0")  # draws by itself: this runs where there is no OpenGL
    printed, file = video(harness, run_dir, "rooms.gif", "--episodes", "2", "--seed", "5")
    words = ("--episodes", "2", "--seed", "5", "--json", "--which", "best")
    evaluation = harness.start("dppo", "eval", str(run_dir), *words)
    assert evaluation.wait() == 0, evaluation.text
    episodes = json.loads(evaluation.text)["episodes"]
    lengths = [int(number) for number in re.findall(r"episode \d: (\d+) steps", printed)]
    assert lengths == [episode["length"] for episode in episodes]
    assert seconds(file) == pytest.approx((sum(lengths) + 2) / 8, rel=0.05)  # 8 pictures a second
    with Image.open(file) as image:
        assert image.size == (13 * 16, 13 * 16)
        assert len(list(ImageSequence.Iterator(image))) > 10


@pytest.mark.slow
@needs_egl
def test_mujoco_is_filmed_without_a_screen(harness, runs):
    printed, file = video(harness, runs("Hopper-v5"), "hopper.gif")
    (length,) = (int(number) for number in re.findall(r"episode \d: (\d+) steps", printed))
    # 125 steps per second are filmed in every 5th, and the end: 25 pictures per second
    assert seconds(file) == pytest.approx((-(-length // 5) + 1) / 25, rel=0.01)
    with Image.open(file) as image:
        pictures = [
            np.asarray(frame.convert("L"), np.float64) for frame in ImageSequence.Iterator(image)
        ]
    assert pictures[0].std() > 10, "there is something to see"
    assert np.abs(pictures[0] - pictures[-1]).max() > 50, "and it moves"


@pytest.mark.slow
@needs_ffmpeg
def test_an_mp4_has_its_pictures(harness, runs):
    import imageio_ffmpeg

    printed, file = video(harness, runs("FourRooms-v0"), "rooms.mp4")
    (length,) = (int(number) for number in re.findall(r"episode \d: (\d+) steps", printed))
    pictures, duration = imageio_ffmpeg.count_frames_and_secs(str(file))
    assert pictures == length + 1
    assert duration == pytest.approx((length + 1) / 8, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "environment", "sentence"),
    [
        (("--out", "{}/a.avi"), {}, "expected a name that ends in .mp4 or .gif"),
        (("--out", "/nowhere/a.gif"), {}, "/nowhere/a.gif lies in no folder that exists"),
        (("--out", "{}"), {}, "is a folder, expected a file to write"),
        (("--out", "{}/a.gif"), {"MUJOCO_GL": "disable"}, "no picture can be made here"),
        (("--out", "{}/a.gif"), {"MUJOCO_GL": "crayon"}, "MUJOCO_GL"),
    ],
)
def test_what_cannot_be_filmed_is_one_sentence_and_code_2(
    harness, runs, words, environment, sentence
):
    words = [word.format(harness.folder) for word in words]
    process = harness.start(
        "dppo", "video", str(runs("Hopper-v5")), *words, environment=SCREENLESS | environment
    )
    assert process.wait() == 2, process.text
    assert sentence in process.text
    assert "Traceback" not in process.text
    assert not (harness.folder / "a.gif").exists()


@pytest.mark.slow
def test_without_a_screen_there_is_no_window_but_advice(harness, runs):
    process = harness.start("dppo", "watch", str(runs("Hopper-v5")), environment=SCREENLESS)
    assert process.wait() == 2, process.text
    assert "there is no screen here: neither DISPLAY nor WAYLAND_DISPLAY is set" in process.text


@pytest.mark.slow
def test_a_screen_that_cannot_be_used_is_one_sentence_and_code_2(harness, runs):
    nobody = {"DISPLAY": ":77", "WAYLAND_DISPLAY": ""}
    process = harness.start("dppo", "watch", str(runs("Hopper-v5")), environment=nobody)
    assert process.wait() == 2, process.text
    assert "the screen cannot be used (DISPLAY :77" in process.text
    assert len(process.text.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.usefixtures("quiet_libraries")
def test_a_package_that_draws_and_is_missing_is_named(runs, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    _, checkpoint = chosen(str(runs("tests.odd_envs:Walk-v0")), "newest")
    stage = Stage(checkpoint, "human", deterministic=True)
    with pytest.raises(UsageError, match=r"Walk-v0 cannot be shown here: pygame .*pip install"):
        stage.play(0, 0, lambda _: None)


def filmed(run_dir, file, **more):
    """The episodes in a film of a run's newest policy; `more` into the run's settings."""
    _, checkpoint = chosen(str(run_dir), "newest")
    checkpoint.facts["config"]["run"] |= more
    return film(checkpoint, file, episodes=2, seed=0, deterministic=True)


def test_a_film_ends_with_the_last_state(runs, tmp_path):
    file = tmp_path / "walk.gif"
    shown = list(filmed(runs("tests.odd_envs:Walk-v0"), file))
    assert [one.length for one in shown] == [16, 16]
    with Image.open(file) as image:
        brightness = [
            float(np.asarray(frame.convert("L")).mean()) for frame in ImageSequence.Iterator(image)
        ]
    assert brightness == pytest.approx(2 * [15 * step for step in range(17)], abs=3)
    assert list(tmp_path.iterdir()) == [file]


def test_an_environment_that_raises_leaves_the_earlier_film(runs, tmp_path):
    file = tmp_path / "walk.gif"
    file.write_bytes(b"earlier")
    sentence = r"Raises-v0 raised RuntimeError: the arm fell off at step 10 .* reset seed \d+"
    with pytest.raises(RunFailedError, match=sentence):
        list(filmed(runs("tests.odd_envs:Walk-v0"), file, env="tests.odd_envs:Raises-v0"))
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [
        ("walk.gif", b"earlier")
    ]


@pytest.mark.slow
def test_sigterm_leaves_the_earlier_film(harness, runs):
    stepped = harness.folder / "stepped"
    kwargs = json.dumps({"once": str(stepped)})  # the first step makes this file
    run_dir = runs("tests.odd_envs:Walk-v0", "--env-kwargs", kwargs)
    stepped.unlink()
    folder = harness.folder / "films"
    folder.mkdir()
    (folder / "walk.gif").write_bytes(b"earlier")
    words = ("dppo", "video", str(run_dir), "--out", str(folder / "walk.gif"))
    process = harness.start(*words, "--episodes", "1000000", environment=SCREENLESS)
    wait_until(stepped.exists, "a film under way")
    process.send(signal.SIGTERM)
    assert process.wait() == 143, process.text
    assert [(path.name, path.read_bytes()) for path in folder.iterdir()] == [
        ("walk.gif", b"earlier")
    ]


@pytest.mark.slow
def test_a_film_of_an_episode_that_never_ends_is_cut(harness, runs):
    limit = ("--env-kwargs", "{}")  # without the time limit of the other runs
    run_dir = runs("tests.odd_envs:Endless-v0", *limit)
    printed, file = video(harness, run_dir, "endless.gif", "--max-steps", "9")
    assert "episode 0: 9 steps" in printed
    assert seconds(file) == pytest.approx(10 / 30, abs=0.06)  # a GIF counts hundredths
