"""Communication: which agents exchange embeddings, in what frame, and that every algorithm trains such a policy."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from torch.nn.functional import one_hot
from torchrl.modules import set_recurrent_mode

import mapf_pz
from mapf_pz.errors import FormatError
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.planners import Shield
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.expert import NO_LABEL
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig, ModelConfig
from mapf_pz.rl.config_file import CONFIG
from mapf_pz.rl.environments.collect import collecting
from mapf_pz.rl.networks.communication import CommunicatingEncoder
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.rl.training.train import resume
from tests.helpers.labeled_steps import labeled_steps
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
    assert not equal(network(*observations(positions, (headings + 2) % 4)), embedding)


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
    rng = np.random.default_rng(0)
    for _ in range(3):
        for (row, col), heading, values in zip(env.positions, env.headings, observed.values(), strict=True):
            expected = [row / 32768, col / 32768, *(float(heading == h) for h in range(4))]
            assert values["features"][shape.pose].tolist() == expected
        observed, *_ = env.step({name: int(rng.integers(env.action_space(name).n)) for name in env.agents})


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
    assert policy.num_agents is None
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
            batch = torch.zeros(1, num_agents, 12), torch.zeros(1, 1, dtype=torch.bool), *batch
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


@pytest.mark.parametrize("recurrent", [0, 12])
@pytest.mark.parametrize("name", ["mappo", "central-ppo"])
def test_the_loss_finds_the_log_probs_that_the_collector_acted_with(name, recurrent):
    torch.manual_seed(0)
    algorithm = ALGORITHMS[name](talking(name, recurrent=recurrent))
    louder(algorithm.network)
    group = "team" if name == "central-ppo" else "agents"
    with collecting(algorithm, algorithm.config, 0, 1) as collector:
        batch = next(iter(collector))
    with torch.no_grad(), set_recurrent_mode(True):
        found = algorithm.policy.get_dist(batch.clone()).log_prob(batch[group, "action"])
    torch.testing.assert_close(found, batch[group, "action_log_prob"], rtol=1e-4, atol=1e-4)


def labeled_by_the_other(algorithm, number, generator):
    """Steps of two agents side by side, in which each agent's label depends only on what the other one observes."""
    shape = algorithm.observation_shape
    image = torch.zeros(number, 2, *shape.image)
    features = torch.zeros(number, 2, shape.features)
    signal = torch.rand(number, 2, generator=generator).round()
    features[..., 0] = signal
    features[..., shape.pose] = torch.tensor([[0.0, 0, 1, 0, 0, 0], [0.0, 1 / 32768, 0, 0, 1, 0]])
    return labeled_steps(signal.flip(-1).long(), image, features)


@pytest.mark.parametrize(("radius", "least", "most"), [(1, 0, 0.1), (0, 0.5, 1)])
def test_imitation_learns_from_what_others_observe(radius, least, most):
    config = talking("dagger", communication_radius=radius)
    optimization = dataclasses.replace(config.optimization, learning_rate=3e-3, minibatch_size=64)
    config = dataclasses.replace(config, task=changed(config.task, num_agents=2), optimization=optimization)
    algorithm = ALGORITHMS["dagger"](config)
    learner, generator = algorithm.make_learner(), torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    losses = [learner.learn(labeled_by_the_other(algorithm, 256, generator), 0)["loss"] for _ in range(40)]
    assert least <= losses[-1] <= most


def test_labels_that_are_not_learned_from_have_no_gradient_but_their_agents_are_heard():
    algorithm = ALGORITHMS["dagger"](talking("dagger", communication_radius=None))
    shape, generator = algorithm.observation_shape, torch.Generator().manual_seed(0)
    image = torch.rand(32, 3, *shape.image, generator=generator)
    features = torch.rand(32, 3, shape.features, generator=generator)
    features[..., shape.pose] = torch.tensor([0.0, 0, 1, 0, 0, 0])
    labels = torch.zeros(32, 3, dtype=torch.int64)
    labels[:, 1:] = NO_LABEL
    labels[:8] = NO_LABEL

    def learned(changes):
        torch.manual_seed(0)
        learner = ALGORITHMS["dagger"](algorithm.config).make_learner()
        batch = labeled_steps(labels, image, features)
        batch.update(changes)
        row = learner.learn(batch, 0)
        assert row["buffer"] == 24 * 3  # environment steps without any label are not stored
        return row["loss"]

    once = learned({})
    logits = torch.rand(32, 3, 4, generator=generator)
    assert learned({("agents", "logits"): logits}) == once
    assert learned({("agents", "observation", "image"): image * torch.tensor([1, 2, 1]).view(3, 1, 1, 1)}) != once


