"""The configuration of the curiosity reward. Does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import arg

from mapf_pz.rl.checks import check_counts, check_from_zero, check_names, check_positive

CuriosityName = Literal["none", "rnd", "random-features", "inverse-dynamics"]


@dataclass(frozen=True)
class CuriosityConfig:
    """An intrinsic reward for prediction errors, added to the task's reward; its encoders are like the policy's."""

    kind: Annotated[CuriosityName, arg(name="curiosity")] = "none"
    """Curiosity reward. `rnd`: error in predicting a random network's embedding of the next observation;
    `random-features`, `inverse-dynamics`: error in predicting the effect of an action on the embedding."""
    weight: Annotated[float, arg(name="curiosity-weight")] = 0.1
    """Weight of the curiosity reward, which is normalized to about 0.03 per step (the task's reward: about 0.1).
    Curiosity should dominate only where the task's reward is 0."""
    gamma: Annotated[float, arg(name="curiosity-gamma")] = 0.99
    """Discount factor of the curiosity return used for normalization."""
    size: Annotated[int, arg(name="curiosity-size")] = 64
    """Size of the embedding that is predicted for curiosity."""
    learning_rate: Annotated[float, arg(name="curiosity-learning-rate")] = 1e-4
    """Initial learning rate of the curiosity networks; it decays linearly to a tenth."""
    update_fraction: Annotated[float, arg(name="curiosity-update-fraction")] = 0.25
    """Fraction of each minibatch that the curiosity networks are trained on."""

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_names(self)
        check_counts(self, 1, "size")
        check_positive(self, math.inf, "learning_rate")
        check_positive(self, 1, "update_fraction")
        check_from_zero(self, 1, "gamma")
        check_from_zero(self, math.inf, "weight")
