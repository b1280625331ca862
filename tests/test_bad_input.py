"""Bad input raises an error with a clear one-line message."""

import pickle
import re

import numpy as np
import pytest

import mapf_pz
from mapf_pz import Action, FormatError, Grid, GuidanceGraph, Instance, RewardConfig, Scenario
from mapf_pz.instances import FixedMap, FixedScenario, RandomObstacles, write_map, write_scenario
from mapf_pz.wrappers import AgentVectorEnv, ContinuousActions, FlatObservations, MaskedObservations, RecordEpisode

FREE = np.ones((3, 4), np.bool_)
GRID = Grid(FREE, "tiny")
WALL = np.array([[True, False, True]] * 3)
TOO_LARGE = "observations of 1 x 2 agents, \\d+ bytes each: expected at most 4294967296 bytes together,"
SMALL = {"map": FREE, "num_agents": 2, "view_size": (2, 2)}


def refuses(error, message, make):
    """Check that `make()` raises `error` with a message of one line that matches `message`, to its end."""
    with pytest.raises(error) as caught:
        make()
    text = str(caught.value)
    assert type(caught.value) is error
    assert "\n" not in text
    assert re.fullmatch(message, text), text


# Keywords.


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"num_agent": 3}, TypeError, "unknown keyword 'num_agent': did you mean 'num_agents'\\?"),
        ({"view_sise": (3, 3)}, TypeError, "unknown keyword 'view_sise': did you mean 'view_size'\\?"),
        ({"obs_radius": 2}, TypeError, "unknown keyword 'obs_radius': expected view_size=.* and view='centered'"),
        ({"density": 0.2}, TypeError, "unknown keyword 'density': expected source=RandomObstacles\\(.*density.*\\)"),
        ({"seed": 1}, TypeError, "unknown keyword 'seed': expected reset\\(seed=\\.\\.\\.\\)"),
        ({"zzz": 1}, TypeError, "unknown keyword 'zzz': expected one of map, scenario, .*render_mode"),
        ({"num_agents": 0}, ValueError, "num_agents=0: expected a whole number, 1 or more"),
        ({"distance_bytes": 0}, ValueError, "distance_bytes=0: expected a whole number, 1 or more"),
        ({"num_agents": 2.5}, ValueError, "num_agents=2.5: expected a whole number"),
        ({"max_steps": -1}, ValueError, "max_steps=-1: expected a whole number, 1 or more"),
        ({"num_last_actions": 0}, ValueError, "num_last_actions=0: expected a whole number, 1 or more"),
        ({"num_neighbors": -1}, ValueError, "num_neighbors=-1: expected a whole number, 0 or more"),
        ({"action_model": "fly"}, ValueError, "action_model='fly': expected one of 'rotate', 'cardinal'"),
        (
            {"collision_system": "hard"},
            ValueError,
            "collision_system='hard': expected one of 'soft', 'priority', 'block_both'",
        ),
        ({"on_target": None}, ValueError, "on_target=None: expected one of 'nothing', 'finish', 'restart'"),
        ({"view": "back"}, ValueError, "view='back': expected one of 'front', 'centered'"),
        ({"frame": "map"}, ValueError, "frame='map': allowed only with view='centered'"),
        ({"action_model": "cardinal", "view": "front"}, ValueError, "action_model='cardinal': agents have no front.*"),
        ({"render_mode": "screen"}, ValueError, "render_mode='screen': expected one of 'human', 'rgb_array'.*"),
        ({"reward": "rich"}, ValueError, "reward='rich': expected one of 'report', 'progress', or package.module:name"),
        ({"reward": 3}, ValueError, "reward=3: expected a name, a RewardConfig or a function"),
        ({"edge_weights": "heavy"}, ValueError, "edge_weights='heavy': expected one of 'uniform', .*"),
        (
            {"edge_weights": 1.5},
            ValueError,
            "edge_weights=1.5: expected a name, the path of a file, or a GuidanceGraph",
        ),
        ({"max_steps": 2**31}, ValueError, "max_steps=2147483648: expected at most 1073741824"),
        ({"max_steps": 10**30}, ValueError, "max_steps=1000000000000000000000000000000: expected at most 1073741824"),
        ({"num_frames": 10**30}, ValueError, "num_frames=.*: expected at most 1073741824"),
        ({"distance_bytes": 10**30}, ValueError, "distance_bytes=.*: expected at most 4611686018427387904"),
        ({"view_size": (10**30, 1)}, ValueError, "view_size=.*: expected \\(height, width\\), each .* 1 to 511"),
        ({"view_size": 5}, ValueError, "view_size=5: expected \\(height, width\\), each .* 1 to 511"),
        ({"view_size": (0, 2)}, ValueError, "view_size=\\(0, 2\\): expected \\(height, width\\), each .* 1 to 511"),
        ({"view_size": (512, 5)}, ValueError, "view_size=\\(512, 5\\): expected \\(height, width\\), each .* 1 to 511"),
        ({"num_last_actions": 2**30}, ValueError, f"{TOO_LARGE} got .*"),
        ({"num_frames": 2**30}, ValueError, f"{TOO_LARGE} got .*"),
        ({"num_neighbors": 2**30}, ValueError, f"{TOO_LARGE} got .*"),
        ({"features": ("last_actions",), "num_last_actions": 2**30}, ValueError, f"{TOO_LARGE} got .*"),
        ({"channels": ("views",)}, ValueError, "channels: unknown 'views', did you mean 'view'\\?"),
        ({"channels": "view"}, ValueError, "channels='view': expected a tuple or list of different names"),
        ({"channels": 5}, ValueError, "channels=5: expected a tuple or list of different names"),
        ({"channels": ()}, ValueError, "channels: expected at least one of view, goal, .*"),
        ({"channels": ("view", "view")}, ValueError, "channels=.*: expected a tuple or list of different names"),
        (
            {"edge_weights": np.ones((4, 3, 4))},
            ValueError,
            "edge_weights=array.{,30}: expected a name, the path of a file, or a GuidanceGraph",
        ),
        ({"features": ("speed",)}, ValueError, "features: unknown 'speed', expected one of goal_vector, .*"),
        (
            {"initial_heading": "up"},
            ValueError,
            "initial_heading='up': expected 'random', 'east', or N numbers 0 to 3",
        ),
        (
            {"initial_heading": [0, 1, 2]},
            ValueError,
            "initial_heading: expected 'random', 'east' or 2 numbers 0 to 3",
        ),
        (
            {"initial_heading": [0, 4]},
            ValueError,
            "initial_heading=\\[0, 4\\]: expected 'random', 'east', or N numbers 0 to 3",
        ),
        (
            {"edge_weights": GuidanceGraph.uniform(np.ones((4, 3), np.bool_))},
            ValueError,
            "edge_weights of shape \\(4, 3\\): the map's shape is \\(3, 4\\)",
        ),
    ],
)
def test_keywords(keywords, error, message):
    refuses(error, message, lambda: mapf_pz.parallel_env(**SMALL | keywords))


