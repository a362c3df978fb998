"""σ, the variance of the return, on a chain of three states, against its closed form.

    s_0 -> s_1 -> s_2 -> end        leaving s_k pays a normal reward: mean m_k, std d_k

The return from s_k is a sum of independent rewards, so its variance is known:
Var[G | s_k] = d_k² + γ² Var[G | s_{k+1}]. The estimator of the trainer has to find the same from
episodes alone, by the recursion σ(s) = E[δ² + γ̄ σ(s')] with γ̄ = (γ λ_ret)² and λ_ret = 1.
"""

import numpy as np

from dppo.config import ReturnsConfig
from dppo.returns import discounted_sums, estimate, estimate_variance

EPISODES = 50_000
MEAN, STD = np.array([1.0, -2.0, 3.0]), np.array([1.0, 2.0, 3.0])
SETTINGS = ReturnsConfig(gamma=0.9, gae_lambda=0.95, lambda_ret=1.0)


def closed_form() -> list[float]:
    s2 = STD[2] ** 2
    s1 = STD[1] ** 2 + SETTINGS.gamma**2 * s2
    s0 = STD[0] ** 2 + SETTINGS.gamma**2 * s1
    return [s0, s1, s2]


def main() -> None:
    # time is the first axis, episodes the second: row t is the step that leaves s_t
    reward = np.random.default_rng(0).normal(MEAN[:, None], STD[:, None], (3, EPISODES))
    over = np.zeros(reward.shape, np.bool_)
    over[-1] = True

    v, sigma = np.zeros(3), np.zeros(3)
    for _ in range(50):  # what the two critics do by gradient, a table does by averaging
        v_now, v_next = table(v), table(np.append(v[1:], 0.0))
        delta, value = estimate(
            reward, v_now, v_next, over, over, discount=SETTINGS.gamma, trace=SETTINGS.gae_lambda
        )
        sigma_now, sigma_next = table(sigma), table(np.append(sigma[1:], 0.0))
        variance = estimate_variance(delta, sigma_now, sigma_next, over, over, SETTINGS)
        v, sigma = value.target.mean(axis=1), variance.target.mean(axis=1)

    sampled = discounted_sums(reward, over, SETTINGS.gamma).var(axis=1)
    print("state  closed form  sigma  variance of the sampled returns")
    for state, exact in enumerate(closed_form()):
        print(f"s_{state}    {exact:11.3f}  {sigma[state]:6.3f}  {sampled[state]:6.3f}")


def table(values: np.ndarray) -> np.ndarray:
    """The value of each step's state, for all episodes [3, EPISODES]."""
    return np.repeat(values[:, None], EPISODES, axis=1)


if __name__ == "__main__":
    main()
