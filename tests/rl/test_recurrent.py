import dataclasses

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import Compose, TransformedEnv
from torchrl.modules import set_recurrent_mode

import mapf_pz
from mapf_pz.rl import BatchedMapfEnv, load_policy, resume, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.networks.actors import RecurrentCore
from tests.helpers import small_run as tiny

TINY = dataclasses.replace(
    tiny.TINY,
    task=tiny.changed(tiny.TINY.task, max_steps=5),
    model=dataclasses.replace(tiny.TINY.model, recurrent=12),
    optimization=dataclasses.replace(tiny.TINY.optimization, num_epochs=2),
)
NAMES = ["mappo", "ippo", "central-ppo"]
GROUPS = {"mappo": "agents", "ippo": "agents", "central-ppo": "team"}


def batches(algorithm, number):
    """Return the algorithm's first batches, with its first weights."""
    config = algorithm.config
    env = BatchedMapfEnv(config.optimization.num_envs, **config.task.env_keywords())
    env.set_seed(0)
    frames = config.optimization.num_envs * config.optimization.steps_per_batch
    collector = Collector(
        TransformedEnv(env, Compose(*algorithm.transforms(0))),
        algorithm.actor,
        frames_per_batch=frames,
        total_frames=number * frames,
        auto_register_policy_transforms=False,
    )
    result = [batch.clone() for batch in collector]
    collector.shutdown()
    return result


def make(name, **changes):
    torch.manual_seed(0)
    algorithm = ALGORITHMS[name](dataclasses.replace(TINY, algorithm=name, **changes))
    with torch.no_grad():  # what the first weights say hardly differs; say it louder, so that a difference is seen
        for layer in algorithm.network.actor.head:
            if isinstance(layer, torch.nn.Linear):
                layer.weight.mul_(10)
    return algorithm


@pytest.mark.parametrize("credit", ["agent", "team"])
@pytest.mark.parametrize("name", NAMES)
def test_the_loss_finds_the_log_probs_that_the_collector_acted_with(name, credit):
    algorithm = make(name, ppo=dataclasses.replace(TINY.ppo, credit=credit))
    key = (GROUPS[name], "action_log_prob")
    for number, batch in enumerate(batches(algorithm, 3)):
        assert batch["is_init"][:, 1:].any()
        assert batch["is_init"][:, 0].all() == (number == 0)
        assert batch["hidden_state"][batch["is_init"].squeeze(-1)].abs().max() == 0 or not batch["is_init"].any()
        assert batch["hidden_state"][~batch["is_init"].squeeze(-1)].abs().min() > 0
        with torch.no_grad(), set_recurrent_mode(True):
            found = algorithm.actor.get_dist(batch.clone()).log_prob(batch[GROUPS[name], "action"])
        torch.testing.assert_close(found, batch[key], rtol=1e-4, atol=1e-5)
        with torch.no_grad():
            algorithm.loss.value_estimator(batch, params=algorithm.loss.critic_network_params)
            terms = algorithm.loss(batch)
        assert terms["kl_approx"].abs() < 1e-5
        assert terms["clip_fraction"] == 0


def test_an_observation_changes_only_later_steps_of_its_episode():
    algorithm = make("mappo")
    batch = batches(algorithm, 1)[0]
    changed = batch.clone()
    changed["agents", "observation", "features"][:, 2, 0] += 1
    with torch.no_grad(), set_recurrent_mode(True):
        before, after = (algorithm.actor.get_dist(part).logits for part in (batch.clone(), changed))
    differs = (before - after).abs().amax(-1) > 1e-6  # (B, T, N)
    begins = batch["is_init"].squeeze(-1).clone()
    begins[:, :3] = False
    same_episode = begins.cumsum(1) == 0
    same_episode[:, :2] = False
    assert torch.equal(differs[..., 0], same_episode)
    assert not differs[..., 1:].any()


def test_the_loss_trains_the_recurrent_core():
    algorithm = make("ippo")
    batch = batches(algorithm, 1)[0]
    with torch.no_grad():
        algorithm.loss.value_estimator(batch, params=algorithm.loss.critic_network_params)
    optimizer = torch.optim.Adam(algorithm.loss.parameters(), 1e-2)
    algorithm.loss(batch)["loss_objective"].backward()
    weights = dict(algorithm.network.core.named_parameters())
    before = {name: weight.clone() for name, weight in weights.items()}
    optimizer.step()
    assert len(weights) == 4
    for name, weight in weights.items():
        assert not torch.equal(weight, before[name])
    # The network that acts, and the one in the loss, go on with the new weights.
    inputs = torch.randn(2, 3, 16), torch.zeros(2, 3, 12), torch.zeros(2, 1, dtype=torch.bool)
    fresh = RecurrentCore(16, 12)
    fresh.load_state_dict(weights)
    torch.testing.assert_close(algorithm.network.core(*inputs), fresh(*inputs))


