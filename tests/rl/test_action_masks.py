"""Action masks: a policy that is trained with `mask_actions` takes only actions that the map allows."""

import dataclasses

import numpy as np
import pytest
import torch

import mapf_pz
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.pogema.pogema import InPogema
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.environments.collect import collecting
from tests.helpers.small_run import TINY, changed

# Agents that move in four directions on a small map with obstacles are next to walls in most steps.
TASK = changed(TINY.task, action_model="cardinal", density=0.3, max_steps=7)


def masking(**model):
    return dataclasses.replace(TINY, task=TASK, model=dataclasses.replace(TINY.model, mask_actions=True, **model))


@pytest.fixture(scope="module", params=[0, 8], ids=["feedforward", "recurrent"])
def run(request, tmp_path_factory):
    """The folder of a short run with action masks."""
    return train(masking(recurrent=request.param), tmp_path_factory.mktemp("run"))


def collected(config):
    """Return a batch that the algorithm has collected."""
    torch.manual_seed(0)
    with collecting(ALGORITHMS[config.algorithm](config), config, seed=0, updates=1) as collector:
        return next(iter(collector)).clone()


@pytest.mark.parametrize("on_target", ["nothing", "finish"])
@pytest.mark.parametrize("recurrent", [0, 8])
@pytest.mark.parametrize("name", ["mappo", "ippo"])
def test_log_probs_are_those_of_a_softmax_over_the_allowed_actions(name, recurrent, on_target):
    config = dataclasses.replace(masking(recurrent=recurrent), algorithm=name)
    config = dataclasses.replace(config, task=changed(config.task, on_target=on_target))
    batch = collected(config)
    logits, allowed, actions = (batch["agents", key].numpy() for key in ("logits", "action_mask", "action"))
    assert not allowed.all()
    assert np.isfinite(logits).all()
    chosen = np.take_along_axis(allowed, actions[..., None], -1)
    assert chosen.all()
    for row in np.ndindex(actions.shape):
        weights = np.exp(logits[row][allowed[row]].astype(np.float64))
        expected = np.log(np.exp(logits[row][actions[row]].astype(np.float64)) / weights.sum())
        assert batch["agents", "action_log_prob"][row].item() == pytest.approx(expected, abs=1e-5)
    if on_target == "finish":
        gone = ~batch["agents", "active"].squeeze(-1)
        assert gone.any()
        assert (batch["agents", "action_log_prob"][gone] == 0).all()  # they can only wait


def test_a_saved_policy_masks(run):
    policy = load_policy(run)
    env = mapf_pz.parallel_env(**policy.env_kwargs, map="random-16-16-20", num_agents=12, max_steps=40)
    observations, infos = env.reset(seed=0)
    while env.agents:
        policy.reset_states()  # the same random numbers in each step
        unmasked = load_policy(run).preferences(observations)
        policy.reset_states()
        rated = policy.preferences(observations, infos)
        for name, info in infos.items():
            allowed = info["action_mask"].astype(bool)
            np.testing.assert_array_equal(rated[name], np.where(allowed, unmasked[name], -np.inf))
        policy.reset_states()
        actions = policy.act(observations, infos)
        assert actions == {name: int(values.argmax()) for name, values in rated.items()}
        assert all(infos[name]["action_mask"][action] for name, action in actions.items())
        observations, _, _, _, infos = env.step(actions)


def test_a_policy_that_masks_needs_the_infos(run):
    policy = load_policy(run)
    env = mapf_pz.parallel_env(**policy.env_kwargs, num_agents=2)
    with pytest.raises(ValueError, match=r"masks actions: expected act\(observations, infos\)"):
        policy.act(env.reset(seed=0)[0])
    assert not load_policy("mappo").needs_infos
    assert policy.act({}, {}) == {}


def test_an_evaluation_gives_the_infos(run):
    task = EvaluationTask("empty", 6, {"map": "empty-8-8", "max_steps": 30}, 3)

    class Unmasked:
        """The same policy without masks."""

        def __init__(self):
            self.policy = load_policy(run)
            self.env_kwargs = self.policy.env_kwargs

        def act(self, observations):
            return {name: int(values.argmax()) for name, values in self.policy.preferences(observations).items()}

        def reset_states(self):
            self.policy.reset_states()

    episodes = evaluate({"masked": str(run), "unmasked": Unmasked(), "shielded": f"{run}+pibt"}, [task])
    blocked = dict.fromkeys(("masked", "unmasked", "shielded"), 0.0)
    for episode in episodes:
        blocked[episode.policy] += episode.metrics["collisions"]
    assert blocked["shielded"] == 0
    assert blocked["masked"] < blocked["unmasked"]


def test_a_policy_that_masks_acts_in_pogema(run):
    adapter = InPogema(str(run), collision_system="soft", on_target="nothing", max_steps=9)
    empty = np.zeros((14, 14))
    seen = {"obstacles": np.zeros((11, 11)), "global_obstacles": empty, "global_xy": (5, 5), "global_target_xy": (8, 8)}
    for _ in range(10):
        adapter.reset_states()
        assert adapter.act([seen])[0] in (0, 2, 4)  # in the upper left corner: wait, down, right


def test_central_ppo_cannot_mask():
    with pytest.raises(ValueError, match="mask_actions: expected False with central-ppo"):
        ALGORITHMS["central-ppo"](dataclasses.replace(masking(), algorithm="central-ppo"))