def test_a_centralized_policy_starts_from_an_imitated_one(tmp_path):
    start = train(dataclasses.replace(talking("dagger"), agent_steps=192), tmp_path / "start")
    config = talking("central-ppo")
    still = dataclasses.replace(config.ppo, warmup_updates=1)  # only the critic learns
    config = dataclasses.replace(config, ppo=still, agent_steps=192, initial_policy=str(start), initial_temperature=0.5)
    policy, before = load_policy(train(config, tmp_path / "run")), load_policy(start)
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=5)
    observed, _ = env.reset(seed=0)
    seen = [torch.from_numpy(np.stack([o[key] for o in observed.values()])) for key in ("image", "features")]
    with torch.no_grad():
        (logits,), (mean, scale) = before.network(*seen), policy.network(*seen)
    torch.testing.assert_close(20 * mean, logits / 0.5)
    sampled = one_hot((mean + scale * torch.randn(20_000, *mean.shape)).argmax(-1), 4).float().mean(0)
    assert (sampled - (logits / 0.5).softmax(-1)).abs().max() < 0.05


@pytest.mark.parametrize("name", ["mappo", "central-ppo"])
def test_a_policy_of_other_layers_is_refused(tmp_path, name):
    start = train(dataclasses.replace(talking("dagger", communication=1), agent_steps=192), tmp_path / "start")
    config = dataclasses.replace(talking(name), initial_policy=str(start))
    with pytest.raises(ValueError, match="initial_policy: not the networks of this configuration"):
        train(config, tmp_path / "run")


def test_positions_are_exact_in_mixed_precision():
    network = encoder()
    seen = observations(*poses())
    far = observations(poses()[0] + 1000, poses()[1])
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(network(*seen).float(), network(*far).float(), rtol=0.1, atol=0.5)


def test_a_saved_policy_with_too_many_rounds_is_refused(tmp_path):
    folder = train(dataclasses.replace(talking("mappo"), agent_steps=192), tmp_path)
    file = folder / CONFIG
    config = json.loads(file.read_text())
    config["model"]["communication"] = 10**9
    file.write_text(json.dumps(config))
    with pytest.raises(FormatError, match=r"not the weights that config\.json describes: expected those of 1000000002"):
        load_policy(folder)


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("credit", ["team", "agent"])
def test_advantages_of_the_team_or_of_each_agent(tmp_path, credit, on_target):
    config = talking("central-ppo")
    ppo = dataclasses.replace(config.ppo, credit=credit)
    task = changed(config.task, on_target=on_target)
    folder = train(dataclasses.replace(config, task=task, ppo=ppo, agent_steps=192), tmp_path)
    assert all(np.isfinite(float(row["loss_critic"])) for row in untimed(folder))


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("mappo", {"communication": -1}, "communication=-1: expected a whole number, 0 or more"),
        ("mappo", {"communication_radius": -1}, "communication_radius=-1: expected a whole number, 0 or more"),
        ("mappo", {"hidden": 48}, "hidden=48: expected a multiple of 32 with communication"),
        ("bc", {}, "communication=2: expected 0 with bc, which uses separate agent steps"),
    ],
)
def test_bad_settings(tmp_path, name, changes, message):
    def run():
        imitation = ImitationConfig(dataset=str(tmp_path / "nothing"))
        train(dataclasses.replace(talking(name, **changes), imitation=imitation), tmp_path / "run")

    with pytest.raises(ValueError, match=message):
        run()
    assert not list(tmp_path.iterdir())


def test_the_pose_must_be_observed(tmp_path):
    config = dataclasses.replace(talking("mappo"), task=TINY.task)
    with pytest.raises(ValueError, match="communication=2: expected 'pose' among the environment's features"):
        train(config, tmp_path / "run")


@pytest.mark.parametrize("radius", [None, 2])
def test_the_weights_of_attention_are_those_of_the_round(radius):
    network, seen = encoder(rounds=1, radius=radius), observations(*poses())
    (communicate,) = network.rounds
    kept = {}
    communicate.register_forward_hook(lambda _, inputs, output: kept.update(inputs=inputs, output=output))
    network(*seen)
    embedding, team = kept["inputs"]
    weights = communicate.attention(embedding, team)
    assert torch.allclose(weights.sum(-1), torch.ones(()))
    # The round again, with these weights in place of the fused attention.
    _, _, value = communicate._projections(embedding, team)
    received = team.from_map((weights @ value).transpose(-3, -2)).flatten(-2)
    expected = embedding + communicate.output(received)
    assert torch.allclose(kept["output"], expected + communicate.update(expected), atol=1e-4)
