import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import mapf_pz
from mapf_pz import RandomObstacles
from mapf_pz.wrappers import AgentVectorEnv

SMALL = {"map": ".....\n..@..\n.....\n", "num_agents": 3, "max_steps": 7, "view_size": (3, 3)}
KEYWORDS = [
    {},
    {"features": ("goal_vector", "time"), "reward": "progress", "num_frames": 2, "edge_weights": "random"},
    {"action_model": "cardinal", "view": "centered", "channels": ("view", "cost_to_go")},
]
METRICS = {
    "nothing": {"CSR", "ISR", "SoC", "SoC_ratio", "makespan", "ep_length"},
    "finish": {"CSR", "ISR", "SoC", "SoC_ratio", "makespan", "ep_length"},
    "restart": {"avg_throughput", "exhausted_agents", "ep_length"},
}


class Reference:
    """The same as an `AgentVectorEnv`, by one `MapfEnv` after the other."""

    def __init__(self, num_envs, mode, **keywords):
        self.envs = [mapf_pz.parallel_env(**keywords) for _ in range(num_envs)]
        self.agents = self.envs[0].possible_agents
        self.mode = mode
        self.space = self.envs[0].observation_space("agent_0")

    def reset(self, seed):
        first = [env.reset(seed=None if seed is None else seed + b) for b, env in enumerate(self.envs)]
        return [self._row(*one, agent) for one in first for agent in self.agents]

    def _row(self, observations, infos, agent, reward=0.0, ended=(False, False), active=True):
        """Return what one agent gets in a step; those that have disappeared get padding."""
        here = agent in observations
        return {
            "seen": observations[agent] if here else nothing(self.space),
            "mask": infos[agent]["action_mask"].tolist() if here else None,
            "reward": reward,
            "ended": ended,
            "active": active,
        }

    def step(self, actions):
        rows = []
        for b, env in enumerate(self.envs):
            numbers = actions[b * len(self.agents) : (b + 1) * len(self.agents)]
            if not env.agents:
                first = env.reset()
                rows += [self._row(*first, agent) for agent in self.agents]
                continue
            chosen = {agent: int(numbers[i]) for i, agent in enumerate(self.agents) if agent in env.agents}
            seen, rewards, terminated, truncated, infos = env.step(chosen)
            over = not env.agents
            metrics = env.metrics() | {"is_success": over and all(terminated.values())} if over else None
            after = env.reset() if over and self.mode == "SameStep" else None
            for agent in self.agents:
                ended = terminated.get(agent, False), truncated.get(agent, over)
                row = self._row(seen, infos, agent, rewards.get(agent, 0.0), ended, agent in env.agents)
                if self.mode == "SameStep" and any(ended):
                    now = self._row(*(after or ({}, {})), agent)
                    row |= {"final": row["seen"], "final_mask": row["mask"], "seen": now["seen"], "mask": now["mask"]}
                rows.append(row | {"metrics": metrics})
        return rows


def nothing(space):
    return {name: nothing(part) for name, part in space.items()} if hasattr(space, "spaces") else np.zeros(space.shape)


def same(mine, other):
    if isinstance(other, dict):
        return mine.keys() == other.keys() and all(np.array_equal(mine[name], other[name]) for name in other)
    return np.array_equal(mine, other)


def row_of(rows, i):
    return {name: part[i] for name, part in rows.items()} if isinstance(rows, dict) else rows[i]


def assert_observed(observations, infos, expected):
    for i, row in enumerate(expected):
        assert same(row_of(observations, i), row["seen"])
        assert row["mask"] is None or infos["action_mask"][i].tolist() == row["mask"]
        assert infos["active"][i] == row["active"]
    assert infos["_action_mask"].all()
    assert infos["_active"].all()


@pytest.mark.parametrize("keywords", KEYWORDS)
@pytest.mark.parametrize("on_target", ["nothing", "finish", "restart"])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_equal_to_the_environment(mode, on_target, keywords):
    keywords = SMALL | keywords | {"on_target": on_target, "max_steps": 7 if on_target == "restart" else 40}
    envs, reference = AgentVectorEnv(3, autoreset_mode=mode, **keywords), Reference(3, mode, **keywords)
    observations, infos = envs.reset(seed=5)
    assert_observed(observations, infos, reference.reset(seed=5))
    rng, ends, disappeared = np.random.default_rng(0), 0, 0
    for _ in range(160):
        actions = rng.integers(0, envs.single_action_space.n, envs.num_envs)
        expected = reference.step(actions)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        assert rewards.dtype == np.float64
        assert rewards.tolist() == [row["reward"] for row in expected]
        assert list(zip(terminated, truncated, strict=True)) == [row["ended"] for row in expected]
        assert_observed(observations, infos, expected)
        over = [row.get("metrics") is not None for row in expected]
        found = infos.get("final_info", {}) if mode == "SameStep" else infos
        assert ("is_success" in found) == any(over)
        assert any(over) <= (METRICS[on_target] <= found.keys())
        for i, row in enumerate(expected):
            for name, value in (row.get("metrics") or {}).items():
                assert found[f"_{name}"][i]
                np.testing.assert_equal(found[name][i], value)
            if "final" in row:
                assert same(infos["final_obs"][i], row["final"])
                assert infos["_final_obs"][i]
                assert infos["_final_info"][i]
                assert row["final_mask"] is None or found["action_mask"][i].tolist() == row["final_mask"]
        if "final_obs" in infos:
            assert [final is not None for final in infos["final_obs"]] == ["final" in row for row in expected]
        ends += sum(over)
        disappeared += (~infos["active"]).sum()
    assert ends >= 9
    assert (disappeared > 0) == (on_target == "finish" or mode == "NextStep")
    assert_observed(*envs.reset(seed=3), reference.reset(seed=3))
    assert_observed(*envs.reset(), reference.reset(seed=None))


