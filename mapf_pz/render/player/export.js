// Saves the shown step as image files.

function saveFile(name, content, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

function fileName(view, step, extension) {
  const title = view.episode.title.replaceAll(/[^\w+.-]+/g, "-").replaceAll(/^-+|-+$/g, "") || "episode";
  return `${title}-step-${step}.${extension}`;
}

function saveSvg(view, time) { saveFile(fileName(view, Math.floor(time), "svg"), view.svg(time), "image/svg+xml"); }

function savePng(view, time) {
  view.draw(time);
  view.canvas.toBlob((blob) => saveFile(fileName(view, Math.floor(time), "png"), blob));
}
