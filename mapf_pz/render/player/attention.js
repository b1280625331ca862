// The attention of an agent: the agents with the largest weights in the policy's last round of communication.

const FAINTEST = 0.1; // opacity of lines

// Whether the agent's decision in the state after a step is known.
function isDecided(episode, agent, step) {
  const { inspection } = episode;
  return Boolean(inspection) && agent < inspection.agents && step < episode.steps && episode.isActive(agent, step);
}

// The agents and their weights, in descending order; the agent itself may be one of them.
function attentionOf(episode, agent, step) {
  if (!isDecided(episode, agent, step) || !episode.attended) return [];
  const { attended } = episode.inspection, first = (agent * episode.steps + step) * attended;
  const all = Array.from({ length: attended }, (_, k) => [episode.attended[first + k], episode.attention[first + k] / 255]);
  return all.filter(([other]) => other >= 0);
}

// Lines from the selected agent to those that it attends to. The one with the largest weight is opaque.
function drawAttention(pen, episode, camera, time, { chosen, ink }) {
  const found = attentionOf(episode, chosen, Math.floor(time)).filter(([other]) => other !== chosen);
  const largest = Math.max(...found.map(([, weight]) => weight));
  pen.strokeStyle = ink.attention; pen.lineWidth = Math.max(1.5, camera.scale * 0.08);
  for (const [other, weight] of found) {
    pen.globalAlpha = largest ? Math.max(FAINTEST, weight / largest) : FAINTEST;
    drawLine(pen, [episode.position(chosen, time), episode.position(other, time)], camera.scale);
  }
  pen.globalAlpha = 1;
}
