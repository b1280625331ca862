"use strict";
// Plays a recording. The page is one file: the element `data` holds the recording, packed by `html.py`.

const $ = (name) => document.getElementById(name);
const HEADINGS = ["east", "south", "west", "north"];
const ACTIVE = 1, BLOCKED = 2;
const SPEEDS = [1, 2, 4, 8, 16, 32, 64];
const TRAIL = 60; // steps
const LARGEST_SCALE = 96; // px per cell
const ARROW_SCALE = 8; // px per cell, from which on arrows are drawn
const FULL_RATIO = 4; // of the weights of an edge's two directions, for arrows of full size

// Unpacking.

async function unpack(text, Type) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Type(await new Response(stream).arrayBuffer());
}

async function unpackAll(data) {
  const types = { cells: Int32Array, goals: Int32Array, weights: Float32Array, observed: Int8Array };
  const arrays = {};
  for (const [name, text] of Object.entries(data.arrays)) arrays[name] = await unpack(text, types[name] ?? Uint8Array);
  for (const name of ["cells", "goals"]) if (arrays[name]) addUp(arrays[name], data.steps + 1);
  return arrays;
}

// Each agent's cells are stored as the first cell and the differences between steps.
function addUp(values, length) {
  for (let i = 0; i < values.length; i++) if (i % length) values[i] += values[i - 1];
}

class Player {
  constructor(data, arrays) {
    Object.assign(this, data, arrays);
    this.at = 0; // the current step; fractional while playing
    this.playing = false;
    this.chosen = -1;
    this.canvas = $("view");
    this.pen = this.canvas.getContext("2d");
    this.scale = 1; this.left = 0; this.top = 0; // px per cell, and the corner of the map
    this.colors = data.colors;
    this.maps = {};
    this.bind();
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    this.resize();
    this.fit();
    this.seek(0);
    requestAnimationFrame((now) => this.tick(now));
  }

  // Cells and states.

  index(agent, step) { return agent * (this.steps + 1) + step; }
  row(cell) { return Math.floor(cell / this.width); }
  col(cell) { return cell % this.width; }
  isActive(agent, step) { return (this.flags[this.index(agent, step)] & ACTIVE) > 0; }
  isBlocked(agent, step) { return (this.flags[this.index(agent, step)] & BLOCKED) > 0; }
  isAtGoal(agent, step) { return this.goals !== undefined && this.cells[this.index(agent, step)] === this.goals[this.index(agent, step)]; }

  // The displayed position of an agent, which is between two cells while it moves.
  positionOf(agent) {
    const before = Math.floor(this.at), after = Math.min(before + 1, this.steps), part = this.at - before;
    const from = this.cells[this.index(agent, before)], to = this.cells[this.index(agent, after)];
    const near = Math.abs(this.row(from) - this.row(to)) + Math.abs(this.col(from) - this.col(to)) <= 1;
    const share = near ? part : Math.round(part);
    return {
      row: this.row(from) + (this.row(to) - this.row(from)) * share,
      col: this.col(from) + (this.col(to) - this.col(from)) * share,
    };
  }

  angle(agent) {
    const before = Math.floor(this.at), after = Math.min(before + 1, this.steps), part = this.at - before;
    const from = this.headings[this.index(agent, before)], to = this.headings[this.index(agent, after)];
    const turn = ((to - from + 5) % 4) - 1; // -1, 0, 1 or 2 quarters to the right
    return ((from + turn * part) * Math.PI) / 2;
  }

  // For scripts that control the player.
  state() {
    const shown = Math.floor(this.at), positions = [];
    for (let i = 0; i < this.agents; i++) {
      const cell = this.cells[this.index(i, shown)];
      positions.push([this.row(cell), this.col(cell)]);
    }
    return { step: this.at, playing: this.playing, chosen: this.chosen, positions, theme: this.theme };
  }

  // The position of a cell's center on the page.
  onPage(row, col) {
    const box = this.canvas.getBoundingClientRect();
    return [box.left + this.left + (col + 0.5) * this.scale, box.top + this.top + (row + 0.5) * this.scale];
  }

  // Playback.

  seek(step) {
    this.at = Math.max(0, Math.min(this.steps, step));
    $("scrub").value = Math.floor(this.at);
    $("step").value = `${Math.floor(this.at)} / ${this.steps}`;
    this.updatePanel();
    this.dirty = true;
  }

