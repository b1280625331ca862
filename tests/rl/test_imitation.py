"""DAgger: a planner labels the states that the policy visits."""

import dataclasses

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from mapf_pz.planners import BatchShield, LaCAM, planner_of
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.expert import NO_LABEL, ExpertActions
from mapf_pz.rl.algorithms.imitation import ImitationLearner
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig
from mapf_pz.rl.environments.collect import MakeEnv
from mapf_pz.rl.environments.execution import ExecutePreferences, OrderActions, SamplePreferences
from mapf_pz.rl.training.train import resume
from mapf_pz.simulator.actions import CardinalAction, wait_action
from tests.helpers.small_run import TINY, changed, rows, untimed

DAGGER = dataclasses.replace(
    TINY, algorithm="dagger", task=changed(TINY.task, on_target="restart", action_model="cardinal", shield=True)
)


def imitating(config=DAGGER, **fields):
    return dataclasses.replace(config, imitation=dataclasses.replace(config.imitation, **fields))


def environments(config, number=4, seed=5):
    """Return the environments that data is collected in, and the policy that acts in them."""
    algorithm = ALGORITHMS["dagger"](config)
    return MakeEnv(algorithm, config, seed, number)(), algorithm.actor


@pytest.mark.parametrize("action_model", ["cardinal", "rotate"])
@pytest.mark.parametrize("on_target", ["restart", "nothing", "finish"])
def test_specs(action_model, on_target):
    task = changed(DAGGER.task, action_model=action_model, on_target=on_target)
    config = imitating(dataclasses.replace(DAGGER, task=task), expert_share=0.5, segment_steps=3)
    env, _ = environments(config)
    torch.manual_seed(0)
    check_env_specs(env)


@pytest.mark.parametrize("expert", ["pibt", "windowed:rounds=1"])
def test_labels_are_what_the_expert_would_do_in_each_state(expert):
    config = imitating(expert=expert, expert_share=0.0)
    env, actor = environments(config)
    torch.manual_seed(0)
    steps = env.rollout(20, actor, break_when_any_done=False)
    # The same episodes again, with an expert of its own for each environment.
    again = BatchedMapfEnv(4, **config.task.env_keywords())
    again.set_seed(5)
    again.reset()
    simulator = again.simulator
    experts = [planner_of(expert, 5 + b) for b in range(4)]
    shield = BatchShield(simulator)
    over = np.zeros(4, bool)
    for t in range(20):
        for b in np.flatnonzero(over):
            experts[b].reset_states()
        labels = np.stack([experts[b].decide(simulator, b) for b in range(4)])
        assert np.array_equal(steps["agents", "expert_action"][:, t].numpy(), labels), t
        simulator.step(shield.actions(steps["agents", "preferences"][:, t].detach().numpy()))
        over = simulator.over.copy()
        if over.any():
            simulator.reset(np.flatnonzero(over).tolist())
            shield.reset(np.flatnonzero(over).tolist())


def test_the_expert_controls_all_environments_with_a_share_of_one():
    config = imitating(expert="pibt", expert_share=1.0)
    env, actor = environments(config)
    steps = env.rollout(10, actor, break_when_any_done=False)
    planned, planner = BatchedMapfEnv(1, **config.task.env_keywords()), planner_of("pibt", 5)
    planned.set_seed(5)
    planned.reset()
    for t in range(10):
        assert steps["agents", "position"][0, t].tolist() == planned.simulator.positions(0).tolist()
        planned.simulator.step(planner.decide(planned.simulator)[None])


def test_a_planner_of_whole_paths_labels_only_the_segments_that_it_controls():
    config = imitating(expert="lacam:anytime=False", expert_share=0.5, segment_steps=4)
    env, actor = environments(config, number=20)
    torch.manual_seed(0)
    labels = env.rollout(8, actor, break_when_any_done=False)["agents", "expert_action"]
    labeled = (labels != NO_LABEL).all(-1)
    assert ((labels == NO_LABEL).all(-1) | labeled).all()  # all agents or none
    assert (labeled[:, :4] == labeled[:, :1]).all()
    assert 3 <= labeled[:, 0].sum() <= 17


def test_without_a_plan_there_are_no_labels_and_the_policy_acts(monkeypatch):
    monkeypatch.setattr(LaCAM, "plan", lambda *_: None)
    config = imitating(expert="lacam", expert_share=1.0)
    env, actor = environments(config)
    torch.manual_seed(0)
    steps = env.rollout(8, actor, break_when_any_done=False)["agents"]
    assert (steps["expert_action"] == NO_LABEL).all()
    assert (steps["position"] != steps["position"][:, :1]).any()


def batch_of(labels, at_goal, features):
    """Return a batch of one environment step per row."""
    shape = labels.shape
    agents = {
        "observation": {"image": torch.zeros(*shape, 6, 3, 3), "features": features},
        "expert_action": labels,
        "at_goal": at_goal.unsqueeze(-1),
        "active": torch.ones(*shape, 1, dtype=torch.bool),
        "logits": torch.zeros(*shape, 5),
    }
    return TensorDict({"agents": TensorDict(agents, batch_size=shape)}, batch_size=shape[:1])


