"""What is recorded of a policy's decisions: it is what the policy computed, and recording it changes nothing."""

import numpy as np
import pytest

from mapf_pz.evaluation import InspectedPolicy, make_env, policy_factory, rollout
from mapf_pz.evaluation.inspection import MAX_NUMBERS, STRONGEST, strongest
from mapf_pz.wrappers import RecordEpisode

torch = pytest.importorskip("torch")
from mapf_pz.planners import Shield  # noqa: E402
from mapf_pz.rl import load_policy  # noqa: E402
from tests.helpers.untrained import untrained  # noqa: E402

SETTINGS = {"map": "random-12-12-15", "num_agents": 30, "max_steps": 25}


def make(name):
    """Return an environment, and a policy in it that has begun no episode."""
    if name == "recurrent":
        policy = untrained(recurrent=12)
    elif name == "masked":
        policy = untrained(mask_actions=True)
    else:
        return policy_factory(name)(SETTINGS)
    return make_env(policy, **SETTINGS), policy


def run(name, inspected):
    """Return the recording of an episode, and its inspection if there is one."""
    env, policy = make(name)
    recorded = RecordEpisode(env)
    wrapper = InspectedPolicy(policy, env) if inspected else None
    rollout(recorded, wrapper or policy, seed=5)
    return recorded.recording, wrapper and wrapper.inspection


NAMES = ["mappo", "oneshot-cardinal+pibt", "central+pibt", "central-warehouse", "recurrent", "masked", "pibt", "random"]


@pytest.mark.parametrize("name", NAMES)
def test_the_episode_is_the_same(name):
    (plain, _), (recording, inspection) = run(name, False), run(name, True)
    np.testing.assert_array_equal(recording.positions, plain.positions)
    np.testing.assert_array_equal(recording.actions, plain.actions)
    assert inspection.num_steps == recording.num_steps
    assert (inspection.ignored is not None) == ("+pibt" in name)
    if inspection.preferred is not None and inspection.ignored is None:  # nothing stands between
        np.testing.assert_array_equal(inspection.preferred, recording.actions[1:])


@pytest.mark.parametrize("name", ["pibt", "random"])
def test_of_a_planner_only_the_masks_are_known(name):
    _, inspection = run(name, True)
    assert inspection.allowed.shape == (25, 30, 4)
    assert 0.5 < inspection.allowed.mean() < 1
    known = (inspection.probabilities, inspection.means, inspection.preferred, inspection.ignored, inspection.attended)
    assert known == (None,) * 5


def collected(name, temperature):
    """Return the inspection of an episode, and what the network says of each of its observations."""
    policy = load_policy(name, temperature=temperature)
    env = make_env(policy, **SETTINGS)
    wrapper = InspectedPolicy(policy, env)
    outputs = []

    class Watched:
        def act(self, observations):
            image, features = (torch.tensor(np.stack([o[k] for o in observations.values()])) for k in o_keys)
            with torch.no_grad():
                outputs.append([part[0].numpy() for part in policy.network(image[None], features[None])])
            return wrapper.act(observations)

        def reset_states(self):
            wrapper.reset_states()

    o_keys = ("image", "features")
    rollout(env, Watched(), seed=5)
    return wrapper.inspection, [np.stack(each) for each in zip(*outputs, strict=True)]


@pytest.mark.parametrize("temperature", [1.0, 0.5])
def test_probabilities_are_those_of_the_network(temperature):
    inspection, (logits,) = collected("lifelong-cardinal", temperature)
    powers = np.exp(logits / temperature)
    np.testing.assert_allclose(inspection.probabilities, powers / powers.sum(-1, keepdims=True), atol=1e-4)
    np.testing.assert_allclose(inspection.probabilities.sum(-1), 1, atol=1e-5)
    chosen = np.take_along_axis(inspection.probabilities, inspection.preferred[..., None], -1)
    assert chosen.mean() > 0.5  # actions are sampled from them


def test_the_most_likely_action_has_probability_one_at_temperature_zero():
    inspection, (logits,) = collected("lifelong-cardinal", 0.0)
    assert (inspection.probabilities == np.eye(5)[logits.argmax(-1)]).all()


def test_means_of_a_policy_without_probabilities():
    inspection, (means, _) = collected("central", 1.0)
    assert inspection.probabilities is None
    np.testing.assert_allclose(inspection.means, means, atol=1e-4)


