"""Episodes in which a planner acts."""


def play(env, planner, seed):
    """Play an episode, and yield the actions after each step: all agents act, and no move is blocked."""
    observations, _ = env.reset(seed=seed)
    while env.agents:
        actions = planner.act(observations)
        assert actions.keys() == observations.keys()
        observations, _, _, _, infos = env.step(actions)
        assert not any(info["blocked"] for info in infos.values())
        yield actions
