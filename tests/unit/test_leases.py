"""Leases: nobody without work, no slot without a holder, no state that is only believed in."""

from copy import deepcopy
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dppo.leases import Leases


def with_workers(num_slots, *workers):
    leases = Leases(num_slots)
    for worker in workers:
        leases.join(worker)
    return leases


def apply(leases, event):
    """Let an event happen to a copy; the copy and what the event said."""
    after = deepcopy(leases)
    kind, *who = event
    match kind:
        case "join":
            return after, after.join(*who)
        case "leave":
            return after, after.leave(*who)
        case "work":  # a worker computes every slot it holds, and claims one it does not
            for slot in range(after.num_slots):
                after.mark_current(slot, *who)
            return after, None
    after.spread()
    return after, None


def check_state(leases):
    assert set(leases.holder.values()) <= set(leases.workers), "a holder that has left"
    assert len(set(leases.workers)) == len(leases.workers), "a worker joined twice"
    everything = set(range(leases.num_slots)) if leases.workers else set()
    assert set(leases.holder) == everything, "an unheld slot, or a holder of nothing we know"
    assert leases.current <= set(leases.holder), "current without a holder"
    held = [slot for worker in leases.workers for slot in leases.slots_of(worker)]
    assert sorted(held) == sorted(leases.holder), "a slot with two holders"
    assert set(leases.spares) == {w for w in leases.workers if not leases.slots_of(w)}


def check_event(before, event, after, said):
    kind, *who = event
    moved = {slot for slot in after.holder if before.holder.get(slot) != after.holder[slot]}
    assert not after.current & moved, "a moved slot is believed to be current"
    if kind != "work":
        assert after.current <= before.current
    match kind:
        case "join":
            assert set(said) == moved
            assert all(slot not in before.holder for slot in moved), "taken from its holder"
        case "leave":
            assert moved == {s for s in after.holder if before.holder[s] == who[0]}
            assert {(h, s) for h, taken in said.items() for s in taken} == {
                (after.holder[s], s) for s in moved
            }
            idle = [spare for spare in before.spares if spare != who[0]]
            used = [spare for spare in idle if after.slots_of(spare)]
            assert len(used) == min(len(idle), len(moved)), "spares inherit first"
        case "work":
            assert not moved
            assert after.current == before.current | set(after.slots_of(who[0]))
        case "spread":
            sizes = [len(after.slots_of(w)) for w in after.workers[: after.num_slots]]
            assert not sizes or max(sizes) - min(sizes) <= 1
            runs = [after.slots_of(w) for w in after.workers]
            assert [s for run in runs for s in run] == sorted(after.holder), "not runs in order"
            assert after.current == before.current - moved


def check_all(leases, event):
    after, said = apply(leases, event)
    check_state(after)
    check_event(leases, event, after, said)
    return after


EVENTS = [("spread",), *product(("join", "leave", "work"), "abc")]


def signature(leases):
    held = tuple(sorted(leases.holder.items()))
    current = tuple(sorted(leases.current))
    return tuple(leases.workers), held, current, leases.spread_over, leases.worth_it


@pytest.mark.parametrize("num_slots", [1, 2, 4])
def test_the_rules_hold_after_every_order_of_events_of_three_workers(num_slots):
    """Every state that any order of events of any length can reach, and every event in it."""
    start = Leases(num_slots)
    seen, waiting = {signature(start)}, [start]
    while waiting:
        leases = waiting.pop()
        for event in EVENTS:
            after = check_all(leases, event)
            if signature(after) not in seen:
                seen.add(signature(after))
                waiting.append(after)
    assert len(seen) > 16  # the 16 orders in which three workers can be in


names = st.sampled_from([f"w{k}" for k in range(12)])
events = st.one_of(
    st.just(("spread",)), st.tuples(st.sampled_from(["join", "leave", "work"]), names)
)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 9), st.lists(events, min_size=5, max_size=50))
def test_the_rules_hold_in_long_lives_of_many_workers(num_slots, life):
    leases = Leases(num_slots)
    for event in life:
        leases = check_all(leases, event)


def test_the_first_worker_takes_everything_at_once():
    leases = Leases(3)
    assert leases.join("a") == (0, 1, 2)
    assert leases.join("a") == ()
    assert leases.slots_of("a") == (0, 1, 2)


def test_a_newcomer_waits_for_the_next_spread():
    leases = with_workers(4, "a", "b")
    assert leases.slots_of("b") == ()
    leases.spread()
    assert (leases.slots_of("a"), leases.slots_of("b")) == ((0, 1), (2, 3))


