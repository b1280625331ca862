"""Agents that decide in rounds: who decides when, that decisions are heard, and that actions fit together."""

import dataclasses

import numpy as np
import pytest
import torch

import mapf_pz
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig
from mapf_pz.rl.environments.execution import sampled_preferences
from mapf_pz.rl.networks.joint_actor import DecisionRounds, JointActor
from mapf_pz.rl.training.train import resume
from tests.helpers.labeled_steps import labeled_steps
from tests.helpers.small_run import TINY, changed, untimed

ROUNDS = 3
MODEL = dataclasses.replace(
    TINY.model, hidden=32, head=(8,), communication=1, communication_radius=2, decision_rounds=ROUNDS
)
CONFIG = dataclasses.replace(
    TINY,
    algorithm="dagger",
    task=changed(TINY.task, features=("action_advantage", "pose", "time")),
    model=MODEL,
    imitation=ImitationConfig(expert="pibt", expert_share=0.5),
    agent_steps=384,
)


def config(rounds=ROUNDS, **changes):
    return dataclasses.replace(CONFIG, model=dataclasses.replace(MODEL, decision_rounds=rounds), **changes)


def actor(rounds=ROUNDS):
    """An actor with large random weights, so that decisions have a clear effect."""
    torch.manual_seed(0)
    network = ALGORITHMS["dagger"](config(rounds)).network
    with torch.no_grad():
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.3)
    return network


def observations(num_teams=4, num_agents=6):
    """Observations of teams of agents in a row."""
    shape, generator = ALGORITHMS["dagger"](CONFIG).observation_shape, torch.Generator().manual_seed(1)
    image = torch.rand(num_teams, num_agents, *shape.image, generator=generator)
    features = torch.rand(num_teams, num_agents, shape.features, generator=generator)
    features[..., shape.pose] = torch.tensor([0.0, 0, 1, 0, 0, 0])
    features[..., shape.pose.start] = torch.arange(num_agents) / 32768
    return image, features


def pairs(distance, num_teams):
    """Observations of teams of two agents."""
    image, features = (part[:, :2] for part in observations(num_teams))
    features[:, 1, ALGORITHMS["dagger"](CONFIG).observation_shape.pose.start] = distance / 32768
    return image, features


def exponential(image, actions=4):
    return torch.empty(*image.shape[:2], actions).exponential_(generator=torch.Generator().manual_seed(2))


@pytest.mark.parametrize("temperature", [0.0, 0.5])
@pytest.mark.parametrize(("rounds", "num_agents"), [(2, 6), (3, 6), (4, 6), (6, 6), (9, 4), (3, 1)])
def test_the_most_certain_agents_of_those_near_decide_first_and_the_others_know_what(rounds, num_agents, temperature):
    network, seen = actor(rounds), observations(num_agents=num_agents)
    noise = exponential(seen[0])
    with torch.no_grad():
        logits, preferences = DecisionRounds(network, rounds, temperature)(*seen, noise)
        assert torch.equal(preferences, sampled_preferences(logits, temperature, noise))
        for team in range(len(noise)):
            decided = torch.full((num_agents,), network.undecided)
            for number in range(1, rounds + 1):
                (latest,) = network(*(part[team] for part in seen), decided)
                waiting = (decided == network.undecided).nonzero().flatten().tolist()
                certainty = {i: float(latest[i].softmax(-1).max()) for i in waiting}
                for i in waiting:  # agent i is in column i
                    if number == rounds or all(certainty[j] <= certainty[i] for j in waiting if abs(j - i) <= 2):
                        torch.testing.assert_close(logits[team, i], latest[i], rtol=1e-4, atol=1e-4)
                        decided[i] = preferences[team, i].argmax()
            assert not (decided == network.undecided).any()


@pytest.mark.parametrize(("distance", "number"), [(1, 1), (2, 1), (3, 2)])
def test_agents_decide_together_if_they_cannot_conflict(distance, number):
    network, (image, features) = actor(2), pairs(distance, num_teams=5)
    with torch.no_grad():
        (alone,) = network(image, features)
        logits, _ = DecisionRounds(network, 2, 0.0)(image, features, exponential(image))
    assert (logits == alone).all(-1).sum(-1).tolist() == [number] * 5


@pytest.mark.parametrize(("distance", "rounds"), [(1, 2), (3, 1)])
def test_rounds_end_when_all_agents_have_decided(distance, rounds, monkeypatch):
    network, decided = actor(), []
    decide = network.decide
    monkeypatch.setattr(network, "decide", lambda *parts: decided.append(parts[-1]) or decide(*parts))
    with torch.no_grad():
        DecisionRounds(network, 9, 0.0)(*pairs(distance, num_teams=4))
    assert len(decided) == rounds