class OneAgent(gymnasium.Env):
    """The only agent of a `MapfEnv`."""

    def __init__(self):
        self.env = mapf_pz.parallel_env(**SMALL | {"num_agents": 1})
        self.observation_space, self.action_space = (
            self.env.observation_space("agent_0"),
            self.env.action_space("agent_0"),
        )

    def reset(self, *, seed=None, options=None):
        observations, infos = self.env.reset(seed=seed)
        return observations["agent_0"], {"action_mask": infos["agent_0"]["action_mask"]}

    def step(self, action):
        seen, rewards, terminated, truncated, infos = (one["agent_0"] for one in self.env.step({"agent_0": action}))
        info = {"action_mask": infos["action_mask"]}
        if terminated or truncated:
            info |= self.env.metrics() | {"is_success": terminated}
        return seen, rewards, terminated, truncated, info


def without_activity(infos):
    return {name: one for name, one in infos.items() if name not in ("active", "_active")}


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_one_agent_is_a_vector_environment_of_gymnasium(mode):
    ours = AgentVectorEnv(4, autoreset_mode=mode, **SMALL | {"num_agents": 1})
    theirs = SyncVectorEnv([OneAgent] * 4, autoreset_mode=mode)
    assert ours.num_envs == theirs.num_envs
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    for name in ("single_observation_space", "observation_space", "single_action_space", "action_space"):
        assert getattr(ours, name) == getattr(theirs, name)
    mine, other = ours.reset(seed=5), theirs.reset(seed=5)
    np.testing.assert_array_equal(mine[0], other[0])
    ours.action_space.seed(0)
    for _ in range(40):
        actions = ours.action_space.sample()
        (*mine, my_infos), (*other, other_infos) = ours.step(actions), theirs.step(actions)
        for part, expected in zip(mine, other, strict=True):
            np.testing.assert_array_equal(part, expected)
            assert part.dtype == expected.dtype
        found = without_activity(my_infos)
        assert found.keys() == other_infos.keys()
        assert ours.observation_space.contains(mine[0])
        if "final_obs" in found:
            for one, expected in zip(found["final_obs"], other_infos["final_obs"], strict=True):
                np.testing.assert_array_equal(one, expected)
            found, other_infos = found["final_info"], other_infos["final_info"]
            assert found.keys() == other_infos.keys()
        for name in found.keys() - {"final_obs", "final_info"}:
            if not name.startswith("_"):
                mask = found[f"_{name}"]
                np.testing.assert_array_equal(mask, other_infos[f"_{name}"])
                np.testing.assert_array_equal(found[name][mask], other_infos[name][mask])


def test_agents_that_have_disappeared_are_padded():
    """In a corridor, the left agent arrives in the first step, and the right one in the second."""
    corridor = mapf_pz.Grid(np.ones((1, 6), np.bool_))
    scenario = mapf_pz.Scenario(np.array([[0, 0], [0, 3]]), np.array([[0, 1], [0, 5]]))
    envs = AgentVectorEnv(
        1, map=corridor, scenario=scenario, action_model="cardinal", on_target="finish", max_steps=5, view_size=(3, 3)
    )
    envs.reset(seed=0)
    east = np.full(2, mapf_pz.CardinalAction.RIGHT)
    steps = [envs.step(east) for _ in range(3)]
    assert [step[2].tolist() for step in steps] == [[True, False], [False, True], [False, False]]
    assert [step[3].tolist() for step in steps] == [[False, False], [True, False], [False, False]]
    assert [step[4]["active"].tolist() for step in steps] == [[False, True], [False, False], [True, True]]
    assert steps[0][0][0].any()
    assert not steps[1][0][0].any()
    assert (steps[1][1][0], steps[2][1].tolist()) == (0, [0, 0])
    assert steps[1][4]["CSR"].tolist() == [1, 1]


