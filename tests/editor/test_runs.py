"""Runs of solvers: their plans are those of the command line, and their episodes can be resumed."""

import multiprocessing
import os
import signal
import sys

import numpy as np
import pytest

from mapf_pz import EnvConfig
from mapf_pz.commands.main import main
from mapf_pz.environment.policy import actions_of, simulator_of
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.instances import Grid, Instance, Scenario, format_map, format_scenario, load_map
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import planner_of
from mapf_pz.planners.named import import_code
from mapf_pz.planners.plans.plan import reached
from mapf_pz.simulator.source import sample_instance
from tests.editor.test_instances import encoded
from tests.helpers.editor_server import EditorServer, array, positions

pytestmark = pytest.mark.usefixtures("forked_solvers")


def sampled(action_model="rotate", num_agents=6, map="random-16-16-20"):
    config = EnvConfig(map=map, num_agents=num_agents, action_model=action_model, initial_heading="east")
    return sample_instance(config, seed=4)


def edited(instance, goals=None):
    """Return an instance as the page sends it."""
    return {
        "name": instance.grid.name,
        "map": format_map(instance.grid),
        "starts": instance.scenario.starts.tolist(),
        "goals": [[goal] for goal in instance.scenario.goals.tolist()] if goals is None else goals,
        "headings": None if instance.headings is None else instance.headings.tolist(),
    }


def solved(server, given, *solvers, **members):
    """Run solvers on an instance of the page; return the run, and the progress of the solvers, which are all done."""
    run = server.call("solve", instance=given, solvers=solvers, **members)["run"]
    progress = server.finished(run)
    assert [solver["state"] for solver in progress] == ["done"] * len(solvers), progress
    return run, progress


@pytest.mark.parametrize("weighted", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("solver", "action_model"),
    [
        ("pibt", "rotate"),
        ("epibt:depth=3", "rotate"),
        ("lacam:anytime=False", "cardinal"),
        ("cbs", "cardinal"),
        ("random", "cardinal"),
        ("oneshot+pibt", "rotate"),
    ],
)
def test_the_plan_is_that_of_the_command(server, tmp_path, solver, action_model, weighted):
    if solver.startswith("oneshot"):
        pytest.importorskip("torchrl")
    instance = sampled(action_model)
    files, grid = tmp_path / "files", instance.grid
    server.call("save", path=str(files / "a.map"), text=format_map(grid))
    server.call("save", path=str(files / "a.scen"), text=format_scenario(instance.scenario, grid))
    words = ["--map", files / "a.map", "--scenario", files / "a.scen", "--action-model", action_model]
    given = edited(instance)
    if weighted:
        graph = GuidanceGraph.random(grid.free, np.random.default_rng(3))
        save_guidance(graph, files / "a.npz", grid)
        words += ["--edge-weights", files / "a.npz"]
        given["weights"] = encoded(np.concatenate([graph.move, graph.wait[None]]))
    words += ["--planner", solver, "--seed", 7, "--max-steps", 60, "--time-limit", 1000, "--partial"]
    status = main(["solve", *map(str, [files / "plan.json", *words])])
    _, [progress] = solved(server, given, solver, seed=7, max_steps=60, time_limit=1000)
    answer = server.call("episode", run=1, solver=0)
    assert answer["plan"] == (files / "plan.json").read_text()
    assert answer["goalsReached"] is None
    assert (status == 0) == (progress["unfinished"] == [])
    episode = answer["episode"]
    assert progress["step"] == episode["steps"] == len(positions(episode)) - 1
    away = (positions(episode)[-1] != instance.scenario.goals).any(axis=1)
    assert progress["unfinished"] == np.flatnonzero(away).tolist()
    assert episode["facts"] == {"solver": solver, "seed": "7"}


