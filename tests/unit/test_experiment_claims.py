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
    results["together"] = together(results["environments"], "psi0")
    (found,) = [one for one in claims(results) if "abstract" in one[0]]
    assert here in found[1]
    assert found[2] == judgement


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
