// Runs the live view's page without a browser: node docs/view_page.mjs WIDTH HEIGHT light|dark [calm] < events.jsonl
// Events are what the process sends, one {"name", "data"} a line. Printed is JSON: what the page drew, as SVG by canvas,
// what stands in it, what it asked for, and errors. {"wait": seconds} lets time pass, {"sleep": seconds}
// with nothing done meanwhile; "to" is the number of the stream that an event comes by (default: the newest), {"event": "error" | "open", "stream": state}
// is what becomes of the newest stream, {"refuse": status} what becomes of what is asked for next; {"note": name} keeps what stands
// in the page then. tests/view uses it, and docs/view_picture.py for the figure.
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";

const [width, height] = process.argv.slice(2, 4).map(Number);
const dark = process.argv[4] === "dark";
const sizes = { plan: [width, Math.round(0.68 * height)], side: [width, Math.round(0.32 * height)], flow: [112, 112], camera: [320, 240] };
const errors = [], requests = [], streams = [], frames = [], intervals = [], notes = {};
const clock = { ms: 1000 };
let refused = 0, reloads = 0;

class Context {
  constructor(canvas) { this.canvas = canvas; this.clear(); }
  clear() { this.out = []; this.points = []; this.dash = []; this.clips = 0; this.open = 0; this.saved = []; }
  setTransform() { this.clear(); }
  set globalAlpha(value) { this.alpha = value; }
  beginPath() { this.points = []; }
  number(...values) {
    for (const value of values) if (!Number.isFinite(value)) throw new Error(`drawn at ${value}`);
    return values.map((value) => value.toFixed(1)).join(" ");
  }
  moveTo(x, y) { this.points.push(`M${this.number(x, y)}`); }
  lineTo(x, y) { this.points.push(`L${this.number(x, y)}`); }
  closePath() { this.points.push("Z"); }
  arc(x, y, r) { this.points.push(`M${this.number(x - r, y)}a${this.number(r, r)} 0 1 1 ${this.number(2 * r, 0)}a${this.number(r, r)} 0 1 1 ${this.number(-2 * r, 0)}`); }
  fill() { this.out.push(`<path d="${this.points.join("")}" fill="${this.fillStyle}"/>`); }
  setLineDash(dash) { this.dash = dash; }
  stroke() { this.out.push(`<path d="${this.points.join("")}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.number(this.lineWidth)}" stroke-dasharray="${this.dash.join(" ")}"/>`); }
  fillRect(x, y, w, h) { this.out.push(`<path d="M${this.number(x, y)}h${this.number(w)}v${this.number(h)}h${this.number(-w)}z" fill="${this.fillStyle}"/>`); }
  fillText(words, x, y) {
    const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    this.out.push(`<text x="${this.number(x)}" y="${this.number(y + 4)}" font-family="sans-serif" font-size="12" fill="${this.fillStyle}" text-anchor="${anchor}">${escape(words)}</text>`);
  }
  save() { this.saved.push(this.open); this.open = 0; }
  clip() {
    const name = `${this.canvas.id}${dark ? "d" : "l"}${++this.clips}`;
    this.out.push(`<clipPath id="${name}"><path d="${this.points.join("")}"/></clipPath><g clip-path="url(#${name})">`);
    this.open += 1;
  }
  restore() { this.out.push("</g>".repeat(this.open)); this.open = this.saved.pop(); }
  drawImage(image, x, y, w, h) { this.out.push(`<image href="${image.src}" x="${this.number(x)}" y="${this.number(y)}" width="${this.number(w)}" height="${this.number(h)}" opacity="${this.alpha ?? 1}"/>`); }
}

