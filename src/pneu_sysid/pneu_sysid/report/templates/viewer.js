// SPDX-License-Identifier: Apache-2.0
// The time plot: measured and modelled readings per sensor, residual strips, valve command.

const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const MARGIN = { left: 64, right: 12, top: 6, bottom: 26 };
const GAP_PX = 6;
const HEAD_PX = 16; // line of text above each frame

function unpack(text, Type) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return new Type(bytes.buffer);
}

/** Ticks at 1, 2 or 5 times a power of ten, about `count` of them, with the decimals they need. */
function niceTicks(low, high, count) {
  const rough = (high - low) / Math.max(count, 1);
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * decade).find((s) => s >= rough);
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = [];
  for (let i = Math.ceil(low / step); i * step <= high + 1e-9 * step; i++) {
    ticks.push({ at: i * step, label: (i * step).toFixed(places).replace("-", "−") });
  }
  return ticks;
}

/** Zero and the decades, outermost first, of a scale linear up to `linear`, logarithmic beyond. */
function decadeTicks(linear, high) {
  const ticks = [{ at: 0, label: "0" }];
  const first = Math.ceil(Math.log10(linear));
  const last = Math.floor(Math.log10(high));
  for (let decade = last; decade >= first; decade--) {
    const label = (10 ** decade).toFixed(Math.max(0, -decade));
    ticks.push({ at: 10 ** decade, label }, { at: -(10 ** decade), label: `−${label}` });
  }
  return ticks;
}

/** Index of the first time that is not below t. */
function lowerBound(time, t) {
  let low = 0;
  let high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < t) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Smallest and largest finite value of several arrays between two indices. */
function extent(arrays, first, last) {
  let low = Infinity;
  let high = -Infinity;
  for (const values of arrays) {
    for (let i = first; i <= last; i++) {
      if (values[i] < low) low = values[i];
      if (values[i] > high) high = values[i];
    }
  }
  return low <= high ? [low, high] : [0, 1];
}

function readSeries(packed) {
  const measured = packed.measured.map((text) => unpack(text, Float32Array));
  return {
    time: unpack(packed.time, Float64Array),
    taps: packed.taps,
    noise: packed.noise,
    unit: packed.unit,
    scale: packed.scale,
    gap: packed.gap ?? [],
    segments: packed.segments,
    measured,
    models: packed.models.map((model) => {
      const taps = model.taps.map((text) => unpack(text, Float32Array));
      const residual = taps.map((values, k) => values.map((value, i) => measured[k][i] - value));
      return { name: model.name, taps, residual };
    }),
    commands: packed.commands.map((command) => ({
      name: command.name,
      values: unpack(command.values, Float32Array),
    })),
  };
}