  play(on) {
    if (on && this.at >= this.steps) this.seek(0);
    this.playing = on;
    if (!on) this.seek(Math.round(this.at));
    $("play").textContent = on ? "pause" : "play";
  }

  tick(now) {
    if (this.playing) {
      const seconds = Math.min(0.1, (now - (this.last ?? now)) / 1000);
      this.seek(this.at + seconds * Number($("speed").value));
      if (this.at >= this.steps) this.play(false);
    }
    this.last = now;
    if (this.dirty) this.draw();
    this.dirty = false;
    requestAnimationFrame((next) => this.tick(next));
  }

  // Drawing.

  resize() {
    const ratio = devicePixelRatio || 1, box = this.canvas.parentElement.getBoundingClientRect();
    this.canvas.width = Math.max(1, Math.round(box.width * ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * ratio));
    this.ratio = ratio; this.box = box;
    this.dirty = true;
  }

  fit() {
    const room = 16;
    this.scale = Math.min(
      LARGEST_SCALE, (this.box.width - room) / this.width, (this.box.height - room) / this.height,
    );
    this.left = (this.box.width - this.scale * this.width) / 2;
    this.top = (this.box.height - this.scale * this.height) / 2;
    this.dirty = true;
  }

  zoom(factor, x, y) {
    const least = Math.min(this.box.width / this.width, this.box.height / this.height) / 2;
    const scale = Math.max(least, Math.min(LARGEST_SCALE, this.scale * factor));
    this.left = x - ((x - this.left) * scale) / this.scale;
    this.top = y - ((y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.dirty = true;
  }

  setTheme(name) {
    this.theme = name;
    document.documentElement.dataset.theme = name;
    const style = getComputedStyle(document.documentElement);
    this.ink = {};
    for (const key of ["page", "free", "obstacle", "grid", "mark", "blocked", "chosen"])
      this.ink[key] = style.getPropertyValue(`--${key}`).trim();
    this.maps = {};
    this.dirty = true;
  }

  // An image of the map with one pixel per cell.
  mapPicture(kind) {
    if (this.maps[kind]) return this.maps[kind];
    const picture = new OffscreenCanvas(this.width, this.height), pen = picture.getContext("2d");
    const heat = kind === "heat" ? this.heatOf() : null;
    for (let cell = 0; cell < this.width * this.height; cell++) {
      pen.fillStyle = !this.free[cell] ? this.ink.obstacle : heat ? heat(cell) : this.ink.free;
      pen.fillRect(this.col(cell), this.row(cell), 1, 1);
    }
    return (this.maps[kind] = picture);
  }

  // Colors cells by the mean cost of leaving them, from cheap to expensive.
  heatOf() {
    const cells = this.width * this.height, mean = new Float32Array(cells);
    let least = Infinity, most = -Infinity;
    for (let cell = 0; cell < cells; cell++) {
      const costs = [0, 1, 2, 3].map((k) => this.weights[k * cells + cell]).filter(Number.isFinite);
      if (!costs.length) continue;
      mean[cell] = costs.reduce((sum, cost) => sum + cost) / costs.length;
      least = Math.min(least, mean[cell]); most = Math.max(most, mean[cell]);
    }
    return (cell) => {
      const share = most > least ? (mean[cell] - least) / (most - least) : 0.5;
      return `hsl(${220 - 200 * share} 70% ${this.theme === "dark" ? 30 + 12 * share : 88 - 22 * share}%)`;
    };
  }

  draw() {
    const { pen, scale } = this;
    if ($("follow").checked && this.chosen >= 0) {
      const { row, col } = this.positionOf(this.chosen);
      this.left = this.box.width / 2 - (col + 0.5) * scale;
      this.top = this.box.height / 2 - (row + 0.5) * scale;
    }
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    pen.fillStyle = this.ink.page;
    pen.fillRect(0, 0, this.box.width, this.box.height);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(
      this.mapPicture($("heat").checked ? "heat" : "plain"), this.left, this.top, this.width * scale, this.height * scale,
    );
    pen.translate(this.left, this.top);
    if (scale >= 14) this.drawGrid();
    if (scale >= ARROW_SCALE && $("arrows").checked) this.drawArrows();
    if (this.goals && $("goals").checked) this.drawGoals();
    if (this.chosen >= 0) this.drawChosen();
    this.drawAgents();
  }

  drawGrid() {
    const { pen, scale } = this;
    pen.strokeStyle = this.ink.grid; pen.lineWidth = 1;
    pen.beginPath();
    for (let row = 0; row <= this.height; row++) { pen.moveTo(0, row * scale); pen.lineTo(this.width * scale, row * scale); }
    for (let col = 0; col <= this.width; col++) { pen.moveTo(col * scale, 0); pen.lineTo(col * scale, this.height * scale); }
    pen.stroke();
  }

  // The edges that are cheaper in one direction than in the other, as in `guidance.py`.
  cheaperEdges() {
    if (this.cheaper) return this.cheaper;
    const cells = this.width * this.height, steps = [1, this.width, -1, -this.width];
    this.cheaper = [];
    for (let heading = 0; heading < 4; heading++)
      for (let cell = 0; cell < cells; cell++) {
        const weight = this.weights[heading * cells + cell], to = cell + steps[heading];
        const inRow = heading % 2 === 1 || this.row(to) === this.row(cell);
        if (!Number.isFinite(weight) || !inRow || !this.free[cell] || !this.free[to]) continue;
        const opposite = this.weights[((heading + 2) % 4) * cells + to];
        const strength = Math.min(1, Math.log(opposite / weight) / Math.log(FULL_RATIO));
        if (strength > 0) this.cheaper.push({ heading, cell, strength });
      }
    return this.cheaper;
  }

  // An arrow on the border between two cells.
  drawArrows() {
    const { pen, scale } = this;
    pen.fillStyle = this.ink.chosen;
    for (const { heading, cell, strength } of this.cheaperEdges()) {
      const angle = (heading * Math.PI) / 2, cos = Math.round(Math.cos(angle)), sin = Math.round(Math.sin(angle));
      const x = this.col(cell) + 0.5 + cos / 2, y = this.row(cell) + 0.5 + sin / 2;
      const length = 0.14 + 0.2 * strength, width = 0.1 + 0.1 * strength;
      const at = (along, aside) => [scale * (x + along * cos - aside * sin), scale * (y + along * sin + aside * cos)];
      pen.globalAlpha = 0.35 + 0.65 * strength;
      pen.beginPath(); pen.moveTo(...at(length, 0)); pen.lineTo(...at(-length, width)); pen.lineTo(...at(-length, -width));
      pen.closePath(); pen.fill();
    }
    pen.globalAlpha = 1;
  }

  drawGoals() {
    const { pen, scale } = this, step = Math.floor(this.at);
    pen.lineWidth = Math.max(1, scale * 0.07);
    for (let agent = 0; agent < this.agents; agent++) {
      if (!this.isActive(agent, step)) continue;
      const cell = this.goals[this.index(agent, step)], inset = scale * 0.1;
      pen.strokeStyle = this.colors[agent];
      pen.strokeRect(
        this.col(cell) * scale + inset, this.row(cell) * scale + inset, scale - 2 * inset, scale - 2 * inset,
      );
    }
  }

  // The chosen agent's trail, and a line to its goal.
  drawChosen() {
    const { pen, scale } = this, step = Math.floor(this.at), { row, col } = this.positionOf(this.chosen);
    const middle = (value) => (value + 0.5) * scale;
    pen.strokeStyle = this.colors[this.chosen]; pen.lineWidth = Math.max(2, scale * 0.18); pen.lineJoin = "round";
    pen.globalAlpha = 0.45;
    pen.beginPath(); pen.moveTo(middle(col), middle(row));
    for (let past = step; past >= Math.max(0, step - TRAIL); past--) {
      const cell = this.cells[this.index(this.chosen, past)];
      pen.lineTo(middle(this.col(cell)), middle(this.row(cell)));
    }
    pen.stroke();
    pen.globalAlpha = 1;
    if (!this.goals) return;
    const goal = this.goals[this.index(this.chosen, step)];
    pen.strokeStyle = this.ink.chosen; pen.lineWidth = Math.max(1, scale * 0.06); pen.setLineDash([scale * 0.3, scale * 0.2]);
    pen.beginPath(); pen.moveTo(middle(col), middle(row)); pen.lineTo(middle(this.col(goal)), middle(this.row(goal)));
    pen.stroke(); pen.setLineDash([]);
    pen.strokeRect(this.col(goal) * scale, this.row(goal) * scale, scale, scale);
  }

  drawAgents() {
    const { pen, scale } = this, radius = scale * (scale >= 12 ? 0.38 : 0.48);
    const step = Math.floor(this.at), next = Math.ceil(this.at), marks = $("blocked").checked;
    for (let agent = 0; agent < this.agents; agent++) {
      if (!this.isActive(agent, step)) continue;
      const { row, col } = this.positionOf(agent), x = (col + 0.5) * scale, y = (row + 0.5) * scale;
      if (x + this.left < -scale || y + this.top < -scale) continue;
      if (x + this.left > this.box.width + scale || y + this.top > this.box.height + scale) continue;
      pen.fillStyle = this.colors[agent];
      pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.fill();
      if (this.headings && scale >= 5) this.drawHeading(x, y, radius, this.angle(agent));
      if (marks && this.isBlocked(agent, next)) this.ring(x, y, radius, this.ink.blocked);
      if (agent === this.chosen) this.ring(x, y, radius * 1.25, this.ink.chosen);
    }
  }

  drawHeading(x, y, radius, angle) {
    const { pen } = this, at = (along, aside) => [
      x + radius * (along * Math.cos(angle) - aside * Math.sin(angle)),
      y + radius * (along * Math.sin(angle) + aside * Math.cos(angle)),
    ];
    pen.fillStyle = this.ink.mark;
    pen.beginPath(); pen.moveTo(...at(0.85, 0)); pen.lineTo(...at(-0.15, 0.6)); pen.lineTo(...at(-0.15, -0.6));
    pen.closePath(); pen.fill();
  }

  ring(x, y, radius, color) {
    const { pen } = this;
    pen.strokeStyle = color; pen.lineWidth = Math.max(1.5, this.scale * 0.09);
    pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.stroke();
  }

  // The panel.

  choose(agent) {
    this.chosen = agent >= 0 && agent < this.agents ? agent : -1;
    $("agent").value = this.chosen < 0 ? "" : this.chosen;
    this.updatePanel();
    this.dirty = true;
  }

  updatePanel() {
    const step = Math.floor(this.at), { chosen } = this;
    if (this.panelKey === `${step} ${chosen}`) return;
    this.panelKey = `${step} ${chosen}`;
    let active = 0, atGoals = 0, blocked = 0;
    for (let agent = 0; agent < this.agents; agent++) {
      if (this.isActive(agent, step)) active++;
      if (this.isAtGoal(agent, step)) atGoals++;
      if (this.isBlocked(agent, step)) blocked++;
    }
    const facts = { agents: this.agents };
    if (this.goals) facts["at their goals"] = atGoals;
    if (this.hasBlocked) facts["moves blocked"] = blocked;
    if (active < this.agents) facts["on the map"] = active;
    list($("facts"), { ...facts, ...this.facts });
    if (chosen < 0) { list($("agent-facts"), {}); $("planes").replaceChildren(); $("unobserved").hidden = true; return; }
    const cell = this.cells[this.index(chosen, step)], goal = this.goals?.[this.index(chosen, step)];
    list($("agent-facts"), {
      "row, column": `${this.row(cell)}, ${this.col(cell)}`,
      ...(this.headings ? { heading: HEADINGS[this.headings[this.index(chosen, step)]] } : {}),
      ...(this.goals ? { goal: `${this.row(goal)}, ${this.col(goal)}` } : {}),
      ...(this.goals ? { "at its goal": this.isAtGoal(chosen, step) ? "yes" : "no" } : {}),
      ...(this.hasBlocked ? { "move blocked": this.isBlocked(chosen, step) ? "yes" : "no" } : {}),
    });
    $("unobserved").hidden = chosen < this.observers;
    if (chosen < this.observers) this.showObserved(step); else $("planes").replaceChildren();
  }

  showObserved(step) {
    const [rows, cols] = this.viewSize, size = rows * cols;
    if ($("planes").childElementCount !== this.planes.length)
      $("planes").replaceChildren(...this.planes.map((name) => planeFigure(name, rows, cols)));
    [...$("planes").children].forEach((figure, k) => {
      const pen = figure.firstChild.getContext("2d"), picture = pen.createImageData(cols, rows);
      const from = ((step * this.observers + this.chosen) * this.planes.length + k) * size;
      for (let i = 0; i < size; i++) picture.data.set(shade(this.observed[from + i] / 127), 4 * i);
      pen.putImageData(picture, 0, 0);
    });
  }

  // User input.

  bind() {
    $("scrub").max = this.steps; $("agent").max = this.agents - 1;
    $("heat-label").hidden = $("arrows-label").hidden = !this.weights;
    for (const speed of SPEEDS) $("speed").add(new Option(`${speed} / s`, speed, speed === this.speed, speed === this.speed));
    $("play").onclick = () => this.play(!this.playing);
    $("back").onclick = () => this.seekBy(-1);
    $("forth").onclick = () => this.seekBy(1);
    $("scrub").oninput = () => {
      const step = Number($("scrub").value); // stopping moves the slider
      this.play(false);
      this.seek(step);
    };
    $("theme").onclick = () => this.setTheme(this.theme === "dark" ? "light" : "dark");
    $("agent").oninput = () => this.choose($("agent").value === "" ? -1 : Number($("agent").value));
    for (const name of ["blocked", "goals", "heat", "arrows", "follow"]) $(name).onchange = () => { this.dirty = true; };
    addEventListener("resize", () => this.resize());
    addEventListener("keydown", (event) => this.key(event));
    this.canvas.onwheel = (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
    };
    this.canvas.onpointerdown = (event) => {
      this.drag = { x: event.offsetX, y: event.offsetY, moved: false };
      this.canvas.setPointerCapture(event.pointerId);
    };
    this.canvas.onpointermove = (event) => {
      if (!this.drag) return;
      const dx = event.offsetX - this.drag.x, dy = event.offsetY - this.drag.y;
      if (!this.drag.moved && Math.hypot(dx, dy) < 4) return;
      this.canvas.classList.add("dragging");
      $("follow").checked = false;
      this.left += dx; this.top += dy;
      this.drag = { x: event.offsetX, y: event.offsetY, moved: true };
      this.dirty = true;
    };
    this.canvas.onpointerup = () => {
      if (this.drag && !this.drag.moved) this.choose(this.agentAt(this.drag.x, this.drag.y));
      this.canvas.classList.remove("dragging");
      this.drag = null;
    };
  }

  seekBy(steps) { this.play(false); this.seek(Math.round(this.at) + steps); }

  key(event) {
    if (event.target.matches("input[type=number], select")) return;
    const actions = {
      " ": () => this.play(!this.playing), ArrowLeft: () => this.seekBy(-1), ArrowRight: () => this.seekBy(1),
      Home: () => this.seekBy(-this.steps), End: () => this.seekBy(this.steps), 0: () => this.fit(),
      "+": () => this.zoom(1.25, this.box.width / 2, this.box.height / 2),
      "-": () => this.zoom(0.8, this.box.width / 2, this.box.height / 2),
      d: () => $("theme").click(), Escape: () => this.choose(-1),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  }

  agentAt(x, y) {
    const col = (x - this.left) / this.scale - 0.5, row = (y - this.top) / this.scale - 0.5, step = Math.floor(this.at);
    let found = -1, nearest = Math.max(0.7, 8 / this.scale);
    for (let agent = 0; agent < this.agents; agent++) {
      const position = this.positionOf(agent), distance = Math.hypot(position.row - row, position.col - col);
      if (this.isActive(agent, step) && distance < nearest) { nearest = distance; found = agent; }
    }
    return found;
  }
}

function list(element, facts) {
  element.replaceChildren(...Object.entries(facts).flatMap(([name, value]) => [
    Object.assign(document.createElement("dt"), { textContent: name }),
    Object.assign(document.createElement("dd"), { textContent: value }),
  ]));
}

function planeFigure(name, rows, cols) {
  const figure = document.createElement("figure"), canvas = document.createElement("canvas");
  const size = Math.max(2, Math.min(18, Math.floor(110 / Math.max(rows, cols))));
  Object.assign(canvas, { width: cols, height: rows });
  Object.assign(canvas.style, { width: `${cols * size}px`, height: `${rows * size}px` });
  figure.append(canvas, Object.assign(document.createElement("figcaption"), { textContent: name }));
  return figure;
}

// -1 red, 0 white, 1 blue.
function shade(value) {
  const fade = Math.round(255 * (1 - Math.min(1, Math.abs(value))));
  return value < 0 ? [214, Math.round(fade * 0.85), Math.round(fade * 0.85), 255] : [fade, Math.round(255 - (255 - fade) * 0.6), 255, 255];
}

(async () => {
  const data = JSON.parse($("data").textContent);
  window.player = new Player(data, await unpackAll(data));
  document.body.dataset.ready = "yes";
})();
