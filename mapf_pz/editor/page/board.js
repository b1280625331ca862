// The drawing on a canvas: cells, edge weights, agents with their goals, faults, and the cursor.

const SHORT_SIDE = 0.16; // of the mark of a fault, in cells
const CURSOR_LEAST = 5; // px

class Board {
  constructor(canvas, colors) {
    Object.assign(this, { canvas, colors, pen: canvas.getContext("2d"), picture: document.createElement("canvas") });
    this.camera = new Camera(1, 1);
  }

  color(agent) { return this.colors[agent % this.colors.length]; }

  resize() {
    this.ratio = devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    Object.assign(this.canvas, { width: Math.round(width * this.ratio), height: Math.round(height * this.ratio) });
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    this.camera.resize(Math.max(1, width), Math.max(1, height));
  }

  // Shows all of a map that has another size than the one before.
  frame({ height, width }) {
    if (this.camera.height === height && this.camera.width === width) return;
    Object.assign(this.camera, { height, width });
    this.camera.fit();
  }

  // `shown`: {drawing, faults, selected, cursor, ink, weights (whether they are shown)}.
  draw(shown) {
    this.frame(shown.drawing);
    this.pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.drawWith(this.pen, shown);
  }

  // The whole map as the text of an SVG file.
  svg(shown, scale = 24) {
    const { height, width } = shown.drawing, whole = new Camera(height, width), before = this.camera;
    Object.assign(whole, { scale, boxHeight: scale * height, boxWidth: scale * width });
    const pen = new SvgPen(whole.boxWidth, whole.boxHeight);
    this.camera = whole;
    this.drawWith(pen, { ...shown, selected: -1, cursor: null, faults: [] });
    this.camera = before;
    return pen.text();
  }

