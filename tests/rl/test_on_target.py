"""Training on lifelong episodes, and on episodes that agents leave one by one."""

import dataclasses

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv

import mapf_pz
from mapf_pz.commands.main import main
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.rl import BatchedMapfEnv, load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.ranks import Ranks
from mapf_pz.rl.training.episodes import episode_means
from mapf_pz.rl.training.train import resume
from mapf_pz.rl.training.validation import Validation
from tests.helpers.small_run import TINY, changed, rows

ALGORITHM_NAMES = ["mappo", "ippo", "central-ppo"]


def on(on_target, **fields):
    task = changed(TINY.task, on_target=on_target)
    return dataclasses.replace(TINY, task=task, **{"validation_interval": 192, "validation_episodes": 60} | fields)


@pytest.mark.parametrize("algorithm", ALGORITHM_NAMES)
def test_a_lifelong_policy_is_trained_resumed_and_evaluated(tmp_path, algorithm):
    folder = train(on("restart", algorithm=algorithm, agent_steps=192), tmp_path)
    resume(folder, agent_steps=576)
    last = rows(folder)[-1]
    assert not {"CSR", "ISR", "validation_CSR"} & last.keys()
    assert float(last["validation_throughput"]) > 0
    assert float(last["throughput"]) >= 0
    task = EvaluationTask("empty", 3, {"map": "empty-8-8", "max_steps": 8, "on_target": "restart"}, episodes=2)
    for episode in evaluate({"it": load_policy(folder)}, [task]):
        assert "avg_throughput" in episode.metrics


@pytest.mark.parametrize("algorithm", ALGORITHM_NAMES)
def test_policies_of_agents_that_leave_are_trained(tmp_path, algorithm):
    last = rows(train(on("finish", algorithm=algorithm, agent_steps=384), tmp_path))[-1]
    assert 0 < float(last["validation_ISR"]) <= 1


def test_the_command_trains_evaluates_and_renders_under_the_rules_of_the_task(tmp_path, capsys):
    suite = tmp_path / "suite.json"
    suite.write_text('{"tasks": [{"random": [7, 7, 0.1], "num_agents": 2, "max_steps": 4, "episodes": 2}]}')
    small = "--num-envs 4 --steps-per-batch 8 --num-epochs 1 --num-agents 3 --height 7 --width 7 --agent-steps 100"
    words = ["--on-target", "restart", "--evaluate", str(suite), "--output", str(tmp_path / "run")]
    assert main(["train", "quickstart", *small.split(), *words]) == 0
    assert "avg_throughput" in capsys.readouterr().out.splitlines()[-1]
    assert (tmp_path / "run" / "episode.gif").stat().st_size > 0


def test_throughput_counts_the_goals_of_all_agents_per_step():
    task = changed(TINY.task, on_target="restart")
    env = BatchedMapfEnv(5, **task.env_keywords())
    single = mapf_pz.parallel_env(**task.env_keywords())
    env.set_seed(0)
    torch.manual_seed(0)
    rollout = env.rollout(task.env.max_steps)
    rollout["next", "agents", "episode_reward"] = torch.zeros(*rollout.shape, 3, 1)
    expected = 0.0
    for b in range(5):
        single.reset(seed=b)
        for actions in rollout["agents", "action"][b].tolist():
            single.step({f"agent_{i}": action for i, action in enumerate(actions)})
        expected += single.metrics()["avg_throughput"] / 5
    found = episode_means(task, rollout["next"][rollout["next", "done"].squeeze(-1)])
    assert found["episodes"] == 5
    assert expected > 0
    assert found["throughput"] == pytest.approx(expected)


def test_agents_that_have_left_count_as_arrived():
    config = on("finish", validation_episodes=30)
    found = Validation(ALGORITHMS["mappo"](config), config, Ranks()).measure()
    assert found["validation_ISR"] >= found["validation_CSR"]
    assert found["validation_ISR"] > 0.05


def collect(config, steps=40):
    torch.manual_seed(0)
    algorithm = ALGORITHMS[config.algorithm](config)
    env = TransformedEnv(BatchedMapfEnv(4, **config.task.env_keywords()), Compose(*algorithm.transforms(0)))
    env.set_seed(0)
    with torch.no_grad():
        batch = env.rollout(steps, algorithm.actor, break_when_any_done=False)
    assert not batch["agents", "active"].all()
    return algorithm, batch


@pytest.mark.parametrize("algorithm", ALGORITHM_NAMES)
def test_steps_after_an_agent_has_disappeared_are_not_learned_from(algorithm):
    """Whatever is in those steps, the update is the same."""
    config = on("finish", algorithm=algorithm)
    config = dataclasses.replace(
        config, optimization=dataclasses.replace(config.optimization, steps_per_batch=40, minibatch_size=64)
    )
    weights = []
    for spoil in (False, True):
        made, batch = collect(config)
        gone = ~batch["agents", "active"]
        if spoil:
            batch["next", "agents", "reward"] += 100.0 * gone
            log_prob = batch["team" if algorithm == "central-ppo" else "agents", "action_log_prob"]
            log_prob += 1.0 * gone.squeeze(-1)
        torch.manual_seed(1)
        made.make_learner().learn(batch, 0)
        weights.append(torch.cat([weight.flatten() for weight in made.loss.parameters()]))
    torch.testing.assert_close(weights[0], weights[1], rtol=0, atol=0)


def test_the_value_of_disappearing_is_the_last_reward():
    config = dataclasses.replace(on("finish"), optimization=dataclasses.replace(TINY.optimization, steps_per_batch=40))
    made, batch = collect(config)
    left = batch["agents", "active"] & ~batch["next", "agents", "active"]
    made.make_learner().learn(batch, 0)
    target = batch["value_target"]
    assert left.any()
    torch.testing.assert_close(target[left], batch["next", "agents", "reward"][left])
