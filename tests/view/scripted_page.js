// Before the page's own code: stands in for what it hears and asks, for its clocks and its 2D contexts, which draw SVG.
// Everything else is the browser's. `play(lines)` gives the page what a process sends, {"name", "data"} a line, and returns
// what the page drew, as SVG by canvas, what stands in it, what it asked for, and errors. {"wait": seconds} lets time pass,
// {"sleep": seconds} with nothing done meanwhile; "to" is the number of the stream that an event comes by (default: the
// newest), {"event": "error" | "open", "stream": state} is what becomes of the newest stream, {"refuse": status} what
// becomes of what is asked for next; {"event", "name", "data"} is an event at an element; {"note": name} keeps what stands
// in the page then.
(([width, height]) => {
  const sizes = { plan: [width, Math.round(0.68 * height)], side: [width, Math.round(0.32 * height)], flow: [112, 112], camera: [320, 240] };
  const errors = [], requests = [], streams = [], frames = [], intervals = [], notes = {};
  const clock = { ms: 1000 };
  let refused = 0;

  const escape = (words) => String(words).replace(/[&<>"]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[sign]);
  const number = (...values) => {
    for (const value of values) if (!Number.isFinite(value)) throw new Error(`drawn at ${value}`);
    return values.map((value) => value.toFixed(1)).join(" ");
  };

  class Context {
    constructor(canvas) { this.canvas = canvas; this.clear(); }
    clear() { Object.assign(this, { out: [], points: [], dash: [], clips: 0, open: 0, saved: [], globalAlpha: 1 }); }
    setTransform() { this.clear(); }
    beginPath() { this.points = []; }
    moveTo(x, y) { this.points.push(`M${number(x, y)}`); }
    lineTo(x, y) { this.points.push(`L${number(x, y)}`); }
    closePath() { this.points.push("Z"); }
    arc(x, y, r) { this.points.push(`M${number(x - r, y)}a${number(r, r)} 0 1 1 ${number(2 * r, 0)}a${number(r, r)} 0 1 1 ${number(-2 * r, 0)}`); }
    fill() { this.out.push(`<path d="${this.points.join("")}" fill="${this.fillStyle}"/>`); }
    setLineDash(dash) { this.dash = dash; }
    stroke() { this.out.push(`<path d="${this.points.join("")}" fill="none" stroke="${this.strokeStyle}" stroke-width="${number(this.lineWidth)}" stroke-dasharray="${this.dash.join(" ")}"/>`); }
    fillRect(x, y, w, h) { this.out.push(`<path d="M${number(x, y)}h${number(w)}v${number(h)}h${number(-w)}z" fill="${this.fillStyle}"/>`); }
    fillText(words, x, y) {
      const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
      this.out.push(`<text x="${number(x)}" y="${number(y + 4)}" font-family="sans-serif" font-size="12" fill="${this.fillStyle}" text-anchor="${anchor}">${escape(words)}</text>`);
    }
    save() { this.saved.push(this.open); this.open = 0; }
    clip() {
      const name = `${this.canvas.id}${++this.clips}`;
      this.out.push(`<clipPath id="${name}"><path d="${this.points.join("")}"/></clipPath><g clip-path="url(#${name})">`);
      this.open += 1;
    }
    restore() { this.out.push("</g>".repeat(this.open)); this.open = this.saved.pop(); }
    drawImage(image, x, y, w, h) { this.out.push(`<image href="${image.src}" x="${number(x)}" y="${number(y)}" width="${number(w)}" height="${number(h)}" opacity="${this.globalAlpha}"/>`); }
  }

  const canvases = new Map(), canvas = HTMLCanvasElement.prototype;
  canvas.getContext = function () {
    if (!canvases.has(this.id)) canvases.set(this.id, new Context(this));
    return canvases.get(this.id);
  };
  canvas.getBoundingClientRect = function () { return { left: 0, top: 0, width: this.clientWidth, height: this.clientHeight }; };
  for (const [axis, name] of ["clientWidth", "clientHeight"].entries()) Object.defineProperty(canvas, name, { get() { return (sizes[this.id] ?? [100, 100])[axis]; } });
  Element.prototype.setPointerCapture = () => {}; // no pointer of the browser's

  const find = document.querySelector.bind(document);
  document.querySelector = (name) => (name.startsWith("meta") ? { content: name.includes("token") ? "token" : "" } : find(name));
  window.requestAnimationFrame = (work) => frames.push(work);
  window.setInterval = (work) => intervals.push(work);
  performance.now = () => clock.ms;
  Date.now = () => clock.ms;
  window.fetch = async (url, options) => {
    requests.push({ url, ...JSON.parse(options.body), ...(options.headers["X-View-Token"] === "token" ? {} : { token: options.headers["X-View-Token"] }) });
    const status = refused || 200;
    refused = 0;
    return { ok: status === 200, status, json: async () => (status === 200 ? { done: "done" } : { error: "refused" }) };
  };
  window.Image = class { set src(value) { this.source = value; this.onload(); } get src() { return this.source; } };
  window.EventSource = class {
    constructor(url) { this.url = url; this.listeners = {}; this.readyState = 1; streams.push(this); }
    addEventListener(name, work) { this.listeners[name] = work; }
    close() {}
  };

  const tried = (work) => { try { work(); } catch (error) { errors.push(error.stack); } };
  const turn = () => new Promise((done) => { const { port1, port2 } = new MessageChannel(); port1.onmessage = done; port2.postMessage(0); });
  const wordsOf = (one) => (one.nodeType === Node.TEXT_NODE ? one.data : [...one.childNodes].map(wordsOf).join(" "));
  const all = () => [...document.querySelectorAll("[id]")];
  const drawn = (id) => (canvases.has(id) ? canvases.get(id).out.join("") : "");
  const words = () => Object.fromEntries(all().map((one) => [one.id, wordsOf(one)]));
  const stale = () => all().filter((one) => one.classList.contains("stale")).map(({ id }) => id);
  const shown = () => ({ words: words(), stale: stale(), camera: drawn("camera"), plan: drawn("plan"), rows: document.querySelectorAll("#state dd.stale").length });
  const list = (id) => [...document.getElementById(id).children].map(wordsOf);
  const bar = (row) => {
    const [, track] = row.children, [rod] = track.children;
    return { words: [...row.children].map(wordsOf), rod: { left: rod.style.left, width: rod.style.width } };
  };

  window.play = async (lines) => {
    for (const { name, data, event, wait, sleep, to, refuse, note, stream } of lines) {
      if (wait) { clock.ms += 1e3 * wait; for (const work of intervals) tried(work); }
      else if (sleep) clock.ms += 1e3 * sleep;
      else if (refuse) refused = refuse;
      else if (stream !== undefined) { streams.at(-1).readyState = stream; tried(() => (event === "error" ? streams.at(-1).onerror() : streams.at(-1).listeners[event]({}))); }
      else if (event) {
        const kind = event.startsWith("key") ? KeyboardEvent : event === "wheel" ? WheelEvent : PointerEvent;
        document.getElementById(name).dispatchEvent(new kind(event, { bubbles: true, cancelable: true, ...data }));
      } else if (!note) tried(() => streams.at(to ?? -1).listeners[name]({ data: JSON.stringify(data) }));
      await turn();
      for (const work of frames.splice(0)) tried(work);
      if (note) notes[note] = shown();
    }
    const svg = Object.fromEntries(Object.keys(sizes).map((id) => [id, drawn(id)]));
    const hidden = all().filter((one) => one.hidden).map(({ id }) => id);
    const bars = [...document.querySelectorAll("#bars .bar, #thrusters .bar")].map(bar);
    return { errors, requests, notes, stale: stale(), streams: streams.map((one) => one.url), svg, words: words(), hidden, state: list("state"), messages: list("messages"), bars };
  };
})(@SIZE@);
