// What the plan shows, in 3-D, by three.js. Coordinates are local NED metres: one group turns them to three's axes.
import { faded } from "./draw.js";
import { hull, tubeEdges } from "./ink.js";
import { extent, floorDepth, gridStep } from "./plan.js";

const FOV_DEG = 40, AXES = [["#e5484d", [1, 0, 0]], ["#30a46c", [0, 1, 0]], ["#3e7bfa", [0, 0, 1]]]; // forward, right, down
const FLOW_S = 2; // an arrow of a current is what it carries away in that time
const ROUND = 24; // corners of a circle
const LEAST_M = 1e-4; // of a prediction's way, to have sides
const NAME_PX = 28, LEAST_PX = 7; // height of a name's box; radius of the vehicle, at least
const FOLLOW_RADII = 12; // of its body, of what is seen of a vehicle that is followed

// Corners of a circle, (north, east).
const ring = ([n, e], radius) => Array.from({ length: ROUND }, (_, k) => {
  const angle = (2 * Math.PI * k) / ROUND;
  return [n + radius * Math.cos(angle), e + radius * Math.sin(angle)];
});
const at = (points, down) => points.map(([n, e]) => [n, e, down]);
const closed = (points) => [...points, points[0]];
// Two triangles for each pair of neighbours on two lines.
const strip = (one, other) => one.slice(1).flatMap((end, k) => [one[k], end, other[k], other[k], end, other[k + 1]]);

const halfOf = ({ n0, n1, e0, e1 }, floor) => 0.5 * Math.hypot(n1 - n0, e1 - e0, floor);

export class World {
  constructor(THREE, canvas, context) {
    this.THREE = THREE;
    this.context = context;
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    this.camera = new THREE.PerspectiveCamera(FOV_DEG, 1, 0.1, 100);
    this.scene = new THREE.Scene();
    this.ned = new THREE.Group();
    this.ned.matrixAutoUpdate = false;
    this.ned.matrix.set(0, 1, 0, 0, 0, 0, -1, 0, -1, 0, 0, 0, 0, 0, 0, 1); // x = east, y = up, z = south
    this.scene.add(this.ned, new THREE.HemisphereLight(0xffffff, 0x8090a0, 1));
    this.materials = new Map();
    this.names = [];
    this.bodies = [];
    this.still = this.moving = null;
    this.of = {};
  }

  // Anew what has changed since: the surroundings, and all that moves.
  show(shown, palette) {
    const { scene, frame, trail } = shown, of = this.of;
    if (of.palette !== palette) {
      for (const material of this.materials.values()) material.dispose();
      this.materials.clear();
    }
    if (of.scene !== scene || of.palette !== palette) {
      this.names = [];
      this.still = this.replaced(this.still, this.surroundings(scene, palette));
      this.renderer.setClearColor(palette.back);
    }
    if (of.frame !== frame || of.palette !== palette || of.trail !== trail || of.scene !== scene || of.lost !== shown.lost) this.moving = this.replaced(this.moving, this.movers(shown, palette));
    this.all = extent(scene, frame);
    this.floor = floorDepth(scene, frame);
    const { n0, n1, e0, e1 } = this.all, follow = shown.camera && shown.camera.follow && frame && frame.estimate;
    this.target = follow ? frame.estimate.pos_ned_m : [0.5 * (n0 + n1), 0.5 * (e0 + e1), 0.5 * this.floor];
    this.of = { scene, frame, palette, trail, lost: shown.lost };
  }

  draw(width, height, { angles: [azimuth, elevation], nearness }) {
    const { camera, renderer, target, all } = this, tan = Math.tan((0.5 * FOV_DEG * Math.PI) / 180), ratio = window.devicePixelRatio || 1;
    if (this.size !== `${width} ${height} ${ratio}`) {
      this.size = `${width} ${height} ${ratio}`;
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
    }
    const radius = halfOf(all, this.floor);
    const far = (radius / tan) * Math.max(0.76, (1.05 * height) / width) / nearness; // flat: less high than wide
    camera.aspect = width / height;
    camera.near = far / 50;
    camera.far = far + 4 * radius;
    camera.updateProjectionMatrix();
    const middle = new this.THREE.Vector3(...target).applyMatrix4(this.ned.matrix), flat = far * Math.cos(elevation);
    camera.position.set(middle.x + flat * Math.sin(azimuth), middle.y + far * Math.sin(elevation), middle.z - flat * Math.cos(azimuth));
    camera.lookAt(middle);
    const pixel = (one) => (2 * tan * camera.position.distanceTo(one.getWorldPosition(new this.THREE.Vector3()))) / height;
    for (const name of this.names) name.scale.set(4 * NAME_PX * pixel(name), NAME_PX * pixel(name), 1);
    for (const body of this.bodies) body.scale.setScalar(Math.max(1, (LEAST_PX * pixel(body)) / this.of.scene.body_radius_m));
    renderer.render(this.scene, camera);
  }

