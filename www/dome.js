// The dome of light directions over the object: a view that can be turned, with candidates, the lights of a run in
// their order, and a sun that can be dragged. Of use wherever directions are shown; it knows nothing of planners.
//
// Frame: x right, y up, z to the camera. The view looks along the optical axis when the tilt is 0.

import { draw, html, set, svg } from "./svg.js";

/** @typedef {import("./messages.js").Direction} Direction */
/** @typedef {import("./messages.js").Picture} Picture */

/**
 * @typedef {object} DomeLight
 * @property {Direction} used where the light was
 * @property {Direction} requested where it was asked for
 * @property {string} label one or two characters
 *
 * @typedef {object} DomeEvents
 * @property {(direction: Direction) => void} [onSun] the sun was moved
 * @property {(candidate: number | null) => void} [onCandidate] a candidate is pointed at, or none
 * @property {(light: number) => void} [onLight] a light of the run was chosen, from 0
 */

const RADIUS = 100;
/** Sizes in the dome's units, in which its radius is 100. */
const VIEW = { left: -117, top: -113, width: 234, height: 226 };
const OBJECT_SIZE = 1.12;
const DEFAULT_TURN = { yaw: -0.42, tilt: 0.72 };
const KEY_STEP = Math.PI / 36;
/** A pointer that moves less than this, in the dome's units, turns nothing: it points. */
const TAP = 3;

