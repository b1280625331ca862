import json
import subprocess
import sys

import numpy as np
import pytest

import mapf_pz
from mapf_pz.evaluation.pogema.pogema import InPogema
from mapf_pz.evaluation.pogema.served_policy import replies
from mapf_pz.instances import RandomObstacles

RULES = {"collision_system": "soft", "on_target": "nothing", "max_steps": 40}


def requests(env, seed, act):
    """Yield the requests of an episode, in which `act` takes the actions, and the actions that were taken."""
    env.reset(seed=seed)
    first = {"map": ["".join("#."[cell] for cell in row) for row in env.grid.astype(int)]}
    while env.agents:
        actions = act(first | {"positions": env.positions.tolist(), "goals": env.goals.tolist()})
        first = {}
        env.step(dict(zip(env.agents, actions, strict=True)))


@pytest.mark.slow
def test_a_served_planner_solves_episodes_in_another_process():
    env = mapf_pz.parallel_env(source=RandomObstacles(9, 8, 0.15, 6), action_model="cardinal", **RULES)
    words = ["--collision-system", "soft", "--on-target", "nothing", "--max-steps", "40"]
    command = [sys.executable, "-m", "mapf_pz", "serve", "pibt", *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:

        def act(request):
            print(json.dumps(request), file=server.stdin, flush=True)
            return json.loads(server.stdout.readline())["actions"]

        for seed in range(3):
            requests(env, seed, act)
            assert env.metrics()["CSR"] == 1
        server.stdin.close()
        assert server.wait() == 0


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("{", "request 1:1:2: expected JSON: Expecting property name enclosed in double quotes"),
        ("[]", "request 1:1: expected a JSON object, got []"),
        ('{"positions": [[0, 0]]}', "expected a map in the first request"),
        ('{"map": ["..", "."]}', "map: expected a list of strings of the same length"),
        ('{"map": ["", ""]}', "map: expected a list of strings of the same length"),
        ('{"map": [".."]}', "request 1: expected 'positions' to be a list, got None"),
        (
            '{"map": [".."], "positions": [[0, 0]], "goals": [[0]]}',
            "request 1: expected 'goals' to be a list of [row, col]",
        ),
        ('{"map": [".."], "positions": [[0, 0]], "goals": [[3, 0]]}', "agent 0: goal [row 3, col 0] is outside of map"),
    ],
)
def test_errors_are_replies_and_the_next_episode_is_served(line, error):
    policy = InPogema("pibt", **RULES)
    good = '{"map": ["..."], "positions": [[0, 0]], "goals": [[0, 2]]}'
    first, second, third = map(json.loads, replies(policy, [line, good, '{"positions": [[0, 1]], "goals": [[0, 2]]}']))
    assert error in first["error"]
    assert "\n" not in first["error"]
    assert (second, third) == ({"actions": [4]}, {"actions": [4]})


def test_a_step_that_was_not_taken_is_reported():
    policy = InPogema("pibt", **RULES)
    good = {"map": ["..."], "positions": [[0, 0]], "goals": [[0, 2]]}
    _, second = map(
        json.loads, replies(policy, [json.dumps(good), json.dumps({**good, "positions": [[0, 0]], "map": good["map"]})])
    )
    assert second == {"actions": [4]}  # a map begins an episode
    del good["map"]
    *_, last = map(json.loads, replies(policy, [json.dumps({**good, "map": ["..."]}), json.dumps(good)]))
    assert "the position of agent 0 is [0, 0] in POGEMA, but [0, 1]" in last["error"]
    assert np.array_equal(good["positions"], [[0, 0]])
