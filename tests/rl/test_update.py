"""What an update does to the weights, compared in float64 with the formulas of the papers in plain torch."""

import copy
import dataclasses

import pytest
import torch

from mapf_pz.rl import train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, TaskConfig, TrainConfig
from mapf_pz.rl.environments.collect import collecting
from mapf_pz.rl.networks.actors import LocalCritic, TeamCritic, TeamValue
from mapf_pz.rl.networks.observation_shape import ObservationShape
from tests.helpers.reference_ppo import ReferencePPO, categorical, normal, recurrent_distribution
from tests.helpers.small_run import changed

# Two agents on four cells: within a batch, some episodes terminate and others are truncated.
FIELDS = {"num_agents": 2, "max_steps": 7, "view_size": (1, 1), "action_model": "cardinal"}
SMALL = TrainConfig(
    task=changed(TaskConfig(), height=2, width=2, density=0, **FIELDS),
    model=ModelConfig(conv_channels=(4,), hidden=16, head=(16,)),
    optimization=OptimizationConfig(
        num_envs=6, steps_per_batch=32, num_epochs=2, minibatch_size=64, learning_rate=3e-3
    ),
    agent_steps=6 * 32 * 2 * 4,
)
ALL = [
    ("mappo", "agent"),
    ("ippo", "agent"),
    ("central-ppo", "agent"),
    ("central-ppo", "team"),
]


def configured(algorithm="mappo", recurrent=0, on_target="nothing", mask_actions=False, ppo=None, **optimization):
    return dataclasses.replace(
        SMALL,
        task=changed(SMALL.task, on_target=on_target),
        algorithm=algorithm,
        model=dataclasses.replace(SMALL.model, recurrent=recurrent, mask_actions=mask_actions),
        optimization=dataclasses.replace(SMALL.optimization, **optimization),
        ppo=dataclasses.replace(SMALL.ppo, **(ppo or {})),
    )


def make(config):
    """Return an algorithm and a batch that it has collected, both in float64."""
    torch.manual_seed(0)
    algorithm = ALGORITHMS[config.algorithm](config)
    with collecting(algorithm, config, seed=0, updates=1) as collector:
        batch = next(iter(collector)).clone()
    algorithm.loss.double()
    return algorithm, batch.apply(lambda tensor: tensor.double() if tensor.is_floating_point() else tensor)


def make_critic(algorithm):
    """Return a copy of the algorithm's critic, as a module."""
    config = algorithm.config
    observed = ObservationShape.of_task(config.task)
    critics = {
        "mappo": lambda: TeamCritic(observed, config.model),
        "ippo": lambda: LocalCritic(observed, config.model),
        "central-ppo": lambda: TeamValue(observed, config.task.num_agents, config.ppo.credit, config.model),
    }
    critic = critics[config.algorithm]().double()
    critic.load_state_dict(critic_weights(algorithm))
    return critic


def critic_weights(algorithm):
    params = algorithm.loss.critic_network_params.flatten_keys(".")
    return {name.removeprefix("module."): params[name].detach().clone() for name in params.keys()}  # noqa: SIM118


def masked(config):
    """Return whether agents that have left are excluded: not from one advantage of the whole team."""
    one = config.algorithm == "central-ppo" and config.ppo.credit == "team"
    return config.task.env.on_target == "finish" and not one


def as_reference_batch(algorithm, batch):
    """Return the tensors that the reference reads; the team's reward is the mean of the agents' rewards."""
    team = algorithm.config.algorithm == "central-ppo"
    one = team and algorithm.config.ppo.credit == "team"
    group = batch["team" if team else "agents"]
    reward = batch["next", "agents", "reward"].squeeze(-1)
    log_prob = group["action_log_prob"]
    observed = algorithm.observation_keys()
    done, terminated = batch["next", "done"], batch["next", "terminated"]
    active = torch.ones_like(reward, dtype=torch.bool)
    if masked(algorithm.config):  # an agent's episode ends when it leaves
        active = batch["agents", "active"].squeeze(-1)
        left = ~batch["next", "agents", "active"].squeeze(-1)
        done, terminated = done | left, terminated | left
    return {
        "observation": tuple(batch[key] for key in observed),
        "next_observation": tuple(batch["next"][key] for key in observed),
        "action": group["action"],
        "action_mask": batch["agents", "action_mask"],
        "log_prob": log_prob.unsqueeze(-1) if one else log_prob,
        "reward": reward.mean(-1, keepdim=True) if one else reward,
        "active": active[..., :1] if one else active,
        "done": done,
        "terminated": terminated,
        **{name: batch[name] for name in ("hidden_state", "is_init") if name in batch.keys()},  # noqa: SIM118
    }


