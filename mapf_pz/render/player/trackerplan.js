// CSV files of the MAPF tracker: several plans, one in each row, without starts. `u` is a LARGER row.

const TRACKER_MOVES = { u: [1, 0], d: [-1, 0], l: [0, -1], r: [0, 1], w: [0, 0] };

function parseTrackerPlan(text, name, scenario) {
  const [header, ...records] = csvRecords(text, name);
  const plans = records.map((fields) => Object.fromEntries(header.map((column, k) => [column, fields[k]])));
  require(header.includes("agents"), name, "expected the columns agents and solution_plan or path", 1);
  require(scenario, name, "expected a scenario to be given, as this file does not contain the starts");
  const named = /.+-(even|random)-\d+$/.test(scenario.name) ? scenario.name : "";
  const found = plans.filter((plan) => !named || ["", named].includes(scenarioName(plan)));
  if (found.length !== 1) {
    const there = plans.slice(0, 5).map((plan) => `${scenarioName(plan)} ${plan.agents}`.trim()).join(", ");
    const expected = `expected one plan${named && ` of ${named}`}, got ${found.length}`;
    throw new FileError(name, `${expected}: the file has plans for ${there || "no agents"}`);
  }
  const letters = linesOf(found[0].solution_plan ?? found[0].path ?? ""), agents = Number(found[0].agents);
  require(letters.length === agents, name, `expected a line for each of ${found[0].agents} agents, got ${letters.length}`);
  const known = scenario.starts.length;
  require(agents <= known, name, `expected a scenario of ${agents} agents, got ${known}`);
  const table = new PlanTable(agents, Math.max(...letters.map((word) => word.length)), false, name);
  letters.forEach((word, agent) => {
    const wrong = word.search(/[^udlrw]/);
    const expected = `expected one of udlrw as step ${wrong + 1} of agent ${agent}`;
    require(wrong < 0, name, `${expected}, got ${shortened(word[wrong])}`);
    followLetters(table, agent, scenario.starts[agent], word, TRACKER_MOVES, null);
  });
  return table;
}

function scenarioName(plan) {
  const parts = [plan.map_name, plan.scen_type, plan.type_id];
  return parts.every(Boolean) ? parts.join("-") : "";
}

// The records of a CSV text; quoted fields may hold line ends.
function csvRecords(text, name) {
  const field = /(?:"([^"]*)"|([^",\r\n]*))(,|\r?\n|$)/y, records = [];
  let fields = [];
  while (field.lastIndex < text.length) {
    const start = field.lastIndex, match = field.exec(text);
    const expected = "expected a quoted field, or a field without quotes in it";
    require(match, name, expected, text.slice(0, start).split("\n").length);
    fields.push(match[1] ?? match[2]);
    if (match[3] !== ",") { records.push(fields); fields = []; }
  }
  const wrong = records.findIndex((record) => record.length !== records[0].length);
  const expected = `expected ${records[0].length} fields in record ${wrong + 1}`;
  require(wrong <= 0, name, `${expected}, got ${records[wrong]?.length}`);
  return records;
}
