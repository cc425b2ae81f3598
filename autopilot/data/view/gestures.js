// What keys, wheel and fingers mean, on the plan and in 3-D.

// As the arrow keys point: to the right and down.
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

// The browser's own keys are left to it.
export const plainKey = (event) => !(event.ctrlKey || event.metaKey || event.altKey);

export const viewKeys = (zoom, step, fit, follow) => ({ "+": () => zoom(step), "=": () => zoom(step), "-": () => zoom(1 / step), 0: fit, f: follow, F: follow });

export const wheelZoom = (event) => Math.exp(-0.002 * event.deltaY * (event.deltaMode ? 20 : event.ctrlKey ? 5 : 1)); // ctrl: a touchpad's pinch

// Of two fingers, in pixels.
export const apart = ([x, y], [x1, y1]) => Math.max(Math.hypot(x1 - x, y1 - y), 1);