def test_a_negative_radius():
    refuses(ValueError, "share_radius=-1: expected a whole number, 0 or more", lambda: RewardConfig(share_radius=-1))


@pytest.mark.parametrize(
    ("move", "wait", "message"),
    [
        (np.ones((3, 2, 2)), np.ones((2, 2)), "guidance graph: expected move \\(4, H, W\\) and wait .*"),
        (np.ones((4, 2, 3)), np.ones((2, 2)), "guidance graph: expected move \\(4, H, W\\) and wait .*"),
        (np.zeros((4, 2, 2)), np.ones((2, 2)), "guidance graph: expected weights greater than 0, .*"),
        (np.ones((4, 2, 2)), np.full((2, 2), np.inf), "guidance graph: expected weights greater than 0, .*"),
        (np.full((4, 2, 2), np.nan), np.ones((2, 2)), "guidance graph: expected weights greater than 0, .*"),
    ],
)
def test_guidance_graphs(move, wait, message):
    refuses(ValueError, message, lambda: GuidanceGraph(move, wait))


# Maps and scenarios.


def test_an_unknown_map(tmp_path):
    refuses(
        ValueError,
        "no \\.map file is named 'empty-8-9': did you mean 'empty-8-8'.*",
        lambda: mapf_pz.parallel_env(map="empty-8-9"),
    )
    with pytest.raises(FileNotFoundError, match=r"nowhere\.map") as caught:
        mapf_pz.parallel_env(map=tmp_path / "nowhere.map")
    assert "\n" not in str(caught.value)


def test_a_truncated_map_file(tmp_path):
    file = tmp_path / "short.map"
    write_map(GRID, file)
    file.write_text(file.read_text()[:-5])
    refuses(FormatError, re.escape(f"{file}:7: expected 3 rows, got 2"), lambda: mapf_pz.parallel_env(map=file))
    file.write_text("type octile\nheight 3\nwid")
    refuses(
        FormatError,
        re.escape(f"{file}:3:1: expected 'width' and a number, got 'wid'"),
        lambda: mapf_pz.parallel_env(map=file),
    )


