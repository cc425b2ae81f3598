// Lines, areas and words on a 2D context, and the outline of the vehicle.

export function path(ctx, points, close) {
  ctx.beginPath();
  points.forEach(([x, y], index) => (index ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  if (close) ctx.closePath();
}

export function stroke(ctx, points, color, width, close = false, dash = []) {
  if (points.length < 2) return;
  path(ctx, points, close);
  ctx.setLineDash(dash);
  ctx.lineWidth = width;
  ctx.strokeStyle = color;
  ctx.stroke();
  ctx.setLineDash([]);
}

export function fill(ctx, points, color) {
  path(ctx, points, true);
  ctx.fillStyle = color;
  ctx.fill();
}

export function circle(ctx, [x, y], radius, color, width, filled = false, dash = []) {
  ctx.beginPath();
  ctx.arc(x, y, Math.max(radius, 0.5), 0, 2 * Math.PI);
  if (filled) { ctx.fillStyle = color; ctx.fill(); return; }
  ctx.setLineDash(dash);
  ctx.lineWidth = width;
  ctx.strokeStyle = color;
  ctx.stroke();
  ctx.setLineDash([]);
}

export function text(ctx, words, x, y, color, align = "left", size_px = 12) {
  ctx.fillStyle = color;
  ctx.textAlign = align;
  ctx.textBaseline = "middle";
  ctx.font = `${size_px}px system-ui, sans-serif`;
  ctx.fillText(words, x, y);
}

export function clear(ctx, width, height, colors) {
  ctx.fillStyle = colors.back;
  ctx.fillRect(0, 0, width, height);
}

// Without a minus before nothing.
export const number = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");

// The two edges of what lies within its radius of a way, in a plane; where the way stands still (`least`) they have no side.
export function tubeEdges(points, radii, least) {
  const edges = [[], []];
  points.forEach(([x, y, ...rest], index) => {
    const [x0, y0] = points[Math.max(index - 1, 0)], [x1, y1] = points[Math.min(index + 1, points.length - 1)];
    const length = Math.hypot(x1 - x0, y1 - y0), r = radii[index];
    if (length < least) return;
    const [u, v] = [(r * (y1 - y0)) / length, (r * (x0 - x1)) / length];
    edges[0].push([x + u, y + v, ...rest]);
    edges[1].push([x - u, y - v, ...rest]);
  });
  return edges;
}

export function arrow(ctx, [x0, y0], [x1, y1], color, width) {
  const angle = Math.atan2(y1 - y0, x1 - x0), length = Math.hypot(x1 - x0, y1 - y0);
  if (length < 1) return;
  const head = Math.min(7, 0.45 * length);
  stroke(ctx, [[x0, y0], [x1, y1]], color, width);
  const side = (turn) => [x1 - head * Math.cos(angle + turn), y1 - head * Math.sin(angle + turn)];
  stroke(ctx, [side(0.5), [x1, y1], side(-0.5)], color, width);
}

// Corners of a body of that radius, north and east; the first, second and last are the nose.
export function hull(place, yaw, radius) {
  const [n, e] = place, c = Math.cos(yaw), s = Math.sin(yaw);
  const corner = (f, r) => [n + radius * (f * c - r * s), e + radius * (f * s + r * c)];
  return [corner(1, 0), corner(0.35, 0.62), corner(-0.85, 0.62), corner(-0.85, -0.62), corner(0.35, -0.62)];
}