def make_reference(algorithm):
    """Return the reference with copies of the weights, and those of the actor and the critic by name."""
    config = algorithm.config
    one = config.algorithm == "central-ppo" and config.ppo.credit == "team"
    actor, critic = copy.deepcopy(algorithm.network), make_critic(algorithm)

    def distribution(part):
        if config.model.recurrent:
            inputs = part["observation"], part["hidden_state"], part["is_init"]
            parameters = recurrent_distribution(actor, *inputs)
        else:
            parameters = actor(*part["observation"])
        if config.model.mask_actions:
            return (parameters[0].masked_fill(~part["action_mask"], -1e9),)
        return parameters

    def log_prob_and_entropy(action, *parameters):
        found = (normal if config.algorithm == "central-ppo" else categorical)(action, *parameters)
        return tuple(part.sum(-1, keepdim=True) for part in found) if one else found

    def values(observation):
        return critic(*observation) if one else critic(*observation).squeeze(-1)

    weights = [*actor.parameters(), *critic.parameters()]
    reference = ReferencePPO(distribution, log_prob_and_entropy, values, weights, config, masked(config))
    return reference, actor, critic


def assert_episodes_end_within(batch, observed):
    """Check that episodes terminate and are truncated before the last step, and keep their last observations."""
    ended, terminated = batch["next", "done"][:, :-1, 0], batch["next", "terminated"][:, :-1, 0]
    assert terminated.any()
    assert (ended & ~terminated).any()
    for key in observed:
        differs = (batch["next"][key][:, :-1] != batch[key][:, 1:]).flatten(2).any(-1)
        assert not differs[~ended].any()
    assert differs[ended].all()  # features hold the last actions, and resets clear them


def ratios_of_equal_updates(config):
    """Check that updates of the algorithm and of the reference are equal; return the reference's probability ratios."""
    algorithm, batch = make(config)
    assert batch["agents", "active"].all() == (config.task.env.on_target == "nothing")
    assert_episodes_end_within(batch, algorithm.observation_keys())
    reference, actor, critic = make_reference(algorithm)
    learner = algorithm.make_learner()
    for progress in (0.0, 0.25, 0.5):  # the same batch again, so that probability ratios are clipped
        torch.manual_seed(7)
        learner.learn(batch.clone(), progress)
        torch.manual_seed(7)
        reference.update(as_reference_batch(algorithm, batch), bool(config.model.recurrent), progress)
        torch.testing.assert_close(dict(algorithm.network.state_dict()), dict(actor.state_dict()), rtol=0, atol=1e-6)
        torch.testing.assert_close(critic_weights(algorithm), dict(critic.state_dict()), rtol=0, atol=1e-6)
    return torch.cat([ratio.flatten() for ratio in reference.ratios])


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("recurrent", [0, 6])
@pytest.mark.parametrize(("name", "credit"), ALL)
@pytest.mark.filterwarnings("error")
def test_updates_are_those_of_the_papers(name, credit, recurrent, on_target):
    config = configured(name, recurrent, on_target, ppo={"credit": credit}, max_grad_norm=0.3)
    assert ((ratios_of_equal_updates(config) - 1).abs() > config.ppo.clip_epsilon).any()


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("recurrent", [0, 6])
@pytest.mark.filterwarnings("error")
def test_updates_with_action_masks_are_those_of_the_papers(recurrent, on_target):
    ratios_of_equal_updates(configured("mappo", recurrent, on_target, mask_actions=True))


def test_advantages_are_normalized_for_each_agent():
    """Shifting and scaling all advantages of one agent does not change the policy loss."""
    algorithm, batch = make(configured())
    with torch.no_grad():
        algorithm.loss.value_estimator(batch, params=algorithm.loss.critic_network_params)
        log_prob = batch["agents", "action_log_prob"]
        log_prob += 0.3 * torch.rand_like(log_prob)  # ratios other than 1
        before = algorithm.loss(batch)["loss_objective"]
        batch["advantage"] = batch["advantage"] * torch.tensor([[3.0], [50.0]]) + torch.tensor([[-7.0], [2.0]])
        after = algorithm.loss(batch)["loss_objective"]
    assert before.abs() > 1e-3
    torch.testing.assert_close(after, before, rtol=1e-6, atol=0)


