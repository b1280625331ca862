// Why the safety layer took another action than the one that an agent preferred.

// Names the other agent that this is due to, from the positions before and after the step that follows `step`.
function overriddenBecause(episode, agent, step, preferred) {
  if (episode.ignored[agent * episode.steps + step]) return "the agent made no progress and follows PIBT";
  const own = episode.cell(agent, step), wanted = cellAfter(episode, agent, step, preferred) ?? own;
  if (!episode.isInside(...wanted)) return "edge of the map";
  if (!episode.isFree(...wanted)) return "obstacle";
  const others = [...Array(episode.agents).keys()].filter((k) => k !== agent && episode.isActive(k, step));
  const isAt = (k, cell, time) => sameCell(episode.cell(k, time), cell);
  const enters = others.find((k) => isAt(k, wanted, step + 1));
  if (enters !== undefined) {
    if (sameCell(wanted, own)) return `agent ${enters} takes its cell`;
    return `agent ${enters} ${isAt(enters, wanted, step) ? "stays on" : "takes"} that cell`;
  }
  const swaps = others.find((k) => isAt(k, wanted, step) && isAt(k, own, step + 1));
  if (swaps !== undefined) return `swap with agent ${swaps}, which takes its cell`;
  return episode.headings ? "a conflict in a later step" : "to make room for another agent";
}
