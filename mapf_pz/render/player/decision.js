// The decision of the selected agent: probabilities, mask, the action taken and why, attention, and features.

class DecisionTable {
  constructor(caption, open) { // `open` selects an agent
    Object.assign(this, { caption, open, element: document.createElement("div") });
    this.features = document.createElement("details"); // remains open or closed
    this.features.append(document.createElement("summary"), document.createElement("table"));
  }

  clear() { this.element.replaceChildren(); }

  show(episode, agent, step) {
    if (!episode.inspection) { this.clear(); return; }
    const title = Object.assign(document.createElement("h3"), { textContent: "Decision" });
    this.element.replaceChildren(title, ...(this.caption ? [paragraph(this.caption)] : []));
    if (!isDecided(episode, agent, step)) { this.element.append(paragraph(this.absence(episode, agent, step))); return; }
    this.element.append(barTable(this.actionRows(episode, agent, step)), ...this.override(episode, agent, step));
    const attention = attentionOf(episode, agent, step);
    if (attention.length) this.element.append(subtitle("Attention"), barTable(this.attentionRows(attention, agent, step)));
    if (episode.features) this.showFeatures(episode, agent, step);
  }

  // Why no decision is shown.
  absence(episode, agent, step) {
    if (agent >= episode.inspection.agents) return "This agent's decisions were not recorded.";
    return step < episode.steps ? "The agent has disappeared." : "None in the last step.";
  }

  actionRows(episode, agent, step) {
    const at = agent * episode.steps + step, { actions } = episode.inspection;
    const preferred = episode.preferred?.[at], taken = episode.actions?.[episode.index(agent, step + 1)];
    return actionNames(episode).map((name, action) => {
      const allowed = (episode.allowed[at] >> action) & 1;
      const marks = [preferred === action && "preferred", taken === action && "taken", !allowed && "not allowed"];
      const row = { name, mark: marks.filter(Boolean).join(", "), kinds: [] };
      if (!allowed) row.kinds.push("forbidden");
      if (taken === action) row.kinds.push("taken");
      if (episode.probabilities) row.share = episode.probabilities[at * actions + action] / 65535;
      if (episode.probabilities) row.value = row.share.toFixed(3);
      else if (episode.means) row.value = episode.means[at * actions + action].toFixed(3);
      return row;
    });
  }

  // What was made of the preferred action, if another one was taken.
  override(episode, agent, step) {
    const preferred = episode.preferred?.[agent * episode.steps + step];
    const notes = episode.means ? [paragraph("Numbers are means of the preferences.")] : [];
    const taken = episode.actions?.[episode.index(agent, step + 1)];
    if (preferred === undefined || taken === undefined || taken === preferred) return notes;
    const names = actionNames(episode), chosen = `${names[taken]} instead of ${names[preferred]}`;
    if (!episode.inspection.hasSafetyLayer) return [...notes, paragraph(`The action mode sampled ${chosen}.`)];
    const cause = overriddenBecause(episode, agent, step, preferred);
    const note = Object.assign(paragraph(`The safety layer took ${chosen}: ${cause}.`), { className: "refused" });
    return [...notes, note];
  }

  attentionRows(attention, agent, step) {
    return attention.map(([other, share]) => {
      const row = { name: other === agent ? "itself" : `agent ${other}`, share, value: share.toFixed(2), mark: "", kinds: [] };
      if (other !== agent) Object.assign(row, { link: address(step, other), open: () => this.open(other) });
      return row;
    });
  }

  showFeatures(episode, agent, step) {
    const names = episode.inspection.features, first = (agent * episode.steps + step) * names.length;
    const [summary, table] = this.features.children;
    summary.textContent = `Features (${names.length})`;
    fillTable(table, names.map((name, k) => [name, [(episode.features[first + k] / 32767).toFixed(3)]]), [""]);
    this.element.append(this.features);
  }
}

function subtitle(text) { return Object.assign(document.createElement("h3"), { textContent: text }); }

// A table of rows with a name above a bar, a number, and a mark. `share`, 0 to 1, is the bar's length.
function barTable(rows) {
  const table = Object.assign(document.createElement("table"), { className: "bars" });
  table.append(...rows.map((each) => {
    const row = line(each.name, [each.value ?? "", each.mark]), label = row.firstChild;
    row.className = each.kinds.join(" ");
    if (each.link) {
      const link = Object.assign(document.createElement("a"), { href: each.link, textContent: each.name });
      link.onclick = (event) => { event.preventDefault(); each.open(); };
      label.replaceChildren(link);
    }
    if (each.share !== undefined) {
      const bar = document.createElement("i");
      bar.style.width = `${100 * each.share}%`;
      label.append(bar);
    }
    return row;
  }));
  return table;
}
