// Starts the editor; with a server if the page has a token for one.

(async () => {
  const data = JSON.parse($("data").textContent), server = data.token ? new Server(data.token) : null;
  const editor = new Editor(data.colors), playback = new Playback(editor);
  const playPlan = (text, name) => {
    const { drawing } = editor, { agents } = drawing;
    const given = { starts: agents.map(({ start }) => start), goals: agents.map(({ goals }) => goals[0]), name: drawing.name };
    const scenario = agents.length && agents.every(({ goals }) => goals.length === 1) ? given : null;
    playback.play([planEpisode(drawing, scenario, parsePlan(text, name, scenario), name, data.colors)]);
  };
  const files = new Files(editor, server, playPlan);
  new Panel(editor);
  new DrawingPointer(editor);
  bindShortcuts(editor);
  new ResizeObserver(() => { if (!$("drawing").hidden) editor.resize(); }).observe($("easel"));
  editor.resize();
  Object.assign(window, { editor });
  if (server) {
    new Runs(editor, server, files, playback);
    await files.attempt(() => new Catalog(editor, server, files).load());
  }
  const texts = Object.values(data.start ?? {}).filter(Boolean).map(({ name, text }) => [name, text]);
  if (texts.length) await files.attempt(() => files.openTexts(Object.fromEntries(texts)));
  document.body.dataset.ready = "yes";
})();
