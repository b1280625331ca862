"""Several processes that train together."""

import dataclasses
import math
import os
import signal
import subprocess
import sys
from contextlib import nullcontext
from multiprocessing import active_children

import pytest
import torch

from mapf_pz.commands.main import main
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import ImitationConfig
from mapf_pz.rl.config_file import CONFIG, load_config
from mapf_pz.rl.policies.folder import WEIGHTS
from mapf_pz.rl.ranks import Ranks
from mapf_pz.rl.training.checkpoint import Checkpoints, read_position
from mapf_pz.rl.training.launch import connecting
from mapf_pz.rl.training.train import resume
from tests.evaluation.test_parallel import children_of, is_alive, wait_for
from tests.helpers.small_run import TINY, rows, untimed

pytestmark = pytest.mark.usefixtures("forked_processes")

PAIR = dataclasses.replace(TINY, num_learners=2, checkpoint_interval=1)
PER_UPDATE = 4 * 16 * 3
SMALL = "--num-envs 4 --steps-per-batch 8 --minibatch-size 8 --num-epochs 1 --num-agents 3 --height 7 --width 7"
LONG = f"train quickstart {SMALL} --agent-steps 400000 --checkpoint-interval 1 --evaluate none"


def exchange_and_fail(ranks):
    """Do what the test of the operations does in rank 0, and end."""
    operations(ranks)
    os._exit(3)


def operations(ranks):
    tensors = [torch.full((2,), float(ranks.rank)), torch.tensor([[1.0 + ranks.rank]])]
    ranks.average(tensors)
    return (
        [tensor.tolist() for tensor in tensors],
        ranks.from_first({"rank": ranks.rank}),
        ranks.gather({"a": ranks.rank, "b": 0.5}),
        ranks.mean({"n": 3.0 * ranks.rank, "a": 7.0 if ranks.rank else math.nan}, weight="n"),
        ranks.mean({"n": 0.0, "a": math.nan}, weight="n"),
        ranks.mean({"n": 1.0 + ranks.rank, "a": 6.0 * ranks.rank}, weight="n"),
        ranks.mean({"a": ranks.rank}),
        ranks.mean({}),
        ranks.any(ranks.rank == 1),
        ranks.any(False),
    )


def exchange_until_the_other_fails(results):
    with connecting(2, exchange_and_fail) as ranks:
        assert (ranks.rank, ranks.size) == (0, 2)
        results += operations(ranks)
        ranks.gather({"a": 0.0})


def test_two_ranks_exchange_numbers_until_one_fails():
    results = []
    with pytest.raises(ChildProcessError, match=r"^learner 1 of 2 \(from 0\) has ended: exit status 3$"):
        exchange_until_the_other_fails(results)
    tensors, first, gathered, one_weight, no_weight, weighted, mean, nothing, some, none = results
    assert tensors == [[0.5, 0.5], [[1.5]]]
    assert first == {"rank": 0}
    assert gathered == [{"a": 0, "b": 0.5}, {"a": 1, "b": 0.5}]
    assert one_weight == {"n": 3.0, "a": 7.0}
    assert no_weight["n"] == 0
    assert math.isnan(no_weight["a"])
    assert weighted == {"n": 3.0, "a": 4.0}
    assert mean == {"a": 0.5}
    assert nothing == {}
    assert (some, none) == (True, False)


def test_a_single_process_exchanges_with_itself():
    tensor, row = torch.tensor([2.0]), {"n": 0.0, "a": 1.5}
    Ranks().average([tensor])
    assert tensor == 2
    assert Ranks().gather(row) == [row]
    assert Ranks().mean(row, weight="n") == row
    assert Ranks().from_first(row) is row


def test_a_seed_decides_a_run_of_several_learners(tmp_path):
    imitation = ImitationConfig(expert="pibt", buffer_size=501)
    config = dataclasses.replace(PAIR, algorithm="dagger", imitation=imitation, agent_steps=2 * PER_UPDATE)
    runs = [train(config, tmp_path / name) for name in "ab"]
    assert untimed(runs[0]) == untimed(runs[1])
    assert (runs[0] / WEIGHTS).read_bytes() == (runs[1] / WEIGHTS).read_bytes()
    assert [int(row["agent_steps"]) for row in rows(runs[0])] == [PER_UPDATE, 2 * PER_UPDATE]
    assert load_policy(runs[0]).config == config


class Comparing(ALGORITHMS["mappo"]):
    """Reports by how much the weights of the ranks differ after an update, and the seeds of their environments."""

    def make_learner(self):
        learner = super().make_learner()
        learn, network = learner.learn, self.network

        def learn_and_compare(batch, done):
            losses = learn(batch, done)
            total = sum(parameter.detach().double().sum() for parameter in network.parameters())
            totals = [row["total"] for row in learner.ranks.gather({"total": float(total)})]
            return losses | {"spread": max(totals) - min(totals), "environments": float(batch.shape[0])}

        learner.learn = learn_and_compare
        return learner