def test_slots_are_spread_in_the_order_of_joining():
    leases = with_workers(7, "zoe", "adam", "mia")
    leases.spread()
    assert leases.slots_of("zoe") == (0, 1, 2)  # the odd one goes to who joined first
    assert leases.slots_of("adam") == (3, 4)
    assert leases.slots_of("mia") == (5, 6)


def test_workers_beyond_the_slots_are_spares_and_inherit_first():
    leases = with_workers(2, "a", "b", "c")
    leases.spread()
    assert leases.spares == ("c",)
    assert leases.leave("a") == {"c": (0,)}
    assert leases.slots_of("b") == (1,)


def test_the_slots_of_a_lost_worker_go_to_whoever_holds_the_fewest():
    leases = with_workers(4, "a", "b", "c")
    leases.spread()  # a 0 1, b 2, c 3
    assert leases.leave("a") == {"b": (0,), "c": (1,)}


def test_slots_wait_while_nobody_is_there():
    leases = with_workers(2, "a")
    assert leases.leave("a") == {}
    assert leases.holder == {}
    assert leases.join("b") == (0, 1)


def test_a_stranger_that_leaves_changes_nothing():
    leases = with_workers(2, "a")
    assert leases.leave("nobody") == {}
    assert leases.slots_of("a") == (0, 1)


def test_only_the_holder_makes_a_slot_current():
    leases = with_workers(2, "a", "b")
    leases.spread()
    leases.mark_current(0, "b")
    assert leases.current == set()
    leases.mark_current(0, "a")
    assert leases.current == {0}


def test_a_slot_stays_current_where_the_next_spread_leaves_it():
    leases = with_workers(2, "a")
    leases.mark_current(0, "a")
    leases.mark_current(1, "a")
    leases.join("b")
    leases.spread()  # slot 1 goes to b, which knows nothing of it
    assert leases.current == {0}


def test_slots_are_spread_by_measured_speed():
    leases = with_workers(8, "fast", "slow")
    leases.seconds = {"fast": 1.0, "slow": 3.0}
    leases.spread()  # 6 x 1 s against 2 x 3 s
    assert (leases.slots_of("fast"), leases.slots_of("slow")) == ((0, 1, 2, 3, 4, 5), (6, 7))


def test_a_worker_ten_times_slower_than_its_peer_stands_by():
    leases = with_workers(8, "fast", "slow")
    leases.seconds = {"fast": 1.0, "slow": 10.0}
    leases.spread()  # all 8 take 8 s on the fast one, a single slot takes 10 s on the slow one
    assert leases.spares == ("slow",)
    assert leases.leave("fast") == {"slow": tuple(range(8))}


def test_a_worker_that_was_not_measured_counts_as_the_fastest_one():
    leases = with_workers(9, "a", "b", "new")
    leases.seconds = {"a": 1.0, "b": 3.0}
    leases.spread()  # new counts as 1 s: 4 x 1 s, 1 x 3 s, 4 x 1 s
    assert [len(leases.slots_of(worker)) for worker in leases.workers] == [4, 1, 4]


def test_slots_stay_where_they_are_for_a_small_difference_of_speed():
    leases = with_workers(8, "a", "b")
    leases.spread()
    leases.seconds = {"a": 1.0, "b": 1.9}  # less than twice as slow: alike
    for _ in range(9):
        leases.spread()
    assert [len(leases.slots_of(worker)) for worker in leases.workers] == [4, 4]


def test_slots_move_when_it_has_been_worth_it_three_times_running():
    leases = with_workers(8, "a", "b")
    leases.spread()
    for seconds in (2.1, 2.1, 1.0, 2.1, 2.1):  # 4 x 2.1 s now, 6 x 1 s at best: 1.4 times
        leases.seconds = {"a": 1.0, "b": seconds}
        leases.spread()
        assert [len(leases.slots_of(worker)) for worker in leases.workers] == [4, 4]
    leases.spread()
    assert [len(leases.slots_of(worker)) for worker in leases.workers] == [6, 2]


def test_a_faster_spare_takes_the_place_of_a_slow_worker():
    leases = with_workers(2, "a", "slow", "spare")
    leases.spread()
    leases.seconds = {"a": 1.0, "slow": 4.0}  # the spare counts as 1 s
    for _ in range(3):
        leases.spread()
    assert leases.spares == ("slow",)


def test_an_even_spread_is_restored_after_a_loss():
    leases = with_workers(16, "a", "b")
    leases.spread()
    leases.leave("b")
    leases.join("b")
    leases.spread()
    assert [len(leases.slots_of(worker)) for worker in leases.workers] == [8, 8]
