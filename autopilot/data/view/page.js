// What the page shows, and what all its parts need of it: elements, words, colours, the next drawing.
import { Link, Pace } from "./ages.js";
import { DARK, LIGHT } from "./draw.js";
import { number } from "./ink.js";

export const $ = (id) => document.getElementById(id);
export const meta = (name) => document.querySelector(`meta[name=view-${name}]`).content;
export const log = meta("source") === "log";
export const dark = matchMedia("(prefers-color-scheme: dark)"), calm = matchMedia("(prefers-reduced-motion: reduce)");
export const present = { scene: null, frame: null, flow: null, picture: null, image: null, trail: [] };
// What is shown: the present, or (`past`) a moment of before or of a log. `camera`, `view`: of the plan; `drag`, `moving`:
// what a pointer or a key holds; `other`: it is of a process that is not there any more; `trouble`: in its words.
export const seen = { ...present, past: log, camera: null, view: null, drag: null, moving: null, margins: true, other: false, pictureOld: false, trouble: "" };
export const link = new Link(), pace = new Pace();

export const colors = () => (dark.matches ? DARK : LIGHT);
export const fixed = (value, digits = 2) => (value === null || value === undefined ? "–" : number(value, digits));
export const degrees = (radians) => `${number((radians * 180) / Math.PI, 1)}°`;
export const plain = (name) => name.toLowerCase().replaceAll("_", " ");
export const seconds = () => performance.now() / 1e3;
export const ages = () => seen.scene.ages;
export const current = (frame) => (frame.control && frame.control.age_s <= ages().control_s ? frame.control : null);
export const lost = (frame) => !frame.estimate || frame.estimate.health === "INVALID" || frame.estimate.age_s > ages().estimate_s;

export function element(tag, words, kind) {
  const made = document.createElement(tag);
  if (words !== undefined) made.textContent = words;
  if (kind) made.className = kind;
  return made;
}

// Nothing is written that stands there already: a reader of the screen hears every change, and each is laid out.
export function set(one, name, value) {
  if (one[name] !== value) one[name] = value;
}

export function put(id, words) { set($(id), "textContent", words); }

// Sizes of canvases as the layout was last: to ask for them between two changes of the page would lay it out anew.
const sizes = new Map();
const resized = new ResizeObserver((entries) => {
  for (const { target } of entries) sizes.set(target, [target.clientWidth, target.clientHeight]);
  soon();
});

// Canvases in the screen's own pixels.
export function context(canvas) {
  if (!sizes.has(canvas)) {
    sizes.set(canvas, [canvas.clientWidth, canvas.clientHeight]);
    resized.observe(canvas);
  }
  const ratio = window.devicePixelRatio || 1, [width, height] = sizes.get(canvas);
  set(canvas, "width", Math.round(width * ratio));
  set(canvas, "height", Math.round(height * ratio));
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [ctx, width, height];
}

let drawing = null, asked = false;
export function drawWith(work) { drawing = work; }

export function soon() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; drawing(); });
}

// Of the plan: which part of the world it shows, null = everything.
export function look(camera) { seen.camera = camera; $("follow").ariaPressed = String(Boolean(camera && camera.follow)); soon(); }
