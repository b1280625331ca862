// Plays one or several episodes at the same time: the clock, the selected agent, and the panel.

const SPEEDS = [1, 2, 4, 8, 16, 32, 64]; // steps per second
const LONGEST_FRAME = 0.1; // s; after a pause of the browser, playback continues where it was

const $ = (name) => document.getElementById(name);

class Player {
  constructor(episodes, speed) {
    this.episodes = episodes;
    this.steps = Math.max(...episodes.map((episode) => episode.steps));
    this.agents = Math.max(...episodes.map((episode) => episode.agents));
    this.captions = episodes.map((episode) => episode.caption);
    this.time = 0; // the current step; fractional while playing
    this.playing = false;
    this.options = { chosen: -1, pointed: null };
    const sides = ["height", "width"].map((side) => Math.max(...episodes.map((episode) => episode[side])));
    this.camera = new Camera(...sides);
    this.views = episodes.map((episode) => new View(episode, episodes, this.camera, this.options));
    this.addressBar = new AddressBar();
    this.ended = new AbortController();
    this.hint = new Hint($("hint"), this.options);
    this.planes = episodes.map(({ caption }) => new Planes(episodes.length > 1 ? caption : "", (cell) => this.point(cell)));
    const open = (agent) => this.choose(agent);
    this.decisions = episodes.map(({ caption }) => new DecisionTable(episodes.length > 1 ? caption : "", open));
    this.controls = new Controls(episodes, this.options, () => this.changeOptions());
    this.fillPanel();
    this.bind(speed);
    this.setTheme(preferredTheme());
    this.camera.fits = true;
    this.resize();
    this.followAddress();
    requestAnimationFrame((now) => this.tick(now));
  }

  // What is shown.

  fillPanel() {
    $("views").replaceChildren(...this.views.map((view) => view.figure));
    if (this.views.length > 1) this.views.forEach((view, k) => view.addCaption(this.captions[k]));
    $("decisions").replaceChildren(...this.decisions.map((decision) => decision.element));
    $("planes").replaceChildren(...this.planes.map((planes) => planes.element));
    $("scrub").max = this.steps;
    $("agent").max = this.agents - 1;
    listViolations($("violations"), this.episodes, this.captions, (step, agent) => this.show(step, agent));
    showThroughput($("throughput"), this.episodes, this.captions);
    fillTable($("final"), finalRows(this.episodes), this.captions);
    fillTable($("facts"), rowsOf(this.episodes.map((episode) => episode.facts)), this.captions);
    for (const name of ["final", "facts"]) $(name).parentElement.hidden = !$(name).rows.length;
  }

  updatePanel() {
    const step = Math.floor(this.time), { chosen } = this.options, key = `${step} ${chosen}`;
    if (this.panelKey === key) return;
    this.panelKey = key;
    $("scrub").value = step;
    $("scrub").setAttribute("aria-valuetext", `step ${step} of ${this.steps}`);
    $("now").textContent = step;
    $("step").value = `${step} / ${this.steps}`;
    const present = presentRows(this.episodes, this.time);
    fillTable($("present"), present, this.captions);
    $("present").parentElement.hidden = !present.length;
    markCurrentViolations($("violations"), step);
    markThroughput($("throughput"), step, this.steps);
    fillTable($("agent-facts"), chosen < 0 ? [] : agentRows(this.episodes, chosen, this.time), this.captions);
    this.episodes.forEach((episode, k) => {
      for (const part of [this.decisions[k], this.planes[k]])
        if (chosen < 0 || chosen >= episode.agents) part.clear();
        else part.show(episode, chosen, Math.min(step, episode.steps));
    });
  }

  changeOptions() {
    if (this.options.follow && this.options.chosen < 0) this.choose(0);
    this.redraw();
  }

  redraw() { this.dirty = true; }

  draw() {
    if (this.options.follow && this.options.chosen >= 0) {
      const view = this.views.find(({ episode }) => this.options.chosen < episode.agents);
      this.camera.center(...view.episode.position(this.options.chosen, view.timeOf(this.time)));
    }
    for (const view of this.views) view.draw(this.time);
    showLegend($("legend"), this.views[0], this.options);
    this.dirty = false;
  }

  resize() {
    for (const view of this.views) view.resize();
    this.draw(); // at once, as a canvas is empty after a change of its size
  }