def test_masked_actions_have_probability_zero():
    _, inspection = run("masked", True)
    assert not inspection.allowed.all()
    assert (inspection.probabilities[~inspection.allowed] == 0).all()
    np.testing.assert_allclose(inspection.probabilities.sum(-1), 1, atol=1e-5)


def test_features_have_names_and_are_the_observed_ones():
    recording, inspection = run("oneshot-cardinal", True)
    names = inspection.feature_names
    assert (names[0], names[-1], len(names)) == ("action_advantage 1", "pose 6", 27)
    on_goal = (recording.positions == recording.goals).all(-1)[:-1]
    np.testing.assert_array_equal(inspection.features[..., names.index("goal_vector 4")], on_goal)
    last = [names.index(f"last_actions {k + 1}") for k in range(5)]
    np.testing.assert_array_equal(inspection.features[1:, :, last].argmax(-1), recording.actions[1:-1])


def test_attention():
    _, inspection = run("central-warehouse", True)
    assert inspection.attended.shape == inspection.attention.shape == (25, 30, STRONGEST)
    assert (np.diff(inspection.attention, axis=-1) <= 0).all()
    assert (inspection.attention.sum(-1) <= 1 + 1e-5).all()
    assert inspection.attention.sum(-1).mean() > 0.5
    for row in inspection.attended.reshape(-1, STRONGEST):
        others = row[row >= 0]
        assert len(set(others.tolist())) == len(others)


def test_the_strongest_of_few():
    agents, weights = strongest(np.array([[0.7, 0.3, 0.0], [0.1, 0.2, 0.7], [0.0, 0.0, 1.0]], np.float32))
    assert agents[:, :4].tolist() == [[0, 1, -1, -1], [2, 1, 0, -1], [2, -1, -1, -1]]
    assert (agents[:, 3:] == -1).all()
    np.testing.assert_array_equal(weights[1, :4], np.array([0.7, 0.2, 0.1, 0], np.float32))


def test_agents_that_have_disappeared():
    env, policy = policy_factory("central-warehouse+pibt")(SETTINGS | {"on_target": "finish"})
    recorded, wrapper = RecordEpisode(env), InspectedPolicy(policy, env)
    rollout(recorded, wrapper, seed=5)
    gone = ~recorded.recording.active[:-1]
    inspection = wrapper.inspection
    assert gone.any()
    assert (inspection.preferred[gone] == -1).all()
    assert (inspection.attended[gone] == -1).all()
    assert (inspection.probabilities[gone] == 0).all()
    for missing, attended in zip(gone[:-1], inspection.attended[1:], strict=True):  # observed in one more step
        assert not np.isin(attended, missing.nonzero()[0]).any()


@pytest.mark.parametrize(("inspected", "recorded"), [(None, 30), (4, 4), (0, 0), (99, 30)])
def test_the_first_agents_are_recorded(inspected, recorded):
    env, policy = policy_factory("mappo+pibt")(SETTINGS)
    wrapper = InspectedPolicy(policy, env, inspected)
    rollout(env, wrapper, seed=5)
    for name in ("allowed", "features", "probabilities", "preferred", "ignored"):
        assert getattr(wrapper.inspection, name).shape[:2] == (25, recorded)


def test_the_size_is_limited():
    env, policy = policy_factory("mappo")(SETTINGS | {"max_steps": 8000})
    wrapper = InspectedPolicy(policy, env)
    observations, infos = env.reset(seed=0)
    wrapper.reset_states()
    wrapper.act(observations, infos)
    num_recorded = wrapper.inspection.allowed.shape[1]
    assert 5 < num_recorded < 30
    assert 8000 * num_recorded * (wrapper.inspection.features.shape[-1] + 4) < MAX_NUMBERS


def test_wrong_use():
    env, policy = policy_factory("pibt")(SETTINGS)
    with pytest.raises(ValueError, match="inspected=-1: expected 0 or more"):
        InspectedPolicy(policy, env, -1)
    with pytest.raises(RuntimeError, match=r"call act\(\) first"):
        _ = InspectedPolicy(policy, env).inspection


def test_agents_that_ignore_their_preferences():
    env, policy = policy_factory("oneshot-cardinal+pibt:patience=3")(SETTINGS)
    wrapper = InspectedPolicy(policy, env)
    assert isinstance(policy, Shield)
    rollout(env, wrapper, seed=5)
    ignored = wrapper.inspection.ignored
    assert ignored.any()
    assert not ignored[:3].any()
