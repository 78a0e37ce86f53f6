"use strict";

// What the parts of a page share: what its address keeps, and pictures as linear values with an exposure.
const headtail = (() => {
  // The fragment of the address holds what a reader has chosen, as key=value pairs. A fragment without them is a place on the page.
  const known = () => new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  const get = (key) => known().get(key);
  const keep = (key, value) => {
    const chosen = known();
    if (value === null || value === undefined) chosen.delete(key);
    else chosen.set(key, value);
    const text = chosen.toString().replaceAll("%2C", ",").replaceAll("%3B", ";");
    history.replaceState(null, "", text ? "#" + text : location.pathname + location.search);
  };
  const restored = [];
  // Calls back now and whenever the address is changed by hand.
  const restore = (callback) => {
    restored.push(callback);
    callback();
  };
  window.addEventListener("hashchange", () => {
    if (location.hash.includes("=")) for (const callback of restored) callback();
  });

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  const DECODED = Float32Array.from({ length: 256 }, (_, code) => {
    const v = code / 255;
    return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });
  const STEPS = 16384;
  const ENCODED = Uint8ClampedArray.from({ length: STEPS + 1 }, (_, step) => {
    const v = step / STEPS;
    return 255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
  });
  const encode = (value) => ENCODED[value > 0 ? (value < 1 ? (value * STEPS + 0.5) | 0 : STEPS) : 0];

  // Planes of mantissas and exponents, as the program writes them.
  async function decode(text, width, height) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const count = width * height;
    if (planes.length !== 4 * count) throw new Error("linear values of another size");
    for (let row = 0; row < 4 * count; row += width) {
      for (let x = 1; x < width; x++) planes[row + x] += planes[row + x - 1];
    }
    const linear = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) {
      const exponent = planes[3 * count + k];
      const scale = exponent === 255 ? NaN : 2 ** (exponent - 136);
      for (let c = 0; c < 3; c++) linear[3 * k + c] = planes[c * count + k] * scale;
    }
    return linear;
  }

  // The values of a picture that has none but its own 8 bits: those of the display.
  function shown(image, width, height) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0, width, height);
    const pixels = context.getImageData(0, 0, width, height).data;
    const linear = new Float32Array(3 * width * height);
    for (let k = 0; k < width * height; k++) for (let c = 0; c < 3; c++) linear[3 * k + c] = DECODED[pixels[4 * k + c]];
    return linear;
  }

  const pictures = new Map();
  // The linear values of an <img> by its id, as a promise.
  function picture(id) {
    if (!pictures.has(id)) {
      const load = async () => {
        const image = document.getElementById(id);
        await image.decode();
        const [width, height] = [image.naturalWidth, image.naturalHeight];
        const source = document.querySelector(`script[data-of="${id}"]`);
        const linear = source ? await decode(source.textContent, width, height) : shown(image, width, height);
        return { width, height, linear, isDisplay: !source };
      };
      pictures.set(id, load());
    }
    return pictures.get(id);
  }

  // The tone curve of the program's pictures: extended Reinhard, white at this luminance; colours fade where a channel would pass 1.
  const WHITE = 8;
  function toneMap(out, at, r, g, b) {
    if (Number.isNaN(r + g + b)) {
      [out[at], out[at + 1], out[at + 2]] = [255, 0, 255];
      return;
    }
    const bright = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    if (bright >= WHITE) {
      out[at] = out[at + 1] = out[at + 2] = 255;
      return;
    }
    const level = bright * (1 + bright / (WHITE * WHITE)) / (1 + bright);
    const scale = bright > 0 ? level / bright : 0;
    const peak = Math.max(r, g, b) * scale;
    const fade = peak > 1 ? (1 - level) / (peak - level) : 1;
    out[at] = encode(level + (r * scale - level) * fade);
    out[at + 1] = encode(level + (g * scale - level) * fade);
    out[at + 2] = encode(level + (b * scale - level) * fade);
  }

  // Draws `colour(k, out, at)` for each pixel.
  function draw(canvas, width, height, colour) {
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    const image = context.createImageData(width, height);
    for (let k = 0; k < width * height; k++) {
      colour(k, image.data, 4 * k);
      image.data[4 * k + 3] = 255;
    }
    context.putImageData(image, 0, 0);
  }

  // A picture under an exposure in stops.
  function paint(canvas, { width, height, linear, isDisplay }, stops) {
    const scale = 2 ** stops;
    draw(canvas, width, height, (k, out, at) => {
      const [r, g, b] = [scale * linear[3 * k], scale * linear[3 * k + 1], scale * linear[3 * k + 2]];
      if (isDisplay) [out[at], out[at + 1], out[at + 2]] = [encode(r), encode(g), encode(b)];
      else toneMap(out, at, r, g, b);
    });
  }

  // What the right picture has more or less than the left one.
  function difference(canvas, left, right, stops, isRelative) {
    const scale = 2 ** stops, [a, b] = [left.linear, right.linear];
    const luminance = (values, k) => 0.2126 * values[3 * k] + 0.7152 * values[3 * k + 1] + 0.0722 * values[3 * k + 2];
    draw(canvas, left.width, left.height, (k, out, at) => {
      if (!isRelative) {
        for (let c = 0; c < 3; c++) out[at + c] = encode(scale * Math.abs(b[3 * k + c] - a[3 * k + c]));
        return;
      }
      const before = luminance(a, k);
      const part = clamp(scale * (luminance(b, k) - before) / (before + 0.01), -1, 1);
      const end = part < 0 ? [33, 102, 172] : [178, 24, 43];
      for (let c = 0; c < 3; c++) out[at + c] = 247 + Math.abs(part) * (end[c] - 247);
    });
  }

  return { get, keep, restore, clamp, picture, paint, difference };
})();