/** Draws the series on the figure's canvas and answers to pointer, wheel and keys. */
function createViewer(figure, packed) {
  const data = readSeries(packed);
  const canvas = figure.querySelector("canvas");
  const output = figure.querySelector("output");
  const pen = canvas.getContext("2d");
  const whole = [data.time[0], data.time[data.time.length - 1]];
  const shortest = (4 * (whole[1] - whole[0])) / data.time.length;
  const shown = { tap: data.taps.map(() => true), model: data.models.map(() => true) };
  let [start, end] = whole;
  let width = 0;
  let cursor = null; // pixels from the left
  let drag = null; // { from, to, pan, start, end }
  let waiting = false;
  let logarithmic = true; // residual strips, beyond twice the sensor noise

  const plotWidth = () => width - MARGIN.left - MARGIN.right;
  const xOf = (t) => MARGIN.left + ((t - start) / (end - start)) * plotWidth();
  const timeAt = (x) => start + ((x - MARGIN.left) / plotWidth()) * (end - start);
  const offset = (event) => event.clientX - canvas.getBoundingClientRect().left;

  function show(from, to) {
    const span = Math.min(Math.max(to - from, shortest), whole[1] - whole[0]);
    const middle = (from + to) / 2;
    start = Math.min(Math.max(middle - span / 2, whole[0]), whole[1] - span);
    end = start + span;
    redraw();
  }

  function zoom(factor, about) {
    show(about - (about - start) * factor, about + (end - about) * factor);
  }

  function layout() {
    const taps = data.taps.map((_, k) => k).filter((k) => shown.tap[k]);
    const [tapHeight, residualHeight] = taps.length > 6 ? [80, 40] : [116, 56];
    const panels = [];
    let y = MARGIN.top;
    const add = (panel) => {
      panels.push({ ...panel, y: y + HEAD_PX });
      y += HEAD_PX + panel.height + GAP_PX;
    };
    for (const tap of taps) {
      add({ kind: "tap", tap, height: tapHeight });
      add({ kind: "residual", tap, height: residualHeight });
    }
    for (const command of data.commands) add({ kind: "command", command, height: 52 });
    return { panels, bottom: y - GAP_PX };
  }

  function readColours() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    return {
      ink: colour("ink"), soft: colour("soft"), rule: colour("rule"), band: colour("band"),
      noise: colour("noise"), paper: colour("paper"), measured: colour("measured"),
      models: [0, 1, 2, 3].map((i) => colour(`m${i}`)),
    };
  }

  function range(panel, first, last) {
    const models = data.models.filter((_, m) => shown.model[m]);
    const noise = data.noise[panel.tap] ?? 0;
    if (panel.kind === "residual") {
      const [low, high] = extent(models.map((model) => model.residual[panel.tap]), first, last);
      const most = Math.max(-low, high, 3 * noise, 1e-6) * (logarithmic ? 1.6 : 1.08);
      return [-most, most];
    }
    const arrays = panel.kind === "command"
      ? [panel.command.values]
      : [data.measured[panel.tap], ...models.map((model) => model.taps[panel.tap])];
    const [low, high] = extent(arrays, first, last);
    const pad = Math.max(0.07 * (high - low), 4 * noise, 1e-9 * Math.abs(high), 1e-12);
    return [low - pad, high + pad];
  }

  /** A line through the values there are; it breaks where none came for longer than `gap`. */
  function drawLine(values, first, last, yOf, colour, thickness, dash, gap = 0) {
    pen.beginPath();
    let before = -Infinity;
    let whole = true;
    for (let i = first; i <= last; i++) {
      const value = values[i];
      if (Number.isNaN(value)) {
        whole = false;
        continue;
      }
      const t = data.time[i];
      if (whole ? before > -Infinity : t - before <= gap) pen.lineTo(xOf(t), yOf(value));
      else pen.moveTo(xOf(t), yOf(value));
      before = t;
      whole = true;
    }
    pen.setLineDash(dash);
    pen.lineWidth = thickness;
    pen.strokeStyle = colour;
    pen.stroke();
    pen.setLineDash([]);
  }

  function drawPanel(panel, first, last, colours, xTicks) {
    const sensed = panel.kind !== "command";
    const scale = sensed ? data.scale[panel.tap] : 1; // pascals are shown as kPa
    const [low, high] = range(panel, first, last);
    const noise = data.noise[panel.tap];
    const bent = panel.kind === "residual" && logarithmic && noise > 0;
    const bend = bent ? (v) => Math.asinh(v / (2 * noise)) : (v) => v;
    const share = (v) => (bend(v) - bend(low)) / (bend(high) - bend(low));
    const yOf = (v) => panel.y + panel.height * (1 - share(v));
    const right = width - MARGIN.right;

    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, panel.y, plotWidth(), panel.height);
    pen.clip();
    data.segments.forEach(([from, to], i) => {
      if (i % 2) return;
      pen.fillStyle = colours.band;
      pen.fillRect(xOf(from), panel.y, xOf(to) - xOf(from), panel.height);
    });
    if (panel.kind === "residual" && noise) {
      pen.fillStyle = colours.noise;
      pen.fillRect(MARGIN.left, yOf(2 * noise), plotWidth(), yOf(-2 * noise) - yOf(2 * noise));
    }
    pen.strokeStyle = colours.rule;
    pen.lineWidth = 1;
    for (const tick of xTicks) {
      pen.strokeRect(Math.round(xOf(tick.at)) + 0.5, panel.y - 1, 0, panel.height + 2);
    }
    if (panel.kind === "command") {
      drawLine(panel.command.values, first, last, yOf, colours.measured, 1.3, []);
    } else {
      if (panel.kind === "tap") {
        drawLine(
          data.measured[panel.tap], first, last, yOf, colours.measured, 1.1, [], data.gap[panel.tap],
        );
      } else {
        drawLine([0, 0], 0, 1, () => yOf(0), colours.soft, 1, []);
      }
      data.models.forEach((model, m) => {
        if (!shown.model[m]) return;
        const values = (panel.kind === "tap" ? model.taps : model.residual)[panel.tap];
        const thickness = panel.kind === "tap" ? 1.7 : 1.1;
        // The dash tells lines apart where they are smooth; residuals are told apart by colour.
        const dash = panel.kind === "tap" ? DASHES[m % 4] : [];
        drawLine(
          values, first, last, yOf, colours.models[m % 4], thickness, dash, data.gap[panel.tap],
        );
      });
    }
    pen.restore();

    pen.strokeStyle = colours.rule;
    pen.lineWidth = 1;
    pen.strokeRect(MARGIN.left + 0.5, panel.y + 0.5, plotWidth() - 1, panel.height - 1);
    pen.fillStyle = colours.soft;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const count = panel.kind === "tap" ? 4 : 3;
    const ticks = bent ? decadeTicks(2 * noise * scale, high * scale)
      : niceTicks(low * scale, high * scale, count);
    const taken = [];
    for (const tick of ticks) {
      const y = yOf(tick.at / scale);
      const inside = y > panel.y + 4 && y < panel.y + panel.height - 4;
      if (inside && taken.every((other) => Math.abs(other - y) >= 11)) {
        taken.push(y);
        pen.fillText(tick.label, MARGIN.left - 7, y);
        pen.fillRect(MARGIN.left - 4, Math.round(y), 4, 1);
      }
    }
    const label = panel.kind === "tap" ? `${data.taps[panel.tap]}, ${data.unit[panel.tap]}`
      : panel.kind === "residual" ? `measured − model, ${data.unit[panel.tap]}` : `${panel.command.name}, V`;
    pen.textAlign = "left";
    pen.font = (panel.kind === "residual" ? "11px " : "600 12px ") + fontFamily;
    pen.fillStyle = panel.kind === "residual" ? colours.soft : colours.ink;
    pen.fillText(label, MARGIN.left, panel.y - 8);
    pen.font = "12px " + fontFamily;
    if (cursor !== null) drawReadout(panel, right, scale, colours);
  }

  const fontFamily = getComputedStyle(document.body).fontFamily;

  /** The reading of a tap that is nearest to a time, from an index at about that time. */
  function nearest(values, i, t) {
    let [left, right] = [i, i];
    while (left > 0 && Number.isNaN(values[left])) left -= 1;
    while (right < values.length - 1 && Number.isNaN(values[right])) right += 1;
    if (Number.isNaN(values[left])) return right;
    if (Number.isNaN(values[right])) return left;
    return t - data.time[left] < data.time[right] - t ? left : right;
  }

  /** Values under the pointer, right-aligned above the frame. */
  function drawReadout(panel, right, scale, colours) {
    const t = timeAt(cursor);
    let i = Math.min(lowerBound(data.time, t), data.time.length - 1);
    if (i > 0 && t - data.time[i - 1] < data.time[i] - t) i -= 1;
    if (panel.kind !== "command") i = nearest(data.measured[panel.tap], i, t);
    const entries = [];
    if (panel.kind === "command") {
      entries.push([panel.command.values[i], colours.measured]);
    } else {
      if (panel.kind === "tap") entries.push([data.measured[panel.tap][i], colours.measured]);
      data.models.forEach((model, m) => {
        if (!shown.model[m]) return;
        const values = (panel.kind === "tap" ? model.taps : model.residual)[panel.tap];
        entries.push([values[i], colours.models[m % 4]]);
      });
    }
    pen.textAlign = "right";
    let x = right;
    for (const [value, colour] of entries.reverse()) {
      const digits = panel.kind === "residual" ? 3 : 2;
      const text = Number.isNaN(value) ? "–" : (value * scale).toFixed(digits).replace("-", "−");
      pen.fillStyle = colour;
      pen.fillText(text, x, panel.y - 8);
      x -= pen.measureText(text).width + 14;
    }
  }

  function draw() {
    waiting = false;
    const { panels, bottom } = layout();
    const height = bottom + MARGIN.bottom;
    const printing = document.documentElement.classList.contains("printing");
    const sharpness = Math.max(window.devicePixelRatio || 1, printing ? 2 : 1);
    width = canvas.parentElement.clientWidth;
    canvas.style.height = `${height}px`;
    canvas.width = Math.round(width * sharpness);
    canvas.height = Math.round(height * sharpness);
    pen.setTransform(sharpness, 0, 0, sharpness, 0, 0);
    pen.font = "12px " + fontFamily;
    const colours = readColours();
    const first = Math.max(lowerBound(data.time, start) - 1, 0);
    const last = Math.min(lowerBound(data.time, end) + 1, data.time.length - 1);
    const xTicks = niceTicks(start, end, width / 110);
    for (const panel of panels) drawPanel(panel, first, last, colours, xTicks);

    pen.fillStyle = colours.soft;
    pen.textBaseline = "top";
    for (const tick of xTicks) {
      pen.textAlign = xOf(tick.at) > width - 34 ? "right" : "center";
      pen.fillText(`${tick.label} s`, xOf(tick.at), bottom + 8);
    }
    if (cursor !== null && cursor >= MARGIN.left && cursor <= width - MARGIN.right) {
      pen.fillStyle = colours.soft;
      pen.fillRect(Math.round(cursor), MARGIN.top, 1, bottom - MARGIN.top);
    }
    if (drag && !drag.pan) {
      pen.globalAlpha = 0.18;
      pen.fillStyle = colours.models[0];
      const left = Math.min(drag.from, drag.to);
      pen.fillRect(left, MARGIN.top, Math.abs(drag.to - drag.from), bottom - MARGIN.top);
      pen.globalAlpha = 1;
    }
    output.value = `${start.toFixed(3)} s to ${end.toFixed(3)} s`
      + (cursor === null ? "" : `, pointer at ${timeAt(cursor).toFixed(4)} s`);
  }

  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(draw);
  }

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 1 || event.pointerType === "touch") return;
    const x = offset(event);
    drag = { from: x, to: x, pan: event.shiftKey || event.button === 1, start, end };
    canvas.focus({ preventScroll: true });
  });
  addEventListener("pointermove", (event) => {
    if (!drag) return;
    drag.to = offset(event);
    if (drag.pan) {
      const shift = ((drag.from - drag.to) / plotWidth()) * (drag.end - drag.start);
      show(drag.start + shift, drag.end + shift);
    }
    redraw();
  });
  addEventListener("pointerup", () => {
    if (!drag) return;
    const { from, to, pan } = drag;
    drag = null;
    if (!pan && Math.abs(to - from) > 5) show(timeAt(Math.min(from, to)), timeAt(Math.max(from, to)));
    redraw();
  });
  addEventListener("pointercancel", () => { drag = null; redraw(); });
  canvas.addEventListener("pointermove", (event) => { cursor = offset(event); redraw(); });
  canvas.addEventListener("pointerleave", () => { cursor = null; redraw(); });
  canvas.addEventListener("dblclick", () => show(...whole));
  canvas.addEventListener("wheel", (event) => {
    // A wheel that just passes over the plot scrolls the page.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      const shift = (event.deltaX / plotWidth()) * (end - start);
      show(start + shift, end + shift);
    } else {
      zoom(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * 0.002))), timeAt(offset(event)));
    }
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = (end - start) / 5;
    const middle = (start + end) / 2;
    const actions = {
      ArrowLeft: () => show(start - step, end - step),
      ArrowRight: () => show(start + step, end + step),
      "+": () => zoom(0.7, middle),
      "=": () => zoom(0.7, middle),
      "-": () => zoom(1 / 0.7, middle),
      0: () => show(...whole),
      Escape: () => show(...whole),
    };
    if (!Object.hasOwn(actions, event.key) || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    actions[event.key]();
  });
  figure.addEventListener("change", (event) => {
    const { kind, index } = event.target.dataset;
    if (kind === "logarithmic") logarithmic = event.target.checked;
    else shown[kind][Number(index)] = event.target.checked;
    redraw();
  });

  draw();
  return { show, showAll: () => show(...whole), draw };
}