def test_a_map_of_numbers():
    refuses(
        TypeError,
        "map: expected a name, .* or a bool array with True for free, got list of int64",
        lambda: mapf_pz.parallel_env(map=[[0, 1], [0, 0]]),
    )


def test_more_agents_than_free_cells():
    refuses(
        ValueError,
        "13 agents do not fit on the 12 cells of the map's largest component",
        lambda: mapf_pz.parallel_env(**SMALL | {"num_agents": 13}),
    )
    refuses(
        ValueError,
        "4 agents do not fit on the 3 cells of the map's largest component",
        lambda: mapf_pz.parallel_env(**SMALL | {"map": WALL, "num_agents": 4}),
    )


def test_more_agents_than_the_scenario_has():
    scenario = Scenario([(0, 0)], [(1, 1)])
    refuses(
        ValueError,
        "num_agents=2: the scenario has 1 agents",
        lambda: mapf_pz.parallel_env(**SMALL | {"scenario": scenario}),
    )


def test_a_scenario_of_another_map(tmp_path):
    file = tmp_path / "other.scen"
    write_scenario(Scenario([(0, 0), (1, 1)], [(1, 1), (0, 0)]), Grid(np.ones((2, 2), np.bool_), "other"), file)
    refuses(
        FormatError,
        f"{re.escape(str(file))}:2:13: expected the size of map 'custom', width 4 and height 3, got 2 and 2",
        lambda: mapf_pz.parallel_env(**SMALL | {"scenario": file}),
    )
    refuses(
        ValueError,
        "agent 1: goal \\[row 5, col 5\\] is outside of map 'custom' \\(3 x 4\\)",
        lambda: mapf_pz.parallel_env(**SMALL | {"scenario": Scenario([(0, 0), (0, 1)], [(0, 1), (5, 5)])}),
    )


def test_a_start_on_an_obstacle():
    refuses(
        ValueError,
        "agent 1: start \\[row 2, col 1\\] is an obstacle of map 'custom' \\(3 x 3\\)",
        lambda: mapf_pz.parallel_env(**SMALL | {"map": WALL, "scenario": Scenario([(0, 0), (2, 1)], [(1, 0), (2, 0)])}),
    )


def test_two_agents_on_one_start():
    refuses(
        ValueError,
        "agent 1: start \\[row 0, col 0\\] is also another agent's start",
        lambda: mapf_pz.parallel_env(**SMALL | {"scenario": Scenario([(0, 0), (0, 0)], [(1, 0), (2, 0)])}),
    )


NO_PATH = "agent 1: no path on map '\\w+' leads from its start \\[row 1, col 0\\] to its goal \\[row 2, col 2\\]"


def test_a_goal_that_cannot_be_reached():
    scenario = Scenario([(0, 0), (1, 0)], [(2, 0), (2, 2)])
    walled = SMALL | {"map": WALL, "view_size": (2, 2)}
    refuses(ValueError, NO_PATH, lambda: mapf_pz.parallel_env(**walled | {"scenario": scenario}))
    refuses(ValueError, NO_PATH, lambda: FixedScenario(Grid(WALL), scenario, 2))
    env = mapf_pz.parallel_env(**walled)
    refuses(ValueError, NO_PATH, lambda: env.reset(options={"instance": scenario}))
    refuses(ValueError, NO_PATH, lambda: env.reset(options={"instance": Instance(Grid(WALL, "walled"), scenario)}))


def test_a_later_goal_that_cannot_be_reached():
    scenario = Scenario([(0, 0), (1, 0)], [[(2, 0), (1, 0)], [(2, 0), (2, 2)]])
    env = mapf_pz.parallel_env(**SMALL | {"map": WALL, "on_target": "restart"})
    refuses(ValueError, NO_PATH, lambda: env.reset(options={"instance": scenario}))


def test_goals_that_are_not_used_may_be_anywhere():
    scenario = Scenario([(0, 0), (1, 0)], [(2, 0), (2, 2)])
    env = mapf_pz.parallel_env(**SMALL | {"map": WALL, "num_agents": 1, "scenario": scenario})
    env.reset()
    assert env.goals.tolist() == [[2, 0]]


