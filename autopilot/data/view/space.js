// The plan's place in 3-D, on demand: loads three.js and what is drawn by it, and turns pointer and keys into a camera.
// Off, it costs nothing; out of sight nothing is drawn.
import { ARROWS, apart, plainKey, viewKeys, wheelZoom } from "./gestures.js";

const TURN_RAD_PX = 0.008, TURN_KEY_RAD = 0.15, ZOOM_KEY = 1.25, MOST_NEAR = 1000;
const RESET = "3-D: the graphics driver has reset; wait, or reload the page";

export class SpaceView {
  // `parts`: canvas, button, chart and words of the page; `missing`: how to get three.js where it is not there;
  // `redraw` asks for a picture, `fit` and `follow` are what the plan's keys do.
  constructor(parts, missing, { redraw, fit, follow }) {
    Object.assign(this, parts, { missing, redraw, on: false, world: null, angles: null, nearness: 1, following: false, last: null, asked: false, pointers: new Map() });
    this.button.addEventListener("click", () => this.toggle());
    const canvas = this.canvas, on = (name, work) => canvas.addEventListener(name, work, { passive: false });
    on("pointerdown", (event) => { this.pointers.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); });
    on("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) on(end, (event) => this.pointers.delete(event.pointerId));
    on("wheel", (event) => { event.preventDefault(); this.zoom(wheelZoom(event)); });
    const keys = viewKeys((factor) => this.zoom(factor), ZOOM_KEY, fit, follow);
    on("keydown", (event) => {
      const way = ARROWS[event.key], work = keys[event.key];
      if (!plainKey(event) || (!way && !work)) return;
      event.preventDefault();
      if (way) this.turn(-way[0] * TURN_KEY_RAD, -way[1] * TURN_KEY_RAD);
      else work();
    });
    // Nothing of a lost context may be used, or deleted, in the next one: another world is made there.
    on("webglcontextlost", (event) => {
      event.preventDefault(); // asks for the next one
      if (this.world) this.world.renderer.dispose();
      this.world = null;
      this.words.textContent = RESET;
    });
    on("webglcontextrestored", async () => {
      if (this.on) this.world = await this.made();
      this.show("");
    });
  }

  async toggle() {
    try {
      if (!this.on) this.world ??= await this.made();
      this.on = !this.on;
      this.show("");
    } catch (error) {
      this.show(error.message);
    }
  }

  async made() {
    if (this.missing) throw new Error(this.missing);
    const context = this.canvas.getContext("webgl", { antialias: true });
    if (!context) throw new Error("3-D needs WebGL, which this browser does not offer");
    if (context.isContextLost()) throw new Error(RESET);
    const [{ World }] = await Promise.all([import("./space_world.js"), window.THREE ?? loaded("three.js")]);
    return new World(window.THREE, this.canvas, context);
  }

  show(words) {
    this.button.ariaPressed = String(this.on);
    this.chart.classList.toggle("space", this.on);
    this.canvas.hidden = !this.on;
    this.words.textContent = words;
    this.redraw();
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId), now = [event.clientX, event.clientY];
    if (!before) return;
    const other = [...this.pointers].find(([id]) => id !== event.pointerId);
    this.pointers.set(event.pointerId, now);
    if (other) this.zoom(apart(now, other[1]) / apart(before, other[1]));
    else this.turn((now[0] - before[0]) * TURN_RAD_PX, (now[1] - before[1]) * TURN_RAD_PX);
  }

  // By how much the world turns to the right, and its near side down.
  turn(right, down) {
    if (!this.angles) return;
    const [azimuth, elevation] = this.angles;
    this.angles = [azimuth - right, Math.min(Math.max(elevation + down, 0.02), 1.55)];
    this.again();
  }

  zoom(factor) {
    this.nearness = Math.min(Math.max(this.nearness * factor, 0.3), MOST_NEAR);
    this.again();
  }

  fit() {
    this.angles = null;
    this.nearness = 1;
    this.again();
  }

  // The same from elsewhere: nothing but this is drawn for it.
  again() {
    if (this.asked || !this.last) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.draw(...this.last);
    });
  }

  // `shown`: what the plan is drawn from.
  draw(shown, palette) {
    if (!this.on || !this.world || this.world.context.isContextLost()) return;
    this.last = [shown, palette];
    const box = this.canvas.getBoundingClientRect();
    if (box.bottom < 0 || box.top > window.innerHeight) return;
    // At first as the plan lies: from the south, or from the east where north is to the right.
    const follow = Boolean(shown.camera && shown.camera.follow);
    if (follow && !this.following) this.nearness = Math.max(this.nearness, this.world.nearnessOf(shown));
    this.following = follow;
    this.angles ??= [(shown.view.turned ? 0.5 : 1) * Math.PI + 0.35, 0.6];
    this.world.show(shown, palette);
    this.world.draw(box.width, box.height, { angles: this.angles, nearness: this.nearness });
  }
}

function loaded(url) {
  return new Promise((done, fail) => {
    const script = document.createElement("script");
    script.src = url;
    script.onload = done;
    script.onerror = () => fail(new Error("3-D: three.js cannot be loaded; reload the page"));
    document.head.append(script);
  });
}