@pytest.mark.parametrize(("name", "credit"), ALL)
def test_the_entropy_bonus_raises_the_entropy(name, credit):
    """With zero rewards and values, only the bonus changes the policy."""

    def entropies(coefficient):
        config = configured(name, ppo={"credit": credit, "entropy_coeff": coefficient})
        algorithm, batch = make(config)
        for key in (("agents", "reward"), algorithm.reward_key):
            batch["next", key].zero_()
        algorithm.network.head[-1].bias.data[0] += 2
        for weight in algorithm.loss.critic_network_params.values(include_nested=True, leaves_only=True):
            weight.data.zero_()
        learner = algorithm.make_learner()
        return [learner.learn(batch.clone(), 0)["entropy"] for _ in range(3)]

    first, second, third = entropies(0.5)
    assert first + 1e-3 < second < third - 1e-3
    assert entropies(0) == pytest.approx([entropies(0)[0]] * 3, rel=1e-9)


@pytest.mark.parametrize("name", ["mappo", "central-ppo"])
@pytest.mark.parametrize("progress", [0.0, 0.3, 0.9])
def test_step_sizes_and_entropy_bonus_fall_linearly_to_a_tenth(name, progress):
    config = configured(name, ppo={"entropy_coeff": 0.05}, learning_rate=2e-3)
    algorithm, batch = make(config)
    learner = algorithm.make_learner()
    learner.learn(batch, progress)
    assert learner.optimizer.param_groups[0]["lr"] == pytest.approx(2e-3 * (1 - 0.9 * progress))
    assert learner.loss.entropy_coeff.item() == pytest.approx(0.05 * (1 - 0.9 * progress))


@pytest.mark.parametrize("final", [0.0, 0.4, 1.0])
def test_the_learning_rate_at_the_end(final):
    config = configured(learning_rate=2e-3, final_learning_rate=final)
    algorithm, batch = make(config)
    learner = algorithm.make_learner()
    for done, fraction in ((0.0, 1), (0.5, (1 + final) / 2), (1.0, final)):
        learner.learn(batch.clone(), done)
        assert learner.optimizer.param_groups[0]["lr"] == pytest.approx(2e-3 * fraction)


def test_a_run_lowers_the_entropy_bonus_from_update_to_update(tmp_path):
    made, seen = [], []

    def make_algorithm(config):
        made.append(ALGORITHMS[config.algorithm](config))
        return made[0]

    train(SMALL, tmp_path, lambda _: seen.append(made[0].loss.entropy_coeff.item()), make_algorithm)
    start = SMALL.ppo.entropy_coeff
    assert seen == pytest.approx([start * (1 - 0.9 * update / 4) for update in range(4)])


@pytest.mark.parametrize(("recurrent", "minibatch_size", "steps"), [(0, 64, 3), (6, 64, 3), (6, 8, 6), (0, 192, 1)])
def test_an_epoch_takes_one_gradient_step_for_each_minibatch(recurrent, minibatch_size, steps):
    """Recurrent networks learn from whole sequences of 32 steps, at least one at a time."""
    config = configured("mappo", recurrent, num_epochs=1, minibatch_size=minibatch_size)
    algorithm, batch = make(config)
    learner = algorithm.make_learner()
    learner.learn(batch, 0)
    assert {int(state["step"]) for state in learner.optimizer.state_dict()["state"].values()} == {steps}


@pytest.mark.parametrize("name", ["mappo", "central-ppo"])
@pytest.mark.parametrize(("limit", "clips"), [(0.25, True), (1e9, False)])
def test_gradients_are_clipped_to_the_maximum_norm(name, limit, clips):
    config = configured(name, max_grad_norm=limit, num_epochs=1, minibatch_size=6 * 32)
    algorithm, batch = make(config)
    for key in (("agents", "reward"), algorithm.reward_key):
        batch["next", key] *= 1e4
    learner = algorithm.make_learner()
    learner.learn(batch, 0)
    norm = torch.cat([weight.grad.flatten() for weight in learner.loss.parameters()]).norm().item()
    if clips:
        assert norm == pytest.approx(limit, rel=1e-5)
    else:
        assert norm > 0.5
