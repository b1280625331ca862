"""Results of a folder are reused only for the version, the policies and the tasks that they belong to."""

import shutil
from functools import partial

import numpy as np
import pytest

from mapf_pz._internal.digest import NoDigestError, digest
from mapf_pz.commands.main import main
from mapf_pz.evaluation import EvaluationTask, evaluate, identity
from mapf_pz.evaluation.identity import IDENTITIES_FILE, Identities, policy_identity
from mapf_pz.evaluation.results import Results, discard
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import RandomMaps, RandomObstacles, generate, load_map, place, write_scenario
from mapf_pz.instances.instance import Instance, Scenario
from tests.evaluation.test_episodes import Right
from tests.evaluation.test_results import TASKS, untimed
from tests.helpers.text_instances import drawn

SMALL = EvaluationTask("small", 2, {"map": "empty-8-8", "max_steps": 12, "action_model": "cardinal"}, 3)


class Named(Right):
    def __init__(self, identity):
        super().__init__()
        self.identity = identity


class Unnamed(Right):
    identity = None


class Custom:
    """A source that does not state what it is."""

    shape, num_agents, grid = (8, 8), 2, None

    def sample(self, rng):
        grid = load_map("empty-8-8")
        return Instance(grid, place(grid, 2, rng))


def refused(folder, line, policies, tasks=(SMALL,)):
    """Expect that an evaluation is refused, and that it is run as without a folder if it may overwrite."""
    before = (folder / "episodes.csv").read_bytes()
    with pytest.raises(ValueError, match="expected another folder, or overwrite") as error:
        evaluate(policies, tasks, folder)
    assert str(error.value) == f"{folder}: {line}; expected another folder, or overwrite"
    assert (folder / "episodes.csv").read_bytes() == before
    again = evaluate(policies, tasks, folder, overwrite=True)
    assert untimed(again) == untimed(evaluate(policies, tasks))
    return again


def left(folder, policies, tasks=(SMALL,)):
    """Return how many episodes an evaluation runs."""
    lefts = []
    evaluate(policies, tasks, folder, show=lambda episode, left: lefts.append(left))
    return lefts[0]


def test_other_weights(tmp_path):
    safetensors = pytest.importorskip("safetensors.torch")
    pytest.importorskip("torchrl")
    from mapf_pz.rl import load_policy
    from mapf_pz.rl.policies.folder import bundled

    shutil.copytree(bundled() / "mappo-cardinal", tmp_path / "mine")
    policies = {"mine": str(tmp_path / "mine"), "pibt": "pibt"}
    first = evaluate(policies, [SMALL], tmp_path / "out")
    assert left(tmp_path / "out", policies) == 0
    loaded = load_policy(tmp_path / "mine")
    assert policy_identity(loaded) == policy_identity(load_policy(tmp_path / "mine"))

    file = tmp_path / "mine" / "policy.safetensors"
    weights = safetensors.load_file(file)
    safetensors.save_file({name: 0 * weight for name, weight in weights.items()}, file)
    again = refused(tmp_path / "out", "policy 'mine': weights differ", policies)
    assert untimed(again[:3]) != untimed(first[:3])
    assert again[3:] == first[3:]  # to the time: they were not run again
    assert policy_identity(loaded) != policy_identity(load_policy(tmp_path / "mine"))

    config = tmp_path / "mine" / "config.json"
    config.write_text(config.read_text().replace('"seed": 0', '"seed": 1'))
    refused(tmp_path / "out", "policy 'mine': configuration differs", policies)
    greedy = {"mine": f"{tmp_path / 'mine'}:temperature=0"}
    refused(tmp_path / "out", "policy 'mine': options differ", greedy)
    assert left(tmp_path / "out", greedy) == 0


def test_another_policy_under_the_same_name(tmp_path):
    evaluate({"mine": "pibt", "other": "pibt:swap=False"}, [SMALL], tmp_path)
    refused(tmp_path, "policy 'mine': policy differs", {"mine": "random"})
    refused(tmp_path, "policy 'other': options differ", {"other": "pibt"})
    assert left(tmp_path, {"mine": "random", "other": "pibt"}) == 0


