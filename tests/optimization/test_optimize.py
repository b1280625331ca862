"""Optimization of guidance graphs: selection, interrupts, and going on."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.errors import FormatError
from mapf_pz.guidance import GuidanceGraph, load_guidance
from mapf_pz.instances import RandomObstacles, load_map, write_map
from mapf_pz.instances.instance import Grid
from mapf_pz.optimization.candidate import Candidate, ranked
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.evaluate import compare
from mapf_pz.optimization.folder import read_optimization
from mapf_pz.optimization.optimize import baselines, optimize, resume
from mapf_pz.optimization.rule import FeedbackRule
from mapf_pz.optimization.search import FIRST_SEED, Search
from mapf_pz.optimization.simulation import Simulation, simulate
from mapf_pz.optimization.task import GuidanceTask
from mapf_pz.optimization.usage import Usage
from mapf_pz.simulator.keywords import EnvKeywords

LIFELONG = GuidanceTask(
    env=EnvKeywords(
        {"map": "empty-8-8", "num_agents": 24, "action_model": "cardinal", "on_target": "restart", "max_steps": 60}
    )
)
SHORT = OptimizeConfig(task=LIFELONG, minutes=0.03, jobs=1)


def lifelong(**keywords):
    """Return the environment of `LIFELONG` with other keywords."""
    return EnvKeywords(LIFELONG.env.keywords | keywords)


def test_simulations_depend_on_seed_and_graph_only():
    free = LIFELONG.grid.free
    graph = GuidanceGraph.crisscross(free)
    first, again, other = (simulate(LIFELONG, graph, seed) for seed in (3, 3, 4))
    assert first.score == again.score > 0
    assert np.array_equal(first.usage.moves, again.usage.moves)
    assert not np.array_equal(first.usage.moves, other.usage.moves)
    assert first.usage.moves.sum() + first.usage.waits.sum() == 24 * 60
    assert not np.array_equal(first.usage.moves, simulate(LIFELONG, GuidanceGraph.uniform(free), 3).usage.moves)


def test_the_score_of_one_shot_episodes_is_the_cost_per_agent():
    env = EnvKeywords({"map": "empty-8-8", "num_agents": 2, "action_model": "cardinal", "max_steps": 60})
    task = GuidanceTask(env=env)
    graph = GuidanceGraph.uniform(task.grid.free)
    result = simulate(task, graph, 0)
    moves, waits = result.usage.moves.sum(), result.usage.waits.sum()
    assert result.score == -(moves + waits) / 2  # each step before an agent rests at its goal is a move or a wait
    cut = simulate(task, graph, 0, num_steps=1)
    assert cut.score == -2  # one step, and as much again for agents that have not arrived


@pytest.mark.parametrize("planner", ["pibt", "epibt:depth=2", "mappo-cardinal", "random"])
def test_planners_and_policies(planner):
    task = GuidanceTask(env=lifelong(num_agents=4, max_steps=20), planner=planner)
    result = simulate(task, GuidanceGraph.crisscross(task.grid.free), 0)
    assert result.usage.moves.sum() + result.usage.waits.sum() == 4 * 20


def test_tasks_need_one_map():
    with pytest.raises(ValueError, match="one map"):
        GuidanceTask(env=EnvKeywords({"source": RandomObstacles(8, 8, 0.1, 4)}))


def test_the_result_is_not_worse_than_uniform_weights():
    """Also on a busy machine, where little more than the baselines is simulated."""
    progress = []
    result = optimize(SHORT, on_progress=progress.append)
    assert progress[-1].simulations >= len(progress)
    free = LIFELONG.grid.free
    found, uniform = compare(LIFELONG, {"found": result.graph, "uniform": GuidanceGraph.uniform(free)}, 12)
    assert found.mean > uniform.mean - 3 * uniform.standard_error


def test_the_rule_improves_on_uniform_weights():
    """Without a time limit: ten episodes of the default rule, with ties broken at random as graphs leave few ties."""
    task = replace(LIFELONG, planner="pibt:preference=random")
    search = Search(task, map, seconds=1e9, rng=np.random.default_rng(0))
    rule = FeedbackRule()
    traffic = rule.start(task.grid.free)
    for _ in range(10):
        (result,) = search.evaluate([Candidate(rule.graph(traffic, task.grid.free))])
        traffic = rule.update(traffic, result.usage, task.grid.free)
    graphs = {"found": search.archive[0].graph, "uniform": GuidanceGraph.uniform(task.grid.free)}
    found, uniform = compare(task, graphs, 24)
    assert found.mean > uniform.mean + 3 * uniform.standard_error


def test_files_and_going_on(tmp_path, capsys):
    folder = tmp_path / "run"
    result = optimize(SHORT, folder)
    assert result.graph == load_guidance(folder / "guidance.json", LIFELONG.grid)
    rows = list(csv.DictReader((folder / "history.csv").read_text().splitlines()))
    simulations = [int(row["simulations"]) for row in rows]
    assert simulations == sorted(set(simulations))
    for name in ("guidance.png", "curve.png"):
        assert (folder / name).stat().st_size > 1000
    assert json.loads((folder / "config.json").read_text())["task"]["env"]["map"] == "empty-8-8"
    with pytest.raises(FileExistsError, match="choose another output, or continue it with `mapf-pz guidance resume"):
        optimize(SHORT, folder)
    resume(folder, minutes=0.02)
    more = list(csv.DictReader((folder / "history.csv").read_text().splitlines()))
    assert more[: len(rows)] == rows
    assert int(more[-1]["simulations"]) > simulations[-1]
    assert float(more[len(rows)]["seconds"]) > float(rows[-1]["seconds"])
    with pytest.raises(FileNotFoundError, match="no optimization to resume"):
        resume(tmp_path / "other")
    main(["guidance", "resume", str(folder), "--minutes", "0.01", "--jobs", "1"])
    assert "guidance.json" in capsys.readouterr().out


def test_a_resumed_optimization_has_the_configuration_of_the_folder(tmp_path):
    """Also the objects in it, here the map and the weights."""
    grid = Grid(np.ones((4, 5), bool))
    weights = GuidanceGraph.random(grid.free, np.random.default_rng(0))
    env = lifelong(map=grid, num_agents=3, edge_weights=weights)
    config = replace(SHORT, task=GuidanceTask(env=env, planner="epibt:depth=2"), seed=5)
    optimize(config, tmp_path)
    assert read_optimization(tmp_path) == config
    before = {file.name: file.read_bytes() for file in tmp_path.glob("*.safetensors")}
    resume(tmp_path, minutes=0.02)
    assert read_optimization(tmp_path) == replace(config, minutes=0.02)
    assert {file.name: file.read_bytes() for file in tmp_path.glob("*.safetensors")} == before
    (tmp_path / "config.json").write_text('{"seed": -')
    with pytest.raises(FormatError, match=r"config\.json"):
        resume(tmp_path)


def test_candidates_of_another_map_are_refused(tmp_path):
    optimize(SHORT, tmp_path)
    config = tmp_path / "config.json"
    config.write_text(config.read_text().replace("empty-8-8", "empty-16-16"))
    with pytest.raises(ValueError, match=r"candidates\.npz: .*map"):
        resume(tmp_path)


def test_a_map_that_was_changed_in_place_is_refused(tmp_path):
    file = tmp_path / "mine.map"
    write_map(load_map("empty-8-8"), file)
    optimize(replace(SHORT, task=GuidanceTask(env=lifelong(map=file))), tmp_path / "run")
    before = file.read_text()
    file.write_text(before.replace("map\n.", "map\n@"))
    with pytest.raises(FormatError, match=r"candidates\.npz: candidates for another map, .* has changed"):
        resume(tmp_path / "run")
    file.write_text(before)
    resume(tmp_path / "run", minutes=0.02)


@pytest.mark.parametrize("change", ["rules", "scores", "usage"])
def test_damaged_candidates_are_refused(change, tmp_path):
    """Arrays that do not fit each other, or have other types."""
    optimize(SHORT, tmp_path)
    file = tmp_path / "candidates.npz"
    arrays = dict(np.load(file))
    if change == "rules":
        arrays["rule"] = arrays["rule"][:, :3]
    elif change == "scores":
        arrays["scores"] = np.full((99, 1), 1.0)
    else:
        arrays["moves"] = np.zeros(2, np.bool_)
    np.savez(file, **arrays)
    with pytest.raises(FormatError, match=r"candidates\.npz: expected candidates"):
        resume(tmp_path)


def test_an_interrupt_keeps_the_best(tmp_path):
    best = []

    def interrupt(progress):
        best.append(progress.best)
        if progress.simulations >= 60:
            raise KeyboardInterrupt

    result = optimize(replace(SHORT, minutes=60), tmp_path / "run", on_progress=interrupt)
    assert result.interrupted
    assert result.score == best[-1]
    assert result.graph == load_guidance(tmp_path / "run" / "guidance.json", LIFELONG.grid)


def test_selection_is_by_fresh_scores():
    """A candidate with lucky scores in the search loses to one that is better on new seeds."""
    free = LIFELONG.grid.free
    blocked = GuidanceGraph.uniform(free).move * np.where(np.arange(8) % 2, 1.0, 60.0)[:, None]
    lucky = Candidate(GuidanceGraph(blocked, np.ones(free.shape)), scores=[1e9])
    good = Candidate(GuidanceGraph.crisscross(free), scores=[0.0])
    search = Search(LIFELONG, map, seconds=0, rng=np.random.default_rng(0), archive=[lucky, good])
    assert search.select().graph == good.graph


def test_the_weights_of_the_task_compete():
    graph = GuidanceGraph.random(LIFELONG.grid.free, np.random.default_rng(0))
    task = replace(LIFELONG, env=lifelong(edge_weights=graph))
    assert [candidate.graph for candidate in baselines(task)][2:] == [graph]
    for name in ("crisscross", "random"):
        assert len(baselines(replace(LIFELONG, env=lifelong(edge_weights=name)))) == 2


def test_ranking_discounts_few_scores():
    empty = Usage.empty((8, 8))
    steady, lucky, low = (Candidate(GuidanceGraph.uniform(LIFELONG.grid.free)) for _ in range(3))
    for candidate, scores in ((steady, [4.0, 5.0, 6.0] * 4), (lucky, [5.2]), (low, [1.0, 2.0])):
        for score in scores:
            candidate.add(Simulation(score, empty))
    assert ranked([low, lucky, steady, Candidate(low.graph)]) == [steady, lucky, low]


def test_seeds_of_the_search_are_not_those_of_tests():
    search = Search(LIFELONG, map, seconds=1, rng=np.random.default_rng(0))
    assert min(search.draw_seed() for _ in range(1000)) >= FIRST_SEED


@pytest.mark.parametrize(
    ("change", "message"),
    [({"minutes": 0}, "minutes=0"), ({"minutes": -1}, "minutes=-1")],
)
def test_invalid_options(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SHORT, **change)
