"use strict";

window.addEventListener("load", () => {
  const get = (id) => document.getElementById(id);
  const found = {};
  const seen = (element) => element && element.getBoundingClientRect().width > 50 && element.getBoundingClientRect().height > 50;
  const slider = get("position");
  if (slider) {
    const cut = () => getComputedStyle(get("before")).clipPath + get("stage").style.getPropertyValue("--position");
    const before = cut();
    slider.value = 20;
    slider.dispatchEvent(new Event("input"));
    found.moved = cut() !== before && get("stage").style.getPropertyValue("--position") === "20%";
    const left = get("left");
    const choice = [...left.options].find((option) => ["image-reference", "image-mask"].includes(option.value));
    left.value = choice.value;
    left.dispatchEvent(new Event("change"));
    found.chosen = get("tag-left").textContent.startsWith(choice.text) && get("before").naturalWidth > 0;
    const zoom = get("zoom");
    zoom.value = "4";
    zoom.dispatchEvent(new Event("change"));
    found.zoomed = get("stage").classList.contains("zoomed");
    const head = document.querySelector("#results thead th:nth-child(7) button");
    if (head) {
      head.click();
      const values = [...document.querySelectorAll("#results tbody tr")].map((row) => Number(row.cells[6].dataset.value));
      found.sorted = values.every((value, i) => i === 0 || values[i - 1] <= value);
    }
  }
  const finish = () => {
    found.charts = [...document.querySelectorAll("svg.chart")].filter(seen).length;
    found.images = [...document.images].every((image) => image.complete && image.naturalWidth > 0);
    document.body.dataset.probe = Object.entries(found).map(([key, value]) => key + "=" + value).join(" ");
  };
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
        const points = document.querySelectorAll("#pareto .point");
        found.points = points.length;
        points[0].dispatchEvent(new MouseEvent("click"));
        found.detail = !get("detail").hidden && get("detail").textContent.includes("headtail fit --config trials/") && get("detail").querySelector("a") !== null;
        const before = get("pareto").innerHTML;
        get("pareto-x").value = "relative_variance";
        get("pareto-x").dispatchEvent(new Event("change"));
        found.axis = get("pareto").innerHTML !== before;
        finish();
      }, 150);
    }, 150);
  }
  if (!trials) finish();
});