  // How near the camera is for a vehicle that is followed to be seen as one.
  nearnessOf({ scene, frame }) { return halfOf(extent(scene, frame), floorDepth(scene, frame)) / (FOLLOW_RADII * scene.body_radius_m); }

  replaced(before, group) {
    if (before) {
      this.ned.remove(before);
      before.traverse((one) => {
        if (one.isSprite) { one.material.map.dispose(); one.material.dispose(); } // all sprites share one geometry
        else if (one.geometry) one.geometry.dispose();
      });
    }
    this.ned.add(group);
    return group;
  }

  surroundings(scene, colors) {
    const group = new this.THREE.Group(), { n0, n1, e0, e1 } = extent(scene, null), floor = floorDepth(scene, null);
    const base = scene.tank_m.length ? scene.tank_m : [[n1, e0], [n1, e1], [n0, e1], [n0, e0]];
    const norths = base.map((p) => p[0]), easts = base.map((p) => p[1]), step = gridStep(700 / Math.max(n1 - n0, e1 - e0));
    this.area(group, base, floor, colors.water);
    const [south, north, west, east] = [Math.min(...norths), Math.max(...norths), Math.min(...easts), Math.max(...easts)];
    const grid = [];
    for (let n = Math.ceil(south / step) * step; n <= north; n += step) grid.push([n, west, floor], [n, east, floor]);
    for (let e = Math.ceil(west / step) * step; e <= east; e += step) grid.push([south, e, floor], [north, e, floor]);
    this.lines(group, grid, colors.grid);
    if (scene.tank_m.length) this.walls(group, scene.tank_m, 0, floor, colors.wall);
    const depths = [scene.parameters.DEPTH_MIN, scene.parameters.DEPTH_MAX].map((depth) => Math.min(Math.max(depth || 0, 0), floor));
    for (const shape of scene.fence) {
      const [high, low] = depths[1] > depths[0] ? depths : [0, floor];
      this.walls(group, shape.corners_m, high, low, colors.fence, colors.margin);
    }
    for (const place of scene.places) {
      const [n, e, d] = place.pos_ned_m, r = place.accept_radius_m;
      this.line(group, at(closed(ring([n, e], r)), d), colors.place);
      this.line(group, [[n, e, d], [n, e, floor]], colors.place);
      if (place.yaw_rad !== null) this.line(group, [[n, e, d], [n + r * Math.cos(place.yaw_rad), e + r * Math.sin(place.yaw_rad), d]], colors.place);
      this.name(group, place.name, place.pos_ned_m, colors.place);
    }
    return group;
  }

  movers({ scene, frame, trail, lost }, colors) {
    const { THREE } = this, group = new THREE.Group(), floor = floorDepth(scene, frame);
    this.bodies = [];
    if (!frame) return group;
    for (const solid of frame.solids) {
      if (solid.depth_m !== null) this.ball(group, [...solid.center_m, solid.depth_m], solid.radius_m, colors.solid);
      else this.pillar(group, solid.corners_m.length ? solid.corners_m : ring(solid.center_m, solid.radius_m), 0, floor, colors.solid);
    }
    for (const track of frame.tracks) {
      const [n, e] = track.pos_ned_m, [u, v] = track.vel_ned_m_s, color = track.age_s > scene.ages.track_s ? colors.weak : colors.track;
      this.walls(group, ring([n, e], track.radius_m), 0, floor, color);
      this.line(group, at([[n, e], [n + FLOW_S * u, e + FLOW_S * v]], 0), color);
    }
    this.line(group, trail, colors.trail);
    const { estimate, truth, control, goal } = frame;
    if (goal) this.line(group, at(closed(ring(goal.pos_ned_m, goal.accept_radius_m)), goal.pos_ned_m[2]), colors.goal);
    if (control) {
      this.line(group, at(control.route_ned_m, estimate ? estimate.pos_ned_m[2] : 0), colors.route);
      const edges = tubeEdges(control.horizon_ned_m, control.tube_m, LEAST_M);
      if (control.tube_m.length && edges[0].length) {
        this.faces(group, strip(...edges), colors.tube);
        for (const edge of edges) this.line(group, edge, colors.horizon);
      }
      this.line(group, control.horizon_ned_m, colors.horizon);
    }
    const body = hull([0, 0], 0, scene.body_radius_m), h = scene.half_height_m;
    const placed = ({ pos_ned_m, rpy_rad: [roll, pitch, yaw] }) => {
      const own = new THREE.Group();
      own.position.set(...pos_ned_m);
      own.rotation.set(roll, pitch, yaw, "ZYX");
      group.add(own);
      this.bodies.push(own);
      return own;
    };
    if (truth) this.walls(placed(truth), body, -h, h, colors.truth);
    if (!estimate) return group;
    const paint = lost ? faded(colors) : colors, own = placed(estimate), reach = 1.8 * scene.body_radius_m;
    this.pillar(own, body, -h, h, paint.body);
    for (const [color, axis] of AXES) this.line(own, [[0, 0, 0], axis.map((part) => reach * part)], lost ? paint.weak : color, true);
    const [n, e, d] = estimate.pos_ned_m, [u, v, w] = estimate.current_ned_m_s;
    this.line(group, [[n, e, d], [n, e, floor]], paint.weak);
    this.line(group, [[n, e, d], [n + FLOW_S * u, e + FLOW_S * v, d + FLOW_S * w]], paint.felt, true);
    return group;
  }

