"""A worker's slots give the same answers however they come and go."""

import json
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from dppo.config import Config, RolloutConfig, RunConfig, UpdateConfig
from dppo.networks import Networks
from dppo.normalizer import Statistics
from dppo.wire.codec import encode
from dppo.wire.messages import Collect, Collected, Restore, Update
from tests.support import ROOT
from workers.core import Core
from workers.envs import make_env, quiet, spaces_of
from workers.worker import OutOfStepError, Worker

ENVS = ["Hopper-v5", "CartPole-v1"]


class Link:
    """A worker's end that keeps what is sent; nothing is ever received."""

    def __init__(self):
        self.sent = []

    def send(self, *messages):
        self.sent += messages

    def receive(self, timeout):
        del timeout

    def close(self):
        pass


class Story:
    """One worker, asked by hand."""

    def __init__(self, env, exact=True, core=None):
        quiet()
        run = RunConfig(env=env, env_kwargs=json.dumps({"max_episode_steps": 20}), seed=3)
        self.config = Config(
            run=run,
            rollout=RolloutConfig(slots=8, num_envs=2, num_steps=16, exact_envs=exact),
            update=UpdateConfig(critic_replay=True, update_epochs=2, num_minibatches=2),
        )
        self.spaces = spaces_of(make_env(run))
        self.parameters = Networks.build(self.spaces, self.config).initial(self.config)
        self.link = Link()
        self.worker = Worker("w", self.link, self.spaces, self.config, core)
        self.snapshots = {}

    def collect(self, iteration, slots):
        """Each slot's answer as bytes."""
        empty = Statistics.empty(self.spaces.obs_size)
        self.link.sent.clear()
        self.worker.perform(
            Collect(
                generation=1, iteration=iteration, round=0, slots=slots, psi=0.1, beta=1.0,
                mean_reward=0.0,
                parameters=self.parameters + np.float32(0.01 * iteration),
                obs=empty.obs.to_vector(), returns=empty.returns.to_vector(),
                sigma_target=empty.sigma_target.to_vector(),
            )
        )  # fmt: skip
        answers = {m.slot: m for m in self.link.sent if isinstance(m, Collected)}
        self.snapshots |= {slot: answer.snapshot for slot, answer in answers.items()}
        return {slot: encode(answer) for slot, answer in answers.items()}

    def restore(self, iteration, slot, snapshot):
        self.worker.perform(
            Restore(generation=1, iteration=iteration, slot=slot, snapshot=snapshot)
        )

    def gradients(self, iteration, slots):
        self.link.sent.clear()
        self.worker.perform(
            Update(
                generation=1, iteration=iteration, round=1, slots=slots, stopped=(),
                parameters=self.parameters, advantages=np.array([64.0, 0, 0, 0, 64, 64, 64]),
            )
        )  # fmt: skip
        return [(m.first, m.size, m.vector.tobytes()) for m in self.link.sent]


@pytest.mark.parametrize("env", ENVS)
def test_slots_answer_alike_together_apart_and_after_moves(env):
    whole = Story(env)
    expected = [whole.collect(iteration, (0, 1, 2, 3, 4, 5)) for iteration in range(4)]
    gradients = whole.gradients(3, (0, 1, 2, 3))

    mover, heir = Story(env), Story(env)
    assert mover.collect(0, (0, 1, 2, 3)) == {s: expected[0][s] for s in (0, 1, 2, 3)}
    assert heir.collect(0, (4, 5)) == {s: expected[0][s] for s in (4, 5)}
    assert mover.collect(1, (0, 1, 2, 3)) == {s: expected[1][s] for s in (0, 1, 2, 3)}
    # the other one is lost in iteration 1: its slots are caught up, then all go on together
    for slot in (4, 5):
        mover.restore(1, slot, heir.snapshots[slot])
    assert mover.collect(1, (4, 5)) == {s: expected[1][s] for s in (4, 5)}
    assert mover.collect(2, (0, 1, 2, 3, 4, 5)) == expected[2]
    # one joins: this one gives slots away and keeps the others
    assert mover.collect(3, (0, 1, 2, 3)) == {s: expected[3][s] for s in (0, 1, 2, 3)}
    assert mover.gradients(3, (0, 1, 2, 3)) == gradients


