// Renders a view with two samplers by WebGPU, and shows both in one picture while they converge.
(() => {
  const find = (name) => document.getElementById("live-" + name);
  const content = JSON.parse(find("content").textContent);
  const { view, round, bindings } = content;
  const { width, height } = view;
  const HEADER = 28, GROUP = 7, FILM = bindings.indexOf("Film"), VIEW = bindings.indexOf("View");
  // Milliseconds of a dispatch, and most samples in one; most samples of a pixel, which the address may lower.
  const SLICE = 12, MOST_AT_ONCE = 16;
  let most = 1 << 20;
  const SEEDS = { left: 1, right: 2, reference: 3 };

  const say = (text) => { find("message").textContent = text; find("message").hidden = !text; };
  const unpack = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint32Array(await new Response(stream).arrayBuffer());
  };

  // ---- Camera
  const sub = (a, b) => a.map((x, k) => x - b[k]);
  const add = (a, b, s) => a.map((x, k) => x + s * b[k]);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const length = (a) => Math.hypot(...a);
  const unit = (a) => a.map((x) => x / length(a));
  const first = { from: view.from, at: view.at };
  let camera = { ...first };

  function axes() {
    const forward = unit(sub(camera.at, camera.from));
    const side = cross(forward, [0, 1, 0]);
    const right = length(side) > 1e-6 ? unit(side) : [1, 0, 0];
    return { forward, right, up: cross(right, forward) };
  }

  // Turns around the point that is looked at, in radians.
  function turn(azimuth, elevation) {
    const arm = sub(camera.from, camera.at);
    const distance = length(arm);
    const high = Math.max(-1.5, Math.min(1.5, Math.asin(arm[1] / distance) + elevation));
    const around = Math.atan2(arm[0], arm[2]) + azimuth;
    const flat = Math.cos(high) * distance;
    const offset = [Math.sin(around) * flat, Math.sin(high) * distance, Math.cos(around) * flat];
    camera = { ...camera, from: add(camera.at, offset, 1) };
    restart();
  }

  function approach(factor) {
    camera = { ...camera, from: add(camera.at, sub(camera.from, camera.at), factor) };
    restart();
  }

  // ---- Device
  let device, layout, films, display, measuring, resources;
  const programs = new Map();

  const buffer = (words, usage) => {
    const made = device.createBuffer({ size: Math.max(4 * words.length, 16), usage: usage | GPUBufferUsage.COPY_DST });
    device.queue.writeBuffer(made, 0, words);
    return made;
  };

  async function open() {
    if (!navigator.gpu) throw new Error("This browser has no WebGPU. Current versions of Chrome, Edge, Firefox and Safari have it; on some systems it must be switched on.");
    const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
    if (!adapter) throw new Error("WebGPU finds no graphics adapter.");
    const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
    device = await adapter.requestDevice({ requiredLimits: { maxStorageBufferBindingSize, maxBufferSize } });
    device.lost.then(({ message }) => say("The graphics device was lost: " + message + " Load the page again."));
    const info = adapter.info ?? {};
    find("adapter").textContent = [info.vendor, info.architecture, info.description].filter(Boolean).join(" ");
    const kind = (binding) => ({ type: binding === FILM ? "storage" : "read-only-storage" });
    layout = device.createBindGroupLayout({
      entries: bindings.map((_, binding) => ({ binding, visibility: GPUShaderStage.COMPUTE, buffer: kind(binding) })),
    });
    resources = {};
    for (const [name, packed] of Object.entries(content.scene)) resources[name] = buffer(await unpack(packed), GPUBufferUsage.STORAGE);
    const film = () => device.createBuffer({ size: 48 * width * height, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC | GPUBufferUsage.COPY_DST });
    films = { left: film(), right: film(), reference: film() };
    const format = navigator.gpu.getPreferredCanvasFormat();
    const module = device.createShaderModule({ code: content.display });
    const canvas = find("canvas").getContext("webgpu");
    canvas.configure({ device, format, alphaMode: "opaque" });
    const pipeline = device.createRenderPipeline({
      layout: "auto", vertex: { module, entryPoint: "corner" }, fragment: { module, entryPoint: "pixel", targets: [{ format }] },
    });
    const uniform = (size) => device.createBuffer({ size, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    display = { canvas, pipeline, uniform: uniform(64) };
    display.group = device.createBindGroup({
      layout: pipeline.getBindGroupLayout(0),
      entries: [films.left, films.right, display.uniform].map((own, binding) => ({ binding, resource: { buffer: own } })),
    });
    const compute = { module: device.createShaderModule({ code: content.error }), entryPoint: "measure" };
    measuring = {
      pipeline: device.createComputePipeline({ layout: "auto", compute }),
      counts: uniform(16),
      result: device.createBuffer({ size: 16, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC }),
      read: device.createBuffer({ size: 16, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST }),
    };
  }

  // Compiles a sampler and moves its buffers to the device, once.
  function program(index) {
    if (!programs.has(index)) {
      programs.set(index, (async () => {
        const own = content.samplers[index];
        const module = device.createShaderModule({ code: own.source });
        const pipeline = await device.createComputePipelineAsync({
          layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }), compute: { module, entryPoint: "headtail_render" },
        });
        const buffers = { ...resources };
        for (const name of ["Floats", "Integers", "Visibility"]) buffers[name] = buffer(await unpack(own[name]), GPUBufferUsage.STORAGE);
        const numbers = await unpack(own.numbers);
        const size = 4 * Math.max(HEADER + Math.ceil(numbers.length / round) * MOST_AT_ONCE, 32);
        return { pipeline, buffers, numbers, perSample: numbers.length / round, size };
      })());
    }
    return programs.get(index);
  }

  // ---- Pictures
  // Of each: its sampler, finished samples of all pixels, the rows that have `extra` more, milliseconds, cost of a pixel's sample.
  const pictures = {};
  let paused = false, errors = {}, generation = 0;

  async function choose(side, index) {
    const own = await program(index);
    const words = device.createBuffer({ size: own.size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
    const resource = (name, binding) => (binding === FILM ? films[side] : binding === VIEW ? words : own.buffers[name]);
    const group = device.createBindGroup({ layout, entries: bindings.map((name, binding) => ({ binding, resource: { buffer: resource(name, binding) } })) });
    pictures[side] = { side, index, own, words, group, cost: pictures[side]?.index === index ? pictures[side].cost : 0 };
    clear(pictures[side]);
  }

  function clear(picture) {
    Object.assign(picture, { samples: 0, rows: 0, extra: 0, spent: 0 });
    const encoder = device.createCommandEncoder();
    encoder.clearBuffer(films[picture.side]);
    device.queue.submit([encoder.finish()]);
    errors = {};
  }

  function restart() {
    generation += 1;
    Object.values(pictures).forEach(clear);
    save();
  }

  function header(row, samples, seed) {
    const words = new Uint32Array(HEADER), floats = new Float32Array(words.buffer);
    const { forward, right, up } = axes();
    floats.set([...camera.from, view.halfHeight, ...right, view.principal[0], ...up, view.principal[1], ...forward, view.parallel ? 1 : 0]);
    words.set([width, height, view.depth, view.unshadowed ? 1 : 0, 0, 0, width, height, row, samples, seed, 0], 16);
    return words;
  }

  // Adds some samples to a picture, or one sample to some of its rows.
  async function advance(picture) {
    const { own, group, words } = picture;
    const begun = generation;
    const pixels = picture.cost > 0 ? SLICE / picture.cost : 8 * width;
    const whole = Math.min(Math.floor(pixels / (width * height)), MOST_AT_ONCE, round - (picture.samples % round), most - picture.samples);
    const count = picture.rows > 0 ? picture.extra : Math.max(whole, 1);
    const rows = Math.min(Math.max(8 * Math.floor(pixels / count / width / 8), 8), height - picture.rows);
    const from = (picture.samples % round) * own.perSample;
    const numbers = own.numbers.slice(from, from + count * own.perSample);
    // Each round of samples has a shift of its own.
    const turns = Math.floor(picture.samples / round);
    for (let group = 0; group < numbers.length; group += GROUP) numbers[group + 3] += turns;
    device.queue.writeBuffer(words, 0, header(picture.rows, count, SEEDS[picture.side]));
    device.queue.writeBuffer(words, 4 * HEADER, numbers);
    const start = performance.now();
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(own.pipeline);
    pass.setBindGroup(0, group);
    pass.dispatchWorkgroups(Math.ceil(width / 8), Math.ceil(rows / 8));
    pass.end();
    device.queue.submit([encoder.finish()]);
    await device.queue.onSubmittedWorkDone();
    const taken = performance.now() - start;
    picture.cost = taken / (rows * width * count);
    // The camera moved meanwhile.
    if (begun !== generation) return clear(picture);
    picture.spent += taken;
    picture.rows += rows;
    picture.extra = count;
    if (picture.rows >= height) Object.assign(picture, { samples: picture.samples + count, rows: 0, extra: 0 });
  }

  function draw() {
    const data = new ArrayBuffer(64), floats = new Float32Array(data);
    new Uint32Array(data).set([width, height]);
    const counts = ({ samples, extra, rows }) => [samples, extra, rows, 0];
    floats.set([...counts(pictures.left), ...counts(pictures.right), cut() / 100, 2 ** (view.stops + stops()), 0, 0], 4);
    device.queue.writeBuffer(display.uniform, 0, data);
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view: display.canvas.getCurrentTexture().createView(), loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(display.pipeline);
    pass.setBindGroup(0, display.group);
    pass.draw(3);
    pass.end();
    device.queue.submit([encoder.finish()]);
  }

  // The mean squared difference to the reference; both have whole samples.
  async function measure(picture) {
    const { reference } = pictures;
    const data = new ArrayBuffer(16);
    new Uint32Array(data)[0] = width * height;
    new Float32Array(data).set([picture.samples, reference.samples], 1);
    device.queue.writeBuffer(measuring.counts, 0, data);
    const entries = [films[picture.side], films.reference, measuring.counts, measuring.result];
    const group = device.createBindGroup({
      layout: measuring.pipeline.getBindGroupLayout(0), entries: entries.map((own, binding) => ({ binding, resource: { buffer: own } })),
    });
    const encoder = device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(measuring.pipeline);
    pass.setBindGroup(0, group);
    pass.dispatchWorkgroups(1);
    pass.end();
    encoder.copyBufferToBuffer(measuring.result, 0, measuring.read, 0, 16);
    device.queue.submit([encoder.finish()]);
    await measuring.read.mapAsync(GPUMapMode.READ);
    const [sum, pixels] = new Float32Array(measuring.read.getMappedRange());
    measuring.read.unmap();
    errors[picture.side] = pixels > 0 ? sum / pixels : NaN;
  }

  function tag(side) {
    const { index, samples, spent, cost } = pictures[side];
    const rate = cost > 0 ? `${(1e-3 / cost).toPrecision(3)} M samples/s` : "";
    const error = errors[side] > 0 ? `MSE ${errors[side].toExponential(1)} against ${pictures.reference.samples} spp` : "";
    const small = document.createElement("small");
    small.textContent = [`${samples} spp, ${(spent / 1000).toFixed(1)} s`, rate, error].filter(Boolean).join(" · ");
    find("tag-" + side).replaceChildren(content.samplers[index].name, small);
  }

  // ---- The loop: both sides have the same time, the reference half of it once they had a second.
  async function loop() {
    let measured = 0;
    for (;;) {
      const { left, right, reference } = pictures;
      const start = performance.now();
      while (!paused && performance.now() - start < SLICE) {
        const [behind] = [left, right].filter((own) => own.samples < most).sort((a, b) => a.spent - b.spent);
        const isDue = !behind || reference.rows > 0 || (behind.spent > 1000 && reference.spent < 0.5 * behind.spent && behind.rows === 0);
        const next = isDue ? reference : behind;
        if (next.samples >= most) break;
        await advance(next);
        if (pictures[next.side] !== next) break;
        const isWhole = next !== reference && next.rows === 0 && next.samples > 0 && reference.samples > 0 && reference.rows === 0;
        if (isWhole && performance.now() - measured > 250) {
          await measure(next);
          measured = next === right ? performance.now() : measured;
        }
      }
      draw();
      tag("left");
      tag("right");
      await new Promise((done) => requestAnimationFrame(done));
    }
  }

  // ---- Controls, and the address
  const cut = () => Number(find("cut").value);
  const stops = () => Number(find("exposure").value);

  function save() {
    const place = (numbers) => numbers.map((x) => Number(x.toPrecision(6))).join(",");
    const chosen = { left: find("left").value, right: find("right").value, cut: cut(), exposure: stops(), from: place(camera.from), at: place(camera.at) };
    clearTimeout(save.later);
    save.later = setTimeout(() => history.replaceState(null, "", "#" + new URLSearchParams(chosen)), 200);
  }

  function load() {
    const chosen = new URLSearchParams(location.hash.slice(1));
    const place = (name) => {
      const numbers = (chosen.get(name) ?? "").split(",").map(Number);
      return numbers.length === 3 && numbers.every(Number.isFinite) ? numbers : camera[name];
    };
    camera = { from: place("from"), at: place("at") };
    if (Number(chosen.get("spp")) > 0) most = Number(chosen.get("spp"));
    if (length(sub(camera.at, camera.from)) === 0) camera = { ...first };
    for (const side of ["left", "right"]) if (content.samplers[chosen.get(side)]) find(side).value = chosen.get(side);
    for (const [name, key] of [["cut", "cut"], ["exposure", "exposure"]]) if (chosen.has(key)) find(name).value = chosen.get(key);
    place_divider();
  }

  function place_divider() {
    find("divider").style.left = cut() + "%";
    find("stops").textContent = stops();
  }

  function listen() {
    for (const name of ["cut", "exposure"]) find(name).addEventListener("input", () => { place_divider(); save(); });
    for (const side of ["left", "right"]) {
      find(side).addEventListener("change", async () => {
        try {
          say("Compiling…");
          await choose(side, Number(find(side).value));
          if (side === "right") await choose("reference", Number(find(side).value));
          restart();
          say("");
        } catch (error) { say(error.message); }
      });
    }
    const pause = () => { paused = !paused; find("pause").textContent = paused ? "Go on" : "Pause"; };
    find("pause").addEventListener("click", pause);
    find("home").addEventListener("click", () => { camera = { ...first }; restart(); });
    const stage = find("stage"), fingers = new Map();
    let holdsDivider = false;
    const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
    stage.addEventListener("pointerdown", (event) => {
      stage.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      holdsDivider = event.target === find("divider");
      stage.classList.toggle("moving", !holdsDivider);
    });
    stage.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const apart = fingers.size === 2 ? spread() : 0;
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const box = stage.getBoundingClientRect();
      if (fingers.size === 2) {
        if (spread() > 0) approach(apart / spread());
      } else if (holdsDivider) {
        find("cut").value = (100 * (event.clientX - box.left)) / box.width;
        place_divider();
        save();
      } else {
        turn((-3 * (event.clientX - before.x)) / box.width, (3 * (event.clientY - before.y)) / box.height);
      }
    });
    const release = (event) => { fingers.delete(event.pointerId); stage.classList.remove("moving"); };
    stage.addEventListener("pointerup", release);
    stage.addEventListener("pointercancel", release);
    stage.addEventListener("wheel", (event) => { event.preventDefault(); approach(2 ** (event.deltaY / 600)); }, { passive: false });
    stage.addEventListener("keydown", (event) => {
      const keys = {
        ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
        "+": () => approach(0.9), "=": () => approach(0.9), "-": () => approach(1.1), " ": pause,
      };
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  async function run() {
    try {
      load();
      listen();
      await open();
      device.addEventListener("uncapturederror", ({ error }) => say(error.message));
      const right = Number(find("right").value);
      for (const [side, index] of [["left", Number(find("left").value)], ["right", right], ["reference", right]]) await choose(side, index);
      say("");
      await loop();
    } catch (error) { say(error.message); }
  }

  // For scripts: the pictures so far, and a film's numbers.
  async function read(side) {
    const copy = device.createBuffer({ size: films[side].size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    const encoder = device.createCommandEncoder();
    encoder.copyBufferToBuffer(films[side], 0, copy, 0, films[side].size);
    device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    return new Float32Array(copy.getMappedRange());
  }
  window.headtail = { pictures, read, errors: () => errors, turn };
  run();
})();
