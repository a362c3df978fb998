"""Named recipes, as functions of the environment.

Sources: "paper" is Safe Actor-Critic, sections 4.2 and Table 2, whose baseline is the public
code it cites; "authors-2019" is what the authors' own code did; "heess2017" is Heess et al. 2017,
Algorithms 2 and 3. Where the sources give no number, the default stays.
"""

from collections.abc import Callable
from dataclasses import replace

from dppo.config import Config

PAPER_PSI = {"HalfCheetah": 0.15, "Ant": 0.1, "Hopper": 0.075, "Walker2d": 0.075}
"""Table 2: the best ψ of each environment."""
_PAPER_RATES = {
    "HalfCheetah": (8.87e-5, 1.83e-3), "Ant": (7.37e-5, 1.64e-3),
    "Hopper": (1.16e-4, 2.04e-3), "Walker2d": (8.87e-5, 1.83e-3), "Ant-v5": (5.28e-5, 1.18e-3),
}  # fmt: skip
"""Step sizes of policy and critics: the cited baseline's 9e-4/√h2 and 1e-2/√h2. Of -v5 only Ant
has another observation; environments that are not here get Walker2d's."""


def default(env: str) -> Config:
    """Minibatched, tanh 64x64, γ .99 to .995, λ .95, KL target .02, step sizes linear to 0."""
    config = Config()
    return replace(config, run=replace(config.run, env=env))


def paper(env: str) -> Config:
    """The paper's baseline recipe with its ψ.

    20 full-batch policy updates, 10 passes of minibatches for the critics with the previous batch
    replayed, γ .995, λ .98, KL target .003, rewards times (1 - γ), a time feature and no
    bootstrap at the time limit, Monte-Carlo targets. Its batch of 20 episodes (5 for HalfCheetah)
    is 20 (5) slots of one environment and 1000 steps here: slots have fixed sizes.
    """
    base = default(env)
    name = _kind(env)
    few = name == "HalfCheetah"
    rates = _PAPER_RATES.get(name, _PAPER_RATES["Walker2d"])
    policy_rate, critic_rate = _PAPER_RATES.get(name + env[-3:], rates)
    return replace(
        base,
        rollout=replace(
            base.rollout, slots=5 if few else 20, num_envs=1, num_steps=1000,
            time_limit="time-feature", normalize_obs="paper", clip_obs=float("inf"),
            reward_scale="one-minus-gamma",
        ),
        returns=replace(
            base.returns, gamma=0.995, gamma_start=-1.0, gae_lambda=0.98, targets="monte-carlo"
        ),
        safety=replace(base.safety, psi=PAPER_PSI.get(name, 0.1), sigma_head="linear"),
        update=replace(
            base.update, learning_rate=policy_rate, critic_learning_rate=critic_rate,
            lr_schedule="servo", update_epochs=20, num_minibatches=1,
            critic_epochs=10, critic_minibatches=40 if few else 125,
            critic_replay=True, max_grad_norm=float("inf"), adam_eps=1e-8,
        ),
        kl=replace(base.kl, kl_target=0.003),
        network=replace(
            base.network, architecture="paper", init="fan-in", log_std_init=-0.5,
            log_std_rate=-1.0,
        ),
    )  # fmt: skip


def _kind(env: str) -> str:
    """Which of Table 2's environments this is, or a hazardous kin of it; empty: none."""
    bare = env.rpartition(":")[2]
    return next((kind for kind in PAPER_PSI if bare.startswith(kind)), "")


def authors_2019(env: str) -> Config:
    """The paper's recipe as its authors' 2019 code ran it: γ̄ = γλ, σ fed by unscaled rewards."""
    base = paper(env)
    return replace(
        base, returns=replace(base.returns, gamma_bar="authors-2019", delta_reward="raw")
    )


def heess2017(env: str) -> Config:
    """DPPO as published: K-step windows with K-step returns, full-batch updates, KL per worker."""
    base = default(env)
    return replace(
        base,
        rollout=replace(base.rollout, num_envs=1, num_steps=500, window=50),
        returns=replace(base.returns, gamma=0.99, gae_lambda=1.0),
        update=replace(
            base.update, learning_rate=3e-4, critic_learning_rate=1e-3,
            lr_schedule="constant", update_epochs=20, num_minibatches=1,
            critic_epochs=50, critic_minibatches=1,
        ),
        kl=replace(base.kl, kl_scope="worker"),
    )  # fmt: skip


PRESETS: dict[str, Callable[[str], Config]] = {
    "default": default,
    "paper": paper,
    "authors-2019": authors_2019,
    "heess2017": heess2017,
}
