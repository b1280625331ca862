"""Planners and policies of users by name: `package.module:Class`."""

import pickle
import sys

import pytest

from mapf_pz.evaluation import EvaluationTask, evaluate, policy_factory, rollout, solver_of
from mapf_pz.instances import load_instance
from mapf_pz.planners import Shield, planner_of
from mapf_pz.planners.named import import_code

CODE = """
import numpy as np
from mapf_pz.planners import StepPlanner


class Greedy:
    env_kwargs = {"view_size": (1, 1), "features": ("action_advantage",)}
    identity = "greedy, version 1"

    def act(self, observations):
        return {agent: int(seen["features"].argmax()) for agent, seen in observations.items()}

    def preferences(self, observations):
        return {agent: seen["features"] for agent, seen in observations.items()}

    def reset_states(self):
        pass


class Blind(Greedy):
    identity = None
    preferences = None

    def __init__(self, env, seed, action=3):
        self.seen = env.unwrapped.simulator.num_agents, seed
        self.action = action

    def act(self, observations):
        return dict.fromkeys(observations, self.action)


class NoDefault(Greedy):
    def __init__(self, network):
        self.network = network


class Constant(StepPlanner):
    def __init__(self, env=None, seed=0, action=2):
        self.action = action
        super().__init__(env, seed)

    def decide(self, simulator, b=0):
        return np.full(simulator.num_agents, self.action)


ready = Greedy()
"""
ROOM = {"map": "empty-8-8", "num_agents": 3, "max_steps": 24, "initial_heading": "east"}
NAME = "own_policies"


@pytest.fixture
def module(tmp_path, monkeypatch):
    """The folder of a module that is not imported yet."""
    (tmp_path / f"{NAME}.py").write_text(CODE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop(NAME, None)


@pytest.fixture
def imported(module):
    import_code(f"{NAME}:Greedy")


def actions(name, keywords=ROOM, **arguments):
    """Return the actions of the first agent in three steps, and the policy."""
    env, policy = policy_factory(name, **arguments)(keywords)
    observations, _ = env.reset(seed=1)
    policy.reset_states()
    taken = []
    for _ in range(3):
        chosen = policy.act(observations)
        taken.append(chosen["agent_0"])
        observations = env.step(chosen)[0]
    return taken, policy


def test_a_class(imported):
    env, policy = policy_factory(f"{NAME}:Greedy")(ROOM)
    assert env.config.features == ("action_advantage",)
    result = rollout(env, policy, seed=1)
    assert result.metrics["ISR"] > 0


def test_a_class_gets_the_environment_the_seed_and_options(imported):
    taken, policy = actions(f"{NAME}:Blind", seed=5)
    assert (taken, policy.seen) == ([3, 3, 3], (3, 5))
    assert actions(f"{NAME}:Blind:action=1")[0] == [1, 1, 1]


def test_the_layer_executes_the_preferences_of_a_class(imported):
    _, policy = actions(f"{NAME}:Greedy+pibt:patience=0,depth=4")
    assert isinstance(policy, Shield)
    assert type(policy.policy).__name__ == "Greedy"


def test_an_object(imported):
    assert actions(f"{NAME}:ready")[0] == actions(f"{NAME}:Greedy")[0]


def test_a_planner(imported):
    assert actions(f"{NAME}:Constant:action=1")[0] == [1, 1, 1]
    plan = planner_of(f"{NAME}:Constant").solve(load_instance("empty-8-8", num_agents=3), partial=True, max_steps=5)
    assert plan.num_steps == 5


@pytest.mark.parametrize("kind", ["Greedy", "Greedy+pibt"])
def test_a_policy_solves_instances(imported, kind):
    plan = solver_of(f"{NAME}:{kind}").solve(load_instance("empty-8-8", num_agents=1))
    assert plan.num_steps > 0


def test_in_other_processes(imported):
    task = EvaluationTask("room", 3, ROOM, episodes=4)
    names = [f"{NAME}:Greedy", f"{NAME}:Constant"]
    first, second = (evaluate(names, [task], jobs=jobs) for jobs in (1, 2))
    assert [one.metrics["ISR"] for one in first] == [one.metrics["ISR"] for one in second]
    for name in names:
        assert pickle.loads(pickle.dumps(policy_factory(name))) == policy_factory(name)


@pytest.mark.parametrize("kind", ["Greedy", "Greedy+pibt:patience=1", "Constant"])
def test_results_are_reused_only_with_an_identity(imported, tmp_path, kind):
    name, task = f"{NAME}:{kind}", EvaluationTask("room", 3, ROOM, episodes=2)
    evaluate([name], [task], tmp_path / "results")
    if kind == "Constant":
        with pytest.raises(ValueError, match="identity"):
            evaluate([name], [task], tmp_path / "results")
    else:
        pending = []
        evaluate([name], [task], tmp_path / "results", show=lambda _, left: pending.append(left))
        assert pending == [0]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (f"{NAME}:Greedy:depth=2", r"^option 'depth=2': Greedy has no options$"),
        (f"{NAME}:Blind:patience=2", r"^option 'patience=2': Blind has the options action$"),
        (f"{NAME}:NoDefault", r"^NoDefault: expected a default of its argument 'network'$"),
        (f"{NAME}:ready+pibt", r"^policy 'own_policies:ready\+pibt': expected a class before '\+pibt', got an object$"),
        (f"{NAME}:Missing", r"^policy 'own_policies:Missing': expected an object of a module that is imported"),
    ],
)
def test_names_that_are_refused(imported, name, told):
    with pytest.raises(ValueError, match=told):
        policy_factory(name)


def test_a_policy_without_preferences_has_no_layer(imported):
    with pytest.raises(ValueError, match=r"^policy 'own_policies:Blind\+pibt': expected a method preferences, which"):
        policy_factory(f"{NAME}:Blind+pibt")(ROOM)


def test_an_object_that_is_no_policy_is_refused(imported):
    with pytest.raises(TypeError, match="expected the methods act and reset_states, not found: act"):
        policy_factory(f"{NAME}:np")


def test_a_name_alone_imports_nothing(module):
    for make in (policy_factory, solver_of, planner_of):
        with pytest.raises(ValueError, match="of a module that is imported"):
            make(f"{NAME}:Greedy")
    assert NAME not in sys.modules
