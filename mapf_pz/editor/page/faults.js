// What makes an instance impossible: starts and goals on obstacles, starts or goals of two agents on one cell, and goals
// that cannot be reached.

// Returns {agent, cell, text} for each fault. In lifelong episodes, several agents may have the same goal.
function faultsOf(drawing, lifelong) {
  const regions = regionNumbers(drawing), faults = [], starts = new Map(), goals = new Map();
  drawing.agents.forEach((each, agent) => {
    const add = (cell, text) => faults.push({ agent, cell, text: `agent ${agent}: ${text}` });
    checkPlace(drawing, each.start, "start", starts, agent, add);
    if (!each.goals.length) add(each.start, "no goal");
    if (!lifelong && each.goals.length > 1) add(each.goals[1], "several goals, which only lifelong episodes have");
    for (const goal of each.goals) {
      checkPlace(drawing, goal, "goal", lifelong ? new Map() : goals, agent, add);
      const areFree = drawing.isFree(...each.start) && drawing.isFree(...goal);
      if (areFree && regions[drawing.number(each.start)] !== regions[drawing.number(goal)]) add(goal, "unreachable goal");
    }
  });
  return faults;
}

// Finds a start or goal on an obstacle, or on the cell of an earlier agent, and adds it to those that are `taken`.
function checkPlace(drawing, cell, what, taken, agent, add) {
  const number = drawing.number(cell), other = taken.get(number);
  if (!drawing.isFree(...cell)) add(cell, `${what} on an obstacle`);
  if (other !== undefined) add(cell, `the same ${what} as agent ${other}`); else taken.set(number, agent);
}
