
// The slider: two pictures on top of each other, the upper one cut at the divider, or their difference.
(() => {
  const stage = document.getElementById("stage");
  if (!stage) return;
  const get = (id) => document.getElementById(id);
  const names = ["before", "after", "difference", "divider", "position", "zoom", "mode", "exposure", "stops", "left", "right"];
  const [before, after, difference, divider, position, zoom, mode, exposure, stops, left, right] = names.map(get);
  const state = { cut: 50, zoom: 1, x: 0, y: 0 };
  const clamp = headtail.clamp;

  // x and y are the offset of the zoomed picture, in parts of the stage, from 0 to 1 - zoom.
  function place() {
    state.x = clamp(state.x, 1 - state.zoom, 0);
    state.y = clamp(state.y, 1 - state.zoom, 0);
    const style = stage.style;
    style.setProperty("--zoom", state.zoom);
    style.setProperty("--x", 100 * state.x + "%");
    style.setProperty("--y", 100 * state.y + "%");
    style.setProperty("--position", state.cut + "%");
    // The cut in parts of the picture, which is larger than the stage when zoomed.
    style.setProperty("--cut", (state.cut - 100 * state.x) / state.zoom + "%");
    stage.classList.toggle("zoomed", state.zoom > 1);
    position.value = state.cut;
  }

  function tag(select, element) {
    const option = select.selectedOptions[0];
    element.textContent = option.text;
    if (option.dataset.note) {
      const note = document.createElement("small");
      note.textContent = option.dataset.note;
      element.append(note);
    }
  }

  // Pictures come when they are decoded: only the last wish counts.
  let wish = 0;
  async function show() {
    const own = ++wish;
    tag(left, get("tag-left"));
    tag(right, get("tag-right"));
    const isBoth = mode.value === "both";
    const [a, b] = await Promise.all([headtail.picture(left.value), headtail.picture(right.value)]);
    if (own !== wish) return;
    const value = Number(exposure.value);
    stops.textContent = (value > 0 ? "+" : value < 0 ? "\u2212" : "") + Math.abs(value);
    [before.hidden, after.hidden, divider.hidden, difference.hidden] = [!isBoth, !isBoth, !isBoth, isBoth];
    before.setAttribute("aria-label", left.selectedOptions[0].text);
    after.setAttribute("aria-label", right.selectedOptions[0].text);
    difference.setAttribute("aria-label", mode.selectedOptions[0].text);
    position.disabled = !isBoth;
    if (isBoth) {
      headtail.paint(before, a, value);
      headtail.paint(after, b, value);
    } else {
      headtail.difference(difference, a, b, value, mode.value === "relative");
    }
    stage.dispatchEvent(new CustomEvent("shown"));
  }

  const choose = (select, key, first) => select.addEventListener("change", () => {
    headtail.keep(key, select.value === first ? null : select.value);
    show();
  });
  const first = { left: left.value, right: right.value };
  choose(left, "left", first.left);
  choose(right, "right", first.right);
  choose(mode, "mode", "both");
  exposure.addEventListener("input", () => {
    headtail.keep("exposure", Number(exposure.value) || null);
    show();
    document.dispatchEvent(new CustomEvent("exposure", { detail: Number(exposure.value) }));
  });

  function setZoom(value) {
    // The middle of the stage stays where it is.
    const factor = value / state.zoom;
    state.x = 0.5 - (0.5 - state.x) * factor;
    state.y = 0.5 - (0.5 - state.y) * factor;
    state.zoom = value;
    place();
  }
  zoom.addEventListener("change", () => {
    setZoom(Number(zoom.value));
    headtail.keep("zoom", zoom.value === "1" ? null : zoom.value);
  });

  const sharpen = () => stage.classList.toggle("pixelated", get("pixelated").checked);
  get("pixelated").addEventListener("change", sharpen);

  position.addEventListener("input", () => {
    state.cut = Number(position.value);
    place();
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
      place();
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
    place();
  });

  headtail.restore(() => {
    for (const [select, key, value] of [[left, "left", first.left], [right, "right", first.right], [mode, "mode", "both"]]) {
      select.value = headtail.get(key) ?? value;
      if (!select.selectedOptions.length) select.value = value;
    }
    exposure.value = headtail.get("exposure") ?? 0;
    zoom.value = headtail.get("zoom") ?? "1";
    if (!zoom.selectedOptions.length) zoom.value = "1";
    setZoom(Number(zoom.value));
    sharpen();
    show();
    document.dispatchEvent(new CustomEvent("exposure", { detail: Number(exposure.value) }));
  });
})();
