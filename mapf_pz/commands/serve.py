"""The command `mapf-pz serve`: a policy for POGEMA's environment in a separate process."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from tyro.conf import Positional

from mapf_pz.evaluation.pogema.pogema import InPogema
from mapf_pz.evaluation.pogema.served_policy import replies
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.planners.named import import_code
from mapf_pz.simulator.config import CollisionSystem, OnTarget


@dataclass(frozen=True)
class ServeOptions:
    """Options of `mapf-pz serve`, which must equal those of POGEMA's `GridConfig`."""

    policy: Positional[str]
    """A planner, or a trained policy with cardinal actions: a bundled one or the folder of a run."""
    collision_system: CollisionSystem
    """How conflicting moves are resolved."""
    on_target: OnTarget
    """What an agent does at its goal."""
    max_steps: int
    """Maximum number of steps per episode, POGEMA's `max_episode_steps`."""
    trust_remote_code: bool = False
    """Load policies whose configurations name code outside this package (`package.module:name`), and run that code."""


def serve(options: ServeOptions) -> None:
    """Act in POGEMA's environment, the dependencies of which conflict with this package's.

    Reads observations from the standard input and writes actions to the standard output, as lines of JSON, until the
    input ends. `examples/in_pogema.py` is a client.
    """
    import_code(options.policy)
    policy = InPogema(
        policy_factory(options.policy, trust_remote_code=options.trust_remote_code),
        collision_system=options.collision_system,
        on_target=options.on_target,
        max_steps=options.max_steps,
    )
    for reply in replies(policy, sys.stdin):
        print(reply, flush=True)
