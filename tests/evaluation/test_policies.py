import inspect
import re
import shutil
from dataclasses import replace
from importlib import resources

import pytest

from mapf_pz.evaluation import EvaluationTask, evaluate, policy_factory
from mapf_pz.evaluation.episodes import run_episodes
from mapf_pz.evaluation.policies import factory_for
from mapf_pz.instances import RandomObstacles
from mapf_pz.planners import EPIBT, PIBT, PLANNERS, LaCAM, Shield
from tests.evaluation.test_episodes import Right

ROOM = {"map": "empty-8-8", "num_agents": 2, "max_steps": 12}
CARDINAL = ROOM | {"action_model": "cardinal"}
TRAINED = [
    *("central", "central-ppo", "central-warehouse", "ippo", "lifelong", "lifelong-cardinal"),
    *("mappo", "mappo-cardinal", "oneshot", "oneshot-cardinal", "report-repaired"),
]


def actions(name, keywords=ROOM, steps=6, **arguments):
    env, policy = policy_factory(name, **arguments)(keywords)
    observations, _ = env.reset(seed=3)
    policy.reset_states()
    taken = []
    while env.agents and len(taken) < steps:
        taken.append(policy.act(observations))
        observations = env.step(taken[-1])[0]
    return taken


@pytest.mark.parametrize(("name", "kind"), [("pibt", PIBT), ("epibt:depth=2", EPIBT), ("lacam:time_limit=1", LaCAM)])
def test_planners(name, kind):
    env, policy = policy_factory(name)(ROOM)
    assert isinstance(policy, kind)
    assert (env.config.view_size, env.config.max_steps) == ((1, 1), 12)
    env, _ = policy_factory(name)(ROOM | {"view_size": (3, 3)})
    assert env.config.view_size == (3, 3)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("epibt", {"depth": 4, "time_limit": 0.0}),
        ("epibt:", {"depth": 4, "time_limit": 0.0}),
        ("epibt:depth=2", {"depth": 2, "time_limit": 0.0}),
        ("epibt: depth = 2, time_limit = 1e-3", {"depth": 2, "time_limit": 0.001}),
        ("lacam:anytime=False,time_limit=2", {"anytime": False, "time_limit": 2}),
    ],
)
def test_options(monkeypatch, name, expected):
    kind = PLANNERS[name.partition(":")[0]]
    got = []
    begin = kind.__init__

    def spy(self, env=None, seed=0, **options):
        got.append(options | {"seed": seed, "bound": env is not None})
        begin(self, env, seed, **options)

    # The signature is what options are checked against.
    spy.__signature__ = inspect.signature(begin)
    monkeypatch.setattr(kind, "__init__", spy)
    _, policy = policy_factory(name, seed=5)(ROOM)
    assert got[-1].pop("seed") == 5
    assert got[-1].pop("bound")
    assert got[-1].items() <= expected.items()
    assert {option: getattr(policy, f"_{option}") for option in expected} == expected


