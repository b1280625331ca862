// Plan files of the League of Robot Runners.

const LORR_MODELS = {
  MAPF: { names: ["N/A"], moves: { U: [-1, 0], D: [1, 0], L: [0, -1], R: [0, 1], W: [0, 0] }, turns: null },
  MAPF_T: { names: ["E", "S", "W", "N"], moves: { F: null, W: [0, 0] }, turns: { F: 0, R: 1, C: 3, W: 0 } },
};

function parseLorrPlan(text, name) {
  let data;
  try { data = JSON.parse(text); } catch (error) { throw new FileError(name, `expected JSON: ${error.message}`); }
  const model = Object.hasOwn(LORR_MODELS, data.actionModel) ? LORR_MODELS[data.actionModel] : null;
  require(model, name, `expected 'actionModel' MAPF or MAPF_T, got ${shortened(data.actionModel)}`);
  const agents = data.teamSize, isCount = Number.isInteger(agents) && agents >= 1;
  require(isCount, name, `expected 'teamSize' to be a whole number, 1 or more, got ${shortened(agents)}`);
  for (const key of ["start", "actualPaths"]) {
    const isList = Array.isArray(data[key]) && data[key].length >= agents;
    require(isList, name, `expected '${key}' to be a list of at least ${agents}`);
  }
  const paths = data.actualPaths.slice(0, agents).map((path, agent) => lorrLetters(path, agent, model, name));
  const table = new PlanTable(agents, paths[0].length, model.turns !== null, name);
  paths.forEach((letters, agent) => {
    const steps = `expected ${table.steps} steps for agent ${agent}, as for agent 0`;
    require(letters.length === table.steps, name, `${steps}, got ${letters.length}`);
    const [row, col, heading] = Array.isArray(data.start[agent]) ? data.start[agent] : [];
    const facing = model.names.indexOf(heading), isStart = Number.isInteger(row) && Number.isInteger(col) && facing >= 0;
    const start = `expected the start of agent ${agent} to be [row, col, ${model.names.join(" or ")}]`;
    require(isStart, name, `${start}, got ${shortened(data.start[agent])}`);
    followLetters(table, agent, [row, col, facing], letters, model.moves, model.turns);
  });
  table.goals = lorrGoals(data, agents);
  return table;
}

function lorrLetters(path, agent, model, name) {
  require(typeof path === "string", name, `expected the path of agent ${agent} to be text, got ${shortened(path)}`);
  require(!path.startsWith("["), name, "paths in ticks are not read here, but by 'mapf-pz render --plan'");
  const letters = path === "" ? [] : path.split(","), known = model.turns ?? model.moves;
  const wrong = letters.findIndex((letter) => !Object.hasOwn(known, letter));
  const expected = `expected one of ${Object.keys(known).join("")} as step ${wrong + 1} of agent ${agent}`;
  require(wrong < 0, name, `${expected}, got ${shortened(letters[wrong])}`);
  return letters;
}

// The goals if each agent has one task with one errand, and all are finished; else null.
function lorrGoals(data, agents) {
  const schedule = data.events ?? data.actualSchedule;
  if (data.numTaskFinished !== agents || !Array.isArray(data.tasks) || !Array.isArray(schedule)) return null;
  const tasks = data.tasks.filter(Array.isArray);
  const errands = new Map(tasks.map((task) => [task[0], Array.isArray(task[2]) ? task[2] : task.slice(1)]));
  const goals = schedule.slice(0, agents).map((entry) => {
    const assigned = assignedTasks(entry);
    return assigned.length === 1 ? errands.get(assigned[0]) : undefined;
  });
  return goals.length === agents && goals.every((goal) => goal?.length === 2) ? goals : null;
}

// The tasks of an agent: `step:task,...` (2024) or a list of [task, step, "assigned" or "finished"] (2023).
function assignedTasks(entry) {
  if (typeof entry === "string") return entry.split(",").map((item) => Number(item.split(":")[1]));
  const events = Array.isArray(entry) ? entry.filter(Array.isArray) : [];
  return events.filter(([, , event]) => event === "assigned").map(([task]) => task);
}