def test_make_vec():
    envs = gymnasium.make_vec("mapf_pz:Mapf-Agents-v0", num_envs=3, num_threads=2, autoreset_mode="SameStep", **SMALL)
    assert isinstance(envs.unwrapped, AgentVectorEnv)
    observations, infos = envs.reset(seed=0)
    assert observations.shape == (3 * 3, 7, 3, 3)
    assert infos["action_mask"].shape == (3 * 3, 4)
    assert envs.observation_space.contains(observations)
    envs.close()
    with pytest.raises(ValueError, match=r"use gymnasium\.make_vec instead"):
        gymnasium.make("mapf_pz:Mapf-Agents-v0", **SMALL)


def test_wrappers_of_gymnasium():
    envs = RecordEpisodeStatistics(AgentVectorEnv(2, **SMALL))
    observations, _ = envs.reset(seed=0)
    found = []
    for _ in range(8):
        observations, _, _, truncated, infos = envs.step(np.full(6, mapf_pz.Action.WAIT))
        found += infos["episode"]["l"].tolist() if truncated.any() else []
    assert found == [7] * 6
    assert envs.observation_space.contains(observations)


def test_seeds_by_environment():
    envs = AgentVectorEnv(2, **SMALL)
    first = envs.reset(seed=4)[0]
    np.testing.assert_array_equal(envs.reset(seed=[4, 5])[0], first)
    np.testing.assert_array_equal(envs.reset(seed=[5, 4])[0], np.concatenate([first[3:], first[:3]]))
    envs.reset(seed=[4, None])
    with pytest.raises(ValueError, match=r"seed: expected 2 seeds, got 6"):
        envs.reset(seed=[1] * 6)
    with pytest.raises(ValueError, match=r"options=\{'a': 1\}: expected none"):
        envs.reset(options={"a": 1})


def test_observations_are_never_reused():
    envs = AgentVectorEnv(2, **SMALL)
    first, infos = envs.reset(seed=0)
    kept = first.copy(), infos["action_mask"].copy()
    envs.action_space.seed(0)
    for _ in range(3):
        envs.step(envs.action_space.sample())
    np.testing.assert_array_equal(first, kept[0])
    np.testing.assert_array_equal(infos["action_mask"], kept[1])


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ([0] * 5, r"actions: expected integers of shape \(6,\), got int64 of shape \(5,\)"),
        ([0.0] * 6, r"actions: expected integers of shape \(6,\), got float64 of shape \(6,\)"),
        ([0, 1, 2, 3, 4, 0], "actions: expected numbers from 0 to 3, got 0 to 4"),
        ([0, 1, 2, 3, -1, 0], "actions: expected numbers from 0 to 3, got -1 to 3"),
    ],
)
def test_wrong_actions(actions, message):
    envs = AgentVectorEnv(2, **SMALL)
    with pytest.raises(RuntimeError, match="call reset"):
        envs.step(actions)
    envs.reset()
    with pytest.raises(ValueError, match=message):
        envs.step(actions)
    envs.step(np.array([0, 1, 2, 3, 0, 0], np.uint8))


@pytest.mark.parametrize("mode", ["Disabled", AutoresetMode.DISABLED, "later"])
def test_wrong_autoreset_modes(mode):
    with pytest.raises(ValueError, match=r"autoreset_mode=.*: expected one of 'NextStep', 'SameStep'"):
        AgentVectorEnv(2, autoreset_mode=mode, **SMALL)


@pytest.mark.parametrize(("action_model", "delays"), [("rotate", None), ("cardinal", None), ("rotate", "0.4:1-2")])
def test_images_are_those_of_the_environments(action_model, delays):
    settings = {"num_agents": 3, "max_steps": 7, "source": RandomObstacles(4, 5, 0.2, 3), "action_model": action_model}
    settings |= {"render_mode": "rgb_array", "on_target": "finish", "delays": delays}
    envs, single = AgentVectorEnv(2, **settings), [mapf_pz.parallel_env(**settings) for _ in range(2)]
    rng = np.random.default_rng(0)
    envs.reset(seed=3)
    for b, env in enumerate(single):
        env.reset(seed=3 + b)
    for _ in range(5):
        for images, env in zip(np.array(envs.render()).reshape(2, 3, *envs.render()[0].shape), single, strict=True):
            for image in images:
                np.testing.assert_array_equal(image, env.render())
        actions = rng.integers(envs.single_action_space.n, size=(2, 3))
        envs.step(actions.ravel())
        for row, env in zip(actions.tolist(), single, strict=True):
            env.step(
                {agent: action for agent, action in zip(env.possible_agents, row, strict=True) if agent in env.agents}
            )


def test_render_modes_of_several_environments():
    assert AgentVectorEnv(2, **SMALL).render() is None
    with pytest.raises(ValueError, match="render_mode='human': expected None or 'rgb_array'"):
        AgentVectorEnv(2, render_mode="human", **SMALL)
