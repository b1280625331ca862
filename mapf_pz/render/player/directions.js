// The guidance graph: an arrow in the cheaper direction of each edge, as `guidance.py` draws them.

const ARROW_SCALE = 10; // px per cell, from which on arrows are drawn
const FULL_RATIO = 4; // of the weights of an edge's two directions, from which on its arrow has full size

// The edges that are cheaper in one direction than in the other.
function cheaperEdges(episode) {
  if (episode.cheaper) return episode.cheaper;
  const cells = episode.width * episode.height;
  episode.cheaper = [];
  for (let heading = 0; heading < 4; heading++)
    for (let cell = 0; cell < cells; cell++) {
      const row = Math.floor(cell / episode.width) + HEADING_STEPS[heading][0];
      const col = (cell % episode.width) + HEADING_STEPS[heading][1];
      const weight = episode.weights[heading * cells + cell];
      if (!Number.isFinite(weight) || !episode.free[cell] || !episode.isFree(row, col)) continue;
      const opposite = episode.weights[((heading + 2) % 4) * cells + row * episode.width + col];
      const strength = Math.min(1, Math.log(opposite / weight) / Math.log(FULL_RATIO));
      if (strength > 0) episode.cheaper.push({ heading, cell, strength });
    }
  return episode.cheaper;
}

function drawDirections(pen, episode, camera, color) {
  const { scale } = camera;
  if (scale < ARROW_SCALE) return;
  pen.fillStyle = color;
  for (const { heading, cell, strength } of cheaperEdges(episode)) {
    const row = Math.floor(cell / episode.width), col = cell % episode.width, [down, right] = HEADING_STEPS[heading];
    if (!camera.sees(row, col)) continue;
    const x = col + 0.5 + right / 2, y = row + 0.5 + down / 2; // the border between the two cells
    const length = 0.14 + 0.2 * strength, width = 0.1 + 0.1 * strength;
    const at = (along, aside) => [scale * (x + along * right - aside * down), scale * (y + along * down + aside * right)];
    pen.globalAlpha = 0.35 + 0.65 * strength;
    pen.beginPath(); pen.moveTo(...at(length, 0)); pen.lineTo(...at(-length, width)); pen.lineTo(...at(-length, -width));
    pen.closePath(); pen.fill();
  }
  pen.globalAlpha = 1;
}
