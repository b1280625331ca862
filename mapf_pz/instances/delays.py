"""Delays of agents: how often they begin, and how long they take."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field

from mapf_pz._internal.config import Count, Share, as_tuple, checked, expecting

Events = Literal["bernoulli", "poisson"]
Durations = Literal["uniform", "normal"]
MAX_DURATION = 2**20
"""Maximum number of steps of a delay."""
NORMAL_DEVIATION = 0.22
"""Standard deviation of normal durations, as a fraction of their range: that of the League of Robot Runners."""
_NUMBER = r"\d+(\.\d*)?(e-?\d+)?"
_TEXT = re.compile(
    rf"(?P<probability>{_NUMBER}):(?P<smallest>\d+)-(?P<largest>\d+)(?P<poisson>:poisson)?(?P<normal>:normal)?"
)
Duration = Annotated[
    tuple[Annotated[Count, Field(le=MAX_DURATION)], Annotated[Count, Field(le=MAX_DURATION)]],
    BeforeValidator(as_tuple),
    expecting(f"(smallest, largest), each a whole number from 1 to {MAX_DURATION}"),
]
"""The smallest and the largest number of steps."""


@checked
@dataclass(frozen=True)
class Delays:
    """Delays of agents. In a step in which it is delayed, an agent waits, whatever its action.

    A delay begins in a step whose actions are already chosen: no agent knows of it before. Delays depend on the seed of
    the episode, the agent and the step alone, not on actions. The models are those of the Start-Kit 3.1 of the League
    of Robot Runners.

    The text of a configuration is `PROBABILITY:SMALLEST-LARGEST`, optionally with `:poisson` and `:normal`, such as
    `0.003:2-8:poisson`.
    """

    probability: Share = 0.01
    """Probability that a delay of an agent begins in a step, unless the agent is delayed already; with `poisson`, mean
    number of delays that begin in a step, divided by the number of agents."""
    duration: Duration = (1, 4)
    """Smallest and largest number of steps of a delay."""
    events: Events = "bernoulli"
    """How delays begin: `bernoulli` (of each agent by itself) or `poisson` (of a Poisson distributed number of agents
    that are not delayed, chosen at random)."""
    durations: Durations = "uniform"
    """Distribution of the number of steps: `uniform`, or `normal`, whose mean is in the middle, whose standard
    deviation is 0.22 of the range, and which is rounded and limited to the range."""

    def __post_init__(self) -> None:
        """Raise `ValueError` if the smallest duration exceeds the largest."""
        smallest, largest = self.duration
        if smallest > largest:
            raise ValueError(f"duration={self.duration}: expected the smallest number of steps first")

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Return the delays that a text states; raises `ValueError` if it is malformed."""
        found = _TEXT.fullmatch(text)
        if found is None or not float(found["probability"]) <= 1:
            expected = "PROBABILITY:SMALLEST-LARGEST, optionally with :poisson and :normal, such as 0.01:1-4"
            raise ValueError(f"expected {expected}")
        return cls(
            float(found["probability"]),
            (int(found["smallest"]), int(found["largest"])),
            events="poisson" if found["poisson"] else "bernoulli",
            durations="normal" if found["normal"] else "uniform",
        )

    def __str__(self) -> str:
        """Return the text, which `from_text` reads."""
        smallest, largest = self.duration
        events = ":poisson" if self.events == "poisson" else ""
        durations = ":normal" if self.durations == "normal" else ""
        return f"{self.probability!r}:{smallest}-{largest}{events}{durations}"
