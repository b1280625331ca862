// Opens and saves files: those that the user chooses or drops, and those of the server.

const FILE_NAME = /^[\w+-][\w.+-]*$/;

class Files {
  // `server` is null on a page without one: files are then saved as downloads.
  constructor(editor, server, onPlan) {
    Object.assign(this, { editor, server, onPlan });
    $("open-files").onchange = async () => {
      await this.attempt(() => this.open($("open-files").files));
      $("open-files").value = ""; // so that a changed file can be chosen again
    };
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => {
      event.preventDefault();
      this.attempt(() => this.open(event.dataTransfer.files));
    });
    const saved = {
      "save-map": (drawing) => [this.map(drawing)],
      "save-scenario": (drawing) => [this.map(drawing), this.scenario(drawing)],
      "save-problem": problemFiles,
      "save-graph": (drawing) => [{ name: `${drawing.name}.json`, text: graphText(drawing) }],
      "save-svg": (drawing) => [{ name: `${drawing.name}.svg`, text: editor.board.svg(editor.shown()) }],
    };
    for (const [button, files] of Object.entries(saved)) $(button).onclick = () => this.attempt(() => this.save(files));
    $("copy-python").onclick = () => this.attempt(() => this.copy(pythonCode(editor.drawing), "Python"));
    $("copy-command").onclick = () => this.attempt(() => this.copy(solveCommand(editor.drawing, $("solver-a").value, solveLimits()), "command"));
  }

  map(drawing) { return { name: `${drawing.name}.map`, text: mapText(drawing) }; }
  scenario(drawing) { return { name: `${drawing.name}.scen`, text: scenarioText(drawing, `${drawing.name}.scen`) }; }

  // Runs an action, and shows what is wrong with its files.
  async attempt(action) {
    try {
      tell("");
      await action();
    } catch (error) {
      if (!(error instanceof FileError || error instanceof ServerError)) throw error;
      tell(error.message);
    }
  }

  async open(files) {
    const texts = {};
    for (const file of files) texts[file.name] = await file.text();
    this.openTexts(texts);
  }

  // Opens the texts of files by name: a problem, or any of a map, a scenario, a guidance graph and a plan.
  openTexts(texts) {
    const { editor } = this, names = Object.keys(texts), ending = (...suffixes) => names.find((name) => suffixes.some((each) => name.toLowerCase().endsWith(each)));
    const json = names.filter((name) => /\.json$/i.test(name)), problem = json.find((name) => isProblem(texts[name]));
    if (problem) { editor.open(parseProblem(problem, texts)); return; }
    const graph = json.find((name) => isGraph(texts[name])), plan = ending(".csv", ".txt") ?? json.find((name) => name !== graph);
    const map = ending(".map"), scenario = ending(".scen");
    let { drawing } = editor;
    if (map) drawing = drawingOf(parseMap(texts[map], map));
    if (graph) drawing = withGraph(drawing, parseGraph(texts[graph], graph), Boolean(map || scenario));
    if (scenario) {
      const { agents } = drawingOf(drawing, parseScenario(texts[scenario], scenario, drawing));
      drawing = drawing.with({ agents });
    }
    require(map || graph || scenario || plan, names[0] ?? "files", "expected a map, a scenario, a problem, a guidance graph or a plan");
    if (drawing !== editor.drawing) editor.open(drawing);
    if (plan) this.onPlan(texts[plan], plan);
  }

  async save(filesOf) {
    const { drawing } = this.editor, files = filesOf(drawing);
    require(FILE_NAME.test(drawing.name), drawing.name, "expected a name of letters, digits and . _ + - for files");
    for (const { name, text } of files) {
      if (!this.server) saveFile(name, text, "text/plain");
      else if (!(await this.server.save(`${$("folder").value}/${name}`, text))) return;
    }
    tell(this.server ? `saved: ${files.map(({ name }) => name).join(", ")}` : "");
  }

  async copy(text, what) {
    await navigator.clipboard.writeText(text);
    tell(`copied: ${what}`);
  }
}

// The drawing with the weights of a guidance graph for its map; if no map is kept, the graph's.
function withGraph(drawing, graph, isKept) {
  const isSame = graph.height === drawing.height && graph.width === drawing.width && graph.free.every((value, cell) => value === drawing.free[cell]);
  if (isSame) return drawing.with({ weights: graph.weights });
  require(!isKept, graph.name, `expected a guidance graph of map '${drawing.name}'`);
  return graph;
}
