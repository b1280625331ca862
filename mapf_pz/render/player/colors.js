// Colors: those of the theme, of values from -1 to 1, and of heat maps.

const INKS = ["page", "free", "obstacle", "grid", "mark", "blocked", "delayed", "chosen", "hot", "arrow", "attention"];
const DIVERGING = [ // ColorBrewer's RdBu, as in the documentation's figures: -1 blue, 0 white, 1 red
  [5, 48, 97], [33, 102, 172], [67, 147, 195], [146, 197, 222], [209, 229, 240], [247, 247, 247],
  [253, 219, 199], [244, 165, 130], [214, 96, 77], [178, 24, 43], [103, 0, 31],
];

function preferredTheme() { return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"; }

// Sets the theme, and returns its colors by name, as page.css defines them.
function themeInk(theme) {
  document.documentElement.dataset.theme = theme;
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(INKS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function channels(code) { return [1, 3, 5].map((i) => parseInt(code.slice(i, i + 2), 16)); }

function blend(from, to, share) { return from.map((value, k) => Math.round(value + (to[k] - value) * share)); }

// The color [r, g, b] of a value from -1 to 1.
function divergingColor(value) {
  const place = ((Math.max(-1, Math.min(1, value)) + 1) / 2) * (DIVERGING.length - 1), low = Math.floor(place);
  return blend(DIVERGING[low], DIVERGING[Math.min(low + 1, DIVERGING.length - 1)], place - low);
}

// Black or white, whichever is easier to read on a background.
function readableOn(code) {
  const [red, green, blue] = channels(code).map((value) => (value / 255) ** 2.2);
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.3 ? "#111827" : "#ffffff";
}
