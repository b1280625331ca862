"""Every wrapper under the converters of other libraries, up to the end of episodes and beyond."""

import numpy as np
import pytest
from pettingzoo.test import api_test

import mapf_pz
from mapf_pz.wrappers import ContinuousActions, FlatObservations, MaskedObservations, RecordEpisode, to_aec

WRAPPERS = {
    "none": lambda env: env,
    "ContinuousActions": ContinuousActions,
    "FlatObservations": FlatObservations,
    "MaskedObservations": MaskedObservations,
    "RecordEpisode": RecordEpisode,
    "continuous, flat": lambda env: FlatObservations(ContinuousActions(env)),
    "flat, continuous": lambda env: ContinuousActions(FlatObservations(env)),
    "flat, masked": lambda env: MaskedObservations(FlatObservations(env)),
    "continuous, recorded": lambda env: RecordEpisode(ContinuousActions(env)),
}


def made(wrapper, **keywords):
    return WRAPPERS[wrapper](mapf_pz.parallel_env(num_agents=3, max_steps=10, map="...\n.@.\n...", **keywords))


@pytest.fixture(params=[{}, {"features": ("time",)}], ids=["image", "features"])
def keywords(request):
    return request.param


@pytest.fixture(params=["nothing", "finish"])
def on_target(request):
    return request.param


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")
@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_torchrl(wrapper, keywords, on_target):
    torchrl = pytest.importorskip("torchrl.envs")
    env = torchrl.PettingZooWrapper(made(wrapper, on_target=on_target, **keywords), use_mask=True)
    torchrl.check_env_specs(env)
    steps = env.rollout(30, break_when_any_done=False)
    assert steps.numel() == 30
    assert ("agent", "info", "at_goal") in steps.keys(True)
    assert (("agent", "action_mask") in steps.keys(True)) == ("ontinuous" not in wrapper)
    assert ("agent", "info", "action_mask") not in steps.keys(True)


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_supersuit(wrapper, keywords):
    supersuit = pytest.importorskip("supersuit")
    env = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(made(wrapper, **keywords)), 2, base_class="gymnasium"
    )
    env.reset(seed=0)
    env.action_space.seed(0)
    ends = 0
    for _ in range(30):
        _, _, terminations, truncations, _ = env.step(np.stack([env.action_space.sample() for _ in range(6)]))
        ends += (terminations | truncations).sum()
    assert ends >= 18


@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_rllib(wrapper, keywords, on_target):
    rllib = pytest.importorskip("ray.rllib.env.wrappers.pettingzoo_env", exc_type=ImportError)  # needs ray[rllib]
    env = rllib.ParallelPettingZooEnv(made(wrapper, on_target=on_target, **keywords))
    observations, _ = env.reset(seed=0)
    ends = 0
    for agent in env.get_agent_ids():
        env.get_action_space(agent).seed(0)
    for _ in range(30):
        actions = {agent: env.get_action_space(agent).sample() for agent in observations}
        observations, _, terminations, truncations, infos = env.step(actions)
        assert infos.keys() == observations.keys()
        assert all(env.get_observation_space(agent).contains(seen) for agent, seen in observations.items())
        if terminations["__all__"] or truncations["__all__"]:
            ends += 1
            observations, _ = env.reset()
        else:
            observations = {agent: observations[agent] for agent in env.par_env.agents}
    assert ends >= 3


@pytest.mark.parametrize("wrapper", [ContinuousActions, FlatObservations, MaskedObservations, RecordEpisode])
def test_the_aec_form_is_refused(wrapper):
    with pytest.raises(TypeError, match=r"^env: expected a MapfEnv or a wrapper of one, got "):
        wrapper(mapf_pz.env())


def test_wrappers_that_do_not_fit_each_other_are_refused():
    with pytest.raises(TypeError, match=r"^env: expected discrete actions, got Box"):
        MaskedObservations(made("ContinuousActions"))
    with pytest.raises(TypeError, match=r"^env: expected observations without action masks"):
        ContinuousActions(made("MaskedObservations"))
    with pytest.raises(TypeError, match=r"^env: expected observations of an image and features, got Dict"):
        FlatObservations(made("MaskedObservations"))


@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array")
@pytest.mark.filterwarnings("ignore:Observation space for each agent probably should be")
@pytest.mark.parametrize("wrapper", WRAPPERS)
def test_aec(wrapper, keywords, on_target):
    env = to_aec(made(wrapper, on_target=on_target, **keywords))
    api_test(env, num_cycles=30)
    env.reset(seed=0)
    for agent in env.agent_iter():
        last = env.terminations[agent] or env.truncations[agent]
        env.step(None if last else env.action_space(agent).sample())
    assert env.unwrapped.step_count > 0
    assert env.metrics() == env.unwrapped.metrics()
    assert repr(env).startswith("MapfAecEnv(")


def test_aec_observes_masks():
    """Tianshou looks for the mask in the observation: without it, all actions are allowed."""
    env = to_aec(MaskedObservations(FlatObservations(mapf_pz.parallel_env(map="...\n.@.\n...", num_agents=2))))
    env.reset(seed=0)
    observed, *_ = env.last()
    assert set(observed) == {"observation", "action_mask"}
    assert observed["action_mask"].tolist() == env.unwrapped.simulator.observe().action_mask[0, 0].tolist()


def test_aec_of_another_environment_is_refused():
    for wrong in (None, mapf_pz.env(num_agents=2)):
        with pytest.raises(TypeError, match="env: expected a MapfEnv or a wrapper of one"):
            to_aec(wrong)


def test_black_death_misses_the_end():
    """SuperSuit's wrapper pads agents that have disappeared, but waits for agents that are terminated and truncated."""
    supersuit = pytest.importorskip("supersuit")
    instance = mapf_pz.Scenario([(0, 0), (2, 0)], [(0, 1), (2, 2)])
    env = supersuit.black_death_v3(
        mapf_pz.parallel_env(
            map="...\n...\n...", scenario=instance, action_model="cardinal", on_target="finish", max_steps=6
        )
    )
    env.reset(seed=0)
    for _ in range(2):
        observations, _, terminations, _, _ = env.step(dict.fromkeys(env.agents, 4))
    assert list(observations) == ["agent_0", "agent_1"]
    assert not observations["agent_0"].any()
    assert env.unwrapped.agents == []
    assert not any(terminations.values())
    with pytest.raises(RuntimeError, match="the episode is over"):
        env.step(dict.fromkeys(env.agents, 4))
