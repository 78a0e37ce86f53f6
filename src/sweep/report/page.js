"use strict";

(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const get = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg";

  const make = (parent, tag, attributes, text) => {
    const element = parent instanceof SVGElement ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const [key, value] of Object.entries(attributes || {})) element.setAttribute(key, value);
    if (text !== undefined) element.textContent = text;
    parent.appendChild(element);
    return element;
  };
  const words = (value) => {
    if (value === null || value === undefined) return "";
    if (!Number.isFinite(value)) return String(value);
    if (value === 0 || Number.isInteger(value) && Math.abs(value) < 1e6) return String(value);
    const size = Math.abs(value);
    return size < 1e-3 || size >= 1e5 ? value.toExponential(2) : String(Number(value.toPrecision(3)));
  };
  const at = (trial, axis) => {
    const value = trial.at[axis];
    if (value === null) return "";
    const own = data.axes[axis];
    return own.words ? own.words[value] : words(value);
  };

  // A scale from values to places; logarithmic where it is asked for and can be.
  const scale = (values, log, from, to) => {
    const known = values.filter((value) => value !== null && Number.isFinite(value));
    let low = Math.min(...known.slice(0, 1)), high = low;
    for (const value of known) { low = Math.min(low, value); high = Math.max(high, value); }
    if (!known.length) { low = 0; high = 1; }
    const isLog = log && low > 0;
    const map = isLog ? Math.log10 : (value) => value;
    let [a, b] = [map(low), map(high)];
    if (a === b) { a -= 0.5; b += 0.5; }
    const margin = 0.03 * (b - a);
    a -= margin; b += margin;
    const place = (value) => from + (map(value) - a) / (b - a) * (to - from);
    const back = (at) => { const value = a + (at - from) / (to - from) * (b - a); return isLog ? 10 ** value : value; };
    let ticks = [];
    if (isLog) {
      for (let power = Math.floor(a); power <= Math.ceil(b); power++) {
        for (const factor of b - a > 2 ? [1] : b - a > 0.7 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9]) ticks.push(factor * 10 ** power);
      }
    } else {
      const raw = (b - a) / 5, size = 10 ** Math.floor(Math.log10(raw));
      const step = [1, 2, 5, 10].map((factor) => factor * size).find((candidate) => candidate >= raw);
      for (let value = Math.ceil(a / step) * step; value <= b; value += step) ticks.push(Number(value.toPrecision(12)));
    }
    ticks = ticks.filter((value) => map(value) >= a && map(value) <= b);
    return { place, back, ticks };
  };

  const frame = (svg, x, y, box, xName, yName) => {
    for (const tick of x.ticks) {
      make(svg, "line", { class: "grid", x1: x.place(tick), x2: x.place(tick), y1: box.top, y2: box.bottom });
      make(svg, "text", { class: "tick", x: x.place(tick), y: box.bottom + 18, "text-anchor": "middle" }, words(tick));
    }
    for (const tick of y.ticks) {
      make(svg, "line", { class: "grid", x1: box.left, x2: box.right, y1: y.place(tick), y2: y.place(tick) });
      make(svg, "text", { class: "tick", x: box.left - 8, y: y.place(tick) + 4, "text-anchor": "end" }, words(tick));
    }
    make(svg, "rect", { class: "frame", x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top });
    make(svg, "text", { class: "axis", x: (box.left + box.right) / 2, y: box.bottom + 40, "text-anchor": "middle" }, xName);
    make(svg, "text", { class: "axis", x: box.left, y: box.top - 10 }, yName);
  };

  // Which trials are kept by brushes and by the filter.
  const brushes = new Map();
  let kept = data.trials.map((_, index) => index);

  // Parallel coordinates.
  const columns = data.axes.map((axis, index) => ({
    name: axis.key, words: axis.words, value: (trial) => trial.at[index], log: axis.log,
  })).concat(data.objectives.map((name, index) => ({ name, words: null, value: (trial) => trial.figures[index], log: true })));
  const parallel = get("parallel");
  const TOP = 46, BOTTOM = 330;
  const left = (column) => 60 + column * 1000 / Math.max(1, columns.length - 1);
  const scales = columns.map((column) => {
    const values = data.trials.map(column.value);
    if (!column.words) return scale(values, column.log, BOTTOM, TOP);
    const count = Math.max(1, column.words.length - 1);
    return { place: (value) => BOTTOM - 10 - value / count * (BOTTOM - TOP - 20), back: (at) => (BOTTOM - 10 - at) / (BOTTOM - TOP - 20) * count, ticks: column.words.map((_, index) => index) };
  });
  const path = (trials) => {
    const parts = [];
    for (const index of trials) {
      let pen = "M";
      columns.forEach((column, k) => {
        const value = column.value(data.trials[index]);
        if (value === null) { pen = "M"; return; }
        parts.push(pen, left(k).toFixed(1), " ", scales[k].place(value).toFixed(1));
        pen = "L";
      });
    }
    return parts.join("");
  };
  const measured = data.trials.map((_, index) => index).filter((index) => data.trials[index].figures.some((figure) => figure !== null));
  // More lines than this say nothing more. In several paths, so that lines on top of each other are darker.
  const LINES = 2000, PATHS = 20;
  const step = Math.ceil(measured.length / LINES);
  const drawn = measured.filter((_, index) => index % step === 0);
  const many = drawn.length > 200 ? " many" : "";
  if (step > 1) make(parallel.parentElement.querySelector("figcaption"), "span", {}, " One trial in " + step + " is drawn.");
  const parts = (trials) => Array.from({ length: PATHS }, (_, part) => path(trials.filter((_, index) => index % PATHS === part)));
  parts(drawn).forEach((d) => make(parallel, "path", { class: "lines off" + many, d }));
  const on = parts([]).map((d) => make(parallel, "path", { class: "lines on" + many, d }));
  columns.forEach((column, k) => {
    const x = left(k);
    make(parallel, "line", { class: "axis-line", x1: x, x2: x, y1: TOP, y2: BOTTOM });
    const short = column.name.length > 18 ? column.name.slice(0, 17) + "\u2026" : column.name;
    const title = make(parallel, "text", { class: "axis", x, y: TOP - 14 - (k % 2) * 16, "text-anchor": "middle" }, short);
    make(title, "title", {}, column.name);
    const ticks = scales[k].ticks, every = Math.ceil(ticks.length / 8);
    ticks.forEach((tick, i) => {
      if (i % every) return;
      const text = column.words ? column.words[tick].split("/").pop() : words(tick);
      make(parallel, "text", { class: "tick", x: x + 5, y: scales[k].place(tick) + 4 }, text.length > 14 ? text.slice(0, 13) + "\u2026" : text);
    });
    const brush = make(parallel, "rect", { class: "brush", x: x - 9, width: 18, y: 0, height: 0 });
    const hit = make(parallel, "rect", { class: "axis-hit", x: x - 16, width: 32, y: TOP - 6, height: BOTTOM - TOP + 12, "data-axis": column.name });
    const where = (event) => {
      const box = parallel.getBoundingClientRect();
      return Math.min(BOTTOM, Math.max(TOP, (event.clientY - box.top) / box.height * 360));
    };
    let start = null;
    hit.addEventListener("pointerdown", (event) => { start = where(event); hit.setPointerCapture(event.pointerId); });
    hit.addEventListener("pointermove", (event) => {
      if (start === null) return;
      const end = where(event);
      brush.setAttribute("y", Math.min(start, end));
      brush.setAttribute("height", Math.abs(end - start));
    });
    hit.addEventListener("pointerup", (event) => {
      const end = where(event);
      if (Math.abs(end - start) < 3) {
        brushes.delete(k);
        brush.setAttribute("height", 0);
      } else {
        const ends = [scales[k].back(start), scales[k].back(end)].sort((a, b) => a - b);
        brushes.set(k, (value) => value !== null && value >= ends[0] && value <= ends[1]);
      }
      start = null;
      update();
    });
  });

  // The table.
  const heads = ["trial", "state"].concat(data.axes.map((axis) => axis.key), data.objectives, ["seconds"]);
  const cell = (trial, k) => {
    if (k === 0) return trial.id;
    if (k === 1) return trial.state;
    if (k < 2 + data.axes.length) return at(trial, k - 2);
    const figure = k - 2 - data.axes.length;
    return words(figure < data.objectives.length ? trial.figures[figure] : trial.seconds);
  };
  const raw = (trial, k) => {
    if (k < 2) return cell(trial, k);
    if (k < 2 + data.axes.length) return trial.at[k - 2];
    const figure = k - 2 - data.axes.length;
    return figure < data.objectives.length ? trial.figures[figure] : trial.seconds;
  };
  const table = get("trials"), filter = get("filter");
  let sorted = { column: 2 + data.axes.length, up: true }, rowsShown = 100;
  const row = make(table.tHead, "tr");
  heads.forEach((name, k) => {
    const head = make(row, "th", { scope: "col", class: k > 1 ? "number" : "" });
    make(head, "button", { type: "button" }, name).addEventListener("click", () => {
      sorted = { column: k, up: sorted.column === k ? !sorted.up : true };
      rowsShown = 100;
      draw();
    });
  });
  const tests = () => filter.value.trim().split(/\s+/).filter(Boolean).map((word) => {
    const match = word.match(/^(.+?)([=<>])(.*)$/);
    const k = match ? heads.indexOf(match[1]) : -1;
    if (k < 0) return (trial) => heads.some((_, k) => cell(trial, k).includes(word)) || trial.error.includes(word);
    const [, , sign, text] = match;
    if (sign === "=") return (trial) => cell(trial, k) === text || Number(raw(trial, k)) === Number(text) && text !== "";
    const bound = Number(text);
    return (trial) => { const value = raw(trial, k); return typeof value === "number" && (sign === "<" ? value < bound : value > bound); };
  });
  const draw = () => {
    const { column, up } = sorted;
    const order = kept.slice().sort((a, b) => {
      const [x, y] = [raw(data.trials[a], column), raw(data.trials[b], column)];
      if (x === null || y === null) return (x === null) - (y === null);
      const less = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
      return up ? less : -less;
    });
    [...row.cells].forEach((head, k) => k === column ? head.setAttribute("aria-sort", up ? "ascending" : "descending") : head.removeAttribute("aria-sort"));
    const body = document.createElement("tbody");
    for (const index of order.slice(0, rowsShown)) {
      const trial = data.trials[index], line = make(body, "tr");
      heads.forEach((_, k) => {
        const place = make(line, k === 0 ? "th" : "td", { class: k > 1 ? "number" : "" });
        if (k === 0) make(place, "a", { href: trial.folder + "/" }, trial.id);
        else place.textContent = cell(trial, k);
        if (k === 1 && trial.error) place.title = trial.error;
      });
    }
    table.tBodies[0].replaceWith(body);
    get("shown").textContent = order.length + " of " + data.trials.length;
    get("more").hidden = order.length <= rowsShown;
  };
  get("more").addEventListener("click", () => { rowsShown += 400; draw(); });
  const update = () => {
    const asked = tests();
    kept = [];
    data.trials.forEach((trial, index) => {
      for (const [k, holds] of brushes) if (!holds(columns[k].value(trial))) return;
      if (asked.every((test) => test(trial))) kept.push(index);
    });
    const seen = new Set(kept);
    parts(drawn.filter((index) => seen.has(index))).forEach((d, part) => on[part].setAttribute("d", d));
    draw();
  };
  let waiting;
  filter.addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(update, 60); });
  update();

  // The Pareto front.
  const plot = get("pareto"), [across, up] = [get("pareto-x"), get("pareto-y")];
  data.objectives.forEach((name) => { make(across, "option", {}, name); make(up, "option", {}, name); });
  up.value = data.objectives[0];
  across.value = data.objectives[Math.min(1, data.objectives.length - 1)];
  const detail = get("detail");
  const show = (configuration) => {
    detail.hidden = false;
    detail.replaceChildren();
    make(detail, "p", {}, configuration.name || "the fixed settings");
    make(detail, "p", {}, data.objectives.map((name, k) => name + " " + words(configuration.figures[k])).join(", "));
    for (const index of configuration.trials) {
      const trial = data.trials[index], line = make(detail, "p");
      make(line, "a", { href: trial.folder + "/" }, trial.id);
      make(line, "code", {}, " headtail fit --config " + trial.folder + "/resolved.toml --out " + trial.id);
    }
  };
  const pareto = () => {
    plot.replaceChildren();
    const [i, j] = [across, up].map((select) => data.objectives.indexOf(select.value));
    const box = { left: 80, right: 880, top: 26, bottom: 360 };
    const x = scale(data.configurations.map((c) => c.figures[i]), true, box.left, box.right);
    const y = scale(data.configurations.map((c) => c.figures[j]), true, box.bottom, box.top);
    frame(plot, x, y, box, data.objectives[i], data.objectives[j]);
    const ordered = data.configurations.slice().sort((a, b) => a.figures[i] - b.figures[i] || a.figures[j] - b.figures[j]);
    let line = "", least = Infinity;
    for (const c of ordered) {
      if (c.figures[j] >= least) continue;
      least = c.figures[j];
      const [px, py] = [x.place(c.figures[i]), y.place(least)];
      line += line ? "H" + px + "V" + py : "M" + px + " " + box.top + "V" + py;
    }
    if (line) make(plot, "path", { class: "front", d: line + "H" + box.right });
    for (const c of ordered) {
      const point = make(plot, "circle", { class: "point" + (c.front ? " front-point" : ""), cx: x.place(c.figures[i]), cy: y.place(c.figures[j]), r: 5, tabindex: 0, role: "button" });
      make(point, "title", {}, c.name);
      const choose = () => {
        plot.querySelectorAll(".chosen").forEach((other) => other.classList.remove("chosen"));
        point.classList.add("chosen");
        show(c);
      };
      point.addEventListener("click", choose);
      point.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(); } });
    }
  };
  if (data.configurations.length) {
    pareto();
    across.addEventListener("change", pareto);
    up.addEventListener("change", pareto);
  } else get("pareto-section").hidden = true;

  // Effects, as bars from 1 on a logarithmic track.
  const bars = (parent, rows, low, high) => {
    const place = (ratio) => 100 * (Math.log(ratio) - Math.log(low)) / (Math.log(high) - Math.log(low));
    for (const { name, value, ratio, ends } of rows) {
      const line = make(parent, "div", { class: "bar-row" });
      make(line, "span", { class: "bar-name" }, name);
      const track = make(line, "span", { class: "bar-track" });
      const [from, to] = [place(1), place(ratio)].sort((a, b) => a - b);
      make(track, "span", { class: "bar " + (ratio > 1 ? "s1" : "s2") }).style.cssText = "left:" + from + "%;width:" + (to - from) + "%";
      make(track, "span", { class: "bar-one" }).style.left = place(1) + "%";
      if (ends) {
        const [a, b] = ends.map((end) => Math.min(100, Math.max(0, place(end))));
        make(track, "span", { class: "bar-ci" }).style.cssText = "left:" + a + "%;width:" + (b - a) + "%";
      }
      make(line, "span", { class: "bar-value" }, value);
    }
  };
  if (data.effects.length) {
    get("effects-note").textContent = data.objectives[0] + " under each value over that of all trials, geometric means: less than 1 is better. Lines are 95 % intervals over " + (data.has_seeds ? "seeds" : "trials") + ". Trials are compared with those of the same map. Ranges are divided into parts with equally many trials.";
    let low = 0.5, high = 2;
    for (const [, effects] of data.effects) for (const { ratio } of effects) { low = Math.min(low, ratio / 1.2); high = Math.max(high, ratio * 1.2); }
    for (const [key, effects] of data.effects) {
      const box = make(get("effects"), "div");
      make(box, "p", { class: "bars-title" }, key);
      bars(box, effects.map((effect) => ({ ...effect, name: effect.value.split("/").pop(), value: words(effect.ratio) })), low, high);
    }
  } else get("effects-section").hidden = true;

  // Importance.
  if (data.importance) {
    const { shares, explained, trees, objective } = data.importance;
    const most = Math.max(...shares.map(([, share]) => share), 1e-9);
    for (const [key, share] of shares) {
      const line = make(get("importance"), "div", { class: "bar-row" });
      make(line, "span", { class: "bar-name" }, key);
      make(make(line, "span", { class: "bar-track" }), "span", { class: "bar s2" }).style.cssText = "left:0;width:" + 100 * share / most + "%";
      make(line, "span", { class: "bar-value" }, words(share));
    }
    get("importance-note").textContent = "Permutation importance over a random forest of " + trees + " trees: the share of the variance of ln " + objective + " that the forest no longer explains, out of bag, once the setting is shuffled among trials. Trials are compared with those of the same map. The forest explains " + Math.round(100 * explained) + " %.";
  } else get("importance-section").hidden = true;

  // Learning curves.
  if (data.curves.length) {
    const svg = get("curves"), box = { left: 80, right: 880, top: 26, bottom: 300 };
    const points = data.curves.flatMap((curve) => curve.points.filter(([step]) => step > 0));
    const x = scale(points.map(([step]) => step), true, box.left, box.right);
    const y = scale(points.map(([, value]) => value), true, box.bottom, box.top);
    frame(svg, x, y, box, "steps", "relative variance");
    data.curves.slice().reverse().forEach((curve, k, all) => {
      const own = curve.points.filter(([step, value]) => step > 0 && value > 0);
      const line = make(svg, "path", { class: "curve" + (k === all.length - 1 ? " best-curve" : ""), d: "M" + own.map(([step, value]) => x.place(step) + " " + y.place(value)).join("L") });
      make(line, "title", {}, data.axes.map((axis, k) => axis.key + " = " + at(data.trials[curve.trial], k)).join(", "));
    });
    get("curves-note").textContent = "Validation of the best " + data.curves.length + " trials by " + data.objectives[0] + "; the best one is marked.";
  } else get("curves-section").hidden = true;

  // Charts as files: a copy that has its style with it, in the colours that are shown.
  const STYLED = ["fill", "stroke", "stroke-width", "stroke-dasharray", "opacity", "font-size", "font-weight"];
  const withStyle = (svg) => {
    const copy = svg.cloneNode(true);
    const originals = [svg, ...svg.querySelectorAll("*")], copies = [copy, ...copy.querySelectorAll("*")];
    originals.forEach((original, k) => {
      const style = getComputedStyle(original);
      for (const name of STYLED) copies[k].setAttribute(name, style.getPropertyValue(name));
      copies[k].removeAttribute("class");
    });
    copy.setAttribute("xmlns", SVG);
    copy.setAttribute("style", "font-family:system-ui,Helvetica,Arial,sans-serif;background:" + getComputedStyle(document.body).backgroundColor);
    return new XMLSerializer().serializeToString(copy);
  };
  for (const svg of document.querySelectorAll("svg.chart")) {
    const line = make(svg.parentElement, "p", { class: "save" });
    svg.after(line);
    const button = make(line, "button", { type: "button", "aria-label": "Save " + svg.id + " as SVG" }, "Save SVG");
    button.addEventListener("click", () => {
      const link = document.createElement("a");
      link.download = svg.id + ".svg";
      link.href = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(withStyle(svg));
      link.click();
    });
  }
})();
