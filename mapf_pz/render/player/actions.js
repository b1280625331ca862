// The actions of agents, and why a move did not happen: the rules of docs/reference/rules.md.

const ACTIONS = {
  rotate: ["forward", "turn left", "turn right", "wait"], cardinal: ["wait", "up", "down", "left", "right"],
};
const CARDINAL_DIRECTIONS = [-1, 3, 1, 2, 0]; // headings; -1: no move

// The names of actions by number.
function actionNames(episode) { return ACTIONS[episode.headings ? "rotate" : "cardinal"]; }

function actionName(episode, agent, step) {
  const action = episode.actions[episode.index(agent, step)];
  return action < 0 ? "none" : actionNames(episode)[action];
}

// The cell that an agent's action leads to in a step, whether or not it is free; null if it is no move, or was delayed.
function targetOf(episode, agent, step) {
  if (episode.isDelayed(agent, step)) return null;
  return cellAfter(episode, agent, step - 1, episode.actions[episode.index(agent, step)]);
}

// The same for any action in the state after a step; -1 is none.
function cellAfter(episode, agent, step, action) {
  if (action < 0) return null;
  let direction = CARDINAL_DIRECTIONS[action];
  if (episode.headings) direction = action === 0 ? episode.headings[episode.index(agent, step)] : -1;
  if (direction < 0) return null;
  const [row, col] = episode.cell(agent, step), [down, right] = HEADING_STEPS[direction];
  return [row + down, col + right];
}

// Why the move of an agent was blocked in a step.
function blockedBecause(episode, agent, step) {
  const target = targetOf(episode, agent, step);
  if (!episode.isInside(...target)) return "edge of the map";
  if (!episode.isFree(...target)) return "obstacle";
  const others = [...Array(episode.agents).keys()].filter((k) => k !== agent && episode.isActive(k, step - 1));
  const requests = (k, cell) => { const own = targetOf(episode, k, step); return own !== null && sameCell(own, cell); };
  const occupant = others.find((k) => sameCell(episode.cell(k, step - 1), target));
  if (occupant !== undefined && requests(occupant, episode.cell(agent, step - 1))) return `swap with agent ${occupant}`;
  const rivals = others.filter((k) => requests(k, target));
  return COLLISION_RULES[episode.collisionSystem](episode, agent, step, occupant, rivals);
}

const COLLISION_RULES = {
  soft(episode, agent, step, occupant, rivals) {
    return staying(episode, step, occupant) ?? `vertex conflict with agent ${rivals[0]}, which has the lower index`;
  },
  priority(episode, agent, step, occupant, rivals) {
    const first = rivals.find((k) => k < agent && !episode.isBlocked(k, step));
    const entered = first === undefined ? null : `vertex conflict with agent ${first}, which moved first`;
    return staying(episode, step, occupant) ?? entered ?? `agent ${occupant} left the cell later in this step`;
  },
  block_both(episode, agent, step, occupant, rivals) {
    if (occupant !== undefined) return `agent ${occupant} was on the cell`;
    return `vertex conflict with agent${rivals.length > 1 ? "s" : ""} ${rivals.join(", ")}`;
  },
};

// What keeps the agent on the requested cell there; null if there is none or it left.
function staying(episode, step, occupant) {
  if (occupant === undefined) return null;
  if (!sameCell(episode.cell(occupant, step - 1), episode.cell(occupant, step))) return null;
  const cause = episode.isBlocked(occupant, step) ? ", blocked itself" : episode.isDelayed(occupant, step) ? ", delayed" : "";
  return `agent ${occupant} stayed on the cell${cause}`;
}