  setTheme(name) {
    this.theme = name;
    this.options.ink = themeInk(name);
    this.redraw();
  }

  toggleTheme() { this.setTheme(this.theme === "dark" ? "light" : "dark"); }

  fit() { this.controls.set("follow", false); this.camera.fit(); this.redraw(); }
  pan(dx, dy) { this.controls.set("follow", false); this.camera.pan(dx, dy); this.redraw(); }
  zoom(factor, x, y) { this.camera.zoom(factor, x, y); this.redraw(); }
  point(cell) { this.options.pointed = cell; this.redraw(); }

  // The clock.

  seek(step) {
    this.time = Math.max(0, Math.min(this.steps, step));
    this.updatePanel();
    this.redraw();
    if (!this.playing) this.addressBar.write(Math.floor(this.time), this.options.chosen);
  }

  seekBy(steps) { this.play(false); this.seek(Math.round(this.time) + steps); }

  play(on) {
    if (on && this.time >= this.steps) this.seek(0);
    this.playing = on;
    if (!on) this.seek(Math.round(this.time));
    $("play").textContent = on ? "pause" : "play";
  }

  tick(now) {
    if (this.ended.signal.aborted) return;
    if (this.playing) {
      const seconds = Math.min(LONGEST_FRAME, (now - this.last) / 1000);
      this.seek(this.time + seconds * Number($("speed").value));
      if (this.time >= this.steps) this.play(false);
    }
    this.last = now;
    if (this.dirty) this.draw();
    requestAnimationFrame((next) => this.tick(next));
  }

  // The selected agent.

  choose(agent) {
    this.options.chosen = agent >= 0 && agent < this.agents ? agent : -1;
    const text = this.options.chosen < 0 ? "" : String(agent);
    if ($("agent").value !== text) $("agent").value = text;
    this.seek(this.time);
  }

  chooseNext(by) { this.choose((Math.max(this.options.chosen, by > 0 ? -1 : 0) + by + this.agents) % this.agents); }

  // Shows a step and selects an agent; -1 leaves either as it is.
  show(step, agent) {
    this.play(false);
    this.choose(agent >= 0 ? agent : this.options.chosen);
    this.seek(step >= 0 ? step : this.time);
  }

  followAddress() {
    const { step, agent } = parseAddress(location.hash);
    this.show(step, agent);
  }

  // Controls.

  bind(speed) {
    $("speed").replaceChildren(...SPEEDS.map((each) => new Option(`${each} / s`, each, each === speed, each === speed)));
    $("play").onclick = () => this.play(!this.playing);
    $("back").onclick = () => this.seekBy(-1);
    $("forth").onclick = () => this.seekBy(1);
    $("scrub").oninput = () => {
      const step = Number($("scrub").value); // stopping moves the slider
      this.play(false);
      this.seek(step);
    };
    $("smaller").onclick = () => this.zoom(0.8);
    $("larger").onclick = () => this.zoom(1.25);
    $("whole").onclick = () => this.fit();
    $("theme").onclick = () => this.toggleTheme();
    $("agent").oninput = () => this.choose($("agent").value === "" ? -1 : Number($("agent").value));
    $("png").onclick = () => this.views.forEach((view) => savePng(view, this.time));
    $("svg").onclick = () => this.views.forEach((view) => saveSvg(view, this.time));
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe($("views"));
    addEventListener("hashchange", () => this.followAddress(), { signal: this.ended.signal });
    bindKeys(this, this.ended.signal);
    for (const view of this.views) new Pointer(this, view);
  }

  // Ends the player, so that another one can use the page.
  end() {
    this.ended.abort();
    this.sizes.disconnect();
  }

  // For scripts that control the player.

  state() {
    const step = Math.floor(this.time), [episode] = this.episodes;
    const shown = Math.min(step, episode.steps);
    const positions = Array.from({ length: episode.agents }, (_, agent) => episode.cell(agent, shown));
    return { step: this.time, playing: this.playing, chosen: this.options.chosen, positions, theme: this.theme };
  }

  // The position of a cell's center on the page.
  onPage(row, col) {
    const box = this.views[0].canvas.getBoundingClientRect(), { left, top, scale } = this.camera;
    return [box.left + left + (col + 0.5) * scale, box.top + top + (row + 0.5) * scale];
  }
}
