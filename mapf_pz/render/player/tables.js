// The tables of the panel, with a column of values for each episode.

const METRICS = {
  CSR: "1 if all agents are at their goals at the end",
  ISR: "fraction of agents at their goals at the end",
  SoC: "sum of costs: over agents, the step since which they have been at their goals, at least 1, or all steps",
  makespan: "largest cost of an agent",
  ep_length: "number of steps",
  SoC_ratio: "sum of costs divided by the sum of the shortest paths",
  weighted_cost: "sum of costs in the weights of the guidance graph",
  weighted_cost_ratio: "weighted cost divided by the sum of the costs of the cheapest paths",
  delay_share: "fraction of the steps of agents on the map in which they were delayed",
  delayed_SoC_ratio: "sum of costs divided by its value if each agent were alone, with its delays",
  avg_throughput: "goals reached per step",
  exhausted_agents: "agents that have reached all goals of their sequence",
};

function fillTable(table, rows, captions) {
  const shown = rows.filter(([, values]) => values.some((value) => value !== undefined));
  const head = captions.length > 1 && shown.length ? [line("", captions)] : [];
  for (const row of head) row.className = "captions";
  table.replaceChildren(...head, ...shown.map(([name, values, title]) => line(name, values, title)));
}

function line(name, values, title) {
  const row = document.createElement("tr"), label = document.createElement("th");
  label.textContent = name;
  label.scope = "row";
  if (title) label.title = title;
  row.append(label, ...values.map((value) => {
    const cell = document.createElement("td");
    cell.textContent = value ?? "–";
    if (name === "blocked by") cell.className = "refused";
    return cell;
  }));
  return row;
}

// Rows of all names in some objects, in order of their first appearance.
function rowsOf(objects, titles = {}) {
  const names = [...new Set(objects.flatMap((object) => Object.keys(object)))];
  return names.map((name) => [name, objects.map((object) => object[name]), titles[name]]);
}

function presentRows(episodes, time) {
  return rowsOf(episodes.map((episode) => {
    const step = Math.floor(Math.min(time, episode.steps)), facts = {};
    if (episode.lifelong && episode.hasGoals()) facts["goals reached so far"] = episode.numReached[step];
    else if (episode.hasGoals()) facts["at their goals"] = `${episode.numAtGoal[step]} of ${episode.agents}`;
    if (episode.hasBlocked) facts["moves blocked"] = episode.numBlocked[step];
    if (episode.delayed) facts["agents delayed"] = episode.numDelayed[step];
    if (episode.numActive[episode.steps] < episode.agents) facts["agents on the map"] = episode.numActive[step];
    return facts;
  }));
}

function agentRows(episodes, agent, time) {
  return rowsOf(episodes.map((episode) => {
    const step = Math.floor(Math.min(time, episode.steps));
    return agent < episode.agents ? agentFacts(episode, agent, step) : {};
  }));
}

function agentFacts(episode, agent, step) {
  const i = episode.index(agent, step), facts = { "row, column": episode.cell(agent, step).join(", ") };
  if (episode.headings) facts.heading = HEADINGS[episode.headings[i]];
  if (episode.hasGoals()) facts.goal = episode.goal(agent, step).join(", ");
  if (episode.hasGoals()) facts["at its goal"] = episode.isAtGoal(agent, step) ? "yes" : "no";
  if (episode.actions && step > 0) facts["last action"] = actionName(episode, agent, step);
  if (episode.hasBlocked && episode.isBlocked(agent, step))
    facts["blocked by"] = episode.actions && episode.collisionSystem ? blockedBecause(episode, agent, step) : "yes";
  if (episode.delayed && step > 0) facts.delayed = episode.isDelayed(agent, step) ? "yes" : "no";
  if (episode.leader(agent, step) >= 0) facts["waits for"] = `agent ${episode.leader(agent, step)}`;
  if (episode.rewards && step > 0) facts.reward = shortNumber(episode.rewards[i]);
  return facts;
}

function finalRows(episodes) {
  const all = episodes.map((episode) => ({
    agents: episode.agents, steps: episode.steps,
    ...Object.fromEntries(Object.entries(episode.metrics).map(([name, value]) => [name, shortNumber(value)])),
  }));
  return rowsOf(all, METRICS);
}

function shortNumber(value) { return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(4))); }
