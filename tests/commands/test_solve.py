import numpy as np
import pytest

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.evaluation import rollout
from mapf_pz.instances import load_instance
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import CBS, PLANNERS, Plan, Planner
from mapf_pz.planners.base import lower_bound
from mapf_pz.planners.plans.files import read_plan
from mapf_pz.simulator.actions import wait_action
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.source import sample_instance
from tests.helpers.text_instances import drawn
from tests.instances.problem_files import write_lorr, write_pogema


def run(capsys, command, *words):
    """Return the status and the lines of both outputs."""
    status = main([command, *map(str, words)])
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


@pytest.mark.parametrize(
    ("ending", "action_model"), [("json", "rotate"), ("json", "cardinal"), ("csv", "cardinal"), ("txt", "rotate")]
)
def test_a_plan_is_solved_written_and_legal(capsys, tmp_path, ending, action_model):
    plan = tmp_path / "new" / f"plan.{ending}"
    options = ["--map", "empty-8-8", "--num-agents", 3, "--action-model", action_model, "--seed", 1]
    status, out, err = run(capsys, "solve", plan, *options, "--edge-weights", "crisscross")
    assert (status, len(out), err) == (0, 2, [])
    assert out[0].startswith(f"{plan}: 3 agents, sum of costs ")
    assert out[1].startswith("weighted cost: ")
    if ending != "csv":
        status, validated, err = run(capsys, "validate", plan, "--map", "empty-8-8", "--edge-weights", "crisscross")
        assert (status, err) == (0, [])
        assert validated[-1] == out[1]
        assert validated[1].split(", ")[0] in out[0].replace("costs ", "costs: ")


@pytest.mark.parametrize("planner", ["pibt", "mappo-cardinal"])
def test_random_weights_are_those_of_the_plan(capsys, tmp_path, planner):
    """The printed cost is that of the episode with the same seed."""
    options = ["--map", "empty-8-8", "--num-agents", 3, "--action-model", "cardinal", "--seed", 2]
    words = [tmp_path / "plan.txt", *options, "--planner", planner, "--edge-weights", "random"]
    status, out, _ = run(capsys, "solve", *words)
    assert status == 0
    instance = sample_instance(EnvConfig(map="empty-8-8", num_agents=3, action_model="cardinal"), seed=2)
    env = mapf_pz.parallel_env(source=InstanceList([instance]), action_model="cardinal", edge_weights="random")
    env.reset(seed=2)
    plan = read_plan(tmp_path / "plan.txt").plan
    assert out[1] == f"weighted cost: {plan.weighted_cost(env.simulator.guidance(0)):.6g}"


def test_a_scenario_of_the_benchmark(capsys, tmp_path, benchmark):
    files = [
        "--map", benchmark / "maps" / "random-32-32-10.map",
        "--scenario", benchmark / "scens" / "random-32-32-10-even-2.scen",
        "--num-agents", 20,
    ]  # fmt: skip
    status, out, _ = run(capsys, "solve", tmp_path / "plan.csv", "--action-model", "cardinal", *files)
    assert status == 0
    assert " times the lower bound " in out[0]
    bound = out[0].split("the lower bound ")[1].split(",")[0]
    assert f",even,2,20,{bound}," in (tmp_path / "plan.csv").read_text()
    assert run(capsys, "validate", tmp_path / "plan.csv", *files)[0] == 0


@pytest.mark.parametrize(("write", "agents"), [(write_lorr, 3), (write_pogema, 3)])
@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_a_problem_file(capsys, tmp_path, write, agents, action_model):
    problem = write(tmp_path)
    words = [tmp_path / "plan.txt", "--scenario", problem, "--action-model", action_model]
    status, out, err = run(capsys, "solve", *words)
    assert (status, err) == (0, [])
    assert f"plan.txt: {agents} agents, sum of costs " in out[0]
    status, _, err = run(capsys, "solve", *words, "--map", "empty-8-8")
    assert status == 1
    assert "which names its own map" in err[0]


def test_an_instance_is_that_of_the_environment():
    """The same fields and seed give the starts and goals of the first episode."""
    for keywords in ({"map": "random-16-16-20", "num_agents": 5}, {"initial_heading": "east"}):
        env = mapf_pz.parallel_env(**keywords)
        env.reset(seed=3)
        instance = sample_instance(env.config, seed=3)
        np.testing.assert_array_equal(instance.scenario.starts, env.positions)
        np.testing.assert_array_equal(instance.scenario.goals, env.goals)
        np.testing.assert_array_equal(instance.headings, env.headings)
    assert sample_instance(EnvConfig(action_model="cardinal"), seed=0).headings is None


def test_lower_bound():
    assert lower_bound(drawn("a.B\n##.\nA.b", headings=[0, 0])) == 6 + 2 + 2 + 1
    assert lower_bound(drawn("a.B\n##.\nA.b")) == 6 + 2
    assert lower_bound(drawn("a.")) == 1  # an arrival takes a step