@pytest.mark.parametrize("env", ENVS)
def test_slots_caught_up_in_the_first_iteration_start_afresh(env):
    whole, mover = Story(env), Story(env)
    expected = [whole.collect(iteration, (0, 1, 2)) for iteration in range(2)]
    assert mover.collect(0, (0,)) | mover.collect(0, (1, 2)) == expected[0]
    assert mover.collect(1, (0, 1, 2)) == expected[1]


def test_a_slot_that_was_never_here_is_out_of_step():
    story = Story("Hopper-v5")
    story.collect(0, (0, 1))
    with pytest.raises(OutOfStepError, match="slot 5 is not at the start of iteration 1"):
        story.collect(1, (0, 5))
    story.collect(1, (0, 1))
    with pytest.raises(OutOfStepError, match="slot 1 is not at the start of iteration 3"):
        story.collect(3, (1,))


def test_without_exact_environments_every_move_is_told():
    story = Story("Hopper-v5", exact=False)
    story.collect(0, (0, 1))
    assert all(m.exact for m in story.link.sent)
    story.collect(1, (0, 1))
    assert all(m.exact for m in story.link.sent)
    story.restore(2, 2, story.snapshots[1])
    story.collect(2, (0, 2))
    assert not any(m.exact for m in story.link.sent)


class ReleasedCore(Core):
    """How often it was let go of."""

    released = 0

    def release(self):
        self.released += 1


def test_environments_that_are_made_later_on_may_use_all_cores_too():
    core = ReleasedCore()
    story = Story("Hopper-v5", core=core)
    story.collect(0, (0,))
    assert core.released == 1
    story.collect(1, (0,))
    assert core.released == 1
    story.restore(2, 1, story.snapshots[0])
    story.collect(2, (0, 1))
    assert core.released == 2


QUICK_STEPS = """
    import itertools
    from dppo.process import leave

    def work():
        from workers.envs import make_vec, quiet
        from workers.heart import Heart

        quiet()
        envs, signs = make_vec("CartPole-v1", 1), []
        envs.reset(seed=[0])
        actions = itertools.cycle(envs.action_space.sample() for _ in range(64))
        Heart("worker", 1, signs.append).begin()
        while len(signs) < 4:
            envs.step(next(actions))
        print("alive")
        return 0

    leave(work)
"""


@pytest.mark.slow
def test_signs_of_life_are_sent_beside_steps_that_take_microseconds():
    words = [sys.executable, "-c", textwrap.dedent(QUICK_STEPS)]
    # 2 s; with Python's own switch interval: after minutes, or never.
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=20, check=False)
    assert done.stdout == "alive\n", done.stderr


MOVES = """
    from dppo.machine import one_thread

    one_thread()
    import resource
    from pathlib import Path
    from tests.processes.test_worker import Story

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    story = Story("Hopper-v5")
    sizes = []
    for iteration in range(0, 160, 2):  # slots 4 and 5 go to another worker and come back
        story.collect(iteration, (0, 1, 2, 3, 4, 5))
        lent = {slot: story.snapshots[slot] for slot in (4, 5)}
        story.collect(iteration + 1, (0, 1, 2, 3))
        for slot, snapshot in lent.items():
            story.restore(iteration + 2, slot, snapshot)
        sizes.append(resident())
    print((sizes[-1] - sizes[0]) / 1e6)
"""


@pytest.mark.slow
def test_slots_that_come_and_go_leave_no_memory_behind():
    words = [sys.executable, "-c", textwrap.dedent(MOVES)]
    done = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 4, "[MB]; 8 to 16 when freed memory is not returned"
