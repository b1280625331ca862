import copy
import dataclasses

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from mapf_pz import FormatError
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.curiosity import RewardScale, make_curiosity
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import CuriosityConfig
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.rl.training.checkpoint import Checkpoints, Position, restore
from mapf_pz.rl.training.train import resume
from tests.helpers import small_run as tiny
from tests.helpers.small_run import changed, rows, untimed

KINDS = ["rnd", "random-features", "inverse-dynamics", "disagreement"]
TINY = dataclasses.replace(tiny.TINY, curiosity=CuriosityConfig(size=16), agent_steps=384)


def curious(kind, config=TINY, **fields):
    return dataclasses.replace(config, curiosity=dataclasses.replace(config.curiosity, kind=kind, **fields))


def interrupt_after(updates):
    seen = []

    def on_progress(row):
        seen.append(row)
        if len(seen) == updates:
            raise KeyboardInterrupt

    return on_progress


def random_steps(config, number, seed):
    """Steps of N agents each between observations that have nothing to do with each other."""
    torch.manual_seed(seed)
    observed, each = ObservationShape.of_task(config.task), (number, config.task.num_agents)

    def seen():
        return {"image": torch.rand(*each, *observed.image), "features": torch.rand(*each, observed.features)}

    agents = {"observation": seen(), "action": torch.randint(observed.actions, each)}
    return TensorDict(agents=agents, next={"agents": {"observation": seen()}}, batch_size=[number])


