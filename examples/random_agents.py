"""Run an episode with random legal actions, and print its metrics."""

import mapf_pz

env = mapf_pz.parallel_env(map="random-12-12-15", num_agents=4, max_steps=100)
_, infos = env.reset(seed=0)
env.action_space("agent_0").seed(0)  # one space for all agents
while env.agents:
    actions = {agent: int(env.action_space(agent).sample(infos[agent]["action_mask"])) for agent in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
print(env.metrics())
