// Episodes of plan files.

// The episode of a plan: `scenario` has the starts and goals of agents; null: they are those of the plan. `name`: that of
// the plan's file.
function planEpisode(map, scenario, plan, name, colors) {
  const goals = scenario?.goals ?? plan.goals, starts = scenario?.starts.length ?? plan.agents;
  require(plan.agents <= starts, name, `expected at most ${starts} agents, as in scenario '${scenario?.name}', got ${plan.agents}`);
  const data = {
    ...plan, width: map.width, height: map.height, free: map.free, colors, caption: name,
    title: `${name}: ${map.name}, ${plan.agents} agents`, metrics: {}, lifelong: false, hasBlocked: false,
    facts: {}, planes: [], observers: 0, viewSize: [0, 0], violations: null,
  };
  const arrays = { flags: new Uint8Array(plan.rows.length).fill(ACTIVE) };
  if (goals) {
    const each = (part) => Int32Array.from(plan.rows, (_, i) => goals[Math.floor(i / (plan.steps + 1))][part]);
    Object.assign(arrays, { goalRows: each(0), goalCols: each(1) });
  }
  const episode = new Episode(data, arrays);
  if (goals) episode.metrics = planCosts(episode);
  episode.violations = findViolations(episode, scenario?.starts);
  return episode;
}

function planCosts(episode) {
  const costs = Array.from({ length: episode.agents }, (_, agent) => Math.max(1, episode.restsFrom(agent)));
  return { SoC: costs.reduce((sum, cost) => sum + cost, 0), makespan: Math.max(...costs) };
}
