import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv, check_env_specs

import mapf_pz
from mapf_pz.rl import BatchedMapfEnv
from mapf_pz.rl.environments.centralize import Centralize
from mapf_pz.wrappers import CentralizedEnv


@pytest.mark.parametrize("features", [(), ("goal_vector",)])
@pytest.mark.parametrize("mode", ["argmax", "affine", "sigmoid", "softmax"])
def test_specs_hold(mode, features):
    check_env_specs(
        TransformedEnv(BatchedMapfEnv(3, num_agents=4, max_steps=6, features=features), Centralize(4, mode))
    )


def test_a_row_is_the_gymnasium_form():
    keywords = {"num_agents": 3, "max_steps": 8, "reward": "progress", "features": ("time",)}
    base = BatchedMapfEnv(2, **keywords)
    base.set_seed(7)
    team = TransformedEnv(base, Centralize(num_actions=4))
    now = team.reset()
    single = CentralizedEnv(mapf_pz.parallel_env(**keywords), team_reward="mean")
    seen, _ = single.reset(seed=8)
    rng = np.random.default_rng(0)
    for _ in range(8):
        assert np.array_equal(seen["image"], now["team", "image"][1].numpy())
        assert np.array_equal(seen["features"], now["team", "features"][1].numpy())
        values = rng.uniform(-1, 1, (2, 3, 4)).astype(np.float32)
        now["team", "action"] = torch.from_numpy(values)
        now = team.step(now)["next"]
        seen, reward, terminated, truncated, _ = single.step(values[1])
        assert reward == pytest.approx(now["team", "reward"][1].item(), abs=1e-6)
        assert (terminated, truncated) == (now["terminated"][1].item(), now["truncated"][1].item())
        if terminated or truncated:
            break


def test_unknown_mode_is_named():
    with pytest.raises(ValueError, match="action_mode='max': expected one of 'argmax'"):
        Centralize(4, "max")
