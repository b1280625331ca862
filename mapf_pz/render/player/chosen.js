// The selected agent: its trail, the path ahead, a line to its goal, and its field of view.

const TRAIL = 60; // steps

function drawChosen(pen, episode, camera, time, options) {
  const agent = options.chosen, step = Math.floor(time), { scale } = camera;
  if (options.field && episode.hasField() && agent < episode.observers) drawField(pen, episode, camera, step, options);
  pen.strokeStyle = episode.colors[agent % episode.colors.length];
  pen.lineWidth = Math.max(2, scale * 0.18); pen.lineJoin = "round"; pen.globalAlpha = 0.45;
  const trail = [episode.position(agent, time)];
  for (let past = step; past >= Math.max(0, step - TRAIL); past--) trail.push(episode.cell(agent, past));
  drawLine(pen, trail, scale);
  if (options.ahead) {
    const path = [episode.position(agent, time)];
    const end = episode.endOfPath(agent, step);
    for (let later = Math.ceil(time); later <= end; later++) path.push(episode.cell(agent, later));
    pen.globalAlpha = 0.9; pen.lineWidth = Math.max(1.5, scale * 0.09); pen.setLineDash([scale * 0.12, scale * 0.18]);
    drawLine(pen, path, scale);
    pen.setLineDash([]);
  }
  pen.globalAlpha = 1;
  if (episode.hasGoals()) drawGoalLine(pen, episode, camera, time, options);
}

function drawLine(pen, cells, scale) {
  pen.beginPath();
  cells.forEach(([row, col], k) => pen[k ? "lineTo" : "moveTo"]((col + 0.5) * scale, (row + 0.5) * scale));
  pen.stroke();
}

function drawGoalLine(pen, episode, camera, time, options) {
  const { scale } = camera, goal = episode.goal(options.chosen, Math.floor(time));
  pen.strokeStyle = options.ink.chosen; pen.lineWidth = Math.max(1, scale * 0.05);
  if (!options.ahead) {
    pen.setLineDash([scale * 0.3, scale * 0.2]);
    drawLine(pen, [episode.position(options.chosen, time), goal], scale);
    pen.setLineDash([]);
  }
  pen.strokeRect(goal[1] * scale, goal[0] * scale, scale, scale);
}

// The cell [row, column] of the map at a place [row, column] of the agent's image.
function fieldCell(episode, agent, step, row, col) {
  const [ownRow, ownCol] = observerPlace(episode), [agentRow, agentCol] = episode.cell(agent, step);
  const up = episode.frame === "egocentric" ? episode.headings[episode.index(agent, step)] : NORTH;
  const [upRows, upCols] = HEADING_STEPS[up], [rightRows, rightCols] = HEADING_STEPS[(up + 1) % 4];
  const ahead = ownRow - row, right = col - ownCol;
  return [agentRow + ahead * upRows + right * rightRows, agentCol + ahead * upCols + right * rightCols];
}

// Where the agent itself is in its image.
function observerPlace(episode) {
  const [rows, cols] = episode.viewSize;
  return [episode.view === "front" ? rows - 1 : Math.floor(rows / 2), Math.floor(cols / 2)];
}

function drawField(pen, episode, camera, step, { chosen, ink }) {
  const [rows, cols] = episode.viewSize, { scale } = camera;
  const [a, b] = [fieldCell(episode, chosen, step, 0, 0), fieldCell(episode, chosen, step, rows - 1, cols - 1)];
  const top = Math.min(a[0], b[0]), left = Math.min(a[1], b[1]);
  const width = Math.abs(a[1] - b[1]) + 1, height = Math.abs(a[0] - b[0]) + 1;
  pen.fillStyle = ink.chosen; pen.globalAlpha = 0.07;
  pen.fillRect(left * scale, top * scale, width * scale, height * scale);
  pen.globalAlpha = 1; pen.strokeStyle = ink.chosen; pen.lineWidth = Math.max(1.5, scale * 0.06);
  pen.strokeRect(left * scale, top * scale, width * scale, height * scale);
}

// A frame around the cell of the map whose value the pointer is at in a plane.
function drawPointed(pen, cell, camera, color) {
  pen.strokeStyle = color; pen.lineWidth = Math.max(2, camera.scale * 0.1);
  pen.strokeRect(cell[1] * camera.scale, cell[0] * camera.scale, camera.scale, camera.scale);
}