const escape = (words) => String(words).replace(/[&<>"]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[sign]);

class Element {
  constructor(tag, id = "") { this.tag = tag; this.id = id; this.children = []; this.words = ""; this.style = {}; this.className = ""; this.hidden = false; this.open = tag === "details"; this.listeners = {}; this.value = ""; this.parent = null; this.kinds = new Set(); this.classList = { toggle: (kind, on) => (on ? this.kinds.add(kind) : this.kinds.delete(kind)) }; }
  get textContent() { return this.children.length ? this.children.map((child) => (typeof child === "string" ? child : child.textContent)).join(" ") : this.words; }
  set textContent(words) { this.children = []; this.words = String(words); }
  get parentElement() { return (this.parent ??= new Element("div")); }
  get clientWidth() { return (sizes[this.id] ?? [100, 100])[0]; }
  get clientHeight() { return (sizes[this.id] ?? [100, 100])[1]; }
  get lastChild() { return this.children[this.children.length - 1]; }
  append(...items) { for (const item of items) if (item.tag) item.parent = this; this.children.push(...items); }
  prepend(item) { item.parent = this; this.children.unshift(item); }
  replaceChildren(...items) { this.children = []; this.append(...items); }
  remove() { this.parent.children = this.parent.children.filter((child) => child !== this); }
  addEventListener(name, work) { this.listeners[name] = work; }
  getContext() { return (this.context ??= new Context(this)); }
  getBoundingClientRect() { return { left: 0, top: 0, width: this.clientWidth, height: this.clientHeight }; }
  setPointerCapture() {}
  blur() {}
}

const page = new URL("../autopilot/data/view/", import.meta.url);
const html = readFileSync(new URL("index.html", page), "utf8"), found = {};
for (const [, tag, id] of html.matchAll(/<(\w+)[^>]*? id="(\w+)"/g)) found[id] = new Element(tag, id);
const missing = (id) => { throw new Error(`the page has no #${id}`); };
globalThis.document = {
  getElementById: (id) => found[id] ?? missing(id),
  querySelector: (name) => ({ content: name.includes("token") ? "token" : "" }),
  addEventListener() {},
  createElement: (tag) => new Element(tag),
  activeElement: null,
};
globalThis.window = { devicePixelRatio: 1, addEventListener() {} };
globalThis.matchMedia = (query) => ({ matches: query.includes("motion") ? process.argv[5] === "calm" : dark, addEventListener() {} });
globalThis.requestAnimationFrame = (work) => frames.push(work);
globalThis.setInterval = (work) => intervals.push(work);
globalThis.performance = { now: () => clock.ms };
Date.now = () => clock.ms;
globalThis.location = { reload: () => { reloads += 1; } };
globalThis.fetch = async (url, options) => {
  requests.push({ url, ...JSON.parse(options.body), ...(options.headers["X-View-Token"] === "token" ? {} : { token: options.headers["X-View-Token"] }) });
  const status = refused || 200;
  refused = 0;
  return { ok: status === 200, status, json: async () => (status === 200 ? { done: "done" } : { error: "refused" }) };
};
globalThis.Image = class { set src(value) { this.source = value; this.onload(); } get src() { return this.source; } };
globalThis.EventSource = class {
  constructor(url) { this.url = url; this.listeners = {}; this.readyState = 1; streams.push(this); }
  addEventListener(name, work) { this.listeners[name] = work; }
  close() {}
};

const tried = (work) => { try { work(); } catch (error) { errors.push(error.stack); } };
found.camerabox.open = true;
const source = (name) => readFileSync(new URL(name, page), "utf8").replaceAll(/"\.\/(\w+\.js)"/g, (_, other) => `"${inline(other)}"`);
const inline = (name) => `data:text/javascript,${encodeURIComponent(source(name))}`;
await import(inline("view.js"));
const shown = () => ({
  words: Object.fromEntries(Object.entries(found).map(([id, element]) => [id, element.textContent])),
  stale: Object.keys(found).filter((id) => found[id].kinds.has("stale")),
  camera: found.camera.context ? found.camera.context.out.join("") : "",
  plan: found.plan.context ? found.plan.context.out.join("") : "",
  rows: found.state.children.filter((child) => child.className === "stale").length,
});
for await (const line of createInterface({ input: process.stdin })) {
  const { name, data, event, wait, sleep, to, refuse, note, stream } = JSON.parse(line);
  if (wait) { clock.ms += 1e3 * wait; for (const work of intervals) tried(work); }
  else if (sleep) clock.ms += 1e3 * sleep;
  else if (refuse) refused = refuse;
  else if (stream !== undefined) { streams.at(-1).readyState = stream; tried(() => (event === "error" ? streams.at(-1).onerror() : streams.at(-1).listeners[event]({}))); }
  else if (note) await new Promise((done) => setImmediate(done));
  else if (event) tried(() => found[name].listeners[event]({ preventDefault() {}, ...data, target: found[name] }));
  else tried(() => streams.at(to ?? -1).listeners[name]({ data: JSON.stringify(data) }));
  for (const work of frames.splice(0)) tried(work);
  if (note) notes[note] = shown();
}
const svg = {};
for (const id of ["plan", "side", "flow", "camera"]) {
  const [w, h] = sizes[id];
  svg[id] = found[id].context ? `<svg xmlns="http://www.w3.org/2000/svg" width="${w}" height="${h}" viewBox="0 0 ${w} ${h}">${found[id].context.out.join("")}</svg>` : "";
}
const list = (id) => found[id].children.map((child) => child.textContent);
const words = Object.fromEntries(Object.entries(found).map(([id, element]) => [id, element.textContent]));
const hidden = Object.keys(found).filter((id) => found[id].hidden);
const bars = [...found.bars.children, ...found.thrusters.children].map((row) => ({ words: row.children.map((child) => child.textContent), rod: { ...row.children[1].children[0].style }, full: row.children[1].children[0].className === "full", two: row.children[1].className.includes("two") }));
console.log(JSON.stringify({ errors, requests, reloads, notes, stale: shown().stale, streams: streams.map((one) => one.url), svg, words, hidden, state: list("state"), messages: list("messages"), bars }));
