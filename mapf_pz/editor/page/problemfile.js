// Problems of the League of Robot Runners: a JSON file that names a map, a file of starts, and one of tasks. A task has
// an agent's goals in order. All agents face east.

const PROBLEM_VERSION = "2024 LoRR";

// The files {name, text} of a problem.
function problemFiles(drawing) {
  const { name, agents } = drawing, lines = (values) => `${[values.length, ...values].join("\n")}\n`;
  agents.forEach(({ goals }, agent) => require(goals.length > 0, `${name}.json`, `expected a goal of agent ${agent}`));
  const names = { mapFile: `${name}.map`, agentFile: `${name}.agents`, taskFile: `${name}.tasks` };
  const problem = { ...names, teamSize: agents.length, numTasksReveal: 1, version: PROBLEM_VERSION };
  const numbers = (cells) => cells.map((cell) => drawing.number(cell)).join();
  return [
    { name: `${name}.json`, text: `${JSON.stringify(problem, null, 2)}\n` },
    { name: names.mapFile, text: mapText(drawing) },
    { name: names.agentFile, text: lines(agents.map(({ start }) => numbers([start]))) },
    { name: names.taskFile, text: lines(agents.map(({ goals }) => numbers(goals))) },
  ];
}

// Whether the text of a JSON file is that of a problem.
function isProblem(text) { return /"agentFile"\s*:/.test(text); }

// The drawing of a problem's files: `texts` are those of all files by name. Agent k gets the tasks k, k + N, and so on.
function parseProblem(name, texts) {
  const data = parseJson(texts[name], name), size = data.teamSize;
  const named = (key) => {
    const path = data[key], file = typeof path === "string" ? path.split("/").pop() : "";
    require(file in texts, name, `expected the file '${key}', too: ${shortened(path ?? "not named")}`);
    return file;
  };
  const map = parseMap(texts[named("mapFile")], named("mapFile"));
  const [starts, tasks] = ["agentFile", "taskFile"].map((key) => parseCells(texts[named(key)], named(key), map));
  const isSize = Number.isInteger(size) && size >= 1 && size <= starts.length;
  require(isSize, name, `expected 'teamSize' to be a whole number from 1 to ${starts.length}, got ${shortened(size)}`);
  const agents = starts.slice(0, size).map(([start], agent) => {
    const own = tasks.filter((_, task) => task % size === agent);
    return Object.freeze({ start, goals: own.length ? own.flat() : tasks[agent % tasks.length], heading: 0 });
  });
  const drawing = new Drawing({ name: name.replace(/\.json$/i, ""), height: map.height, width: map.width, free: map.free });
  return drawing.with({ agents });
}

// The cells [row, column] of each line of a file of starts or tasks.
function parseCells(text, name, map) {
  const all = linesOf(text.trimEnd()), comments = all.findIndex((line) => !line.startsWith("#"));
  const count = Number(all[comments]), lines = all.slice(comments + 1);
  require(/^\d{1,9}$/.test(all[comments]) && lines.length === count, name, `expected ${shortened(all[comments])} lines`, comments + 1);
  return lines.map((line, k) => {
    const at = comments + 2 + k;
    require(/^\d{1,9}(,\d{1,9})*$/.test(line), name, `expected numbers of cells, got ${shortened(line)}`, at);
    return line.split(",").map(Number).map((number) => {
      require(map.free[number], name, `expected a free cell of map '${map.name}', got ${number}`, at);
      return [Math.floor(number / map.width), number % map.width];
    });
  });
}
