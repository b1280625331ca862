// The planes that the selected agent observes, with the values under the pointer.

const PLANE_WIDTH = 118; // px, about

class Planes {
  constructor(caption, onPoint) { // `onPoint` gets the pointed cell of the map, or null
    Object.assign(this, { caption, onPoint, element: document.createElement("div") });
    this.grid = Object.assign(document.createElement("div"), { className: "planes" });
    this.readout = document.createElement("p");
    this.readout.setAttribute("aria-live", "polite");
    this.scale = Object.assign(document.createElement("div"), { className: "scale" });
    this.scale.append("−1", document.createElement("i"), "1");
  }

  clear(note = "") {
    this.element.replaceChildren(...(note ? [paragraph(note)] : []));
    this.shown = null;
  }

  show(episode, agent, step) {
    if (!episode.observers) { this.clear(); return; }
    if (agent >= episode.observers) { this.clear("This agent's observations were not recorded."); return; }
    if (!this.shown || this.shown.episode !== episode) {
      this.grid.replaceChildren(...episode.planes.map((name, plane) => this.figure(episode, name, plane)));
      this.element.replaceChildren(...(this.caption ? [paragraph(this.caption)] : []), this.grid, this.scale, this.readout);
    }
    this.shown = { episode, agent, step };
    [...this.grid.children].forEach((figure, plane) => this.paint(figure.firstChild, plane));
    this.tell();
  }

  figure(episode, name, plane) {
    const [rows, cols] = episode.viewSize, size = Math.max(2, Math.min(24, Math.floor(PLANE_WIDTH / Math.max(rows, cols))));
    const figure = document.createElement("figure"), canvas = document.createElement("canvas");
    Object.assign(canvas, { width: cols, height: rows });
    Object.assign(canvas.style, { width: `${cols * size + 2}px`, height: `${rows * size + 2}px` });
    canvas.onpointermove = canvas.onpointerdown = (event) => {
      const row = Math.floor(event.offsetY / size), col = Math.floor(event.offsetX / size);
      this.pointed = row >= 0 && row < rows && col >= 0 && col < cols ? { plane, row, col } : null;
      this.tell();
    };
    canvas.onpointerleave = () => { this.pointed = null; this.tell(); };
    figure.append(canvas, Object.assign(document.createElement("figcaption"), { textContent: name }));
    return figure;
  }

  value(plane, row, col) {
    const { episode, agent, step } = this.shown, [rows, cols] = episode.viewSize;
    const image = (step * episode.observers + agent) * episode.planes.length + plane;
    return episode.observed[(image * rows + row) * cols + col] / 127;
  }

  paint(canvas, plane) {
    const pen = canvas.getContext("2d"), image = pen.createImageData(canvas.width, canvas.height);
    for (let row = 0, i = 0; row < canvas.height; row++)
      for (let col = 0; col < canvas.width; col++, i += 4)
        image.data.set([...divergingColor(this.value(plane, row, col)), 255], i);
    pen.putImageData(image, 0, 0);
  }

  // States the pointed value.
  tell() {
    if (!this.pointed || !this.shown) { this.readout.textContent = ""; this.onPoint(null); return; }
    const { plane, row, col } = this.pointed, { episode, agent, step } = this.shown;
    const cell = episode.hasField() ? fieldCell(episode, agent, step, row, col) : null;
    const place = cell ? ` at row ${cell[0]}, column ${cell[1]}` : "";
    this.readout.textContent = `${episode.planes[plane]}${place}: ${this.value(plane, row, col).toFixed(2)}`;
    this.onPoint(cell);
  }
}

function paragraph(text) { return Object.assign(document.createElement("p"), { textContent: text }); }