def test_learners_divide_the_environments_of_one_and_have_the_same_weights(tmp_path):
    # The policy's first batch is the same function of the instances, but other actions are sampled.
    seen = []
    for number in (1, 2):
        config = dataclasses.replace(PAIR, agent_steps=2 * PER_UPDATE, num_learners=number, validation_interval=1)
        _, row = rows(train(config, tmp_path / str(number), make_algorithm=Comparing))
        seen.append(row)
    assert seen[0].keys() == seen[1].keys()
    assert seen[0]["episodes"] == seen[1]["episodes"] == "8"  # two of each environment start in the first update
    assert (seen[1]["spread"], seen[1]["environments"]) == ("0", "2")


def test_a_run_continues_after_a_kill_and_with_another_number_of_learners(tmp_path):
    def kill_the_other(row):
        if row["agent_steps"] == 2 * PER_UPDATE:
            active_children()[0].kill()

    def interrupt(_row):
        raise KeyboardInterrupt

    config = dataclasses.replace(PAIR, agent_steps=5 * PER_UPDATE)
    with pytest.raises(ChildProcessError, match=r"^learner 1 of 2 \(from 0\) has ended: killed by SIGKILL"):
        train(config, tmp_path, kill_the_other)
    assert read_position(Checkpoints(tmp_path).latest()).updates == 2
    for updates, number in ((3, 2), (4, 1), (5, 2)):
        before = rows(tmp_path)[: updates - 1]
        with nullcontext() if updates == 5 else pytest.raises(KeyboardInterrupt):
            resume(tmp_path, on_progress=interrupt if updates < 5 else None, num_learners=number)
        assert rows(tmp_path)[:-1] == before
        assert len(rows(tmp_path)) == updates
        assert load_config(tmp_path / CONFIG).num_learners == number
    assert active_children() == []


@pytest.mark.slow
def test_an_interrupt_ends_all_learners(tmp_path):
    # The kernels are compiled and cached by the same training here, so that the processes print nothing about it.
    assert main([*LONG.replace("400000", "96").split(), "--output", str(tmp_path / "first")]) == 0
    words = [sys.executable, "-m", "mapf_pz", *LONG.split(), "--num-learners", "2", "--output", str(tmp_path / "run")]
    running = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    progress = tmp_path / "run" / "progress.csv"
    wait_for(lambda: running.poll() is not None or (progress.exists() and len(progress.read_text().splitlines()) > 3))
    others = children_of(running.pid)
    os.killpg(running.pid, signal.SIGINT)
    _, errors = running.communicate()
    assert (running.returncode, errors) == (130, "mapf-pz train: interrupted\n")
    wait_for(lambda: not any(map(is_alive, others)))
    assert read_position(Checkpoints(tmp_path / "run").latest()).updates == len(rows(tmp_path / "run"))


@pytest.mark.slow
def test_torchrun_trains_like_processes_that_are_started_here(tmp_path):
    words = [*LONG.replace("400000", "288").split(), "--curiosity", "rnd"]
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "mapf_pz"]
    subprocess.run([*launch, *words, "--output", str(tmp_path / "a")], check=True, capture_output=True)
    assert main([*words, "--num-learners", "2", "--output", str(tmp_path / "b")]) == 0
    assert (tmp_path / "a" / WEIGHTS).read_bytes() == (tmp_path / "b" / WEIGHTS).read_bytes()
    assert untimed(tmp_path / "a") == untimed(tmp_path / "b")
    assert load_config(tmp_path / "a" / CONFIG) == load_config(tmp_path / "b" / CONFIG)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"num_learners": 0}, "num_learners=0: expected a whole number, 1 or more, or 'auto'"),
        ({"num_learners": 3}, "num_envs=4: expected a multiple of num_learners=3"),
        ({"num_learners": 4, "validation_episodes": 3}, "validation_episodes=3: expected num_learners=4 or more"),
        (
            {"collector": "processes", "num_workers": 4},
            "num_envs=4: expected a multiple of num_workers=4 for each of 2 learners",
        ),
    ],
)
def test_a_batch_that_cannot_be_divided_is_refused(fields, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        dataclasses.replace(PAIR, **fields)


@pytest.mark.parametrize(("cores", "learners"), [(1, 1), (2, 2), (3, 2), (4, 4), (64, 4)])
def test_automatically_as_many_learners_as_can_divide_a_batch(cores, learners):
    config = dataclasses.replace(TINY, num_learners="auto").with_learners(cores)
    assert config == dataclasses.replace(TINY, num_learners=learners)
    share = config.share(learners)
    assert share.num_updates == config.num_updates
    assert share.steps_per_update * learners == config.steps_per_update
    assert share.optimization.minibatch_size * learners == config.optimization.minibatch_size
