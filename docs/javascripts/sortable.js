// Tables of the leaderboard are sorted by a click on a column header: numbers first descending, text ascending.

"use strict";

function cellValue(row, column) {
  const text = row.cells[column].textContent.trim();
  const number = parseFloat(text);
  return { text, number, isEmpty: text === "" };
}

function compare(a, b, direction) {
  if (a.isEmpty || b.isEmpty) return a.isEmpty - b.isEmpty; // empty cells come last
  const isNumber = !Number.isNaN(a.number) && !Number.isNaN(b.number);
  return direction * (isNumber ? a.number - b.number : a.text.localeCompare(b.text));
}

function sortBy(table, column, head) {
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const isNumeric = rows.some((row) => !Number.isNaN(cellValue(row, column).number));
  const before = head.getAttribute("aria-sort");
  const up = isNumeric ? before === "descending" : before !== "ascending";
  rows.sort((a, b) => compare(cellValue(a, column), cellValue(b, column), up ? 1 : -1));
  for (const cell of table.tHead.rows[0].cells) cell.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  body.append(...rows);
}

function makeSortable(table) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    head.tabIndex = 0;
    head.setAttribute("role", "button");
    head.addEventListener("click", () => sortBy(table, column, head));
    head.addEventListener("keydown", (event) => {
      if (event.key === "Enter") sortBy(table, column, head);
    });
  });
}

if (document.getElementById("leaderboard")) {
  document.querySelectorAll("article table").forEach(makeSortable);
}
