"""The paper's claims: each is judged by the verdicts that it is made of, and by no other."""

import pytest

from dppo.experiment.claims import claims
from dppo.experiment.table2 import ENVIRONMENTS
from dppo.experiment.together import together
from tests.experiment_results import results_of

OPEN = "Not decided: no difference that 5 seeds can show."
NOT = "The claim does not hold here: {}."
HOLDS = "The claim holds here: {}."
BOUGHT = "Not what is claimed: lower, but at a lower mean."


def judged(words, verdicts, status="whole"):
    """The one claim with these words: what is said to it here, and the judgement."""
    found = [one for one in claims(results_of(verdicts, status)) if words in one[0]]
    ((_, here, judgement),) = found
    return here, judgement


@pytest.mark.parametrize(
    ("env", "words", "verdicts", "judgement"),
    [
        ("Ant-v4", "figure 7", {"mean": "higher"}, HOLDS.format("higher")),
        ("Ant-v4", "figure 7", {"mean": "lower"}, NOT.format("lower")),
        ("Ant-v4", "figure 7", {}, OPEN),
        ("Walker2d-v4", "figure 9", {"mean": "lower"}, HOLDS.format("lower")),
        ("Walker2d-v4", "figure 9", {"mean": "higher"}, "Better than the paper reports: higher."),
        ("Ant-v4", "across seeds", {"spread": "lower"}, HOLDS.format("lower")),
        ("Ant-v4", "across seeds", {"spread": "higher"}, NOT.format("higher")),
        ("Ant-v4", "across seeds", {}, OPEN),
        ("Ant-v4", "across seeds", {"spread": "lower", "mean": "lower"}, BOUGHT),
        ("Walker2d-v4", "across seeds", {"spread": "lower", "mean": "lower"},
         HOLDS.format("lower")),
        ("Ant-v4", "consistent", {"within": "lower"}, HOLDS.format("lower")),
        ("Ant-v4", "consistent", {"within": "higher"}, NOT.format("higher")),
        ("Ant-v4", "consistent", {}, OPEN),
        ("Ant-v4", "consistent", {"within": "lower", "mean": "lower"}, HOLDS.format("lower")),
        ("Ant-v4", "consistent", {"within": "lower", "policy_mean": "lower"}, BOUGHT),
        ("Ant-v4", "life-span", {"life": "higher"}, HOLDS.format("higher")),
        ("Ant-v4", "life-span", {"life": "lower"}, NOT.format("lower")),
        ("Ant-v4", "life-span", {}, OPEN),
        ("Ant-v4", "faster", {"speed": "higher"}, HOLDS.format("higher")),
        ("Ant-v4", "faster", {"speed": "lower"}, NOT.format("lower")),
        ("Ant-v4", "faster", {}, OPEN),
    ],
)  # fmt: skip
def test_a_claim_about_one_environment_is_judged_by_its_own_verdict(
    env, words, verdicts, judgement
):
    assert judged(words, {env: verdicts})[1] == judgement


def everywhere(**verdicts):
    return dict.fromkeys(ENVIRONMENTS, verdicts)


@pytest.mark.parametrize(
    ("words", "verdicts", "judgement"),
    [
        ("boosts", everywhere(mean="higher"), "Holds here."),
        ("boosts", everywhere(spread="lower"), "Holds here."),
        ("boosts", everywhere(spread="lower", mean="lower"), "Not shown here in all of them."),
        ("boosts", everywhere(mean="higher") | {"Ant-v4": {}}, "Not shown here in all of them."),
        ("outperforms", everywhere(mean="higher"), "Holds here."),
        ("outperforms", everywhere(), "Not shown here in all of them."),
        ("outperforms", everywhere(mean="higher") | {"Ant-v4": {"mean": "lower"}},
         "Does not hold here."),
        ("abstract", everywhere(spread="lower") | {"Ant-v4": {"spread": "higher"}},
         NOT.format("higher (Ant-v4)")),
        ("abstract", {"Ant-v4": {"spread": "lower"}},
         "Not decided: 1 of the 4 environments were run."),
    ],
)  # fmt: skip
def test_a_claim_about_all_environments_takes_all_of_them(words, verdicts, judgement):
    assert judged(words, verdicts)[1] == judgement


@pytest.mark.parametrize(
    ("ratios", "here", "judgement"),
    [
        # logs -.69 -.92 -.51 -.69: mean -.704, standard error .0833, t 3.182: ± .265
        ((0.5, 0.4, 0.6, 0.5), "together, 0.49 times [0.38, 0.64]", HOLDS.format("lower")),
        ((2.0, 2.5, 1.6, 2.0), "together, 2.00 times", NOT.format("higher")),
        ((0.5, 2.0, 0.5, 2.0), "together, 1.00 times",
         "Not decided: no difference that these environments show together."),
    ],
)  # fmt: skip
def test_the_abstracts_claim_is_judged_by_all_environments_together(ratios, here, judgement):
    results = results_of(everywhere())
    for ratio, one in zip(ratios, results["environments"].values(), strict=True):
        one["arms"]["psi-paper"]["against_baseline"]["last200"]["std_ratio"] = ratio
    (found,) = [one for one in claims(results) if "abstract" in one[0]]
    assert here in found[1]
    assert found[2] == judgement