class Idle(Planner):
    """A planner in which all agents wait, or that has no plan."""

    plan = None

    def decide(self, simulator, b=0):
        return np.full(simulator.num_agents, wait_action(simulator.config.action_model))

    def _solve(self, simulator, deadline):
        return self.plan


@pytest.fixture
def idle(monkeypatch):
    monkeypatch.setitem(PLANNERS, "idle", Idle)
    return Idle


def test_an_agent_that_stays_at_its_goal_costs_the_same_everywhere(capsys, tmp_path):
    """It costs 1, as in POGEMA, in plans, in the environment, and in the lower bound."""
    map, scenario = tmp_path / "free.map", tmp_path / "free.scen"
    map.write_text("type octile\nheight 3\nwidth 8\nmap\n" + "........\n" * 3)
    scenario.write_text("version 1\n0\tfree.map\t8\t3\t0\t0\t0\t0\t0\n0\tfree.map\t8\t3\t0\t2\t5\t2\t5\n")
    words = [tmp_path / "plan.txt", "--map", map, "--scenario", scenario, "--num-agents", 2, "--planner", "cbs"]
    status, out, _ = run(capsys, "solve", *words, "--action-model", "cardinal")
    assert status == 0
    assert "2 agents, sum of costs 6, makespan 5, 1.000 times the lower bound 6" in out[0]
    env = mapf_pz.parallel_env(map=str(map), scenario=str(scenario), num_agents=2, action_model="cardinal")
    metrics = rollout(env, CBS(env), seed=0).metrics
    assert (metrics["SoC"], metrics["makespan"], metrics["SoC_ratio"]) == (6, 5, 1)


@pytest.mark.parametrize("planner", ["pibt", "lacam", "mappo-cardinal"])
def test_a_plan_that_does_not_exist(capsys, tmp_path, planner):
    map, scenario = tmp_path / "lane.map", tmp_path / "lane.scen"
    map.write_text("type octile\nheight 1\nwidth 4\nmap\n....\n")
    scenario.write_text("version 1\n0\tlane.map\t4\t1\t0\t0\t3\t0\t3\n0\tlane.map\t4\t1\t1\t0\t3\t0\t2\n")
    words = [tmp_path / "plan.txt", "--map", map, "--scenario", scenario, "--num-agents", 2, "--planner", planner]
    limits = ["--time-limit", 600, "--max-steps", 9]
    reason = "the instance has no plan: agents 0 and 1 have the same goal"
    error = f"mapf-pz solve: {planner}: {reason}"
    assert run(capsys, "solve", *words, "--action-model", "cardinal", *limits) == (1, [], [error])
    assert not (tmp_path / "plan.txt").exists()


def test_no_plan(capsys, tmp_path, idle):
    words = [tmp_path / "plan.txt", "--planner", "idle", "--num-agents", 2, "--time-limit", 0.5, "--max-steps", 7]
    message = "mapf-pz solve: idle found no plan for 2 agents within 0.5 seconds and 7 steps"
    assert run(capsys, "solve", *words) == (1, [], [message])
    assert not list(tmp_path.iterdir())


def test_a_wrong_plan_is_not_written(capsys, tmp_path, idle, monkeypatch):
    instance = load_instance("empty-8-8", None, 2)
    jump = np.stack([instance.scenario.starts, instance.scenario.goals])
    monkeypatch.setattr(idle, "plan", Plan(jump, np.stack([instance.headings] * 2)))
    status, out, err = run(capsys, "solve", tmp_path / "plan.txt", "--planner", "idle", "--num-agents", 2)
    assert (status, out, len(err)) == (1, [], 1)
    assert err[0].startswith("mapf-pz solve: idle returned an illegal plan: step 1: agent 0 at ")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.txt", "--planner", "none"], "policy 'none': expected random, a planner (pibt, "),
        (["a.txt", "--planner", "lacam:depth=1"], "option 'depth=1': LaCAM has the options time_limit, anytime"),
        (["a.gif", "--num-agents", "2"], "a.gif: expected a file name that ends in .json, .csv, .txt"),
        (["a.csv", "--num-agents", "2"], "a.csv: a tracker CSV file cannot hold headings, expected act"),
        (["a.txt", "--num-agents", "65"], "65 agents do not fit on the 64 cells"),
        (["a.txt", "--map", "nowhere", "--num-agents", "2"], "no .map file is named 'nowhere'"),
    ],
)  # fmt: skip
def test_errors(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, "solve", *words)
    assert (status, out, len(err)) == (1, [], 1)
    assert message in err[0]
    assert not list(tmp_path.iterdir())


def test_a_planner_has_options(tmp_path, capsys):
    costs = []
    for planner in ("lacam", "lacam:anytime=False"):
        words = ["--planner", planner, "--map", "empty-8-8", "--num-agents", 12, "--time-limit", 1]
        status, [out], _ = run(capsys, "solve", tmp_path / "plan.json", *words)
        assert status == 0
        costs.append(int(out.split("sum of costs ")[1].split(",")[0]))
    assert costs[0] < costs[1]  # the first plan is not improved