def test_a_planner_with_the_costs_of_a_guidance_graph():
    keywords = {"map": "....\n....", "num_agents": 2, "action_model": "cardinal"}
    own = policy_factory("epibt:edge_weights=crisscross,depth=3")
    env, planner = own(keywords | {"edge_weights": "uniform"})
    assert (env.config.edge_weights, planner._depth) == ("crisscross", 3)
    assert own.identity == {"policy": "epibt", "options": {"depth": 3, "edge_weights": "crisscross"}, "seed": 0}
    assert policy_factory("epibt:depth=3")(keywords)[0].config.edge_weights == "uniform"
    task = EvaluationTask("lifelong", 2, keywords | {"on_target": "restart", "max_steps": 32}, episodes=2)
    one = evaluate(["pibt:edge_weights=crisscross"], [task])
    other = evaluate(["pibt"], [replace(task, keywords=task.keywords | {"edge_weights": "crisscross"})])
    assert [e.metrics["avg_throughput"] for e in one] == [e.metrics["avg_throughput"] for e in other]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("pibt:edge_weights=cross", "edge_weights='cross': expected one of "),
        ("pibt:edge_weights=", "edge_weights='': expected one of "),
    ],
)
def test_wrong_guidance_graphs_of_planners(name, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        policy_factory(name)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("epibt:deep=5", "option 'deep=5': EPIBT has the options depth, time_limit, rounds, num_threads"),
        ("pibt:depth=5", "option 'depth=5': PIBT has the options priority, swap, preference"),
        ("pibt:priority=5", "priority='5': expected one of nearest, elapsed, late"),
        ("pibt:preference=", "preference='': expected one of random, hindrance"),
        ("pibt:swap=maybe", "option 'swap=maybe': expected a number, True or False"),
        ("epibt:seed=5", "option 'seed=5': EPIBT has the options depth, time_limit, rounds, num_threads"),
        ("epibt:depth", "option 'depth': expected a number, True or False"),
        ("epibt:depth=", "option 'depth=': expected a number, True or False"),
        ("windowed:rounds=1073741825", "option 'rounds=1073741825': expected -1073741824 to 1073741824"),
        ("epibt:time_limit=1e400", "option 'time_limit=1e400': expected -1073741824 to 1073741824"),
        ("epibt:depth=five", "option 'depth=five': expected a number, True or False"),
        ("epibt:depth='5'", "option \"depth='5'\": expected a number, True or False"),
        ("epibt:depth=[5]", "option 'depth=[5]': expected a number, True or False"),
        ("epibt:depth=None", "option 'depth=None': expected a number, True or False"),
        ("epibt:depth=9", "depth=9: expected a number of actions from 1 to 8"),
        ("mappo:patience=2", "option 'patience=2': mappo has the options temperature, decision_rounds"),
        (
            "mappo+pibt:swap=2",
            "option 'swap=2': mappo+pibt has the options temperature, decision_rounds, patience, depth",
        ),
        ("mappo+pibt:temperature=low", "option 'temperature=low': expected a number, True or False"),
    ],
)
def test_wrong_options(name, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        policy_factory(name)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        *(
            ("pibbt", "pibt"),
            ("mapo", "mappo"),
            ("mapo+pibt", "mappo"),
            ("mapo:temperature=0", "mappo"),
            ("PIBT", "pibt"),
        ),
        *((name, None) for name in ("no/such/run", "random:seed=1", "pibt+pibt", "+pibt")),
    ],
)
def test_unknown_names(name, near, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hint = f"did you mean {near!r}? " if near else ""
    expected = (
        f"policy {name!r}: {hint}expected random, a planner ({', '.join(PLANNERS)}), "
        f"a trained policy ({', '.join(TRAINED)}), the folder of a training run, or package.module:Class"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        policy_factory(name)


def test_the_trained_policies_are_those_that_can_be_loaded():
    pytest.importorskip("torch")
    from mapf_pz.rl import policy_names

    assert policy_names() == TRAINED


@pytest.mark.parametrize("keywords", [ROOM, CARDINAL], ids=["rotate", "cardinal"])
def test_random_takes_every_action(keywords):
    taken = actions("random", keywords | {"max_steps": 60}, steps=60)
    seen = {action for step in taken for action in step.values()}
    assert seen == set(range(4 if keywords is ROOM else 5))
    assert actions("random", keywords, seed=1) == actions("random", keywords, seed=1) != actions("random", keywords)


def test_a_trained_policy_has_its_own_observations_and_seed():
    pytest.importorskip("torch")
    assert actions("mappo") == actions("mappo") != actions("mappo", seed=1)
    sure = actions("mappo", deterministic=True)
    assert sure == actions("mappo", deterministic=True, seed=1)


def test_options_of_trained_policies():
    pytest.importorskip("torch")
    assert actions("mappo:temperature=0") == actions("mappo", deterministic=True)
    assert actions("mappo:temperature=1") == actions("mappo") == actions("mappo:")
    assert actions("mappo:temperature=30") != actions("mappo")
    assert actions("mappo:temperature=30", deterministic=True) == actions("mappo", deterministic=True)
    _, policy = policy_factory("mappo+pibt:patience=3,temperature=0.5,depth=4")(ROOM)
    assert isinstance(policy, Shield)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mappo:temperature=-1", "temperature=-1: expected a finite number, 0 or more"),
        ("mappo:temperature=1e999", "option 'temperature=1e999': expected -1073741824 to 1073741824"),
        ("mappo:decision_rounds=2", "decision_rounds=2: expected 1, as in the policy's training"),
        ("mappo:decision_rounds=0", "decision_rounds=0: expected a whole number, 1 or more"),
        ("mappo:decision_rounds=1.5", "decision_rounds=1.5: expected a whole number, 1 or more"),
        ("central-ppo:temperature=-1", "temperature=-1: expected a finite number, 0 or more"),
        ("mappo+pibt:patience=-1", "patience=-1: expected a whole number, 0 or more"),
        ("mappo+pibt:patience=1.5", "patience=1.5: expected a whole number, 0 or more"),
        ("mappo+pibt:depth=2", "depth=2: expected a number of actions from 3 to 8"),
        ("mappo+pibt:patience=1e999", "option 'patience=1e999': expected -1073741824 to 1073741824"),
    ],
)
def test_wrong_options_of_trained_policies(name, message):
    pytest.importorskip("torch")
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        policy_factory(name)(ROOM)


def test_the_name_of_a_folder_may_have_a_colon(tmp_path):
    pytest.importorskip("torch")
    folder = tmp_path / "a:b"
    shutil.copytree(resources.files("mapf_pz.rl.policies") / "bundled" / "mappo", folder)
    assert actions(str(folder)) == actions("mappo")
    assert actions(f"{folder}:temperature=0") == actions("mappo:temperature=0")
    assert actions(f"{folder}+pibt:temperature=0") == actions("mappo+pibt:temperature=0")


def test_a_trained_policy_under_pibt_never_collides():
    pytest.importorskip("torch")
    task = EvaluationTask("crowded", 24, {"source": RandomObstacles(8, 8, 0.1, 24), "max_steps": 16}, episodes=2)
    plain, shielded = (list(run_episodes(policy_factory(name), task, range(2))) for name in ("mappo", "mappo+pibt"))
    assert [episode["collisions"] for episode in shielded] == [0, 0]
    assert any(episode["collisions"] > 0 for episode in plain)


def test_actions_must_be_those_that_a_policy_was_trained_for():
    pytest.importorskip("torch")
    with pytest.raises(ValueError, match=r"^policy 'mappo' requires action_model='rotate', got 'cardinal'$"):
        policy_factory("mappo")(CARDINAL)
    with pytest.raises(ValueError, match=r"^policy 'mappo-cardinal' requires action_model='cardinal', got 'rotate'$"):
        policy_factory("mappo-cardinal")(ROOM | {"action_model": "rotate"})
    env, _ = policy_factory("mappo-cardinal")(ROOM)
    assert env.config.action_model == "cardinal"


def test_an_existing_policy():
    policy = Right()
    env, same = factory_for(policy)(ROOM)
    assert same is policy
    assert (env.config.action_model, env.config.view_size) == ("cardinal", (1, 1))
    with pytest.raises(ValueError, match=r"^Right requires action_model='cardinal', got 'rotate'$"):
        factory_for(policy)(ROOM | {"action_model": "rotate"})
