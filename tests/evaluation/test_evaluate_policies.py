import json

import pytest

from mapf_pz.errors import FormatError
from mapf_pz.evaluation import Episode, EvaluationTask, evaluate, policy_factory
from tests.evaluation.test_episodes import Right
from tests.helpers.text_instances import drawn

TASKS = (
    EvaluationTask("short", 1, {"max_steps": 6}, 2, instances=(drawn("a.A"),)),
    EvaluationTask("long", 1, {"max_steps": 6}, 1, instances=(drawn("a...A"),)),
)


def costs(episodes):
    return [(*episode.key, episode.metrics["SoC"]) for episode in episodes]


def test_every_policy_is_in_every_episode():
    episodes = evaluate({"one": Right(), "other": Right()}, TASKS)
    assert all(isinstance(episode, Episode) for episode in episodes)
    assert costs(episodes) == [
        ("one", "short", 1, 0, 2),
        ("one", "short", 1, 1, 2),
        ("other", "short", 1, 0, 2),
        ("other", "short", 1, 1, 2),
        ("one", "long", 1, 0, 4),
        ("other", "long", 1, 0, 4),
    ]


def test_policies_by_name_as_objects_and_as_factories():
    class Module(Right):
        """Can be called, as networks can."""

        def __call__(self):
            raise AssertionError("it makes nothing")

    policies = {"own": Right(), "by name": "pibt", "made": policy_factory("pibt", seed=4), "network": Module()}
    cardinal = TASKS[1].with_(keywords={"max_steps": 6, "action_model": "cardinal"})
    assert [cost[-1] for cost in costs(evaluate(policies, [cardinal]))] == [4] * 4


def test_one_name_and_several():
    assert {episode.policy for episode in evaluate(["pibt", "random"], TASKS)} == {"pibt", "random"}
    assert {episode.policy for episode in evaluate("pibt", TASKS)} == {"pibt"}


def test_seeds_follow_by_ones():
    seen = []

    class Sees(Right):
        env_kwargs = Right.env_kwargs | {"view_size": (5, 5)}

        def act(self, observations):
            seen.append(b"".join(value.tobytes() for value in observations.values()))
            return super().act(observations)

    task = EvaluationTask("drawn", 2, {"map": "empty-8-8", "num_agents": 2, "max_steps": 1}, 3, seed=10)
    evaluate({"sees": Sees()}, [task])
    first = seen[1:]  # without that before all episodes
    seen.clear()
    evaluate({"sees": Sees()}, [task.with_(seed=11)])
    assert seen[1:-1] == first[1:]
    assert len(set(first)) == 3


def test_a_suite_by_its_file(tmp_path):
    suite = {"tasks": [{"map": "empty-8-8", "num_agents": [1, 2], "episodes": 2, "max_steps": 30}]}
    (tmp_path / "mine.json").write_text(json.dumps(suite))
    for suite in (tmp_path / "mine.json", str(tmp_path / "mine.json")):
        assert [episode.key[1:] for episode in evaluate(["pibt"], suite)] == [
            ("empty-8-8", 1, 0),
            ("empty-8-8", 1, 1),
            ("empty-8-8", 2, 0),
            ("empty-8-8", 2, 1),
        ]


def test_progress_is_shown():
    shown = []
    done = evaluate({"right": Right()}, TASKS, show=lambda episode, left: shown.append((episode, left)))
    assert shown == list(zip([None, *done], [3, 2, 1, 0], strict=True))


def test_tasks_with_the_same_label_are_rejected(tmp_path):
    with pytest.raises(ValueError, match=r"^two tasks are named '1 agents on short': expected unique names$"):
        evaluate({"right": Right()}, [TASKS[0], TASKS[0].with_(seed=1)], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert len(evaluate({"right": Right()}, [TASKS[0], TASKS[0].with_(num_agents=2, instances=(drawn("ab.BA"),))])) == 4


@pytest.mark.parametrize(
    ("policies", "suite", "error", "message"),
    [
        (["nobody"], TASKS, ValueError, "policy 'nobody'"),
        (["pibt:depth=1"], TASKS, ValueError, "option 'depth=1'"),
        (["pibt"], "nothing", ValueError, "suite 'nothing'"),
        (["pibt"], "no.json", FileNotFoundError, "no.json"),
    ],
)
def test_errors_are_raised_before_the_first_episode(tmp_path, policies, suite, error, message):
    with pytest.raises(error, match=message):
        evaluate(policies, suite, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_errors_of_a_task_in_a_process():
    task = EvaluationTask("nowhere", 1, {"map": "nowhere"})
    with pytest.raises(ValueError, match=r"no .map file is named 'nowhere'"):
        evaluate(["pibt"], [task], jobs=2)


def test_a_malformed_file_of_a_policy_is_an_error(tmp_path):
    pytest.importorskip("torch")
    (tmp_path / "config.json").write_text("{")
    (tmp_path / "policy.safetensors").touch()
    with pytest.raises(FormatError, match=r"config\.json"):
        evaluate([str(tmp_path)], TASKS)
