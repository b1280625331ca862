"""Communication: which agents exchange embeddings, in what frame, and that every algorithm trains such a policy."""

import dataclasses

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.nn.functional import one_hot
from torchrl.envs.utils import set_exploration_type, ExplorationType

import mapf_pz
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.instances.sources import RandomObstacles
from mapf_pz.planners import Shield
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms import ALGORITHMS
from mapf_pz.rl.collect import MakeEnv, collecting
from mapf_pz.rl.communication import CommunicatingEncoder
from mapf_pz.rl.config import ImitationConfig, ModelConfig
from mapf_pz.rl.expert import NO_LABEL
from mapf_pz.rl.observation_shape import ObservationShape
from mapf_pz.rl.train import resume
from tests.helpers.small_run import TINY, changed, untimed

SHAPE = ObservationShape((2, 3, 3), 8, 4, slice(2, 8))
MODEL = dataclasses.replace(TINY.model, hidden=32, head=(8,), communication=2, communication_radius=2)
TALKING = dataclasses.replace(
    TINY, task=changed(TINY.task, features=("action_advantage", "pose", "time")), model=MODEL, agent_steps=384
)
ALGORITHM_NAMES = ["mappo", "ippo", "central-ppo", "dagger"]


def talking(name, **model):
    imitation = ImitationConfig(expert="pibt", expert_share=0.5)
    changed_model = dataclasses.replace(MODEL, **model)
    return dataclasses.replace(TALKING, algorithm=name, model=changed_model, imitation=imitation)


def louder(network):
    """Increase the weights, so that what others send has a clear effect."""
    with torch.no_grad():
        for parameter in network.parameters():
            if parameter.ndim > 1:
                torch.nn.init.normal_(parameter, std=0.3)
    return network


def encoder(rounds=2, radius=None):
    torch.manual_seed(0)
    config = ModelConfig(conv_channels=(4,), hidden=32, communication=rounds, communication_radius=radius)
    network = louder(CommunicatingEncoder(SHAPE, config))
    with torch.no_grad():  # the agent's own pose has an effect only on communication
        network.encoder.joint[0].weight[:, -6:] = 0
    return network


def observations(positions, headings, seed=0):
    """Random observations of B teams of N agents at these positions, with these headings."""
    generator = torch.Generator().manual_seed(seed)
    image = torch.randn(*headings.shape, *SHAPE.image, generator=generator)
    numbers = torch.randn(*headings.shape, 2, generator=generator)
    return image, torch.cat([numbers, positions / 32768, one_hot(headings, 4)], -1)


