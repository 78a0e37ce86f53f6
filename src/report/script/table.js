
// Tables: a click on a column sorts by it, a second one the other way round.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  // What is not a number comes last either way, unless it is a name.
  const compare = (a, b, sign) => {
    const [x, y] = [Number(a), Number(b)];
    if (Number.isNaN(x) && Number.isNaN(y)) return sign * a.localeCompare(b, "en", { numeric: true });
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
    return sign * (x - y);
  };
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const ascending = head.getAttribute("aria-sort") !== "ascending";
      const key = (row) => row.cells[column].dataset.value;
      const rows = [...table.tBodies].flatMap((body) => [...body.rows]);
      rows.sort((a, b) => compare(key(a), key(b), ascending ? 1 : -1));
      // Sorted rows of all budgets share one body: the lines between budgets would no longer mean anything.
      for (const body of [...table.tBodies].slice(1)) body.remove();
      table.tBodies[0].replaceChildren(...rows);
      for (const other of heads) other.setAttribute("aria-sort", "none");
      head.setAttribute("aria-sort", ascending ? "ascending" : "descending");
    });
  });
}