@pytest.mark.parametrize(
    ("starts", "goals", "message"),
    [
        ([0, 1], [0, 1], "scenario starts: expected the shape \\(M, 2\\), got \\(2,\\)"),
        ([(0, 0)] * 2, [[(0, 1)], [(0, 2), (0, 1)]], "scenario goals: expected whole numbers .*"),
        (["a"], [(0, 0)], "scenario starts: expected whole numbers .*"),
        ([(0, 0)], [(0, 1), (0, 2)], "scenario goals: expected the shape \\(1, 2\\) or \\(1, L, 2\\), got \\(2, 2\\)"),
    ],
)
def test_scenario_shapes(starts, goals, message):
    refuses(ValueError, message, lambda: Scenario(starts, goals))


def test_instance_headings():
    refuses(
        ValueError,
        "headings: expected 1 numbers 0 to 3, got .*",
        lambda: Instance(GRID, Scenario([(0, 0)], [(0, 1)]), [4]),
    )


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"num_agents": 5}, ValueError, "num_agents=5: the source has 8 agents"),
        ({"map": "empty-8-8"}, ValueError, "map: not allowed together with source, .*"),
        ({"scenario": Scenario([(0, 0)], [(1, 1)])}, ValueError, "scenario: not allowed together with source, .*"),
        ({"source": 1}, TypeError, "source=1: expected an InstanceSource, such as RandomObstacles or FixedMap"),
    ],
    ids=str,
)
def test_keywords_that_contradict_the_source(keywords, error, message):
    source = RandomObstacles(16, 16, 0.2, 8)
    refuses(error, message, lambda: mapf_pz.parallel_env(**{"source": source} | keywords))
    assert len(mapf_pz.parallel_env(source=source, num_agents=8).possible_agents) == 8


def test_sources():
    refuses(ValueError, ".* expected 1 or more", lambda: FixedMap(GRID, 0))
    refuses(ValueError, "30 agents fit on none of 100 maps: .*", lambda: RandomObstacles(5, 5, 0.2, 30))


# reset().


@pytest.mark.parametrize(
    ("instance", "error", "message"),
    [
        ("empty-8-8", TypeError, "options\\['instance'\\]: expected an Instance or a Scenario, got str"),
        (
            Scenario([(0, 0)], [(0, 1)]),
            ValueError,
            "instance of 1 agents on \\(3, 4\\) cells: this environment has 2 agents on \\(3, 4\\) cells",
        ),
        (
            Instance(Grid(np.ones((2, 2), np.bool_)), Scenario([(0, 0), (0, 1)], [(0, 1), (0, 0)])),
            ValueError,
            "instance of 2 agents on \\(2, 2\\) cells: this environment has 2 agents on \\(3, 4\\) cells",
        ),
    ],
)
def test_reset_to_something_else(instance, error, message):
    env = mapf_pz.parallel_env(**SMALL)
    refuses(error, message, lambda: env.reset(options={"instance": instance}))


def test_a_failed_reset_leaves_no_episode():
    env = mapf_pz.parallel_env(**SMALL)
    env.reset(seed=0)
    refuses(
        ValueError, "instance of 1 agents .*", lambda: env.reset(options={"instance": Scenario([(0, 0)], [(0, 1)])})
    )
    assert env.agents == []
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 0))


# step().


@pytest.mark.parametrize(
    ("action", "shown"),
    [
        (4, "4"),
        (-1, "-1"),
        (2**70, str(2**70)),
        (0.5, "0.5"),
        (None, "None"),
        ("0", "'0'"),
        (np.float32(1), ".*"),
        (np.array([1]), "array\\(\\[1\\]\\)"),
        ([0], "\\[0\\]"),
    ],
)
def test_impossible_actions(action, shown):
    env = mapf_pz.parallel_env(**SMALL)
    env.reset(seed=0)
    before = env.state()
    refuses(
        ValueError,
        f"action {shown} of 'agent_1': expected a whole number from 0 to 3",
        lambda: env.step({"agent_0": 0, "agent_1": action}),
    )
    assert np.array_equal(env.state(), before), "a refused step changed something"
    assert env.step_count == 0


@pytest.mark.parametrize("space", ["observation_space", "action_space"])
def test_spaces_of_an_unknown_agent(space):
    env = mapf_pz.parallel_env(**SMALL)
    refuses(ValueError, "unknown agent 'agent_9': expected agent_0 to agent_1", lambda: getattr(env, space)("agent_9"))


def test_actions_of_the_wrong_agents():
    env = mapf_pz.parallel_env(**SMALL)
    env.reset(seed=0)
    refuses(
        ValueError,
        "action for an unknown agent 'agent_2': expected names from possible_agents",
        lambda: env.step(dict.fromkeys([*env.agents, "agent_2"], 0)),
    )
    refuses(ValueError, "action for an unknown agent 0: expected names from possible_agents", lambda: env.step({0: 1}))
    refuses(
        ValueError,
        "no action for 'agent_1': expected one for each active agent",
        lambda: env.step({"agent_0": 0}),
    )


