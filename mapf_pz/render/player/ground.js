// The map: free cells, which can be colored by traffic or cost, grid lines, and obstacles.

const GRID_SCALE = 14; // px per cell, from which on grid lines are drawn
const GROUNDS = {
  plain: { label: "nothing", isKnown: () => true },
  traffic: { label: "traffic", legend: "moves into the cell", isKnown: () => true, values: (episode) => episode.traffic() },
  weights: {
    label: "edge weights", legend: "mean cost of leaving the cell",
    isKnown: (episode) => episode.weights !== undefined, values: (episode) => episode.leavingCosts(),
  },
};

class Ground {
  constructor(episode) { this.episode = episode; }

  // What the colors of a ground mean: least and largest value; null if cells are not colored.
  range(name) {
    const { free } = this.episode, values = GROUNDS[name].values?.(this.episode);
    if (!values) return null;
    let least = Infinity, largest = -Infinity;
    for (let cell = 0; cell < values.length; cell++)
      if (free[cell] && Number.isFinite(values[cell])) {
        least = Math.min(least, values[cell]);
        largest = Math.max(largest, values[cell]);
      }
    return { least, largest, values };
  }

  draw(pen, camera, ink, name) {
    const { episode } = this, { scale } = camera, width = episode.width * scale, height = episode.height * scale;
    this.paint(ink, name);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.floor, 0, 0, width, height);
    if (scale >= GRID_SCALE) drawGrid(pen, episode, camera, ink.grid);
    pen.drawImage(this.walls, 0, 0, width, height);
  }

  // Paints pictures with one pixel per cell, unless they are painted already.
  paint(ink, name) {
    const key = `${name} ${ink.free}`;
    if (this.key === key) return;
    this.key = key;
    const { episode } = this, free = channels(ink.free), hot = channels(ink.hot), range = this.range(name);
    const spread = range ? range.largest - range.least : 0;
    this.floor = picture(episode, (cell) => {
      if (!episode.free[cell]) return null;
      const value = range ? range.values[cell] : NaN;
      return spread > 0 && Number.isFinite(value) ? blend(free, hot, (value - range.least) / spread) : free;
    });
    const obstacle = channels(ink.obstacle);
    this.walls = picture(episode, (cell) => (episode.free[cell] ? null : obstacle));
  }
}

// A picture with one pixel per cell; cells without a color are transparent.
function picture(episode, colorOf) {
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: episode.width, height: episode.height });
  const pen = canvas.getContext("2d"), image = pen.createImageData(episode.width, episode.height);
  for (let cell = 0; cell < episode.width * episode.height; cell++) {
    const color = colorOf(cell);
    if (color) image.data.set([...color, 255], 4 * cell);
  }
  pen.putImageData(image, 0, 0);
  return canvas;
}

function drawGrid(pen, episode, camera, color) {
  const { scale } = camera, [top, left] = camera.at(0, 0), [bottom, right] = camera.at(camera.boxWidth, camera.boxHeight);
  const firstRow = Math.max(0, Math.floor(top)), lastRow = Math.min(episode.height, Math.ceil(bottom));
  const firstCol = Math.max(0, Math.floor(left)), lastCol = Math.min(episode.width, Math.ceil(right));
  pen.strokeStyle = color; pen.lineWidth = 1;
  pen.beginPath();
  for (let row = firstRow; row <= lastRow; row++) { pen.moveTo(firstCol * scale, row * scale); pen.lineTo(lastCol * scale, row * scale); }
  for (let col = firstCol; col <= lastCol; col++) { pen.moveTo(col * scale, firstRow * scale); pen.lineTo(col * scale, lastRow * scale); }
  pen.stroke();
}