  // `over`: seen through what is before it.
  material(kind, color, over = false) {
    const key = `${kind} ${color} ${over}`;
    if (!this.materials.has(key)) {
      const parts = /^rgba\((\d+),(\d+),(\d+),([\d.]+)\)$/.exec(color), clear = parts !== null;
      const paint = { color: clear ? `rgb(${parts.slice(1, 4)})` : color, transparent: clear || over, opacity: clear ? Number(parts[4]) : 1, depthTest: !over };
      if (kind !== "Line") Object.assign(paint, { side: this.THREE.DoubleSide, depthWrite: !clear, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
      this.materials.set(key, new this.THREE[kind === "Line" ? "LineBasicMaterial" : kind === "Solid" ? "MeshLambertMaterial" : "MeshBasicMaterial"](paint));
    }
    return this.materials.get(key);
  }

  geometry(points) {
    const made = new this.THREE.BufferGeometry();
    made.addAttribute("position", new this.THREE.Float32BufferAttribute(points.flat(), 3));
    return made;
  }

  line(group, points, color, over) {
    if (points.length < 2) return;
    const made = new this.THREE.Line(this.geometry(points), this.material("Line", color, over));
    made.renderOrder = over ? 2 : 0;
    group.add(made);
  }

  lines(group, points, color) { group.add(new this.THREE.LineSegments(this.geometry(points), this.material("Line", color))); }

  faces(group, points, color, kind = "Face") {
    const made = this.geometry(points);
    if (kind === "Solid") made.computeVertexNormals();
    group.add(new this.THREE.Mesh(made, this.material(kind, color)));
  }

  // A level polygon.
  area(group, corners, down, color, kind) {
    const { Vector2, ShapeUtils } = this.THREE, flat = corners.map(([n, e]) => new Vector2(n, e));
    this.faces(group, ShapeUtils.triangulateShape(flat, []).flatMap((three) => three.map((k) => [...corners[k], down])), color, kind);
  }

  // Edges of a prism, with its sides if they have a colour.
  walls(group, corners, high, low, color, side) {
    const round = closed(corners);
    this.line(group, at(round, high), color);
    this.line(group, at(round, low), color);
    if (corners.length < ROUND) this.lines(group, corners.flatMap(([n, e]) => [[n, e, high], [n, e, low]]), color);
    if (side) this.faces(group, strip(at(round, high), at(round, low)), side);
  }

  pillar(group, corners, high, low, color) {
    this.faces(group, strip(at(closed(corners), high), at(closed(corners), low)), color, "Solid");
    for (const down of [high, low]) this.area(group, corners, down, color, "Solid");
  }

  ball(group, place, radius, color) {
    const made = new this.THREE.Mesh(new this.THREE.SphereBufferGeometry(radius, ROUND, ROUND / 2), this.material("Solid", color));
    made.position.set(...place);
    group.add(made);
  }

  name(group, words, place, color) {
    const { THREE } = this, canvas = document.createElement("canvas"), ctx = canvas.getContext("2d");
    [canvas.width, canvas.height] = [256, 64];
    Object.assign(ctx, { fillStyle: color, font: "30px system-ui, sans-serif", textAlign: "left", textBaseline: "middle" });
    ctx.fillText(words, 144, 32, 112);
    const made = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false }));
    made.position.set(...place);
    made.renderOrder = 3;
    this.names.push(made);
    group.add(made);
  }
}