def abstract_of(results):
    (found,) = [one for one in claims(results) if "abstract" in one[0]]
    return found


def narrower(results, ratios=(0.5, 0.4, 0.6, 0.5)):
    """The paper's arms with these ratios of spreads across seeds."""
    for ratio, env in zip(ratios, ENVIRONMENTS, strict=True):
        arm = results["environments"][env]["arms"]["psi-paper"]
        arm["against_baseline"]["last200"]["std_ratio"] = ratio
    return results


def test_the_abstracts_claim_is_not_bought_with_a_lower_mean():
    verdicts = everywhere() | {"Ant-v4": {"mean": "lower"}}
    assert abstract_of(narrower(results_of(verdicts)))[2] == (
        "Not what is claimed: lower, but at a lower mean (Ant-v4)."
    )


def test_the_abstracts_claim_is_of_the_papers_environments_and_psi_alone():
    """Others in the folder, without that arm or with it, and other names of it, change nothing."""
    expected = abstract_of(narrower(results_of(everywhere())))
    results = narrower(results_of(everywhere()))
    odd = results_of({"Ant-v4": {}})["environments"]["Ant-v4"]
    odd["arms"]["psi-paper"]["against_baseline"]["last200"]["std_ratio"] = 9.0
    results["environments"]["AntRiskySpeed-v4"] = odd
    results["environments"]["Pusher-v5"] = {"arms": {"psi0": odd["arms"]["psi0"]}}
    arms = results["environments"]["Ant-v4"]["arms"]
    arms["psi0.1"] = arms.pop("psi-paper")
    assert abstract_of(results) == expected
    assert "0.49 times [0.38, 0.64]" in expected[1]


@pytest.mark.parametrize(
    ("ours", "judgement"),
    [(4800.0, HOLDS.format("lower")),
     (4700.0, "Not what is claimed: lower, but at a lower mean than the paper's 95%.")],
)  # fmt: skip
def test_on_walker_the_mean_may_drop_as_far_as_the_papers(ours, judgement):
    """Theirs: 6191.5 of 6506.5."""
    results = results_of({"Walker2d-v4": {"spread": "lower", "mean": "lower"}})
    arms = results["environments"]["Walker2d-v4"]["arms"]
    for arm, mean in (("psi0", 5000.0), ("psi-paper", ours)):
        last = arms[arm]["training"]["last200"]
        arms[arm] |= {"training": {"last200": last | {"mean": mean}}}
    (found,) = [one for one in claims(results) if "across seeds" in one[0]]
    assert found[2] == judgement


def test_a_life_span_is_not_judged_where_nobody_falls():
    results = results_of({"HalfCheetah-v4": {}})
    for arm in results["environments"]["HalfCheetah-v4"]["arms"].values():
        free = arm["evaluation"]["free"]
        arm["evaluation"] = {"free": free | {"falls": 0.0}}
    (found,) = [one for one in claims(results) if "life-span" in one[0]]
    assert found[1:] == ("no episode ends before 10 steps", "Not judged: nobody falls.")


def test_fewer_falls_are_told_beside_the_life_span():
    (found,) = [one for one in claims(results_of({"Ant-v4": {"falls": "lower"}}))
                if "life-span" in one[0]]  # fmt: skip
    assert found[1].endswith("falls 50% against 50% of the episodes (lower)")
    assert found[2] == "Not decided: no difference that 5 seeds can show."


def test_learning_is_not_faster_by_the_number_that_the_mean_is_judged_by():
    results = results_of({"Ant-v4": {}})
    results["environments"]["Ant-v4"]["arms"]["psi-paper"]["steps"] = 1_000_000
    assert not [one for one in claims(results) if "faster" in one[0]]


def test_a_baseline_with_a_penalty_of_another_kind_is_not_the_papers():
    results = results_of({"Ant-v4": {}})
    results["environments"]["Ant-v4"]["arms"]["psi0"]["is_plain"] = False
    assert not list(claims(results))


def test_what_one_environment_lacks_is_not_compared_over_all():
    results = results_of(everywhere())
    assert set(together(results["environments"], "psi0")["psi-paper"]) == {
        "across", "within", "within_mean"
    }  # fmt: skip
    against = results["environments"]["Ant-v4"]["arms"]["psi-paper"]["against_baseline"]
    del against["free"]
    assert set(together(results["environments"], "psi0")["psi-paper"]) == {"across"}
    against["last200"]["seeds"] = [5, 1]
    assert together(results["environments"], "psi0") == {}
    two = {env: results["environments"][env] for env in ("Hopper-v4", "HalfCheetah-v4")}
    assert together(two, "psi0") == {}


def test_judgements_of_a_partial_grid_are_interim():
    for status, begin in (("partial", "Interim. The claim"), ("whole", "The claim")):
        _, judgement = judged("figure 7", {"Ant-v4": {"mean": "higher"}}, status)
        assert judgement.startswith(begin)


def test_numbers_beside_a_ratio_are_the_geometric_means_it_is_of():
    here, _ = judged("consistent", {"Ant-v4": {}})
    assert here.startswith(
        "returns of one policy's episodes spread by 2.0 against 2.0, 1.00 times"
    )
