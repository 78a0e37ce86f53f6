"use strict";

window.addEventListener("load", () => {
  const get = (id) => document.getElementById(id);
  const found = {};
  const seen = (element) => element && element.getBoundingClientRect().width > 50 && element.getBoundingClientRect().height > 50;
  const finish = () => {
    found.charts = [...document.querySelectorAll("svg.chart")].filter(seen).length;
    found.images = [...document.images].every((image) => image.complete && image.naturalWidth > 0);
    document.body.dataset.probe = Object.entries(found).map(([key, value]) => key + "=" + value).join(" ");
  };
  if (document.querySelector(".kicker")?.textContent.endsWith("autosize")) {
    // autosize: the line along the front, and the chosen sampler by name.
    found.front = [...document.querySelectorAll("svg.chart path.front")].some(seen);
    found.choice = [...document.querySelectorAll("svg.chart text")].some((label) => label.textContent.startsWith("best: "));
  }
  if (get("position")) return useSlider().catch((error) => { found.error = String(error).replaceAll(" ", "_"); }).then(finish);

  // Makes a choice, and waits until the stage is repainted.
  function change(element, value, kind) {
    return new Promise((resolve) => {
      get("stage").addEventListener("shown", resolve, { once: true });
      element.value = value;
      element.dispatchEvent(new Event(kind));
    });
  }
  function pixels(source) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [source.naturalWidth || source.width, source.naturalHeight || source.height];
    canvas.getContext("2d").drawImage(source, 0, 0);
    return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  }
  function farthest(a, b) {
    return a.reduce((most, value, k) => Math.max(most, Math.abs(value - b[k])), 0);
  }
  function mean(values) {
    return values.reduce((sum, value) => sum + value, 0) / values.length;
  }

  async function useSlider() {
    const slider = get("position");
    const cut = () => getComputedStyle(get("before")).clipPath + get("stage").style.getPropertyValue("--position");
    const before = cut();
    slider.value = 20;
    slider.dispatchEvent(new Event("input"));
    found.moved = cut() !== before && get("stage").style.getPropertyValue("--position") === "20%";
    const left = get("left");
    const choice = [...left.options].find((option) => ["image-reference", "image-mask"].includes(option.value));
    await change(left, choice.value, "change");
    found.chosen = get("tag-left").textContent.startsWith(choice.text) && location.hash.includes("left=" + choice.value);
    // Linear values under the page's tone curve equal the picture's 8 bits up to quantization.
    found.same = farthest(pixels(get("before")), pixels(get(choice.value))) <= 3;
    const plain = mean(pixels(get("before")));
    await change(get("exposure"), -2, "input");
    found.exposed = mean(pixels(get("before"))) < plain - 5 && location.hash.includes("exposure=-2");
    await change(get("exposure"), 0, "input");
    await change(get("mode"), "difference", "change");
    const differs = mean(pixels(get("difference")).filter((_, k) => k % 4 < 3)) > 0.5 && !get("difference").hidden && get("before").hidden;
    await change(get("right"), choice.value, "change");
    found.difference = differs && pixels(get("difference")).every((value, k) => value === (k % 4 === 3 ? 255 : 0));
    await change(get("mode"), "both", "change");
    get("zoom").value = "4";
    get("zoom").dispatchEvent(new Event("change"));
    found.zoomed = get("stage").classList.contains("zoomed");
    const head = document.querySelector("table.sortable thead th:nth-child(7) button");
    if (head) {
      head.click();
      const values = [...document.querySelectorAll("table.sortable tbody tr")].map((row) => Number(row.cells[6].dataset.value));
      found.sorted = values.every((value, i) => i === 0 || values[i - 1] <= value);
    }
    if (get("multiples") && document.querySelector(".insets canvas")) useInsets();
  }

  function useInsets() {
    const boxes = [...document.querySelectorAll(".picture")].filter(seen);
    const places = () => boxes.map((box) => box.querySelector(".frame.inset-0").style.left + box.querySelector(".frame.inset-0").style.top);
    const equal = (values) => values.every((value) => value === values[0]);
    const press = (key) => boxes[1].dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
    const first = places();
    for (let k = 0; k < 5; k++) press("ArrowRight");
    for (let k = 0; k < 5; k++) press("ArrowUp");
    const moved = places();
    found.insets = equal(first) && equal(moved) && first[0] !== moved[0] && location.hash.includes("insets=");
    const area = boxes[0].getBoundingClientRect();
    boxes[0].setPointerCapture = () => {};
    boxes[0].dispatchEvent(new PointerEvent("pointerdown", { clientX: area.left + area.width / 2, clientY: area.top + area.height / 2, pointerId: 1, bubbles: true }));
    found.clicked = equal(places()) && places()[0] !== moved[0];
    // The page shows the state in the address, both at first and after changes.
    location.hash = "insets=0.3,0.4,0.1;0.7,0.6,0.1&map=flip&budget=0";
    window.dispatchEvent(new HashChangeEvent("hashchange"));
    const frame = boxes[0].querySelector(".frame.inset-0").getBoundingClientRect();
    const middle = (frame.left + frame.width / 2 - area.left) / area.width;
    const shown = [...document.querySelectorAll("img.errors")].filter((image) => image.offsetParent);
    found.fragment = Math.abs(middle - 0.3) < 0.05 && shown.length > 0 && shown.every((image) => image.dataset.map === "flip" && image.closest("[data-panel]").dataset.panel === "0");
  }
  const trials = get("trials");
  if (trials) {
    const rows = () => [...trials.tBodies[0].rows];
    found.rows = rows().length;
    // The columns: trial, state, three axes, two objectives, seconds.
    trials.tHead.rows[0].cells[5].querySelector("button").click();
    trials.tHead.rows[0].cells[5].querySelector("button").click();
    const values = rows().map((row) => Number(row.cells[5].textContent));
    found.sorted = values.every((value, i) => i === 0 || values[i - 1] <= value) || values.every((value, i) => i === 0 || values[i - 1] >= value);
    const filter = get("filter");
    const ask = (text) => { filter.value = text; filter.dispatchEvent(new Event("input")); };
    const brush = (name, from, to) => {
      const hit = document.querySelector("[data-axis=\"" + name + "\"]");
      hit.setPointerCapture = () => {};
      const box = hit.getBoundingClientRect();
      const send = (kind, share) => hit.dispatchEvent(new PointerEvent(kind, { clientX: box.left + 2, clientY: box.top + share * box.height, pointerId: 1, bubbles: true }));
      send("pointerdown", from);
      send("pointermove", to);
      send("pointerup", to);
    };
    ask("head.bins=8");
    setTimeout(() => {
      found.filtered = rows().length;
      ask("");
      setTimeout(() => {
        // The upper half of an axis with two values.
        brush("seed", 0, 0.5);
        found.brushed = rows().length === 4 && rows().every((row) => row.cells[4].textContent === "1");
        brush("seed", 0.3, 0.3);
        found.released = rows().length;
        const points = () => [...document.querySelectorAll("#pareto .spot")].filter((point) => point.getBoundingClientRect().width > 0);
        found.points = points().length;
        points()[0].dispatchEvent(new MouseEvent("click", { bubbles: true }));
        const { fit } = JSON.parse(get("data").textContent), link = get("detail").querySelector("a");
        found.detail = !get("detail").hidden && get("detail").textContent.includes(fit.replaceAll("{id}", link.textContent))
          && link.getAttribute("href") === "trials/" + link.textContent + "/";
        const place = points()[0].getAttribute("cx");
        get("pair").value = "1";
        get("pair").dispatchEvent(new Event("change"));
        found.axis = points().length === found.points && points()[0].getAttribute("cx") !== place;
        const links = [];
        HTMLAnchorElement.prototype.click = function () { links.push(this.download + " " + decodeURIComponent(this.href)); };
        get("save-csv").click();
        get("save-tex").click();
        document.querySelector("[aria-label='Save parallel as PDF']").click();
        const pdf = links.pop();
        found.pdf = pdf.startsWith("parallel.pdf data:application/pdf") && pdf.includes("(relative_variance) Tj") && pdf.includes(" l S") && pdf.endsWith("%%EOF\n")
          && pdf.slice(pdf.indexOf("%PDF") + Number(pdf.match(/startxref\n(\d+)/)[1])).startsWith("xref\n");
        found.saved = links.length === 2 && links[0].startsWith("trials.csv") && links[0].trimEnd().split("\n").length === 9
          && links[0].includes("\n" + rows()[0].cells[0].textContent + ",done,") && links[1].includes("\\toprule") && links[1].includes("relative\\_variance");
        finish();
      }, 150);
    }, 150);
  }
  if (!trials) finish();
});
