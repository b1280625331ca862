// Agents, their goals, and marks of those that were delayed, or whose move was blocked or violates the rules.

const DISC_SCALE = 4; // px per cell, below which agents are squares
const HEADING_SCALE = 5; // px per cell, from which on headings are drawn
const ROOMY_SCALE = 12; // px per cell, from which on a goal's frame is visible around an agent
const FAINT = 0.5; // opacity of small goals, which look like small agents otherwise
const NUMBER_SCALE = 22; // px per cell, from which on agents have numbers

function drawGoals(pen, episode, camera, step) {
  const { scale } = camera, inset = scale * 0.1;
  pen.lineWidth = Math.max(1, scale * 0.07);
  pen.globalAlpha = scale < ROOMY_SCALE ? FAINT : 1;
  for (let agent = 0; agent < episode.agents; agent++) {
    const [row, col] = episode.goal(agent, step);
    if (!episode.isActive(agent, step) || !camera.sees(row, col)) continue;
    pen.strokeStyle = episode.colors[agent % episode.colors.length];
    pen.strokeRect(col * scale + inset, row * scale + inset, scale - 2 * inset, scale - 2 * inset);
  }
  pen.globalAlpha = 1;
}

// The selected agent is drawn last, so that no other one hides it.
function drawAgents(pen, episode, camera, time, options) {
  for (let agent = 0; agent < episode.agents; agent++)
    if (agent !== options.chosen) drawAgent(pen, episode, agent, camera, time, options);
  if (options.chosen >= 0 && options.chosen < episode.agents) drawAgent(pen, episode, options.chosen, camera, time, options);
}

function drawAgent(pen, episode, agent, camera, time, options) {
  const { scale } = camera, { ink } = options;
  if (!episode.isActive(agent, Math.floor(time))) return;
  const [row, col] = episode.position(agent, time);
  if (!camera.sees(row, col)) return;
  const x = (col + 0.5) * scale, y = (row + 0.5) * scale, radius = discRadius(scale);
  const color = episode.colors[agent % episode.colors.length], numbered = options.numbers && scale >= NUMBER_SCALE;
  drawDisc(pen, x, y, scale, color, options.ground === "plain" ? null : ink.page);
  if (episode.isDelayed(agent, Math.ceil(time))) drawBar(pen, x, y, scale, ink.delayed);
  if (episode.headings && scale >= HEADING_SCALE) {
    const angle = episode.angle(agent, time);
    if (numbered) drawPointer(pen, x, y, scale, angle, color); else drawHeading(pen, x, y, radius, angle, ink.mark);
  }
  if (numbered) drawNumber(pen, agent, x, y, scale, color);
  if (options.blocked && episode.isBlocked(agent, Math.ceil(time))) drawRing(pen, x, y, radius, scale, ink.blocked);
  if (agent === options.chosen) drawRing(pen, x, y, radius * 1.25, scale, ink.chosen);
}

function discRadius(scale) { return scale * (scale >= ROOMY_SCALE ? 0.38 : 0.48); }

function drawDisc(pen, x, y, scale, color, outline) {
  const radius = discRadius(scale);
  if (outline && scale >= DISC_SCALE) { // keeps agents legible on colored cells
    pen.fillStyle = outline;
    pen.beginPath(); pen.arc(x, y, radius + Math.max(1, scale * 0.06), 0, 2 * Math.PI); pen.fill();
  }
  pen.fillStyle = color;
  if (scale < DISC_SCALE) { pen.fillRect(x - radius, y - radius, 2 * radius, 2 * radius); return; }
  pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.fill();
}

// A bar across the lower half of the disc, below a number. It extends beyond the disc.
function drawBar(pen, x, y, scale, color) {
  pen.fillStyle = color;
  pen.fillRect(x - 0.46 * scale, y + 0.2 * scale, 0.92 * scale, Math.max(1, 0.14 * scale));
}

// A triangle in the disc.
function drawHeading(pen, x, y, radius, angle, color) {
  drawTriangle(pen, x, y, angle, radius * 0.85, radius * -0.15, radius * 0.6, color);
}

// A triangle at the rim of the disc, which leaves room for a number.
function drawPointer(pen, x, y, scale, angle, color) {
  drawTriangle(pen, x, y, angle, scale * 0.5, scale * 0.3, scale * 0.2, color);
}

function drawTriangle(pen, x, y, angle, tip, base, side, color) {
  const cos = Math.cos(angle), sin = Math.sin(angle);
  pen.fillStyle = color;
  pen.beginPath();
  pen.moveTo(x + tip * cos, y + tip * sin);
  pen.lineTo(x + base * cos - side * sin, y + base * sin + side * cos);
  pen.lineTo(x + base * cos + side * sin, y + base * sin - side * cos);
  pen.closePath(); pen.fill();
}

function drawNumber(pen, agent, x, y, scale, color) {
  const text = String(agent), size = scale * Math.min(0.42, 1.05 / (0.6 + 0.6 * text.length + 0.4));
  pen.fillStyle = readableOn(color);
  pen.font = `600 ${size.toFixed(1)}px system-ui, sans-serif`;
  pen.textAlign = "center"; pen.textBaseline = "middle";
  pen.fillText(text, x, y + size * 0.06);
}

function drawRing(pen, x, y, radius, scale, color) {
  pen.strokeStyle = color; pen.lineWidth = Math.max(1.5, scale * 0.08);
  pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.stroke();
}

// An arrow from each agent that waits for another one to that one. Its outline keeps it legible on agents and obstacles.
function drawWaits(pen, episode, camera, time, ink) {
  const { scale } = camera;
  for (let agent = 0; agent < episode.agents; agent++) {
    const leader = episode.leader(agent, Math.ceil(time));
    if (leader < 0) continue;
    const [row, col] = episode.position(agent, time), [toRow, toCol] = episode.position(leader, time);
    const length = Math.hypot(toRow - row, toCol - col), angle = Math.atan2(toRow - row, toCol - col);
    for (const [color, rim] of [[ink.page, 0.05], [ink.delayed, 0]])
      drawArrow(pen, (col + 0.5) * scale, (row + 0.5) * scale, angle, length * scale, scale, rim * scale, color);
  }
}

// From disc to disc, whose centers are `length` apart, beside their numbers; larger by `rim` on all sides.
function drawArrow(pen, x, y, angle, length, scale, rim, color) {
  const start = 0.34 * scale - rim, base = length - 0.48 * scale - rim, tip = length - 0.28 * scale + 1.5 * rim;
  pen.strokeStyle = color; pen.lineWidth = Math.max(1, 0.07 * scale) + 2 * rim;
  pen.beginPath();
  pen.moveTo(x + start * Math.cos(angle), y + start * Math.sin(angle));
  pen.lineTo(x + base * Math.cos(angle), y + base * Math.sin(angle));
  pen.stroke();
  drawTriangle(pen, x, y, angle, tip, base, 0.13 * scale + 1.5 * rim, color);
}

// A red frame around the cells of agents that violate the rules in this step.
function drawViolations(pen, episode, camera, step, color) {
  const least = Math.max(camera.scale, 9);
  pen.strokeStyle = color; pen.lineWidth = Math.max(2, camera.scale * 0.1);
  for (const violation of (episode.violations ?? []).filter((each) => each.step === step))
    for (const agent of violation.agents) {
      const [row, col] = episode.cell(agent, step), x = (col + 0.5) * camera.scale, y = (row + 0.5) * camera.scale;
      pen.strokeRect(x - least / 2, y - least / 2, least, least);
    }
}
