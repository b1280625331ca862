"""Files that are replaced while an evaluation runs: no row is of other files than its identity."""

import shutil

import numpy as np
import pytest

from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.external.plan_folder import PlanFolderFactory
from mapf_pz.evaluation.results import read_episodes
from mapf_pz.guidance import GuidanceGraph, save_guidance
from mapf_pz.instances import load_map, place, write_map, write_scenario
from tests.evaluation.test_results import untimed

GRID = load_map("empty-8-8")
KEYWORDS = {"map": "empty-8-8", "action_model": "cardinal", "max_steps": 6}


def policy_files(folder):
    safetensors = pytest.importorskip("safetensors.torch")
    pytest.importorskip("torchrl")
    from mapf_pz.rl.policies.folder import bundled

    file = folder / "mine" / "policy.safetensors"
    shutil.copytree(bundled() / "mappo-cardinal", file.parent)
    zeros = {name: 0 * weight for name, weight in safetensors.load_file(file).items()}
    return str(file.parent), KEYWORDS, file, lambda: file.write_bytes(safetensors.save(zeros))


def weights_files(folder, of_task):
    file = folder / "weights.npz"

    def write(seed=0):
        save_guidance(GuidanceGraph.random(GRID.free, np.random.default_rng(seed)), file, GRID)

    write()
    policy = "pibt" if of_task else f"pibt:edge_weights={file}"
    return policy, KEYWORDS | ({"edge_weights": file} if of_task else {}), file, lambda: write(1)


def map_files(folder):
    file = folder / "mine.map"
    write_map(GRID, file)
    return "pibt", KEYWORDS | {"map": file}, file, lambda: file.write_text(file.read_text().replace("\n..", "\n.@"))


def scenario_files(folder):
    file = folder / "mine.scen"

    def write(seed=0):
        write_scenario(place(GRID, 2, np.random.default_rng(seed)), GRID, file)

    write()
    return "pibt", KEYWORDS | {"scenario": file}, file, lambda: write(1)


def plan_files(folder):
    file = folder / "mine-2agents.txt"
    file.write_text("solution=\n0:(0,0),(1,0),\n")
    return PlanFolderFactory(folder), KEYWORDS, file, lambda: file.write_text("solution=\n0:(0,0),(2,0),\n")


def program_files(folder):
    file = folder / "program"
    file.write_text("#!/bin/sh\nexit 1\n")
    file.chmod(0o755)
    return f"command:{file} {{map}} {{scen}} {{plan}}", KEYWORDS, file, lambda: file.write_text("#!/bin/sh\nexit 2\n")


KINDS = {
    "policy": (policy_files, "policy 'mine': weights differ"),
    "planner's weights": (lambda folder: weights_files(folder, False), "policy 'mine': options differ"),
    "task's weights": (lambda folder: weights_files(folder, True), "task '2 agents on b': edge_weights differ"),
    "map": (map_files, "task '2 agents on b': instances differ"),
    "scenario": (scenario_files, "task '2 agents on b': instances differ"),
    "plans": (plan_files, "policy 'mine': plans differ"),
    "program": (program_files, "policy 'mine': program differs"),
}


@pytest.fixture(params=KINDS.values(), ids=list(KINDS))
def replaceable(request, tmp_path):
    """The policies, two tasks, each of which is a job, a file of them, a function that replaces it, and the message."""
    make, message = request.param
    policy, keywords, file, replace = make(tmp_path)
    return {"mine": policy}, [EvaluationTask(name, 2, keywords, 1) for name in "ab"], file, replace, message


def test_a_file_that_is_replaced_during_an_evaluation(replaceable, tmp_path):
    policies, tasks, file, replace, message = replaceable
    before, rows = file.read_bytes(), []
    message = f"{message} from the start of the evaluation; expected files that do not change"

    def show(episode, left):
        if episode is not None:
            rows.append(episode)
            replace()

    with pytest.raises(ValueError, match=f"^{message}$"):
        evaluate(policies, tasks, tmp_path / "out", show=show)
    assert [row.task for row in rows] == ["a"]
    assert read_episodes(tmp_path / "out") == rows

    file.write_bytes(before)
    again = evaluate(policies, tasks, tmp_path / "out")
    assert again[0] == rows[0]
    assert untimed(again) == untimed(evaluate(policies, tasks))


@pytest.mark.slow
@pytest.mark.parametrize("output", [True, False])
def test_a_file_that_is_replaced_before_a_process_reads_it(output, tmp_path):
    policy, keywords, _, replace = weights_files(tmp_path, False)
    tasks = [EvaluationTask(name, 2, keywords, 1) for name in "ab"]
    with pytest.raises(ValueError, match="policy 'mine': options differ from the start of the evaluation"):
        evaluate(
            {"mine": policy},
            tasks,
            tmp_path / "out" if output else None,
            jobs=2,
            show=lambda episode, left: replace(),
        )
    assert not output or read_episodes(tmp_path / "out") == []