  drawWith(pen, shown) {
    const { camera } = this, { drawing, ink } = shown, { scale } = camera;
    pen.fillStyle = ink.page;
    pen.fillRect(0, 0, camera.boxWidth, camera.boxHeight);
    pen.translate(camera.left, camera.top);
    this.paint(drawing, ink, shown.weights);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.picture, 0, 0, drawing.width * scale, drawing.height * scale);
    if (scale >= GRID_SCALE) drawGrid(pen, drawing, camera, ink.grid);
    if (shown.weights && drawing.weights) drawDirections(pen, this.graph, camera, ink.arrow);
    this.drawGoals(pen, shown);
    drawing.agents.forEach((agent, k) => { if (k !== shown.selected) this.drawAgent(pen, shown, agent, k); });
    if (drawing.agents[shown.selected]) this.drawSelected(pen, shown, drawing.agents[shown.selected]);
    for (const { cell } of shown.faults) this.drawFault(pen, cell, ink.blocked);
    if (shown.cursor) this.drawCursor(pen, shown.cursor, ink.chosen);
  }

  // Paints the picture of the map, with one pixel per cell, unless it is painted already.
  paint(drawing, ink, hasWeights) {
    const { free, weights, height, width } = drawing, key = `${hasWeights} ${ink.free}`;
    if (this.free === free && this.weights === weights && this.key === key && this.picture.width === width) return;
    Object.assign(this, { free, weights, key });
    this.graph = { height, width, free, weights, isFree: (row, col) => drawing.isFree(row, col) };
    Object.assign(this.picture, { height, width });
    const image = new ImageData(width, height), pixels = new Uint32Array(image.data.buffer);
    const [ground, obstacle] = [ink.free, ink.obstacle].map((code) => pixelOf(channels(code)));
    for (let cell = 0; cell < free.length; cell++) pixels[cell] = free[cell] ? ground : obstacle;
    if (hasWeights && weights) this.paintCosts(pixels, ink);
    this.picture.getContext("2d").putImageData(image, 0, 0);
  }

  // Colors free cells by the mean cost of leaving them.
  paintCosts(pixels, ink) {
    const costs = Episode.prototype.leavingCosts.call(this.graph), { least, largest } = rangeOf(costs, this.free);
    if (!(largest > least)) return;
    const shades = Array.from({ length: 256 }, (_, k) => pixelOf(blend(channels(ink.free), channels(ink.hot), k / 255)));
    costs.forEach((cost, cell) => {
      if (this.free[cell] && Number.isFinite(cost)) pixels[cell] = shades[Math.round((255 * (cost - least)) / (largest - least))];
    });
  }

  drawGoals(pen, { drawing }) {
    const { scale } = this.camera, inset = scale * 0.1;
    pen.lineWidth = Math.max(1, scale * 0.07);
    drawing.agents.forEach(({ goals }, agent) => {
      pen.strokeStyle = this.color(agent);
      for (const [row, col] of goals)
        if (this.camera.sees(row, col)) pen.strokeRect(col * scale + inset, row * scale + inset, scale - 2 * inset, scale - 2 * inset);
    });
  }

  drawAgent(pen, { drawing, ink }, { start: [row, col], heading }, agent) {
    const { scale } = this.camera, x = (col + 0.5) * scale, y = (row + 0.5) * scale, color = this.color(agent);
    if (!this.camera.sees(row, col)) return;
    const isNumbered = scale >= NUMBER_SCALE, angle = (heading * Math.PI) / 2;
    drawDisc(pen, x, y, scale, color, ink.page);
    if (drawing.turning && isNumbered) drawPointer(pen, x, y, scale, angle, color);
    else if (drawing.turning && scale >= HEADING_SCALE) drawHeading(pen, x, y, discRadius(scale), angle, ink.mark);
    if (isNumbered) drawNumber(pen, agent, x, y, scale, color);
  }

  // The selected agent, with a line through its goals in order.
  drawSelected(pen, shown, agent) {
    const { scale } = this.camera, { start: [row, col], goals } = agent;
    pen.strokeStyle = this.color(shown.selected);
    pen.lineWidth = Math.max(1.5, scale * 0.08);
    pen.setLineDash([scale * 0.3, scale * 0.2]);
    drawLine(pen, [agent.start, ...goals], scale);
    pen.setLineDash([]);
    if (goals.length > 1 && scale >= NUMBER_SCALE)
      goals.forEach((goal, k) => drawNumber(pen, k + 1, (goal[1] + 0.5) * scale, (goal[0] + 0.5) * scale, scale, "#000000"));
    this.drawAgent(pen, shown, agent, shown.selected);
    drawRing(pen, (col + 0.5) * scale, (row + 0.5) * scale, discRadius(scale) * 1.25, scale, shown.ink.chosen);
  }

  // A cross, which is at least as large as a cell of 9 px.
  drawFault(pen, [row, col], color) {
    const { scale } = this.camera, x = (col + 0.5) * scale, y = (row + 0.5) * scale;
    const arm = Math.max(scale, 9) * (0.5 - SHORT_SIDE / 2);
    pen.strokeStyle = color;
    pen.lineWidth = Math.max(2, scale * SHORT_SIDE);
    pen.beginPath();
    pen.moveTo(x - arm, y - arm); pen.lineTo(x + arm, y + arm);
    pen.moveTo(x - arm, y + arm); pen.lineTo(x + arm, y - arm);
    pen.stroke();
  }

  drawCursor(pen, [row, col], color) {
    const { scale } = this.camera, side = Math.max(scale, CURSOR_LEAST), inset = (scale - side) / 2;
    pen.strokeStyle = color;
    pen.lineWidth = 2;
    pen.strokeRect(col * scale + inset, row * scale + inset, side, side);
  }
}

// A pixel of an image, opaque, as browsers store it on little-endian machines.
function pixelOf([red, green, blue]) { return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0; }

function rangeOf(values, free) {
  let least = Infinity, largest = -Infinity;
  values.forEach((value, cell) => {
    if (!free[cell] || !Number.isFinite(value)) return;
    least = Math.min(least, value);
    largest = Math.max(largest, value);
  });
  return { least, largest };
}