def test_objects(tmp_path):
    evaluate({"mine": Named("a"), "none": Unnamed()}, [SMALL], tmp_path)
    assert left(tmp_path, {"mine": Named("a")}) == 0
    refused(tmp_path, "policy 'mine': identity differs", {"mine": Named("b")})
    line = "policy 'none': no attribute 'identity' states what it is, so its results cannot be reused"
    refused(tmp_path, line, {"none": Unnamed()})
    evaluate({"none": Unnamed()}, [SMALL], tmp_path, overwrite=True)
    line = "policy 'none': its results are those of an object without the attribute 'identity'"
    refused(tmp_path, line, {"none": Named("a")})
    for wrong in ("", 3):
        with pytest.raises(TypeError, match="policy Named: expected its identity to be a non-empty text or a mapping"):
            policy_identity(Named(wrong))


def test_another_version(tmp_path, monkeypatch):
    evaluate(["pibt"], [SMALL], tmp_path)
    monkeypatch.setattr(identity, "__version__", "0.0.0")
    refused(tmp_path, "policy 'pibt': version differs", ["pibt"])


def test_a_folder_without_identities(tmp_path):
    evaluate(["pibt", "random"], [SMALL], tmp_path)
    (tmp_path / IDENTITIES_FILE).unlink()
    refused(tmp_path, f"policy 'pibt': its results have no identity in {IDENTITIES_FILE}", ["pibt"])
    assert {episode.policy for episode in Results(tmp_path).episodes} == {"pibt"}  # nothing is known of the others


@pytest.mark.parametrize(
    ("changed", "line"),
    [
        (TASKS[0].with_(seed=5), "seed differs"),
        (TASKS[0].with_(keywords={"max_steps": 7}), "max_steps differ"),
        (TASKS[0].with_(instances=(drawn("a..A."), drawn("a.A.."))), "instances differ"),
        (TASKS[0].with_(instances=(drawn("a...A", [0]), drawn("a.A..", [0]))), "instances differ"),
        (TASKS[0].with_(keywords={"max_steps": 6, "edge_weights": "crisscross"}), "edge_weights differ"),
        (TASKS[1].with_(keywords={"max_steps": 6, "source": RandomObstacles(4, 4, 0.3, 2)}), "instances differ"),
        (TASKS[1].with_(keywords={"max_steps": 6, "map": "empty-8-8"}), "instances differ"),
    ],
    ids=["seed", "max_steps", "goals", "headings", "edge_weights", "source", "map"],
)
def test_other_tasks_under_the_same_name(tmp_path, changed, line):
    before = evaluate({"right": Right()}, TASKS, tmp_path)
    rows = {episode.key: episode for episode in before}
    tasks = [changed if task.label == changed.label else task for task in TASKS]
    again = refused(tmp_path, f"task {changed.label!r}: {line}", {"right": Right()}, tasks)
    assert all(rows[episode.key] == episode for episode in again if episode.task != changed.name)


def test_more_and_fewer_tasks(tmp_path):
    evaluate({"right": Right()}, TASKS[:1], tmp_path)
    assert left(tmp_path, {"right": Right()}, TASKS) == TASKS[1].episodes
    assert left(tmp_path, {"right": Right()}, TASKS[1:]) == 0
    discard(tmp_path)
    discard(tmp_path)  # nothing is left to remove
    assert list(tmp_path.iterdir()) == []


def test_weights_that_are_printed_alike(tmp_path):
    free = np.ones((40, 40), np.bool_)
    graphs = [GuidanceGraph(np.ones((4, 40, 40)), np.ones((40, 40))) for _ in range(2)]
    wait = np.ones((40, 40))
    wait[20, 20] = 9
    graphs.append(GuidanceGraph(graphs[0].move, wait))
    assert repr(graphs[0]) == repr(graphs[2])
    tasks = [EvaluationTask("open", 1, {"map": free, "edge_weights": graph, "max_steps": 2}, 1) for graph in graphs]
    evaluate({"right": Right()}, tasks[:1], tmp_path)
    assert left(tmp_path, {"right": Right()}, tasks[1:2]) == 0
    refused(tmp_path, "task '1 agents on open': edge_weights differ", {"right": Right()}, tasks[2:])


