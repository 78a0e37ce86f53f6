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
  if (step > 1) make(get("parallel-note"), "span", {}, " One trial in " + step + " is drawn.");
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
  const order = () => {
    const { column, up } = sorted;
    return kept.slice().sort((a, b) => {
      const [x, y] = [raw(data.trials[a], column), raw(data.trials[b], column)];
      if (x === null || y === null) return (x === null) - (y === null);
      const less = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
      return up ? less : -less;
    });
  };
  const draw = () => {
    const { column, up } = sorted, all = order();
    [...row.cells].forEach((head, k) => k === column ? head.setAttribute("aria-sort", up ? "ascending" : "descending") : head.removeAttribute("aria-sort"));
    const body = document.createElement("tbody");
    for (const index of all.slice(0, rowsShown)) {
      const trial = data.trials[index], line = make(body, "tr");
      heads.forEach((_, k) => {
        const place = make(line, k === 0 ? "th" : "td", { class: k > 1 ? "number" : "" });
        if (k === 0) make(place, "a", { href: trial.folder + "/" }, trial.id);
        else place.textContent = cell(trial, k);
        if (k === 1 && trial.error) place.title = trial.error;
      });
    }
    table.tBodies[0].replaceWith(body);
    get("shown").textContent = all.length + " of " + data.trials.length;
    get("more").hidden = all.length <= rowsShown;
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

  // The table as files: the rows that are shown, all of them.
  const save = (name, kind, text) => {
    const link = document.createElement("a");
    link.download = name;
    link.href = "data:" + kind + ";charset=utf-8," + encodeURIComponent(text);
    link.click();
  };
  const asCsv = () => {
    const quoted = (text) => /[",\n\r]/.test(text) ? "\"" + text.replaceAll("\"", "\"\"") + "\"" : text;
    const exact = (trial, k) => k >= 2 && typeof raw(trial, k) === "number" && !(data.axes[k - 2] && data.axes[k - 2].words) ? String(raw(trial, k)) : cell(trial, k);
    const lines = order().map((index) => heads.map((_, k) => quoted(exact(data.trials[index], k))).join(","));
    return [heads.map(quoted).join(",")].concat(lines).join("\n") + "\n";
  };
  const asLatex = () => {
    const special = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "<": "$<$", ">": "$>$" };
    const escaped = (text) => text.replace(/[\\~^<>&%$#_{}]/g, (letter) => special[letter] || "\\" + letter);
    const line = (cells) => cells.map(escaped).join(" & ") + " \\\\";
    const lines = order().map((index) => line(heads.map((_, k) => cell(data.trials[index], k))));
    const columns = heads.map((_, k) => k > 1 ? "r" : "l").join("");
    return ["% \\usepackage{booktabs}", "\\begin{tabular}{" + columns + "}", "\\toprule", line(heads), "\\midrule"].concat(lines, ["\\bottomrule", "\\end{tabular}"]).join("\n") + "\n";
  };
  get("save-csv").addEventListener("click", () => save("trials.csv", "text/csv", asCsv()));
  get("save-tex").addEventListener("click", () => save("trials.tex", "application/x-tex", asLatex()));

  // One pair of objectives at a time, and the runs of a chosen point.
  const figure = get("pareto"), detail = get("detail");
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
  if (figure) {
    const pair = get("pair"), parts = [...figure.querySelectorAll("[data-pair]")];
    pair.closest(".controls").hidden = parts.length < 2;
    pair.addEventListener("change", () => parts.forEach((part) => { part.hidden = part.dataset.pair !== pair.value; }));
    const choose = (event) => {
      const point = event.target.closest(".spot");
      if (!point || event.type === "keydown" && event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      for (const other of figure.querySelectorAll(".spot")) other.classList.toggle("chosen", other.dataset.index === point.dataset.index);
      show(data.configurations[point.dataset.index]);
    };
    figure.querySelectorAll(".spot").forEach((point) => point.setAttribute("role", "button"));
    // Names come when they are asked for: there may be thousands.
    const name = ({ target }) => {
      if (!target.classList.contains("spot") || target.hasAttribute("aria-label")) return;
      const { name, figures } = data.configurations[target.dataset.index];
      const text = (name || "the fixed settings") + ": " + data.objectives.map((objective, k) => objective + " " + words(figures[k])).join(", ");
      target.setAttribute("aria-label", text);
      make(target, "title", {}, text);
    };
    figure.addEventListener("pointerover", name);
    figure.addEventListener("focusin", name);
    figure.addEventListener("click", choose);
    figure.addEventListener("keydown", choose);
  }

  // The drawing as a file: a copy that has its style with it, in the colours that are shown.
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
  // The same as PDF: paths of M and L, lines, and texts in Helvetica, which every reader has.
  const asPdf = (svg) => {
    const [, , width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
    const colour = (value) => value.match(/[\d.]+/g).slice(0, 3).map((part) => (part / 255).toFixed(3)).join(" ");
    const octal = (letter) => letter === "\u2026" ? "\\205" : letter > "\u00ff" ? "?" : "\\" + letter.charCodeAt(0).toString(8).padStart(3, "0");
    const opacities = [], page = colour(getComputedStyle(document.body).backgroundColor);
    const marks = ["1 0 0 -1 0 " + height + " cm " + page + " rg 0 0 " + width + " " + height + " re f"];
    for (const element of svg.querySelectorAll("path, line, text")) {
      const style = getComputedStyle(element), at = (name) => Number(element.getAttribute(name));
      if (!opacities.includes(style.opacity)) opacities.push(style.opacity);
      const state = "/G" + opacities.indexOf(style.opacity) + " gs ";
      if (element.tagName === "text") {
        const x = at("x") - (style.textAnchor === "middle" ? element.getComputedTextLength() / 2 : 0);
        const text = element.firstChild.data.replace(/[()\\]|[^ -~]/g, octal);
        marks.push(state + "BT /F " + parseFloat(style.fontSize) + " Tf " + colour(style.fill) + " rg 1 0 0 -1 " + x.toFixed(1) + " " + at("y").toFixed(1) + " Tm (" + text + ") Tj ET");
        continue;
      }
      const d = element.getAttribute("d") ?? "M" + at("x1") + " " + at("y1") + "L" + at("x2") + " " + at("y2");
      const pens = d.replace(/([ML])([-\d.]+) ([-\d.]+)/g, (_, pen, x, y) => x + " " + y + " " + pen.toLowerCase() + " ");
      if (d) marks.push(state + colour(style.stroke) + " RG " + parseFloat(style.strokeWidth) + " w " + pens + "S");
    }
    const states = opacities.map((opacity, k) => "/G" + k + " << /CA " + opacity + " /ca " + opacity + " >>").join(" ");
    const content = marks.join("\n");
    const objects = [
      "<< /Type /Catalog /Pages 2 0 R >>",
      "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
      "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 " + width + " " + height + "] /Contents 5 0 R /Resources << /Font << /F 4 0 R >> /ExtGState << " + states + " >> >> >>",
      "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
      "<< /Length " + content.length + " >>\nstream\n" + content + "\nendstream",
    ];
    let file = "%PDF-1.4\n";
    const places = objects.map((object, k) => {
      const place = file.length;
      file += k + 1 + " 0 obj\n" + object + "\nendobj\n";
      return String(place).padStart(10, "0") + " 00000 n \n";
    });
    const end = "trailer\n<< /Size 6 /Root 1 0 R >>\nstartxref\n" + file.length + "\n%%EOF\n";
    return file + "xref\n0 6\n0000000000 65535 f \n" + places.join("") + end;
  };
  const saving = make(parallel.parentElement.parentElement, "p", { class: "save" }, "Save ");
  for (const [extension, kind, file] of [["svg", "image/svg+xml", withStyle], ["pdf", "application/pdf", asPdf]]) {
    const words = extension.toUpperCase();
    const button = make(saving, "button", { type: "button", "aria-label": "Save parallel as " + words }, words);
    saving.append(" ");
    button.addEventListener("click", () => save("parallel." + extension, kind, file(parallel)));
  }
})();
