"""What an environment looks like to the algorithm: sizes, not objects."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class Spaces:
    """Sizes of one environment's observation and action.

    A worker reports them when it joins; the learner builds the networks from them, so it never
    needs the environment itself.
    """

    obs_size: int
    """O: length of the flattened observation, without the time feature."""
    action_kind: Literal["box", "discrete"]
    """box: a Gaussian per dimension; discrete: one categorical per entry of `action_sizes`."""
    action_sizes: tuple[int, ...]
    """box: (A,); discrete: the number of choices of each action component."""

    @property
    def action_size(self) -> int:
        """A: numbers per action."""
        return self.action_sizes[0] if self.action_kind == "box" else len(self.action_sizes)

    @property
    def output_size(self) -> int:
        """Numbers the policy network puts out: means, or logits of all components."""
        return sum(self.action_sizes)
