"use strict";

// The slider: two images on top of each other, the upper one cut at the divider.
(() => {
  const stage = document.getElementById("stage");
  if (!stage) return;
  const get = (id) => document.getElementById(id);
  const [before, after, divider, position, zoom] = ["before", "after", "divider", "position", "zoom"].map(get);
  const state = { cut: 50, zoom: 1, x: 0, y: 0 };

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  // x and y are the offset of the zoomed image, in parts of the stage, from 0 to 1 - zoom.
  function draw() {
    state.x = clamp(state.x, 1 - state.zoom, 0);
    state.y = clamp(state.y, 1 - state.zoom, 0);
    const style = stage.style;
    style.setProperty("--zoom", state.zoom);
    style.setProperty("--x", 100 * state.x + "%");
    style.setProperty("--y", 100 * state.y + "%");
    style.setProperty("--position", state.cut + "%");
    // The cut in parts of the image, which is larger than the stage when zoomed.
    style.setProperty("--cut", (state.cut - 100 * state.x) / state.zoom + "%");
    stage.classList.toggle("zoomed", state.zoom > 1);
    position.value = state.cut;
  }

  function show(select, image, tag) {
    const option = select.selectedOptions[0];
    image.src = document.getElementById(option.value).src;
    image.alt = option.text;
    tag.textContent = option.text;
    if (option.dataset.note) {
      const note = document.createElement("small");
      note.textContent = option.dataset.note;
      tag.append(note);
    }
  }

  const showLeft = () => show(get("left"), before, get("tag-left"));
  const showRight = () => show(get("right"), after, get("tag-right"));
  get("left").addEventListener("change", showLeft);
  get("right").addEventListener("change", showRight);

  zoom.addEventListener("change", () => {
    // The middle of the stage stays where it is.
    const factor = zoom.value / state.zoom;
    state.x = 0.5 - (0.5 - state.x) * factor;
    state.y = 0.5 - (0.5 - state.y) * factor;
    state.zoom = Number(zoom.value);
    draw();
  });

  const sharpen = () => stage.classList.toggle("pixelated", get("pixelated").checked);
  get("pixelated").addEventListener("change", sharpen);

  position.addEventListener("input", () => {
    state.cut = Number(position.value);
    draw();
  });

  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const pan = state.zoom > 1 && event.target !== divider;
    const box = stage.getBoundingClientRect();
    const start = { px: event.clientX, py: event.clientY, x: state.x, y: state.y };
    const move = (event) => {
      if (pan) {
        state.x = start.x + (event.clientX - start.px) / box.width;
        state.y = start.y + (event.clientY - start.py) / box.height;
      } else {
        state.cut = clamp((100 * (event.clientX - box.left)) / box.width, 0, 100);
      }
      draw();
    };
    const stop = () => {
      stage.classList.remove("moving");
      stage.removeEventListener("pointermove", move);
      stage.removeEventListener("pointerup", stop);
      stage.removeEventListener("pointercancel", stop);
    };
    stage.setPointerCapture(event.pointerId);
    stage.classList.add("moving");
    stage.addEventListener("pointermove", move);
    stage.addEventListener("pointerup", stop);
    stage.addEventListener("pointercancel", stop);
    if (!pan) move(event);
  });

  stage.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!step) return;
    if (state.zoom > 1) {
      state.x += step[0];
      state.y += step[1];
    } else if (step[0]) {
      state.cut = clamp(state.cut - 20 * step[0], 0, 100);
    } else {
      return;
    }
    event.preventDefault();
    draw();
  });

  showLeft();
  showRight();
  sharpen();
  draw();
})();

// Small multiples: one budget at a time.
(() => {
  const choices = document.querySelectorAll("#budgets input");
  const choose = () => {
    const chosen = [...choices].find((choice) => choice.checked)?.value;
    for (const part of document.querySelectorAll("[data-panel]")) part.hidden = part.dataset.panel !== chosen;
  };
  for (const choice of choices) choice.addEventListener("change", choose);
  choose();
})();

// The table: a click on a column sorts by it, a second one the other way round.
(() => {
  const table = document.getElementById("results");
  if (!table) return;
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
})();