def one_goes(algorithm, number):
    """Steps of two agents side by side, of which a random one goes and the other one waits; they observe the same."""
    shape = algorithm.observation_shape
    first = torch.randint(2, (number, 1))
    features = torch.zeros(number, 2, shape.features)
    features[..., shape.pose] = torch.tensor([[0.0, 0, 1, 0, 0, 0], [0.0, 1 / 32768, 0, 0, 1, 0]])
    return labeled_steps(torch.cat([3 * first, 3 - 3 * first], -1), torch.zeros(number, 2, *shape.image), features)


@pytest.mark.parametrize(("rounds", "least", "most"), [(1, 0.4, 0.6), (2, 0.97, 1)])
def test_actions_fit_together(rounds, least, most):
    optimization = dataclasses.replace(CONFIG.optimization, learning_rate=3e-3, minibatch_size=64)
    task = changed(CONFIG.task, num_agents=2)
    torch.manual_seed(0)
    algorithm = ALGORITHMS["dagger"](config(rounds, task=task, optimization=optimization))
    learner = algorithm.make_learner()
    for _ in range(60):
        learner.learn(one_goes(algorithm, 256), 0)
    batch = one_goes(algorithm, 2000)
    with torch.no_grad():
        actions = algorithm.actor(batch)["agents", "preferences"].argmax(-1)
    goes = actions == 0
    assert least <= float((goes.sum(-1) == 1).float().mean()) <= most
    assert 0.25 <= float(goes[:, 0].float().mean()) <= 0.75  # not always the same agent


def test_a_run_is_trained_and_resumed_and_its_policy_decides_in_rounds(tmp_path):
    once = train(CONFIG, tmp_path / "once")
    folder = train(dataclasses.replace(CONFIG, agent_steps=192), tmp_path / "run")
    resume(folder, agent_steps=384)
    assert untimed(folder)[0] == untimed(once)[0]
    policy = load_policy(folder, deterministic=True)
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=5)
    observed, _ = env.reset(seed=0)
    seen = [torch.from_numpy(np.stack([o[key] for o in observed.values()])) for key in ("image", "features")]
    assert isinstance(policy.network, JointActor)
    with torch.no_grad():
        expected, _ = DecisionRounds(policy.network, ROUNDS, 0.0)(*(part[None] for part in seen))
    found = np.stack(list(policy.preferences(observed).values()))
    np.testing.assert_allclose(found, expected[0].numpy(), rtol=1e-4, atol=1e-5)
    decisions = []
    policy.watch(decisions.append)
    policy.act(observed)
    assert decisions[0].probabilities.shape == (5, 4)


def test_a_policy_acts_with_another_number_of_rounds(tmp_path):
    folder = train(dataclasses.replace(CONFIG, agent_steps=192), tmp_path)
    louder = actor().state_dict()
    taken = {}
    for rounds in (None, ROUNDS, 1, 6):
        policy = load_policy(folder, decision_rounds=rounds)
        policy.network.load_state_dict(louder)
        env = mapf_pz.parallel_env(**policy.env_kwargs, map="empty-8-8", num_agents=20)
        preferences = policy.preferences(env.reset(seed=0)[0])
        taken[rounds] = np.stack(list(preferences.values())).tolist(), policy.identity
    assert taken[None] == taken[ROUNDS]
    for part in (0, 1):
        assert len({str(each[part]) for each in taken.values()}) == 3
    task = EvaluationTask("empty-8-8", 4, {"map": "empty-8-8", "max_steps": 16}, episodes=2)
    assert {episode.policy for episode in evaluate([f"{folder}:decision_rounds=2"], [task])} == {
        f"{folder}:decision_rounds=2"
    }


def test_a_run_starts_from_a_policy_whose_agents_decide_at_once(tmp_path):
    start = train(config(1, agent_steps=192), tmp_path / "start")
    still = dataclasses.replace(CONFIG.optimization, learning_rate=1e-9)
    folder = train(config(agent_steps=192, initial_policy=str(start), optimization=still), tmp_path / "run")
    seen = observations()
    with torch.no_grad():
        (before,), (after,) = load_policy(start).network(*seen), load_policy(folder).network(*seen)
    torch.testing.assert_close(after, before, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="initial_policy: not the networks of this configuration"):
        train(config(1, initial_policy=str(folder)), tmp_path / "other")


@pytest.mark.parametrize(
    ("name", "model", "message"),
    [
        ("dagger", {"communication": 0}, "decision_rounds=3: expected 1 without communication, and with mask_actions"),
        (
            "dagger",
            {"mask_actions": True},
            "decision_rounds=3: expected 1 without communication, and with mask_actions",
        ),
        ("dagger", {"decision_rounds": 0}, "decision_rounds=0: expected a whole number, 1 or more"),
        ("mappo", {}, "decision_rounds=3: expected 1 with mappo, whose agents act at the same time"),
        ("central-ppo", {}, "decision_rounds=3: expected 1 with central-ppo, whose agents act at the same time"),
    ],
)
def test_bad_settings(tmp_path, name, model, message):
    def run():
        changed_model = dataclasses.replace(MODEL, **model)
        train(dataclasses.replace(CONFIG, algorithm=name, model=changed_model), tmp_path)

    with pytest.raises(ValueError, match=message):
        run()
