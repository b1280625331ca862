import mapf_pz
from mapf_pz.evaluate.run import Trial, play, run_episodes
from mapf_pz.types import Action

CORRIDOR = "....."


class Forward:
    """Drives forward, and counts the episodes."""

    env_kwargs = {"initial_heading": "east", "view_size": (1, 3)}  # noqa: RUF012

    def __init__(self):
        self.episodes = 0

    def act(self, observations):
        return dict.fromkeys(observations, int(Action.FORWARD))

    def reset_states(self):
        self.episodes += 1


def one_agent(max_steps):
    scenario = mapf_pz.Scenario([[0, 0]], [[0, 4]])
    keywords = {"map": CORRIDOR + "\n", "scenario": scenario, "num_agents": 1, "max_steps": max_steps}
    return Trial("corridor", keywords, episodes=3)


def test_metrics_of_each_episode():
    policy = Forward()
    episodes = list(run_episodes(policy, one_agent(max_steps=10)))
    assert policy.episodes == 3
    for episode in episodes:
        assert (episode["CSR"], episode["SoC"], episode["makespan"], episode["SoC_ratio"]) == (1, 4, 4, 1)
        assert episode["runtime"] >= 0


def test_time_limit_counts_as_unsolved():
    (episode, *_) = run_episodes(Forward(), one_agent(max_steps=3))
    assert (episode["CSR"], episode["ISR"], episode["ep_length"]) == (0, 0, 3)


def test_play_yields_the_beginning_and_each_step():
    trial = one_agent(max_steps=10)
    policy = Forward()
    env = trial.make_env(policy)
    columns = [env.positions[0, 1] for _ in play(env, policy, seed=0)]
    assert columns == [0, 1, 2, 3, 4]