def test_two_solvers(server, capsys, tmp_path):
    instance = sampled()
    run, progress = solved(
        server, edited(instance), "pibt", "prioritized:anytime=False", max_steps=100, time_limit=1000
    )
    assert [solver["name"] for solver in progress] == ["pibt", "prioritized:anytime=False"]
    assert [solver["steps"] for solver in progress] == [100, 100]
    (tmp_path / "a.scen").write_text(format_scenario(instance.scenario, instance.grid))
    words = ["--map", instance.grid.name, "--scenario", str(tmp_path / "a.scen"), "--time-limit", "1000"]
    for number, solver in enumerate(progress):
        assert main(["solve", str(tmp_path / "plan.json"), *words, "--planner", solver["name"]]) == 0
        printed = capsys.readouterr().out.partition("plan.json: ")[2]
        assert printed.startswith(f"{solver['message']}, ")
        plan = server.call("episode", run=run, solver=number)["plan"]
        assert plan == (tmp_path / "plan.json").read_text()
    assert server.refused("step", run=run, solver=1, **{"from": 0}) == (
        400,
        "prioritized:anytime=False plans whole paths: expected a policy, or a planner of single steps",
    )
    assert server.refused("episode", run=run, solver=2)[0] == 400
    assert server.refused("episode", run=run + 1, solver=0) == (404, f"there is no run {run + 1}")


def test_a_solver_without_a_plan_has_failed(server):
    instance = Instance(Grid(np.ones((1, 3), np.bool_)), Scenario([[0, 0], [0, 2]], [[0, 2], [0, 0]]))
    members = {"instance": edited(instance), "solvers": ["lacam:anytime=False", "pibt"]}
    run = server.call("solve", **members, max_steps=20, time_limit=50)["run"]
    planned, stepped = server.finished(run)
    assert (planned["state"], stepped["state"]) == ("failed", "done")
    reason = "the search has visited all configurations"
    assert planned["message"] == f"lacam:anytime=False: the instance has no plan: {reason}"
    assert stepped["message"] == "2 of 2 agents are not at their goals after 20 steps"
    assert stepped["unfinished"] == [0, 1]
    assert server.refused("episode", run=run, solver=0)[0] == 409


def test_a_policy_with_other_actions_has_failed(server):
    pytest.importorskip("torchrl")
    run = server.call("solve", instance=edited(sampled()), solvers=["mappo-cardinal"])["run"]
    [progress] = server.finished(run)
    message = "policy 'mappo-cardinal' requires action_model='cardinal', got 'rotate'"
    assert (progress["state"], progress["message"]) == ("failed", message)


GOALS = [[[15, 15], [0, 0], [7, 8]], [[0, 1]], [[3, 3], [9, 9]]]


def lifelong(action_model="rotate"):
    instance = sampled(action_model, num_agents=3, map="empty-16-16")
    return instance, edited(instance, GOALS)


def test_a_lifelong_run(server):
    _, given = lifelong()
    run, [progress] = solved(server, given, "pibt", lifelong=True, max_steps=80, time_limit=1000)
    answer = server.call("episode", run=run, solver=0)
    paths = positions(answer["episode"])
    steps = [step for agent, goals in enumerate(GOALS) for step in reached(paths[:, agent], np.array(goals * 80))]
    assert answer["goalsReached"] == np.bincount(steps, minlength=81)[1:].tolist()
    assert sum(answer["goalsReached"]) > len(GOALS[0])
    assert progress["message"] == (
        f"3 agents reached {len(steps)} goals in 80 steps, throughput {len(steps) / 80:.3f} goals per step"
    )
    assert (progress["step"], progress["unfinished"], answer["episode"]["lifelong"]) == (80, [], True)
    assert f'"numTaskFinished": {len(steps)},' in answer["plan"]


