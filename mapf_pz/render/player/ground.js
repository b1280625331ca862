// The map: free cells, which can be colored by traffic or cost, grid lines, and obstacles.

const GRID_SCALE = 14; // px per cell, from which on grid lines are drawn
const GROUNDS = {
  plain: { label: "nothing", isKnown: () => true },
  traffic: { label: "traffic", legend: "moves into the cell", isKnown: () => true, values: (episode) => episode.traffic() },
  waits: { label: "waiting", legend: "steps waited in the cell", isKnown: () => true, values: (episode) => episode.waits() },
  weights: {
    label: "edge weights", legend: "mean cost of leaving the cell",
    isKnown: (episode) => episode.weights !== undefined, values: (episode) => episode.leavingCosts(),
  },
};

class Ground {
  // `compared`: all episodes of the page, which have the same range of colors.
  constructor(episode, compared) { Object.assign(this, { episode, compared, ranges: {} }); }

  // The minimum and maximum value that a ground's colors show; null if it is not known or the cells are not colored.
  range(name) {
    if (this.ranges[name] === undefined) this.ranges[name] = this.findRange(GROUNDS[name]);
    return this.ranges[name];
  }

  findRange({ values, isKnown }) {
    const episodes = values ? this.compared.filter(isKnown) : [];
    if (!episodes.includes(this.episode)) return null;
    let least = Infinity, largest = -Infinity;
    for (const episode of episodes)
      values(episode).forEach((value, cell) => {
        if (!episode.free[cell] || !Number.isFinite(value)) return;
        least = Math.min(least, value);
        largest = Math.max(largest, value);
      });
    return { least, largest };
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
    const spread = range ? range.largest - range.least : 0, values = range ? GROUNDS[name].values(episode) : [];
    this.floor = picture(episode, (cell) => {
      if (!episode.free[cell]) return null;
      const value = values[cell];
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
  for (let row = firstRow; row <= lastRow; row++) {
    pen.moveTo(firstCol * scale, row * scale);
    pen.lineTo(lastCol * scale, row * scale);
  }
  for (let col = firstCol; col <= lastCol; col++) {
    pen.moveTo(col * scale, firstRow * scale);
    pen.lineTo(col * scale, lastRow * scale);
  }
  pen.stroke();
}
