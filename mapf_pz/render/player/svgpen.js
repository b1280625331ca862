// Draws an SVG text by the same calls as a canvas, as far as the page makes them.

class SvgPen {
  constructor(width, height) {
    Object.assign(this, { width, height, parts: [], path: "", dash: [], lineWidth: 1, lineJoin: "miter" });
    Object.assign(this, { fillStyle: "#000", strokeStyle: "#000", globalAlpha: 1, font: "" });
  }

  // Is called once: what follows is moved.
  translate(x, y) { this.parts.push(`<g transform="translate(${short(x)} ${short(y)})">`); }
  beginPath() { this.path = ""; }
  moveTo(x, y) { this.path += `M${short(x)} ${short(y)}`; }
  lineTo(x, y) { this.path += `L${short(x)} ${short(y)}`; }
  closePath() { this.path += "Z"; }
  setLineDash(dash) { this.dash = dash; }

  arc(x, y, radius) { // a full circle
    const r = short(radius), d = short(2 * radius);
    this.path += `M${short(x - radius)} ${short(y)}a${r} ${r} 0 1 0 ${d} 0a${r} ${r} 0 1 0 -${d} 0Z`;
  }

  fill() { this.parts.push(`<path d="${this.path}" fill="${this.fillStyle}"${this.opacity()}/>`); }
  stroke() { this.parts.push(`<path d="${this.path}" fill="none"${this.line()}/>`); }
  strokeRect(x, y, width, height) { this.parts.push(`<rect${box(x, y, width, height)} fill="none"${this.line()}/>`); }

  fillRect(x, y, width, height) {
    this.parts.push(`<rect${box(x, y, width, height)} fill="${this.fillStyle}"${this.opacity()}/>`);
  }

  fillText(text, x, y) {
    const [weight, size, ...family] = this.font.split(" ");
    this.parts.push(
      `<text x="${short(x)}" y="${short(y)}" font-family="${family.join(" ")}" font-size="${size}" font-weight="${weight}"`
        + ` text-anchor="middle" dominant-baseline="central" fill="${this.fillStyle}">${escapeText(text)}</text>`,
    );
  }

  // A picture becomes a path for each color: a rectangle for each run of equal pixels in a row.
  drawImage(picture, x, y, width, height) {
    const { data } = picture.getContext("2d").getImageData(0, 0, picture.width, picture.height), paths = new Map();
    const colorAt = (i) => (data[4 * i + 3] ? data.slice(4 * i, 4 * i + 3).join() : "");
    for (let row = 0; row < picture.height; row++)
      for (let first = 0, col = 1; col <= picture.width; col++) {
        const color = colorAt(row * picture.width + first);
        if (col < picture.width && colorAt(row * picture.width + col) === color) continue;
        if (color) paths.set(color, `${paths.get(color) ?? ""}M${first} ${row}h${col - first}v1h${first - col}z`);
        first = col;
      }
    const scale = `scale(${width / picture.width} ${height / picture.height})`;
    this.parts.push(`<g transform="translate(${short(x)} ${short(y)}) ${scale}" shape-rendering="crispEdges">`);
    for (const [color, path] of paths) this.parts.push(`<path d="${path}" fill="rgb(${color})"/>`);
    this.parts.push("</g>");
  }

  opacity() { return this.globalAlpha < 1 ? ` opacity="${this.globalAlpha}"` : ""; }

  line() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.map(short).join(" ")}"` : "";
    const join = this.lineJoin === "round" ? ' stroke-linejoin="round"' : "";
    return ` stroke="${this.strokeStyle}" stroke-width="${short(this.lineWidth)}"${dash}${join}${this.opacity()}`;
  }

  text() {
    const { width, height } = this, size = `viewBox="0 0 ${width} ${height}" width="${width}" height="${height}"`;
    return `<svg xmlns="http://www.w3.org/2000/svg" ${size}>\n${this.parts.join("\n")}\n</g>\n</svg>\n`;
  }
}

function short(value) { return String(Math.round(value * 100) / 100); }

function box(x, y, width, height) {
  return ` x="${short(x)}" y="${short(y)}" width="${short(width)}" height="${short(height)}"`;
}

function escapeText(text) { return text.replaceAll("&", "&amp;").replaceAll("<", "&lt;"); }