def replayed(solver, instance, given, steps, lifelong):
    """Return the positions (T + 1, N, 2) of an episode with actions given by step and agent."""
    if lifelong:
        longest = max(map(len, GOALS))
        goals = [own + own[:1] * (longest - len(own)) for own in GOALS]
        instance = Instance(
            instance.grid, Scenario(instance.scenario.starts, goals, list(map(len, GOALS))), instance.headings
        )
    keywords = {"source": InstanceList([instance]), "max_steps": 60, "on_target": "restart" if lifelong else "nothing"}
    keywords["action_model"] = "cardinal" if instance.headings is None else "rotate"
    env, policy = policy_factory(solver, 7)(keywords)
    observations, infos = env.reset(seed=7)
    policy.reset_states()
    found = [simulator_of(env).positions(0)]
    while env.agents and len(found) <= steps:
        actions = actions_of(policy, observations, infos)
        actions |= {f"agent_{agent}": action for agent, action in given.get(len(found) - 1, {}).items()}
        observations, _, _, _, infos = env.step(actions)
        found.append(simulator_of(env).positions(0))
    return np.stack(found)


@pytest.mark.parametrize(
    ("solver", "action_model", "is_lifelong"),
    [
        ("pibt", "rotate", False),
        ("pibt", "cardinal", True),
        ("random", "rotate", False),
        ("windowed:rounds=1", "rotate", True),
        ("oneshot+pibt", "rotate", False),
        ("lifelong-cardinal", "cardinal", True),
    ],
)
def test_an_episode_is_resumed(server, solver, action_model, is_lifelong):
    if solver.startswith(("oneshot", "lifelong")):
        pytest.importorskip("torchrl")
    instance, given = lifelong(action_model)
    if not is_lifelong:
        instance = sampled(action_model)
        given = edited(instance)
    limits = {"lifelong": is_lifelong, "max_steps": 60, "time_limit": 1000, "seed": 7}
    first, [progress] = solved(server, given, solver, **limits)
    wait = 3 if action_model == "rotate" else 0
    manual = {3: {0: wait, 2: 1}, 6: {1: wait}}
    taken, run = {}, first
    for step, steps in ((3, 60), (6, 5)):
        taken[step] = manual[step]
        actions = {str(agent): action for agent, action in manual[step].items()}
        run = server.call("step", run=run, solver=0, actions=actions, steps=steps, **{"from": step})["run"]
        [progress] = server.finished(run)
        assert progress["state"] == "done", progress
        episode = server.call("episode", run=run, solver=0)["episode"]
        expected = replayed(solver, instance, taken, step + steps, is_lifelong)
        assert np.array_equal(positions(episode), expected)
        assert progress["step"] == len(expected) - 1
        for agent, action in manual[step].items():
            assert array(episode, "actions", np.int8)[agent, step + 1] == action
    assert run == first + 2
    assert server.refused("progress", run=first)[0] == 404


def test_steps_that_are_refused(server):
    instance = sampled()
    run, [progress] = solved(server, edited(instance), "pibt", max_steps=100, time_limit=1000)
    last = progress["step"] - 1
    for members, error in (
        ({"from": last + 1}, f"from={last + 1}: expected 0 to {last}, a step before the end of the episode"),
        ({"from": -1}, "from: Input should be greater than or equal to 0"),
        ({"from": 0, "actions": {"6": 0}}, "actions: expected agents 0 to 5, got 6"),
        ({"from": 0, "actions": {"0": 4}}, "actions: expected an action 0 to 3 of agent 0, got 4"),
        ({"from": 0, "actions": {"a": 0}}, "actions.a.[key]: Input should be a valid integer"),
        ({"from": 0, "steps": 0}, "steps: Input should be greater than or equal to 1"),
    ):
        status, message = server.refused("step", run=run, solver=0, **members)
        assert status == 400
        assert message.startswith(error)
    assert server.finished(run) == [progress]


@pytest.fixture
def endless(server):
    """A run that ends only when it is stopped, and its process."""
    before = set(multiprocessing.active_children())
    _, given = lifelong()
    members = {"lifelong": True, "max_steps": 100_000, "time_limit": 80_000}
    run = server.call("solve", instance=given, solvers=["pibt"], **members)["run"]
    [process] = set(multiprocessing.active_children()) - before
    return run, process


