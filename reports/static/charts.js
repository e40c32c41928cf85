// Charts of a page: layers of marks, lines, areas, bars and rules over the axes of uPlot. A reader can hover,
// drag across a part (to select it, or to zoom), and use the keyboard. Colours are names in palette.css.
"use strict";
const charts = (function () {
  const drawn = new Set();
  const language = document.documentElement.lang;
  const say = (number, digits = 4) => number.toLocaleString(language, { maximumSignificantDigits: digits, useGrouping: false });
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const FONT = (px) => `${12 * px}px system-ui, sans-serif`;
  const SHAPES = {
    square: [[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
    diamond: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]],
    triangle: [[0, -1.2], [1.15, 0.9], [-1.15, 0.9]],
    down: [[0, 1.2], [1.15, -0.9], [-1.15, -0.9]],
    arrow: [[0, -2], [1.6, 0], [0.5, 0], [0.5, 2], [-0.5, 2], [-0.5, 0], [-1.6, 0]],
  };

  function path(pen, points, smooth) {
    pen.moveTo(...points[0]);
    if (!smooth) points.slice(1).forEach((point) => pen.lineTo(...point));
    else {
      for (let k = 1; k < points.length - 1; k++) { // through the middles, so that no corner shows
        const end = points[k].map((at, axis) => (at + points[k + 1][axis]) / 2);
        pen.quadraticCurveTo(...points[k], ...(k < points.length - 2 ? end : points[k + 1]));
      }
      if (points.length === 2) pen.lineTo(...points[1]);
    }
  }

  const PAINT = {
    area(pen, layer, X, Y) {
      pen.globalAlpha = 0.22;
      path(pen, layer.x.map((x, k) => [X(x), Y(layer.y[k])]));
      pen.fill();
    },
    line(pen, layer, X, Y, box, px) {
      if (layer.dashed) pen.setLineDash([6 * px, 4 * px]);
      path(pen, layer.x.map((x, k) => [X(x), Y(layer.y[k])]), layer.smooth);
      pen.stroke();
    },
    rules(pen, layer, X, Y, box, px) { // dashed, across the other axis
      pen.setLineDash([4 * px, 4 * px]);
      layer.at.forEach((at) => {
        const ends = layer.along === "x" ? [[X(at), box.top], [X(at), box.top + box.height]] : [[box.left, Y(at)], [box.left + box.width, Y(at)]];
        path(pen, ends);
      });
      pen.stroke();
    },
    bars(pen, layer, X, Y, box, px) {
      layer.from.forEach((from, k) => pen.rect(X(from) + px / 2, Y(layer.y[k]), X(layer.to[k]) - X(from) - px, Y(0) - Y(layer.y[k])));
      pen.globalAlpha = layer.faint ? 0.22 : 1;
      pen.fill();
    },
    // faint ones are hollow, so that their colour keeps its contrast; beyond the axis, an arrow at its edge
    marks(pen, layer, X, Y, box, px) {
      const many = layer.x.length > 60, size = (many ? 2.4 : 3.6) * px;
      layer.x.forEach((x, k) => {
        pen.globalAlpha = (many ? 0.4 : 1) * (layer.faint ? 0.4 : 1);
        const at = X(x), way = Math.sign(Y(layer.y[k]) - Math.min(Math.max(Y(layer.y[k]), box.top), box.top + box.height));
        const up = way ? box.top + (way > 0 ? box.height : 0) - way * 2 * size : Y(layer.y[k]);
        if (layer.y_sd && layer.y_sd[k]) path(pen, [[at, Y(layer.y[k] - layer.y_sd[k])], [at, Y(layer.y[k] + layer.y_sd[k])]]);
        if (layer.y_ends) path(pen, layer.y_ends[k].map((end) => [at, Y(end)]));
        pen.stroke();
        pen.globalAlpha = 1;
        pen.beginPath();
        if (way) path(pen, SHAPES.arrow.map(([right, below]) => [at + size * right, up - way * size * below]));
        else if (layer.shape in SHAPES) path(pen, SHAPES[layer.shape].map(([right, below]) => [at + size * right, up + size * below]));
        else pen.arc(at, up, size, 0, 2 * Math.PI);
        pen.closePath();
        if (layer.faint) pen.stroke();
        else pen.fill();
        pen.beginPath();
      });
    },
  };

  function paint(plot, spec) {
    const pen = plot.ctx, px = devicePixelRatio;
    const X = (x) => plot.valToPos(x, "x", true), Y = (y) => plot.valToPos(y, "y", true);
    pen.save();
    pen.beginPath();
    pen.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
    pen.clip();
    for (const layer of spec.layers) {
      if (!(layer.x || layer.at || layer.from).length) continue;
      pen.save();
      pen.fillStyle = pen.strokeStyle = colour(layer.colour);
      pen.lineWidth = (layer.kind === "line" ? 2 : 1.2) * px;
      pen.beginPath();
      PAINT[layer.kind](pen, layer, X, Y, plot.bbox, px);
      pen.restore();
    }
    pen.restore();
    nameRules(pen, spec, Y, plot, px);
  }

  // names of rules across x, right of the marks, beside their lines; a name that has no room goes up
  const namedRules = (spec) => spec.layers.filter((layer) => layer.kind === "rules" && layer.names?.length)
    .flatMap((layer) => layer.names.map((name, k) => ({ name, at: layer.at[k], colour: layer.colour })));
  const measuring = document.createElement("canvas").getContext("2d");
  function margin(spec, width) {
    measuring.font = FONT(1);
    return Math.min(width / 3, Math.max(0, ...namedRules(spec).map(({ name }) => measuring.measureText(name).width + 8)));
  }
  function nameRules(pen, spec, Y, plot, px) {
    const { left, top, width, height } = plot.bbox, room = margin(spec, plot.width) - 4;
    let lowest = top + height;
    pen.save();
    pen.font = FONT(px);
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    for (const { name, at, colour: its } of namedRules(spec).sort((a, b) => a.at - b.at)) {
      if (Y(at) < top || Y(at) > top + height) continue;
      const up = Math.min(Y(at), lowest);
      lowest = up - 13 * px;
      pen.fillStyle = colour(its);
      pen.fillText(name, left + width + 4 * px, up, room * px);
    }
    pen.restore();
  }

  // a place on an axis in words: a number, or of days since 1970 the date
  const said = (along, at) => (along.dates ? new Date(864e5 * at).toISOString().slice(0, 10) : say(at));

  // what can be pointed at, from left to right: place, words, and what a pick of it is
  function stops(spec) {
    const of = (layer) => (layer.kind === "bars" ? layer.from.map((x, k) => [(x + layer.to[k]) / 2, layer.y[k]])
      : layer.kind === "marks" ? layer.x.map((x, k) => [x, layer.y[k]]) : []);
    return spec.layers.filter((layer) => !layer.faint || !layer.tips).flatMap((layer) => of(layer).map(([x, y], k) => ({
      x, y, pick: layer.picks && layer.picks[k],
      words: layer.tips ? layer.tips[k] : `${layer.name ? layer.name + ": " : ""}${said(spec.x, x)}, ${say(y)}`,
    }))).sort((a, b) => a.x - b.x);
  }

  function axes(spec) {
    const common = { stroke: () => colour("soft"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif", labelFont: "13px system-ui, sans-serif" };
    const numbers = (along) => (plot, places) => places.map((at) => said(along, at));
    const steps = (along) => along.whole || along.dates ? { incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000] } : {};
    return [
      { ...common, ...steps(spec.x), label: spec.x.label, labelSize: 22, size: 26, values: numbers(spec.x), space: spec.x.dates ? 100 : 60 },
      { ...common, ...steps(spec.y), label: spec.y.label, labelSize: spec.y.label ? 22 : 0, size: 48, space: spec.low ? 24 : 34,
        values: numbers(spec.y) },
    ];
  }

  // A chart in `host`. `select(low, high)`: called with the part that a reader drags across, without with
  // nothing; else a drag zooms. `pick`: called with what a mark stands for.
  function chart(host, spec, { select, pick } = {}) {
    const caption = document.createElement("figcaption"), frame = document.createElement("div"), tip = document.createElement("output");
    const legend = spec.layers.filter((layer) => layer.name && layer.kind !== "bars");
    frame.className = "plot";
    frame.tabIndex = 0;
    frame.setAttribute("role", "img");
    tip.className = "tip";
    tip.hidden = true;
    caption.textContent = spec.caption || spec.title;
    host.replaceChildren(frame, tip, caption);
    if (legend.length) {
      const keys = document.createElement("p");
      keys.className = "keys";
      for (const layer of legend) {
        const key = document.createElement("span");
        key.className = `key ${layer.kind} ${layer.shape || (layer.dashed ? "dashed" : "")}`;
        key.style.setProperty("--key", `var(--${layer.colour})`);
        key.textContent = layer.name;
        keys.append(key, " ");
      }
      host.prepend(keys);
    }
    let points = [], at = -1, limits = [spec.x.limits, spec.y.limits];
    const upOf = (point) => Math.max(0, Math.min(plot.valToPos(point.y, "y"), plot.over.clientHeight));
    function show(k) {
      at = k;
      tip.hidden = k < 0;
      if (k < 0) return;
      tip.value = points[k].words;
      const right = Math.max(0, Math.min(plot.valToPos(points[k].x, "x"), plot.over.clientWidth));
      tip.style.left = `${plot.over.offsetLeft + right}px`;
      tip.style.top = `${frame.offsetTop + plot.over.offsetTop + upOf(points[k]) - 8}px`;
      tip.classList.toggle("leftwards", right > plot.over.clientWidth / 2);
    }
    function nearest(plot) {
      const { left, top } = plot.cursor;
      if (left < 0) return show(-1);
      let best = -1, least = 24;
      points.forEach((point, k) => {
        const far = Math.hypot(plot.valToPos(point.x, "x") - left, spec.bars ? 0 : upOf(point) - top);
        if (far < least) [best, least] = [k, far];
      });
      show(best);
    }
    const plot = new uPlot({
      width: frame.clientWidth || 320, height: spec.height || (spec.low ? 170 : 260),
      legend: { show: false }, padding: [10, () => 10 + margin(spec, frame.clientWidth || 320), 0, 0], axes: axes(spec), series: [{}, { points: { show: false }, stroke: "transparent" }],
      scales: { x: { time: false, range: (u, low, high) => (low === null ? limits[0] : [low, high]) }, y: { range: () => limits[1].slice().sort((a, b) => a - b) } },
      cursor: { drag: { x: true, y: false, setScale: !select }, points: { show: false }, y: !select, ...(spec.group ? { sync: { key: spec.group } } : {}) },
      hooks: {
        draw: [(u) => paint(u, spec)],
        setCursor: [nearest],
        setSelect: select ? [(u) => { if (u.select.width > 4) select(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")); }] : [],
      },
    }, [limits[0].slice().sort((a, b) => a - b), [null, null]], frame);
    if (select) plot.over.addEventListener("dblclick", () => select());
    plot.over.addEventListener("click", () => { if (at >= 0 && pick && points[at].pick !== undefined && plot.select.width < 5) pick(points[at].pick); });
    frame.addEventListener("keydown", (event) => {
      const way = { ArrowRight: 1, ArrowLeft: -1 }[event.key], { min, max } = plot.scales.x;
      if (way && points.length) show((Math.max(at, way > 0 ? -1 : 0) + way + points.length) % points.length);
      else if (event.key === "Enter" && at >= 0 && pick && points[at].pick !== undefined) pick(points[at].pick);
      else if (event.key === "Escape") show(-1);
      else if (!select && "+-0".includes(event.key)) {
        const middle = at >= 0 ? points[at].x : (min + max) / 2, half = (max - min) / 2 * (event.key === "+" ? 0.6 : 1.6);
        plot.setScale("x", event.key === "0" ? { min: limits[0][0], max: limits[0][1] } : { min: middle - half, max: middle + half });
      } else return;
      event.preventDefault();
    });
    frame.addEventListener("blur", () => show(-1));
    const resized = new ResizeObserver(() => {
      if (frame.clientWidth) plot.setSize({ width: frame.clientWidth, height: plot.height });
    });
    resized.observe(frame);
    const shown = {
      // draws `changed` in its place: layers, limits, description
      show(changed) {
        Object.assign(spec, changed);
        limits = [spec.x.limits, spec.y.limits];
        frame.setAttribute("aria-label", `${spec.title}. ${spec.description}`);
        points = stops(spec);
        show(-1);
        plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        plot.setData([limits[0].slice().sort((a, b) => a - b), [null, null]]);
      },
      redraw: () => plot.redraw(),
      remove() {
        resized.disconnect();
        drawn.delete(shown);
        plot.destroy();
      },
    };
    drawn.add(shown);
    shown.show({});
    return shown;
  }

  const placed = document.getElementById("charts"), specs = placed ? JSON.parse(placed.textContent) : [];
  document.querySelectorAll("figure.drawn").forEach((host, k) => chart(host, specs[k]));
  matchMedia("screen and (prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((each) => each.redraw()));
  return { chart, say };
})();
