// The throughput of lifelong episodes as a curve: goals reached per step, over the steps before.

const CURVE_WIDTH = 270, CURVE_HEIGHT = 70; // px
const CURVE_WINDOW = 25; // steps that are averaged
const CURVE_DASHES = ["", "4 3"]; // tells episodes apart

// Goals reached per step in the window that ends at each step.
function throughputs({ numReached, steps }) {
  return Array.from({ length: steps + 1 }, (_, step) => {
    const first = Math.max(0, step - CURVE_WINDOW);
    return step === 0 ? 0 : (numReached[step] - numReached[first]) / (step - first);
  });
}

function showThroughput(element, episodes, captions) {
  const curves = episodes.map((episode) => (episode.lifelong && episode.hasGoals() ? throughputs(episode) : null));
  element.hidden = !curves.some(Boolean);
  if (element.hidden) return;
  const steps = Math.max(1, ...episodes.map((episode) => episode.steps)), most = Math.max(...curves.flatMap((curve) => curve ?? []), 1e-9);
  const place = (value, step) => `${short((step / steps) * CURVE_WIDTH)},${short(CURVE_HEIGHT - (value / most) * CURVE_HEIGHT)}`;
  const lines = curves.map((curve, k) => (curve
    ? `<polyline points="${curve.map(place).join(" ")}" stroke-dasharray="${CURVE_DASHES[k % CURVE_DASHES.length]}"/>` : ""));
  const cursor = `<line class="now" y1="0" y2="${CURVE_HEIGHT}"/>`;
  element.querySelector("svg").outerHTML = `<svg viewBox="0 0 ${CURVE_WIDTH} ${CURVE_HEIGHT}" role="img">${lines.join("")}${cursor}</svg>`;
  const names = captions.length > 1 ? ` (${captions.map((caption, k) => `${caption}: ${k ? "dashed" : "solid"}`).join(", ")})` : "";
  element.querySelector("p").textContent = `mean of ${CURVE_WINDOW} steps, 0 to ${shortNumber(most)}${names}`;
}

function markThroughput(element, step, steps) {
  const cursor = element.querySelector(".now"), x = short((step / Math.max(1, steps)) * CURVE_WIDTH);
  cursor?.setAttribute("x1", x);
  cursor?.setAttribute("x2", x);
}
