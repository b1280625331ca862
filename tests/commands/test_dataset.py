import shlex

import numpy as np
import pytest

from mapf_pz.commands.main import main
from mapf_pz.rl.demonstrations import load_dataset

SMALL = ["--planner", "pibt", "--num-agents", "2", "3", "--episodes", "5", "--shard-size", "3", "--max-steps", "60"]
MAPS = ["--maps", "random", "room", "--height", "8", "10", "--width", "8", "--seed", "4", "--no-solved-only"]


def run(capsys, *words):
    """Return the status and the lines of both outputs."""
    status = main(["dataset", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out.splitlines(), err.splitlines()


def shards(folder):
    return {file.name: file.read_bytes() for file in folder.glob("*.npz")}


def test_demonstrations_are_made(capsys, tmp_path):
    status, out, err = run(capsys, "make", tmp_path / "data", *SMALL, *MAPS)
    data = load_dataset(tmp_path / "data")
    assert (status, err) == (0, [])
    assert out == [f"{tmp_path / 'data'}: 10 demonstrations, {data.num_agent_steps} agent steps"]
    assert [d.num_agents for d in data] == [2] * 5 + [3] * 5
    assert {d.instance.grid.shape for d in data} == {(10, 8)}
    assert [d.seed for d in data] == [*range(4, 14)]


def test_the_command_of_the_card_makes_the_same(capsys, tmp_path):
    run(capsys, "make", tmp_path / "data", *SMALL, *MAPS, "--on-target", "restart", "--license", "CC0-1.0")
    card = (tmp_path / "data" / "README.md").read_text()
    command = next(line for line in card.splitlines() if line.startswith("mapf-pz"))
    again = shlex.split(command.replace(str(tmp_path / "data"), str(tmp_path / "again")))
    assert main(again[1:]) == 0
    assert shards(tmp_path / "again") == shards(tmp_path / "data")
    assert (tmp_path / "again" / "dataset.json").read_bytes() == (tmp_path / "data" / "dataset.json").read_bytes()


def test_a_command_is_repeated(capsys, tmp_path):
    words = ["make", tmp_path, *SMALL, *MAPS]
    run(capsys, *words)
    removed = min(tmp_path.glob("*.npz"))
    before = removed.read_bytes()
    removed.unlink()
    assert run(capsys, *words)[0] == 0
    assert removed.read_bytes() == before
    status, out, err = run(capsys, *words[:-1], "--seed", "9")
    assert (status, out, len(err)) == (1, [], 1)
    assert "contains demonstrations with other settings" in err[0]


def test_a_map(capsys, tmp_path):
    words = ["--map", "random-16-16-20", "--action-model", "cardinal", "--planner", "lacam:anytime=False"]
    status, _, err = run(capsys, "make", tmp_path, *words, "--num-agents", 10, "--episodes", 3)
    assert (status, err) == (0, [])
    data = load_dataset(tmp_path)
    assert len(data) == 3
    assert all(d.metrics["CSR"] == 1 for d in data)
    assert data.rules.action_model == "cardinal"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--planner", "best"], "planner 'best': expected one of"),
        (["--episodes", "0"], "episodes=0: expected a whole number, 1 or more"),
        (
            ["--seed", "999990", "--episodes", "11"],
            "seed=999990: expected at most 999989, since evaluations use the following seeds",
        ),
        (["--edge-weights", "random"], "edge_weights: expected a name or a file"),
        (["--height", "0"], "height=0: expected a whole number from 1"),
    ],
)
def test_invalid_settings(capsys, tmp_path, words, message):
    with pytest.raises(SystemExit) as stop:
        run(capsys, "make", tmp_path / "data", *words)
    assert stop.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--map", "none"], "mapf-pz dataset: "), (["--jobs", "0"], "mapf-pz dataset: jobs=0: expected")],
)
def test_invalid_options(capsys, tmp_path, words, message):
    status, out, err = run(capsys, "make", tmp_path / "data", *words)
    assert (status, out, len(err)) == (1, [], 1)
    assert err[0].startswith(message)


def test_a_damaged_file(capsys, tmp_path):
    run(capsys, "make", tmp_path / "data", *SMALL)
    file = min((tmp_path / "data").glob("*.npz"))
    file.write_bytes(file.read_bytes()[:-50])
    status, out, err = run(capsys, "export", tmp_path / "data", tmp_path / "steps")
    assert (status, out, len(err)) == (1, [], 1)
    assert err[0].startswith(f"mapf-pz dataset: {file}: expected an .npz file")


def test_export(capsys, tmp_path):
    torch = pytest.importorskip("torch")
    from tensordict import TensorDict

    run(capsys, "make", tmp_path / "data", *SMALL, *MAPS)
    words = ["--view-size", 3, 5, "--channels", "view", "goal", "--features", "time"]
    status, out, err = run(capsys, "export", tmp_path / "data", tmp_path / "steps", *words)
    data = load_dataset(tmp_path / "data")
    assert (status, err) == (0, [])
    groups = [(group[0].num_agents, int(group.num_steps.sum())) for group in data.groups()]
    assert out == [f"{tmp_path / 'steps' / f'agents-{n}'}: {steps} steps" for n, steps in groups]
    exported = TensorDict.load_memmap(tmp_path / "steps" / "agents-2")
    assert exported["agents", "observation", "image"].shape[1:] == (2, 2, 3, 5)
    expected = np.concatenate([d.actions for d in data if d.num_agents == 2])
    assert torch.equal(exported["agents", "action"], torch.from_numpy(expected.astype(np.int64)))
    assert run(capsys, "export", tmp_path / "data", tmp_path / "steps")[0] == 1
