
// Every sampler's picture: one budget at a time, with crops of the same places under all of them.
(() => {
  const multiples = document.getElementById("multiples");
  if (!multiples) return;

  // Radio buttons whose choice the address keeps.
  const choice = (name, key, apply) => {
    const buttons = [...document.querySelectorAll(`input[name="${name}"]`)];
    const first = buttons.find((button) => button.defaultChecked)?.value;
    const chosen = () => buttons.find((button) => button.checked)?.value;
    for (const button of buttons) {
      button.addEventListener("change", () => {
        headtail.keep(key, chosen() === first ? null : chosen());
        apply(chosen());
      });
    }
    headtail.restore(() => {
      const wanted = headtail.get(key) ?? first;
      (buttons.find((button) => button.value === wanted) ?? buttons.find((button) => button.value === first)).checked = true;
      apply(chosen());
    });
    return { chosen, choose: (value) => buttons.find((button) => button.value === value)?.click() };
  };

  let panel, map;
  const filter = () => {
    for (const part of multiples.querySelectorAll("[data-panel], [data-map]")) {
      const isHere = !part.dataset.panel || part.dataset.panel === panel;
      part.hidden = !isHere || (part.dataset.map !== undefined && part.dataset.map !== map);
    }
  };

  // Insets: the middle in parts of the picture, the side in parts of its width.
  const DEFAULTS = multiples.dataset.insets.split(";").filter(Boolean).map((text) => text.split(",").map(Number));
  const insets = DEFAULTS.map((inset) => [...inset]);
  const isVisible = (element) => element.offsetParent !== null;
  let active = "0", stops = 0;

  const cards = [...multiples.querySelectorAll(".picture")].map((box) => {
    const image = box.querySelector("img");
    const live = document.createElement("canvas");
    live.className = "live";
    live.hidden = true;
    box.append(live);
    const row = document.createElement("div");
    row.className = "insets";
    const parts = insets.map((_, index) => {
      const frame = document.createElement("span");
      frame.className = `frame inset-${index}`;
      box.append(frame);
      const canvas = document.createElement("canvas");
      canvas.className = `inset-${index}`;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `Inset ${index + 1} of ${image.alt}`);
      row.append(canvas);
      return { frame, canvas };
    });
    box.after(row);
    return { box, image, live, row, parts };
  });

  function drawCard({ image, live, row, parts }) {
    row.hidden = active === "none";
    const source = live.hidden ? image : live;
    const [width, height] = [image.naturalWidth, image.naturalHeight];
    parts.forEach(({ frame, canvas }, index) => {
      const [x, y, side] = insets[index];
      const pixels = Math.max(4, Math.round(side * width));
      const [left, top] = [Math.round(x * width - pixels / 2), Math.round(y * height - pixels / 2)];
      frame.hidden = active === "none";
      frame.style.cssText = `left:${100 * left / width}%;top:${100 * top / height}%;width:${100 * pixels / width}%;height:${100 * pixels / height}%`;
      [canvas.width, canvas.height] = [pixels, pixels];
      canvas.getContext("2d").drawImage(source, left, top, pixels, pixels, 0, 0, pixels, pixels);
    });
  }
  const drawAll = () => cards.filter((card) => isVisible(card.box)).forEach(drawCard);

  // Exposure: what is seen is painted anew, from linear values.
  async function expose() {
    const wanted = stops;
    for (const card of cards.filter((card) => isVisible(card.box))) {
      if (wanted === 0) {
        card.live.hidden = true;
      } else {
        const picture = await headtail.picture(card.image.id);
        if (wanted !== stops) return;
        headtail.paint(card.live, picture, wanted);
        card.live.hidden = false;
      }
      drawCard(card);
    }
  }

  function settle(inset) {
    const ratio = cards[0].image.naturalWidth / cards[0].image.naturalHeight;
    inset[2] = headtail.clamp(inset[2], 0.02, Math.min(1, 1 / ratio));
    inset[0] = headtail.clamp(inset[0], inset[2] / 2, 1 - inset[2] / 2);
    inset[1] = headtail.clamp(inset[1], inset[2] * ratio / 2, 1 - inset[2] * ratio / 2);
  }
  function moved() {
    insets.forEach(settle);
    const text = insets.map((inset) => inset.map((part) => part.toFixed(3)).join(",")).join(";");
    headtail.keep("insets", text === multiples.dataset.insets ? null : text);
    drawAll();
  }

  for (const { box } of cards) {
    const to = (event) => {
      const area = box.getBoundingClientRect();
      const inset = insets[Number(active)];
      [inset[0], inset[1]] = [(event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height];
      moved();
    };
    box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || active === "none") return;
      box.setPointerCapture(event.pointerId);
      box.addEventListener("pointermove", to);
      const stop = () => box.removeEventListener("pointermove", to);
      box.addEventListener("pointerup", stop, { once: true });
      box.addEventListener("pointercancel", stop, { once: true });
      to(event);
    });
    box.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === "1" || event.key === "2") return insetChoice.choose(String(Number(event.key) - 1));
      const inset = insets[Number(active)];
      if (!inset) return;
      const step = event.shiftKey ? 0.002 : 0.02;
      const moves = { ArrowLeft: [-step, 0, 1], ArrowRight: [step, 0, 1], ArrowUp: [0, -step, 1], ArrowDown: [0, step, 1],
        "+": [0, 0, 1.2], "=": [0, 0, 1.2], "-": [0, 0, 1 / 1.2] };
      const move = moves[event.key];
      if (!move) return;
      event.preventDefault();
      inset[0] += move[0];
      inset[1] += move[1];
      inset[2] *= move[2];
      moved();
    });
  }

  const ready = Promise.all(cards.map((card) => card.image.decode().catch(() => {})));
  ready.then(() => {
    if (insets.length) {
      headtail.restore(() => {
        const kept = (headtail.get("insets") ?? multiples.dataset.insets).split(";").map((text) => text.split(",").map(Number));
        kept.forEach((inset, index) => {
          if (insets[index] && inset.length === 3 && inset.every(Number.isFinite)) insets[index] = inset;
        });
        insets.forEach(settle);
        drawAll();
      });
    }
    document.addEventListener("exposure", (event) => {
      stops = event.detail;
      expose();
    });
    stops = Number(headtail.get("exposure") ?? 0);
    expose();
  });
  choice("budget", "budget", (value) => {
    panel = value;
    filter();
    ready.then(expose);
  });
  choice("map", "map", (value) => {
    map = value;
    filter();
  });
  const insetChoice = choice("inset", "inset", (value) => {
    active = value;
    ready.then(drawAll);
  });
})();
