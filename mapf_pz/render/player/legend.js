// What the colors of cells and the arrows mean.

function showLegend(element, view, options) {
  const { episode, ground } = view, lines = [], range = ground.range(options.ground);
  if (range && range.least <= range.largest) {
    const bar = document.createElement("i"), scale = Object.assign(document.createElement("div"), { className: "scale" });
    bar.style.background = `linear-gradient(to right, ${options.ink.free}, ${options.ink.hot})`;
    scale.append(shortNumber(range.least), bar, shortNumber(range.largest));
    lines.push(Object.assign(document.createElement("div"), { textContent: GROUNDS[options.ground].legend }), scale);
  }
  if (options.directions && episode.weights) {
    const meaning = `▶ cheaper direction; full size: ${FULL_RATIO} times cheaper`;
    const textContent = view.camera.scale >= ARROW_SCALE ? meaning : "zoom in for arrows in the cheaper directions";
    lines.push(Object.assign(document.createElement("div"), { textContent }));
  }
  element.replaceChildren(...lines);
}