def rollout(config, steps, max_steps=None):
    """An algorithm's steps in its form of the environment, reset where episodes end."""
    torch.manual_seed(0)
    algorithm = ALGORITHMS[config.algorithm](config)
    keywords = config.task.env_keywords() | {"max_steps": max_steps or config.task.env.max_steps}
    env = TransformedEnv(
        BatchedMapfEnv(config.optimization.num_envs, **keywords), Compose(*algorithm.transforms(config.seed))
    )
    env.set_seed(0)
    torch.manual_seed(1)
    with torch.no_grad():
        return env.rollout(steps, algorithm.actor, break_when_any_done=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_known_transitions_surprise_less(kind):
    config = curious(kind, update_fraction=1.0)
    torch.manual_seed(0)
    curiosity = make_curiosity(config, ALGORITHMS[config.algorithm].action_key)
    assert curiosity is not None
    known, unknown = random_steps(config, 10, seed=1), random_steps(config, 10, seed=2)

    def surprises():
        with torch.no_grad():
            return float(curiosity.surprise(known).mean()), float(curiosity.surprise(unknown).mean())

    before, never_seen = surprises()
    assert before > 0.7 * never_seen
    optimizer = torch.optim.Adam(curiosity.parameters(), 3e-3)
    for _ in range(400):
        optimizer.zero_grad()
        curiosity.loss(known).backward()
        optimizer.step()
    after, never_seen = surprises()
    assert after < 0.3 * before
    assert after < 0.5 * never_seen


def test_networks_that_agree_are_not_surprised():
    """The surprise is the variance of the predictions, whatever happens after the step."""
    config = curious("disagreement")
    torch.manual_seed(0)
    curiosity = make_curiosity(config, ALGORITHMS[config.algorithm].action_key)
    steps, other = random_steps(config, 10, seed=1), random_steps(config, 10, seed=2)
    with torch.no_grad():
        surprise = curiosity.surprise(steps)
        steps["next"] = other["next"]
        torch.testing.assert_close(curiosity.surprise(steps), surprise, rtol=0, atol=0)
        embedded = curiosity.embedding(steps["agents", "observation"]).numpy()
        actions = np.eye(curiosity.num_actions, dtype=np.float32)[steps["agents", "action"].numpy()]
        inputs = torch.tensor(np.concatenate([embedded, actions], -1))
        predicted = np.stack([model(inputs).numpy() for model in curiosity.forward_models])
        assert len(predicted) == 5
        np.testing.assert_allclose(surprise.numpy(), predicted.var(0, ddof=1).mean(-1), rtol=1e-4)
        for model in curiosity.forward_models:
            model.load_state_dict(curiosity.forward_models[0].state_dict())
        assert curiosity.surprise(steps).max() < 1e-10


def numpy_deviation(rewards, gamma):
    sums = np.zeros(rewards.shape)
    for t in range(rewards.shape[1]):
        sums[:, t] = gamma * sums[:, t - 1] * (t > 0) + rewards[:, t]
    return sums.std()


def test_rewards_are_divided_by_the_deviation_of_all_discounted_sums():
    rewards = np.random.default_rng(0).gamma(2.0, size=(5, 40, 3))
    scale = RewardScale(5, 3, gamma=0.9)
    for first in range(0, 40, 8):  # sums go on from batch to batch
        part = torch.tensor(rewards[:, first : first + 8], dtype=torch.float32)
        expected = rewards[:, first : first + 8] / numpy_deviation(rewards[:, : first + 8], 0.9)
        np.testing.assert_allclose(scale(part).numpy(), expected, rtol=1e-4)


@pytest.mark.parametrize("unit", [0.01, 100.0])
def test_the_unit_of_rewards_does_not_matter(unit):
    rewards = torch.rand(5, 40, 3)
    torch.testing.assert_close(
        RewardScale(5, 3, 0.99)(unit * rewards), RewardScale(5, 3, 0.99)(rewards), rtol=1e-3, atol=0
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("algorithm", ["mappo", "central-ppo"])
def test_the_end_of_an_episode_is_its_own(kind, algorithm):
    config = dataclasses.replace(curious(kind), algorithm=algorithm)
    torch.manual_seed(0)
    curiosity = make_curiosity(config, ALGORITHMS[config.algorithm].action_key)
    assert curiosity is not None
    ended, ongoing = rollout(config, 6, max_steps=3), rollout(config, 3, max_steps=100)
    assert ended["next", "done"][:, 2].all()
    assert not ongoing["next", "done"].any()
    with torch.no_grad():
        torch.testing.assert_close(curiosity.surprise(ended)[:, :3], curiosity.surprise(ongoing))


def test_actions_taken_are_those_of_the_matrix():
    batch = rollout(dataclasses.replace(TINY, algorithm="central-ppo"), 8)
    taken = batch["next", "agents", "taken"]
    assert len(taken.unique()) > 1
    torch.testing.assert_close(taken, batch["team", "action"].clamp(-1, 1).argmax(-1))


@pytest.mark.parametrize(
    ("algorithm", "credit"), [("mappo", "agent"), ("central-ppo", "agent"), ("central-ppo", "team")]
)
def test_the_reward_is_added_to_what_the_loss_learns_from(algorithm, credit):
    ppo = dataclasses.replace(TINY.ppo, credit=credit)
    config = dataclasses.replace(curious("rnd", weight=0.5), algorithm=algorithm, ppo=ppo)
    curiosity, key = (
        make_curiosity(config, ALGORITHMS[config.algorithm].action_key),
        ALGORITHMS[algorithm](config).reward_key,
    )
    assert curiosity is not None
    batch = rollout(config, 5)
    before, same_curiosity = batch.clone(), copy.deepcopy(curiosity)
    mean = curiosity.add_reward(batch, key)
    intrinsic = same_curiosity.reward(before)
    assert intrinsic.shape == (4, 5, 3, 1)
    assert (intrinsic > 0).all()
    torch.testing.assert_close(mean, intrinsic.mean())
    expected = intrinsic.mean(2) if credit == "team" else intrinsic
    torch.testing.assert_close(batch["next"][key], before["next"][key] + 0.5 * expected)


def test_an_observation_without_features():
    config = curious("inverse-dynamics")
    config = dataclasses.replace(config, task=changed(config.task, features=()))
    curiosity = make_curiosity(config, ALGORITHMS[config.algorithm].action_key)
    assert curiosity is not None
    assert curiosity.reward(rollout(config, 5)).shape == (4, 5, 3, 1)


@pytest.mark.parametrize(
    "algorithm", ["mappo", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ippo", "central-ppo"))]
)
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_curiosity(tmp_path, kind, algorithm):
    folder = train(dataclasses.replace(curious(kind), algorithm=algorithm), tmp_path)
    assert len(rows(folder)) == 2
    for row in rows(folder):
        assert float(row["intrinsic_reward"]) > 0
        assert float(row["loss_curiosity"]) > 0
    assert load_policy(folder).config.curiosity.kind == kind


def test_curiosity_is_not_reported_without_it(tmp_path):
    assert not {"intrinsic_reward", "loss_curiosity"} & rows(train(TINY, tmp_path))[0].keys()


@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_same_run(tmp_path, kind):
    one, two = (untimed(train(curious(kind), tmp_path / name)) for name in "ab")
    assert one == two


def test_the_return_is_the_tasks_own(tmp_path):
    config = dataclasses.replace(TINY, agent_steps=192)  # one update: the policy is the same until its end
    free, paid = (
        rows(train(curious("rnd", config, weight=weight), tmp_path / str(weight)))[0] for weight in (0.0, 100.0)
    )
    assert paid["return"] == free["return"]
    assert paid["intrinsic_reward"] == free["intrinsic_reward"]
    assert paid["loss_critic"] != free["loss_critic"]


def make_learner(config):
    torch.manual_seed(config.seed)
    learner, steps = ALGORITHMS[config.algorithm](config).make_learner(), rollout(config, 16)
    torch.manual_seed(config.seed)
    learner.learn(steps.clone(), 0.0)
    return learner, steps


@pytest.mark.parametrize("kind", KINDS)
def test_a_learner_lowers_the_loss_of_curiosity(kind):
    config = curious(kind, update_fraction=1.0, learning_rate=3e-3)
    learner, steps = make_learner(config)
    losses = [learner.learn(steps.clone(), 0.0)["loss_curiosity"] for _ in range(20)]
    assert losses[-1] < 0.7 * losses[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_checkpoint_holds_networks_moments_and_statistics(tmp_path, kind):
    config = curious(kind)
    learner, steps = make_learner(config)
    other, _ = make_learner(dataclasses.replace(config, seed=1))
    curiosity, restored = learner.curiosity, other.curiosity
    assert curiosity is not None
    assert restored is not None
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(learner, Position(1, 192, 0.5))
    kept = learner.tensors()
    restore(checkpoints.latest(), other)
    torch.set_rng_state(kept["random"])
    torch.testing.assert_close(other.tensors(), kept, rtol=0, atol=0)
    restored.scale.sums.copy_(curiosity.scale.sums)  # these belong to the environments, which start new episodes
    torch.testing.assert_close(restored.reward(steps), curiosity.reward(steps), rtol=0, atol=0)


def test_a_checkpoint_with_curiosity_fits_no_other_run(tmp_path):
    learner, _ = make_learner(curious("rnd"))
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(learner, Position(1, 192, 0.5))
    for kind in ("none", "inverse-dynamics"):
        other, _ = make_learner(curious(kind))
        with pytest.raises(FormatError, match="not a checkpoint of this run"):
            restore(checkpoints.latest(), other)


@pytest.mark.parametrize("algorithm", ["mappo", pytest.param("central-ppo", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_curiosity_resumes(tmp_path, kind, algorithm):
    with pytest.raises(KeyboardInterrupt):
        train(dataclasses.replace(curious(kind), algorithm=algorithm), tmp_path, interrupt_after(1))
    before = rows(tmp_path)
    assert len(before) == 1
    resume(tmp_path)
    assert rows(tmp_path)[:1] == before
    assert [row.keys() for row in rows(tmp_path)] == [before[0].keys()] * 2
