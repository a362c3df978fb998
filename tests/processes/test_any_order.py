"""The exchange in any order of events: waits end, no gradient counts twice, none is stale."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.deadlines import Deadlines
from dppo.leases import Leases
from dppo.spaces import Spaces
from dppo.sums import block_sum, members, whole
from dppo.wire import messages as wire
from learner.exchange import Exchange
from learner.soundness import Expected
from tests.simulation import ALL, OBS, SAMPLES, SIZE, SLOTS, World, gradient_of, snapshot_of

ITERATIONS, UPDATES = 3, 2


def undisturbed():
    """The parameters at the end, worked out without an exchange."""
    parameters = np.zeros(SIZE, np.float32)
    for iteration in range(1, ITERATIONS):
        for update in range(1, 1 + UPDATES):
            rows = {(slot, 1): gradient_of(slot, iteration, update, parameters) for slot in ALL}
            parameters = parameters + block_sum(rows, whole(SLOTS))
    return parameters


def run(choices, drop=0):
    """A run of a few iterations; its final parameters, and what each update went on with.

    Checks on the way that no slot counts twice, and that all that counts was computed from the
    present parameters.
    """
    world = World(choices)
    welcome = wire.Welcome(run="r", generation=1, config="{}", name="r")
    exchange = Exchange(
        world,
        welcome,
        Leases(SLOTS),
        lambda: None,
        1.0,
        lambda: world.now,
        Deadlines(SLOTS, drop_limit=2, first=0.5),
    )
    spaces = Spaces(obs_size=OBS, action_kind="box", action_sizes=(1,))
    exchange.expected = Expected(spaces, SIZE, SAMPLES)
    accepted: list[Any] = []
    parameters, snapshots = np.zeros(SIZE, np.float32), dict[int, bytes]()
    for iteration in range(ITERATIONS):
        where: dict[str, Any] = {"generation": 1, "iteration": iteration, "slots": ALL}
        world.next_iteration()
        one = np.zeros(3)
        collect = wire.Collect(
            **where, round=0, psi=0.1, beta=1.0, mean_reward=0.0, parameters=parameters,
            obs=np.zeros(1 + 2 * OBS),
            returns=one, sigma_target=one,
        )  # fmt: skip
        exchange.begin_iteration(collect, snapshots)
        collected: Any = exchange.gather(collect, SLOTS).answers
        assert sorted(collected) == [(slot, 1) for slot in ALL]
        for (slot, _), answer in collected.items():
            assert answer.snapshot == snapshot_of(slot, iteration + 1)
        for update in range(1, 1 + UPDATES) if iteration else ():
            task = wire.Update(
                **where, round=update, stopped=(), parameters=parameters, advantages=np.zeros(7)
            )
            closed: Any = exchange.gather(task, SLOTS - drop)
            counted = [slot for block in closed.answers for slot in members(block)]
            assert len(counted) == len(set(counted)) >= SLOTS - drop
            rows = {
                (slot, 1): gradient_of(slot, iteration, update, parameters) for slot in counted
            }
            parts = {block: answer.vector for block, answer in closed.answers.items()}
            total = block_sum(parts, whole(SLOTS))
            assert total.tolist() == block_sum(rows, whole(SLOTS)).tolist()
            parameters = parameters + total
            accepted.append(sorted(counted))
        if iteration:
            last = wire.Measure(**where, round=1 + UPDATES, parameters=parameters)
            measured: Any = exchange.gather(last, SLOTS).answers
            kls = [kl for answer in measured.values() for kl in answer.kls.tolist()]
            assert sorted(kls) == list(map(float, ALL))
        snapshots = {slot: answer.snapshot for (slot, _), answer in collected.items()}
    return parameters, accepted


choices = st.lists(st.integers(0, 16 * 12 - 1), min_size=30, max_size=200)


def test_without_any_trouble_the_parameters_are_those_worked_out():
    parameters, accepted = run([])
    assert parameters.tolist() == undisturbed().tolist()
    assert accepted == [list(ALL)] * (UPDATES * (ITERATIONS - 1))


@settings(max_examples=300)
@given(choices)
def test_whatever_happens_the_parameters_are_the_same(chosen):
    parameters, _ = run(chosen)
    assert parameters.tolist() == undisturbed().tolist()


@settings(max_examples=150)
@given(choices, st.integers(1, 4))
def test_whatever_happens_dropping_loses_at_most_d_slots_and_counts_none_twice(chosen, drop):
    _, accepted = run(chosen, drop)
    assert all(len(slots) >= len(ALL) - drop for slots in accepted)
    for slot in ALL:  # never dropped more than twice running
        runs = "".join("." if slot in slots else "x" for slots in accepted)
        assert "xxx" not in runs


KINDS = {"deliver": 0, "work": 1, "repeat": 4, "lose": 5, "kill": 6, "start": 7, "hang": 8}


@pytest.mark.slow
@pytest.mark.parametrize("when", [0, 14, 30, 45])
def test_every_order_of_small_sets_of_events(when):
    """Every sequence of three events of two workers, at several moments of a calm run."""
    calm = [16 * kind + who for _ in range(20) for who in (0, 1) for kind in (1, 0)][:when]
    events = [16 * kind + who for kind in KINDS.values() for who in (0, 1)]
    for sequence in product(events, repeat=3):
        parameters, _ = run([*calm, *sequence])
        assert parameters.tolist() == undisturbed().tolist(), sequence
