"""Delays: their rules, and that they depend on nothing but the seed, the agent and the step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mapf_pz
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.delays import Delays
from mapf_pz.simulator import Simulator
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.delay import delay_rules, delayed_agents

ALWAYS = Delays(1.0, (1, 1))
SOURCE = RandomObstacles(6, 6, 0.1, 8)

numbers = st.floats(0, 1)
durations = st.tuples(st.integers(1, 50), st.integers(1, 50)).map(lambda pair: tuple(sorted(pair)))
any_delays = st.builds(
    Delays, numbers, durations, st.sampled_from(["bernoulli", "poisson"]), st.sampled_from(["uniform", "normal"])
)


def corridor(delays, action_model="cardinal", headings="east"):
    """Two agents that go east, one behind the other."""
    return mapf_pz.parallel_env(
        map=np.ones((1, 5), bool),
        scenario=mapf_pz.Scenario(np.array([[0, 0], [0, 1]]), np.array([[0, 3], [0, 4]])),
        action_model=action_model,
        initial_heading=headings,
        delays=delays,
    )


@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_a_delayed_agent_waits_whatever_its_action(action_model):
    env = corridor(ALWAYS, action_model)
    env.reset(seed=0)
    positions, headings = env.positions.tolist(), env.headings.tolist()
    for action in CardinalAction if action_model == "cardinal" else Action:
        _, rewards, _, _, infos = env.step(dict.fromkeys(env.agents, int(action)))
        assert (env.positions.tolist(), env.headings.tolist()) == (positions, headings)
        assert set(rewards.values()) == {0}
        for info in infos.values():
            assert (info["delayed"], info["moved"], info["blocked"]) == (1, 0, 0)


def test_a_delay_takes_its_number_of_steps():
    env = corridor("1:3-3")
    env.reset(seed=0)
    left = []
    for _ in range(4):
        env.step(dict.fromkeys(env.agents, 0))
        left.append(env.simulator.agents["delay"][0].tolist())
    assert left == [[2, 2], [1, 1], [0, 0], [2, 2]]  # the next delay begins at once


def test_agents_behind_a_delayed_one_are_blocked():
    env = corridor("0.3:1-1")
    right, seen = int(CardinalAction.RIGHT), set()
    for seed in range(50):
        env.reset(seed=seed)
        *_, infos = env.step(dict.fromkeys(env.agents, right))
        behind, front = (infos[agent] for agent in env.possible_agents)
        moved = (behind["moved"], front["moved"])
        seen.add((behind["delayed"], front["delayed"], *moved))
        assert behind["blocked"] == (front["delayed"] and not behind["delayed"])
    assert seen == {(0, 0, 1, 1), (1, 0, 0, 1), (0, 1, 0, 0), (1, 1, 0, 0)}


def test_no_delays_no_infos():
    env = corridor(None)
    _, infos = env.reset(seed=0)
    assert "delayed" not in infos["agent_0"]
    assert not any("delay" in name for name in env.metrics())


def history(config, num_envs=1, num_threads=1, choices=5, seed=3, num_steps=40):
    """Return which agents were delayed (steps, B, N), with random actions of `choices`, over several episodes."""
    simulator = Simulator(config, num_envs, num_threads)
    simulator.reset(seeds={b: seed + b for b in range(num_envs)})
    rng = np.random.default_rng(choices)
    log = []
    for _ in range(num_steps):
        simulator.step(rng.integers(choices, size=(num_envs, simulator.num_agents)))
        log.append(simulator.agents["delayed"].copy())
        if simulator.over.any():
            simulator.reset(np.flatnonzero(simulator.over).tolist())
    return np.array(log)


@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("delays", ["0.1:1-4", "0.1:2-5:poisson:normal"])
def test_delays_do_not_depend_on_actions_threads_or_the_batch(delays, on_target):
    # The first episode does not end before the steps that are compared.
    keywords = {"source": RandomObstacles(6, 6, 0.1, 8, 3), "action_model": "cardinal", "on_target": on_target}
    config = EnvConfig(**keywords, max_steps=40, delays=delays)
    batch = history(config, num_envs=3)
    assert 0.05 < batch.mean() < 0.5
    np.testing.assert_array_equal(batch, history(config, num_envs=3, choices=1))
    np.testing.assert_array_equal(batch, history(config, num_envs=3, num_threads=2))
    for b in range(3):
        np.testing.assert_array_equal(batch[:, b], history(config, seed=3 + b, choices=2)[:, 0])
    assert not np.array_equal(batch[:, 0], batch[:, 1])


def test_episodes_differ_and_agents_keep_their_instances():
    """The instances of a seed are the same with and without delays."""
    plain, delayed = (Simulator(EnvConfig(source=SOURCE, max_steps=20, delays=text)) for text in (None, "0.2:1-3"))
    keys = set()
    for simulator in (plain, delayed):
        simulator.reset(seeds={0: 7})
    np.testing.assert_array_equal(plain.positions(0), delayed.positions(0))
    for _ in range(3):
        keys.add(int(delayed.state.delay_key[0]))
        delayed.reset()
    assert len(keys) == 3


def test_the_rates_of_both_models():
    """Of agents that are free, the share `probability` becomes delayed in a step, in the mean."""
    for events in ("bernoulli", "poisson"):
        delays = Delays(0.05, (1, 1), events)
        delayed = delayed_agents(delay_rules(delays), 5, 2000, 20)
        assert delayed.mean() == pytest.approx(0.05, abs=0.004)
        per_step = delayed.sum(axis=1)
        # Bernoulli: N p (1 - p) = 0.95; Poisson: N p = 1.
        assert per_step.var() == pytest.approx(0.95 if events == "bernoulli" else 1.0, abs=0.1)
        assert delayed.mean(axis=0).min() > 0.03


def test_the_durations_of_both_models():
    means, deviations = {}, {}
    for name in ("uniform", "normal"):
        delays = Delays(1.0, (1, 21), durations=name)  # the next delay begins when one ends
        left, lengths = np.zeros(10, np.int32), []
        simulator = Simulator(EnvConfig(source=RandomObstacles(6, 6, 0, 10), max_steps=3000, delays=delays))
        simulator.reset(seeds={0: 1})
        for _ in range(2000):
            simulator.step(np.zeros((1, 10), np.int64))
            now = simulator.agents["delay"][0]
            lengths += (now[left == 0] + 1).tolist()
            left = now.copy()
        assert (min(lengths), max(lengths)) == (1, 21)
        means[name], deviations[name] = np.mean(lengths), np.std(lengths)
    assert means == {name: pytest.approx(11, abs=0.5) for name in means}
    assert deviations == {"uniform": pytest.approx(6.06, abs=0.3), "normal": pytest.approx(4.35, abs=0.3)}


def test_all_agents_can_be_delayed():
    delayed = delayed_agents(delay_rules(Delays(1.0, (50, 50), "poisson")), 1, 200, 5)
    assert delayed[-50:].mean() > 0.9
    assert delayed_agents(delay_rules(Delays(0.0)), 1, 50, 5).sum() == 0


# Texts, and what is refused.


@given(any_delays)
def test_texts_are_read_as_what_they_were(delays):
    assert Delays.from_text(str(delays)) == delays


@pytest.mark.parametrize(
    ("text", "delays"),
    [
        ("0.01:1-4", Delays(0.01, (1, 4))),
        ("0.003:2-8:poisson", Delays(0.003, (2, 8), "poisson")),
        ("1e-3:5-20:poisson:normal", Delays(0.001, (5, 20), "poisson", "normal")),
        ("0:1-1:normal", Delays(0.0, (1, 1), durations="normal")),
    ],
)
def test_texts(text, delays):
    assert EnvConfig(delays=text).delays == delays
    assert EnvConfig(delays=text) == EnvConfig(delays=delays)


@pytest.mark.parametrize(
    "text",
    ["", "0.01", "0.01:4", "2:1-4", "0.01:1-4:gamma", "0.01:1-4:normal:poisson", "-1:1-2", "nan:1-2", "0.1: 1-2"],
)
def test_texts_that_are_refused(text):
    with pytest.raises(ValueError, match=r"^delays=.*: expected PROBABILITY:SMALLEST-LARGEST"):
        EnvConfig(delays=text)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"probability": 1.5}, "probability=1.5: expected a number, 1 or less|probability=1.5: expected at most 1"),
        ({"duration": (4, 1)}, r"duration=\(4, 1\): expected the smallest number of steps first"),
        ({"duration": (0, 1)}, r"duration=\(0, 1\): expected \(smallest, largest\)"),
        ({"events": "gamma"}, "events='gamma': expected one of 'bernoulli', 'poisson'"),
        ({"durations": "gamma"}, "durations='gamma': expected one of 'uniform', 'normal'"),
    ],
)
def test_values_that_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Delays(**given)
    with pytest.raises(ValueError, match=r"delays=1: expected a Delays, or its text"):
        EnvConfig(delays=1)


# Metrics.


def test_the_metrics_of_agents_that_are_alone():
    """Agents that never meet are as late as their delays make them."""
    scenario = mapf_pz.Scenario(np.array([[0, 0], [2, 0]]), np.array([[0, 7], [2, 0]]))
    free = np.array([[True] * 8, [False] * 8, [True] * 8])
    env = mapf_pz.parallel_env(map=free, scenario=scenario, action_model="cardinal", delays="0.3:1-2", max_steps=100)
    env.reset(seed=5)
    assert env.metrics()["delay_share"] == 0
    delayed = []
    while env.agents:
        *_, infos = env.step({"agent_0": int(CardinalAction.RIGHT), "agent_1": 0})
        delayed.append([info["delayed"] for info in infos.values()])
    metrics, late = env.metrics(), sum(one for one, _ in delayed)
    assert late > 0
    assert metrics["SoC"] == 7 + late + 1
    assert metrics["delayed_SoC_ratio"] == 1
    assert metrics["SoC_ratio"] == (7 + late + 1) / 8
    assert metrics["delay_share"] == pytest.approx(np.mean(delayed))


# The other interfaces.


def test_all_interfaces_tell_who_is_delayed():
    rl = pytest.importorskip("mapf_pz.rl")
    keywords = {"source": SOURCE, "delays": "0.4:1-2", "max_steps": 9}
    simulator = Simulator(EnvConfig(**keywords), 2)
    simulator.reset(seeds={0: 5, 1: 6})
    agents = mapf_pz.wrappers.AgentVectorEnv(2, **keywords)
    batched = rl.BatchedMapfEnv(num_envs=2, **keywords)
    team = mapf_pz.wrappers.CentralizedVectorEnv(2, **keywords)
    single = mapf_pz.wrappers.CentralizedEnv(mapf_pz.parallel_env(**keywords))
    _, infos = agents.reset(seed=5)
    batched.set_seed(5)
    data = batched.reset()
    team.reset(seed=5)
    single.reset(seed=5)
    assert not infos["delayed"].any()
    for _ in range(6):
        simulator.step(np.zeros((2, 8), np.int64))
        expected = simulator.agents["delayed"]
        *_, infos = agents.step(np.zeros(16, np.int64))
        np.testing.assert_array_equal(infos["delayed"], expected.reshape(-1))
        data["agents", "action"] = data["agents", "action_mask"].long().argmax(-1) * 0
        data = batched.step(data)["next"]
        np.testing.assert_array_equal(data["agents", "delayed"].squeeze(-1).numpy(), expected)
        *_, infos = team.step(np.zeros((2, 8, 4)))
        np.testing.assert_array_equal(infos["delayed"], expected)
        *_, info = single.step(np.zeros((8, 4)))
        np.testing.assert_array_equal(info["delayed"], expected[0])
