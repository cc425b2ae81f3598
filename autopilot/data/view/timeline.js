// Slider, buttons and strip charts: back to a moment of the live view, or through a log.
import { plainKey } from "./gestures.js";
import { drawCharts, timeAt } from "./history.js";
import { $, set } from "./page.js";
import { RATES } from "./player.js";

const SMALL_S = 0.1, LARGE_S = 1, AT_END_S = 0.05;
const SPANS = [["1 min", 60], ["10 min", 600]];
const ANYWHERE = [" ", "ArrowLeft", "ArrowRight", "n", "p"]; // keys of a log's page; the others scroll it
const EVENT_LENGTH = 60; // letters of a message in the list

// `source`: { begin, end, now, live: whether it is the present, playing, events, history(span_s), window(span_s), seek(t_s), toEnd(), play(on), rate(times) }.
export class Timeline {
  constructor(source, log) {
    this.source = source;
    this.log = log;
    this.listed = -1;
    const option = (words, value) => Object.assign(document.createElement("option"), { textContent: words, value: String(value) });
    $("span").replaceChildren(...(log ? [["whole log", 0]] : []).concat(SPANS).map(([words, value]) => option(words, value)));
    $("rate").replaceChildren(...RATES.map((value) => option(`${value} ×`, value)));
    $("rate").value = "1";
    for (const id of ["play", "ratebox", "eventbox"]) $(id).hidden = !log;
    $("when").addEventListener("input", () => this.to(Number($("when").value)));
    $("prior").addEventListener("click", () => this.event(-1));
    $("next").addEventListener("click", () => this.event(1));
    $("present").addEventListener("click", () => source.toEnd());
    $("play").addEventListener("click", () => source.play(!source.playing));
    $("rate").addEventListener("change", () => source.rate(Number($("rate").value)));
    $("span").addEventListener("change", () => source.spanned(this.span));
    $("events").addEventListener("change", () => { if ($("events").value) source.seek(Number($("events").value)); });
    $("timeline").addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("keydown", (event) => { if (log && event.target === document.body) this.key(event); });
    const strips = $("strips"), at = (event) => {
      const box = strips.getBoundingClientRect();
      this.to(timeAt(box.width, box.height, [event.clientX - box.left, event.clientY - box.top], source.window(this.span)));
    };
    strips.addEventListener("pointerdown", (event) => { if (event.button > 0) return; strips.setPointerCapture(event.pointerId); this.dragged = true; at(event); });
    strips.addEventListener("pointermove", (event) => { if (this.dragged) at(event); });
    for (const end of ["pointerup", "pointercancel"]) strips.addEventListener(end, () => { this.dragged = false; });
  }

  get span() { return Number($("span").value); }

  to(t_s) {
    const { source } = this;
    if (!this.log && t_s >= source.end - AT_END_S) source.toEnd();
    else source.seek(Math.min(Math.max(t_s, source.begin), source.end));
  }

  // The message before or after the time that is shown.
  event(way) {
    const { source } = this, times = source.events.filter((one) => one.severity !== "DEBUG").map((one) => one.t_s);
    const found = way > 0 ? times.find((t_s) => t_s > source.now + SMALL_S / 2) : times.filter((t_s) => t_s < source.now - SMALL_S / 2).pop();
    if (found !== undefined) this.to(found);
  }

  // Space plays, arrows step, N and P go from message to message, Home and End to the ends, Escape back to the present.
  key(event) {
    const { source } = this, tag = event.target.tagName;
    if (!plainKey(event) || tag === "SELECT" || (event.key === " " && (tag === "BUTTON" || !this.log))) return;
    const step = event.shiftKey ? LARGE_S : SMALL_S, key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const work = {
      " ": () => source.play(!source.playing),
      ArrowLeft: () => this.to(source.now - step), ArrowRight: () => this.to(source.now + step),
      ArrowDown: () => this.to(source.now - step), ArrowUp: () => this.to(source.now + step),
      PageDown: () => this.event(-1), PageUp: () => this.event(1), p: () => this.event(-1), n: () => this.event(1),
      Home: () => this.to(source.begin), End: () => this.to(source.end), Escape: () => source.toEnd(),
    }[key];
    if (!work || (event.target === document.body && !ANYWHERE.includes(key))) return;
    event.preventDefault();
    work();
  }

  // How things stand.
  show() {
    const { source, log } = this, when = $("when"), { begin, end, now } = source;
    set(when, "min", begin.toFixed(1));
    set(when, "max", (log ? Math.ceil(10 * end) / 10 : end).toFixed(1));
    set(when, "value", now.toFixed(1));
    const back = end - now, words = log ? `${now.toFixed(1)} of ${end.toFixed(1)} s` : source.live ? "" : `${back.toFixed(1)} s ago`;
    set(when, "ariaValueText", log ? words : source.live ? "live" : words);
    set($("moment"), "textContent", words);
    set($("past"), "textContent", log ? "Log" : source.live ? "" : `Past: ${words}`);
    set($("present"), "hidden", log || source.live);
    set($("play"), "textContent", source.playing ? "Pause" : "Play");
    if (log && this.listed !== source.events.length) this.list();
  }

  list() {
    const { events } = this.source, option = (words, value) => Object.assign(document.createElement("option"), { textContent: words, value });
    this.listed = events.length;
    $("events").replaceChildren(option(`${events.length} messages`, ""), ...events.map(({ t_s, severity, text }) => {
      const words = `${t_s.toFixed(1)} s ${["INFO", "NOTICE", "DEBUG"].includes(severity) ? "" : `${severity.toLowerCase()}: `}${text}`;
      return option(words.length > EVENT_LENGTH ? `${words.slice(0, EVENT_LENGTH)}…` : words, String(t_s));
    }));
  }

  draw(ctx, width, height, { scene, frame }, colors) {
    const { source } = this, [from, to] = source.window(this.span);
    const label = this.log ? (t_s) => `${t_s.toFixed(0)} s` : (t_s) => `${(t_s - source.end).toFixed(0)} s`;
    drawCharts(ctx, width, height, { history: source.history(), scene, frame, from, to, at: source.now, label }, colors);
  }
}
