"""Evaluate your own policy, PIBT and a random policy on the same episodes."""

from typing import Any

from mapf_pz import RandomObstacles
from mapf_pz.evaluation import EvaluationTask, evaluate, markdown_table


class Greedy:
    """Takes the action with the lowest cost to go, as if the agent were alone."""

    env_kwargs = {  # noqa: RUF012 (required observations: for each action, its cost relative to the best one)
        "view_size": (1, 1),
        "features": ("action_advantage",),
    }

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        return {agent: int(seen["features"].argmax()) for agent, seen in observations.items()}

    def reset_states(self) -> None:
        """Reset all per-episode state, of which there is none."""


suite = [
    EvaluationTask(
        "random 12 x 12", num_agents, {"source": RandomObstacles(12, 12, 0.15, num_agents), "max_steps": 96}, 8
    )
    for num_agents in (2, 8)
]
episodes = evaluate({"greedy": Greedy(), "pibt": "pibt", "random": "random"}, suite)
print(markdown_table(episodes))