def test_hidden_states_are_permuted_with_the_agents():
    memory, order = RecurrentCore(6, 4), torch.tensor([2, 0, 1])
    code, before, begins = torch.randn(2, 5, 3, 6), torch.randn(2, 5, 3, 4), torch.zeros(2, 5, 1, dtype=torch.bool)
    with set_recurrent_mode(True):
        after = memory(code, before, begins)
        torch.testing.assert_close(memory(code[:, :, order], before[:, :, order], begins), after[:, :, order])
    for t in range(5):
        step = memory(code[:, t], before[:, 0] if t == 0 else after[:, t - 1], begins[:, t])
        torch.testing.assert_close(step, after[:, t])


@pytest.mark.parametrize("name", NAMES)
def test_training_resuming_and_acting(tmp_path, name):
    config = dataclasses.replace(TINY, algorithm=name)
    folder = train(dataclasses.replace(config, agent_steps=400), tmp_path)
    resume(folder, agent_steps=576)
    assert len((folder / "progress.csv").read_text().splitlines()) == 4
    policy = load_policy(folder, deterministic=True)
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=3)
    observations, _ = env.reset(seed=1)
    algorithm = ALGORITHMS[name](config)
    algorithm.network.load_state_dict(policy.network.state_dict())
    hidden_state = torch.zeros(1, algorithm.num_hidden_states(config), 12)
    for step in range(4):
        actions = policy.act(observations)
        seen = {
            key: torch.stack([torch.from_numpy(observation[key]) for observation in observations.values()])[None]
            for key in ("image", "features")
        }
        team = {"image": seen["image"].flatten(1, 2), "features": seen["features"].flatten(1)}
        begins = torch.full((1, 1), step == 0)
        inputs = TensorDict({"hidden_state": hidden_state, "is_init": begins, "team": team}, batch_size=[1])
        inputs["agents", "observation"] = TensorDict(seen, batch_size=[1])
        with torch.no_grad():
            result = algorithm.network_module()(inputs)
        hidden_state = result["next", "hidden_state"]
        torch.testing.assert_close(torch.stack(list(policy._memory.hidden_states.values())), hidden_state[0])
        if name != "central-ppo":
            assert list(actions.values()) == result["agents", "logits"][0].argmax(-1).tolist()
        observations = env.step(actions)[0]


def test_each_agent_has_a_hidden_state_until_it_is_reset(tmp_path):
    folder = train(dataclasses.replace(TINY, agent_steps=192), tmp_path)
    policy = load_policy(folder)
    first, _ = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=4).reset(seed=3)
    second, _ = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=4).reset(seed=4)

    def hidden_states(*steps):
        policy.reset_states()
        for observations in steps:
            policy.act(observations)
        return {name: state.clone() for name, state in policy._memory.hidden_states.items()}

    whole = hidden_states(first, second)
    fewer = hidden_states(first, {name: second[name] for name in ("agent_3", "agent_1")})
    for name in ("agent_1", "agent_3"):
        torch.testing.assert_close(fewer[name], whole[name])
    assert not torch.allclose(hidden_states(second)["agent_1"], whole["agent_1"])


def test_same_seed_same_actions(tmp_path):
    folder = train(dataclasses.replace(TINY, agent_steps=192), tmp_path)

    def episode(policy):
        env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=4, on_target="finish", max_steps=30)
        observations, _ = env.reset(seed=5)
        policy.reset_states()
        taken = []
        while env.agents:
            taken.append(policy.act(observations))
            observations = env.step(taken[-1])[0]
        return taken

    assert episode(load_policy(folder, seed=7)) == episode(load_policy(folder, seed=7))


@pytest.mark.parametrize("minibatch_size", [64, 3])
def test_training_updates_from_whole_sequences(tmp_path, minibatch_size):
    steps = dataclasses.replace(TINY.optimization, num_epochs=1, minibatch_size=minibatch_size, learning_rate=0.03)
    drifts = []
    train(dataclasses.replace(TINY, optimization=steps), tmp_path, lambda row: drifts.append(abs(row["kl_approx"])))
    if minibatch_size == 64:  # the whole batch: the loss comes before the only change
        assert max(drifts) < 1e-5
    else:  # less than a sequence: still one sequence a minibatch
        assert max(drifts) > 1e-5
