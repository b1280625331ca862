// The editor: the drawing and its history, the tool in use, and what is shown.

class Editor {
  constructor(colors) {
    this.history = new History(Drawing.empty(16, 16));
    Object.assign(this, { drawing: this.history.current, tool: "draw", selected: -1, cursor: [0, 0], alternate: false });
    Object.assign(this, { along: 0.5, against: 2, lifelong: false, showsWeights: true, hasCursor: false });
    this.board = new Board($("board"), colors);
    this.listeners = [];
    this.setTheme(preferredTheme());
    this.refresh();
  }

  // Calls a function after each change of what is shown.
  listen(listener) { this.listeners.push(listener); listener(this); }

  // Shows the drawing in the next frame.
  refresh() {
    if (this.requested) return;
    this.requested = requestAnimationFrame(() => {
      this.requested = 0;
      if (!$("drawing").hidden) this.board.draw(this.shown());
      for (const listener of this.listeners) listener(this);
    });
  }

  shown() {
    return {
      drawing: this.drawing, selected: this.selected, faults: this.faults(), ink: this.ink, weights: this.showsWeights,
      cursor: this.hasCursor ? this.cursor : null,
    };
  }

  // The faults of the drawing, which are found once for each.
  faults() {
    const key = [this.drawing, this.lifelong];
    if (!this.checked || key.some((each, k) => each !== this.checked.key[k]))
      this.checked = { key, faults: faultsOf(this.drawing, this.lifelong) };
    return this.checked.faults;
  }

  setTheme(theme) {
    this.theme = theme;
    this.ink = themeInk(theme);
    this.refresh();
  }

  set(changes) { Object.assign(this, changes); this.refresh(); }

  resize() { this.board.resize(); this.board.draw(this.shown()); }

  // Edits.

  edit(drawing) {
    this.cancel();
    this.history.add(drawing);
    this.show();
  }

  // Replaces the drawing by one from elsewhere, which can be undone.
  open(drawing) {
    this.selected = -1;
    this.lifelong = drawing.agents.some(({ goals }) => goals.length > 1);
    this.edit(drawing);
  }

  undo() { this.cancel(); this.history.undo(); this.show(); }
  redo() { this.cancel(); this.history.redo(); this.show(); }

  show() {
    this.drawing = this.history.current;
    if (this.selected >= this.drawing.agents.length) this.selected = -1;
    this.cursor = this.drawing.inside(this.cursor);
    this.refresh();
  }

  // The tool: it is pressed at a cell, dragged to others, and released.

  press(cell, alternate = false) {
    this.alternate = alternate;
    this.stroke = { before: this.drawing, path: [cell] };
    const tool = TOOLS[this.tool];
    this.drawing = tool.press ? tool.press(this.drawing, cell, this) : tool.drag(this.drawing, [cell], this);
    this.refresh();
  }

  drag(cell) {
    const { before, path } = this.stroke, tool = TOOLS[this.tool];
    if (sameCell(cell, path.at(-1)) || !tool.drag) return;
    path.push(...cellsBetween(path.at(-1), cell).slice(1));
    this.drawing = tool.drag(before, path, this);
    this.refresh();
  }

  release() {
    if (!this.stroke) return;
    this.stroke = null;
    this.history.add(this.drawing);
    this.refresh();
  }

  // Ends a stroke without its changes.
  cancel() {
    if (!this.stroke) return;
    this.stroke = null;
    this.drawing = this.history.current;
    this.refresh();
  }

  // Agents.

  turn(quarters) {
    const agent = this.drawing.agents[this.selected];
    if (agent) this.edit(this.drawing.withAgent(this.selected, { heading: (agent.heading + quarters + 4) % 4 }));
  }

  deleteSelected() { if (this.selected >= 0) this.edit(this.drawing.withoutAgent(this.selected)); }

  selectNext(by) {
    const count = this.drawing.agents.length;
    if (count) this.set({ selected: (Math.max(this.selected, by > 0 ? -1 : 0) + by + count) % count });
  }

  moveCursor(down, right) {
    this.hasCursor = true;
    this.cursor = this.drawing.inside([this.cursor[0] + down, this.cursor[1] + right]);
    if (this.stroke) this.drag(this.cursor);
    if (!this.board.camera.sees(...this.cursor)) this.board.camera.center(...this.cursor);
    this.refresh();
  }
}
