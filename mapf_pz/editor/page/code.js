// The drawing as code and as a command, to copy.

// Python that makes the environment and resets it to this instance.
function pythonCode(drawing) {
  const cells = (values) => `[${values.map(([row, col]) => `[${row}, ${col}]`).join(", ")}]`;
  const { agents } = drawing, counts = agents.map(({ goals }) => goals.length), most = Math.max(...counts);
  const filled = agents.map(({ goals }) => [...goals, ...Array(most - goals.length).fill(goals.at(-1))]);
  const goals = most > 1 ? `[${filled.map(cells).join(", ")}]` : cells(filled.map(([goal]) => goal));
  const scenario = [`starts=${cells(agents.map(({ start }) => start))}`, `goals=${goals}`];
  if (counts.some((count) => count < most)) scenario.push(`goal_counts=[${counts.join(", ")}]`);
  const options = [`num_agents=${agents.length}`, `action_model="${drawing.turning ? "rotate" : "cardinal"}"`];
  if (most > 1) options.push('on_target="restart"');
  if (drawing.weights) options.push(`edge_weights="${drawing.name}.json"`);
  const headings = drawing.turning ? `, headings=[${agents.map(({ heading }) => heading).join(", ")}]` : "";
  const graph = drawing.weights ? `  # ${drawing.name}.json: the saved guidance graph` : "";
  return `from mapf_pz import parallel_env
from mapf_pz.instances import Instance, Scenario, parse_map

grid = parse_map(
    """\\
${mapText(drawing)}""",
    "${drawing.name}.map",
)
scenario = Scenario(
    ${scenario.join(",\n    ")},
)
instance = Instance(grid, scenario${headings})
env = parallel_env(map=grid, ${options.join(", ")})${graph}
observations, infos = env.reset(options={"instance": instance})
`;
}

// The command that solves the saved instance with the same result; a scenario has no headings.
function solveCommand(drawing, solver, { time_limit, max_steps, seed, delays }) {
  require(!delays, "copy command", "expected no delays, which mapf-pz solve does not have");
  for (const [agent, { goals }] of drawing.agents.entries())
    require(goals.length === 1, "copy command", `expected one goal of agent ${agent}, got ${goals.length}: mapf-pz solve has no lifelong episodes`);
  const { name, agents } = drawing, quote = (text) => (/^[\w.:=,+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
  const files = `--map ${quote(`${name}.map`)} --scenario ${quote(`${name}.scen`)}`;
  const graph = drawing.weights ? ` --edge-weights ${quote(`${name}.json`)}` : "";
  const isEast = agents.every(({ heading }) => heading === 0), headings = agents.map(({ heading }) => heading).join(" ");
  const turning = isEast ? "" : ` --initial-heading ${headings}`;
  const model = drawing.turning ? turning : " --action-model cardinal";
  const limits = ` --time-limit ${time_limit} --max-steps ${max_steps} --seed ${seed}`;
  return `mapf-pz solve plan.json --planner ${quote(solver)} ${files} --num-agents ${agents.length}${model}${graph}${limits}\n`;
}
