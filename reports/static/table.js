// Sorts, filters and searches the table of all fruit, and prints one fruit alone; without scripts the page
// shows all of it.
"use strict";
(function () {
  const table = document.querySelector("table.fruit");
  const tools = document.querySelector("form.tools");
  if (!table || !tools) return;
  const body = table.tBodies[0];
  const rows = Array.from(body.rows);
  const texts = rows.map((row) => row.textContent.toLowerCase().normalize("NFC"));
  const status = tools.querySelector("output");
  tools.hidden = false;
  tools.addEventListener("submit", (event) => event.preventDefault());

  function filter() {
    const wanted = tools.elements.search.value.toLowerCase().normalize("NFC").split(",")
      .map((part) => part.split(/\s+/).filter(Boolean)).filter((words) => words.length);
    const list = tools.elements.list ? tools.elements.list.value : "";
    const kind = tools.elements.kind ? tools.elements.kind.value : "";
    let shown = 0;
    rows.forEach((row, k) => {
      const found = !wanted.length || wanted.some((words) => words.every((word) => texts[k].includes(word)));
      const fits = found &&
        (!list || row.dataset.list === list) && (!kind || row.dataset.kind === kind);
      row.hidden = !fits;
      shown += fits ? 1 : 0;
    });
    status.value = shown === rows.length ? tools.dataset.fruit.replace("#", shown)
      : tools.dataset.some.replace("##", rows.length).replace("#", shown);
  }
  tools.addEventListener("input", filter);
  tools.addEventListener("reset", () => setTimeout(filter, 0));

  function value(row, column) {
    const cell = row.cells[column];
    const number = cell.dataset.value;
    if (number !== undefined) return number === "" ? null : Number(number);
    return cell.textContent.trim() || null;
  }
  const collator = new Intl.Collator(document.documentElement.lang, { numeric: true });
  Array.from(table.tHead.rows[0].cells).forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      table.tHead.querySelectorAll("[aria-sort]").forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const sign = down ? -1 : 1;
      const keyed = rows.map((row, k) => [value(row, column), k, row]);
      keyed.sort((a, b) => {
        if (a[0] === null || b[0] === null) return (a[0] === null) - (b[0] === null) || a[1] - b[1];
        const order = typeof a[0] === "number" ? a[0] - b[0] : collator.compare(a[0], b[0]);
        return sign * order || a[1] - b[1];
      });
      body.append(...keyed.map((one) => one[2]));
    });
  });
  const hint = document.createElement("span");
  hint.className = "on-screen";
  hint.textContent = "; " + tools.dataset.sorts;
  table.caption.append(hint);
  filter();
})();
(function () {
  document.documentElement.classList.add("scripted");
  document.addEventListener("click", (event) => {
    const button = event.target.closest("button.alone");
    if (!button) return;
    const fruit = button.closest("article");
    fruit.classList.add("chosen");
    document.body.classList.add("one");
    window.print();
    document.body.classList.remove("one");
    fruit.classList.remove("chosen");
  });
})();