def test_a_run_is_stopped(server, endless):
    run, process = endless
    given = {"instance": edited(sampled()), "solvers": ["pibt"]}
    assert server.refused("solve", **given) == (409, "another run is running: stop it first")
    assert server.refused("episode", run=run, solver=0) == (
        409,
        "pibt: expected a solver that is done, got one that is running",
    )
    while server.call("progress", run=run)["solvers"][0]["step"] < 3:  # it works on
        pass
    assert server.call("stop", run=run) == {}
    assert not process.is_alive()
    [progress] = server.call("progress", run=run)["solvers"]
    assert (progress["state"], progress["message"]) == ("stopped", "stopped")
    assert progress["step"] >= 3
    assert server.call("stop", run=run) == {}
    assert server.call("solve", **given, time_limit=1000)["run"] == run + 1
    assert server.finished(run + 1)[0]["state"] == "done"


def wait_for_the_end(connection, *_):
    """Receive requests, and answer none."""
    while True:
        connection.recv()


def test_a_crash_is_reported(server, endless):
    run, process = endless
    os.kill(process.pid, signal.SIGKILL)
    [progress] = server.finished(run)
    assert progress["state"] == "failed"
    assert progress["message"].startswith("the solver's process has ended unexpectedly, exit code ")


def test_a_crash_of_a_solver_that_is_done(server):
    before = set(multiprocessing.active_children())
    run, _ = solved(server, edited(sampled()), "pibt", time_limit=1000)
    [process] = set(multiprocessing.active_children()) - before
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert server.refused("episode", run=run, solver=0)[0] in (400, 409)
    assert server.call("progress", run=run)["solvers"][0]["state"] == "failed"


def test_processes_end_with_the_server(server, endless):
    _, process = endless
    server.runs.close()
    assert not process.is_alive()


@pytest.mark.parametrize("solver", ["pibt", "lacam:anytime=False"])
def test_an_episode_with_delays(server, solver):
    """A planner of whole paths acts, too: it plans again when an agent was delayed."""
    instance = sampled()
    keywords = {"source": InstanceList([instance]), "max_steps": 100, "delays": "0.3:1-3"}
    env, policy = policy_factory(solver, 7)(keywords)
    observations, infos = env.reset(seed=7)
    policy.reset_states()
    agents, delayed, cells = simulator_of(env).agents[0], [[False] * 6], [instance.scenario.starts]
    while env.agents:
        observations, _, _, _, infos = env.step(actions_of(policy, observations, infos))
        delayed.append(agents["delayed"].tolist())
        cells.append(simulator_of(env).positions(0))
    limits = {"max_steps": 100, "time_limit": 1000, "seed": 7, "delays": "0.3:1-3"}
    run, [progress] = solved(server, edited(instance), solver, **limits)
    episode = server.call("episode", run=run, solver=0)["episode"]
    assert (progress["unfinished"], progress["step"]) == ([], len(cells) - 1)
    assert np.array_equal(positions(episode), cells)
    assert array(episode, "delayed", np.uint8).T.tolist() == delayed
    assert episode["facts"] == {"solver": solver, "seed": "7", "delays": "0.3:1-3"}
    resumed = server.call("step", run=run, solver=0, steps=100, **{"from": 3})["run"]
    server.finished(resumed)
    assert server.call("episode", run=resumed, solver=0)["episode"] == episode


@pytest.mark.parametrize(
    ("delays", "message"),
    [
        ("0.1", "delays '0.1': expected PROBABILITY:SMALLEST-LARGEST, optionally with :poisson and :normal"),
        ("0.1:4-1", "delays '0.1:4-1': duration=(4, 1): expected the smallest number of steps first"),
    ],
)
def test_malformed_delays_are_refused(server, delays, message):
    status, error = server.refused("solve", instance=edited(sampled()), solvers=["pibt"], delays=delays)
    assert status == 400
    assert error.startswith(message)


