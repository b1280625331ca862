// Plays episodes and plans in place of the drawing. The selected agent can be moved by hand, while the policy moves the
// others.

const BY_HAND_KEYS = { rotate: ["i", "j", "l", "k"], cardinal: ["o", "i", "k", "j", "l"] }; // in the order of ACTIONS

class Playback {
  constructor(editor) {
    this.editor = editor;
    $("back-to-drawing").onclick = () => this.hide();
    $("go-on").onclick = () => this.goOn({}, Infinity);
    addEventListener("keydown", (event) => this.press(event));
  }

  // `runs`: what goes on with an episode; null for the plan of a file.
  play(episodes, runs = null) {
    const before = window.player?.state(), isContinued = runs && this.next !== undefined, byHand = $("by-hand-episode").value;
    this.runs = runs;
    this.show();
    window.player?.end();
    window.player = new Player(episodes, PLAYBACK_SPEED);
    player.setTheme(this.editor.theme);
    $("title").textContent = episodes.map(({ title }) => title).join(" and ");
    if (isContinued) player.show(this.next, before.chosen);
    this.next = undefined;
    const acting = [...episodes.keys()].filter((k) => episodes[k].actions); // others are whole plans
    $("by-hand").hidden = runs === null || !acting.length;
    $("by-hand-episode").replaceChildren(...acting.map((k) => new Option(episodes[k].caption, k)));
    if (isContinued) $("by-hand-episode").value = byHand;
    $("by-hand-episode").hidden = acting.length < 2;
    this.addActions(episodes[0]);
    document.body.dataset.played = String(Number(document.body.dataset.played ?? 0) + 1);
  }

  addActions(episode) {
    const model = episode.headings ? "rotate" : "cardinal";
    this.keys = BY_HAND_KEYS[model];
    $("by-hand-actions").replaceChildren(...ACTIONS[model].map((label, action) => {
      const button = Object.assign(document.createElement("button"), { textContent: label, title: `${label} (${this.keys[action]})` });
      button.onclick = () => this.act(action);
      return button;
    }));
  }

  press(event) {
    if ($("playback").hidden || $("by-hand").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
    const action = event.target.matches("input, select") ? -1 : this.keys.indexOf(event.key);
    if (action < 0) return;
    event.preventDefault();
    this.act(action);
  }

  // The selected agent takes an action in the next step.
  act(action) { if (player.options.chosen >= 0) this.goOn({ [player.options.chosen]: action }, 1); }

  goOn(actions, steps) {
    if (document.body.classList.contains("running")) return;
    const episode = Number($("by-hand-episode").value), from = Math.floor(player.time);
    this.next = from + (steps === 1 ? 1 : 0);
    this.runs.files.attempt(() => this.runs.goOn(episode, from, actions, steps === Infinity ? number("max-steps") : steps));
  }

  show() { $("drawing").hidden = true; $("playback").hidden = false; }

  hide() {
    window.player?.play(false);
    $("playback").hidden = true;
    $("drawing").hidden = false;
    this.editor.resize();
  }
}
