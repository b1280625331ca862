// Text files, and what is wrong with them.

const MOST_POSITIONS = 50_000_000; // steps times agents of a plan
const MOST_CELLS = 16_000_000; // of a map

class FileError extends Error {
  constructor(name, message, line = 0) { super(`${name}${line ? `:${line}` : ""}: ${message}`); }
}

function require(holds, name, message, line = 0) {
  if (!holds) throw new FileError(name, message, line);
}

function linesOf(text) { return text.split("\n").map((line) => line.replace(/\r+$/, "")); }

function shortened(value) {
  const text = typeof value === "string" ? `'${value}'` : JSON.stringify(value) ?? "nothing";
  return text.length > 40 ? `${text.slice(0, 37)}...` : text;
}
