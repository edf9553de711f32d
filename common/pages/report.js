// Time plots of a report: drag or keys zoom, all plots of one clock zoom together; without this script the pictures stay.
(() => {
  "use strict";
  const LEFT = 62, RIGHT = 10, TOP = 6, BOTTOM = 34, NS = "http://www.w3.org/2000/svg", clocks = {};
  const HELP = "Drag to zoom in, double-click for the whole run. Keys on a plot: + and − zoom, ← and → move the line " +
    "that reads values (with Shift the window), 0 shows the whole run.";
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
  const times = ({ first, unit, steps }, sum = 0) =>
    [first, ...Array.from(new Uint16Array(bytes(steps)), step => first + unit * (sum += step))];
  const digits = value => Number.isFinite(value) ? String(Number(value.toPrecision(5))).replaceAll("-", "−") : "none";
  function set(element, attributes) {
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    return element;
  }
  function make(name, attributes, parent, text = "") {
    const drawn = parent instanceof SVGElement || name === "svg";
    const element = drawn ? document.createElementNS(NS, name) : document.createElement(name);
    element.textContent = text;
    parent.append(element);
    return set(element, attributes);
  }
  function place(x, time) { // the first sample at or after a time
    let low = 0, high = x.length;
    while (low < high) { const mid = (low + high) >> 1; if (x[mid] < time) low = mid + 1; else high = mid; }
    return low;
  }
  function ticks(low, high, most) {
    const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find(factor => factor * power >= raw * (1 - 1e-9)), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return found;
  }

  class Panel {
    constructor(data, clock, box, wide) {
      Object.assign(this, data, { clock, height: wide ? 210 : 170, id: `clip${clock.name}${clock.panels.length}` });
      for (const item of this.items.flatMap(item => [item, item.fine])) if (item?.x) {
        item.x = times(item.x);
        for (const key of ["y", "high"]) if (item[key]) item[key] = new Float32Array(bytes(item[key]));
      }
      const panel = make("div", { class: "panel" }, box), head = make("div", { class: "head" }, panel);
      make("b", {}, head, [this.title, this.y].filter(Boolean).join(": "));
      this.read = make("span", {}, head, this.note);
      this.svg = make("svg", { tabindex: 0, role: "img", "aria-label": `${this.title || this.y} ${this.note}. ${HELP}` }, panel);
      this.listen();
      clock.panels.push(this);
    }
    range() { // of the vertical axis: as in the picture while its part or the whole run is shown, else of what is in view
      const [first, last] = this.clock.view, near = (a, b) => Math.abs(a - b) < 1e-6 * (last - first);
      const shown = part => part && near(part[0], first) && near(part[1], last);
      if (this.limits && (shown(this.clock.home) || shown(this.part))) return this.limits;
      let low = Infinity, high = -Infinity;
      for (const { x, y, high: upper } of this.used) if (x && !upper) {
        for (let k = Math.max(0, place(x, first) - 1), end = Math.min(x.length - 1, place(x, last)); k <= end; k++) {
          if (Number.isFinite(y[k])) { low = Math.min(low, y[k]); high = Math.max(high, y[k]); }
        }
      }
      if (low > high) return this.limits || [0, 1];
      const margin = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
      return [low - margin, high + margin];
    }
    draw() {
      const width = this.svg.parentNode.clientWidth, { svg, height, part } = this, [first, last] = this.clock.view;
      const inside = part && first > part[0] - 1e-6 && last < part[1] + 1e-6; // finer data are there of this part only
      this.used = this.items.map(item => inside ? { ...item, ...item.fine } : item);
      const [low, high] = this.range(), right = width - RIGHT, bottom = height - BOTTOM;
      this.toX = t => LEFT + (t - first) / (last - first) * (right - LEFT);
      this.toTime = x => first + (Math.min(right, Math.max(LEFT, x)) - LEFT) / (right - LEFT) * (last - first);
      const toY = v => Math.max(-1e4, Math.min(1e4, bottom - (v - low) / (high - low) * (bottom - TOP)));
      svg.replaceChildren();
      set(svg, { width, height });
      make("rect", { x: LEFT, y: TOP, width: right - LEFT, height: bottom - TOP }, make("clipPath", { id: this.id }, svg));
      const xs = ticks(first, last, width / 90), ys = ticks(low, high, 5);
      const text = (values, value) => {
        const most = Math.max(...values.map(Math.abs)), step = values.length > 1 ? values[1] - values[0] : most || 1;
        const left = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
        return most >= 1e5 || left > 5 ? digits(value) : value.toFixed(left).replace("-", "−");
      };
      for (const t of xs) {
        make("path", { d: `M${this.toX(t)} ${TOP}V${bottom}`, class: "grid" }, svg);
        make("text", { x: this.toX(t), y: bottom + 14, "text-anchor": "middle" }, svg, text(xs, t));
      }
      for (const v of ys) {
        make("path", { d: `M${LEFT} ${toY(v)}H${right}`, class: "grid" }, svg);
        make("text", { x: LEFT - 5, y: toY(v) + 4, "text-anchor": "end" }, svg, text(ys, v));
      }
      make("text", { x: (LEFT + right) / 2, y: height - 5, "text-anchor": "middle" }, svg, "time, s");
      make("path", { d: `M${LEFT} ${TOP}V${bottom}H${right}`, class: "axis" }, svg);
      const area = make("g", { "clip-path": `url(#${this.id})`, fill: "none" }, svg);
      for (const item of this.used) this.item(area, item, first, last, toY, bottom);
      this.line = make("line", { y1: TOP, y2: bottom, class: "cursor", visibility: "hidden" }, svg);
      this.brush = make("rect", { y: TOP, height: bottom - TOP, class: "brush", visibility: "hidden" }, svg);
    }
    item(area, item, first, last, toY, bottom) {
      const { x, y, high, colour } = item;
      if ("at" in item) {
        make("path", { d: `M${this.toX(item.at)} ${TOP}V${bottom}`, stroke: colour, "stroke-dasharray": "1 2" }, area);
      } else if ("level" in item) {
        make("path", { d: `M${LEFT} ${toY(item.level)}h9999`, stroke: colour, "stroke-dasharray": item.dashes.join(" ") }, area);
      } else if ("from" in item) {
        const d = `M${this.toX(item.from)} ${TOP}V${bottom}H${this.toX(item.to)}V${TOP}Z`;
        make("path", { d, fill: colour, opacity: item.alpha }, area);
      } else {
        const begin = Math.max(0, place(x, first) - 1), end = Math.min(x.length, place(x, last) + 1);
        const point = (k, values) => `${this.toX(x[k]).toFixed(1)} ${toY(values[k]).toFixed(1)}`;
        let path = "", run = [];
        const close = () => {
          if (run.length) path += "M" + run.map(k => point(k, y)).join("L");
          if (run.length && high) path += "L" + run.reverse().map(k => point(k, high)).join("L") + "Z";
          run = [];
        };
        for (let k = begin; k <= end; k++) if (k < end && Number.isFinite(y[k])) run.push(k); else close();
        if (high) return make("path", { d: path, fill: colour, opacity: item.alpha }, area);
        make("path", { d: path, stroke: colour, "stroke-width": 1.2 * item.width, "stroke-dasharray": item.dashes.join(" ") }, area);
      }
    }
    point(time) { // put the line that reads values at a time, or take it away
      const at = this.toX(time ?? this.clock.view[0]);
      set(this.line, { visibility: time === null ? "hidden" : "visible", x1: at, x2: at });
      this.read.textContent = this.note;
      if (time === null) return;
      this.read.replaceChildren(`${digits(time)} s`);
      for (const { x, y, high, colour, label } of this.used) if (x && !high) {
        const k = place(x, time), near = k > 0 && (k === x.length || time - x[k - 1] < x[k] - time) ? k - 1 : k;
        if (Number.isFinite(y[near])) make("i", { style: `color:${colour}` }, this.read, `${this.svg.clientWidth > 500 ? label : ""} ${digits(y[near])}`);
      }
    }
    listen() {
      const { svg, clock } = this, at = event => event.clientX - svg.getBoundingClientRect().left;
      let from = null;
      svg.addEventListener("pointerdown", event => {
        if (event.button === 0) { from = at(event); svg.setPointerCapture(event.pointerId); }
      });
      svg.addEventListener("pointermove", event => {
        clock.point(this.toTime(at(event)));
        if (from === null) return;
        const [a, b] = [from, at(event)].sort((p, q) => p - q).map(p => this.toX(this.toTime(p)));
        set(this.brush, { x: a, width: b - a, visibility: "visible" });
      });
      svg.addEventListener("pointerup", event => {
        const to = at(event), begin = from;
        from = null;
        set(this.brush, { visibility: "hidden" });
        if (begin !== null && Math.abs(to - begin) > 6) clock.show(...[begin, to].sort((p, q) => p - q).map(this.toTime));
      });
      svg.addEventListener("pointercancel", () => { from = null; set(this.brush, { visibility: "hidden" }); });
      svg.addEventListener("pointerleave", () => clock.point(null));
      svg.addEventListener("dblclick", () => clock.show(...clock.home));
      svg.addEventListener("focus", () => this.read.setAttribute("aria-live", "polite"));
      svg.addEventListener("blur", () => { this.read.removeAttribute("aria-live"); clock.point(null); });
      svg.addEventListener("keydown", event => { if (!event.ctrlKey && !event.metaKey && clock.key(event)) event.preventDefault(); });
    }
  }
  class Clock {
    constructor(name) { Object.assign(this, { name, panels: [], cursor: null }); }
    begin() {
      const ends = this.panels.flatMap(panel => panel.items).flatMap(({ x }) => x ? [x[0], x[x.length - 1]] : []);
      this.show(...this.home = [Math.min(...ends), Math.max(...ends)]);
    }
    show(first, last) {
      const least = (this.home[1] - this.home[0]) * 1e-5, size = Math.min(Math.max(last - first, least), this.home[1] - this.home[0]);
      first = Math.min(Math.max(first, this.home[0]), this.home[1] - size);
      this.view = [first, first + size];
      for (const panel of this.panels) panel.draw();
    }
    point(time) { this.cursor = time; for (const panel of this.panels) panel.point(time); }
    key({ key, shiftKey }) {
      const [first, last] = this.view, size = last - first, middle = this.cursor ?? (first + last) / 2;
      const factor = { "+": 0.5, "=": 0.5, "-": 2, "−": 2 }[key], way = { ArrowLeft: -1, ArrowRight: 1 }[key];
      if (factor) this.show(middle - factor * (middle - first), middle + factor * (last - middle));
      else if (key === "0" || key === "Escape") this.show(...this.home);
      else if (way && shiftKey) this.show(first + 0.2 * way * size, last + 0.2 * way * size);
      else if (!way) return false;
      const moved = way && !shiftKey ? middle + 0.01 * way * size : middle;
      this.point(Math.min(Math.max(moved, this.view[0]), this.view[1]));
      return true;
    }
  }

  for (const script of document.querySelectorAll("script.plot")) {
    const data = JSON.parse(script.textContent), figure = script.parentNode, image = figure.querySelector("img");
    const clock = clocks[data.clock] ||= new Clock(Object.keys(clocks).length + "-");
    const box = document.createElement("div"), bar = make("div", { class: "tools" }, box);
    const button = (text, action) => { make("button", { type: "button" }, bar, text).onclick = action; };
    button("Whole run", () => clock.show(...clock.home));
    const part = data.panels.map(panel => panel.part).find(Boolean), labels = new Map();
    if (part) button(`${digits(part[0])} to ${digits(part[1])} s`, () => clock.show(...part));
    for (const { label, colour } of data.panels.flatMap(panel => panel.items)) if (label && !labels.has(label)) labels.set(label, colour);
    for (const [label, colour] of labels) make("span", { style: `border-color:${colour}` }, bar, label);
    make("small", {}, bar, "drag: zoom, double-click: whole run");
    bar.title = HELP;
    const panels = make("div", { class: data.columns > 1 ? "panels many" : "panels", role: "group", "aria-label": image.alt }, box);
    image.after(box);
    figure.classList.add("live");
    for (const panel of data.panels) new Panel(panel, clock, panels, data.columns === 1);
  }
  for (const clock of Object.values(clocks)) clock.begin();
  addEventListener("resize", () => Object.values(clocks).forEach(clock => clock.show(...clock.view)));
})();
