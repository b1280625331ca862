"""Policies that act in several environments by one call of the network, and the rounding errors of such calls."""

import numpy as np
import pytest
import torch

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import Shield
from mapf_pz.rl import load_policy, policy_names
from mapf_pz.rl.networks.batched_network import MIN_ROWS, BatchedNetwork, Memory, Seen
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.config import EnvConfig
from tests.helpers.untrained import NUM_AGENTS, untrained

NUM_ENVS = 5

POLICIES = {
    "mappo": lambda: load_policy("mappo"),
    "communication": lambda: load_policy("central"),
    "stacked": lambda: untrained("central-ppo"),
    "recurrent": lambda: untrained(recurrent=12),
    "stacked, recurrent": lambda: untrained("central-ppo", recurrent=12),
    "communication, recurrent": lambda: untrained(
        task={"features": ("pose",)}, communication=1, hidden=32, recurrent=8
    ),
    "rounds": lambda: untrained("dagger", task={"features": ("pose",)}, communication=1, hidden=32, decision_rounds=3),
    "masks": lambda: untrained(mask_actions=True),
    "images": lambda: untrained(task={"features": ()}),
}


def keywords_of(policy, on_target):
    source = RandomObstacles(7, 7, 0.1, NUM_AGENTS)
    return policy.env_kwargs | {"source": source, "max_steps": 12, "on_target": on_target}


@pytest.mark.parametrize("shielded", [False, True])
@pytest.mark.parametrize("on_target", ["nothing", "restart", "finish"])
@pytest.mark.parametrize("name", POLICIES)
def test_each_environment_is_as_a_single_one(name, on_target, shielded):
    policy = POLICIES[name]()
    if policy.num_agents is not None and on_target == "finish":
        pytest.skip("this policy acts for a fixed number of agents")
    keywords = keywords_of(policy, on_target)
    simulator = Simulator(EnvConfig(**keywords), NUM_ENVS)
    simulator.reset(seeds={b: b for b in range(NUM_ENVS)})
    envs, singles, observed = [], [], []
    for b in range(NUM_ENVS):
        env = mapf_pz.parallel_env(**keywords)
        observed.append(env.reset(seed=b))
        single = POLICIES[name]()
        singles.append(Shield(single, env) if shielded else single)
        envs.append(env)
    batch = (Shield(policy, envs[0]) if shielded else policy).in_batch(simulator)
    steps = 0
    while running := [b for b in range(NUM_ENVS) if envs[b].agents]:
        actions = batch.actions(simulator.observe(), running)
        for b in running:
            observations, infos = observed[b]
            needs_infos = getattr(singles[b], "needs_infos", False)
            expected = singles[b].act(observations, infos) if needs_infos else singles[b].act(observations)
            assert {agent: actions[b, int(agent[6:])] for agent in observations} == expected
            observations, _, _, _, infos = envs[b].step(expected)
            observed[b] = observations, infos
        simulator.step(actions)
        steps += 1
    assert steps > 5


def test_an_environment_that_is_reset():
    policy = untrained(recurrent=12)
    simulator = Simulator(EnvConfig(**keywords_of(policy, "nothing")), 2)
    batch = policy.in_batch(simulator)

    def actions():
        simulator.reset([0], seeds={0: 3})
        batch.reset(0)
        taken = []
        for _ in range(4):
            taken.append(batch.actions(simulator.observe(), [0, 1])[0].tolist())
            simulator.step(np.array([taken[-1], [0] * NUM_AGENTS]))
        return taken

    simulator.reset(seeds={0: 0, 1: 1})
    assert actions() == actions()


def test_observations_of_another_kind_are_refused():
    policy = load_policy("mappo")
    for other in ({"view_size": (5, 5)}, {"features": ()}):
        simulator = Simulator(EnvConfig(**(keywords_of(policy, "nothing") | other)), 2)
        with pytest.raises(
            ValueError, match=r"^observation of 'agent_0': this policy observes a Dict of image \(5, 7, 7\)"
        ):
            policy.in_batch(simulator)


@pytest.mark.parametrize("name", [name for name in policy_names() if not name.startswith(("central", "report"))])
def test_outputs_do_not_depend_on_the_batch(name):
    """This depends on the processor's routines of matrix products; `MIN_ROWS` describes them."""
    policy = load_policy(name)
    shape, generator = ObservationShape.of_task(policy.config.task), torch.Generator().manual_seed(1)
    image = torch.rand(70, *shape.image, generator=generator)
    features = torch.randn(70, shape.features, generator=generator)
    network = BatchedNetwork(policy.network, communicates=False, num_agents=None, recurrent=0)

    def logits(rows):
        with torch.no_grad():
            return network(Seen([len(rows)], rows, image[rows], features[rows]), [Memory(0)])[0]

    whole = logits(list(range(70)))
    assert len(whole.unique(dim=0)) == 70
    for number in (1, 2, 3, MIN_ROWS - 1, MIN_ROWS, MIN_ROWS + 1, 33):
        rows = torch.randperm(70, generator=generator)[:number].tolist()
        assert torch.equal(logits(rows), whole[rows])
