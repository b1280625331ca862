// Shows files that are dropped on the page: a map, a scenario and a plan.

const VIEWER_SPEED = 4; // steps per second

class Viewer {
  constructor(colors) {
    Object.assign(this, { colors, texts: {} }); // the name and text of each kind of file
    themeInk(preferredTheme());
    document.body.classList.add("empty");
    $("choose").onchange = async () => {
      await this.add($("choose").files);
      $("choose").value = ""; // so that a changed file can be chosen again
    };
    addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
    addEventListener("dragleave", () => document.body.classList.remove("dropping"));
    addEventListener("drop", async (event) => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      await this.add(event.dataTransfer.files);
    });
  }

  async add(files) {
    if (!files.length) return;
    delete document.body.dataset.ready;
    const added = [...files].map((file) => [kindOfFile(file.name), file]);
    if (added.some(([kind]) => kind === "map")) this.texts = {}; // files of another map do not fit
    for (const [kind, file] of added) this.texts[kind] = { name: file.name, text: await file.text() };
    fillTable($("loaded"), Object.entries(this.texts).map(([kind, { name }]) => [kind, [name]]), [""]);
    this.show();
  }

  // Shows the files, or states what is wrong or missing.
  show() {
    $("complaint").textContent = "";
    try {
      const episode = this.episode();
      document.body.classList.remove("empty");
      window.player?.end();
      window.player = new Player([episode], VIEWER_SPEED);
      $("title").textContent = document.title = episode.title;
      document.body.dataset.ready = "yes";
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      document.body.classList.add("empty");
      $("complaint").textContent = error.message;
    }
  }

  episode() {
    const { texts } = this;
    require(texts.map, Object.values(texts)[0].name, "expected a map (.map), too");
    const map = parseMap(texts.map.text, texts.map.name);
    require(texts.plan || texts.scenario, texts.map.name, "expected a plan or a scenario, too");
    const scenario = texts.scenario ? parseScenario(texts.scenario.text, texts.scenario.name, map) : null;
    if (!texts.plan) return planEpisode(map, scenario, standing(scenario, texts.scenario.name), texts, this.colors);
    const plan = parsePlan(texts.plan.text, texts.plan.name, scenario), starts = scenario?.starts.length ?? plan.agents;
    require(plan.agents <= starts, texts.scenario?.name, `expected ${plan.agents} agents, as in the plan, got ${starts}`);
    return planEpisode(map, scenario, plan, texts, this.colors);
  }
}

function kindOfFile(name) {
  return { map: "map", scen: "scenario" }[name.split(".").pop().toLowerCase()] ?? "plan";
}

window.viewer = new Viewer(JSON.parse($("data").textContent).colors);
