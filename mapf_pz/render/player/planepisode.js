// Episodes of plan files.

// A plan without steps: all agents at their starts.
function standing(scenario, name) {
  const table = new PlanTable(scenario.starts.length, 0, false, name);
  scenario.starts.forEach(([row, col], agent) => table.set(agent, 0, row, col));
  return table;
}

function planEpisode(map, scenario, plan, texts, colors) {
  const name = (texts.plan ?? texts.scenario).name, goals = scenario?.goals ?? plan.goals;
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
  if (texts.plan && goals) episode.metrics = planCosts(episode);
  if (texts.plan) episode.violations = findViolations(episode, scenario?.starts);
  return episode;
}

function planCosts(episode) {
  const costs = Array.from({ length: episode.agents }, (_, agent) => Math.max(1, episode.restsFrom(agent)));
  return { SoC: costs.reduce((sum, cost) => sum + cost, 0), makespan: Math.max(...costs) };
}