def test_agents_at_their_goals_need_no_step(server):
    grid = load_map("empty-8-8")
    instance = Instance(grid, Scenario([[1, 2]], [[1, 2]]), np.zeros(1, np.int64))
    for solver in ("pibt", "random", "lacam:anytime=False"):
        _, [progress] = solved(server, edited(instance), solver, time_limit=1000)
        assert (progress["step"], progress["unfinished"]) == (0, [])


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("action_model", ["rotate", "cardinal"])
def test_memory_is_checked_before_a_run(server, monkeypatch, action_model, weighted):
    instance = sampled(action_model)
    given = edited(instance)
    graph = GuidanceGraph.random(instance.grid.free, np.random.default_rng(3))
    if weighted:
        given["weights"] = encoded(np.concatenate([graph.move, graph.wait[None]]))
    weights = graph if weighted else "uniform"
    with pytest.raises(MemoryError) as raised:
        planner_of("pibt").solve(instance, edge_weights=weights, distance_bytes=1)
    needed = int(str(raised.value).partition(" takes ")[2].partition(" ")[0])
    monkeypatch.setattr("mapf_pz.simulator.kernels.cost_tables.CACHE_BYTES", 0)
    monkeypatch.setattr("mapf_pz.simulator.kernels.cost_tables.usable_memory", lambda: 4 * needed - 2)
    before = multiprocessing.active_children()
    status, message = server.refused("solve", instance=given, solvers=["pibt", "lacam"])
    assert status == 400
    assert message.startswith("memory: the cost to go to all goals takes 0.0 GiB, expected at most 0.0 GiB: use fewer")
    assert multiprocessing.active_children() == before
    _, [progress] = solved(server, given, "pibt", max_steps=3, time_limit=1000)
    assert progress["step"] == 3


def test_a_solver_that_does_not_end_by_itself_is_ended(server, monkeypatch, endless):
    run, process = endless
    while server.call("progress", run=run)["solvers"][0]["step"] < 3:  # it works on
        pass
    monkeypatch.setattr("mapf_pz.editor.run.MAX_OVERTIME", -80_000)
    [progress] = server.finished(run)
    limits = "-80000 seconds after its time limit of 80000 seconds"
    assert (progress["state"], progress["message"]) == ("failed", f"pibt had no result {limits}, and was ended")
    process.join()


def test_progress_is_without_compilation(server, monkeypatch):
    monkeypatch.setattr("mapf_pz.editor.run.work", wait_for_the_end)  # as if kernels were compiled without end
    run = server.call("solve", instance=edited(sampled()), solvers=["cbs"], time_limit=1)["run"]
    [progress] = server.call("progress", run=run)["solvers"]
    assert (progress["state"], progress["seconds"], progress["message"]) == ("running", 0, "compiling")
    server.call("stop", run=run)
    assert server.call("progress", run=run)["solvers"][0]["seconds"] == 0


def test_planners_and_policies_of_the_user(tmp_path, monkeypatch):
    (tmp_path / "users.py").write_text(
        "from mapf_pz.planners import PIBT\n\n\nclass Own(PIBT):\n    pass\n\n\n"
        "class Right:\n    def act(self, observations):\n        return dict.fromkeys(observations, 1)\n\n"
        "    def reset_states(self):\n        pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    names = ("users:Own", "users:Right")
    for name in names:
        import_code(name)
    server = EditorServer(tmp_path, solvers=names)
    try:
        offered = {planner["name"]: planner["options"] for planner in server.call("names")["planners"]}
        assert offered["users:Own"] == offered["pibt"]
        assert offered["users:Right"] == {}
        given = edited(sampled())
        plans = []
        for solver in ("pibt", *names):
            run, _ = solved(server, given, solver, max_steps=60)
            plans.append(server.call("episode", run=run, solver=0)["plan"])
        assert plans[0] == plans[1] != plans[2]
    finally:
        server.close()
        sys.modules.pop("users")
