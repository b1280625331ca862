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
  table.goals = lorrGoals(data, agents, name);
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
function lorrGoals(data, agents, name) {
  const key = data.version === undefined || data.version === null ? "events" : "actualSchedule";
  const isEmpty = Array.isArray(data[key]) && !data[key].length;
  if (!("tasks" in data) || !(key in data) || isEmpty) return null;
  for (const [each, least] of [["tasks", 0], [key, agents]]) {
    const isList = Array.isArray(data[each]) && data[each].length >= least;
    require(isList, name, `expected '${each}' to be a list of at least ${least}`);
  }
  const errands = new Map(data.tasks.map((task) => lorrTask(task, name)));
  const assigned = data[key].slice(0, agents).map((entry, agent) => assignedTasks(entry, agent, key, name));
  const goals = assigned.map((tasks) => (tasks.length === 1 ? errands.get(tasks[0]) : undefined));
  return data.numTaskFinished === agents && goals.every((goal) => goal?.length === 2) ? goals : null;
}

// The number and the errands [row, column, row, ...] of a task.
function lorrTask(task, name) {
  const [number, ...rest] = Array.isArray(task) ? task : [], cells = Array.isArray(rest[1]) ? rest[1] : rest;
  const isTask = [number, rest[0], ...cells].every(Number.isInteger) && rest.length === 2 && cells.length % 2 === 0;
  require(isTask, name, `expected a task [task, row, col] or [task, step, [row, col, ...]], got ${shortened(task)}`);
  return [number, cells];
}

// The tasks of an agent: [task, step, "assigned" or "finished"] (2023) or "step:task,..." (2024).
function assignedTasks(entry, agent, key, name) {
  if (key === "actualSchedule") {
    const isSchedule = typeof entry === "string" && /^(\d{1,9}:-?\d{1,9}(,|$))*$/.test(entry);
    require(isSchedule, name, `expected the schedule of agent ${agent} to be 'step:task,...', got ${shortened(entry)}`);
    return entry.split(",").filter(Boolean).map((item) => Number(item.split(":")[1]));
  }
  const isEvent = (event) => Array.isArray(event) && event.length === 3 && [event[0], event[1]].every(Number.isInteger)
    && ["assigned", "finished"].includes(event[2]);
  const expected = `expected events of agent ${agent} to be [task, step, assigned or finished]`;
  require(Array.isArray(entry) && entry.every(isEvent), name, `${expected}, got ${shortened(entry)}`);
  return entry.filter(([, , event]) => event === "assigned").map(([task]) => task);
}
