// What the server offers by name: maps, families of generated maps, guidance graphs, planners and policies.

const OPENED = /\.(map|scen|json)$/i;

class Catalog {
  constructor(editor, server, files) { Object.assign(this, { editor, server, files }); }

  async load() {
    const names = await this.server.call("names");
    Object.assign(this, { names });
    for (const element of document.querySelectorAll("[data-server]")) element.hidden = false;
    fillOptions($("map-names"), [...names.maps, ...names.problems, ...(await this.paths())]);
    fillOptions($("solver-names"), [...names.planners, ...names.policies].map(({ name }) => name));
    fillOptions($("graph"), names.graphs);
    fillOptions($("folder"), names.folders);
    fillOptions($("family"), names.families.map(({ name }) => name));
    this.bind();
    this.showOptions();
  }

  bind() {
    const { files } = this;
    $("family").onchange = () => this.showOptions();
    $("generate").onclick = () => files.attempt(() => this.generate());
    $("cancel").onclick = () => files.attempt(() => this.server.call("cancel"));
    $("use-graph").onclick = () => files.attempt(() => this.useGraph($("graph").value));
    $("open").onclick = () => files.attempt(() => this.open($("open-name").value, $("open-scenario").value));
    $("open-name").oninput = () => fillOptions($("scenario-names"), this.names.scenarios[$("open-name").value] ?? []);
  }

  // The options of the chosen family, and a seed.
  showOptions() {
    const family = this.names.families.find(({ name }) => name === $("family").value);
    const fields = [...(family?.options ?? []), { name: "seed", type: "int", default: 0, help: "Random seed." }];
    $("family-options").replaceChildren(...fields.flatMap(({ name, default: value, help }) => {
      const label = Object.assign(document.createElement("label"), { textContent: name, title: help, htmlFor: `option-${name}` });
      return [label, Object.assign(document.createElement("input"), { id: `option-${name}`, value })];
    }));
  }

  async generate() {
    const family = this.names.families.find(({ name }) => name === $("family").value);
    const options = Object.fromEntries(family.options.map(({ name, type }) => [name, parsedOption($(`option-${name}`).value, type)]));
    const seed = parsedOption($("option-seed").value, "int");
    $("cancel").disabled = false;
    const { name, map } = await this.server.call("generate", { family: family.name, options, seed })
      .finally(() => { $("cancel").disabled = true; });
    this.editor.open(drawingOf(parseMap(map, `${name}.map`)));
  }

  async useGraph(name) {
    const { drawing } = this.editor, { weights } = await this.server.call("graph", { map: mapText(drawing), name });
    const given = floatsOf(weights), indices = graphEdges(drawing, [...GGO_PLANES, WAIT_PLANE]);
    const edges = indices.map((index) => [0, index, given[index]]);
    this.editor.edit(drawing.with({ weights: null }).withWeights(edges));
  }

  // Opens a map, its scenario, or a problem, by names or paths.
  async open(name, scenario) {
    const texts = {};
    const add = async (request) => Object.assign(texts, textsOf(await this.server.call("open", request)));
    if (this.names.problems.includes(name)) await add({ problem: name });
    else if (name) await add(isPath(name) ? { path: name } : { map: name });
    if (Object.values(texts).some(isProblem)) await add({ problem: name });
    if (scenario) await add(isPath(scenario) ? { path: scenario } : { scenario, map: name });
    this.files.openTexts(texts);
  }

  // The paths of the files in the folders that the page can open.
  async paths() {
    const paths = [];
    for (const folder of this.names.folders) {
      const { entries } = await this.server.call("list", { path: folder });
      paths.push(...entries.filter(({ name }) => OPENED.test(name)).map(({ name }) => `${folder}/${name}`));
    }
    return paths;
  }
}

function isPath(name) { return /[/\\]|\.(map|scen|json)$/.test(name); }

// The texts of an answer's files, by name.
function textsOf(answer) {
  const kinds = ["map", "agents", "tasks"].filter((kind) => answer[kind] !== undefined);
  const others = kinds.map((kind) => [answer[`${kind}Name`].split("/").pop(), answer[kind]]);
  return Object.fromEntries([[answer.name, answer.text], ...others]);
}

function fillOptions(element, names) { element.replaceChildren(...names.map((name) => new Option(name, name))); }

function parsedOption(text, type) {
  if (type === "bool") return text === "true" || text === "True";
  return type === "int" || type === "float" ? Number(text) : text;
}

// Bytes of little-endian 32-bit numbers, as base64 text.
function floatsOf(text) { return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer); }

function textOfFloats(values) {
  let letters = "";
  for (const byte of new Uint8Array(values.buffer, values.byteOffset, values.byteLength)) letters += String.fromCharCode(byte);
  return btoa(letters);
}
