// The panel of the editor: what is drawn, and the controls that change it.

const MOST_ITEMS = 1000; // agents and faults
const SIDES = ["top", "right", "bottom", "left"];

class Panel {
  constructor(editor) {
    this.editor = editor;
    this.addTools();
    this.addSides();
    this.bindDrawing();
    this.bindAgents();
    editor.listen(() => this.update());
  }

  addTools() {
    this.tools = Object.entries(TOOLS).map(([tool, { label, key }]) => {
      const button = Object.assign(document.createElement("button"), { textContent: label, title: `${label} (${key})` });
      button.onclick = () => this.editor.set({ tool });
      return button;
    });
    $("toolbar").replaceChildren(...this.tools);
  }

  // Buttons that add rows and columns at each side of the map, or remove them.
  addSides() {
    for (const side of SIDES) {
      const buttons = [["add", 1], ["cut", -1]].map(([label, sign]) => {
        const button = Object.assign(document.createElement("button"), { textContent: label, id: `${label}-${side}` });
        button.onclick = () => this.change((drawing) => drawing.resized({ [side]: sign * number("grow-by") }));
        return button;
      });
      const row = line(side, ["", ""]);
      buttons.forEach((button, k) => row.cells[k + 1].append(button));
      $("edges").append(row);
    }
  }

  change(edit) { this.editor.edit(edit(this.editor.drawing)); }

  bindDrawing() {
    const { editor } = this;
    $("name").onchange = () => this.change((drawing) => drawing.with({ name: $("name").value.trim() || "drawing" }));
    $("undo").onclick = () => editor.undo();
    $("redo").onclick = () => editor.redo();
    $("new").onclick = () => editor.open(Drawing.empty(number("rows"), number("cols")));
    $("add-obstacles").onclick = () =>
      this.change((drawing) => withRandomObstacles(drawing, number("density") / 100, number("obstacle-seed")));
    $("show-weights").onchange = () => editor.set({ showsWeights: $("show-weights").checked });
    $("uniform").onclick = () => this.change((drawing) => drawing.with({ weights: null }));
    for (const name of ["along", "against"]) $(name).onchange = () => editor.set({ [name]: number(name) });
  }

  bindAgents() {
    const { editor } = this;
    $("turning").onchange = () => this.change((drawing) => drawing.with({ turning: $("turning").checked }));
    $("lifelong").onchange = () => editor.set({ lifelong: $("lifelong").checked });
    $("add-agents").onclick = () => this.addAgents(number("random-count"), number("random-goals"), number("random-seed"));
    $("turn-left").onclick = () => editor.turn(-1);
    $("turn-right").onclick = () => editor.turn(1);
    $("delete-agent").onclick = () => editor.deleteSelected();
    $("delete-agents").onclick = () => this.change((drawing) => drawing.with({ agents: [] }));
  }

  addAgents(count, goalsEach, seed) {
    const before = this.editor.drawing.agents.length;
    if (goalsEach > 1) this.editor.lifelong = true;
    this.change((drawing) => withRandomAgents(drawing, count, goalsEach, seed));
    const added = this.editor.drawing.agents.length - before;
    tell(added < count ? `${added} agents: the map has no room for ${count}` : "");
  }

  // What is shown.

  update() {
    const { editor } = this, { drawing } = editor;
    Object.keys(TOOLS).forEach((tool, k) => this.tools[k].setAttribute("aria-pressed", String(tool === editor.tool)));
    $("tool-name").textContent = TOOLS[editor.tool].label;
    $("tool-hint").textContent = TOOLS[editor.tool].hint;
    $("status").textContent = this.place();
    if (document.activeElement !== $("name")) $("name").value = drawing.name;
    $("size").textContent = `${drawing.height} × ${drawing.width}`;
    $("undo").disabled = !editor.history.past.length;
    $("redo").disabled = !editor.history.future.length;
    $("turning").checked = drawing.turning;
    $("lifelong").checked = editor.lifelong;
    $("agent-edit").hidden = editor.selected < 0;
    this.updateList();
    this.updateFaults();
  }

  // The cell under the pointer or the cursor, and the cost of the moves from it.
  place() {
    const { drawing, cursor } = this.editor, place = `row ${cursor[0]}, column ${cursor[1]}`;
    if (!drawing.weights || !drawing.isFree(...cursor)) return place;
    const costs = HEADINGS.map((name, k) => [name, drawing.weights[k * drawing.free.length + drawing.number(cursor)]]);
    return `${place} · cost ${costs.map(([name, cost]) => `${name} ${shortNumber(cost)}`).join(", ")}`;
  }

  updateList() {
    const { drawing, selected, board } = this.editor;
    if (this.listed?.agents === drawing.agents && this.listed.selected === selected) return;
    this.listed = { agents: drawing.agents, selected };
    $("agent-count").textContent = drawing.agents.length;
    const cell = ([row, col]) => `${row}, ${col}`;
    const items = drawing.agents.slice(0, MOST_ITEMS).map(({ start, goals }, agent) => {
      const dot = document.createElement("i");
      dot.style.background = board.color(agent);
      const item = listItem([dot, `${agent}: ${[start, ...goals].map(cell).join(" → ")}`], () => this.select(agent));
      if (agent === selected) item.setAttribute("aria-current", "true");
      return item;
    });
    $("agent-list").replaceChildren(...items);
    items[selected]?.scrollIntoView({ block: "nearest" });
  }

  select(agent) {
    const { camera } = this.editor.board, { start } = this.editor.drawing.agents[agent];
    if (!camera.sees(...start)) camera.center(...start);
    this.editor.set({ selected: agent });
  }

  updateFaults() {
    const faults = this.editor.faults();
    if (this.faults === faults) return;
    this.faults = faults;
    $("faults").classList.toggle("none", !faults.length);
    $("faults").querySelector("h2").textContent = faults.length ? `${faults.length} faults` : "No faults";
    const items = faults.slice(0, MOST_ITEMS).map(({ agent, text }) => listItem([text], () => this.select(agent)));
    $("faults").querySelector("ol").replaceChildren(...items);
  }
}

function number(name) {
  const { valueAsNumber, min, max } = $(name), least = min === "" ? -Infinity : Number(min), most = max === "" ? Infinity : Number(max);
  return Math.max(least, Math.min(most, Number.isNaN(valueAsNumber) ? Math.max(0, least) : valueAsNumber));
}

function listItem(content, onClick) {
  const item = document.createElement("li"), button = document.createElement("button");
  button.append(...content);
  button.onclick = onClick;
  item.append(button);
  return item;
}

// Shows one line to the user, on the drawing's screen and on that of the playback; an empty one removes it.
function tell(text) { for (const place of document.querySelectorAll(".message")) place.textContent = text; }
