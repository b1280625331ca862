// All violations of the rules in an episode that was read from a plan file, as `mapf-pz validate` finds them.

const ROW_STRIDE = 2 ** 26; // larger than any column, so that cells have different numbers, also outside the map

function findViolations(episode, starts) {
  const found = [];
  for (let agent = 0; agent < episode.agents; agent++) {
    const add = (step, rule) => found.push(violation(episode, step, [agent], rule));
    if (starts && !sameCell(episode.cell(agent, 0), starts[agent])) add(0, "not the instance's start");
    for (let step = 0; step <= episode.steps; step++) {
      if (!episode.isFree(...episode.cell(agent, step))) add(step, "an obstacle, or outside the map");
      if (step > 0) checkMove(episode, agent, step, add);
    }
    if (episode.hasGoals() && !episode.isAtGoal(agent, episode.steps)) add(episode.steps, "not the agent's goal");
  }
  for (let step = 0, before = new Map(); step <= episode.steps; step++) before = checkPairs(episode, step, before, found);
  return found.sort((a, b) => a.step - b.step || a.agents[0] - b.agents[0]);
}

function checkMove(episode, agent, step, add) {
  const [from, to] = [episode.cell(agent, step - 1), episode.cell(agent, step)], moved = !sameCell(from, to);
  let allowed = Math.abs(from[0] - to[0]) + Math.abs(from[1] - to[1]) <= 1;
  if (episode.headings) {
    const [heading, next] = [step - 1, step].map((each) => episode.headings[episode.index(agent, each)]);
    const [down, right] = HEADING_STEPS[heading], turn = (next - heading + 4) % 4;
    allowed = !moved || sameCell(to, [from[0] + down, from[1] + right]);
    if (turn === 2 || (turn && moved)) add(step, "more than a quarter turn, or a turn during a move");
  }
  if (!allowed) add(step, "not a move to an adjacent cell, or not straight ahead");
}

// Finds agents on one cell, and swaps, given which agents were on each cell before; returns the same for this step.
function checkPairs(episode, step, before, found) {
  const here = new Map();
  for (let agent = 0; agent < episode.agents; agent++) {
    const cell = episode.cell(agent, step), key = cell[0] * ROW_STRIDE + cell[1], others = here.get(key);
    if (others) found.push(violation(episode, step, [others[0], agent], "two agents on one cell"));
    if (others) others.push(agent); else here.set(key, [agent]);
    for (const other of before.get(key) ?? []) {
      const from = episode.cell(agent, step - 1);
      if (other < agent && !sameCell(from, cell) && sameCell(episode.cell(other, step), from))
        found.push(violation(episode, step, [other, agent], "two agents swap cells"));
    }
  }
  return here;
}

function violation(episode, step, agents, rule) {
  const who = agents.map((agent) => `agent ${agent}`).join(" and ");
  const places = agents.map((agent) => episode.cell(agent, step)).map(([row, col]) => `[row ${row}, col ${col}]`);
  return { step, agents, text: `step ${step}: ${who} at ${[...new Set(places)].join(" and ")}: ${rule}` };
}