export class Dome {
  #yaw = DEFAULT_TURN.yaw;
  #tilt = DEFAULT_TURN.tilt;
  /** @type {Direction[]} */
  #candidates = [];
  /** @type {DomeLight[]} */
  #lights = [];
  #current = 0;
  /** @type {Direction | null} */
  #sun = null;
  /** Largest slant on offer, degrees. */
  #reach = 90;
  /** @type {number | null} */
  #hot = null;
  #waiting = false;
  /** What the drawn shell and candidates show: they are many and change seldom. */
  #drawn = "";
  #canvas = html("canvas", { class: "dome-object", width: 1, height: 1, "aria-hidden": "true" });
  #svg = svg("svg", {
    viewBox: `${VIEW.left} ${VIEW.top} ${VIEW.width} ${VIEW.height}`,
    role: "application", tabindex: 0, "aria-roledescription": "turnable dome",
    "aria-label": "Light directions. Arrow keys turn the view, N and P go through the candidate lights, Home resets.",
  });
  /** Under the object; the marks are above it. */
  #back = svg("svg", { viewBox: `${VIEW.left} ${VIEW.top} ${VIEW.width} ${VIEW.height}`, "aria-hidden": "true" });
  #dots = svg("g");
  #marks = svg("g");
  #sunMark = svg("g", {
    class: "sun", role: "slider", tabindex: 0, "aria-label": "Relighting direction, azimuth",
    "aria-valuemin": -180, "aria-valuemax": 180, "aria-valuenow": 0,
  });
  /** @type {DomeEvents} */
  #events;

  /**
   * @param {HTMLElement} host
   * @param {DomeEvents} events
   */
  constructor(host, events) {
    this.#events = events;
    host.classList.add("dome");
    this.#svg.append(this.#dots, this.#marks, this.#sunMark);
    host.append(this.#back, this.#canvas, this.#svg);
    this.#listen();
    new ResizeObserver(() => this.#redraw()).observe(host);
    this.#redraw();
  }

  /**
   * What to show; what is left out stays.
   * @param {{ candidates?: Direction[], reach?: number, lights?: DomeLight[], current?: number, sun?: Direction | null }} shown
   * current: how many lights of the run have been taken; reach: degrees
   */
  update({ candidates, reach, lights, current, sun }) {
    if (candidates) this.#candidates = candidates;
    if (reach !== undefined) this.#reach = reach;
    if (lights) this.#lights = lights;
    if (current !== undefined) this.#current = current;
    if (sun !== undefined) this.#sun = sun;
    this.#redraw();
  }

  /** @param {Picture | null} picture the object in the middle, as the camera sees it */
  setObject(picture) {
    if (picture) draw(this.#canvas, picture);
    else this.#canvas.width = this.#canvas.height = 1; // which clears it
    this.#placeObject();
  }

  /**
   * Turns the view.
   * @param {number} yaw radians about the optical axis
   * @param {number} tilt radians away from it
   */
  turn(yaw, tilt) {
    this.#yaw += yaw;
    this.#tilt = Math.min(Math.max(this.#tilt + tilt, 0), 1.4);
    this.#redraw();
  }

  /** @param {"default" | "camera"} view */
  look(view) {
    [this.#yaw, this.#tilt] = view === "camera" ? [0, 0] : [DEFAULT_TURN.yaw, DEFAULT_TURN.tilt];
    this.#redraw();
  }

  /** The drawing as a file of its own, with the colours it has now. */
  toSvg() {
    const [back, front] = [this.#back, this.#svg].map(layer => {
      const copy = /** @type {SVGSVGElement} */ (layer.cloneNode(true));
      copyStyles(layer, copy);
      return copy;
    });
    const { a, b, c, d, e, f } = this.#objectMatrix();
    const { width, height } = this.#canvas;
    const object = svg("image", { href: this.#canvas.toDataURL(), width, height, transform: `matrix(${[a, b, c, d, e, f].join(" ")})` });
    const file = svg("svg", { viewBox: this.#back.getAttribute("viewBox"), width: VIEW.width * 3, height: VIEW.height * 3 });
    file.append(...back.children, object, ...front.children);
    return new XMLSerializer().serializeToString(file);
  }

  /** Height of the dome's centre on the drawing: a tilted dome reaches less far down than up. */
  get #middle() {
    return RADIUS * (1 - Math.cos(this.#tilt)) / 2;
  }

  /**
   * Position on the drawing; depth is positive towards the viewer.
   * @param {Direction} direction
   */
  #project([x, y, z]) {
    const [sinYaw, cosYaw, sinTilt, cosTilt] = [Math.sin(this.#yaw), Math.cos(this.#yaw), Math.sin(this.#tilt), Math.cos(this.#tilt)];
    const forward = x * sinYaw + y * cosYaw;
    return {
      x: RADIUS * (x * cosYaw - y * sinYaw),
      y: this.#middle - RADIUS * (forward * cosTilt + z * sinTilt),
      depth: z * cosTilt - forward * sinTilt,
    };
  }

  /**
   * The direction of the dome under a position of the drawing: of the two, the one nearer to where the sun is.
   * @param {number} px
   * @param {number} py
   * @param {Direction} near
   * @returns {Direction}
   */
  #unproject(px, py, near) {
    let [u, v] = [px / RADIUS, (this.#middle - py) / RADIUS];
    const r = Math.hypot(u, v);
    if (r > 1) [u, v] = [u / r, v / r];
    const front = Math.sqrt(Math.max(0, 1 - u * u - v * v));
    const [sinYaw, cosYaw, sinTilt, cosTilt] = [Math.sin(this.#yaw), Math.cos(this.#yaw), Math.sin(this.#tilt), Math.cos(this.#tilt)];
    const both = [front, -front].map(depth => {
      const forward = v * cosTilt - depth * sinTilt;
      const z = Math.max(0, v * sinTilt + depth * cosTilt);
      const [x, y] = [u * cosYaw + forward * sinYaw, forward * cosYaw - u * sinYaw];
      const length = Math.hypot(x, y, z) || 1;
      return /** @type {Direction} */ ([x / length, y / length, z / length]);
    });
    const closeness = both.map(d => d[0] * near[0] + d[1] * near[1] + d[2] * near[2]);
    return both[closeness[0] >= closeness[1] ? 0 : 1];
  }

  #redraw() {
    if (this.#waiting) return;
    this.#waiting = true;
    requestAnimationFrame(() => {
      this.#waiting = false;
      const drawn = `${this.#yaw} ${this.#tilt} ${this.#reach} ${this.#hot} ${this.#candidates}`;
      if (drawn !== this.#drawn) {
        this.#drawBack();
        this.#drawCandidates();
        this.#drawn = drawn;
      }
      this.#drawMarks();
      this.#drawSun();
      this.#placeObject();
    });
  }

  /** @param {Direction[]} directions */
  #line(directions) {
    return directions.map((d, i) => {
      const { x, y } = this.#project(d);
      return `${i ? "L" : "M"}${x.toFixed(2)} ${y.toFixed(2)}`;
    }).join("");
  }

  #drawBack() {
    const [flat, middle] = [Math.cos(this.#tilt), this.#middle];
    /** @type {SVGElement[]} */
    const parts = [
      svg("defs", {}, gradient("dome-shell", ["stop-centre", 1], ["stop-edge", 1]), gradient("dome-floor", ["stop-edge", 0.9], ["stop-edge", 0.2])),
      // The outline of a half ball: the half circle that rises above the floor, and the floor's near edge.
      svg("path", { class: "shell", d: `M${-RADIUS} ${middle}A${RADIUS} ${RADIUS} 0 0 1 ${RADIUS} ${middle}A${RADIUS} ${RADIUS * flat} 0 0 1 ${-RADIUS} ${middle}Z` }),
      svg("ellipse", { class: "floor", cy: middle, rx: RADIUS, ry: RADIUS * flat }),
    ];
    for (const slant of [30, 60]) parts.push(svg("path", { class: "grid", d: this.#line(circle(slant)) }));
    for (let azimuth = 0; azimuth < 360; azimuth += 45) {
      const meridian = Array.from({ length: 13 }, (_, i) => polar(azimuth, 90 - i * 7.5));
      const far = this.#project(polar(azimuth, 80)).depth < 0;
      parts.push(svg("path", { class: `grid${far ? " far" : ""}`, d: this.#line(meridian) }));
    }
    if (this.#reach < 89) parts.push(svg("path", { class: "reach", d: this.#line(circle(this.#reach)) }));
    for (const [text, azimuth] of /** @type {const} */ ([["+x", 0], ["+y", 90], ["−x", 180], ["−y", 270]])) {
      const at = this.#project(polar(azimuth, 90));
      parts.push(svg("text", { class: "axis", x: at.x * 1.1, y: middle + (at.y - middle) * 1.1 + 3 }, text));
    }
    this.#back.replaceChildren(...parts);
  }

  #drawCandidates() {
    if (this.#dots.childElementCount !== 2 * this.#candidates.length) {
      this.#dots.replaceChildren(...this.#candidates.flatMap((_, i) => [svg("circle"), svg("circle", { class: "hit", r: 5, "data-candidate": i })]));
    }
    // The circles stay the same ones: what the pointer stands on must not be taken from under it.
    const circles = /** @type {HTMLCollectionOf<SVGElement>} */ (this.#dots.children);
    this.#candidates.forEach((direction, i) => {
      const { x, y } = this.#project(direction);
      const at = { cx: x.toFixed(2), cy: y.toFixed(2) };
      const hot = i === this.#hot;
      set(circles[2 * i], { class: `candidate${hot ? " hot" : ""}`, r: hot ? 3.4 : 1.4, ...at });
      set(circles[2 * i + 1], at);
    });
  }

  #drawMarks() {
    /** @type {SVGElement[]} */
    const parts = [];
    const now = this.#current - 1;
    this.#lights.forEach(({ used }, i) => {
      if (i === 0) return;
      const arc = between(this.#lights[i - 1].used, used);
      parts.push(svg("path", { class: `path${i > now ? " future" : ""}`, d: this.#line(arc) }));
    });
    const last = this.#lights[now];
    if (last) {
      const at = this.#project(last.used);
      parts.push(svg("line", { class: "ray", x1: at.x, y1: at.y, x2: 0, y2: this.#middle }));
    }
    const order = this.#lights.map((light, i) => ({ light, i, at: this.#project(light.used) }));
    order.sort((a, b) => a.at.depth - b.at.depth);
    for (const { light, i, at } of order) {
      const asked = this.#project(light.requested);
      const future = i > now;
      if (!future && Math.hypot(asked.x - at.x, asked.y - at.y) > 2) {
        parts.push(
          svg("line", { class: "request-link", x1: at.x, y1: at.y, x2: asked.x, y2: asked.y }),
          svg("circle", { class: "request", cx: asked.x, cy: asked.y, r: 3.4 }),
        );
      }
      const mark = svg("g", { class: `light${future ? " future" : ""}${i === now ? " now" : ""}`, transform: `translate(${at.x.toFixed(2)} ${at.y.toFixed(2)})` });
      if (i === now) mark.append(svg("circle", { class: "halo", r: 8.5 }));
      mark.append(svg("circle", { r: 5.6, "data-light": i }));
      if (light.label) mark.append(svg("text", { y: 0.3 }, light.label));
      parts.push(mark);
    }
    this.#marks.replaceChildren(...parts);
  }

  #drawSun() {
    this.#sunMark.toggleAttribute("hidden", !this.#sun);
    this.#sunMark.style.display = this.#sun ? "" : "none";
    if (!this.#sun) return;
    const at = this.#project(this.#sun);
    const { azimuth, slant } = angles(this.#sun);
    set(this.#sunMark, {
      "aria-valuenow": Math.round(azimuth),
      "aria-valuetext": `azimuth ${Math.round(azimuth)}°, slant ${Math.round(slant)}°`,
    });
    const rays = Array.from({ length: 8 }, (_, i) => {
      const [c, s] = [Math.cos(i * Math.PI / 4), Math.sin(i * Math.PI / 4)];
      return `M${(6.8 * c).toFixed(2)} ${(6.8 * s).toFixed(2)}L${(9 * c).toFixed(2)} ${(9 * s).toFixed(2)}`;
    }).join("");
    this.#sunMark.replaceChildren(
      svg("defs", {}, gradient("dome-glow", ["stop-glow", 0.55], ["stop-glow", 0])),
      svg("line", { class: "sun-ray", x1: at.x, y1: at.y, x2: 0, y2: this.#middle }),
      svg("g", { transform: `translate(${at.x} ${at.y})` },
        svg("circle", { class: "glow", r: 22 }),
        svg("circle", { class: "grab", r: 15 }),
        svg("circle", { class: "ring", r: 12 }),
        svg("path", { d: rays }),
        svg("circle", { r: 5 })),
    );
  }

  /** From the object's pixels to the drawing's units: it lies on the floor of the dome. */
  #objectMatrix() {
    const { width, height } = this.#canvas;
    const scale = OBJECT_SIZE * RADIUS / Math.hypot(width, height) * 1.15;
    const [sin, cos, flat] = [Math.sin(this.#yaw), Math.cos(this.#yaw), Math.cos(this.#tilt)];
    // Columns of the image run along +x, rows along −y.
    return new DOMMatrix([cos * scale, -sin * flat * scale, sin * scale, cos * flat * scale, 0, this.#middle])
      .translate(-width / 2, -height / 2);
  }

  #placeObject() {
    const box = this.#svg.getBoundingClientRect();
    if (!box.width) return;
    const unit = box.width / VIEW.width;
    const matrix = new DOMMatrix().scale(unit).translate(-VIEW.left, -VIEW.top).multiply(this.#objectMatrix());
    this.#canvas.style.transform = matrix.toString();
  }

  #listen() {
    /** @type {{ kind: "sun" | "turn", x: number, y: number, tapped: Element | null } | null} tapped: until it moves */
    let drag = null;
    const over = (/** @type {Element} */ element) => {
      const hit = element.getAttribute("data-candidate");
      this.#point(hit === null ? null : Number(hit));
    };
    const position = (/** @type {PointerEvent} */ event) => {
      const box = this.#svg.getBoundingClientRect();
      const unit = VIEW.width / box.width;
      return { x: VIEW.left + (event.clientX - box.left) * unit, y: VIEW.top + (event.clientY - box.top) * unit };
    };
    this.#svg.addEventListener("pointerdown", event => {
      const target = /** @type {Element} */ (event.target);
      const light = target.closest("[data-light]")?.getAttribute("data-light");
      if (light) this.#events.onLight?.(Number(light));
      drag = { kind: target.closest(".sun") ? "sun" : "turn", ...position(event), tapped: target };
      this.#svg.setPointerCapture(event.pointerId);
    });
    this.#svg.addEventListener("pointermove", event => {
      const at = position(event);
      if (drag?.kind === "sun" && this.#sun) this.#moveSun(this.#unproject(at.x, at.y, this.#sun));
      else if (drag?.kind === "turn") {
        if (drag.tapped && Math.hypot(at.x - drag.x, at.y - drag.y) < TAP) return;
        this.#point(null); // what turns leaves the pointer
        this.turn((at.x - drag.x) / RADIUS, (at.y - drag.y) / RADIUS);
        Object.assign(drag, at, { tapped: null });
      } else over(/** @type {Element} */ (event.target));
    });
    this.#svg.addEventListener("pointerup", () => {
      if (drag?.kind === "turn" && drag.tapped) over(drag.tapped);
      drag = null;
    });
    this.#svg.addEventListener("pointercancel", () => { drag = null; });
    // A finger leaves when it is lifted: what it has tapped stays until the next tap.
    this.#svg.addEventListener("pointerleave", event => { if (event.pointerType !== "touch") this.#point(null); });
    this.#svg.addEventListener("blur", () => this.#point(null));
    this.#svg.addEventListener("keydown", event => this.#key(event));
  }

  /** @param {number | null} candidate */
  #point(candidate) {
    if (candidate === this.#hot) return;
    this.#hot = candidate;
    this.#redraw();
    this.#events.onCandidate?.(candidate);
  }

  /** @param {Direction} direction */
  #moveSun(direction) {
    this.#sun = direction;
    this.#redraw();
    this.#events.onSun?.(direction);
  }

  /** Where a candidate is, relative to the dome's box, in fractions of it. @param {number} candidate */
  locate(candidate) {
    const { x, y } = this.#project(this.#candidates[candidate]);
    return { x: (x - VIEW.left) / VIEW.width, y: (y - VIEW.top) / VIEW.height };
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const count = this.#candidates.length;
    if (arrow && event.target === this.#sunMark && this.#sun) {
      const { azimuth, slant } = angles(this.#sun);
      const step = event.shiftKey ? 1 : 5;
      this.#moveSun(polar(azimuth - arrow[0] * step, Math.min(90, Math.max(0, slant + arrow[1] * step))));
    } else if (arrow) this.turn(arrow[0] * KEY_STEP, arrow[1] * KEY_STEP);
    else if (event.key === "Home") this.look("default");
    else if (event.key.toLowerCase() === "n" && count) this.#point(((this.#hot ?? -1) + 1) % count);
    else if (event.key.toLowerCase() === "p" && count) this.#point(((this.#hot ?? 0) + count - 1) % count);
    else if (event.key === "Escape") this.#point(null);
    else return;
    event.preventDefault();
  }
}

/**
 * @param {number} azimuth degrees
 * @param {number} slant degrees
 * @returns {Direction}
 */
export function polar(azimuth, slant) {
  const [a, s] = [azimuth * Math.PI / 180, slant * Math.PI / 180];
  return [Math.sin(s) * Math.cos(a), Math.sin(s) * Math.sin(a), Math.cos(s)];
}

/**
 * Azimuth and slant in degrees, for people.
 * @param {Direction} direction
 */
export function angles([x, y, z]) {
  const slant = Math.atan2(Math.hypot(x, y), z) * 180 / Math.PI;
  return { azimuth: slant < 0.05 ? 0 : Math.atan2(y, x) * 180 / Math.PI, slant };
}

/**
 * A gradient from the middle outwards; its colours are CSS classes with an opacity.
 * @param {string} id
 * @param {...[string, number]} stops
 */
function gradient(id, ...stops) {
  return svg("radialGradient", { id, r: 0.62 }, ...stops.map(([name, opacity], i) =>
    svg("stop", { class: name, offset: i / (stops.length - 1), "stop-opacity": opacity })));
}

/** @param {number} slant degrees */
function circle(slant) {
  return Array.from({ length: 73 }, (_, i) => polar(i * 5, slant));
}

/**
 * Points of the great circle from one direction to another.
 * @param {Direction} a
 * @param {Direction} b
 * @returns {Direction[]}
 */
function between(a, b) {
  const steps = 10;
  return Array.from({ length: steps + 1 }, (_, i) => {
    const t = i / steps;
    const d = /** @type {Direction} */ (a.map((v, k) => v * (1 - t) + b[k] * t));
    const length = Math.hypot(...d) || 1;
    return /** @type {Direction} */ (d.map(v => v / length));
  });
}

/**
 * Writes the computed colours and strokes of a drawing into its copy, which has no style sheet.
 * @param {Element} from
 * @param {Element} to
 */
export function copyStyles(from, to) {
  const wanted = ["fill", "stroke", "stroke-width", "stroke-dasharray", "stroke-linejoin", "opacity", "font", "text-anchor", "dominant-baseline", "display", "stop-color", "stop-opacity"];
  const style = getComputedStyle(from);
  to.setAttribute("style", wanted.map(name => `${name}:${style.getPropertyValue(name)}`).join(";"));
  [...from.children].forEach((child, i) => copyStyles(child, to.children[i]));
}