@pytest.mark.parametrize("read", ["step", "render", "grid", "metrics", "state"])
def test_before_reset(read):
    env = mapf_pz.parallel_env(**SMALL, render_mode="ansi")
    doings = {
        "step": lambda: env.step({}),
        "render": env.render,
        "grid": lambda: env.grid,
        "metrics": env.metrics,
        "state": env.state,
    }
    refuses(RuntimeError, rf"call reset\(\) (before {read}\(\)|first)", doings[read])


def test_options():
    env = mapf_pz.parallel_env(**SMALL)
    for options in ("x", 1, ["instance"]):
        got = type(options).__name__
        refuses(TypeError, f"options: expected a dictionary, got {got}", lambda given=options: env.reset(options=given))
    scenario = Scenario([(0, 0), (1, 0)], [(2, 0), (2, 2)])
    refuses(
        ValueError,
        "options: expected the Scenario as 'instance', got 'instanse'",
        lambda: env.reset(options={"instanse": scenario}),
    )
    refuses(
        TypeError,
        r"options\['instance'\]: expected an Instance or a Scenario, got str",
        lambda: env.reset(options={"instance": "x"}),
    )
    for options in (None, {}, {"instance": None}, {"options": 1}):
        env.reset(options=options)


@pytest.mark.parametrize("seed", ["a", 1.5, -1, True])
def test_seeds(seed):
    env = mapf_pz.parallel_env(**SMALL)
    for one in (env, ContinuousActions(env), AgentVectorEnv(1, **SMALL)):
        refuses(
            ValueError, f"seed={seed!r}: expected a whole number, 0 or more.*", lambda env=one: env.reset(seed=seed)
        )
        one.reset(seed=np.int64(3))
        one.reset(seed=2**128 - 2)
    refuses(
        ValueError,
        "seed=.*: expected a whole number, 0 or more",
        lambda: AgentVectorEnv(2, **SMALL).reset(seed=[0, seed]),
    )


@pytest.mark.parametrize("actions", [[0, 0], None, np.zeros(2), 3])
def test_actions_that_are_no_dictionary(actions):
    env = mapf_pz.parallel_env(**SMALL)
    expected = f"actions: expected a dictionary with an action for each agent, got {type(actions).__name__}"
    for one in (env, ContinuousActions(env), RecordEpisode(env), FlatObservations(env), MaskedObservations(env)):
        one.reset(seed=0)
        refuses(TypeError, expected, lambda env=one: env.step(actions))


def test_a_step_after_the_end():
    env = mapf_pz.parallel_env(**SMALL, max_steps=1)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, int(Action.WAIT)))
    for actions in ({}, {"agent_0": 0, "agent_1": 0}):
        refuses(RuntimeError, "the episode is over, call reset\\(\\)", lambda actions=actions: env.step(actions))
    env.reset()
    env.step(dict.fromkeys(env.agents, int(Action.WAIT)))


def test_initial_headings_are_counted_against_the_source():
    source = RandomObstacles(5, 5, 0.0, num_agents=3)
    env = mapf_pz.parallel_env(source=source, view_size=(3, 3), initial_heading=[2, 1, 0])
    env.reset(seed=0)
    assert env.headings.tolist() == [2, 1, 0]
    with pytest.raises(ValueError, match="'east' or 3 numbers 0 to 3"):
        mapf_pz.parallel_env(source=source, view_size=(3, 3), initial_heading=[0, 0, 0, 0])


def test_format_errors_pass_between_processes():
    error = pickle.loads(pickle.dumps(FormatError("a.map", "expected rows", 3, 1)))
    assert (type(error), str(error)) == (FormatError, "a.map:3:1: expected rows")


def test_format_errors_are_cut():
    assert str(FormatError("a.map", "x" * 500, 3)) == "a.map:3: " + "x" * 500
    assert str(FormatError("a.map", "x" * 501, 3)) == "a.map:3: " + "x" * 500 + " ..."


@pytest.mark.parametrize("name", ["action_model", "collision_system", "on_target", "view", "frame", "render_mode"])
def test_names_that_are_no_text(name):
    refuses(ValueError, rf"{name}=\[\]: expected one of .*", lambda: mapf_pz.parallel_env(**{name: []}))
