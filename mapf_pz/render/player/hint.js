// A line at the pointer: the agent, or the cell and its value.

class Hint {
  constructor(element, options) { Object.assign(this, { element, options }); }

  hide() { this.element.hidden = true; }

  show(view, x, y, time) {
    const text = this.textAt(view, x, y, view.timeOf(time));
    this.element.hidden = !text;
    if (!text) return;
    this.element.textContent = text;
    const stage = this.element.parentElement, figure = view.figure;
    const left = Math.min(figure.offsetLeft + x + 14, stage.clientWidth - this.element.offsetWidth - 4);
    const below = figure.offsetTop + y + 18;
    const top = below + this.element.offsetHeight > stage.clientHeight ? below - 24 - this.element.offsetHeight : below;
    Object.assign(this.element.style, { left: `${Math.max(0, left)}px`, top: `${top}px` });
  }

  textAt(view, x, y, time) {
    const { episode, camera } = view, step = Math.floor(time), agent = view.agentAt(x, y, time);
    const place = ([row, col]) => `row ${row}, column ${col}`;
    if (agent >= 0) {
      const goal = episode.hasGoals() ? ` · goal ${place(episode.goal(agent, step))}` : "";
      const delayed = episode.isDelayed(agent, Math.ceil(time)) ? " · delayed" : "";
      const leader = episode.leader(agent, Math.ceil(time)), waits = leader >= 0 ? ` · waits for agent ${leader}` : "";
      return `agent ${agent} · ${place(episode.cell(agent, step))}${goal}${delayed}${waits}`;
    }
    const [row, col] = camera.at(x, y).map(Math.floor);
    if (!episode.isFree(row, col)) return "";
    const { legend, values, isKnown } = GROUNDS[this.options.ground];
    if (!values || !isKnown(episode)) return place([row, col]);
    return `${place([row, col])} · ${legend}: ${shortNumber(values(episode)[row * episode.width + col])}`;
  }
}