def learner_of(config):
    algorithm = ALGORITHMS["dagger"](config)
    learner = algorithm.make_learner()
    assert isinstance(learner, ImitationLearner)
    return algorithm, learner


def test_the_policy_learns_the_labels():
    fast = dataclasses.replace(DAGGER, optimization=dataclasses.replace(DAGGER.optimization, learning_rate=5e-3))
    algorithm, learner = learner_of(imitating(fast, buffer_size=2000))
    shape = algorithm.observation_shape
    generator = torch.Generator().manual_seed(0)
    losses = []
    for _ in range(20):
        features = torch.rand(128, 3, shape.features, generator=generator)
        labels = (features[..., 0] > 0.5).long() + 1
        batch = batch_of(labels, torch.zeros(128, 3, dtype=torch.bool), features)
        batch["agents", "observation", "image"] = torch.zeros(128, 3, *shape.image)
        losses.append(learner.learn(batch, 0)["loss"])
    assert losses[0] > 1
    assert losses[-1] < 0.3


@pytest.mark.parametrize(("share", "low", "high"), [(0.0, 0, 0), (0.25, 60, 90), (1.0, 300, 300)])
def test_a_part_of_the_waits_at_goals_is_learned_from(share, low, high):
    algorithm, learner = learner_of(imitating(wait_share=share))
    shape = algorithm.observation_shape
    labels = torch.full((100, 4), CardinalAction.WAIT)
    labels[:, 3] = CardinalAction.UP
    at_goal = torch.ones(100, 4, dtype=torch.bool)
    batch = batch_of(labels, at_goal, torch.zeros(100, 4, shape.features))
    batch["agents", "observation", "image"] = torch.zeros(100, 4, *shape.image)
    torch.manual_seed(0)
    assert low <= learner.learn(batch, 0)["buffer"] - 100 <= high


def test_steps_without_a_label_or_an_agent_are_not_learned_from():
    algorithm, learner = learner_of(DAGGER)
    shape = algorithm.observation_shape
    labels = torch.zeros(10, 3, dtype=torch.int64)
    labels[:, 0] = NO_LABEL
    batch = batch_of(labels, torch.zeros(10, 3, dtype=torch.bool), torch.zeros(10, 3, shape.features))
    batch["agents", "observation", "image"] = torch.zeros(10, 3, *shape.image)
    batch["agents", "active"][:, 1] = False
    assert learner.learn(batch, 0)["buffer"] == 10


@pytest.mark.parametrize(("share", "low", "high"), [(0.0, 0, 0), (0.25, 0.15, 0.35), (1.0, 1, 1)])
@pytest.mark.parametrize("action_model", ["cardinal", "rotate"])
def test_history_dropout_puts_waits_in_place_of_the_last_actions(action_model, share, low, high):
    """The waits are those that agents observe which have waited."""
    features = ("goal_vector", "last_actions", "time")
    task = changed(DAGGER.task, action_model=action_model, features=features, num_last_actions=2, shield=False)
    config = imitating(dataclasses.replace(DAGGER, task=task), history_dropout=share, wait_share=1.0)
    _, learner = learner_of(config)
    env = BatchedMapfEnv(64, **config.task.env_keywords())
    env.set_seed(0)
    wait = wait_action(action_model)
    state = env.reset()
    for _ in range(2):
        state["agents", "action"] = torch.full((64, 3), wait)
        state = env.step(state)["next"]
    waited = state["agents", "observation", "features"]
    moved = waited.clone()
    moved[..., 4:-1] = 0.5  # the goal's vector is four numbers, the time one
    seen = []
    learner.modules["policy"].register_forward_pre_hook(lambda _, inputs: seen.append(inputs[1]))
    batch = batch_of(torch.full((64, 3), wait), torch.zeros(64, 3, dtype=torch.bool), moved)
    batch["agents", "observation", "image"] = state["agents", "observation", "image"]
    torch.manual_seed(0)
    learner.learn(batch, 0)
    rows = torch.cat(seen).flatten(0, -2)
    dropped = (rows[:, 4:-1] != 0.5).any(-1)
    assert low <= dropped.float().mean() <= high
    assert torch.equal(rows[dropped, 4:-1], waited.flatten(0, -2)[:1, 4:-1].expand(int(dropped.sum()), -1))
    assert (rows[:, -1] == waited[0, 0, -1]).all()


def test_history_dropout_needs_the_last_actions():
    task = changed(DAGGER.task, features=("goal_vector",))
    with pytest.raises(ValueError, match="history_dropout: expected the feature 'last_actions'"):
        learner_of(imitating(dataclasses.replace(DAGGER, task=task), history_dropout=0.5))


