// Tables that sort by a click on the head of a column: up, down, then as they were.

const UNITS = { "ms": 1e-3, "\u00b5s": 1e-6 };

// The first number of a cell, in its base unit; NaN for words, which come last.
function sortKey(text) {
  const found = text.replaceAll("\u2212", "-").match(/^[[<\s]*(-?[\d.]+(?:e[-+]?\d+)?)\s*([a-z\u00b5%]*)/i);
  return found ? Number(found[1]) * (UNITS[found[2]] ?? 1) : NaN;
}

function compared(a, b) {
  const x = sortKey(a), y = sortKey(b);
  if (Number.isNaN(x) && Number.isNaN(y)) return (a === "") - (b === "") || a.localeCompare(b, "en", { numeric: true });
  return Number.isNaN(x) - Number.isNaN(y) || x - y;
}

function sortTable(table, head, column) {
  const body = table.tBodies[0], before = head.getAttribute("aria-sort");
  const rows = body.sortable ??= Array.from(body.rows); // as they were
  const now = { null: "ascending", ascending: "descending" }[before];
  for (const other of table.querySelectorAll("th[aria-sort]")) other.removeAttribute("aria-sort");
  if (!now) return body.append(...rows);
  head.setAttribute("aria-sort", now);
  const text = row => row.cells[column].dataset.key ?? row.cells[column].textContent.trim();
  const known = rows.filter(row => !/^(no result|not run|not testable|n\/a|)$/.test(text(row)));
  const sign = now === "ascending" ? 1 : -1;
  const sorted = known.map(row => [text(row), row]).sort((a, b) => sign * compared(a[0], b[0])).map(pair => pair[1]);
  body.append(...sorted, ...rows.filter(row => !known.includes(row)));
}

function startTables() {
  for (const table of document.querySelectorAll("table"))
    Array.from(table.tHead.rows[table.tHead.rows.length - 1].cells).forEach((head, column) => {
      const button = head.querySelector("button");
      if (button) button.onclick = () => sortTable(table, head, column);
    });
}
