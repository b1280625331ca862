// Runs planners and policies on the drawing, and plays what they did.

const POLL_DELAY = 300; // ms
const PLAYBACK_SPEED = 4; // steps per second

class Runs {
  constructor(editor, server, files, playback) {
    Object.assign(this, { editor, server, files, playback, run: null });
    $("solve").onclick = () => this.files.attempt(() => this.solve());
    $("stop").onclick = () => this.files.attempt(() => this.server.call("stop", { run: this.run }));
    $("play-again").onclick = () => this.playback.show();
  }

  async solve() {
    const { editor } = this, solvers = [$("solver-a").value, $("solver-b").value].filter(Boolean);
    const request = { instance: instanceOf(editor.drawing), solvers, lifelong: editor.lifelong, ...solveLimits() };
    await this.follow("solve", request);
  }

  // Starts a run, shows its progress until all solvers have ended, and plays their episodes.
  async follow(name, request) {
    this.setRunning(true);
    try {
      this.run = (await this.server.call(name, request)).run;
      const ended = await this.wait();
      const shown = [...ended.keys()].filter((k) => ended[k].state === "done");
      tell(ended.filter(({ state }) => state !== "done").map(progressText).join("; "));
      const answers = [];
      for (const solver of shown) answers.push({ solver, ...(await this.server.call("episode", { run: this.run, solver })) });
      if (answers.length) await this.play(answers);
    } finally {
      this.setRunning(false);
    }
  }

  async wait() {
    for (;;) {
      const { solvers } = await this.server.call("progress", { run: this.run });
      $("progress").replaceChildren(...solvers.map(progressItem));
      if (solvers.every(({ state }) => state !== "running")) return solvers;
      await new Promise((resolve) => setTimeout(resolve, POLL_DELAY));
    }
  }

  async play(answers) {
    const episodes = [];
    for (const { episode } of answers) episodes.push(new Episode(episode, await unpackAll(episode.arrays, episode.steps + 1)));
    this.solvers = answers.map(({ solver }) => solver);
    $("play-again").hidden = false;
    this.playback.play(episodes, this);
  }

  setRunning(isRunning) {
    $("solve").disabled = isRunning;
    $("stop").disabled = !isRunning;
    document.body.classList.toggle("running", isRunning);
  }

  // Goes on from a step of an episode, in which some agents take given actions.
  async goOn(episode, from, actions, steps) {
    await this.follow("step", { run: this.run, solver: this.solvers[episode], from, actions, steps });
  }
}

function progressItem(solver) {
  return Object.assign(document.createElement("li"), { textContent: progressText(solver) });
}

// The progress of a solver in one line.
function progressText({ name, state, step, steps, seconds, message, unfinished }) {
  const parts = [`${name}: ${state}`];
  if (state === "running" && step !== null) parts.push(`step ${step} of ${steps}`);
  parts.push(`${seconds.toFixed(1)} s`);
  if (message) parts.push(message);
  if (unfinished?.length) parts.push(`not at their goals: ${unfinished.slice(0, 20).join(", ")}${unfinished.length > 20 ? ", ..." : ""}`);
  return parts.join(" · ");
}

// The limits, the seed and the delays of solvers, as the server reads them.
function solveLimits() {
  const delays = $("delays").value.trim() || null; // empty: none
  return { time_limit: number("time-limit"), max_steps: number("max-steps"), seed: number("solve-seed"), delays };
}

// The drawing as the server reads it.
function instanceOf(drawing) {
  const { agents } = drawing;
  return {
    name: drawing.name, map: mapText(drawing), starts: agents.map(({ start }) => start), goals: agents.map(({ goals }) => goals),
    headings: drawing.turning ? agents.map(({ heading }) => heading) : null,
    weights: drawing.weights && textOfFloats(drawing.weights),
  };
}
