// The tools of the editor. Each has a function `press`, `drag` or both, which return a new drawing: `press` when the
// pointer goes down at a cell, and `drag` when it goes to further cells (without `press`, also for the first one). They
// are given the drawing before the press, the cell or the path of adjacent cells, and the editor, whose `alternate` is
// true with shift or the right button.

const TOOLS = {
  draw: {
    key: "w", label: "obstacles", hint: "Draw obstacles; with shift or the right button, free cells.",
    drag: (before, path, { alternate }) => before.withCells(path, alternate),
  },
  erase: {
    key: "e", label: "erase", hint: "Draw free cells.",
    drag: (before, path) => before.withCells(path, true),
  },
  rectangle: {
    key: "r", label: "rectangle", hint: "A rectangle of obstacles; with shift or the right button, of free cells.",
    drag: (before, path, { alternate }) => before.withCells(cellsOfRectangle(path[0], path.at(-1)), alternate),
  },
  fill: {
    key: "f", label: "fill", hint: "Turn a region of free cells into obstacles, and one of obstacles into free cells.",
    press: (before, cell) => before.withCells(regionOf(before, cell), !before.isFree(...cell)),
  },
  agent: {
    key: "a", label: "agents", hint: "Place an agent: press at its start and drag to its goal, or click on both.",
    press(before, cell, editor) {
      const last = before.agents.length - 1;
      editor.isPending = last >= 0 && last === editor.selected && !before.agents[last].goals.length;
      if (editor.isPending) return before.withAgent(last, { goals: [cell] });
      editor.selected = before.agents.length;
      return before.withNewAgent(cell, []);
    },
    drag(before, path, { isPending }) {
      const goals = [path.at(-1)];
      return isPending ? before.withAgent(before.agents.length - 1, { goals }) : before.withNewAgent(path[0], goals);
    },
  },
  goal: {
    key: "g", label: "more goals", hint: "Add a goal to the selected agent, for lifelong episodes; with shift or the right button, remove the last one.",
    press(before, cell, editor) {
      const agent = before.agents[editor.selected];
      if (!agent) return before;
      return before.withAgent(editor.selected, { goals: editor.alternate ? agent.goals.slice(0, -1) : [...agent.goals, cell] });
    },
  },
  move: {
    key: "v", label: "select and move", hint: "Select an agent, or drag its start or a goal to another cell; drag elsewhere to move the map.",
    press(before, cell, editor) {
      editor.grabbed = grabbedAt(before, cell, editor.selected);
      editor.selected = editor.grabbed?.agent ?? -1;
      return before;
    },
    drag(before, path, { grabbed }) {
      if (!grabbed) return before;
      const { agent, goal } = grabbed, cell = path.at(-1), goals = before.agents[agent].goals;
      return before.withAgent(agent, goal < 0 ? { start: cell } : { goals: goals.with(goal, cell) });
    },
  },
  lane: {
    key: "l", label: "lane", hint: "Draw a lane: moves along it get one weight, moves against it another.",
    drag: (before, path, { along, against }) => before.withWeights(laneEdges(before, path, along, against)),
  },
  region: {
    key: "k", label: "cost of a region", hint: "A rectangle whose cells cost the weight of a lane to leave.",
    drag(before, path, { along }) {
      const cells = cellsOfRectangle(path[0], path.at(-1)).map((cell) => before.number(cell));
      return before.withWeights(cells.flatMap((cell) => [0, 1, 2, 3].map((heading) => [heading, cell, along])));
    },
  },
};

// What is at a cell: an agent's start, or a goal, of the selected agent if possible; null if there is nothing.
function grabbedAt(drawing, cell, selected) {
  const order = [...drawing.agents.keys()].sort((a, b) => (b === selected) - (a === selected));
  const start = order.find((agent) => sameCell(drawing.agents[agent].start, cell));
  if (start !== undefined) return { agent: start, goal: -1 };
  const owner = order.find((agent) => drawing.agents[agent].goals.some((goal) => sameCell(goal, cell)));
  if (owner === undefined) return null;
  return { agent: owner, goal: drawing.agents[owner].goals.findIndex((goal) => sameCell(goal, cell)) };
}

// The weights [heading, cell, weight] of the moves between the cells of a path, and of the moves back.
function laneEdges(drawing, path, along, against) {
  return path.slice(1).flatMap((to, k) => {
    const from = path[k], heading = HEADING_STEPS.findIndex((step) => sameCell(step, [to[0] - from[0], to[1] - from[1]]));
    return [[(heading + 2) % 4, drawing.number(to), against], [heading, drawing.number(from), along]];
  });
}
