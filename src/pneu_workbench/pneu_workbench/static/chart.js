// SPDX-License-Identifier: Apache-2.0
// Measured and model of every sensor, what is left of it, and the commands: one range for all.
import uPlot from "uplot";

const MEASURED = { light: "#1a1a1a", dark: "#e8e8e8" };
const MODEL = { light: "#b3261e", dark: "#ff8a80" };
const BESIDE = { light: "#6b6b6b", dark: "#a8a8a8" };
const LEFT = { light: "#1f5fa8", dark: "#8ab4f8" };
const FORETOLD = { light: "#9a5b00", dark: "#ffca6b" };
const ASIDE = { light: "#e9eef6", dark: "#232b38" };
const MARKED = { light: "#f6cfa0", dark: "#6b4a16" };
const GRID = { light: "#d7d7d7", dark: "#3c4043" };
const WORDS = { light: "#333333", dark: "#d0d0d0" };

export default {
  template: `
    <div class="pneu-chart" tabindex="0" role="group" :aria-label="label" @keydown="key">
      <div ref="plots"></div>
    </div>`,
  props: {
    sensors: Array, commands: Array, span: Array, token: String, candidate: Number, beside: Boolean, trial: Boolean,
    regime: Array, marks: Array, aside: Array, route: String,
  },
  data() {
    return { label: "Signals" };
  },
  mounted() {
    this.sequence = 0;
    this.range = this.span.slice();
    // light or dark is the browser's word, or the reader's: the page's body tells
    this.shade = new MutationObserver(() => {
      if (this.isDark() !== this.dark) this.build();
    });
    this.shade.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.build();
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.$el);
  },
  beforeUnmount() {
    this.observer.disconnect();
    this.shade.disconnect();
    this.plots.forEach((plot) => plot.destroy());
  },
  watch: {
    candidate() {
      this.build();
    },
    beside() {
      this.build();
    },
    regime() {
      this.show(...this.range);
    },
    marks() {
      this.build();
    },
    aside() {
      this.plots.forEach((plot) => plot.redraw());
    },
    trial() {
      this.build();
    },
    token() {
      this.show(...this.range);
    },
    span(now, before) {
      // what comes in is followed, unless somebody looks at an earlier part
      const near = 1e-3 * (before[1] - before[0]);
      const all = this.range[0] <= before[0] + near && this.range[1] >= before[1] - near;
      this.show(...(all ? now : this.range));
    },
  },
  methods: {
    isDark() {
      return document.body.classList.contains("body--dark");
    },
    build() {
      this.dark = this.isDark();
      (this.plots || []).forEach((plot) => plot.destroy());
      this.plots = [];
      const of = (colours) => colours[this.dark ? "dark" : "light"];
      const width = Math.max(this.$el.clientWidth, 200);
      const axis = (label, size) => ({
        label, size: 58, labelSize: 14, font: "11px sans-serif", labelFont: "11px sans-serif",
        stroke: of(WORDS), grid: { stroke: of(GRID), width: 1 }, ticks: { stroke: of(GRID), width: 1 },
        space: size,
      });
      // what is kept aside, and what was found while the recording was read, lie behind the lines
      const bands = (u, channel) => {
        const fill = (begin, end, colour) => {
          const left = Math.max(u.valToPos(begin, "x", true), u.bbox.left);
          const right = Math.min(u.valToPos(end, "x", true), u.bbox.left + u.bbox.width);
          if (right < u.bbox.left || left > u.bbox.left + u.bbox.width) return;
          u.ctx.fillStyle = of(colour);
          u.ctx.fillRect(left, u.bbox.top, Math.max(right - left, 2), u.bbox.height);
        };
        this.aside.forEach(([begin, end]) => fill(begin, end, ASIDE));
        this.marks.filter((m) => m[2] === channel).forEach(([begin, end]) => fill(begin, end, MARKED));
      };
      const found = (channel) => [...new Set(this.marks.filter((m) => m[2] === channel).map((m) => m[3]))].join(", ");
      const plot = (name, title, height, y, series) => {
        const made = new uPlot(
          {
            width, height, title,
            scales: {
              x: { time: false, auto: false },
              // where there is nothing, as before the model has run, there is a range all the same
              y: { range: (u, least, most) => (least === null ? [-1, 1] : uPlot.rangeNum(least, most, 0.1, true)) },
            },
            legend: { show: false },
            cursor: { sync: { key: "pneu" }, drag: { x: true, y: false, setScale: false } },
            axes: [{ ...axis("", 60), label: undefined, size: 24 }, axis(y, 28)],
            hooks: { setSelect: [(u) => this.selected(u)], drawClear: [(u) => bands(u, name)] },
            series: [{}, ...series],
          },
          [[], ...series.map(() => [])],
          this.$refs.plots,
        );
        made.root.setAttribute("role", "img");
        made.root.setAttribute("aria-label", title);
        this.plots.push(made);
      };
      const line = (label, colours, width) => ({
        label, stroke: of(colours), width, points: { show: false }, spanGaps: false,
      });
      for (const sensor of this.sensors) {
        const amiss = found(sensor.name);
        plot(sensor.name, `${sensor.name}: measured and model${amiss ? ` (marked: ${amiss})` : ""}`, 150, sensor.shown, [
          line("measured", MEASURED, 1.6),
          line("model", MODEL, 1.2),
          ...(this.beside ? [{ ...line("model beside", BESIDE, 1), dash: [6, 4] }] : []),
          ...(this.trial ? [line("model at the strength tried", FORETOLD, 1.4)] : []),
        ]);
        const left = [line("measured minus model", LEFT, 1)];
        if (this.beside) left.push({ ...line("measured minus the model beside", BESIDE, 1), dash: [6, 4] });
        if (this.candidate >= 0) left.push(line("what it would explain", FORETOLD, 1.6));
        plot(sensor.name, `${sensor.name}: what is left, in noise`, 90, "noise", left);
      }
      for (const name of this.commands) plot(name, `command ${name}${found(name) ? ` (marked: ${found(name)})` : ""}`, 90, "V", [line(name, MEASURED, 1.2)]);
      this.show(...this.range);
    },
    resize() {
      const width = Math.max(this.$el.clientWidth, 200);
      if (this.plots.length && this.plots[0].width !== width) {
        this.plots.forEach((plot) => plot.setSize({ width, height: plot.height }));
        this.show(...this.range);
      }
    },
    selected(u) {
      if (u.select.width > 3) {
        const begin = u.posToVal(u.select.left, "x");
        this.show(begin, u.posToVal(u.select.left + u.select.width, "x"));
      }
      u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    },
    key(event) {
      const [begin, end] = this.range;
      const wide = end - begin;
      const moves = {
        ArrowLeft: () => this.show(begin - 0.2 * wide, end - 0.2 * wide),
        ArrowRight: () => this.show(begin + 0.2 * wide, end + 0.2 * wide),
        "+": () => this.zoom(0.5),
        "=": () => this.zoom(0.5),
        "-": () => this.zoom(2),
        Home: () => this.show(...this.span),
      };
      if (event.key in moves) {
        event.preventDefault();
        moves[event.key]();
      }
    },
    zoom(by) {
      const [begin, end] = this.range;
      const middle = 0.5 * (begin + end);
      this.show(middle - 0.5 * by * (end - begin), middle + 0.5 * by * (end - begin));
    },
    whole() {
      this.show(...this.span);
    },
    async show(begin, end) {
      const [first, last] = this.span;
      const wide = Math.min(Math.max(end - begin, 1e-3), last - first);
      begin = Math.min(Math.max(begin, first), last - wide);
      end = begin + wide;
      this.range = [begin, end];
      const own = ++this.sequence;
      const started = performance.now();
      if (this.asked) this.asked.abort();
      this.asked = new AbortController();
      const columns = Math.min(Math.round(this.$el.clientWidth * (window.devicePixelRatio || 1)), 4000);
      const query = new URLSearchParams({ begin, end, columns, candidate: this.candidate, beside: this.beside, trial: this.trial });
      this.regime.forEach((word) => query.append("regime", word));
      let buffer;
      try {
        const answer = await fetch(`${this.route}?${query}`, { signal: this.asked.signal });
        if (answer.status !== 200) return; // 204: what was asked for is no longer there
        buffer = await answer.arrayBuffer();
      } catch {
        return; // a later range was asked for, or the server is gone
      }
      if (own !== this.sequence) return;
      this.paint(buffer, begin, end);
      this.label = `Signals from ${begin.toFixed(3)} to ${end.toFixed(3)} seconds. Arrow keys move, plus and minus zoom, Home shows all.`;
      this.took = performance.now() - started;
      this.$el.dataset.shown = String(own);
      this.$el.dataset.took = this.took.toFixed(1);
      this.$emit("range", { begin, end });
    },
    paint(buffer, begin, end) {
      const head = new DataView(buffer);
      const parts = [];
      let at = 4;
      for (let k = head.getUint32(0, true); k > 0; k--) {
        const n = head.getUint32(at, true);
        const time = new Float32Array(buffer.slice(at + 4, at + 4 + 4 * n));
        const values = new Float32Array(buffer.slice(at + 4 + 4 * n, at + 4 + 8 * n));
        parts.push([Float64Array.from(time, (t) => t + begin), Array.from(values, (v) => (Number.isNaN(v) ? null : v))]);
        at += 4 + 8 * n;
      }
      const next = () => parts.shift();
      const put = (plot, data) =>
        plot.batch(() => {
          plot.setData(data, false);
          plot.setScale("x", { min: begin, max: end });
        });
      let p = 0;
      for (const sensor of this.sensors) {
        const measured = next();
        const model = next();
        const scaled = (of) => of.map((v) => (v === null ? null : v * sensor.scale));
        const lines = [measured[0], scaled(measured[1]), scaled(model[1])];
        const others = [this.beside, this.trial].filter(Boolean).map(next);
        const joined = others.map((of) => [of[0], scaled(of[1])]);
        put(this.plots[p++], joined.length ? uPlot.join([lines, ...joined]) : lines);
        const left = [next(), ...[this.beside, this.candidate >= 0].filter(Boolean).map(next)];
        put(this.plots[p++], left.length > 1 ? uPlot.join(left) : left[0]);
      }
      for (let c = 0; c < this.commands.length; c++) put(this.plots[p++], next());
    },
  },
};