def poses(num_teams=20, num_agents=6, side=7):
    generator = torch.Generator().manual_seed(1)
    cells = torch.stack([torch.randperm(side * side, generator=generator)[:num_agents] for _ in range(num_teams)])
    headings = torch.randint(4, cells.shape, generator=generator)
    return torch.stack([cells // side, cells % side], -1), headings


def equal(first, second):
    return torch.allclose(first, second, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("radius", [None, 2])
def test_only_relative_poses_matter(radius):
    network, (positions, headings) = encoder(radius=radius), poses()
    embedding = network(*observations(positions, headings))
    assert equal(network(*observations(positions + torch.tensor([40, 9]), headings)), embedding)
    turned = torch.stack([positions[..., 1], 20 - positions[..., 0]], -1)  # east becomes south
    assert equal(network(*observations(turned, (headings + 1) % 4)), embedding)
    assert not equal(network(*observations(turned, headings)), embedding)
    mirrored = positions.flip(-1)
    assert not equal(network(*observations(mirrored, headings)), embedding)
    assert not equal(network(*observations(positions, (headings + 2) % 4)), embedding) or radius == 0


def test_embeddings_are_permuted_with_the_agents():
    network, order = encoder(), torch.tensor([3, 0, 5, 4, 2, 1])
    image, features = observations(*poses())
    assert equal(network(image[:, order], features[:, order]), network(image, features)[:, order])


@pytest.mark.parametrize(("rounds", "radius"), [(1, None), (1, 0), (1, 2), (2, 2), (3, 1)])
def test_who_receives_from_whom(rounds, radius):
    network, (positions, headings) = encoder(rounds, radius), poses()
    image, features = observations(positions, headings)
    near = (positions[:, :, None] - positions[:, None]).abs().amax(-1) <= (100 if radius is None else radius)
    reached = near.float()
    for _ in range(rounds - 1):
        reached = (reached @ near.float() > 0).float()
    for sender in range(headings.shape[1]):
        other = image.clone()
        other[:, sender] += 1
        differs = (network(other, features) != network(image, features)).any(-1)
        assert torch.equal(differs, reached[:, :, sender] > 0)


def test_nobody_receives_from_agents_that_have_disappeared():
    network = encoder()
    image, features = observations(*poses())
    image[:, 2:4], features[:, 2:4] = 0, 0
    present = [0, 1, 4, 5]
    alone = network(image[:, present], features[:, present])
    assert equal(network(image, features)[:, present], alone)


@pytest.mark.parametrize("lead", [(), (2,), (2, 3)])
def test_any_leading_dimensions_and_any_number_of_agents(lead):
    network = encoder()
    for num_agents in (1, 4):
        image, features = torch.randn(*lead, num_agents, *SHAPE.image), torch.rand(*lead, num_agents, SHAPE.features)
        assert network(image, features).shape == (*lead, num_agents, 32)


def test_the_pose_of_the_current_step_is_used():
    task = changed(TALKING.task, num_frames=2, num_neighbors=1, features=("time", "pose", "goal_vector"))
    observed = mapf_pz.parallel_env(**task.env_keywords()).reset(seed=0)[0]
    shape = ObservationShape.of_task(task)
    env = mapf_pz.parallel_env(**task.env_keywords())
    observed, _ = env.reset(seed=0)
    for _ in range(3):
        for (row, col), heading, values in zip(env.positions, env.headings, observed.values(), strict=True):
            expected = [row / 32768, col / 32768, *(float(heading == h) for h in range(4))]
            assert values["features"][shape.pose].tolist() == expected
        observed, *_ = env.step({name: int(env.action_space(name).sample()) for name in env.agents})


@pytest.mark.parametrize("recurrent", [0, 12])
@pytest.mark.parametrize("name", ALGORITHM_NAMES)
def test_a_run_is_trained_and_resumed_and_its_policy_acts_as_its_network(tmp_path, name, recurrent):
    if recurrent and name == "dagger":
        pytest.skip("imitation uses single steps")
    config = talking(name, recurrent=recurrent)
    once = train(config, tmp_path / "once")
    folder = train(dataclasses.replace(config, agent_steps=192), tmp_path / "run")
    resume(folder, agent_steps=384)
    assert untimed(folder)[0] == untimed(once)[0]
    policy = load_policy(folder, deterministic=True)
    louder(policy.network)
    for num_agents in (3, 5):  # also for another number of agents
        env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=num_agents)
        observed, _ = env.reset(seed=num_agents)
        policy.reset_states()
        image, features = (
            torch.from_numpy(np.stack([o[key] for o in observed.values()])) for key in ("image", "features")
        )
        batch = image[None], features[None]
        if recurrent:
            batch = torch.zeros(1, num_agents, 12), torch.ones(1, 1, dtype=torch.bool), *batch
        with torch.no_grad():
            best, *_ = policy.network(*batch)
        found = np.stack(list(policy.preferences(observed).values()))
        expected = best[0].clamp(-1, 1) if name == "central-ppo" else best[0]
        np.testing.assert_allclose(found, expected.numpy(), rtol=1e-4, atol=1e-5)
        policy.reset_states()
        assert set(policy.act(observed)) == set(env.agents)


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
def test_an_agent_acts_with_the_others(tmp_path, on_target):
    config = dataclasses.replace(talking("mappo"), task=changed(TALKING.task, on_target=on_target), agent_steps=192)
    policy = load_policy(train(config, tmp_path), deterministic=True)
    louder(policy.network)
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=6, map="empty-8-8", on_target=on_target)
    observed, _ = env.reset(seed=0)
    together = policy.preferences(observed)
    alone = {name: policy.preferences({name: value})[name] for name, value in observed.items()}
    assert any(not np.allclose(together[name], alone[name]) for name in observed)
    shield = Shield(policy, env)
    while env.agents:
        observed, *_ = env.step(shield.act(observed))
    task = EvaluationTask("empty-8-8", 4, {"map": "empty-8-8", "on_target": on_target, "max_steps": 16}, episodes=2)
    assert len(evaluate({"it": policy}, [task])) == 2
