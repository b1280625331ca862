// One episode on a canvas.

class View {
  constructor(episode, compared, camera, options) {
    Object.assign(this, { episode, camera, options, ground: new Ground(episode, compared) });
    this.canvas = document.createElement("canvas");
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Map with ${episode.agents} agents: ${episode.title}`);
    this.figure = document.createElement("figure");
    this.figure.append(this.canvas);
    this.pen = this.canvas.getContext("2d");
  }

  addCaption(text) {
    this.figure.append(Object.assign(document.createElement("figcaption"), { textContent: text }));
  }

  // One canvas pixel for each pixel of the screen. The style has whole px, so nothing is stretched.
  resize() {
    this.ratio = devicePixelRatio || 1;
    const width = Math.max(1, this.figure.clientWidth), height = Math.max(1, this.figure.clientHeight);
    Object.assign(this.canvas, { width: Math.round(width * this.ratio), height: Math.round(height * this.ratio) });
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    this.camera.resize(width, height);
  }

  // The player's time as a time of this episode, which may be shorter.
  timeOf(time) { return Math.min(time, this.episode.steps); }

  draw(time) {
    this.pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.drawWith(this.pen, this.timeOf(time));
  }

  // The shown part as the text of an SVG file.
  svg(time) {
    const pen = new SvgPen(this.camera.boxWidth, this.camera.boxHeight);
    this.drawWith(pen, this.timeOf(time));
    return pen.text();
  }

  drawWith(pen, time) {
    const { camera, episode, options } = this, step = Math.floor(time);
    pen.fillStyle = options.ink.page;
    pen.fillRect(0, 0, camera.boxWidth, camera.boxHeight);
    pen.translate(camera.left, camera.top);
    this.ground.draw(pen, camera, options.ink, options.ground);
    if (options.directions && episode.weights) drawDirections(pen, episode, camera, options.ink.arrow);
    if (options.goals && episode.hasGoals()) drawGoals(pen, episode, camera, step);
    const isChosen = options.chosen >= 0 && options.chosen < episode.agents;
    if (isChosen) drawChosen(pen, episode, camera, time, options);
    if (isChosen && options.attention) drawAttention(pen, episode, camera, time, options);
    drawAgents(pen, episode, camera, time, options);
    if (episode.waitsFor) drawWaits(pen, episode, camera, time, options.ink);
    drawViolations(pen, episode, camera, Math.ceil(time), options.ink.blocked);
    if (isChosen && options.pointed) drawPointed(pen, options.pointed, camera, options.ink.blocked);
  }

  // The agent near a pixel; -1 if there is none.
  agentAt(x, y, time) {
    const [row, col] = this.camera.at(x, y), shown = this.timeOf(time);
    let found = -1, nearest = Math.max(0.7, 10 / this.camera.scale);
    for (let agent = 0; agent < this.episode.agents; agent++) {
      const [r, c] = this.episode.position(agent, shown), distance = Math.hypot(r + 0.5 - row, c + 0.5 - col);
      if (this.episode.isActive(agent, Math.floor(shown)) && distance < nearest) { nearest = distance; found = agent; }
    }
    return found;
  }
}
