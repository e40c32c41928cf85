// The report's table of all fruit: sorts, filters and exports it, draws the lot's charts and shows one fruit at a
// time. What is chosen is in the address. The table that browsers without scripts show is the source of its rows.
"use strict";
(function () {
  const place = document.getElementById("lot");
  if (!place) return;
  document.documentElement.classList.add("scripted");
  const lot = JSON.parse(place.textContent), words = lot.words;
  const details = document.getElementById("details").textContent.split("\n");
  const plain = new DOMParser().parseFromString(document.querySelector("noscript").textContent, "text/html").querySelector("table");
  const table = document.querySelector("table.fruit"), box = table.parentElement, body = table.tBodies[0];
  const tools = document.querySelector("form.tools"), status = tools.querySelector("output"), card = document.getElementById("card");
  const keyOf = (cell) => (cell.dataset.value === undefined ? cell.textContent.trim() || null : cell.dataset.value === "" ? null : Number(cell.dataset.value));
  const plainText = (text) => text.toLowerCase().normalize("NFC");
  const classes = [...lot.classes, lot.unclassed];
  const rows = Array.from(plain.tBodies[0].rows, (row, k) => ({
    ...lot.fruits[k], k, list: row.dataset.list, class: row.dataset.class, text: plainText(row.textContent),
    keys: Array.from(row.cells, keyOf), html: row.outerHTML.replace(/>\s*\n\s*/g, ">"),
  }));
  const counted = (row) => row.E !== null && row.rank !== null;
  const fruitCount = (count) => (count === 1 ? words.one : words.all.replace("#", count));
  const EXTRA = 1, AT_ONCE = 22; // rows above the part in view, and rows in the page at once
  const PRINTED = { ".warning": 4, ".next": 3, "tbody tr": 6 }; // what has a place on a sheet
  let state = {}, shown = rows, height = 34, opened = null, cardCharts = [], lotCharts = [];

  // The state: q, list, class, from, to, zoom, readings (the form), sort (a column, - before it: downwards), fruit
  function read() {
    const hash = location.hash.slice(1), old = /^fruit-(\d+)$/.exec(hash);
    if (old && rows[old[1] - 1]) return { ...state, fruit: rows[old[1] - 1].id };
    return hash.includes("=") || !hash ? Object.fromEntries(new URLSearchParams(hash)) : null;
  }
  function change(changes, { step = false } = {}) {
    const next = Object.fromEntries(Object.entries({ ...state, ...changes }).filter(([, set]) => set !== "" && set !== undefined));
    history[step ? "pushState" : "replaceState"](null, "", "#" + new URLSearchParams(next));
    follow(next);
  }
  function follow(next) {
    state = next;
    for (const field of tools.elements) {
      if (field.type === "checkbox") field.checked = state[field.name] === field.value;
      else if (field.name && field.value !== (state[field.name] || "")) field.value = state[field.name] || "";
    }
    apply();
  }

  function fits(row) {
    const wanted = plainText(state.q || "").split(",").map((part) => part.split(/\s+/).filter(Boolean)).filter((part) => part.length);
    return (!wanted.length || wanted.some((part) => part.every((word) => row.text.includes(word)))) &&
      (!state.list || row.list === state.list) && (!state.class || row.class === state.class) &&
      (!state.from || row.E >= Number(state.from)) && (!state.to || (row.E !== null && row.E <= Number(state.to)));
  }
  const collator = new Intl.Collator(lot.language, { numeric: true });
  function sorted(chosen) {
    const sign = (state.sort || "").startsWith("-") ? -1 : 1, column = Math.abs(parseInt(state.sort, 10)) - 1;
    if (!(column < rows[0].keys.length)) return chosen;
    return chosen.slice().sort((a, b) => {
      const [one, other] = [a.keys[column], b.keys[column]];
      if (one === null || other === null) return (one === null) - (other === null) || a.k - b.k;
      return sign * (typeof one === "number" ? one - other : collator.compare(one, other)) || a.k - b.k;
    });
  }

  function apply() {
    shown = sorted(rows.filter(fits));
    const E = shown.filter(counted).map((row) => row.E), mean = E.reduce((sum, each) => sum + each, 0) / E.length;
    const sd = Math.sqrt(E.reduce((sum, each) => sum + (each - mean) ** 2, 0) / (E.length - 1));
    const some = (count, total) => (count === total ? fruitCount(total) : words.some.replace("##", total).replace("#", count));
    status.value = some(shown.length, rows.length) + (E.length > 1 ? ": " + words.mean.replace("##", charts.say(sd, 3)).replace("#", charts.say(mean, 3)) : "");
    document.querySelectorAll(".count").forEach((count) => {
      const whole = rows.filter((row) => row.list === count.dataset.list).length, now = shown.filter((row) => row.list === count.dataset.list).length;
      count.textContent = now === whole ? whole : `${now} / ${whole}`;
    });
    const column = Math.abs(parseInt(state.sort, 10)) - 1;
    Array.from(table.tHead.rows[0].cells).forEach((head, k) => {
      if (k === column) head.setAttribute("aria-sort", state.sort.startsWith("-") ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    fill(true);
    drawLot();
    open(rows.find((row) => row.id === state.fruit) || shown[0] || null);
  }

  // Only rows in view are in the page; a row above and one below stand for the others
  let first = -1;
  function fill(anew, all = false) {
    const from = all ? 0 : Math.max(0, 3 * Math.floor((box.scrollTop / height - EXTRA) / 3)), to = all ? shown.length : from + AT_ONCE;
    if (!anew && from === first) return;
    first = from;
    const space = (count) => (count > 0 ? `<tr class="space" aria-hidden="true"><td colspan="${table.tHead.rows[0].cells.length}" style="height:${count * height}px"></td></tr>` : "");
    const focused = document.activeElement.closest && document.activeElement.closest("table.fruit tbody tr");
    body.innerHTML = space(from) + shown.slice(from, to).map((row) => row.html).join("") + space(shown.length - to);
    table.setAttribute("aria-rowcount", shown.length + 1);
    shown.slice(from, to).forEach((row, k) => body.querySelector(`#fruit-${row.k + 1}`).setAttribute("aria-rowindex", from + k + 2));
    const again = focused && focused.id && document.getElementById(focused.id);
    if (again) again.querySelector("a").focus({ preventScroll: true });
    mark();
  }
  function mark() {
    body.querySelectorAll("[aria-current]").forEach((row) => row.removeAttribute("aria-current"));
    const row = opened && document.getElementById(`fruit-${opened.k + 1}`);
    if (row) row.setAttribute("aria-current", "true");
  }

  // The lot's charts: all fruit pale, those in the table in full colour
  const layersOf = (all, chosen, across) => classes.flatMap((one) => {
    const own = all.filter((row) => (row.class || "") === one.name);
    const name = one.name || (lot.classes.length && own.length ? one.key : "");
    return [false, true].map((faint) => {
      const of = own.filter((row) => chosen.has(row) !== faint);
      return {
        kind: "marks", x: of.map(across), y: of.map((row) => row.E), y_sd: of.map((row) => row.sd),
        name: faint ? "" : name, colour: one.colour, shape: one.shape, faint, picks: of.map((row) => row.id),
        tips: of.map((row) => `${row.id}: ${charts.say(row.E)} ± ${charts.say(row.sd || 0)} MPa${row.class ? ", " + row.class : ""}`),
      };
    });
  });
  const limits = lot.classes.filter((one) => one.limit !== null);
  function span(values, air) {
    const low = Math.min(...values), high = Math.max(...values), more = air * (high - low) || 0.5 * Math.abs(high) || 0.5;
    return [low - more, high + more];
  }
  // Edges of bars: every limit of a class is one, so that a bar belongs to one class
  function edges(low, high) {
    const raw = (high - low) / 30, power = 10 ** Math.floor(Math.log10(raw)), width = [1, 2, 5, 10].map((k) => k * power).find((each) => each >= raw);
    const ends = [low, ...limits.map((one) => one.limit).filter((limit) => limit > low && limit < high), high], places = [low];
    ends.slice(1).forEach((end, k) => {
      const bars = Math.max(1, Math.round((end - ends[k]) / width));
      for (let j = 1; j <= bars; j++) places.push(ends[k] + (end - ends[k]) * j / bars);
    });
    return { width, places };
  }
  function histogram(chosen, [low, high]) {
    const all = rows.filter(counted), { width, places } = edges(Math.max(0, low), high), layers = [];
    let tallest = 0;
    const bars = places.slice(1).map((to, k) => {
      const inside = all.filter((row) => row.E > places[k] && row.E <= to), now = inside.filter((row) => chosen.has(row)).length;
      const one = lot.classes.find((each) => each.limit === null || (places[k] + to) / 2 <= each.limit) || lot.unclassed;
      const per = width / (to - places[k]);
      tallest = Math.max(tallest, inside.length * per);
      return { from: places[k], to, count: inside.length, now, per, one };
    });
    for (const faint of [true, false]) {
      for (const one of classes) {
        const of = bars.filter((bar) => bar.one === one);
        layers.push({ kind: "bars", faint, colour: one.colour, from: of.map((bar) => bar.from), to: of.map((bar) => bar.to),
          y: of.map((bar) => (faint ? bar.count : bar.now) * bar.per),
          tips: of.map((bar) => `${charts.say(bar.from)}–${charts.say(bar.to)} MPa: ${bar.now === bar.count ? fruitCount(bar.count) : words.all.replace("#", `${bar.now} / ${bar.count}`)}`) });
      }
    }
    layers.push({ kind: "rules", along: "x", at: limits.map((one) => one.limit), colour: "soft" });
    return {
      title: words.histogram, bars: true, layers, x: { label: words.E, limits: [low, high] },
      y: { label: words.per.replace("#", charts.say(width)), whole: true, limits: [0, 1.06 * tallest || 1] },
      description: bars.filter((bar) => bar.now).map((bar) => `${charts.say(bar.from)}–${charts.say(bar.to)} MPa: ${bar.now}`).join("; "),
    };
  }
  function byRank(chosen, [from, to], [low, high]) {
    const rule = { kind: "rules", along: "y", at: limits.map((one) => one.limit), colour: "soft" };
    const marks = layersOf(rows.filter(counted), chosen, (row) => row.rank);
    return {
      title: words.ranking, x: { label: words.rank, whole: true, limits: [from, to] }, y: { label: words.E, limits: [low, high] }, layers: [rule, ...marks],
      description: rows.filter((row) => chosen.has(row) && counted(row)).slice(0, 12).map((row) => `${row.id} ${charts.say(row.E)} MPa`).join("; "),
    };
  }
  function byShore(chosen) {
    const known = rows.filter((row) => counted(row) && row.shore !== null);
    const layers = layersOf(known, chosen, (row) => row.shore);
    return { title: words.shore, description: fruitCount(known.length), layers,
      x: { label: "Shore OO", limits: span(known.map((row) => row.shore), 0.06) }, y: { label: "E (MPa)", limits: span([0, ...known.map((row) => row.E + (row.sd || 0))], 0.06) } };
  }
  const SELECTS = { // from a drag over a chart to the E that is asked for
    histogram: (low, high) => [low, high],
    "by-rank": (low, high) => {
      const E = rows.filter((row) => counted(row) && row.rank >= low && row.rank <= high).map((row) => row.E);
      return E.length ? [Math.min(...E) - 1e-9, Math.max(...E) + 1e-9] : [low, low];
    },
  };
  function select(name, low, high) {
    if (low === undefined) return change({ from: "", to: "", zoom: "" });
    const [from, to] = SELECTS[name](low, high);
    return change({ from: (Math.floor(1e4 * Math.max(from, 0)) / 1e4).toString(), to: (Math.ceil(1e4 * to) / 1e4).toString() });
  }
  function drawLot() {
    const all = rows.filter(counted);
    if (!all.length) return;
    const chosen = new Set(shown), near = shown.filter(counted), seen = state.zoom && near.length ? near : all;
    const ends = seen.flatMap((row) => [row.E - (row.sd || 0), row.E + (row.sd || 0)]), highest = Math.max(...ends);
    const E = span([...ends, ...(seen === all ? limits.map((one) => one.limit).filter((limit) => limit < 1.4 * highest) : [])], 0.03);
    E[0] = Math.max(0, E[0]);
    const ranks = seen.map((row) => row.rank), half = 0.5 + 0.01 * ranks.length;
    const specs = { histogram: histogram(chosen, E), "by-rank": byRank(chosen, [Math.min(...ranks) - half, Math.max(...ranks) + half], E) };
    if (document.getElementById("by-shore")) specs["by-shore"] = byShore(chosen);
    for (const [name, spec] of Object.entries(specs)) {
      if (name in lotCharts) lotCharts[name].show(spec);
      else lotCharts[name] = charts.chart(document.getElementById(name), spec, { pick: (id) => visit(id), ...(name in SELECTS ? { select: (low, high) => select(name, low, high) } : {}) });
    }
  }

  // Marks what has no place on a sheet, and counts it
  function limit(part) {
    for (const [kind, most] of Object.entries(PRINTED)) {
      const beyond = [...part.querySelectorAll(kind)].slice(most);
      beyond.forEach((each) => each.classList.add("beyond"));
      const more = document.createElement("p");
      more.className = "more print-only";
      more.textContent = words[kind].replace("#", beyond.length);
      if (beyond.length) (beyond[0].closest(".table") || beyond[0]).after(more);
    }
  }

  // One fruit with its charts, made when it is opened
  function open(row) {
    if (row === opened) return;
    opened = row;
    cardCharts.forEach((each) => each.remove());
    card.innerHTML = "";
    cardCharts = [];
    mark();
    if (!row) return;
    const { html, charts: specs } = JSON.parse(details[row.k]);
    card.innerHTML = html.replace(/>\s*\n\s*</g, "><");
    limit(card);
    const holder = card.querySelector(".charts"), groups = {};
    for (const spec of specs) { // those of a recording below each other, then the others
      const group = groups[spec.group || ""] ||= holder.appendChild(document.createElement("div"));
      cardCharts.push(charts.chart(group.appendChild(document.createElement("figure")), spec));
    }
  }
  function visit(id) {
    change({ fruit: id }, { step: true });
    const heading = document.getElementById("fruit-name");
    heading.focus({ preventScroll: true });
    heading.scrollIntoView({ block: "start" });
  }

  function save() {
    const file = new Blob(["\ufeff", [lot.header, ...shown.map((row) => row.csv)].join("\n"), "\n"], { type: "text/csv" });
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `${lot.name.replace(/[^\p{L}\p{N}._-]+/gu, "-")}-ranking.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  plain.tHead.querySelectorAll("th").forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => change({ sort: state.sort === String(column + 1) ? `-${column + 1}` : String(column + 1) }));
  });
  plain.caption.textContent += "; " + words.sorts;
  table.prepend(document.adoptNode(plain.caption), document.adoptNode(plain.tHead));
  tools.addEventListener("submit", (event) => event.preventDefault());
  tools.addEventListener("input", () => change(Object.fromEntries(["q", "list", "class", "from", "to", "zoom", "readings"].map((name) => [name, new FormData(tools).get(name) || ""]))));
  tools.addEventListener("reset", (event) => {
    event.preventDefault();
    change({ q: "", list: "", class: "", from: "", to: "", zoom: "", readings: "" });
  });
  tools.querySelector(".save").addEventListener("click", save);
  box.addEventListener("scroll", () => fill(false), { passive: true });
  box.addEventListener("keydown", () => fill(false)); // the next row is there before Tab, whenever the scroll is told
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#fruit-']"), step = event.target.closest("button[data-step]"), alone = event.target.closest("button.alone");
    if (link && rows[link.hash.slice(7) - 1]) {
      event.preventDefault();
      visit(rows[link.hash.slice(7) - 1].id);
    } else if (step && shown.length) {
      const next = shown[(shown.indexOf(opened) + Number(step.dataset.step) + shown.length) % shown.length];
      change({ fruit: next.id });
    } else if (alone) {
      document.body.classList.add(alone.dataset.part);
      window.print();
      document.body.classList.remove(alone.dataset.part);
    }
  });
  addEventListener("hashchange", () => {
    const next = read();
    if (next) follow(next);
    else history.replaceState(null, "", "#" + new URLSearchParams(state)); // the skip link has done its jump
  });
  addEventListener("beforeprint", () => fill(true, true));
  addEventListener("afterprint", () => fill(true));
  document.querySelectorAll(".faults").forEach(limit);
  for (const part of document.querySelectorAll("main, section, dl, tbody, ul, details, .cards")) { // blank lines of the file
    for (const child of [...part.childNodes]) if (child.nodeType === Node.TEXT_NODE && !child.data.trim()) child.remove();
  }
  follow(read() || {});
  const row = body.querySelector("tr:not(.space)");
  if (row) height = row.getBoundingClientRect().height || height;
  fill(true);
})();
