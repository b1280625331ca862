"""An option that is given counts as given, also with the value that it has by default."""

from contextlib import suppress

import pytest

from mapf_pz.commands.main import main
from mapf_pz.planners.plans.files import read_plan

LIFELONG_CARDINAL = "--map random-16-16-20 --num-agents 20 --max-steps 12 --action-model cardinal"


def files_by_weights(folder, command, ending, status):
    """Return what a command of `lifelong-cardinal`, trained with `crisscross:0.7`, writes under edge weights."""
    pytest.importorskip("torchrl")
    files = {}
    for weights in ("", "uniform", "crisscross:0.7"):
        file = folder / f"episode{ending}"
        words = [*command.split(), *LIFELONG_CARDINAL.split(), *(["--edge-weights", weights] if weights else [])]
        assert main([words[0], str(file), *words[1:]]) == status
        files[weights] = file.read_bytes()
    return files


@pytest.mark.parametrize(
    ("command", "ending", "status"),
    [("render --policy lifelong-cardinal", ".svg", 0), ("solve --planner lifelong-cardinal --partial", ".json", 1)],
)
def test_uniform_weights_replace_those_of_the_policy(tmp_path, command, ending, status):
    files = files_by_weights(tmp_path, command, ending, status)
    assert files[""] == files["crisscross:0.7"] != files["uniform"]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("render out.html --policy pibt --view-size 5 5", "view_size: expected only with a trained policy"),
        ("render out.html --policy pibt --no-see-through-walls", "see_through_walls: expected only with a trained"),
        ("play --policy pibt --num-frames 1", "num_frames: expected only with a trained policy"),
        ("guidance evaluate --edge-weights uniform", "edge_weights: expected --graphs"),
        ("guidance evaluate --reward report", "reward: expected that of the environment"),
        ("guidance evaluate --channels view goal orientation edge_weights", "channels: expected only with a trained"),
        ("guidance evaluate --planner mappo-cardinal --action-model rotate", "requires action_model='cardinal', got"),
        ("dataset make out --map empty-8-8 --maps random", "maps: not allowed together with map"),
        ("dataset make out --scenario random-1 --map empty-8-8 --height 12", "height: not allowed together with map"),
        ("train quickstart --map empty-8-8 --maps random", "maps: not allowed together with map"),
        ("train quickstart --map empty-8-8 --height 12", "height: not allowed together with map"),
        ("train quickstart --scenario warehouse_small_10 --density 0.3", "density: not allowed together with scenario"),
        ("train report --maps random", "maps: not allowed together with map"),
        ("train quickstart --reward progress --goal 0", "goal: not allowed together with reward='progress'"),
    ],
)
def test_a_default_value_is_refused_like_others(tmp_path, monkeypatch, capsys, command, message):
    if "train" in command or "mappo" in command:
        pytest.importorskip("torchrl")
    monkeypatch.setattr("mapf_pz.commands.train._train", lambda run: None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    with suppress(SystemExit):  # refused while options are parsed
        assert main(command.split()) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_policy_determines_the_action_model_that_is_not_given(capsys):
    pytest.importorskip("torchrl")
    words = "--planner mappo-cardinal --map empty-8-8 --num-agents 4 --max-steps 9 --num-seeds 1 --graphs uniform"
    assert main(["guidance", "evaluate", *words.split()]) == 0


def test_terms_change_the_default_reward(capsys, monkeypatch):
    pytest.importorskip("torchrl")
    configs = []
    monkeypatch.setattr("mapf_pz.commands.train._train", lambda run: configs.append(run.config))
    for words in ([], ["--goal", "3"], ["--reward", "report"], ["--density", "0.1"]):
        assert main(["train", "quickstart", *words]) == 0
    plain, goal, named, density = (config.task for config in configs)
    assert plain.env.reward_config.progress == goal.env.reward_config.progress > 0
    assert (goal.env.reward_config.goal, named.env.reward) == (3, "report")
    assert (density.mixture.density, density.mixture.height) == (0.1, plain.mixture.height)


def test_headings_are_given_as_numbers(tmp_path):
    words = ["--map", "empty-8-8", "--num-agents", "3", "--planner", "pibt", "--initial-heading", "3", "0", "2"]
    assert main(["solve", str(tmp_path / "plan.json"), *words]) == 0
    assert read_plan(tmp_path / "plan.json").plan.headings[0].tolist() == [3, 0, 2]