def test_sources(tmp_path):
    def task(source):
        return EvaluationTask("mine", 2, {"source": source, "max_steps": 3}, 2)

    evaluate({"right": Right()}, [task(RandomMaps(partial(generate.maze, 8, 8), 2))], tmp_path)
    assert left(tmp_path, {"right": Right()}, [task(RandomMaps(partial(generate.maze, 8, 8), 2))]) == 0
    unknown = task(Custom())
    line = "no attribute 'identity' states what it is, so its results cannot be reused"
    refused(tmp_path, f"task '2 agents on mine': {line}", {"right": Right()}, [unknown])
    known = Custom()
    known.identity = "uniform"
    evaluate({"right": Right()}, [task(known)], tmp_path, overwrite=True)
    assert left(tmp_path, {"right": Right()}, [task(known)]) == 0


def test_a_scenario_and_a_graph_that_were_overwritten(capsys, tmp_path):
    grid = load_map("empty-8-8")

    def scenario(seed):
        write_scenario(place(grid, 4, np.random.default_rng(seed)), grid, tmp_path / "a.scen")

    def run(*words):
        options = ["--policy", "pibt", "--max-steps", "20", "--scenario", str(tmp_path / "a.scen")]
        status = main(["evaluate", *options, "--output", str(tmp_path / "out"), *words])
        return status, capsys.readouterr().err

    scenario(0)
    assert run() == run() == (0, "")
    rows = (tmp_path / "out" / "episodes.csv").read_text()
    scenario(1)
    task = "task '4 agents on a.scen': instances differ"
    message = f"mapf-pz evaluate: {tmp_path / 'out'}: {task}; expected another folder, or overwrite\n"
    assert run() == (1, message)
    assert (tmp_path / "out" / "episodes.csv").read_text() == rows
    assert run("--overwrite") == (0, "")
    after = (tmp_path / "out" / "episodes.csv").read_text()
    assert len(after.splitlines()) == len(rows.splitlines())
    assert after != rows


def test_identities_are_read_as_they_were_written(tmp_path):
    identities = Identities.of({"mine": Named("a"), "none": Unnamed()}, TASKS)
    identities.write(tmp_path)
    assert Identities.read(tmp_path) == identities
    assert Identities.read(tmp_path / "nowhere") == Identities()


# Digests.


def test_digests_of_values(tmp_path):
    file = tmp_path / "file"
    file.write_text("a")
    values = [
        *(None, True, 1, 1.0, "1", b"1", 2, [1, 2], [[1], 2], {"a": 1}, {"a": 2}, {"b": 1}),
        *(np.zeros(4), np.zeros(4, np.float32), np.zeros((2, 2)), np.arange(4.0)),
        *(Scenario([[0, 0]], [[0, 1]]), Scenario([[0, 0]], [[0, 2]]), RandomObstacles(4, 4, 0.1, 2)),
        *(generate.maze, generate.random, partial(generate.maze, 4, 4), partial(generate.maze, 4, loops=0.5)),
        *(file, drawn, Right, "tests.helpers.text_instances:drawn"),
    ]
    digests = [digest(value) for value in values]
    assert len(set(digests)) == len(values)
    assert [digest(value) for value in values] == digests
    assert digest((1, 2)) == digest([1, 2])
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    file.write_text("b")
    assert digest(file) != digests[-4]
    for unknown in (object(), lambda: 0, np.array([object()]), [Custom()]):
        with pytest.raises(NoDigestError):
            digest(unknown)


def test_a_module_that_is_named_is_a_part(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "plugged").mkdir()
    part = tmp_path / "plugged" / "part.py"
    (tmp_path / "plugged" / "__init__.py").write_text("raise AssertionError('it is not imported')")
    digests = set()
    for text in ("a = 1", "a = 2"):
        part.write_text(text)
        digests.add(digest(["plugged.part:a"]))
    assert len(digests) == 2
    assert digest("plugged.other:a") == digest("plugged.other:a")