@pytest.mark.parametrize("shield", [False, True])
def test_a_run_is_trained_resumed_and_validated(tmp_path, shield):
    task = changed(DAGGER.task, shield=shield)
    config = dataclasses.replace(DAGGER, task=task, agent_steps=384, validation_interval=192, validation_episodes=4)
    once = train(config, tmp_path / "once")
    folder = train(dataclasses.replace(config, agent_steps=192), tmp_path / "run")
    resume(folder, agent_steps=384)
    assert untimed(folder)[0] == untimed(once)[0]
    last = rows(folder)[-1]
    assert float(last["validation_throughput"]) >= (0.1 if shield else 0)
    assert 0 < float(last["agreement"]) <= 1
    assert load_policy(folder).config.algorithm == "dagger"


def test_the_policy_acts_at_the_temperature_of_its_training(tmp_path):
    folder = train(imitating(dataclasses.replace(DAGGER, agent_steps=192), temperature=0.25), tmp_path)
    assert load_policy(folder).temperature == 0.25
    assert load_policy(folder, temperature=1.0).temperature == 1.0


def test_validation_does_not_call_the_expert():
    algorithm = ALGORITHMS["dagger"](DAGGER)
    env = MakeEnv(algorithm, DAGGER, 0, 2, training=False)()
    assert ("agents", "expert_action") not in env.reset().keys(include_nested=True)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"expert": "nobody"}, "planner 'nobody': expected one of pibt, "),
        ({"expert": "epibt:depth=0"}, "depth=0: expected"),
        ({"expert": "pibt:depth=2"}, "option 'depth=2': PIBT has the options"),
    ],
)
def test_unknown_experts(tmp_path, fields, message):
    with pytest.raises(ValueError, match=message):
        train(imitating(**fields), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "fields",
    [{"expert_share": 1.1}, {"wait_share": -0.1}, {"segment_steps": 0}, {"buffer_size": 0}, {"temperature": -1.0}],
)
def test_bad_numbers(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        ImitationConfig(**fields)


def test_recurrent_policies_are_refused():
    with pytest.raises(ValueError, match="recurrent=8: expected 0 with dagger"):
        ALGORITHMS["dagger"](dataclasses.replace(DAGGER, model=dataclasses.replace(DAGGER.model, recurrent=8)))


def test_without_the_safety_layer_agents_take_the_action_that_they_prefer():
    env = TransformedEnv(BatchedMapfEnv(3, num_agents=4), Compose(ExecutePreferences(shield=False)))
    now = env.reset()
    now["agents", "preferences"] = torch.randn(3, 4, 4)
    before = env.base_env.simulator.agents["heading"].copy()
    env.step(now)
    turns = (env.base_env.simulator.agents["heading"] - before) % 4
    best = now["agents", "preferences"].argmax(-1).numpy()
    assert np.array_equal(turns != 0, (best == 1) | (best == 2))


def test_an_order_is_a_sample_without_replacement():
    logits = torch.tensor([2.0, 1.0, 0.0]).expand(40_000, 3)
    torch.manual_seed(0)
    first, second = SamplePreferences()(logits).topk(2).indices.T
    p = logits[0].softmax(-1)
    for i in range(3):
        assert (first == i).float().mean().item() == pytest.approx(p[i].item(), abs=0.01)
        for j in {0, 1, 2} - {i}:
            expected = p[i] * p[j] / (1 - p[i])
            pair = ((first == i) & (second == j)).float().mean().item()
            assert pair == pytest.approx(expected.item(), abs=0.01)
    order = OrderActions()(logits, torch.full((40_000,), 1)).topk(2).indices
    assert (order[:, 0] == 1).all()
    assert (order[:, 1] == 0).float().mean().item() == pytest.approx((p[0] / (p[0] + p[2])).item(), abs=0.01)
    assert torch.equal(SamplePreferences(0.0)(logits), logits)


def test_the_expert_is_seeded():
    labels = []
    for seed in (5, 5, 6):
        env, actor = environments(imitating(expert="pibt", expert_share=0.5, segment_steps=2), seed=seed)
        torch.manual_seed(0)
        labels.append(env.rollout(10, actor, break_when_any_done=False)["agents", "expert_action"])
    assert torch.equal(labels[0], labels[1])
    assert not torch.equal(labels[0], labels[2])


@pytest.mark.parametrize("expert", ["windowed:rounds=1", "lacam:time_limit=0.01,clock=work"])
def test_labels_do_not_depend_on_the_number_of_threads(expert):
    labels = []
    for num_threads in (1, 3):
        config = imitating(dataclasses.replace(DAGGER, num_threads=num_threads), expert=expert, expert_share=0.5)
        env, actor = environments(dataclasses.replace(config, task=changed(config.task, on_target="nothing")))
        torch.manual_seed(0)
        labels.append(env.rollout(40, actor, break_when_any_done=False)["agents", "expert_action"])
    assert torch.equal(*labels)
    assert (labels[0] != NO_LABEL).any()


def test_an_expert_needs_a_planner():
    with pytest.raises(ValueError, match="planner ''"):
        ExpertActions(ImitationConfig(expert=""), 0)
